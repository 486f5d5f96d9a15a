"""Solvers behind one protocol, one module each.

A module here names its solvers in ``names()`` without importing them and makes one in
``create(name)``, which may import. Adding a solver is adding a module.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

from clfcbf.errors import BackendError
from clfcbf.qp.problem import QpSolution, QuadraticProgram

__all__ = ["Backend", "BackendModule", "Capability", "available_backends", "get_backend"]


@dataclass(frozen=True, slots=True)
class Capability:
    """What a backend can take, and what it is.

    Attributes
    ----------
    max_variables : largest n, or None for any
    semidefinite : whether P may be singular
    multipliers : whether it returns usable multipliers; they are reconstructed otherwise
    package : distribution that must be installed, or None
    licence : SPDX identifier of that package
    extra : of this library that brings it, or None where it always comes along
    equalities : whether rows :math:`Az = b` are allowed
    warm_start : whether it can start from its last answer
    time_limit : whether it can be given a time limit
    """

    max_variables: int | None = None
    semidefinite: bool = True
    multipliers: bool = True
    package: str | None = None
    licence: str = "Apache-2.0"
    extra: str | None = None
    equalities: bool = True
    warm_start: bool = False
    time_limit: bool = False

    def check(self, name: str, problem: QuadraticProgram, time_limit: float | None = None) -> None:
        """Raise BackendError where ``problem`` is of a kind that this cannot take.

        That P is positive definite where it must be is not checked here.
        """
        if self.max_variables is not None and problem.n > self.max_variables:
            raise BackendError(
                f"{name!r} takes at most {self.max_variables} variables, got {problem.n}; "
                "use 'daqp'"
            )
        if problem.p and not self.equalities:
            raise BackendError(
                f"{name!r} takes no equality rows, got {problem.p}; use 'daqp' or 'clarabel'"
            )
        if time_limit is not None and not self.time_limit:
            raise BackendError(f"{name!r} cannot be given a time limit; use 'clarabel' or 'osqp'")


@runtime_checkable
class Backend(Protocol):
    """A solver of quadratic programs.

    It may keep a workspace between calls; what a call answers must not depend on calls that
    failed, nor, but for rounding, on those that did not.
    """

    @property
    def name(self) -> str:
        """The name it is asked for by."""

    @property
    def capability(self) -> Capability:
        """What it can take."""

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> QpSolution:
        """Solve a well-posed program; the answer is the solver's claim, not yet verified.

        ``time_limit`` [s] is given only to a backend whose capability says that it keeps one.
        """


class BackendModule(Protocol):
    """What each module of this package offers."""

    def names(self) -> tuple[str, ...]:
        """Names it could make if everything were installed; no import of a solver."""

    def installed(self) -> tuple[str, ...]:
        """Those of them that are installed and agree with 'exact'; no import of a solver."""

    def create(self, name: str) -> Backend:
        """Make one; raises MissingExtraError if its package is not installed."""


@functools.cache
def _modules() -> tuple[tuple[str, BackendModule], ...]:
    found = (module.name for module in pkgutil.iter_modules(__path__))
    # "exact" first, for it is the default; then by name.
    ordered = sorted((n for n in found if not n.startswith("_")), key=lambda n: (n != "exact", n))
    return tuple(
        (name, cast(BackendModule, importlib.import_module(f"{__name__}.{name}")))
        for name in ordered
    )


def available_backends() -> tuple[str, ...]:
    """Names of the backends whose packages are installed, ``"exact"`` first."""
    return tuple(name for _, module in _modules() for name in module.installed())


def get_backend(backend: str | Backend) -> Backend:
    """The backend called so, at its default settings; a backend itself is returned as it is.

    Raises
    ------
    BackendError : no backend has that name, the message lists those that do; or the object lacks
        a part of :class:`Backend`
    MissingExtraError : its package is not installed; the message names the extra
    """
    if isinstance(backend, str):
        return _named(backend)
    if isinstance(backend, Backend) and not isinstance(backend, type):
        return backend
    raise BackendError(
        f"not a backend: {backend!r}; it needs name, capability and solve, see clfcbf.qp.Backend, "
        f"or is a name: {', '.join(available_backends())}"
    )


@functools.cache
def _named(name: str) -> Backend:
    family = name.partition(":")[0]
    for module_name, module in _modules():
        if name in module.names() or (family == module_name and family != name):
            return module.create(name)
    known = ", ".join(known for _, module in _modules() for known in module.names())
    raise BackendError(f"no backend is called {name!r}; choose one of: {known}")
