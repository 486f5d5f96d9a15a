"""Counts of what backends' answers were worth, in an object of the caller's own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from clfcbf.qp.lexicographic import BackendHealth
from clfcbf.qp.problem import Attempt, QpStatus

__all__ = ["CORRECTED", "Counts", "SolverHealth"]

CORRECTED = 1e-6
"""Scaled change by the polish from which on a solver's own answer counts as wrong."""

_PROVED = frozenset({QpStatus.OPTIMAL, QpStatus.RELAXED, QpStatus.INFEASIBLE, QpStatus.UNBOUNDED})


@dataclass(slots=True)
class Counts:
    """Of one backend.

    Attributes
    ----------
    asked : programs put to it
    used : answers, or proofs that there is none, that were passed on
    corrected : of those used, the ones that the polish had to move by over :data:`CORRECTED`
    refused : answers that did not stand verification
    failed : programs it gave no answer to, an exception included
    slowest : longest time it took [s]
    """

    asked: int = 0
    used: int = 0
    corrected: int = 0
    refused: int = 0
    failed: int = 0
    slowest: float = 0.0


@dataclass(slots=True)
class SolverHealth:
    """Tally over many solves; hand it to :func:`clfcbf.solve_qp`, or record decisions with it.

    Attributes
    ----------
    backends : counts by name, in the order of first use
    fallbacks : programs that someone other than the backend named had to settle
    unsettled : programs that nobody settled
    """

    backends: dict[str, Counts] = field(default_factory=dict)
    fallbacks: int = 0
    unsettled: int = 0

    def record(self, attempts: Iterable[Attempt]) -> None:
        """Count the attempts at one program, the last of them the one that settled it if any."""
        status: QpStatus | None = None
        tries = 0
        for attempt in attempts:
            status = attempt.status
            tries += 1
            counts = self.backends.setdefault(attempt.backend, Counts())
            counts.asked += 1
            counts.slowest = max(counts.slowest, attempt.seconds)
            if status in _PROVED:
                counts.used += 1
                counts.corrected += attempt.moved > CORRECTED
            elif attempt.refused:
                counts.refused += 1
            else:
                counts.failed += 1
        if status is not None and status not in _PROVED:
            self.unsettled += 1
        elif tries > 1:
            self.fallbacks += 1

    def record_tick(self, health: BackendHealth | None) -> None:
        """Count a tick's last step, ``decision.answer.health``; None where 'exact' took it."""
        if health is None:
            return
        counts = self.backends.setdefault(health.backend, Counts())
        counts.asked += 1
        if health.used:
            counts.used += 1
            return
        self.fallbacks += 1
        if health.refused:
            counts.refused += 1
        else:
            counts.failed += 1

    def __str__(self) -> str:
        lines = [
            f"{name}: {c.asked} asked, {c.used} used, {c.corrected} corrected, "
            f"{c.refused} refused, {c.failed} failed, slowest {1e3 * c.slowest:.3g} ms"
            for name, c in self.backends.items()
        ]
        lines.append(f"{self.fallbacks} by a fallback, {self.unsettled} unsettled")
        return "\n".join(lines)
