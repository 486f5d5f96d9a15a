r"""Interval arithmetic on arrays, with outward rounding that needs no trust in the C library.

IEEE 754 rounds +, -, *, / to the nearest float, so the true result lies strictly between the two
neighbours of the computed one: every bound is pushed to that neighbour. Sine and cosine are
their own alternating series, summed in the same arithmetic, with the tail enclosed.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

_TERMS = 12
"""Terms of a series: what the enclosed tail adds is under 1e-17 up to 1.5 rad."""

REACH = 1.5
"""Arguments of sine and cosine [rad], short of pi/2, where the sine stops being monotone."""


def _down(x):
    return np.nextafter(x, -np.inf)


def _up(x):
    return np.nextafter(x, np.inf)


class Interval:
    """The numbers between ``lo`` and ``hi``, arrays of one shape; a float stands for itself."""

    __slots__ = ("hi", "lo")
    __array_ufunc__ = None  # numpy leaves array + Interval to us

    def __init__(self, lo, hi=None):
        self.lo = np.asarray(lo, dtype=float)
        self.hi = self.lo if hi is None else np.asarray(hi, dtype=float)
        if not np.all(self.lo <= self.hi):
            raise ValueError("bounds are reversed or not numbers")

    @classmethod
    def of(cls, number):
        """A rational number or a decimal string, enclosed."""
        nearest = float(Fraction(number))
        return cls(_down(nearest), _up(nearest))

    @property
    def middle(self):
        """A float inside, near the middle."""
        return np.clip(0.5 * (self.lo + self.hi), self.lo, self.hi)

    def contains(self, number):
        """Whether a rational number lies inside, exactly; scalars only."""
        return Fraction(float(self.lo)) <= number <= Fraction(float(self.hi))

    def __repr__(self):
        return f"Interval({self.lo!r}, {self.hi!r})"

    def __neg__(self):
        return Interval(-self.hi, -self.lo)

    def __add__(self, other):
        other = _interval(other)
        return Interval(_down(self.lo + other.lo), _up(self.hi + other.hi))

    __radd__ = __add__

    def __sub__(self, other):
        return self + -_interval(other)

    def __rsub__(self, other):
        return _interval(other) + -self

    def __mul__(self, other):
        other = _interval(other)
        corners = (
            self.lo * other.lo, self.lo * other.hi, self.hi * other.lo, self.hi * other.hi
        )  # fmt: skip
        return Interval(_down(np.minimum.reduce(corners)), _up(np.maximum.reduce(corners)))

    __rmul__ = __mul__

    def __truediv__(self, other):
        other = _interval(other)
        if np.any((other.lo <= 0.0) & (other.hi >= 0.0)):
            raise ZeroDivisionError("the divisor contains 0")
        corners = (
            self.lo / other.lo, self.lo / other.hi, self.hi / other.lo, self.hi / other.hi
        )  # fmt: skip
        return Interval(_down(np.minimum.reduce(corners)), _up(np.maximum.reduce(corners)))

    def __rtruediv__(self, other):
        return _interval(other) / self

    def magnitude(self):
        """The interval of absolute values."""
        low = np.maximum(np.maximum(self.lo, -self.hi), 0.0)
        return Interval(low, np.maximum(-self.lo, self.hi))

    def square(self):
        """The interval of squares, which is not negative: tighter than a product."""
        size = self.magnitude()
        return Interval(np.maximum(_down(size.lo * size.lo), 0.0), _up(size.hi * size.hi))

    def sin(self):
        """Sine, increasing on what is allowed."""
        self._check()
        low, high = _series(self.lo, 2), _series(self.hi, 2)
        return Interval((low * self.lo).lo, (high * self.hi).hi)

    def cos(self):
        """Cosine, decreasing in the absolute value."""
        self._check()
        size = self.magnitude()
        return Interval(_series(size.hi, 1).lo, _series(size.lo, 1).hi)

    def _check(self):
        if np.any(self.magnitude().hi > REACH):
            raise ValueError(f"sine and cosine are for arguments up to {REACH} rad")


def _interval(value):
    return value if isinstance(value, Interval) else Interval(value)


def _series(x, first):
    r"""Sum of :math:`(-1)^k x^{2k}/(2k + f - 1)!`, that is cos x (f = 1) or sin x / x (f = 2).

    Horner form :math:`1 - \frac{z}{f(f+1)}(1 - \frac{z}{(f+2)(f+3)}(\ldots))`, z = x². Each
    bracket is an alternating series of falling terms, so the innermost is in [0, 1].
    """
    square = Interval(x).square()
    bracket = Interval(np.zeros_like(x), np.ones_like(x))
    for k in reversed(range(_TERMS)):
        n = first + 2 * k
        bracket = 1.0 - square * bracket / float(n * (n + 1))
    return bracket
