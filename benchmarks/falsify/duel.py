"""One run: the filter against an attack, in a world that the assumptions allow.

The feature is held in the robot frame and moved by exact arcs of the body's mean twist, 20 to a
tick, each judged against the true half angle. The run ends early where the feature comes too
near to the camera: its distance is not what is protected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from benchmarks.falsify.assumptions import Assumptions
from benchmarks.falsify.attack import Attack, Constants, Move
from benchmarks.falsify.body import LaggingBody
from clfcbf.camera import FieldOfView
from clfcbf.decision import Decision, Status
from clfcbf.defaults import VIEW_MARGIN, VIEW_SETBACK
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Point, Pose2, Twist

__all__ = ["END", "Arena", "Glimpse", "Outcome", "Subject", "duel"]

NEAREST, FARTHEST = 0.4, 3.0
"""[m] From the camera to the feature at the start: from the goal pose to the farthest start."""

END = 0.25
"""[m] The run ends before the feature is nearer to the camera than a depth camera can see."""

OVERDRIVE = 1.5
"""Nominal commands reach this multiple of the limits: cutting them down is the filter's task."""

TOLERANCE = 1e-9
"""[m/s, rad/s] What a command may stick out of the input box by rounding."""

_REST = Twist(0.0, 0.0)
_FAILED = (Status.INTERNAL_ERROR, Status.SOLVER_FAILED)  # what the filter caught itself


class Subject(Protocol):
    """What is attacked."""

    def filter(self, nominal: Twist, scene: Scene, applied: Twist, now: float) -> Decision:
        """The command to be sent."""


@dataclass(frozen=True, slots=True)
class Arena:
    """Where runs take place; ``margin`` [rad] and ``setback`` [m] are kept at the start."""

    limits: Limits
    camera: FieldOfView
    period: float
    margin: float = VIEW_MARGIN
    setback: float = VIEW_SETBACK


class Outcome(NamedTuple):
    """What a run came to.

    ``margin`` [rad] is the smallest angle from the feature to the true edge, negative outside,
    reached in tick ``worst``; ``outside`` counts the sub-samples in which it was negative.
    """

    ticks: int
    margin: float
    worst: int
    outside: int
    limit_violations: int
    uncertified: int
    exceptions: int


class Glimpse(NamedTuple):
    """A tick as a spectator sees it: decision, scene, true twist and margin at its end."""

    now: float
    nominal: Twist
    scene: Scene
    decision: Decision
    body: Twist
    margin: float


def duel(
    subject: Subject,
    arena: Arena,
    assumptions: Assumptions,
    attack: Attack,
    watch: Callable[[Glimpse], None] | None = None,
) -> Outcome:
    """Run the attack to its end and count what it achieved.

    ``subject`` has to be new: what it remembers would be of another run. ``watch`` is called
    after every tick with a command.
    """
    limits, camera, period = arena.limits, arena.camera, arena.period
    constants = Constants(*attack.constants.tolist())
    moves = [Move(*row) for row in attack.moves.tolist()]
    body = LaggingBody(
        _between(*assumptions.lag, constants.lag),
        (assumptions.clip * limits.a_max, assumptions.clip * limits.alpha_max),
        period, camera, _start(arena, constants),
    )  # fmt: skip
    scale_v = 1.0 + assumptions.scale * constants.scale_v
    scale_omega = 1.0 + assumptions.scale * constants.scale_omega
    drift = assumptions.drift * constants.drift
    nudge_tick = round(_between(0.0, attack.ticks, constants.nudge_time))
    nearest = END + 2.0 * limits.v_max * period  # whatever the body does in one more tick
    applied, scene, captured, withheld, missed = _REST, None, 0, 0, 0
    lowest, worst = camera.margin(body.seen[0]), 0
    ticks = outside = violations = uncertified = exceptions = 0
    for tick in range(attack.ticks):
        if assumptions.nudge and tick == nudge_tick:
            body.seen[-1] = _nudged(body.seen[-1], assumptions.nudge, constants.nudge_direction)
        if math.dist(body.seen[-1], camera.camera[:2]) < nearest:
            break
        move = moves[tick // attack.hold]
        side = math.copysign(1.0, camera.bearing(body.seen[-1])) if attack.outward else 1.0
        age = _between(0.0, assumptions.latency, move.latency)
        frame = max(0, len(body.seen) - 1 - int(age / body.step))
        if scene is None or (withheld >= assumptions.dropouts or move.frame <= 0.5):
            withheld = 0
            if scene is None or frame >= captured:  # frames do not overtake one another
                captured = frame
                feature = _measured(arena, assumptions, body.seen[frame], move, side)
                stamp = frame * body.step + move.stamp * assumptions.stamp
                scene = Scene(feature, feature, stamp)
        else:
            withheld += 1
        nominal = Twist(
            OVERDRIVE * limits.v_max * move.v, -side * OVERDRIVE * limits.omega_max * move.omega
        )
        decision = None
        if move.tick > 0.5 and missed < assumptions.missed:
            missed += 1
        else:
            missed = 0
            try:
                decision = subject.filter(nominal, scene, applied, tick * period)
            except Exception:  # whichever it is, no command went out
                exceptions += 1
            else:
                box = limits.input_box(applied, period)
                violations += not box.contains(decision.twist, TOLERANCE)
                uncertified += not decision.certified
                exceptions += decision.status in _FAILED
                applied = decision.twist
        turn = scale_omega * applied[1] + (drift if applied != _REST else 0.0)
        margin, out = body.follow(scale_v * applied[0], turn)
        ticks += 1
        outside += out
        if margin < lowest:
            lowest, worst = margin, tick
        if watch is not None and decision is not None:
            watch(Glimpse(tick * period, nominal, scene, decision, body.twist, margin))
    return Outcome(ticks, lowest, worst, outside, violations, uncertified, exceptions)


def _between(low: float, high: float, share: float) -> float:
    return low + 0.5 * (share + 1.0) * (high - low)


def _polar(camera: FieldOfView, distance: float, bearing: float) -> Point:
    """The point at a distance and a bearing from the camera, in the robot frame."""
    return camera.camera.transform((distance * math.cos(bearing), distance * math.sin(bearing)))


def _start(arena: Arena, constants: Constants) -> Point:
    """A start in the set that is kept, the edges turned in and moved in."""
    distance = _between(NEAREST, FARTHEST, constants.distance)
    widest = arena.camera.half_angle - arena.margin - math.asin(arena.setback / distance)
    return _polar(arena.camera, distance, constants.bearing * widest)


def _nudged(point: Point, distance: float, direction: float) -> Point:
    angle = math.pi * direction
    return point[0] + distance * math.cos(angle), point[1] + distance * math.sin(angle)


def _measured(
    arena: Arena, assumptions: Assumptions, point: Point, move: Move, side: float
) -> Pose2:
    """The feature as a frame shows it: errors of bearing and range at the camera."""
    distance = math.dist(point, arena.camera.camera[:2])
    error = move.range * (assumptions.range_offset + assumptions.range_scale * distance)
    bearing = arena.camera.bearing(point) - side * move.bearing * assumptions.bearing
    return Pose2(*_polar(arena.camera, max(distance + error, 0.0), bearing), 0.0)
