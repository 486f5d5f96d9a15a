r"""The guard of many robots at once: the rule of :class:`clfcbf.guard.Guard` on arrays.

One row a robot everywhere: points and twists are pairs of arrays of shape (n,), poses triples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.guard import _FALLBACKS, ROUNDING
from clfcbf.limits import Limits
from clfcbf.qp.batch_geometry import Array, Flags, Index, Mask, inside

__all__ = [
    "ADMITTED",
    "BRAKED",
    "REPLACED",
    "ArrayGuard",
    "ArrayGuarded",
    "next_brake",
]

Pair: TypeAlias = tuple[Array, Array]
Pose: TypeAlias = tuple[Array, Array, Array]

ADMITTED, REPLACED, BRAKED = np.uint8(0), np.uint8(1), np.uint8(2)
"""What the guard did with a command, as :class:`clfcbf.guard.Verdict`."""


class ArrayGuarded(NamedTuple):
    """What the guard lets through, as :class:`clfcbf.guard.Guarded`."""

    twist: Pair
    brake: Pair
    ticks: Array
    verdict: Flags
    certified: Mask
    clearance: Array


def arc(twist: Pair, duration: Array | float) -> Pose:
    """Exact motion of a constant twist, see :func:`clfcbf.se2.arc`; the angle is not wrapped."""
    v, omega = twist
    half = 0.5 * omega * duration
    sine = np.sin(half)
    with np.errstate(invalid="ignore"):
        chord = v * duration * np.where(half == 0.0, 1.0, sine / half)
    return chord * np.cos(half), chord * sine, 2.0 * half


def next_brake(twist: Pair, ticks: Array) -> tuple[Pair, Array]:
    """One tick on: the same curvature, slower by one part in ``ticks``."""
    moving = ticks > 1.0
    factor = np.where(moving, 1.0 - 1.0 / np.where(moving, ticks, 1.0), 0.0)
    rest = np.where(moving, ticks - 1.0, 0.0)
    return (np.where(moving, twist[0] * factor, 0.0), np.where(moving, twist[1] * factor, 0.0)), rest


@dataclass(frozen=True, slots=True)
class ArrayGuard:
    """Admits commands only while a stop from them keeps the points in view.

    Attributes
    ----------
    limits, period : as of the chassis
    camera, margin : the view, its half angle less by the margin [rad]
    lag : longest first-order lag of the body that is covered [s]
    """

    limits: Limits
    period: float
    camera: FieldOfView
    margin: float
    lag: float
    _half_angle: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_half_angle", self.camera.half_angle - self.margin)

    def brake_ticks(self, twist: Pair) -> Array:
        """Ticks that a same-curvature brake takes to rest."""
        v, omega = twist
        slowest = np.maximum(
            np.abs(v) / (self.limits.a_max * self.period),
            np.abs(omega) / (self.limits.alpha_max * self.period),
        )
        ticks: Array = np.ceil(slowest)
        return ticks

    def bearing(self, points: tuple[Pair, ...], pose: Pose | None, shift: Array | None) -> Array:
        """Largest modulus of a point's bearing after the motion ``pose`` [rad].

        ``shift`` moves the camera ahead along its axis.
        """
        eye_x, eye_y, yaw = self.camera.camera
        cos, sin = math.cos(yaw), math.sin(yaw)
        if pose is not None:
            x, y, turn = pose
            c, s = np.cos(turn), np.sin(turn)
        widest: Array | None = None
        for p_x, p_y in points:
            seen_x, seen_y = p_x, p_y
            if pose is not None:
                d_x, d_y = p_x - x, p_y - y
                seen_x, seen_y = c * d_x + s * d_y, c * d_y - s * d_x
            seen_x, seen_y = seen_x - eye_x, seen_y - eye_y
            ahead = cos * seen_x + sin * seen_y
            if shift is not None:
                ahead -= shift
            bearing = np.abs(np.arctan2(cos * seen_y - sin * seen_x, ahead))
            widest = bearing if widest is None else np.maximum(widest, bearing)
        assert widest is not None
        return widest

    def clearance(self, widest: Array) -> Array:
        """Angle to the edge at the largest bearing; minus infinity behind the camera."""
        return np.where(widest < 0.5 * math.pi, self._half_angle - widest, -np.inf)

    def admissible(
        self, points: tuple[Pair, ...], body: Pair, twist: Pair, ticks: Array, floor: Array
    ) -> Mask:
        """Whether brakes are safe from here to rest, see :meth:`clfcbf.guard.Guard.admissible`."""
        duration = 0.5 * self.period * (ticks + 1.0)
        braked = arc(twist, duration)
        shift: Array | None = None
        if self.lag:
            blur = np.abs(body[0] * twist[1] - twist[0] * body[1]) * duration * self.lag
            shift = blur * (1.0 / math.sin(self._half_angle))
        widest = np.maximum(
            self.bearing(points, None, shift), self.bearing(points, braked, shift)
        )
        if self.lag:
            x, y, turn = coasted = arc(body, self.lag)
            c, s = np.cos(turn), np.sin(turn)
            both = x + c * braked[0] - s * braked[1], y + s * braked[0] + c * braked[1]
            for pose in (coasted, (*both, turn + braked[2])):
                np.maximum(widest, self.bearing(points, pose, shift), out=widest)
        safe: Mask = self.clearance(widest) >= floor
        return safe

    def filter(
        self,
        wanted: Pair,
        points: tuple[Pair, ...],
        body: Pair,
        box: Array,
        brake: tuple[Pair, Array],
    ) -> ArrayGuarded:
        """As :meth:`clfcbf.guard.Guard.filter`: the wanted commands, or what comes closest."""
        clearance = self.clearance(self.bearing(points, None, None))
        floor = np.minimum(clearance, 0.0)
        ticks = self.brake_ticks(wanted)
        good = self.admissible(points, body, wanted, ticks, floor) & (clearance > -np.inf)
        verdict = np.where(good, ADMITTED, BRAKED)
        sent = wanted[0].copy(), wanted[1].copy()
        kept = wanted[0].copy(), wanted[1].copy()
        certified = np.ones(good.shape, dtype=np.bool_)
        at = np.flatnonzero(~good)
        if at.size:
            last, left = next_brake((brake[0][0][at], brake[0][1][at]), brake[1][at])
            safe = inside(box.take(at, axis=1), *last)
            held = _within(box.take(at, axis=1), last)
            for z in (0, 1):
                sent[z][at] = safe[z]
                kept[z][at] = np.where(held, last[z], safe[z])
            ticks[at] = np.where(held, left, self.brake_ticks(safe))
            certified[at] = held
            seen = np.flatnonzero(clearance[at] > -np.inf)
            self._replace(at, seen, wanted, safe, (points, body, box, floor), (sent, kept, ticks), verdict, certified)
        return ArrayGuarded(sent, kept, ticks, verdict, certified, clearance)
