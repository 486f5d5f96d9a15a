"""ProxQP, a proximal augmented-Lagrangian solver [Bambade2022]_: dense programs, BSD-2 licence."""

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
from clfcbf.qp.backends._workspace import Loader, finite_sides, tighten
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TOLERANCE = 1e-9
"""On residuals and on the duality gap, which the solver ignores unless told: its answers are then
off by a tenth, with residuals of 1e-10."""

_ITERATIONS = 500
"""Sound programs take twenty; an infeasible one would use up the solver's own 10 000."""

_INFEASIBLE = 1e-9
"""Error of a certificate of infeasibility; at the solver's own 1e-4 sound programs have one."""

_NO_BOUND = 1e20
"""What ProxQP takes for infinity."""

_MEANINGS = {
    "PROXQP_SOLVED": QpStatus.OPTIMAL,
    "PROXQP_MAX_ITER_REACHED": QpStatus.ITERATION_LIMIT,
    "PROXQP_PRIMAL_INFEASIBLE": QpStatus.INFEASIBLE,
    "PROXQP_DUAL_INFEASIBLE": QpStatus.UNBOUNDED,
    "PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE": QpStatus.INFEASIBLE,
}


class _Workspace:
    """The dense solver. Bounds go in as rows: boxes are rescaled by a second solve."""

    def __init__(self, warm_start: bool, form: Form) -> None:
        with undisturbed():
            from proxsuite import proxqp

        n, k, equal = form.q.size, form.lower.size, form.equal
        self._solver: Any = proxqp.dense.QP(n, equal, k - equal)
        settings = self._solver.settings
        tighten(settings, _TOLERANCE, _INFEASIBLE)
        settings.max_iter = _ITERATIONS
        guesses = proxqp.InitialGuess
        settings.initial_guess = (
            guesses.WARM_START_WITH_PREVIOUS_RESULT
            if warm_start
            else guesses.EQUALITY_CONSTRAINED_INITIAL_GUESS
        )
        self._load = Loader(
            self._solver.init, partial(self._solver.update, update_preconditioner=True)
        )

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        equal = form.equal
        lower, upper = finite_sides(form, _NO_BOUND, equal)
        self._load(form.P, form.q, form.C[:equal], form.lower[:equal], form.C[equal:], lower, upper)
        self._solver.solve()
        results = self._solver.results
        status, message = statuses(_MEANINGS, results.info.status)
        dual = np.concatenate((results.y, results.z))
        return Claim(status, np.array(results.x), dual, message)


def names() -> tuple[str, ...]:
    """The one name."""
    return ("proxqp",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("proxsuite") else ()


def create(name: str, warm_start: bool = False) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("proxsuite", "proxsuite", "solvers")
    capability = Capability(
        package="proxsuite", licence="BSD-2-Clause", extra="solvers", warm_start=True
    )
    return SolverBackend(name, capability, partial(_Workspace, warm_start))
