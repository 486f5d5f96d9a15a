"""One run: the filter against an attack, on a body and a camera as the assumptions allow.

The feature is held in the robot frame and moved by exact arcs of the body's mean twist, 20 to a
tick, each judged against the true half angle. Between the two, every error that is assumed is
the adversary's to choose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from benchmarks.falsify.assumptions import Assumptions
from benchmarks.falsify.attack import Attack, Constants, Move
from clfcbf.camera import FieldOfView
from clfcbf.decision import Decision
from clfcbf.defaults import VIEW_MARGIN
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.drive import follow

__all__ = ["Field", "Filter", "Outcome", "duel"]

SUBSAMPLES = 20
"""Instants of a tick at which the view is judged, 1.7 ms apart: under 0.05° of turning."""

NEAREST, FARTHEST = 0.4, 3.0
"""[m] Camera's distance at the start."""

END = 0.25
"""[m] The run ends before the feature is nearer to the camera: the range is not protected."""

OVERDRIVE = 1.5
"""Nominal commands up to this multiple of the limits: the filter has to clip them."""

TOLERANCE = 1e-9
"""[m/s, rad/s] Allowed outside the input box, by rounding."""

_REST = Twist(0.0, 0.0)


class Filter(Protocol):
    """The part that is attacked."""

    def filter(self, nominal: Twist, scene: Scene, applied: Twist, now: float) -> Decision:
        """The command to be sent."""


@dataclass(frozen=True, slots=True)
class Field:
    """Where the runs take place: limits, camera, period, and the margin kept at the start."""

    limits: Limits
    camera: FieldOfView
    period: float
    margin: float = VIEW_MARGIN


class Outcome(NamedTuple):
    """What a run came to; ``margin`` [rad] is the smallest angle to the true edge, signed."""

    ticks: int
    margin: float
    outside: int
    limit_violations: int
    uncertified: int
    exceptions: int
    braked: int
    worst_tick: int


class _Body:
    """First-order lag, scale errors and drift; the feature as seen from it."""

    __slots__ = ("_field", "_lag", "_rate", "_share", "_slopes", "history", "step", "twist")

    def __init__(self, field: Field, lag: float, clip: float, point: tuple[float, float]) -> None:
        self._field, self._lag = field, lag
        self.step = field.period / SUBSAMPLES
        self._rate = math.exp(-self.step / lag) if lag else 0.0
        self._share = lag * (1.0 - self._rate) / self.step
        self._slopes = (clip * field.limits.a_max, clip * field.limits.alpha_max)
        self.twist = _REST
        self.history = [point]

    def advance(self, v: float, omega: float) -> tuple[float, int]:
        """Follow a twist for one tick; smallest margin and the sub-samples out of view."""
        camera = self._field.camera
        c_x, c_y, yaw = camera.camera
        step, rate, share = self.step, self._rate, self._share
        x, y = self.history[-1]
        b_v, b_w = self.twist
        e_v, e_w = b_v - v, b_w - omega
        slope_v, slope_w = self._slopes
        clipped = abs(e_v) > slope_v * self._lag or abs(e_w) > slope_w * self._lag
        widest, outside, half_angle = 0.0, 0, camera.half_angle
        sin, cos, atan2, append = math.sin, math.cos, math.atan2, self.history.append
        for _ in range(SUBSAMPLES):
            if clipped:
                b_v, m_v = follow(b_v, v, slope_v, self._lag, step)
                b_w, m_w = follow(b_w, omega, slope_w, self._lag, step)
            else:
                m_v, m_w = v + e_v * share, omega + e_w * share
                e_v *= rate
                e_w *= rate
            half = 0.5 * m_w * step
            s, c = sin(half), cos(half)
            chord = m_v * step * (s / half if half else 1.0)
            x -= chord * c
            y -= chord * s
            c, s = c * c - s * s, 2.0 * s * c
            x, y = c * x + s * y, c * y - s * x
            append((x, y))
            bearing = abs(atan2(y - c_y, x - c_x) - yaw)
            if bearing > widest:
                widest = bearing
            if bearing > half_angle:
                outside += 1
        self.twist = Twist(b_v, b_w) if clipped else Twist(v + e_v, omega + e_w)
        return half_angle - widest, outside


