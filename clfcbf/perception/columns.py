"""One row of a depth camera: the columns it sees, and how noisy their depth is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import ConfigurationError, GeometryError

__all__ = ["Array", "DepthColumns", "DepthNoise", "DepthSpan", "column_tangents"]

Array = NDArray[np.float64]
"""An array of floats."""

NOISE_CONSTANT = math.sqrt(3.0) * 2.5e-3
"""[m] The L515's data sheet gives 2.5 mm at 1 m on white; three times the variance for a board."""
NOISE_QUADRATIC = math.sqrt(3.0) * 1.5e-3
"""[1/m] Growth of a return that fades with distance, above the data sheet's on white."""
NOISE_COMMON = 2e-3
"""[m] Error shared by all columns of a frame: under the 5 mm that the data sheet allows at 1 m."""
NEAREST = 0.25
"""[m] Least depth, the L515's."""
FARTHEST = 3.2
"""[m] Largest depth used: past the start region, where noise would hide half of a step."""
RESOLUTION = 1e-4
"""[m] Added in quadrature: a noiseless camera still counts in steps, and its fit has a scale."""


class DepthSpan(NamedTuple):
    """Depths that a camera measures, from ``near`` to ``far`` [m]."""

    near: float = NEAREST
    far: float = FARTHEST

    def check(self) -> DepthSpan:
        """Return the span; ``ConfigurationError`` unless 0 <= near < far, both finite."""
        if not 0.0 <= self.near < self.far < math.inf:
            raise ConfigurationError(
                f"a span of depths needs 0 <= near < far [m], got {self.near!r} and {self.far!r}"
            )
        return self

    def holds(self, depths: Array) -> NDArray[np.bool_]:
        """Which depths lie within; NaN does not."""
        with np.errstate(invalid="ignore"):
            within: NDArray[np.bool_] = (depths >= self.near) & (depths <= self.far)
        return within


class DepthColumns(NamedTuple):
    r"""What one horizontal row of a depth camera sees, in the camera's frame.

    ``bearings`` (N,) [rad] increase from right to left; ``ranges`` (N,) [m] lie along the rays,
    NaN where nothing is seen. Depth along the axis is :math:`z = r\cos\beta`.
    """

    bearings: Array
    ranges: Array

    def tangents(self) -> Array:
        r""":math:`\tau = \tan\beta` of each column, where it is in the image, (N,)."""
        return np.tan(self.bearings)

    def depths(self, span: DepthSpan) -> Array:
        """Depth along the camera's axis (N,) [m]; NaN outside the span or where nothing is seen."""
        with np.errstate(invalid="ignore"):
            depths = self.ranges * np.cos(self.bearings)
        return np.where(span.holds(depths), depths, np.nan)

    def check(self) -> None:
        """Raise ``GeometryError`` unless the arrays match and bearings rise within ±pi/2."""
        if self.bearings.ndim != 1 or self.bearings.shape != self.ranges.shape:
            raise GeometryError(
                "bearings and ranges must be two arrays of one shape (N,), got "
                f"{self.bearings.shape} and {self.ranges.shape}"
            )
        ahead = bool(np.all(np.abs(self.bearings) < 0.5 * math.pi))
        if not (ahead and bool(np.all(np.diff(self.bearings) > 0.0))):
            raise GeometryError(
                "bearings must rise from right to left within (-pi/2, pi/2) rad; "
                "reverse both arrays of an image read from left to right"
            )


def column_tangents(half_angle: float, count: int) -> Array:
    r"""Tangents of the columns of a pinhole camera, uniform in :math:`\tan\beta`.

    .. math:: \tau_k = \tan\Phi\left(\frac{2k + 1}{N} - 1\right), \quad k = 0 \ldots N - 1

    Parameters
    ----------
    half_angle : half of the horizontal field of view :math:`\Phi` [rad]
    count : number of columns :math:`N`

    Raises
    ------
    ConfigurationError : there are fewer than 2 columns, which have no spacing
    """
    if count < 2:
        raise ConfigurationError(f"a depth camera needs at least 2 columns, got {count!r}")
    return np.asarray(math.tan(half_angle) * ((2.0 * np.arange(count) + 1.0) / count - 1.0))


@dataclass(frozen=True, slots=True)
class DepthNoise:
    r"""White noise of a column's depth, and the error that all columns of a frame share.

    .. math:: \sigma(z) = \sigma_0 + \sigma_2 z^2

    Attributes
    ----------
    constant, quadratic : :math:`\sigma_0` [m] and :math:`\sigma_2` [1/m]
    common : standard deviation of the frame's own error [m]

    Raises
    ------
    ConfigurationError : a value is not finite or negative
    """

    constant: float = NOISE_CONSTANT
    quadratic: float = NOISE_QUADRATIC
    common: float = NOISE_COMMON

    def __post_init__(self) -> None:
        for name in ("constant", "quadratic", "common"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"{name} must be finite and >= 0, got {value!r}")

    @classmethod
    def none(cls) -> DepthNoise:
        """No noise at all."""
        return cls(0.0, 0.0, 0.0)

    def white(self, depths: Array) -> Array:
        """Standard deviation of the white noise at each depth [m]."""
        return self.constant + self.quadratic * depths * depths

    def sigma(self, depths: Array) -> Array:
        """As :meth:`white`, with the camera's resolution: what a fit divides by [m]."""
        return np.hypot(self.white(depths), RESOLUTION)
