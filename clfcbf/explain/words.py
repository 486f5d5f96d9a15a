"""An explanation in words: one sentence, in the terms of the people who read logs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from clfcbf.decision import Phase, Status
from clfcbf.explain.conflict import Conflict, HalfPlane
from clfcbf.explain.findings import Findings, LimitReport, RowReport
from clfcbf.guard import Verdict
from clfcbf.se2 import Twist

__all__ = ["sentence_of", "unit_of"]

_EDGES = {"left": "the camera's left edge", "right": "the camera's right edge"}

_UNITS = {"fov.paper": "rad²", "clf.kanayama": "m²", "clf.strict": "m²"}
"""Of the rows that the library builds; a camera's edges are distances."""

_FAULTS = {
    Status.STALE: "the last measurement is older than the patience",
    Status.NO_TARGET: "the target has not been seen often enough yet",
    Status.INVALID_INPUT: "an input is not finite, or a barrier is undefined there",
    Status.CLOCK_ERROR: "the time did not advance, or a measurement is from the future",
    Status.SOLVER_FAILED: "no answer to the program stood verification",
    Status.INTERNAL_ERROR: "a part raised an exception",
}

_VARIABLES = (("v", "m/s"), ("omega", "rad/s"))


def unit_of(name: str, units: Mapping[str, str] | None = None) -> str:
    """Unit of the barrier value of a row; empty where it is not known."""
    barrier, _, rest = name.partition(".")
    for key in (name, barrier):
        if units is not None and key in units:
            return units[key]
    if barrier == "fov" and rest.partition(".")[0] in _EDGES:
        return "m"
    return _UNITS.get(name, "")


def sentence_of(e: Findings) -> str:
    """The sentence: status and phase, what held or gave way, what was sent."""
    head = e.status.value.capitalize()
    if e.phase is not None:
        head += f" ({e.phase.value})"
    if e.status.is_fault:
        cause = _FAULTS[e.status] if e.conflict is None else _clash(e.conflict)
        if e.reason and (e.phase is Phase.FAILED or e.status is Status.INTERNAL_ERROR):
            cause += f" ({e.reason})"
        return f"{head}: {cause}; {_braked(e)}."
    if e.answer is None:
        return f"{head}: {_without_program(e)}."
    return f"{head}: {_with_program(e)}."


def _without_program(e: Findings) -> str:
    """Ticks of a docking controller that only stand or stop, and those of other controllers."""
    if e.done:
        return f"the task is finished; {_braked(e)}"
    if e.phase is Phase.FAILED:
        return f"{e.reason or 'the task failed'}; {_braked(e)}"
    if e.status is Status.BARRIER_RELAXED and not e.rows:
        return f"the barriers could not all hold; {_show(e.sent)} was sent"
    if e.conflict is not None:
        return f"{_clash(e.conflict)}; {_show(e.sent)} was sent"
    return f"no program was solved; {_show(e.sent)} was sent" + (
        f" ({e.reason})" if e.reason else ""
    )


def _with_program(e: Findings) -> str:
    if e.status is Status.OUT_OF_VIEW:
        outside = [f"{_row(row)} by {_amount(-row.value, row.unit)}" for row in _outside(e)]
        what = f"outside {_list(outside)}" if outside else "a barrier is violated"
        if e.verdict is Verdict.BRAKED:
            return f"{what}; {_braked(e)}"
        return f"{what}; {_show(e.sent)} was sent, which does not make it worse"
    clash = "" if e.conflict is None else _clash(e.conflict)
    if e.status is Status.BRAKING:
        return f"{clash or 'no command that was tried leaves room for a safe stop'}; {_braked(e)}"
    if e.status is Status.GUARDED:
        assert e.answer is not None
        refused = f"a stop from the program's answer {_show(e.answer)} would not stay safe"
        return f"{clash + '; ' if clash else ''}{refused}, so the guard sent {_show(e.sent)}"
    if e.conflict is not None:
        return f"{clash}; {_show(e.sent)} was sent"
    if e.status in (Status.RELAXED, Status.BARRIER_RELAXED):
        slack = e.slack if e.status is Status.RELAXED else e.barrier_slack
        return f"rows gave way by {slack:.3g}; {_show(e.sent)} was sent"
    if e.sent == e.nominal:
        return f"the nominal command {_show(e.sent)} was sent as it is"
    holding = [_row(row) for row in e.active_rows] + [_limit(limit) for limit in e.active_limits]
    return (
        f"{_list(holding) or 'the program'} held the nominal command {_show(e.nominal)} "
        f"back to {_show(e.sent)}"
    )


