r"""One tick from a nominal command to the closest safe one.

Rows, program, verification, guard, in this order:

.. math::

    \min_u \tfrac12 \|u - u_{nom}\|_Q^2 \quad\text{s.t.}\quad
    u \in \text{box},\quad \dot h_i(u) \ge -\lambda_i h_i,\quad \dot V(u) \le -\sigma W

with limits never given up, barriers before the Lyapunov row, and that before the nominal
command. Then the guard asks for more than rows can promise: that a stop from the command stays
safe. What the tick remembers is one value that goes in and comes out, so a run can be replayed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.constraints.barrier import Barrier
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.decision import Decision, Status
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.estimation import DeadReckoning, advance, motion_since
from clfcbf.guard import ROUNDING, Brake, Guard, Guarded, Verdict
from clfcbf.limits import InputBox, Limits, check_period
from clfcbf.qp import Backend, check_weight, get_backend, solve_ladder
from clfcbf.qp.exact import LexicographicSolution
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist

__all__ = [
    "Begun",
    "FilterConfig",
    "FilterState",
    "begin",
    "failed",
    "finish",
    "motion_to_now",
    "stop",
]

_new = tuple.__new__  # makes a named tuple in half the time of its own constructor
_ORIGIN = Pose2(0.0, 0.0, 0.0)
_REST = Twist(0.0, 0.0)

_STABILITY = Priority.STABILITY
_ADMITTED, _BRAKED, _REPLACED = Verdict.ADMITTED, Verdict.BRAKED, Verdict.REPLACED
_OPTIMAL, _CLOCK_ERROR = Status.OPTIMAL, Status.CLOCK_ERROR

_LATE = 1.5
"""Periods after which the last command counts as held for too long."""

_LATEST = 1e15
"""[s] No clock shows more: 30 million years. Differences of such times are still finite."""

_ABSURD = 1e2
"""[m/s, rad/s] So far beyond the limits a command in force is a wrong unit or worse: the answer
still moves from it at the acceleration limit, but the robot is not believed to follow it."""

TOLERANCE = 1e-9
"""Rounding allowed when an answer is verified [m/s and rad/s]."""


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """Everything fixed about the filter.

    Attributes
    ----------
    limits, period : of the chassis; commands are judged against them at this period [s]
    barriers : what must not be violated
    backend : the QP backend, by name or a :class:`clfcbf.qp.Backend` of your own
    weight : (q11, q12, q22) of the distance to the nominal command, positive definite
    lag : first-order lag of the body, for the prediction [s]
    guard_lag : longest lag the guard covers [s]; not below ``lag``
    patience : longest age of the scene that is still acted on [s]
    guard : made of the above

    Raises
    ------
    ConfigurationError : a duration is negative or not finite, the weight is not positive
        definite, or ``guard_lag < lag``
    BackendError : the backend is unknown
    """

    limits: Limits
    barriers: tuple[Barrier, ...]
    period: float
    backend: str | Backend = "exact"
    weight: tuple[float, float, float] = defaults.QP_WEIGHT
    lag: float = 0.0
    guard_lag: float = defaults.GUARD_LAG
    patience: float = defaults.PATIENCE
    guard: Guard = field(init=False)

    def __post_init__(self) -> None:
        check_period(self.period)
        check_weight(self.weight)
        get_backend(self.backend)
        for name in ("lag", "guard_lag", "patience"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigurationError(f"{name} must be finite and at least 0 s, got {value!r}")
        for barrier in self.barriers:
            if not isinstance(barrier, Barrier):
                raise ConfigurationError(
                    f"not a barrier: {barrier!r}; it needs name, rows, clearance, "
                    "clearance_along and clearance_around, see clfcbf.Barrier"
                )
        names = [barrier.name for barrier in self.barriers]
        if len(set(names)) < len(names):
            raise ConfigurationError(f"each barrier needs a name of its own, got {names!r}")
        if self.guard_lag < self.lag:
            raise ConfigurationError(
                f"guard_lag must cover lag: got guard_lag={self.guard_lag!r} < lag={self.lag!r}"
            )
        guard = Guard(self.limits, self.barriers, self.period, self.guard_lag)
        object.__setattr__(self, "guard", guard)


class FilterState(NamedTuple):
    """What a tick leaves to the next: motion so far, certified brake, command last sent."""

    reckoning: DeadReckoning | None = None
    brake: Brake = Brake(_REST, 0, True)
    sent: Twist = _REST


class Begun(NamedTuple):
    """A tick's start: the command in force, what can be reached from it, and the motion so far.

    ``fault`` is set where an input was not usable; the tick then ends in a brake. ``late`` says
    that the last command was held for longer than the period, so nothing is certified now.
    ``since`` is when the tick began on the machine's own clock [s], None where nobody asks how
    long it takes.
    """

    applied: Twist
    box: InputBox
    reckoning: DeadReckoning
    brake: Brake
    fault: Status | None
    late: bool
    since: float | None = None


def begin(
    config: FilterConfig,
    state: FilterState,
    applied: Twist,
    now: float,
    since: float | None = None,
) -> Begun:
    """Check command and clock, and bring the dead reckoning to ``now``.

    A command that is not finite is replaced by the one last sent. A clock that stands still
    keeps the reckoning; one that jumps back restarts it where the robot is.
    """
    limits, period = config.limits, config.period
    reckoning, brake, sent = state
    fault: Status | None = None
    try:
        v, omega = applied
        total = abs(v) + abs(omega)
        known = total < math.inf
    except (TypeError, ValueError):  # whatever a chassis reports, a command must go out
        known, total = False, math.inf
    if not known:
        applied, fault = sent, Status.INVALID_INPUT
    if type(applied) is not Twist:
        applied = Twist(*applied)
    followed = applied
    if total > _ABSURD and not limits.contains(applied, _ABSURD):
        followed, fault = sent, Status.INVALID_INPUT
    ticking = isinstance(now, (int, float)) and -_LATEST < now < _LATEST
    late = False
    if reckoning is None:
        reckoning = DeadReckoning(now if ticking else 0.0, _ORIGIN, followed)
        fault = fault if ticking else Status.CLOCK_ERROR
    elif ticking and now > reckoning.time:
        late = not now - reckoning.time < _LATE * period
        reckoning = advance(reckoning, followed, now, config.lag, config.patience)
    else:
        late = not (ticking and now - reckoning.time < _LATE * period)
        fault = Status.CLOCK_ERROR
        if ticking and now < reckoning.time:
            reckoning = DeadReckoning(now, reckoning.pose, reckoning.body)
    if late or fault is _CLOCK_ERROR:
        brake = Brake(brake.twist, brake.ticks, brake.ticks == 0)
    box = limits.input_box(applied, period)
    return _new(Begun, (applied, box, reckoning, brake, fault, late, since))


def stop(begun: Begun, status: Status, config: FilterConfig) -> tuple[Decision, FilterState]:
    """End a tick without a usable scene: the certified brake, inside the input box."""
    brake = begun.brake.next()
    twist = begun.box.clip(brake.twist)
    if not begun.box.contains(brake.twist, ROUNDING):
        brake = config.guard.brake_from(twist)
    certified = brake.verified and not begun.late
    decision = Decision(
        twist, status, certified, twist, math.nan, box=begun.box, limits=config.limits,
        timing=_timing(begun.since),
    )  # fmt: skip
    return decision, FilterState(begun.reckoning, brake, twist)


def failed(begun: Begun, error: Exception, config: FilterConfig) -> tuple[Decision, FilterState]:
    """End a tick in which a part raised ``error``: the certified brake, and the error's text."""
    bad_input = isinstance(error, GeometryError)
    status = Status.INVALID_INPUT if bad_input else Status.INTERNAL_ERROR
    decision, state = stop(begun, status, config)
    return decision._replace(reason=f"{type(error).__name__}: {error}"), state


