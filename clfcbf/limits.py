"""Speed and acceleration limits, the inputs one tick can reach, and the time to brake."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from clfcbf.errors import ConfigurationError, LimitsError
from clfcbf.se2 import Twist

__all__ = ["InputBox", "Limits", "check_period"]

_MOST_TICKS = 1e9
"""Ticks of a brake counted at most: a year at 30 Hz, so that no twist overflows the count."""


class InputBox(NamedTuple):
    """The commands that one tick may send: ``v_lo <= v <= v_hi``, ``w_lo <= omega <= w_hi``."""

    v_lo: float
    v_hi: float
    w_lo: float
    w_hi: float

    def clip(self, twist: tuple[float, float]) -> Twist:
        """The point of the box nearest to ``twist``, coordinate by coordinate."""
        v, omega = twist
        v_lo, v_hi, w_lo, w_hi = self
        v = v_lo if v < v_lo else v_hi if v > v_hi else v
        omega = w_lo if omega < w_lo else w_hi if omega > w_hi else omega
        return tuple.__new__(Twist, (v, omega))

    def contains(self, twist: Twist, tolerance: float = 0.0) -> bool:
        """Whether ``twist`` lies in the box, to ``tolerance`` in each coordinate."""
        v, omega = twist
        return (
            self[0] - tolerance <= v <= self[1] + tolerance
            and self[2] - tolerance <= omega <= self[3] + tolerance
        )


LEAST = 1e-9
"""[m/s, rad/s, m/s², rad/s²] Smallest limit: with less no robot moves in its lifetime, and the
ticks of a brake could no longer be counted."""


def check_period(period: float) -> float:
    """Return ``period`` [s] if it is finite and positive, else raise ``ConfigurationError``."""
    if not (math.isfinite(period) and period > 0.0):
        raise ConfigurationError(f"period must be finite and positive [s], got {period!r}")
    return period


@dataclass(frozen=True, slots=True)
class Limits:
    r"""What the chassis can do.

    Attributes
    ----------
    v_max, omega_max : largest forward speed [m/s] and turn rate [rad/s]
    a_max, alpha_max : largest acceleration [m/s²] and angular acceleration [rad/s²]
    v_min : most negative speed [m/s]; ``-v_max`` if not given, 0 forbids reverse

    Raises
    ------
    LimitsError : a value is not finite, a maximum not positive (1e-9 at least), or ``v_min > 0``

    Notes
    -----
    The paper writes :math:`|v - v_0| \le a_{max}`, which lacks the time step: here one tick of
    period :math:`T` changes the speed by at most :math:`a_{max}T`.
    """

    v_max: float
    omega_max: float
    a_max: float
    alpha_max: float
    v_min: float | None = None
    _reverse_speed: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("v_max", "omega_max", "a_max", "alpha_max"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise LimitsError(f"{name} must be finite and positive, got {value!r}")
            if value < LEAST:
                raise LimitsError(f"{name} must be at least {LEAST:g}, got {value!r}")
        if self.v_min is None:
            object.__setattr__(self, "v_min", -self.v_max)
        elif not (math.isfinite(self.v_min) and self.v_min <= 0.0):
            raise LimitsError(f"v_min must be finite and at most 0, got {self.v_min!r}")
        object.__setattr__(self, "_reverse_speed", self.v_min)

    @property
    def reverse_speed(self) -> float:
        """The most negative speed [m/s], a number also where ``v_min`` was left out."""
        return self._reverse_speed

    def input_box(self, applied: Twist, period: float) -> InputBox:
        """The commands reachable in one tick from the command last applied.

        The acceleration box around ``applied`` cut with the speed box. Where ``applied`` lies
        outside the speed box (a hand-over from a faster stage), the box is what moves toward
        it at the acceleration limit, so it is never empty.
        """
        v, omega = applied
        dv, dw = self.a_max * period, self.alpha_max * period
        v_lo, v_hi, w_lo, w_hi = v - dv, v + dv, omega - dw, omega + dw
        least, most, widest = self._reverse_speed, self.v_max, self.omega_max
        # Each time the end nearest to the speed limits where the two boxes do not meet.
        if v_hi < least:
            v_lo = v_hi
        elif v_lo > most:
            v_hi = v_lo
        else:
            v_lo = least if v_lo < least else v_lo
            v_hi = most if v_hi > most else v_hi
        if w_hi < -widest:
            w_lo = w_hi
        elif w_lo > widest:
            w_hi = w_lo
        else:
            w_lo = -widest if w_lo < -widest else w_lo
            w_hi = widest if w_hi > widest else w_hi
        return tuple.__new__(InputBox, (v_lo, v_hi, w_lo, w_hi))

    def contains(self, twist: Twist, tolerance: float = 0.0) -> bool:
        """Whether ``twist`` is inside the speed limits, to ``tolerance``."""
        return (
            self._reverse_speed - tolerance <= twist[0] <= self.v_max + tolerance
            and abs(twist[1]) <= self.omega_max + tolerance
        )

    def brake_ticks(self, twist: Twist, period: float) -> int:
        r"""Ticks that a same-curvature brake takes from ``twist`` to rest.

        :math:`N = \lceil\max(|v|/(a_{max}T),\ |\omega|/(\alpha_{max}T))\rceil`.
        """
        slower = abs(twist[0]) / (self.a_max * period)
        straighter = abs(twist[1]) / (self.alpha_max * period)
        ticks = slower if slower > straighter else straighter
        return math.ceil(ticks if ticks < _MOST_TICKS else _MOST_TICKS)

    def brake_horizon(self, period: float) -> float:
        r"""Largest look-ahead of the guard, :math:`\bar T = T(\bar N + 1)/2` [s]."""
        fastest = Twist(max(self.v_max, -self.reverse_speed), self.omega_max)
        return 0.5 * period * (self.brake_ticks(fastest, period) + 1)
