r"""Planar poses, twists and the exact motion of a constant twist.

Frames follow REP-103: x forward, y left, angles counter-clockwise; SI units and radians.
``Pose2`` and ``Twist`` are named tuples because one tick makes dozens of them: they are
immutable, unpack like the equations are written, and cost a quarter of a frozen dataclass.
They carry any float, so that a sensor's NaN reaches the check that answers it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["Point", "Pose2", "Twist", "arc", "is_finite", "wrap_angle"]

Point = tuple[float, float]
"""A point (x, y) [m]."""

_PI = math.pi
_TWO_PI = 2.0 * math.pi
_new = tuple.__new__  # makes a named tuple in half the time of its own constructor


def wrap_angle(angle: float) -> float:
    """Wrap an angle to (-pi, pi] [rad]; exact for every finite angle."""
    if -_PI < angle <= _PI:
        return angle
    wrapped = math.remainder(angle, _TWO_PI)
    return math.pi if wrapped == -math.pi else wrapped


class Twist(NamedTuple):
    """Body velocity of a unicycle: forward speed ``v`` [m/s] and turn rate ``omega`` [rad/s]."""

    v: float
    omega: float

    def scaled(self, factor: float) -> Twist:
        """The same curvature at ``factor`` times the speed."""
        return Twist(self.v * factor, self.omega * factor)


class Pose2(NamedTuple):
    """A pose in the plane, an element of SE(2): ``x``, ``y`` [m] and ``theta`` [rad]."""

    x: float
    y: float
    theta: float

    def compose(self, other: Pose2) -> Pose2:
        """``self * other``: a pose given in this frame, expressed in this frame's parent."""
        x, y, theta = self
        dx, dy, turn = other
        c, s = math.cos(theta), math.sin(theta)
        turn += theta
        if not -_PI < turn <= _PI:
            turn = wrap_angle(turn)
        return _new(Pose2, (x + c * dx - s * dy, y + s * dx + c * dy, turn))

    def inverse(self) -> Pose2:
        """The parent frame seen from this one."""
        x, y, theta = self
        c, s = math.cos(theta), math.sin(theta)
        return Pose2(-c * x - s * y, s * x - c * y, wrap_angle(-theta))

    def relative(self, other: Pose2) -> Pose2:
        """``other`` seen from this pose, ``self.inverse() * other``, both in one frame."""
        x, y, theta = self
        dx, dy, turn = other
        c, s = math.cos(theta), math.sin(theta)
        dx -= x
        dy -= y
        turn -= theta
        if not -_PI < turn <= _PI:
            turn = wrap_angle(turn)
        return _new(Pose2, (c * dx + s * dy, c * dy - s * dx, turn))

    def transform(self, point: Point) -> Point:
        """A point given in this frame, expressed in this frame's parent."""
        x, y, theta = self
        c, s = math.cos(theta), math.sin(theta)
        return x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]

    def seen(self, point: Point | Pose2) -> Point:
        """A point of the parent frame as it is seen from this pose; of a pose its position."""
        x, y, theta = self
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = point[0] - x, point[1] - y
        return c * dx + s * dy, c * dy - s * dx

    def moved(self, twist: Twist, duration: float) -> Pose2:
        """This pose after ``twist`` was held for ``duration`` [s], along the exact arc."""
        x, y, theta = self
        v, omega = twist
        half = 0.5 * omega * duration
        chord = v * duration
        if half:
            chord *= math.sin(half) / half
        along, turn = theta + half, theta + 2.0 * half
        if not -_PI < turn <= _PI:
            turn = wrap_angle(turn)
        return _new(Pose2, (x + chord * math.cos(along), y + chord * math.sin(along), turn))


def arc(twist: Twist, duration: float) -> Pose2:
    r"""Exact motion of a constant twist, :math:`\exp(t\,[v, 0, \omega])`.

    The chord form :math:`vt\,\mathrm{sinc}(\omega t/2)` in the direction
    :math:`\omega t/2` has no cancellation, so it needs no series near
    :math:`\omega = 0`.

    Parameters
    ----------
    twist : body velocity [m/s, rad/s]
    duration : time it is held [s]; negative runs the motion backward

    Returns
    -------
    The final pose seen from the initial one.
    """
    v, omega = twist
    half = 0.5 * omega * duration
    chord = v * duration
    sine = math.sin(half)
    if half:
        chord *= sine / half
    turn = 2.0 * half
    if not -_PI < turn <= _PI:
        turn = wrap_angle(turn)
    return _new(Pose2, (chord * math.cos(half), chord * sine, turn))


def is_finite(values: tuple[float, ...]) -> bool:
    """Whether every value is finite; a sum that is not finite has a NaN or an infinity in it.

    Values so large that their sum overflows count as not finite: no robot is 1e308 m away.
    """
    total = sum(values)
    return total - total == 0.0