def finish(
    config: FilterConfig,
    begun: Begun,
    nominal: Twist,
    scene: Scene,
    motion: Pose2,
    ahead: Pose2,
    wishes: tuple[Rows, ...] = (),
) -> tuple[Decision, FilterState]:
    """Rows, program, verification and guard: from a nominal command to the one that is sent.

    Parameters
    ----------
    nominal : command of the law
    scene : goal and feature as seen from the robot before ``motion``
    motion : how the robot moved since then
    ahead : where its body coasts to, seen from there too; the commands act from there on
    wishes : rows below the barriers, such as a Lyapunov row, taken where the body coasts to
    """
    _, box, reckoning, last, _, late, since = begun
    blocks = (*[barrier.rows(scene, ahead) for barrier in config.barriers], *wishes)
    if len(blocks) == 2 and blocks[0][2] < blocks[1][2]:  # as nearly always
        (_, first, hard, _), (_, second, soft, _) = blocks
        priorities: Sequence[int] = (hard, soft)
        levels: list[Sequence[Row]] = [first, second]
    else:
        by_priority = _levels(blocks)
        priorities, levels = tuple(by_priority), list(by_priority.values())
    answer = solve_ladder(config.weight, nominal, box, levels, config.backend)
    if answer is None or not _verified(answer, box, levels):
        braked, after = stop(begun, Status.SOLVER_FAILED, config)
        asked = braked._replace(nominal=nominal, rows=blocks, weight=config.weight, answer=answer)
        return asked, after
    wanted = _new(Twist, answer[:2])
    outcome = config.guard.filter(wanted, scene, reckoning.body, box, last, motion)
    slack = barrier_slack = 0.0
    relaxed = answer.relaxed
    if relaxed:
        for priority, amount in zip(priorities, answer.slacks, strict=True):
            if priority >= _STABILITY:
                slack = amount if amount > slack else slack
            elif amount > barrier_slack:
                barrier_slack = amount
    twist, brake, verdict, certified, clearance = outcome
    if late and certified:
        certified, brake = False, Brake(twist, brake.ticks, brake.ticks == 0)
    status = _OPTIMAL
    if verdict is not _ADMITTED or clearance < 0.0 or relaxed:
        status = _status(outcome, slack, barrier_slack)
        if status is _OPTIMAL and answer.violated:
            status = Status.BARRIER_RELAXED
    decision = _new(Decision, (
        twist, status, certified, nominal, clearance, slack, barrier_slack, blocks, box,
        False, None, "", config.weight, answer, verdict, config.limits, (), None,
        _timing(since),
    ))  # fmt: skip
    return decision, _new(FilterState, (reckoning, brake, twist))


