r"""A path in the plane, sampled by arc length, and what a motion along it demands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, wrap_angle

__all__ = ["Peaks", "SampledPath", "check_gear"]

FloatArray = NDArray[np.float64]

# Three-point Gauss-Legendre on [0, 1]: exact to degree 5, so a chord of a clothoid of length h
# is good to O(h^7).
_GAUSS = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


def check_gear(gear: int) -> int:
    """Return ``gear`` if it is +1 (forward) or -1 (reverse), else raise ConfigurationError."""
    if gear not in (1, -1):
        raise ConfigurationError(f"gear must be +1 (forward) or -1 (reverse), got {gear!r}")
    return gear


class Peaks(NamedTuple):
    """Largest absolute speed, turn rate and accelerations of a motion, or ratios of them.

    Attributes
    ----------
    speed, turn_rate : [m/s], [rad/s]
    acceleration, angular_acceleration : [m/s²], [rad/s²]
    """

    speed: float
    turn_rate: float
    acceleration: float
    angular_acceleration: float

    def utilisation(self, limits: Limits, gear: int = 1) -> Peaks:
        """Each peak over its limit; in reverse the speed limit is ``-v_min``."""
        top = limits.v_max if gear > 0 else -limits.reverse_speed
        if top == 0.0:
            raise ConfigurationError("reverse is forbidden: v_min is 0")
        return Peaks(
            self.speed / top,
            self.turn_rate / limits.omega_max,
            self.acceleration / limits.a_max,
            self.angular_acceleration / limits.alpha_max,
        )

    def exceeded(self, limits: Limits, gear: int = 1) -> dict[str, float]:
        """Name and ratio of each limit that is exceeded; empty if none is."""
        ratios = self.utilisation(limits, gear)._asdict()
        return {name: ratio for name, ratio in ratios.items() if ratio > 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class SampledPath:
    r"""Arc length, curvature and pose along a path, curvature linear between samples.

    Attributes
    ----------
    s : arc length along the travel [m], shape (n,), from 0, never decreasing. A repeated
        value with two curvatures marks a jump of the curvature: the robot has to stop there
    curvature : :math:`\kappa = d\theta/ds` along the travel [1/m], shape (n,); in reverse it is
        minus the geometric :math:`\omega/v`
    poses : x, y [m] and unwrapped heading [rad], shape (n, 3)
    gear : +1 forward, -1 reverse

    Raises
    ------
    GeometryError : shapes disagree, fewer than two samples, a value not finite, s not starting
        at 0 or decreasing, or no length
    ConfigurationError : the gear is not +1 or -1
    """

    s: FloatArray
    curvature: FloatArray
    poses: FloatArray
    gear: int = 1

    def __post_init__(self) -> None:
        check_gear(self.gear)
        n = len(self.s)
        if n < 2 or self.s.shape != (n,) or self.curvature.shape != (n,):
            raise GeometryError(
                "s and curvature must have one shape (n,) with n at least 2, got "
                f"{self.s.shape} and {self.curvature.shape}"
            )
        if self.poses.shape != (n, 3):
            raise GeometryError(f"poses must have shape ({n}, 3), got {self.poses.shape}")
        if not all(np.isfinite(a).all() for a in (self.s, self.curvature, self.poses)):
            raise GeometryError("arc length, curvature and poses must be finite")
        if self.s[0] != 0.0 or np.any(np.diff(self.s) < 0.0) or self.s[-1] <= 0.0:
            raise GeometryError(
                "arc length must start at 0, never decrease and end above 0 m, got "
                f"{self.s[0]!r} to {self.s[-1]!r} m"
            )

    @classmethod
    def from_curvature(
        cls,
        s: ArrayLike,
        curvature: ArrayLike,
        gear: int = 1,
        start: Pose2 = Pose2(0.0, 0.0, 0.0),  # noqa: B008 - immutable
    ) -> SampledPath:
        r"""The path that leaves ``start`` with a given curvature, a chain of clothoids.

        :math:`\theta' = \kappa`, :math:`(x', y') = \sigma(\cos\theta, \sin\theta)` with gear
        :math:`\sigma`; headings exact, positions by Gauss-Legendre quadrature per sample.
        """
        s, k = np.array(s, dtype=float), np.array(curvature, dtype=float)
        if s.ndim != 1 or s.shape != k.shape:
            raise GeometryError(f"s and curvature must have one shape, got {s.shape}, {k.shape}")
        h = np.diff(s)
        theta = start.theta + np.concatenate(([0.0], np.cumsum(0.5 * h * (k[:-1] + k[1:]))))
        u = _GAUSS[:, None]
        inner = theta[:-1] + h * (u * k[:-1] + 0.5 * u * u * np.diff(k))
        steps = gear * h * (_WEIGHTS @ np.cos(inner)), gear * h * (_WEIGHTS @ np.sin(inner))
        x, y = (
            origin + np.concatenate(([0.0], np.cumsum(step)))
            for origin, step in zip(start[:2], steps, strict=True)
        )
        return cls(s, k, np.column_stack((x, y, theta)), gear)

    @property
    def length(self) -> float:
        """Arc length of the whole path [m]."""
        return float(self.s[-1])

    def segment(self, s: float) -> int:
        """Index of the sample at or before arc length ``s``, at most n - 2."""
        return int(np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2))

    def curvature_at(self, s: float) -> float:
        """Curvature at arc length ``s`` [1/m], linear between samples."""
        i = self.segment(s)
        h = self.s[i + 1] - self.s[i]
        u = float(np.clip((s - self.s[i]) / h, 0.0, 1.0)) if h > 0.0 else 1.0
        return float(self.curvature[i] + u * (self.curvature[i + 1] - self.curvature[i]))

    def pose(self, s: float) -> Pose2:
        """Pose at arc length ``s`` [m], clipped to the ends of the path.

        Along the clothoid from the sample before it, plus the share of what that clothoid
        misses the next sample by, so that the poses pass through every sample.
        """
        s = min(max(s, 0.0), self.length)
        i = self.segment(s)
        h = float(self.s[i + 1] - self.s[i])
        ds = s - float(self.s[i])
        share = ds / h if h > 0.0 else 1.0
        here = self._clothoid(i, h, share)
        missed = self.poses[i + 1] - self._clothoid(i, h, 1.0)
        x, y, theta = (float(value) for value in here + share * missed)
        return Pose2(x, y, wrap_angle(theta))

    def _clothoid(self, i: int, h: float, share: float) -> FloatArray:
        x, y, theta = self.poses[i]
        k0, jump, ds = self.curvature[i], self.curvature[i + 1] - self.curvature[i], share * h
        u = _GAUSS
        inner = theta + ds * (u * k0 + 0.5 * u * u * share * jump)
        step = self.gear * ds
        return np.array(
            (
                x + step * (_WEIGHTS @ np.cos(inner)),
                y + step * (_WEIGHTS @ np.sin(inner)),
                theta + ds * (k0 + 0.5 * share * jump),
            )
        )
