"""One call for every backend, and no answer that was not verified."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clfcbf.errors import BackendError, ConfigurationError, MissingExtraError
from clfcbf.qp.backends import Backend, get_backend
from clfcbf.qp.backends.exact import ExactBackend
from clfcbf.qp.certificates import proves_infeasible, proves_unbounded
from clfcbf.qp.health import SolverHealth
from clfcbf.qp.problem import Attempt, QpSolution, QpStatus, QuadraticProgram
from clfcbf.qp.verify import Duals, is_convex, multipliers_at, verify

__all__ = ["ACCEPTED", "FALLBACK", "judge", "solve_qp"]

ACCEPTED = 1e-7
"""Largest scaled residual of an accepted answer: a tenth of the 1e-6 asked of a command."""

FALLBACK = ("exact", "daqp", "clarabel")
"""Who is asked next where a backend fails: no rounding, then an active set, then the one solver
that was never seen to claim a wrong answer."""

_SETTLED = frozenset({QpStatus.OPTIMAL, QpStatus.RELAXED, QpStatus.INFEASIBLE, QpStatus.UNBOUNDED})
"""Statuses that were proved here: nobody else need be asked."""


def solve_qp(
    problem: QuadraticProgram,
    backend: str | Backend = "exact",
    *,
    fallback: Sequence[str] = FALLBACK,
    time_limit: float | None = None,
    health: SolverHealth | None = None,
) -> QpSolution:
    r"""Solve a convex quadratic program and verify what comes back.

    .. math:: \min_z\ \tfrac12 z^\top P z + q^\top z
              \quad\text{s.t.}\quad G z \le h,\quad A z = b,\quad lb \le z \le ub

    Parameters
    ----------
    problem : the program
    backend : one of :func:`clfcbf.available_backends`, or a :class:`Backend`
    fallback : names asked in turn until one settles the program; those that are not installed or
        cannot take it are passed over, and with ``()`` nobody else is asked
    time_limit : for each backend that keeps one [s]
    health : counts what each backend's answers were worth

    Returns
    -------
    The solution. ``x`` is None unless primal, dual and gap residuals, recomputed here, are at
    most :data:`ACCEPTED`; ``INFEASIBLE`` and ``UNBOUNDED`` are returned only with a certificate
    that was checked here, ``UNPROVEN`` where a backend claims infeasibility without one.
    ``attempts`` lists who was asked; where all fail, the status is that of ``backend``.

    Raises
    ------
    BackendError : no backend has that name, or it cannot take programs of this kind
    ConfigurationError : the time limit is not finite and positive
    MissingExtraError : the backend's package is not installed
    """
    solver = get_backend(backend)
    if time_limit is not None and not 0.0 < time_limit < np.inf:
        raise ConfigurationError(f"time_limit must be finite and positive [s], got {time_limit!r}")
    refusal = _refusal(solver, problem, time_limit)
    if refusal is not None:
        return QpSolution(None, refusal[0], solver.name, message=refusal[1])
    first = solution = _attempt(solver, problem, time_limit)
    attempts = solution.attempts
    for name in fallback:
        if solution.status in _SETTLED:
            break
        if name in (attempt.backend for attempt in attempts):
            continue
        try:
            other = get_backend(name)
            limit = time_limit if other.capability.time_limit else None
            if _refusal(other, problem, limit) is not None:
                continue
            solution = _attempt(other, problem, limit)
        except (BackendError, MissingExtraError):
            continue
        attempts += solution.attempts
    if solution.status not in _SETTLED:
        solution = first
    if health is not None:
        health.record(attempts)
    return replace(solution, attempts=attempts)


def _refusal(
    solver: Backend, problem: QuadraticProgram, time_limit: float | None
) -> tuple[QpStatus, str] | None:
    """Why the program needs no solver; raises BackendError where this one cannot take it."""
    if not problem.well_posed:
        message = "P, q, G, A, b must be finite; h, lb, ub not NaN, and infinite only as no bound"
        return QpStatus.INVALID_INPUT, message
    solver.capability.check(solver.name, problem, time_limit)
    if (problem.lb > problem.ub).any():
        return QpStatus.INFEASIBLE, "a lower bound is above its upper bound"
    if not is_convex(problem, strictly=True):
        if not is_convex(problem):
            return QpStatus.INVALID_INPUT, "P is not positive semidefinite"
        # No solver is good at telling this, and some never return.
        if proves_unbounded(problem):
            if proves_infeasible(problem):
                return QpStatus.INFEASIBLE, "no point satisfies the rows"
            return QpStatus.UNBOUNDED, "the cost falls without end along a direction"
    return None


def _attempt(solver: Backend, problem: QuadraticProgram, time_limit: float | None) -> QpSolution:
    """Ask one backend and judge its answer, whatever it does."""
    begun = time.perf_counter()
    refused = False
    try:
        if time_limit is None:
            claim = solver.solve(problem)
        else:
            claim = solver.solve(problem, time_limit)
        solution = judge(problem, claim)
        refused = claim.status.found and not solution.status.found
    except (BackendError, MissingExtraError):
        raise
    except Exception as error:  # solvers raise what they please; a tick must get an answer
        message = f"{type(error).__name__}: {error}"
        status = _unanswered(problem, QpStatus.NUMERICAL_ERROR)
        solution = QpSolution(None, status, solver.name, message=message)
    seconds = time.perf_counter() - begun
    attempt = Attempt(
        solver.name, solution.status, seconds, solution.message, refused, solution.moved
    )
    return replace(solution, attempts=(attempt,))


def _unanswered(problem: QuadraticProgram, status: QpStatus) -> QpStatus:
    """What is known of a program without an answer; only what was proved here is passed on."""
    if proves_infeasible(problem):
        return QpStatus.INFEASIBLE
    if status is QpStatus.UNBOUNDED or status.found:
        # What is unbounded was proved before a solver was asked.
        return QpStatus.NUMERICAL_ERROR
    if problem.n == 2:
        # In two dimensions geometry decides, however narrow the gap.
        known = ExactBackend().solve(_nearest_to_zero(problem)).status
        if known is QpStatus.INFEASIBLE:
            return known
        return QpStatus.NUMERICAL_ERROR if status is QpStatus.INFEASIBLE else status
    return QpStatus.UNPROVEN if status is QpStatus.INFEASIBLE else status


def _nearest_to_zero(problem: QuadraticProgram) -> QuadraticProgram:
    """The rows and bounds of a program with :math:`|z|^2/2` as its cost."""
    n = problem.n
    rows = problem.G, problem.h, problem.lb, problem.ub, problem.A, problem.b
    return QuadraticProgram(np.eye(n), np.zeros(n), *rows)


def judge(problem: QuadraticProgram, claim: QpSolution) -> QpSolution:
    """The claim of a backend after verification: upheld, or without its point."""
    if not claim.status.found or claim.x is None:
        status = _unanswered(problem, claim.status)
        return QpSolution(None, status, claim.backend, message=claim.message)
    x = np.array(claim.x, dtype=np.float64)
    duals = Duals(claim.dual, claim.dual_bounds, claim.dual_equalities)
    residuals = verify(problem, x, duals)
    if not residuals.worst <= ACCEPTED and np.isfinite(residuals.primal):
        # A good point with poor multipliers is still a good point: look for better ones.
        duals = multipliers_at(problem, x)
        residuals = verify(problem, x, duals)
    if not residuals.worst <= ACCEPTED:
        message = f"answer refused, residuals {residuals} (backend said: {claim.message})"
        return QpSolution(
            None,
            _unanswered(problem, claim.status),
            claim.backend,
            residuals=residuals,
            message=message,
        )
    return replace(
        claim,
        x=x,
        dual=duals.rows,
        dual_bounds=duals.bounds,
        dual_equalities=np.zeros(0) if duals.equalities is None else duals.equalities,
        residuals=residuals,
    )
