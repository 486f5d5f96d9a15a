"""quadprog, the dual active-set method of [GoldfarbIdnani1983]_: dense programs, GPL licence."""

from __future__ import annotations

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import Claim, SolverBackend, is_installed, require
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]


class _Workspace:
    """Nothing to keep: the solver is one call."""

    def __init__(self, form: Form) -> None:
        pass

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        import quadprog

        G, h = form.one_sided()
        equal = form.equal
        # Rows are a.y >= b here, so that every sign but that of an equality's turns.
        rows = np.concatenate((form.C[:equal], -G))
        right = np.concatenate((form.lower[:equal], -h))
        data = (rows.T, right, equal) if right.size else ()
        try:
            y, _, _, _, lagrangian, _ = quadprog.solve_qp(form.P, -form.q, *data)
        except ValueError as error:
            message = str(error)
            inconsistent = "inconsistent" in message
            status = QpStatus.INFEASIBLE if inconsistent else QpStatus.NUMERICAL_ERROR
            return Claim(status, message=message)
        lagrangian = np.asarray(lagrangian, dtype=np.float64)
        # The sign of an equality's multiplier is not told: stationarity knows it.
        dual = None if equal else form.two_sided_dual(np.zeros(0), lagrangian[: right.size])
        return Claim(QpStatus.OPTIMAL, np.array(y), dual, "solved")


def names() -> tuple[str, ...]:
    """The one name."""
    return ("quadprog",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("quadprog") else ()


def create(name: str) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("quadprog", name, "gpl")
    capability = Capability(
        semidefinite=False, package="quadprog", licence="GPL-2.0-or-later", extra="gpl"
    )
    return SolverBackend(name, capability, _Workspace, direct=True)
