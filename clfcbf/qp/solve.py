"""One call for every backend, and no answer that was not verified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clfcbf.errors import BackendError, MissingExtraError
from clfcbf.qp.backends import Backend, get_backend
from clfcbf.qp.backends.exact import ExactBackend
from clfcbf.qp.problem import QpSolution, QpStatus, QuadraticProgram
from clfcbf.qp.verify import is_convex, multipliers_at, proves_infeasible, verify

__all__ = ["ACCEPTED", "solve_qp"]

ACCEPTED = 1e-7
"""Largest scaled residual of an accepted answer: a tenth of the 1e-6 asked of a command."""


def solve_qp(problem: QuadraticProgram, backend: str | Backend = "exact") -> QpSolution:
    r"""Solve a convex quadratic program and verify what comes back.

    .. math:: \min_z\ \tfrac12 z^\top P z + q^\top z
              \quad\text{s.t.}\quad G z \le h,\quad lb \le z \le ub

    Parameters
    ----------
    problem : the program
    backend : one of :func:`clfcbf.available_backends`, or a :class:`Backend`

    Returns
    -------
    The solution. ``x`` is None unless primal, dual and gap residuals, recomputed here, are at
    most :data:`ACCEPTED`; ``INFEASIBLE`` is returned only with a certificate that was checked
    here, ``UNPROVEN`` where the backend claims it without one.

    Raises
    ------
    BackendError : no backend has that name, or it cannot take programs of this shape
    MissingExtraError : the backend's package is not installed
    """
    solver = get_backend(backend) if isinstance(backend, str) else backend
    if not problem.well_posed:
        message = "P, q, G must be finite; h, lb, ub not NaN, and infinite only as no bound"
        return QpSolution(None, QpStatus.INVALID_INPUT, solver.name, message=message)
    limit = solver.capability.max_variables
    if limit is not None and problem.n > limit:
        raise BackendError(
            f"{solver.name!r} takes at most {limit} variables, got {problem.n}; use 'daqp'"
        )
    if not is_convex(problem):
        message = "P is not positive semidefinite"
        return QpSolution(None, QpStatus.INVALID_INPUT, solver.name, message=message)
    if (problem.lb > problem.ub).any():
        message = "a lower bound is above its upper bound"
        return QpSolution(None, QpStatus.INFEASIBLE, solver.name, message=message)
    try:
        claim = solver.solve(problem)
    except (BackendError, MissingExtraError):
        raise
    except Exception as error:  # solvers raise what they please; a tick must get an answer
        message = f"{type(error).__name__}: {error}"
        return QpSolution(None, QpStatus.NUMERICAL_ERROR, solver.name, message=message)
    return judge(problem, claim)


def _infeasibility(problem: QuadraticProgram) -> QpStatus:
    """What a claim that no point is feasible is worth."""
    if proves_infeasible(problem):
        return QpStatus.INFEASIBLE
    if problem.n != 2:
        return QpStatus.UNPROVEN
    # In two dimensions geometry decides, however narrow the gap.
    rows = QuadraticProgram(np.eye(2), np.zeros(2), problem.G, problem.h, problem.lb, problem.ub)
    status = ExactBackend().solve(rows).status
    return status if status is QpStatus.INFEASIBLE else QpStatus.NUMERICAL_ERROR


def judge(problem: QuadraticProgram, claim: QpSolution) -> QpSolution:
    """The claim of a backend after verification: upheld, or without its point."""
    if not claim.status.found or claim.x is None:
        status = claim.status
        if status is QpStatus.INFEASIBLE:
            status = _infeasibility(problem)
        elif status.found:
            status = QpStatus.NUMERICAL_ERROR
        return replace(claim, x=None, status=status, dual=None, dual_bounds=None, residuals=None)
    dual, bounds = claim.dual, claim.dual_bounds
    residuals = verify(problem, claim.x, (dual, bounds))
    usable = dual is not None and bounds is not None and residuals.worst <= ACCEPTED
    if not usable and np.isfinite(residuals.primal):
        # A good point with poor multipliers is still a good point: look for better ones.
        dual, bounds = multipliers_at(problem, claim.x)
        residuals = verify(problem, claim.x, (dual, bounds))
    if not residuals.worst <= ACCEPTED:
        message = f"answer refused, residuals {residuals} (backend said: {claim.message})"
        return QpSolution(
            None, QpStatus.NUMERICAL_ERROR, claim.backend, residuals=residuals, message=message
        )
    return replace(claim, dual=dual, dual_bounds=bounds, residuals=residuals)
