"""Clarabel, an interior-point solver [Goulart2024]_: sparse programs, Apache-2.0 licence."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import (
    Claim,
    SolverBackend,
    is_installed,
    require,
    statuses,
    undisturbed,
)
from clfcbf.qp.problem import Array, QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TOLERANCE = 1e-9
"""A digit short of where badly scaled programs stop converging, and enough for the polish."""

_MEANINGS = {
    "Solved": QpStatus.OPTIMAL,
    "AlmostSolved": QpStatus.ITERATION_LIMIT,
    "PrimalInfeasible": QpStatus.INFEASIBLE,
    "AlmostPrimalInfeasible": QpStatus.INFEASIBLE,
    "DualInfeasible": QpStatus.UNBOUNDED,
    "AlmostDualInfeasible": QpStatus.UNBOUNDED,
    "MaxIterations": QpStatus.ITERATION_LIMIT,
    "InsufficientProgress": QpStatus.ITERATION_LIMIT,
    "MaxTime": QpStatus.TIME_LIMIT,
}


class _Workspace:
    """Set up once for a shape, its numbers updated in place."""

    def __init__(self, form: Form) -> None:
        with undisturbed():
            import clarabel
            from scipy import sparse

        n = form.q.size
        rows, columns = np.triu_indices(n)
        order = columns.argsort(kind="stable")
        self._triangle = rows[order], columns[order]
        starts = np.cumsum(np.arange(n + 1))
        self._P = sparse.csc_matrix(
            (form.P[self._triangle], self._triangle[0], starts), shape=(n, n)
        )
        A, b = _stack(form)
        k = b.size
        self._A = sparse.csc_matrix(
            (A.T.ravel(), np.tile(np.arange(k), n), np.arange(n + 1) * k), shape=(k, n)
        )
        cones = []
        if form.equal:
            cones.append(clarabel.ZeroConeT(form.equal))
        if k > form.equal:
            cones.append(clarabel.NonnegativeConeT(k - form.equal))
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False
        self._settings.presolve_enable = False  # or the numbers could not be updated
        self._settings.max_threads = 1
        self._settings.tol_gap_abs = _TOLERANCE
        self._settings.tol_gap_rel = _TOLERANCE
        self._settings.tol_feas = _TOLERANCE
        self._solver: Any = clarabel.DefaultSolver(
            self._P, form.q, self._A, b, cones, self._settings
        )
        self._fresh = True

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        self._settings.time_limit = math.inf if time_limit is None else time_limit
        if self._fresh:
            self._solver.update(settings=self._settings)
        else:
            A, b = _stack(form)
            self._solver.update(
                P=form.P[self._triangle], q=form.q, A=A.T.ravel(), b=b, settings=self._settings
            )
        self._fresh = False
        answer = self._solver.solve()
        status, message = statuses(_MEANINGS, answer.status)
        z = np.array(answer.z)
        dual = form.two_sided_dual(z[: form.equal], z[form.equal :])
        return Claim(status, np.array(answer.x), dual, message)


def _stack(form: Form) -> tuple[Array, Array]:
    """Equalities, then inequalities one-sided."""
    G, h = form.one_sided()
    equal = form.equal
    return np.concatenate((form.C[:equal], G)), np.concatenate((form.lower[:equal], h))


def names() -> tuple[str, ...]:
    """The one name."""
    return ("clarabel",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("clarabel") else ()


def create(name: str) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("clarabel", name, "solvers")
    capability = Capability(
        package="clarabel", licence="Apache-2.0", extra="solvers", time_limit=True
    )
    return SolverBackend(name, capability, _Workspace)