def _clash(conflict: Conflict) -> str:
    """What the members ask for, and what is missing."""
    soft, hard = conflict.soft, conflict.hard
    if len(conflict.members) == 1:
        lacking = conflict.shortfalls[soft[0].name]
        return f"no command satisfies {_row(soft[0])}: short by {lacking:.3g}"
    if len(soft) == 1 and all(_is_side(member) for member in hard):
        return _demand(soft[0], hard, conflict.short)
    names = _list([_row(member) for member in soft])
    short = f"short by {conflict.short:.3g} in the plane of (v, omega)"
    if not hard:
        return f"{names} exclude each other: {short}"
    against = _list([_limit(m) if _is_side(m) else _row(m) for m in hard])
    return f"{names} had to give way to {against}: {short}"


def _demand(plane: HalfPlane, sides: Sequence[HalfPlane], short: float) -> str:
    """A row against one or two sides of the box, in terms of the input that it acts on most."""
    row = plane.row
    first = max(sides, key=lambda side: abs(row[_input(side)]))
    index = _input(first)
    allowed = _bound(first)
    symbol, unit = _VARIABLES[index]
    rest, where = row[2], ""
    for side in sides:
        if side is not first:
            other = _VARIABLES[_input(side)]
            rest -= row[_input(side)] * _bound(side)
            where = f" even at {other[0]} = {_bound(side):.3g} {other[1]}"
            if _limit_words(side) != _limit_words(first):
                where += f" (all that {_limit_words(side)} allows)"
    needed = rest / row[index]
    lacking = short * math.hypot(row[0], row[1]) / abs(row[index])
    need, allow = _apart(needed, allowed)
    more = row[index] < 0.0
    return (
        f"{_row(plane)} needs {symbol} {'>=' if more else '<='} {need} {unit}{where}, but "
        f"{_limit_words(first)} allows at {'most' if more else 'least'} {allow}: "
        f"short by {lacking:.3g} {unit}"
    )


def _apart(one: float, other: float) -> tuple[str, str]:
    """Two different numbers with as few digits as tell them apart, three at least."""
    for digits in range(3, 17):
        shown = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if shown[0] != shown[1]:
            return shown
    return f"{one!r}", f"{other!r}"


def _is_side(plane: HalfPlane) -> bool:
    return plane.name.startswith(("v lower", "v upper", "omega lower", "omega upper"))


def _input(side: HalfPlane) -> int:
    return 0 if side.row[0] else 1


def _bound(side: HalfPlane) -> float:
    a, c, b = side.row
    return b / (a + c)


def _limit_words(side: HalfPlane) -> str:
    if "acceleration" in side.name:
        return "the acceleration limit"
    if "speed" in side.name:
        return "the turn-rate limit" if _input(side) else "the speed limit"
    return "the limit"


def _limit(limit: HalfPlane | LimitReport) -> str:
    return f"the limit {limit.name}"


def _row(row: HalfPlane | RowReport) -> str:
    barrier, _, rest = row.name.partition(".")
    side, _, end = rest.partition(".")
    if barrier == "fov" and side in _EDGES:
        at = {"left_end": " at the feature's left end", "right_end": " at its right end"}
        return f"{_EDGES[side]}{at.get(end, '')} ({row.name})"
    if barrier == "clf":
        return f"the Lyapunov row ({row.name})"
    return f"row {row.name}"


def _outside(e: Findings) -> list[RowReport]:
    return [row for row in e.rows if row.value < 0.0 and row.name.partition(".")[0] != "clf"]


def _amount(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".rstrip()


def _show(twist: Twist) -> str:
    v, omega = twist[0] + 0.0, twist[1] + 0.0  # a zero without its sign
    return f"v = {v:.3g} m/s, omega = {omega:.3g} rad/s"


def _braked(e: Findings) -> str:
    if e.sent == (0.0, 0.0):
        return "the robot is told to stand"
    kind = "the certified brake" if e.certified else "a brake without a certificate,"
    return f"{kind} {_show(e.sent)} was sent"


def _list(parts: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))
