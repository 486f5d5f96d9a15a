r"""Time scaling of a path: the fastest way along it within all four limits.

With :math:`z(s) = v^2`, :math:`a = z'/2` and :math:`\alpha = \kappa z'/2 + \kappa' z`
([Verscheure2009]_). Between samples both :math:`z` and :math:`\kappa` are linear in s, which
makes a constant and :math:`\alpha` linear there: bounds that hold at both ends of a segment
hold all along it, and they are linear in the two values of z. So one backward pass of planar
linear programs gives the largest speed from which the rest of the path can still be driven,
and one forward pass drives as fast as that allows ([Pham2018]_).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import GeometryError, PlanningError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.trajectories.path import Peaks, SampledPath

__all__ = ["TimedPath", "time_path"]

FloatArray = NDArray[np.float64]

_INSIDE = 1.0 - 1e-9
"""Share of the largest reachable z that is used, so that rounding cannot empty what follows."""

_RELAXED = 100.0  # factor on a limit while the one that binds is sought
_Row = tuple[float, float, float]


class _Bounds(NamedTuple):
    speed: float
    turn_rate: float
    acceleration: float
    angular_acceleration: float


@dataclass(frozen=True, slots=True, eq=False)
class TimedPath:
    r"""A path with its speed profile; acceleration constant between samples.

    Attributes
    ----------
    path : the path itself
    v, omega : twist at the samples [m/s, rad/s], shape (n,); v has the sign of the gear
    t : time at the samples [s], shape (n,), from 0
    """

    path: SampledPath
    v: FloatArray
    omega: FloatArray
    t: FloatArray

    @property
    def s(self) -> FloatArray:
        """Arc length at the samples [m], shape (n,)."""
        return self.path.s

    @property
    def duration(self) -> float:
        """Time to the end [s]."""
        return float(self.t[-1])

    def arc_length(self, t: float) -> float:
        """Arc length travelled at time ``t`` [m]; clipped to the ends."""
        return self._travel(t)[0]

    def twist(self, t: float) -> Twist:
        """Twist at time ``t`` [s]; zero outside [0, duration]."""
        if not 0.0 <= t <= self.duration:
            return Twist(0.0, 0.0)
        s, speed = self._travel(t)
        return Twist(self.path.gear * speed, self.path.curvature_at(s) * speed)

    def at(self, t: float) -> tuple[Pose2, Twist]:
        """Pose and twist at time ``t`` [s]; rests at the end pose after the duration."""
        return self.path.pose(self.arc_length(t)), self.twist(t)

    def _travel(self, t: float) -> tuple[float, float]:
        t = min(max(t, 0.0), self.duration)
        i = min(int(np.searchsorted(self.t, t, side="right")) - 1, len(self.t) - 2)
        dt = float(self.t[i + 1] - self.t[i])
        v0, v1 = abs(float(self.v[i])), abs(float(self.v[i + 1]))
        if dt == 0.0:
            return float(self.s[i + 1]), v1
        past = t - float(self.t[i])
        speed = v0 + past / dt * (v1 - v0)
        return float(self.s[i]) + 0.5 * past * (v0 + speed), speed

    def peaks(self) -> Peaks:
        r"""Largest absolute speed, turn rate and accelerations, exact also between samples.

        The turn rate may peak inside a segment, where :math:`\alpha` changes sign.
        """
        h = np.diff(self.s)
        keep = h > 0.0
        h, k0, k1 = h[keep], self.path.curvature[:-1][keep], self.path.curvature[1:][keep]
        z = self.v**2
        z0, z1 = z[:-1][keep], z[1:][keep]
        a = 0.5 * (z1 - z0) / h
        left, right = a * k0 + (k1 - k0) / h * z0, a * k1 + (k1 - k0) / h * z1
        turning = left * right < 0.0
        u = np.divide(left, left - right, out=np.zeros_like(left), where=turning)
        inside = np.abs(k0 + u * (k1 - k0)) * np.sqrt(z0 + u * (z1 - z0))
        return Peaks(
            float(np.max(np.abs(self.v))),
            float(max(np.max(np.abs(self.omega)), np.max(inside))),
            float(np.max(np.abs(a))),
            float(max(np.max(np.abs(left)), np.max(np.abs(right)))),
        )

    def utilisation(self, limits: Limits) -> Peaks:
        """Peaks over their limits: 1 where a limit is reached."""
        return self.peaks().utilisation(limits, self.path.gear)


def time_path(path: SampledPath, limits: Limits, initial_speed: float = 0.0) -> TimedPath:
    r"""Drive a path from the present speed to rest, fast and within all four limits.

    The limits hold at the samples and between them:
    :math:`z \le v_{max}^2`, :math:`|\kappa|\sqrt z \le \omega_{max}`,
    :math:`|z'|/2 \le a_{max}`, :math:`|\kappa z'/2 + \kappa' z| \le \alpha_{max}`,
    :math:`z(0) = v_0^2`, :math:`z(s_f) = 0`.

    Parameters
    ----------
    path : curvature continuous; where it jumps (a repeated arc length with two curvatures)
        the turn rate could not follow at speed, so the profile stops there
    limits : speeds and accelerations; in reverse ``-v_min`` bounds the speed
    initial_speed : present v [m/s], 0 or with the sign of the gear. The present turn rate
        is taken to be curvature times speed

    Returns
    -------
    The profile. Each sample's speed also obeys the turn rate limit at the curvatures of its
    two neighbours, and where the curvature changes sign between coarse samples the forward
    pass is not quite the fastest: within 1 % of it from some 150 samples on, up to 10 %
    slower with 40.

    Raises
    ------
    PlanningError : the initial speed cannot be kept within the limits; the message and
        ``reasons`` name the limit, or ``"joint"`` where no single one is to blame. Also where
        the speed is against the gear, or reverse is forbidden
    GeometryError : the initial speed is not finite
    """
    if not math.isfinite(initial_speed):
        raise GeometryError(f"initial speed must be finite [m/s], got {initial_speed!r}")
    if initial_speed * path.gear < 0.0:
        raise PlanningError(
            f"initial speed {initial_speed:.3f} m/s is against the gear {path.gear:+d}: stop first",
            {"gear": 1},
        )
    top = limits.v_max if path.gear > 0 else -limits.reverse_speed
    if top == 0.0:
        raise PlanningError("reverse is forbidden: v_min is 0", {"gear": 1})
    bounds = _Bounds(top, limits.omega_max, limits.a_max, limits.alpha_max)
    s, k = path.s.tolist(), path.curvature.tolist()
    reachable = _backward(s, k, bounds)
    z0 = initial_speed * initial_speed
    if z0 * _INSIDE**2 > reachable[0]:
        raise _refusal(s, k, bounds, initial_speed, math.sqrt(reachable[0]))
    z = np.array(_forward(s, k, bounds, reachable, min(z0, reachable[0])))
    speed = np.sqrt(z)
    h, both = np.diff(path.s), speed[:-1] + speed[1:]
    dt = np.divide(2.0 * h, both, out=np.zeros_like(h), where=h > 0.0)
    t = np.concatenate(([0.0], np.cumsum(dt)))
    return TimedPath(path, path.gear * speed, path.curvature * speed, t)


def _rows(h: float, k0: float, k1: float, bounds: _Bounds) -> tuple[_Row, _Row, _Row]:
    # |p z0 + q z1| <= r: alpha at the left end, alpha at the right end, acceleration; each
    # multiplied by the length of the segment.
    turn, jump = bounds.angular_acceleration * h, k1 - k0
    return (
        (jump - 0.5 * k0, 0.5 * k0, turn),
        (-0.5 * k1, jump + 0.5 * k1, turn),
        (-1.0, 1.0, 2.0 * bounds.acceleration * h),
    )


def _backward(s: list[float], k: list[float], bounds: _Bounds) -> list[float]:
    """Largest z at each sample from which the rest can be driven; from 0 up to it all can."""
    top, turn = bounds.speed**2, bounds.turn_rate
    reachable = [0.0] * len(s)
    for i in range(len(s) - 2, -1, -1):
        h = s[i + 1] - s[i]
        if h == 0.0:
            if k[i] != k[i + 1]:
                reachable[i + 1] = 0.0
            reachable[i] = reachable[i + 1]
            continue
        sharpest = max(abs(k[i]), abs(k[i + 1]))
        ceiling = top if sharpest * bounds.speed <= turn else (turn / sharpest) ** 2
        reachable[i + 1] = min(reachable[i + 1], ceiling)
        rows = _rows(h, k[i], k[i + 1], bounds)
        reachable[i] = _INSIDE * _largest_first(rows, ceiling, reachable[i + 1])
    return reachable


def _largest_first(rows: tuple[_Row, ...], first: float, second: float) -> float:
    """Largest z0 of the polygon 0 <= z0 <= first, 0 <= z1 <= second, |p z0 + q z1| <= r."""
    polygon = [(0.0, 0.0), (first, 0.0), (first, second), (0.0, second)]
    for p, q, r in rows:
        for sign in (1.0, -1.0):
            gaps = [r - sign * (p * x + q * y) for x, y in polygon]
            if min(gaps) >= 0.0:
                continue
            clipped = []
            for j, ((x, y), gap) in enumerate(zip(polygon, gaps, strict=True)):
                (x_before, y_before), before = polygon[j - 1], gaps[j - 1]
                if (gap < 0.0) != (before < 0.0):
                    u = before / (before - gap)
                    clipped.append((x_before + u * (x - x_before), y_before + u * (y - y_before)))
                if gap >= 0.0:
                    clipped.append((x, y))
            polygon = clipped
    return max(x for x, _ in polygon)


def _forward(
    s: list[float], k: list[float], bounds: _Bounds, reachable: list[float], z0: float
) -> list[float]:
    z = [z0]
    for i in range(len(s) - 1):
        h = s[i + 1] - s[i]
        if h == 0.0:
            z.append(z[-1])
            continue
        highest = reachable[i + 1]
        for p, q, r in _rows(h, k[i], k[i + 1], bounds):
            if q:
                highest = min(highest, max((-r - p * z[-1]) / q, (r - p * z[-1]) / q))
        # The lower bounds are met as well, since z[-1] is in the reachable set.
        z.append(highest)
    return z


def _refusal(
    s: list[float], k: list[float], bounds: _Bounds, speed: float, possible: float
) -> PlanningError:
    alone = [
        name
        for name, limit in bounds._asdict().items()
        if speed * speed * _INSIDE**2
        <= _backward(s, k, bounds._replace(**{name: _RELAXED * limit}))[0]
    ]
    blamed = alone or ["joint"]
    return PlanningError(
        f"initial speed {speed:.3f} m/s cannot be kept within the limits on this path of "
        f"{s[-1]:.3f} m: at most {possible:.3f} m/s; binding: {', '.join(blamed)}",
        dict.fromkeys(blamed, 1),
    )
