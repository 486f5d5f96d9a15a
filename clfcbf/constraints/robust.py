r"""Rows for a feature that is known only to lie in a set, and how large that set is.

A row of a half-plane, :math:`-n_xv + (n_xy - n_yx)\,\omega + \lambda(n^\top p - d) \ge 0`, is
affine in the point :math:`p`. It holds on a convex polygon when it holds at the vertices, so a
polygon *around* the set of possible points makes the rows exact for the polygon and safe for
the set, with linear rows only. The second-order cone of a ball of errors [Dean2020]_ is not
needed.

How deep the feature is in view is decided by the deepest vertex alone. The rows are not: which
vertex asks for most depends on the turn rate, which carries far points faster than near ones.
:func:`binding` keeps those that do for some turn rate.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.cbf import Edge
from clfcbf.constraints.checks import check_finite
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.scene import Covariance
from clfcbf.se2 import Point

__all__ = [
    "Inflation",
    "ReckoningNoise",
    "binding",
    "ellipse_polygon",
    "margin_of",
    "reckoned_covariance",
    "sector_polygon",
    "vertex_rows",
]

Line = tuple[float, float]
"""``(intercept, slope)`` of a function of the turn rate."""


class Inflation(NamedTuple):
    """By how much a view is to shrink: edges turned in [rad] and moved in [m]."""

    margin: float
    setback: float


class ReckoningNoise(Protocol):
    """Standard deviations of dead reckoning, of :class:`clfcbf.estimation.NoiseModel`."""

    @property
    def along(self) -> float:
        """Of the way travelled, relative."""

    @property
    def across(self) -> float:
        """Sideways, relative to the way travelled."""

    @property
    def turn(self) -> float:
        """Of the angle turned, relative."""

    @property
    def drift(self) -> float:
        """Of the heading, by time [rad/s]."""


def sector_polygon(
    point: Point, centre: Point, bearing_error: float, range_error: float
) -> tuple[Point, Point, Point, Point]:
    r"""Four vertices around all points of bearing and range within the errors.

    The chord of the inner arc lies nearer to the centre than the arc; the outer side is the
    tangent in the middle of the outer arc, whose ends are at :math:`\rho_{hi}/\cos\varepsilon`.

    Parameters
    ----------
    point : estimate of the feature [m]
    centre : what bearing and range are measured from, such as the camera [m]
    bearing_error : :math:`\varepsilon` [rad], in [0, pi/2)
    range_error : [m], at least 0; ranges below 0 do not count

    Raises
    ------
    GeometryError : point or centre is not finite
    ConfigurationError : an error is out of its range
    """
    check_finite("point and centre", point, centre)
    if not 0.0 <= bearing_error < 0.5 * math.pi:
        raise ConfigurationError(f"bearing_error must be in [0, pi/2) rad, got {bearing_error!r}")
    if not 0.0 <= range_error < math.inf:
        raise ConfigurationError(f"range_error must be finite and at least 0, got {range_error!r}")
    d_x, d_y = point[0] - centre[0], point[1] - centre[1]
    rho = math.hypot(d_x, d_y)
    near = max(rho - range_error, 0.0)
    far = (rho + range_error) / math.cos(bearing_error)
    middle = math.atan2(d_y, d_x)

    def at(distance: float, bearing: float) -> Point:
        return centre[0] + distance * math.cos(bearing), centre[1] + distance * math.sin(bearing)

    left, right = middle + bearing_error, middle - bearing_error
    return at(near, right), at(far, right), at(far, left), at(near, left)


def ellipse_polygon(
    point: Point, covariance: Covariance, confidence: float, sides: int = 8
) -> tuple[Point, ...]:
    r"""Vertices around the ellipse in which the position lies with probability ``confidence``.

    The ellipse of a normal distribution, :math:`e^\top P^{-1}e \le -2\ln(1 - c)` (chi-square
    with two degrees of freedom), inside a polygon of ``sides`` tangents to it.

    Raises
    ------
    ConfigurationError : the confidence is not in (0, 1), or fewer than 3 sides
    GeometryError : the point is not finite, or the covariance not one
    """
    check_finite("point", point)
    if sides < 3:
        raise ConfigurationError(f"sides must be at least 3, got {sides!r}")
    values, axes = _position_axes(covariance)
    radius = _position_quantile(confidence) / math.cos(math.pi / sides)
    scaled = axes * (radius * np.sqrt(values))
    vertices = []
    for side in range(sides):
        angle = 2.0 * math.pi * side / sides
        x, y = scaled @ (math.cos(angle), math.sin(angle))
        vertices.append((point[0] + float(x), point[1] + float(y)))
    return tuple(vertices)


def vertex_rows(
    names: tuple[str, ...],
    edges: tuple[Edge, ...],
    vertices: tuple[Point, ...],
    gain: float,
    turn_rate: float = math.inf,
) -> Rows:
    r"""Rows of every edge that hold for every point of the polygon ``vertices``.

    Parameters
    ----------
    names : one an edge; the vertices' numbers are put behind, as in "fov.left.2"
    edges : half-planes that are kept
    vertices : of a polygon around the set of possible points, at rest [m]
    gain : class-K gain :math:`\lambda` [1/s]
    turn_rate : largest turn rate of any command [rad/s]; vertices that ask for most only
        beyond it are left out

    Returns
    -------
    Rows of priority SAFETY, values :math:`n^\top p - d` [m]; none that another makes idle
    """
    kept: list[str] = []
    coefficients: list[Row] = []
    values: list[float] = []
    for name, (n_x, n_y, offset) in zip(names, edges, strict=True):
        depths = [n_x * x + n_y * y - offset for x, y in vertices]
        slopes = [n_x * y - n_y * x for x, y in vertices]
        lines = [(gain * h, slope) for h, slope in zip(depths, slopes, strict=True)]
        for index in binding(lines, turn_rate):
            kept.append(f"{name}.{index}")
            coefficients.append((n_x, -slopes[index], lines[index][0]))
            values.append(depths[index])
    return Rows(tuple(kept), tuple(coefficients), Priority.SAFETY, tuple(values))


def binding(lines: list[Line], bound: float = math.inf) -> list[int]:
    r"""Which lines :math:`a_i + b_i\omega` are the lowest for some :math:`|\omega| \le` ``bound``.

    The lower envelope, from the steepest line on; of equal lines the first.
    """
    order = sorted(range(len(lines)), key=lambda i: (-lines[i][1], lines[i][0], i))
    hull: list[int] = []
    for index in order:
        if hull and lines[hull[-1]][1] == lines[index][1]:
            continue
        while len(hull) >= 2 and _meet(lines, hull[-2], index) <= _meet(lines, *hull[-2:]):
            hull.pop()
        hull.append(index)
    while len(hull) >= 2 and _meet(lines, hull[0], hull[1]) <= -bound:
        hull.pop(0)
    while len(hull) >= 2 and _meet(lines, *hull[-2:]) >= bound:
        hull.pop()
    return hull


def margin_of(
    covariance: Covariance, confidence: float, target_speed: float = 0.0, age: float = 0.0
) -> Inflation:
    r"""Margin and setback that hold with probability ``confidence`` at least.

    The heading is within :math:`\pm z\sigma_\theta` (normal, two-sided) and the position within
    :math:`\sqrt{-2\ln(1 - c')}\,\sigma_{max}` (chi-square with two degrees of freedom, in the
    disc around the ellipse), each with probability :math:`c' = (1 + c)/2`, so that both hold
    with :math:`c`, correlated or not. A target that may move adds ``target_speed * age``. For
    errors that are normal; a bias is not in a covariance.

    Parameters
    ----------
    covariance : of the feature's position and of the heading by which all that is seen may be
        turned about the camera, (x, y, theta) [m², m rad, rad²]
    confidence : c in (0, 1), of one instant, not of a whole run
    target_speed : largest speed of the feature over ground [m/s]
    age : of what is known about it [s]

    Returns
    -------
    ``margin`` [rad] and ``setback`` [m] of :class:`clfcbf.constraints.cbf.FieldOfViewBarrier`

    Raises
    ------
    ConfigurationError : the confidence is not in (0, 1); speed or age negative or not finite
    GeometryError : the covariance is not finite, or a variance negative
    """
    for name, value in (("target_speed", target_speed), ("age", age)):
        if not 0.0 <= value < math.inf:
            raise ConfigurationError(f"{name} must be finite and at least 0, got {value!r}")
    if not 0.0 < confidence < 1.0:
        raise ConfigurationError(f"confidence must be in (0, 1), got {confidence!r}")
    each = 0.5 * (1.0 + confidence)
    radius = _position_quantile(each)
    values, _ = _position_axes(covariance)
    variance = covariance[2][2]
    if not 0.0 <= variance < math.inf:
        raise GeometryError(f"variance of the heading must be at least 0, got {variance!r}")
    quantile = NormalDist().inv_cdf(0.5 * (1.0 + each))
    setback = radius * math.sqrt(float(values.max())) + target_speed * age
    return Inflation(quantile * math.sqrt(variance), setback)


def reckoned_covariance(
    covariance: Covariance,
    feature: Point,
    travelled: float,
    turned: float,
    age: float,
    noise: ReckoningNoise,
) -> Covariance:
    r"""Covariance of a feature at rest after dead reckoning for ``age`` seconds.

    .. math::
        P + G\,\mathrm{diag}\big((\sigma_as)^2, (\sigma_cs)^2,
        (\sigma_t\vartheta)^2 + (\sigma_d\,t)^2\big)G^\top, \qquad
        G = \begin{pmatrix}1 & 0 & -y\\ 0 & 1 & x\\ 0 & 0 & 1\end{pmatrix}

    for a way :math:`s`, an angle :math:`\vartheta` and a time :math:`t`. The errors are taken to
    be one scale for all of the time, the worst case: in steps with errors of their own they
    grow less. What a turn does to a far feature is in the lever :math:`(-y, x)`.

    Parameters
    ----------
    covariance : at the measurement, (x, y, theta) in the robot frame
    feature : where the feature is, in the same axes, seen from the robot [m]
    travelled, turned, age : way [m], angle [rad] and time [s] since, all at least 0; a bound of
        each will do, such as the largest speed times the age
    noise : of the reckoning
    """
    along, across = (noise.along * travelled) ** 2, (noise.across * travelled) ** 2
    heading = (noise.turn * turned) ** 2 + (noise.drift * age) ** 2
    lever = np.array([[1.0, 0.0, -feature[1]], [0.0, 1.0, feature[0]], [0.0, 0.0, 1.0]])
    grown = np.array(covariance) + lever @ np.diag([along, across, heading]) @ lever.T
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = grown.tolist()
    return ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))


def _meet(lines: list[Line], first: int, second: int) -> float:
    """Where two lines of different slope meet."""
    (a, b), (c, d) = lines[first], lines[second]
    return (c - a) / (b - d)


def _position_quantile(confidence: float) -> float:
    """Mahalanobis radius of a plane normal distribution: root of chi-square, two degrees."""
    if not 0.0 < confidence < 1.0:
        raise ConfigurationError(f"confidence must be in (0, 1), got {confidence!r}")
    return math.sqrt(-2.0 * math.log1p(-confidence))


def _position_axes(covariance: Covariance) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Variances along the axes of the position's ellipse, and the axes as columns."""
    matrix = np.array([covariance[0][:2], covariance[1][:2]], dtype=float)
    if not np.isfinite(matrix).all():
        raise GeometryError(f"covariance must be finite, got {covariance!r}")
    values, axes = np.linalg.eigh(matrix)
    if values[0] < -1e-9 * abs(values[1]):
        raise GeometryError(f"covariance must have no negative variance, got {covariance!r}")
    return np.maximum(values, 0.0), axes
