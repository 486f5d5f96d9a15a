"""From a decision to its explanation: multipliers, sides of the box, conflicting rows."""

from __future__ import annotations

from collections.abc import Mapping

from clfcbf.constraints.rows import Row
from clfcbf.decision import Decision
from clfcbf.explain.conflict import NEGLIGIBLE, Conflict, HalfPlane, smallest_conflict
from clfcbf.explain.explanation import Explanation, LimitReport, RowReport
from clfcbf.explain.words import unit_of
from clfcbf.qp.exact import Weight, multipliers, solve_lexicographic
from clfcbf.se2 import Twist, is_finite

__all__ = ["explain"]

_REACHED = 1e-9
"""[m/s and rad/s] How near to a side of the box a command counts as on it: rounding is 1e-12."""

_ANY_WEIGHT: Weight = (1.0, 0.0, 1.0)
"""For the slacks of the levels, which do not depend on the weight."""


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
    held: dict[str, float] = {}
    sides = (0.0,) * 4
    conflict = None
    try:
        exact = solve_lexicographic(decision.weight or _ANY_WEIGHT, nominal, box, levels)
        if exact is not None and decision.weight is not None:
            found = multipliers(decision.weight, nominal, box, levels, exact)
            flat = [name for level in names for name in level]
            held, sides = dict(zip(flat, found.rows, strict=True)), found.box
    except ArithmeticError:  # from numbers near the ends of the floats' range, as of a broken file
        exact = None
    if exact is not None:
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
