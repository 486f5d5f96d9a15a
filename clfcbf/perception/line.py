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
CONVERGED = 1e-6
"""Relative step at which a fit has settled: a micrometre at a metre, and the next one far less."""
LEAST = 3
"""Columns of a fit with any residual at all."""
STARTS = 48
"""Most pairs tried: were half of the columns outliers, one in a million fits would find no pair."""


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
        if inverse.size and float(inverse.min()) > 0.0:
            return np.asarray(1.0 / inverse)
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
    [TorrZisserman2000]_; the pairs tried are half of the surface apart and spread evenly over
    it, in a fixed order, so that the same frame gives the same fit. From there Gauss-Newton
    steps on

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
    now = _Residuals.of(line, tangents, depths, noise)
    for _ in range(ROUNDS):
        normal = _Normal.of(now, tangents)
        if normal is None:
            return None
        a, b = normal.solved(now.scaled[now.inliers])
        line, step, before = Line(line.a + a, line.b + b), math.hypot(a, b), now.inliers
        now = _Residuals.of(line, tangents, depths, noise)
        if step * line.distance <= CONVERGED and np.array_equal(now.inliers, before):
            break
    normal = _Normal.of(now, tangents)
    if normal is None:
        return None
    inliers = now.inliers
    rms = math.sqrt(float(np.mean(now.scaled[inliers] ** 2)))
    return LineFit(line, normal.covariance(now.weight[inliers], noise.common), inliers, rms)


def _consensus(tangents: Array, depths: Array, noise: DepthNoise) -> Line | None:
    n = len(depths)
    if n < LEAST:
        return None
    inverse = 1.0 / depths
    pairs = n - n // 2
    first = np.arange(pairs)
    if pairs > STARTS:
        first = first[:: -(-pairs // STARTS)]
    second = first + n // 2
    b = (inverse[second] - inverse[first]) / (tangents[second] - tangents[first])
    a = inverse[first] - b * tangents[first]
    # Inverse depth has the sigma of the depth over its square.
    weight = 1.0 / (noise.sigma(depths) * inverse * inverse)
    scaled = (inverse - a[:, None] - b[:, None] * tangents) * weight
    cost = np.minimum(scaled * scaled, SIGMAS * SIGMAS).sum(axis=1)
    best = int(np.argmin(cost))
    return Line(float(a[best]), float(b[best]))


class _Residuals(NamedTuple):
    """Columns against a line: ``weight`` is one over sigma, ``scaled`` the residuals times that.

    All (N,); where the line is behind the camera the column is no inlier, and NaN.
    """

    expected: Array
    weight: Array
    scaled: Array
    inliers: NDArray[np.bool_]

    @classmethod
    def of(cls, line: Line, tangents: Array, depths: Array, noise: DepthNoise) -> _Residuals:
        expected = line.depths(tangents)
        weight = 1.0 / noise.sigma(expected)
        scaled = (depths - expected) * weight
        with np.errstate(invalid="ignore"):
            inliers = np.abs(scaled) <= SIGMAS
        return cls(expected, weight, scaled, inliers)


class _Normal(NamedTuple):
    r"""The normal equations of one Gauss-Newton step over the inliers.

    The residual's slope is :math:`s_i(1, \tau_i)` with :math:`s_i = -z_i^2/\sigma_i`. With
    tangents taken from their mean :math:`m`, weighted by :math:`s_i^2`, the equations are
    diagonal: ``size`` :math:`A = \sum s_i^2`, ``spread`` :math:`C = \sum s_i^2(\tau_i-m)^2`, and

    .. math::
        (J^\top J)^{-1} = \begin{pmatrix} 1/A + m^2/C & -m/C \\ -m/C & 1/C \end{pmatrix} .

    ``slope`` holds the :math:`-s_i`, ``about`` the same times :math:`\tau_i - m`, (N,) of the
    inliers.
    """

    size: float
    mean: float
    spread: float
    slope: Array
    about: Array

    @classmethod
    def of(cls, at: _Residuals, tangents: Array) -> _Normal | None:
        """None of fewer than three inliers, or of such that coincide."""
        inliers = at.inliers
        if np.count_nonzero(inliers) < LEAST:
            return None
        expected, tau = at.expected[inliers], tangents[inliers]
        slope = expected * expected * at.weight[inliers]
        size = float(slope @ slope)
        mean = float(slope @ (slope * tau)) / size
        about = slope * (tau - mean)
        spread = float(about @ about)
        return cls(size, mean, spread, slope, about) if spread > 0.0 else None

    def solved(self, residuals: Array) -> tuple[float, float]:
        """The change of (a, b) that is best for these scaled residuals of the inliers."""
        b = -float(self.about @ residuals) / self.spread
        return -float(self.slope @ residuals) / self.size - self.mean * b, b

    def covariance(self, weight: Array, common: float) -> Array:
        """Covariance of (a, b): white noise, and the frame's ``common`` error [m].

        One metre in every column changes the scaled residuals by ``weight``.
        """
        m, c = self.mean, self.spread
        white = np.array([[1.0 / self.size + m * m / c, -m / c], [-m / c, 1.0 / c]])
        shared = np.array(self.solved(weight)) * common
        return np.asarray(white + shared[:, None] * shared)