def start_point(field: Field, constants: Constants) -> tuple[float, float]:
    """Where the feature is at the start: in the view less the declared margin."""
    distance = NEAREST + 0.5 * (constants.distance + 1.0) * (FARTHEST - NEAREST)
    bearing = constants.bearing * (field.camera.half_angle - field.margin)
    return field.camera.camera.transform(
        (distance * math.cos(bearing), distance * math.sin(bearing))
    )


def seen(
    field: Field, assumptions: Assumptions, point: tuple[float, float], move: Move, side: float
) -> Pose2:
    """The feature as it is measured: bearing and range at the camera, each with its error."""
    x, y = field.camera.camera.seen(point)
    distance = math.hypot(x, y)
    bearing = math.atan2(y, x) - side * move.bearing * assumptions.bearing
    distance += move.range * (assumptions.range_offset + assumptions.range_scale * distance)
    distance = max(distance, 0.0)
    at = field.camera.camera.transform((distance * math.cos(bearing), distance * math.sin(bearing)))
    return Pose2(*at, 0.0)


def duel(subject: Filter, field: Field, assumptions: Assumptions, attack: Attack) -> Outcome:
    """Run the attack to its end and count what it achieved.

    ``subject`` has to be new: what it remembers would belong to another run.
    """
    limits, camera, period = field.limits, field.camera, field.period
    constants = Constants(*attack.constants.tolist())
    moves = [Move(*row) for row in attack.moves.tolist()]
    low, high = assumptions.lag
    lag = low + 0.5 * (constants.lag + 1.0) * (high - low)
    body = _Body(field, lag, assumptions.clip, start_point(field, constants))
    scale_v = 1.0 + assumptions.scale * constants.scale_v
    scale_omega = 1.0 + assumptions.scale * constants.scale_omega
    drift = assumptions.drift * constants.drift
    nudge_tick = round(0.5 * (constants.nudge_time + 1.0) * attack.ticks)
    applied, scene, captured = _REST, None, 0
    held = missed = 0
    ticks = outside = violations = uncertified = exceptions = braked = worst = 0
    lowest = camera.margin(body.history[0])
    nearest = END + 1.1 * limits.v_max * period
    for tick in range(attack.ticks):
        move = moves[tick // attack.hold]
        x, y = body.history[-1]
        if camera.camera.seen((x, y))[0] < nearest:
            break
        if assumptions.nudge and tick == nudge_tick:
            angle = math.pi * constants.nudge_direction
            x += assumptions.nudge * math.cos(angle)
            y += assumptions.nudge * math.sin(angle)
            body.history[-1] = x, y
        now = tick * period
        side = math.copysign(1.0, y - camera.camera[1]) if attack.outward else 1.0
        latest = len(body.history) - 1
        frame = latest - int(0.5 * (move.latency + 1.0) * assumptions.latency / body.step)
        if move.frame > 0.5 and held < assumptions.dropouts and scene is not None:
            held += 1
        elif frame >= captured or scene is None:
            held, captured = 0, max(frame, 0)
            feature = seen(field, assumptions, body.history[captured], move, side)
            stamp = captured * body.step + move.stamp * assumptions.stamp
            scene = Scene(feature, feature, stamp)
        ticks += 1
        if move.tick > 0.5 and missed < assumptions.missed:
            missed += 1
        else:
            missed = 0
            nominal = Twist(
                OVERDRIVE * limits.v_max * move.v,
                -side * OVERDRIVE * limits.omega_max * move.omega,
            )
            try:
                decision = subject.filter(nominal, scene, applied, now)
            except Exception:  # whatever it is, it counts
                exceptions += 1
                break
            violations += not limits.input_box(applied, period).contains(
                decision.twist, TOLERANCE
            )
            uncertified += not decision.certified
            applied = decision.twist
        turn = scale_omega * applied[1] + (drift if applied != _REST else 0.0)
        margin, out = body.advance(scale_v * applied[0], turn)
        outside += out
        if margin < lowest:
            lowest, worst = margin, tick
    return Outcome(ticks, lowest, outside, violations, uncertified, exceptions, braked, worst)
