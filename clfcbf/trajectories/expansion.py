"""A planar quintic expanded about one of its ends, with the zeros of its speed divided out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import GeometryError
from clfcbf.se2 import Point, Pose2, Twist, is_finite, wrap_angle

__all__ = [
    "CUSP_TOLERANCE",
    "REST_TOLERANCE",
    "STANDSTILL",
    "VANISHING",
    "BoundaryState",
    "Expansion",
    "extent",
    "settled",
    "taylor",
]

REST_TOLERANCE = 1e-5
"""A boundary speed that moves less than this share of the motion's extent is rest (um/s)."""

SUMMITS = 4
"""Local peaks refined at most: near a cusp two or three of nearly one height stand together."""

VANISHING = 1e-12
"""A derived coefficient that moves less than this share of the extent is rounding."""

STANDSTILL = 1e-9
"""A motion of less extent [m] is none: a nanometre, and no square underflows above it."""

CUSP_TOLERANCE = 1e-6
"""A smallest speed this small against the largest is a cusp: the root is found to 1e-8."""

_FloatArray = NDArray[np.float64]
_Coefficients = tuple[float, ...]
_AT_REST = Twist(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class BoundaryState:
    """Position [m], velocity [m/s] and acceleration [m/s²] at one end, each (x, y)."""

    position: Point
    velocity: Point = (0.0, 0.0)
    acceleration: Point = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = (*self.position, *self.velocity, *self.acceleration)
        if not is_finite(values):
            raise GeometryError(f"boundary values must be finite, got {values!r}")

    @classmethod
    def of(cls, pose: Pose2, twist: Twist = _AT_REST, acceleration: float = 0.0) -> BoundaryState:
        r"""State of a unicycle: :math:`\dot p = v e`, :math:`\ddot p = \dot v e + v\omega n`.

        Here :math:`e = (\cos\theta, \sin\theta)` and :math:`n` is its left normal.

        Parameters
        ----------
        pose : position and heading; the heading is lost where v and acceleration are both 0
        twist : :math:`(v, \omega)`; v is negative in reverse, and at v = 0 omega is lost
        acceleration : :math:`\dot v` along the heading [m/s²]
        """
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        v, across = twist.v, twist.v * twist.omega
        return cls(
            (pose.x, pose.y),
            (v * c, v * s),
            (acceleration * c - across * s, acceleration * s + across * c),
        )


def taylor(
    near: BoundaryState, far: BoundaryState, T: float
) -> tuple[_Coefficients, _Coefficients]:
    r"""Coefficients about ``near`` of the quintic that reaches ``far`` after ``T`` [s].

    With :math:`d = p_1 - p_0`:

    .. math::
        c_3 &= (20 d - (8 v_1 + 12 v_0) T - (3 a_0 - a_1) T^2) / (2 T^3) \\
        c_4 &= (-30 d + (14 v_1 + 16 v_0) T + (3 a_0 - 2 a_1) T^2) / (2 T^4) \\
        c_5 &= (12 d - 6 (v_1 + v_0) T + (a_1 - a_0) T^2) / (2 T^5)

    A negative ``T`` expands about the end of a trajectory instead of its start.

    Returns
    -------
    Six ascending coefficients in x and six in y.
    """
    x, y = (_axis(near, far, axis, T) for axis in (0, 1))
    return x, y


def extent(start: BoundaryState, end: BoundaryState, T: float) -> float:
    r"""Scale of the motion [m]: the largest of :math:`|d|`, :math:`|v| T` and :math:`|a| T^2`."""
    return max(
        math.dist(start.position, end.position),
        T * max(math.hypot(*start.velocity), math.hypot(*end.velocity)),
        T * T * max(math.hypot(*start.acceleration), math.hypot(*end.acceleration)),
    )


def settled(state: BoundaryState, T: float, scale: float) -> BoundaryState:
    """``state`` with a negligible speed, and then a negligible acceleration, set to 0.

    A speed of a few micrometres a second says nothing of a heading.
    """
    if T * math.hypot(*state.velocity) > REST_TOLERANCE * scale:
        return state
    resting = T * T * math.hypot(*state.acceleration) <= REST_TOLERANCE * scale
    return BoundaryState(state.position, acceleration=(0.0, 0.0) if resting else state.acceleration)


def _axis(near: BoundaryState, far: BoundaryState, axis: int, T: float) -> _Coefficients:
    d = far.position[axis] - near.position[axis]
    v0, v1 = near.velocity[axis] * T, far.velocity[axis] * T
    a0, a1 = near.acceleration[axis] * T * T, far.acceleration[axis] * T * T
    return (
        near.position[axis],
        near.velocity[axis],
        0.5 * near.acceleration[axis],
        (20.0 * d - (8.0 * v1 + 12.0 * v0) - (3.0 * a0 - a1)) / (2.0 * T**3),
        (-30.0 * d + (14.0 * v1 + 16.0 * v0) + (3.0 * a0 - 2.0 * a1)) / (2.0 * T**4),
        (12.0 * d - 6.0 * (v1 + v0) + (a1 - a0)) / (2.0 * T**5),
    )


class Expansion(NamedTuple):
    r"""A quintic about one end, :math:`\dot p(\tau) = \tau^n w(\tau)`, :math:`w(0) \ne 0`.

    Attributes
    ----------
    position : coefficients of p in x and y, ascending
    order : n, how many derivatives of p vanish at the end
    deflated : coefficients of w in x and y, ascending
    half : half the duration with the sign of the local time [s]
    """

    position: tuple[_Coefficients, _Coefficients]
    order: int
    deflated: tuple[_Coefficients, _Coefficients]
    half: float

    @classmethod
    def about(cls, x: _Coefficients, y: _Coefficients, half: float, extent: float) -> Expansion:
        """Divide out the zeros of the velocity at local time 0.

        Raises
        ------
        GeometryError : the velocity vanishes everywhere, to rounding against the ``extent`` [m]
        """
        T = 2.0 * abs(half)
        dx = tuple(k * c for k, c in enumerate(x))[1:]
        dy = tuple(k * c for k, c in enumerate(y))[1:]
        if extent > STANDSTILL:
            for order, (a, b) in enumerate(zip(dx, dy, strict=True)):
                if math.hypot(a, b) * T ** (order + 1) > VANISHING * extent:
                    return cls((x, y), order, (dx[order:], dy[order:]), half)
        raise GeometryError("all derivatives of the trajectory vanish: it has no heading")

    def point(self, tau: float) -> Point:
        """Position at the local time [m]."""
        x, y = self.position
        return _horner(x, tau), _horner(y, tau)

    def heading(self, tau: float, gear: int) -> float:
        """Heading [rad] when facing along the travel (gear +1) or against it (-1)."""
        sign = gear * self._orientation()
        x, y = self.deflated
        return wrap_angle(math.atan2(sign * _horner(y, tau), sign * _horner(x, tau)))

    def _orientation(self) -> int:
        # tau^n is negative about the end of a trajectory, where tau < 0, if n is odd.
        return -1 if self.half < 0.0 and self.order % 2 else 1

    def speed(self, tau: float) -> float:
        """Speed along the travel, not negative [m/s]."""
        x, y = self.position
        return math.hypot(_horner_slope(x, tau), _horner_slope(y, tau))

    def turn_rate(self, tau: float) -> float:
        r""":math:`(w \times \dot w)/|w|^2` [rad/s]."""
        x, y = self.deflated
        wx, wy = _horner(x, tau), _horner(y, tau)
        dx, dy = _horner_slope(x, tau), _horner_slope(y, tau)
        return (wx * dy - wy * dx) / (wx * wx + wy * wy)

    def cusp(self) -> float | None:
        """Local time within the half duration at which w vanishes, or None."""
        powers = self.half ** np.arange(len(self.deflated[0]))
        x, y = (np.polynomial.Polynomial(c * powers) for c in self.deflated)
        squared = x * x + y * y
        # A leading coefficient that is rounding would send a root to infinity.
        squared = squared.trim(VANISHING * float(np.max(np.abs(squared.coef))))
        critical = squared.deriv().roots()
        real = critical.real[np.abs(critical.imag) <= CUSP_TOLERANCE]
        times = np.concatenate((real[(real > 0.0) & (real <= 1.0)], (0.0, 1.0)))
        sizes = np.sqrt(np.maximum(squared(times), 0.0))
        k = int(np.argmin(sizes))
        return float(times[k]) * self.half if sizes[k] <= CUSP_TOLERANCE * sizes.max() else None

    def magnitudes(self, samples: int) -> tuple[float, float, float, float]:
        """Largest absolute v, omega and their rates over the half duration.

        Sampled, then refined about the highest samples that stand above their neighbours.
        """
        tau = np.linspace(0.0, self.half, samples)
        largest = []
        for k, values in enumerate(self._rates(tau)):
            padded = np.concatenate([[-1.0], values, [-1.0]])
            summits = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
            peak = 0.0
            for top in summits[np.argsort(values[summits])[-SUMMITS:]].tolist():
                fine = np.linspace(tau[max(top - 1, 0)], tau[min(top + 1, samples - 1)], samples)
                peak = max(peak, float(np.max(self._rates(fine)[k])))
            largest.append(peak)
        v, omega, a, alpha = largest
        return v, omega, a, alpha

    def _rates(self, tau: _FloatArray) -> tuple[_FloatArray, ...]:
        n, size = self.order, np.abs(tau)
        w, dw, ddw = (
            [np.polynomial.Polynomial(c).deriv(k)(tau) for c in self.deflated] for k in (0, 1, 2)
        )
        squared = w[0] ** 2 + w[1] ** 2
        norm: _FloatArray = np.sqrt(squared)
        along, turn = w[0] * dw[0] + w[1] * dw[1], w[0] * dw[1] - w[1] * dw[0]
        rate = size**n * along / norm
        if n:
            rate = rate + math.copysign(n, self.half) * size ** (n - 1) * norm
        twisting = w[0] * ddw[1] - w[1] * ddw[0]
        alpha = twisting / squared - 2.0 * turn * along / squared**2
        return tuple(np.abs(values) for values in (size**n * norm, turn / squared, rate, alpha))


def _horner(coefficients: _Coefficients, t: float) -> float:
    value = 0.0
    for c in reversed(coefficients):
        value = value * t + c
    return value


def _horner_slope(coefficients: _Coefficients, t: float) -> float:
    value = slope = 0.0
    for c in reversed(coefficients):
        slope = slope * t + value
        value = value * t + c
    return slope
