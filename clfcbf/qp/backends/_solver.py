"""What the backends share: reduction before, polish after, and workspaces that never go bad."""

from __future__ import annotations

import importlib.util
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import numpy as np

from clfcbf.errors import BackendError, MissingExtraError
from clfcbf.qp.backends import Capability
from clfcbf.qp.polish import is_exact, polish
from clfcbf.qp.problem import Array, QpSolution, QpStatus, QuadraticProgram
from clfcbf.qp.reduction import Form, reduce

__all__ = [
    "Claim",
    "SolverBackend",
    "Workspace",
    "is_definite",
    "is_installed",
    "require",
    "statuses",
    "undisturbed",
]

_WORKSPACES = 8
"""Shapes kept per thread: a controller's rows come and go in a handful of combinations."""

_PIVOT = 1e-13
"""Share of a diagonal entry under which a pivot is rounding."""


class Claim(NamedTuple):
    """What a solver said of a form.

    Attributes
    ----------
    status : in our words
    y : its point, shape (n,), also where it stopped early; None where there is none
    dual : its multipliers, positive at an upper side, shape (k,), or None
    message : in its own words
    """

    status: QpStatus
    y: Array | None = None
    dual: Array | None = None
    message: str = ""


class Workspace(Protocol):
    """A solver set up for forms of one shape."""

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        """Solve a form of that shape; may raise anything."""


class SolverBackend:
    """A solver of forms as a :class:`Backend`.

    Workspaces are kept by shape and by thread. One that failed, or saw an exception, is thrown
    away with all it knew: a failed solve is nobody's warm start.

    Parameters
    ----------
    name, capability : see :class:`Backend`
    make : sets up a workspace for the shape of a form
    direct : whether it ends by solving for the active rows itself, as active-set methods do; its
        answer is then polished only where a condition of optimality fails. What others return
        depends in its last bits on what went before, unless it always is
    """

    def __init__(
        self,
        name: str,
        capability: Capability,
        make: Callable[[Form], Workspace],
        direct: bool = False,
    ) -> None:
        self._name = name
        self._capability = capability
        self._make = make
        self._direct = direct
        self._kept = threading.local()

    def __repr__(self) -> str:
        return f"SolverBackend({self._name!r})"

    @property
    def name(self) -> str:
        """The name it is asked for by."""
        return self._name

    @property
    def capability(self) -> Capability:
        """What it can take."""
        return self._capability

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> QpSolution:
        """Solve a well-posed program.

        Raises
        ------
        BackendError : the program is of a kind that this backend cannot take
        """
        self._capability.check(self._name, problem, time_limit)
        if not problem.well_posed:
            message = "not a finite program"
            return QpSolution(None, QpStatus.INVALID_INPUT, self._name, message=message)
        reduction = reduce(problem)
        if reduction is None:
            message = "a zero row or a pair of bounds admits no point"
            return QpSolution(None, QpStatus.INFEASIBLE, self._name, message=message)
        form = reduction.form
        if not self._capability.semidefinite and not is_definite(form.P):
            raise BackendError(f"{self._name!r} needs P positive definite; use 'clarabel'")
        claim = self._ask(form, time_limit)
        if claim.y is None:
            return QpSolution(None, claim.status, self._name, message=claim.message)
        y, dual, status, message = claim.y, claim.dual, claim.status, claim.message
        moved = 0.0
        done = self._direct and status.found and is_exact(form, y, dual)
        polished = None if done else polish(form, y, dual)
        if polished is not None:
            moved = float(np.abs(polished[0] - y).max() / (1.0 + np.abs(polished[0]).max()))
            y, dual = polished
            if not status.found:
                # The point was near enough to name the active rows: then it is the answer.
                status, message = QpStatus.OPTIMAL, f"{message}; polished"
        if not status.found:
            return QpSolution(None, status, self._name, message=message)
        x, duals = reduction.restore(y, dual)
        return QpSolution(
            x,
            status,
            self._name,
            duals.rows,
            duals.bounds,
            message=message,
            dual_equalities=duals.equalities,
            moved=moved,
        )

    def _ask(self, form: Form, time_limit: float | None) -> Claim:
        kept: dict[Any, Workspace] = self._kept.__dict__
        shape = form.shape
        workspace = kept.pop(shape, None)
        if workspace is None:
            workspace = self._make(form)
        claim = workspace.solve(form, time_limit)
        if claim.status is QpStatus.OPTIMAL:
            kept[shape] = workspace
            if len(kept) > _WORKSPACES:
                del kept[next(iter(kept))]
        return claim


def is_definite(P: Array) -> bool:
    """Whether P is positive definite with digits to spare: each pivot over :data:`_PIVOT`."""
    try:
        pivots = np.linalg.cholesky(P).diagonal()
    except np.linalg.LinAlgError:
        return False
    return bool((pivots * pivots > _PIVOT * P.diagonal()).all())


def statuses(meanings: dict[str, QpStatus], said: object) -> tuple[QpStatus, str]:
    """Our status for a solver's own word, and that word; what is not listed is a failure."""
    word = str(said)
    return meanings.get(word.rpartition(".")[2], QpStatus.NUMERICAL_ERROR), word


def is_installed(module: str) -> bool:
    """Whether a module can be found; it is not imported."""
    return importlib.util.find_spec(module) is not None


def require(module: str, package: str, extra: str) -> None:
    """Raise MissingExtraError if a module cannot be found."""
    if not is_installed(module):
        raise MissingExtraError(package, extra)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Undo what an import does to the environment variables and to the filters of warnings."""
    before = dict(os.environ)
    try:
        with warnings.catch_warnings():
            yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        for name, value in before.items():
            if os.environ.get(name) != value:
                os.environ[name] = value
