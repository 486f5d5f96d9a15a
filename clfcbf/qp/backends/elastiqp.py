r"""ElastiQP, an active-set solver that never fails: dense programs, Apache-2.0 licence.

It relaxes every inequality at a price, :math:`\min \ldots + \rho\,1^\top t` with
:math:`Gy \le h + t`. A row whose multiplier reaches the price was violated; the program is then
infeasible, or its multipliers are larger than any price that leaves the solver digits to work
with, and no answer is claimed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import Claim, SolverBackend, is_installed, require, statuses
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_PRICE = 1e6
"""Of a unit of violation: over the multipliers of rows that meet at more than a millionth."""

_MEANINGS = {
    "Solved": QpStatus.OPTIMAL,
    "MaxIter": QpStatus.ITERATION_LIMIT,
    "Infeasible": QpStatus.INFEASIBLE,
}


class _Workspace:
    """The dual active-set method, set up anew for each program: that is a copy of its numbers."""

    def __init__(self, form: Form) -> None:
        import elastiqp

        self._solver: Any = elastiqp.Solver("das")
        self._solver.settings.warm_start = False

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        G, h = form.one_sided()
        equal = form.equal
        equalities = {}
        if equal:
            equalities = {"A": np.asfortranarray(form.C[:equal]), "b": form.lower[:equal].copy()}
        self._solver.setup(
            np.asfortranarray(form.P), form.q, np.asfortranarray(G), h, _PRICE, **equalities
        )
        answer = self._solver.solve()
        status, message = statuses(_MEANINGS, answer.status)
        if status is QpStatus.OPTIMAL and answer.n_saturated:
            return Claim(QpStatus.INFEASIBLE, message=f"{answer.n_saturated} rows violated")
        if status is QpStatus.INFEASIBLE:
            return Claim(status, message=message)
        dual = form.two_sided_dual(np.array(answer.y) if equal else np.zeros(0), answer.z)
        return Claim(status, np.array(answer.x), dual, message)


def names() -> tuple[str, ...]:
    """The one name."""
    return ("elastiqp",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("elastiqp") else ()


def create(name: str) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("elastiqp", name, "bench")
    capability = Capability(package="elastiqp", licence="Apache-2.0", extra="bench")
    return SolverBackend(name, capability, _Workspace, direct=True)
