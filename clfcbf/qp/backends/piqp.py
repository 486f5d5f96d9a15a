"""PIQP, a proximal interior-point solver [Schwan2023]_: dense programs, BSD-2 licence."""

from __future__ import annotations

from typing import Any

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import Claim, SolverBackend, is_installed, require, statuses
from clfcbf.qp.backends._workspace import Loader, finite_sides, tighten
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TOLERANCE = 1e-10
"""Three digits under the solver's default, for two iterations more."""

_INFEASIBLE = 1e-9
"""Error of a certificate of infeasibility: in line with the tolerance."""

_NO_BOUND = 1e30
"""What PIQP takes for infinity."""

_MEANINGS = {
    "PIQP_SOLVED": QpStatus.OPTIMAL,
    "PIQP_MAX_ITER_REACHED": QpStatus.ITERATION_LIMIT,
    "PIQP_PRIMAL_INFEASIBLE": QpStatus.INFEASIBLE,
    "PIQP_DUAL_INFEASIBLE": QpStatus.UNBOUNDED,
}


class _Workspace:
    """Set up once for a shape, its numbers updated in place."""

    def __init__(self, form: Form) -> None:
        import piqp

        self._solver: Any = piqp.DenseSolver()
        tighten(self._solver.settings, _TOLERANCE, _INFEASIBLE)
        self._load = Loader(self._solver.setup, self._solver.update)

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        equal = form.equal
        lower, upper = finite_sides(form, _NO_BOUND, equal)
        self._load(
            P=np.asfortranarray(form.P),
            c=form.q,
            A=np.asfortranarray(form.C[:equal]),
            b=form.lower[:equal],
            G=np.asfortranarray(form.C[equal:]),
            h_l=lower,
            h_u=upper,
        )
        status, message = statuses(_MEANINGS, self._solver.solve())
        result = self._solver.result
        dual = np.concatenate((result.y, result.z_u - result.z_l))
        return Claim(status, np.array(result.x), dual, message)


def names() -> tuple[str, ...]:
    """The one name."""
    return ("piqp",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("piqp") else ()


def create(name: str) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("piqp", name, "solvers")
    capability = Capability(package="piqp", licence="BSD-2-Clause", extra="solvers")
    return SolverBackend(name, capability, _Workspace)
