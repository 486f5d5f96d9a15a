"""DAQP, a dual active-set solver [Arnstrom2022]_: small dense programs, MIT licence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import is_definite, is_installed, require
from clfcbf.qp.polish import polish
from clfcbf.qp.problem import QpSolution, QpStatus, QuadraticProgram
from clfcbf.qp.reduction import reduce

__all__ = ["DaqpBackend", "create", "installed", "names"]

_NO_BOUND = 1e30
"""What DAQP takes for infinity."""

_EQUALITY = 5
"""DAQP's mark of a row that is one."""

_EXIT = {
    1: QpStatus.OPTIMAL,
    2: QpStatus.RELAXED,
    -1: QpStatus.INFEASIBLE,
    -2: QpStatus.NUMERICAL_ERROR,
    -3: QpStatus.UNBOUNDED,
    -4: QpStatus.ITERATION_LIMIT,
    -5: QpStatus.INVALID_INPUT,
    -6: QpStatus.NUMERICAL_ERROR,
    -7: QpStatus.TIME_LIMIT,
}


@dataclass(frozen=True, slots=True)
class DaqpBackend:
    """DAQP through its call without state, which is as fast as its workspace and safer.

    Attributes
    ----------
    primal_tol : largest violation of a row; the solver's own default, 1e-6, errs by 1e-4 in
        the command, and 1e-11 costs no time
    iter_limit : the solver's own default
    """

    primal_tol: float = 1e-11
    iter_limit: int = 1000

    @property
    def name(self) -> str:
        """``"daqp"``."""
        return "daqp"

    @property
    def capability(self) -> Capability:
        """Any size; singular P by regularisation."""
        return Capability(package="daqp", licence="MIT", time_limit=True)

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> QpSolution:
        """Solve a well-posed program."""
        import daqp

        n, m = problem.n, problem.m
        rows = np.concatenate((problem.G, problem.A))
        right = np.concatenate((problem.h, problem.b))
        # To length one, by powers of two: DAQP takes rows of length 1e-7 for zero.
        shorten = -np.frexp(np.max(np.abs(rows), axis=1, initial=0.0))[1]
        right = np.ldexp(right, shorten)
        upper = np.minimum(np.concatenate((problem.ub, right)), _NO_BOUND)
        lower = np.full(upper.size, -_NO_BOUND)
        np.maximum(problem.lb, -_NO_BOUND, out=lower[:n])
        lower[n + m :] = right[m:]
        sense = np.zeros(upper.size, dtype=np.int32)
        sense[n + m :] = _EQUALITY
        limits = {} if time_limit is None else {"time_limit": time_limit}
        x, _, flag, info = daqp.solve(
            np.array(problem.P),
            np.array(problem.q),
            np.ldexp(rows, shorten[:, None]),
            upper,
            lower,
            sense,
            primal_tol=self.primal_tol,
            iter_limit=self.iter_limit,
            **limits,
        )
        status = _EXIT.get(int(flag), QpStatus.NUMERICAL_ERROR)
        message = f"exit flag {int(flag)}"
        if not status.found:
            return QpSolution(None, status, self.name, message=message)
        point = np.asarray(x, dtype=np.float64)
        reduction = None if is_definite(problem.P) else reduce(problem)
        if reduction is not None:
            # It regularised the cost, which shows in the ninth digit.
            polished = polish(reduction.form, point / reduction.variables, None)
            if polished is not None:
                point, duals = reduction.restore(*polished)
                return QpSolution(
                    point,
                    status,
                    self.name,
                    duals.rows,
                    duals.bounds,
                    message=message,
                    dual_equalities=duals.equalities,
                )
        dual = np.array(info["lam"], dtype=np.float64)
        dual[n:] = np.ldexp(dual[n:], shorten)
        return QpSolution(
            point,
            status,
            self.name,
            dual[n : n + m],
            dual[:n],
            message=message,
            dual_equalities=dual[n + m :],
        )


def names() -> tuple[str, ...]:
    """The one name."""
    return ("daqp",)


def installed() -> tuple[str, ...]:
    """The name, if the package is there."""
    return names() if is_installed("daqp") else ()


def create(name: str) -> DaqpBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("daqp", name, "solvers")
    return DaqpBackend()
