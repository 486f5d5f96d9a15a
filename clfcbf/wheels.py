r"""What the wheels of a differential drive can do: a box in wheel speeds, a polytope in twists.

The contact points of the wheels, a track :math:`b` apart, roll at the rim speeds

.. math:: s_L = v - \tfrac12 b\,\omega, \qquad s_R = v + \tfrac12 b\,\omega,

a linear and invertible map of the twist. So bounds on each wheel's speed and acceleration, two
intervals, are the four half-planes :math:`\pm(v \mp \tfrac12 b\omega) \le \dots` of a
parallelogram of twists [Siegwart2011]_. It contains rest, and with a twist every slower
one of the same curvature: a same-curvature brake never leaves it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from clfcbf.errors import LimitsError
from clfcbf.se2 import Twist

__all__ = ["RimSpeeds", "WheelBox", "WheelLimits", "WheelRow"]

WheelRow = tuple[float, float, float]
"""``(a_v, a_omega, b)``, the half-plane ``a_v v + a_omega omega <= b`` of twists."""

_MOST_TICKS = 1e9
"""Ticks of a brake counted at most: a year at 30 Hz, so that no twist overflows the count."""

_SHRINK = 1.0 - 2.0**-50
"""By which a share is shortened until rounding has left the twist inside: a few steps do."""

_DOUBLINGS = 26
"""Of that step, at most: up to a hundred-millionth of the way."""


class RimSpeeds(NamedTuple):
    """Speeds of the two wheels' contact points along the floor [m/s], forward positive."""

    left: float
    right: float


class WheelBox(NamedTuple):
    """Rim speeds that one tick may command [m/s], and the track [m] that makes twists of them."""

    left_lo: float
    left_hi: float
    right_lo: float
    right_hi: float
    track: float

    @property
    def rows(self) -> tuple[WheelRow, WheelRow, WheelRow, WheelRow]:
        r"""The same as half-planes of twists: left wheel up and down, right wheel up and down.

        Their order is that of ``names``.
        """
        half = 0.5 * self.track
        return (
            (1.0, -half, self.left_hi),
            (-1.0, half, -self.left_lo),
            (1.0, half, self.right_hi),
            (-1.0, -half, -self.right_lo),
        )

    @property
    def names(self) -> tuple[str, str, str, str]:
        """Names of the rows."""
        return ("wheel.left.fastest", "wheel.left.slowest",
                "wheel.right.fastest", "wheel.right.slowest")  # fmt: skip

    def contains(self, twist: Twist, tolerance: float = 0.0) -> bool:
        """Whether both wheels are within their intervals, to ``tolerance`` [m/s]."""
        lead = 0.5 * self.track * twist[1]
        left, right = twist[0] - lead, twist[0] + lead
        return (
            self.left_lo - tolerance <= left <= self.left_hi + tolerance
            and self.right_lo - tolerance <= right <= self.right_hi + tolerance
        )

    def toward(self, safe: Twist, wanted: Twist) -> Twist:
        """The twist farthest on the way from ``safe``, which is inside, to ``wanted``.

        With ``safe`` at rest that is ``wanted`` itself, slower along its own curvature. Where
        ``safe`` is not inside it is returned as it is: nothing on the way is known to be better.
        A ``wanted`` that is not finite is no wish at all.
        """
        dv, dw = wanted[0] - safe[0], wanted[1] - safe[1]
        if not (math.isfinite(dv) and math.isfinite(dw) and self.contains(safe)):
            return safe
        if self.contains(wanted):
            return Twist(*wanted)
        share = 1.0
        for a, c, b in self.rows:
            rate = a * dv + c * dw
            if rate > 0.0:
                share = min(share, max(0.0, b - (a * safe[0] + c * safe[1])) / rate)
        less = 1.0 - _SHRINK
        for _ in range(_DOUBLINGS):
            twist = Twist(safe[0] + share * dv, safe[1] + share * dw)
            if self.contains(twist):
                return twist
            share -= less * share
            less *= 2.0  # rounding is that of the wheels' speeds, however small the share
        return safe


