r"""The straight line that a flat board is in the camera's plane, fitted to noisy depths.

In the camera's frame (x along the axis) the line with normal :math:`n = (\cos\theta,
\sin\theta)` at the distance :math:`c` is :math:`n^\top p = c`. A column at
:math:`\tau = \tan\beta` sees its point :math:`p = z\,(1, \tau)`, so that

.. math:: \frac1z = a + b\,\tau, \qquad a = \frac{\cos\theta}{c},\quad b = \frac{\sin\theta}{c}:

inverse depth is linear in the image. Bearings are exact and the noise is along the rays, hence
the likelihood is in the depths, and neither orthogonal distances nor inverse depths are what
has to be least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.perception.columns import Array, DepthNoise
from clfcbf.se2 import Point

__all__ = ["Line", "LineFit", "fit_line"]

SIGMAS = 3.5
"""Residuals beyond this many sigma are no part of the line: 1 true column in 2000 is lost."""
ROUNDS = 20
"""Most refits: each takes in or leaves out a column or two, and four or five settle it."""
CONVERGED = 1e-9
"""Relative step at which a fit has settled: a nanometre at a metre."""
LEAST = 3
"""Columns of a fit with any residual at all."""


class Line(NamedTuple):
    """A line in the camera's frame as inverse depth: ``a`` [1/m] and its slope ``b`` [1/m]."""

    a: float
    b: float

    @property
    def theta(self) -> float:
        r"""Direction of the normal :math:`\theta` that points away from the camera [rad]."""
        return math.atan2(self.b, self.a)

    @property
    def distance(self) -> float:
        """Distance :math:`c` of the line from the camera [m]."""
        return 1.0 / math.hypot(self.a, self.b)

    def at(self, tangent: float) -> Point:
        """Where the ray at ``tangent`` meets the line (x, y) [m]."""
        depth = 1.0 / (self.a + self.b * tangent)
        return depth, depth * tangent

    def depths(self, tangents: Array) -> Array:
        """Depth of the line in each column [m]; NaN where it is behind the camera."""
        inverse = self.a + self.b * tangents
        ahead = inverse > 0.0
        return np.where(ahead, 1.0 / np.where(ahead, inverse, 1.0), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class LineFit:
    """A line, how well it is known, and the columns it is made of.

    Attributes
    ----------
    line : the maximum-likelihood line
    covariance : of (a, b), (2, 2) [1/m²], the frame's common error included
    inliers : which of the columns given are part of it, (N,)
    rms : root mean square of their residuals over sigma, near 1 if the noise model is right
    """

    line: Line
    covariance: Array
    inliers: NDArray[np.bool_]
    rms: float


def fit_line(tangents: Array, depths: Array, noise: DepthNoise) -> LineFit | None:
    r"""Robust maximum-likelihood line through columns of one surface.

    The start is the pair of columns whose line leaves the least sum of truncated squares
    [TorrZisserman2000]_; of all pairs those are tried that are half of the surface apart, in
    a fixed order, so that the same frame gives the same fit. From there Gauss-Newton steps on

    .. math:: \sum_i \frac{(z_i - 1/(a + b\tau_i))^2}{\sigma(z_i)^2}

    over the columns within 3.5 sigma, until these and the line stay the same.

    Parameters
    ----------
    tangents, depths : of the columns, (N,), finite
    noise : of the depths

    Returns
    -------
    The fit, or None if no line has three of the columns. Degenerate for a board seen edge-on,
    which fills no columns.
    """
    line = _consensus(tangents, depths, noise)
    if line is None:
        return None
    inliers = _near(line, tangents, depths, noise)
    for _ in range(ROUNDS):
        if inliers.sum() < LEAST:
            return None
        new = _gauss_newton(line, tangents[inliers], depths[inliers], noise)
        step = math.dist(new, line)
        line, before = new, inliers
        inliers = _near(line, tangents, depths, noise)
        if step * line.distance <= CONVERGED and bool(np.all(inliers == before)):
            break
    if inliers.sum() < LEAST:
        return None
    covariance, residuals = _information(line, tangents[inliers], depths[inliers], noise)
    if covariance is None:
        return None
    return LineFit(line, covariance, inliers, float(np.sqrt(np.mean(residuals**2))))


def _near(line: Line, tangents: Array, depths: Array, noise: DepthNoise) -> NDArray[np.bool_]:
    expected = line.depths(tangents)
    with np.errstate(invalid="ignore"):
        return np.abs(depths - expected) <= SIGMAS * noise.sigma(expected)


def _consensus(tangents: Array, depths: Array, noise: DepthNoise) -> Line | None:
    n = len(depths)
    if n < LEAST:
        return None
    inverse = 1.0 / depths
    first, second = np.arange(n - n // 2), np.arange(n // 2, n)
    b = (inverse[second] - inverse[first]) / (tangents[second] - tangents[first])
    a = inverse[first] - b * tangents[first]
    # Inverse depth has the sigma of the depth over its square.
    residuals = inverse - (a[:, None] + b[:, None] * tangents)
    scaled = residuals / (noise.sigma(depths) * inverse * inverse)
    cost = np.minimum(scaled * scaled, SIGMAS * SIGMAS).sum(axis=1)
    best = int(np.argmin(cost))
    return Line(float(a[best]), float(b[best]))


def _gauss_newton(line: Line, tangents: Array, depths: Array, noise: DepthNoise) -> Line:
    """One step to the least weighted squares of depth; weights are those of the old line."""
    expected = line.depths(tangents)
    weight = 1.0 / noise.sigma(expected)
    scale = -expected * expected * weight
    slope = np.column_stack((scale, scale * tangents))
    step, *_ = np.linalg.lstsq(slope, (depths - expected) * weight, rcond=None)
    return Line(line.a + float(step[0]), line.b + float(step[1]))


def _information(
    line: Line, tangents: Array, depths: Array, noise: DepthNoise
) -> tuple[Array | None, Array]:
    """Covariance of (a, b), None where columns coincide, and the residuals over sigma.

    With the gain K of the weighted fit, white noise gives (J'WJ)⁻¹ and an error s shared by all
    columns adds s² (K1)(K1)'.
    """
    expected = line.depths(tangents)
    weight = 1.0 / noise.sigma(expected)
    scale = -expected * expected * weight
    slope = np.column_stack((scale, scale * tangents))
    residuals = (depths - expected) * weight
    information = slope.T @ slope
    if not np.linalg.det(information) > 0.0:
        return None, residuals
    inverse = np.linalg.inv(information)
    shared = inverse @ (slope.T @ weight) * noise.common
    return inverse + np.outer(shared, shared), residuals
