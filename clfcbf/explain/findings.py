"""What there is to say about a tick: its rows, its limits, and what became of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from clfcbf.decision import Phase, Status
from clfcbf.explain.conflict import Conflict
from clfcbf.guard import Verdict
from clfcbf.qp.exact import BackendHealth
from clfcbf.se2 import Twist

__all__ = ["Findings", "LimitReport", "RowReport"]


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
class Findings:
    """Why a tick sent what it sent, as data.

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
