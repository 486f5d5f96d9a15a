"""What is to be said about a tick, as data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from clfcbf.decision import Phase, Status
from clfcbf.explain.conflict import Conflict
from clfcbf.explain.words import sentence_of
from clfcbf.guard import Verdict
from clfcbf.qp.exact import BackendHealth
from clfcbf.se2 import Twist

__all__ = ["Explanation", "LimitReport", "RowReport"]


class RowReport(NamedTuple):
    """One row of the tick.

    Attributes
    ----------
    name : such as ``"fov.right"``
    priority : its level; smaller is kept longer
    value : of the barrier or Lyapunov function behind it
    unit : of ``value``; the margin has the same per second. Empty where it is not known
    margin : what the row has to spare at the command sent; negative where it gave way
    multiplier : how hard it holds the program's answer; 0 where it does not
    """

    name: str
    priority: int
    value: float
    unit: str
    margin: float
    multiplier: float


class LimitReport(NamedTuple):
    """One side of the input box.

    Attributes
    ----------
    name : such as ``"omega upper (acceleration)"``
    bound : where it is [m/s or rad/s]
    cause : ``"speed"`` or ``"acceleration"``; empty where the limits are not known
    multiplier : how hard it holds the program's answer; 0 where it does not
    reached : whether the command sent is on it
    """

    name: str
    bound: float
    cause: str
    multiplier: float
    reached: bool


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why a tick sent what it sent; ``str()`` is one sentence.

    Attributes
    ----------
    status, phase, reason, done, certified, clearance : as in the :class:`Decision`
    nominal : what the law asked for
    answer : what the program made of it; None where there was no program
    sent : what the guard let through
    verdict : of the guard; None where it was not asked
    rows, limits : rows and sides of the box, in the order of the tick
    slack, barrier_slack : by how much Lyapunov and barrier rows gave way, per unit-norm row
    conflict : where rows had to give way, a smallest set of rows and limits that exclude each
        other, of the most important level concerned
    backend : what the backend's answer was worth; None for the exact one
    """

    status: Status
    phase: Phase | None
    reason: str
    done: bool
    certified: bool
    clearance: float
    nominal: Twist
    answer: Twist | None
    sent: Twist
    verdict: Verdict | None
    rows: tuple[RowReport, ...]
    limits: tuple[LimitReport, ...]
    slack: float
    barrier_slack: float
    conflict: Conflict | None
    backend: BackendHealth | None

    @property
    def active_rows(self) -> tuple[RowReport, ...]:
        """The rows that hold the program's answer where it is."""
        return tuple(row for row in self.rows if row.multiplier > 0.0)

    @property
    def active_limits(self) -> tuple[LimitReport, ...]:
        """The sides of the box that hold the program's answer where it is."""
        return tuple(limit for limit in self.limits if limit.multiplier > 0.0)

    def sentence(self) -> str:
        """All of it in one sentence."""
        return sentence_of(self)

    def __str__(self) -> str:
        return self.sentence()

    def to_dict(self) -> dict[str, Any]:
        """For JSON: numbers that are not finite become None."""
        conflict = None
        if self.conflict is not None:
            conflict = {
                "members": [member.name for member in self.conflict.members],
                "gave_way": [member.name for member in self.conflict.soft],
                "short": _number(self.conflict.short),
                "short_by": {n: _number(x) for n, x in self.conflict.shortfalls.items()},
            }
        return {
            "sentence": self.sentence(),
            "status": self.status.value,
            "phase": None if self.phase is None else self.phase.value,
            "reason": self.reason,
            "done": self.done,
            "certified": self.certified,
            "clearance": _number(self.clearance),
            "nominal": _twist(self.nominal),
            "answer": None if self.answer is None else _twist(self.answer),
            "sent": _twist(self.sent),
            "guard": None if self.verdict is None else self.verdict.value,
            "active": [row.name for row in self.active_rows]
            + [limit.name for limit in self.active_limits],
            "rows": [_record(row) for row in self.rows],
            "limits": [_record(limit) for limit in self.limits],
            "slack": _number(self.slack),
            "barrier_slack": _number(self.barrier_slack),
            "conflict": conflict,
            "backend": None if self.backend is None else _record(self.backend),
        }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _twist(twist: Twist) -> dict[str, float | None]:
    return {"v": _number(twist[0]), "omega": _number(twist[1])}


def _record(record: RowReport | LimitReport | BackendHealth) -> dict[str, Any]:
    return {
        key: _number(value) if isinstance(value, float) else value
        for key, value in record._asdict().items()
    }
