"""One line that says whether a backend, a user's own included, keeps the contract.

>>> from clfcbf.qp.conformance import check_backend
>>> check_backend("exact", count=3).passed
True
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clfcbf.errors import BackendError
from clfcbf.qp.backends import Backend, Capability, get_backend
from clfcbf.qp.conformance_families import Case, cases
from clfcbf.qp.health import CORRECTED
from clfcbf.qp.problem import QuadraticProgram
from clfcbf.qp.solve import solve_qp
from clfcbf.qp.verify import is_convex

__all__ = [
    "TOLERANCE",
    "Case",
    "ConformanceReport",
    "Failure",
    "FamilyResult",
    "cases",
    "check_backend",
    "check_case",
]

TOLERANCE = 1e-6
"""Largest error of an answer, relative to the size of the variables: what a command is worth."""


class FamilyResult(NamedTuple):
    """What became of one family of programs.

    Attributes
    ----------
    family : its name
    programs : how many
    agreed : of them answered as expected
    declined : refused with a BackendError that the capability announces
    failed : neither
    refused : points the solver gave that did not stand verification, whatever came of it
    corrected : points that the polish put right, see :attr:`clfcbf.qp.QpSolution.moved`
    worst_error : of the answers that agreed, relative to the size of the variables
    """

    family: str
    programs: int = 0
    agreed: int = 0
    declined: int = 0
    failed: int = 0
    refused: int = 0
    corrected: int = 0
    worst_error: float = 0.0


class Failure(NamedTuple):
    """A case that failed, and how."""

    case: Case
    reason: str

    @property
    def data(self) -> dict[str, list[object]]:
        """The program as nested lists of numbers, by the names of its arguments."""
        problem = self.case.problem
        return {
            name: getattr(problem, name).tolist()
            for name in ("P", "q", "G", "h", "lb", "ub", "A", "b")
        }


class ConformanceReport(NamedTuple):
    """What :func:`check_backend` found.

    Attributes
    ----------
    backend : its name
    families : results, family by family
    first_failure : the first case that failed, or None
    """

    backend: str
    families: tuple[FamilyResult, ...]
    first_failure: Failure | None

    @property
    def passed(self) -> bool:
        """Whether nothing failed, and not everything was declined."""
        return self.first_failure is None and any(result.agreed for result in self.families)

    @property
    def worst_error(self) -> float:
        """The largest of all families."""
        return max((result.worst_error for result in self.families), default=0.0)

    def family(self, name: str) -> FamilyResult:
        """The result of one family."""
        return next(result for result in self.families if result.family == name)

    def __str__(self) -> str:
        lines = [
            f"{self.backend}: {'passed' if self.passed else 'FAILED'}",
            f"{'family':22}{'programs':>9}{'agreed':>8}{'declined':>9}{'failed':>7}"
            f"{'refused':>8}{'corrected':>10}{'worst error':>13}",
        ]
        lines += [
            f"{r.family:22}{r.programs:9}{r.agreed:8}{r.declined:9}{r.failed:7}{r.refused:8}"
            f"{r.corrected:10}{r.worst_error:13.1e}"
            for r in self.families
        ]
        if self.first_failure is not None:
            lines.append(f"first failure, {self.first_failure.case}: {self.first_failure.reason}")
            lines += [f"  {name} = {value}" for name, value in self.first_failure.data.items()]
        return "\n".join(lines)


class _Outcome(NamedTuple):
    """Of one case: why it failed (empty where it did not), and what else is counted."""

    failure: str
    declined: bool = False
    refused: bool = False
    corrected: bool = False
    error: float = 0.0


def check_backend(
    backend: str | Backend, seed: int = 0, count: int = 20, families: tuple[str, ...] = ()
) -> ConformanceReport:
    """Put a backend through every family of programs.

    Parameters
    ----------
    backend : a name, or any object with the :class:`Backend` protocol
    seed : of the programs
    count : programs a family; 20 take a fast backend 0.2 s and IPOPT 2 s
    families : names of those to run; all if none is given

    Returns
    -------
    The report: print it, or assert its ``passed``

    Raises
    ------
    BackendError : no backend has that name
    MissingExtraError : its package is not installed
    """
    solver = get_backend(backend)
    results: dict[str, FamilyResult] = {}
    first: Failure | None = None
    for case in cases(seed, count, families):
        outcome = _try(solver, case)
        r = results.setdefault(case.family, FamilyResult(case.family))
        results[case.family] = FamilyResult(
            r.family,
            r.programs + 1,
            r.agreed + (not outcome.failure and not outcome.declined),
            r.declined + outcome.declined,
            r.failed + bool(outcome.failure),
            r.refused + outcome.refused,
            r.corrected + outcome.corrected,
            max(r.worst_error, outcome.error),
        )
        if outcome.failure and first is None:
            first = Failure(case, outcome.failure)
    return ConformanceReport(solver.name, tuple(results.values()), first)


def check_case(backend: str | Backend, case: Case) -> None:
    """One case as a test: ``@pytest.mark.parametrize("case", cases(), ids=str)``.

    Raises
    ------
    AssertionError : the backend fails the case
    """
    outcome = _try(get_backend(backend), case)
    if outcome.failure:
        raise AssertionError(f"{case}: {outcome.failure}; {Failure(case, '').data}")


def _may_decline(capability: Capability, problem: QuadraticProgram) -> bool:
    limit = capability.max_variables
    return (
        (limit is not None and problem.n > limit)
        or (problem.p > 0 and not capability.equalities)
        or (not capability.semidefinite and not is_convex(problem, strictly=True))
    )


def _try(solver: Backend, case: Case) -> _Outcome:
    problem = case.problem
    try:
        answer = solve_qp(problem, solver, fallback=())
    except BackendError as reason:
        if _may_decline(solver.capability, problem):
            return _Outcome("", declined=True)
        return _Outcome(f"declined without reason: {reason}")
    refused = any(attempt.refused for attempt in answer.attempts)
    if answer.status not in case.expected:
        wanted = " or ".join(status.value for status in case.expected)
        failure = f"expected {wanted}, got {answer.status.value} ({answer.message})"
        return _Outcome(failure, refused=refused)
    if case.x is None:
        failure = "" if answer.x is None else "x is filled without an answer"
        return _Outcome(failure, refused=refused)
    if answer.x is None:
        return _Outcome("x is missing")
    error = float(np.abs(answer.x - case.x).max() / case.size)
    if not error <= TOLERANCE:
        return _Outcome(f"error {error:.1e}: x = {answer.x.tolist()}, not {case.x.tolist()}")
    return _Outcome("", refused=refused, corrected=answer.moved > CORRECTED, error=error)