def _levels(blocks: tuple[Rows, ...]) -> dict[int, Sequence[Row]]:
    """The rows by priority, most important level first."""
    by_priority: dict[int, list[Row]] = {}
    for block in blocks:
        by_priority.setdefault(block.priority, []).extend(block.coefficients)
    return {priority: by_priority[priority] for priority in sorted(by_priority)}


def _verified(answer: LexicographicSolution, box: InputBox, levels: list[Sequence[Row]]) -> bool:
    """Whether an answer is in the box and keeps each row up to its level's slack."""
    v, omega, slacks = answer[:3]
    v_lo, v_hi, w_lo, w_hi = box
    if not (v_lo <= v <= v_hi and w_lo <= omega <= w_hi and len(slacks) == len(levels)):
        return False
    for level, slack in zip(levels, slacks):  # noqa: B905  # the lengths are those just compared
        for a, c, b in level:
            excess = a * v + c * omega - b
            # A zero row is met by no command, or by all; a NaN is no answer.
            if not excess <= 0.0 and (a or c):  # noqa: SIM102
                if not excess <= slack * math.hypot(a, c) + TOLERANCE * (1.0 + abs(b)):
                    return False
    return True


def _timing(since: float | None) -> float:
    return 0.0 if since is None else time.perf_counter() - since


def _status(outcome: Guarded, slack: float, barrier_slack: float) -> Status:
    if outcome.clearance < 0.0:
        return Status.OUT_OF_VIEW
    if outcome.verdict is _BRAKED:
        return Status.BRAKING
    if outcome.verdict is _REPLACED:
        return Status.GUARDED
    if barrier_slack > TOLERANCE:
        return Status.BARRIER_RELAXED
    return Status.RELAXED if slack > TOLERANCE else Status.OPTIMAL


def motion_to_now(config: FilterConfig, begun: Begun, scene: Scene) -> Pose2 | Status:
    """How the robot moved since the scene's stamp, or the fault that makes it unusable."""
    goal, feature, stamp = scene
    total = sum(goal) + sum(feature) + stamp
    if total - total != 0.0:  # NaN and infinity alike
        return Status.INVALID_INPUT
    age = begun.reckoning.time - stamp
    if age < -config.period:
        return Status.CLOCK_ERROR
    if age > config.patience:
        return Status.STALE
    return motion_since(begun.reckoning, stamp) if age > 0.0 else _ORIGIN
