"""OSQP, an operator-splitting solver [Stellato2020]_: sparse programs, Apache-2.0 licence."""

from __future__ import annotations

from functools import partial
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
from clfcbf.qp.backends._workspace import Loader, finite_sides
from clfcbf.qp.problem import Array, QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TOLERANCE = 1e-8
"""Close enough to name the active rows; each digit more costs a first-order method dearly."""

_INFEASIBLE = 1e-8
"""Error of a certificate of infeasibility; at the solver's own 1e-4 sound programs have one."""

_ITERATIONS = 4000
"""The solver's own default: what has not converged by then seldom does."""

_NO_BOUND = 1e30
"""What OSQP takes for infinity."""

_MEANINGS = {
    "solved": QpStatus.OPTIMAL,
    "solved inaccurate": QpStatus.ITERATION_LIMIT,
    "primal infeasible": QpStatus.INFEASIBLE,
    "primal infeasible inaccurate": QpStatus.INFEASIBLE,
    "dual infeasible": QpStatus.UNBOUNDED,
    "dual infeasible inaccurate": QpStatus.UNBOUNDED,
    "maximum iterations reached": QpStatus.ITERATION_LIMIT,
    "run time limit reached": QpStatus.TIME_LIMIT,
    "problem non convex": QpStatus.INVALID_INPUT,
}


class _Workspace:
    """Set up once for a shape, its numbers updated in place."""

    def __init__(self, warm_start: bool, form: Form) -> None:
        with undisturbed():
            import osqp
            from scipy import sparse

        rows, columns = np.triu_indices(form.q.size)
        order = columns.argsort(kind="stable")
        self._triangle = rows[order], columns[order]
        self._matrix = sparse.csc_matrix
        self._warm_start = warm_start
        self._solver: Any = osqp.OSQP()
        self._load = Loader(self._setup, self._solver.update)

    def _setup(self, q: Array, l: Array, u: Array, Px: Array, Ax: Array) -> None:  # noqa: E741
        n, k = q.size, l.size
        # Every entry is part of the pattern, a zero too: another program may need it.
        triangle = Px, self._triangle[0], np.cumsum(np.arange(n + 1))
        full = Ax, np.tile(np.arange(k), n), np.arange(n + 1) * k
        self._solver.setup(
            self._matrix(triangle, shape=(n, n)),
            q,
            self._matrix(full, shape=(k, n)),
            l,
            u,
            verbose=False,
            eps_abs=_TOLERANCE,
            eps_rel=0.0,
            eps_prim_inf=_INFEASIBLE,
            eps_dual_inf=_INFEASIBLE,
            max_iter=_ITERATIONS,
            scaling=0,  # the form is scaled
            polishing=False,  # ours is better, and this one prints
            check_dualgap=True,
            warm_starting=self._warm_start,
            adaptive_rho_interval=25,  # by iterations, not by the clock: runs repeat
        )

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        lower, upper = finite_sides(form, _NO_BOUND)
        self._load(q=form.q, l=lower, u=upper, Px=form.P[self._triangle], Ax=form.C.T.ravel())
        self._solver.update_settings(time_limit=1e10 if time_limit is None else time_limit)
        answer = self._solver.solve(raise_error=False)
        status, message = statuses(_MEANINGS, answer.info.status)
        if answer.x is None:
            return Claim(status, message=message)
        return Claim(status, np.array(answer.x), np.array(answer.y), message)


def names() -> tuple[str, ...]:
    """The one name."""
    return ("osqp",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("osqp") else ()


def create(name: str, warm_start: bool = False) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("osqp", name, "solvers")
    capability = Capability(
        package="osqp", licence="Apache-2.0", extra="solvers", warm_start=True, time_limit=True
    )
    return SolverBackend(name, capability, partial(_Workspace, warm_start))