@dataclass(frozen=True, slots=True)
class WheelLimits:
    r"""What each of the two driven wheels can do.

    Attributes
    ----------
    track : distance between the wheels' contact points [m]
    radius : of the wheels [m]; only the wheels' turn rates depend on it
    speed : fastest rim speed :math:`S` of a wheel, either way [m/s]
    acceleration : largest rim acceleration :math:`A` of a wheel [m/s²]; infinite leaves it out

    Raises
    ------
    LimitsError : a value is not positive, or one but the acceleration not finite
    """

    track: float
    radius: float
    speed: float
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        for name in ("track", "radius", "speed"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise LimitsError(f"{name} must be finite and positive, got {value!r}")
        if not self.acceleration > 0.0:
            raise LimitsError(f"acceleration must be positive, got {self.acceleration!r}")

    def rim_speeds(self, twist: Twist) -> RimSpeeds:
        r""":math:`s = v \mp \tfrac12 b\,\omega` [m/s]."""
        lead = 0.5 * self.track * twist[1]
        return RimSpeeds(twist[0] - lead, twist[0] + lead)

    def wheel_rates(self, twist: Twist) -> tuple[float, float]:
        """Left and right turn rate [rad/s] of wheels that roll at ``twist``."""
        left, right = self.rim_speeds(twist)
        return left / self.radius, right / self.radius

    def twist_of(self, left: float, right: float) -> Twist:
        r"""The twist of wheels that turn at the given rates [rad/s].

        :math:`v = \tfrac12(s_L + s_R)`, :math:`\omega = (s_R - s_L)/b`; wheels that slip do not.
        """
        radius = self.radius
        return Twist(0.5 * radius * (left + right), radius * (right - left) / self.track)

    def contains(self, twist: Twist, tolerance: float = 0.0) -> bool:
        """Whether neither wheel exceeds its speed, to ``tolerance`` [m/s]."""
        return abs(twist[0]) + 0.5 * self.track * abs(twist[1]) <= self.speed + tolerance

    def scaled(self, twist: Twist) -> Twist:
        r"""``twist`` along its own curvature, as slow as the wheels need it.

        The factor is :math:`\min(1, S / \max(|s_L|, |s_R|))`, where the maximum is
        :math:`|v| + \tfrac12 b|\omega|`. A path followed at the scaled twist is the same path,
        which clipping either wheel alone would bend.
        """
        v, omega = twist
        fastest = abs(v) + 0.5 * self.track * abs(omega)
        if fastest <= self.speed:
            return Twist(v, omega)
        factor = self.speed / fastest
        while abs(factor * v) + 0.5 * self.track * abs(factor * omega) > self.speed:
            factor *= _SHRINK
        return Twist(factor * v, factor * omega)

    def box(self, applied: Twist, period: float) -> WheelBox:
        """Rim speeds reachable in one tick from the command last applied.

        Each wheel's acceleration interval around its rim speed cut with its speed interval.
        Where they do not meet (a hand-over from a faster stage), what is left is the end that
        moves toward the speed limit at the acceleration limit, so the box is never empty.
        """
        change = self.acceleration * period
        left, right = self.rim_speeds(applied)
        return WheelBox(
            *_reached(left, change, self.speed), *_reached(right, change, self.speed), self.track
        )

    def brake_ticks(self, twist: Twist, period: float) -> int:
        r"""Ticks that a same-curvature brake takes as far as the wheels are concerned.

        :math:`N = \lceil \max(|s_L|, |s_R|) / (A T) \rceil`: of the brake
        :math:`u(1 - 1/N)` each wheel takes an equal share a tick.
        """
        fastest = abs(twist[0]) + 0.5 * self.track * abs(twist[1])
        return math.ceil(min(fastest / (self.acceleration * period), _MOST_TICKS))


def _reached(speed: float, change: float, fastest: float) -> tuple[float, float]:
    low, high = speed - change, speed + change
    if high < -fastest:
        return high, high
    if low > fastest:
        return low, low
    return max(low, -fastest), min(high, fastest)
