"""What is to be said about a tick, as data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from clfcbf.constraints.rows import Row
from clfcbf.decision import Decision, Phase, Status
from clfcbf.explain.conflict import NEGLIGIBLE, Conflict, HalfPlane, smallest_conflict
from clfcbf.explain.words import sentence_of, unit_of
from clfcbf.guard import Verdict
from clfcbf.qp.exact import BackendHealth, Weight, multipliers, solve_lexicographic
from clfcbf.se2 import Twist, is_finite

__all__ = ["Explanation", "LimitReport", "RowReport", "explain"]

_REACHED = 1e-9
"""[m/s and rad/s] How near to a side of the box a command counts as on it: rounding is 1e-12."""

_ANY_WEIGHT: Weight = (1.0, 0.0, 1.0)
"""For the slacks of the levels, which do not depend on the weight."""


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
            "active": [part.name for part in (*self.active_rows, *self.active_limits)],
            "rows": [_record(row) for row in self.rows],
            "limits": [_record(limit) for limit in self.limits],
            "slack": _number(self.slack),
            "barrier_slack": _number(self.barrier_slack),
            "conflict": conflict,
            "backend": None if self.backend is None else _record(self.backend),
        }


def explain(decision: Decision, units: Mapping[str, str] | None = None) -> Explanation:
    r"""Explain a tick of any controller.

    The multipliers are those of the program at its exact answer,
    :math:`Q(u_{nom} - u) = \sum_i \lambda_i a_i`, :math:`\lambda \ge 0`; where a level of rows
    could not hold, of the program that its slack leaves.

    Parameters
    ----------
    decision : of a filter or controller, or from :func:`decision_from_json`
    units : units of barrier values by name of the row or of its barrier, the part of the name
        before the first dot, such as ``{"gap": "m"}``; those of the library are known

    Notes
    -----
    A decision without its ``weight`` has no multipliers (all 0), one without rows that are
    finite no conflict.
    """
    names, levels = _levels(decision)
    box, nominal = decision.box, decision.nominal
    exact = solve_lexicographic(decision.weight or _ANY_WEIGHT, nominal, box, levels)
    held: dict[str, float] = {}
    sides = (0.0,) * 4
    conflict = None
    if exact is not None:
        if decision.weight is not None:
            found = multipliers(decision.weight, nominal, box, levels, exact)
            flat = [name for level in names for name in level]
            held, sides = dict(zip(flat, found.rows, strict=True)), found.box
        conflict = _conflict(decision, names, levels, exact.slacks, exact.violated)
    margins = decision.margins
    rows = tuple(
        RowReport(
            name, int(block.priority), value, unit_of(name, units), margins[name],
            held.get(name, 0.0),
        )
        for block in decision.rows
        for name, value in zip(block.names, block.values, strict=True)
    )  # fmt: skip
    answer = decision.answer
    return Explanation(
        status=decision.status,
        phase=decision.phase,
        reason=decision.reason,
        done=decision.done,
        certified=decision.certified,
        clearance=decision.clearance,
        nominal=nominal,
        answer=None if answer is None else Twist(answer.v, answer.omega),
        sent=decision.twist,
        verdict=decision.verdict,
        rows=rows,
        limits=_limits(decision, sides),
        slack=decision.slack,
        barrier_slack=decision.barrier_slack,
        conflict=conflict,
        backend=None if answer is None else answer.health,
    )


def _levels(decision: Decision) -> tuple[list[list[str]], list[list[Row]]]:
    """Names and rows by priority, most important level first."""
    priorities = sorted({block.priority for block in decision.rows})
    names: list[list[str]] = [[] for _ in priorities]
    levels: list[list[Row]] = [[] for _ in priorities]
    for block in decision.rows:
        level = priorities.index(block.priority)
        names[level] += block.names
        levels[level] += block.coefficients
    return names, levels


_SIDES = ("v lower", "v upper", "omega lower", "omega upper")
_NORMALS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))


def _cause(decision: Decision, side: int) -> str:
    """Which limit put a side of the box where it is; the speed limit where both did."""
    limits = decision.limits
    if limits is None:
        return ""
    speeds = (limits.reverse_speed, limits.v_max, -limits.omega_max, limits.omega_max)
    return "speed" if decision.box[side] == speeds[side] else "acceleration"


def _side_name(decision: Decision, side: int) -> str:
    cause = _cause(decision, side)
    return f"{_SIDES[side]} ({cause})" if cause else _SIDES[side]


def _limits(decision: Decision, held: tuple[float, ...]) -> tuple[LimitReport, ...]:
    return tuple(
        LimitReport(
            _side_name(decision, side),
            decision.box[side],
            _cause(decision, side),
            held[side],
            abs(decision.twist[side // 2] - decision.box[side]) <= _REACHED,
        )
        for side in range(4)
    )


def _conflict(
    decision: Decision,
    names: list[list[str]],
    levels: list[list[Row]],
    slacks: tuple[float, ...],
    violated: tuple[int, ...],
) -> Conflict | None:
    """Of the first level that gave way; what is above it holds, what is below has no say."""
    planes = [
        HalfPlane(_side_name(decision, side), (a, c, bound if a + c > 0.0 else -bound), False)
        for side, ((a, c), bound) in enumerate(zip(_NORMALS, decision.box, strict=True))
    ]
    first = 0
    for name, rows, slack in zip(names, levels, slacks, strict=True):
        gave_way = slack > NEGLIGIBLE or any(first <= i < first + len(rows) for i in violated)
        planes += [
            HalfPlane(n, row, gave_way) for n, row in zip(name, rows, strict=True) if is_finite(row)
        ]
        if gave_way:
            return smallest_conflict(planes)
        first += len(rows)
    return None


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _twist(twist: Twist) -> dict[str, float | None]:
    return {"v": _number(twist[0]), "omega": _number(twist[1])}


def _record(record: RowReport | LimitReport | BackendHealth) -> dict[str, Any]:
    return {
        key: _number(value) if isinstance(value, float) else value
        for key, value in record._asdict().items()
    }
