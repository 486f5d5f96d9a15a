r"""The robot's footprint as a capsule: all that is within a radius of a segment of its axis.

The segment runs from :math:`(-b, 0)` to :math:`(f, 0)` in the robot frame. A capsule is what
keeps distances smooth: the distance to a convex segment has a gradient everywhere off it, of
unit length, so a barrier made of it has one gain everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Point

__all__ = ["CLEAR_ALONE", "CLEAR_BEHIND", "CLEAR_FORWARD", "Array", "Capsule", "Nearest"]

Array = NDArray[np.float64]

CLEAR_ALONE = 0.55
"""[m] Safety distance of the robot without a trolley [Xie2024]_."""

CLEAR_FORWARD = 1.3
"""[m] Safety distance ahead of the robot that holds a trolley [Xie2024]_."""

CLEAR_BEHIND = 0.55
"""[m] Safety distance behind the robot that holds a trolley [Xie2024]_."""


class Nearest(NamedTuple):
    """Where obstacles come closest to the axis of a capsule; arrays of one shape.

    Attributes
    ----------
    distance : from the axis to the nearest point of each obstacle [m], at least 0
    n_x, n_y : unit vector from the axis to that point; (0, 0) where the distance is 0
    x, y : that point, in the robot frame [m]
    """

    distance: Array
    n_x: Array
    n_y: Array
    x: Array
    y: Array


@dataclass(frozen=True, slots=True)
class Capsule:
    r"""A footprint: the points within ``radius`` of the segment from (-back, 0) to (front, 0).

    Attributes
    ----------
    radius : [m], positive
    front, back : how far the axis reaches ahead of the rotation centre and behind it [m];
        ``front >= -back``, and with both 0 the capsule is a disc

    Raises
    ------
    ConfigurationError : the radius is not positive, or the axis runs backward
    """

    radius: float
    front: float = 0.0
    back: float = 0.0

    def __post_init__(self) -> None:
        check_positive("radius", self.radius)
        if not 0.0 <= self.front + self.back < math.inf:
            raise ConfigurationError(
                "the axis must run from -back to front with front >= -back, got "
                f"front={self.front!r}, back={self.back!r}"
            )

    @classmethod
    def without_trolley(cls) -> Capsule:
        """The paper's robot alone, a disc of its safety distance [Xie2024]_."""
        return cls(CLEAR_ALONE)

    @classmethod
    def with_trolley(cls) -> Capsule:
        """The paper's robot with a trolley ahead of it.

        Clear by its two safety distances on the axis [Xie2024]_; to the sides, where it gives
        none, by the smaller of them.
        """
        return cls(CLEAR_BEHIND, front=CLEAR_FORWARD - CLEAR_BEHIND)

    @property
    def lever(self) -> float:
        """Distance from the rotation centre to the farthest point of the axis [m]."""
        return max(abs(self.front), abs(self.back))

    def clearance(self, point: Point, radius: float = 0.0) -> float:
        """Signed distance from the footprint to a disc; a point where ``radius`` is 0 [m].

        Negative inside, where it is minus the depth of the penetration.

        Raises
        ------
        GeometryError : the point or the radius is not finite
        """
        check_finite("disc", point, (radius,))
        return float(self.to_points(*_columns(point)).distance[0]) - self.radius - radius

    def gradient(self, point: Point) -> Point:
        """Gradient of :meth:`clearance` with respect to the point: the unit vector away.

        Degenerate on the axis, where there is no direction away and it is (0, 0).

        Raises
        ------
        GeometryError : the point is not finite
        """
        check_finite("point", point)
        nearest = self.to_points(*_columns(point))
        return float(nearest.n_x[0]), float(nearest.n_y[0])

    def wall_clearance(self, start: Point, end: Point, radius: float = 0.0) -> float:
        """Signed distance from the footprint to a wall, a segment ``radius`` thick to each side.

        A wall that crosses the axis is ``-self.radius - radius`` away [m].

        Raises
        ------
        GeometryError : an end or the radius is not finite
        """
        check_finite("wall", start, end, (radius,))
        wall = (*_columns(start), *_columns(end))
        ends = self.to_points(np.array([start[0], end[0]]), np.array([start[1], end[1]]))
        sides = self.to_segments(*wall)
        nearest = min(float(ends.distance.min()), float(sides.distance.min()))
        if bool(self.crossed_by(*wall)[0]):
            nearest = 0.0
        return nearest - self.radius - radius

    def to_points(self, x: Array, y: Array) -> Nearest:
        r"""The axis to points :math:`(x, y)` of the robot frame, arrays of any one shape.

        With the foot :math:`q = (\mathrm{clip}(x, -b, f), 0)` the distance is
        :math:`|p - q|` and the unit vector :math:`(p - q)/|p - q|`.
        """
        along = x - np.minimum(np.maximum(x, -self.back), self.front)
        return _nearest(along, y, x, y)

    def to_segments(self, x0: Array, y0: Array, x1: Array, y1: Array) -> Nearest:
        """The two ends of the axis to segments; a first dimension of 2, front and back, is added.

        With the four ends-to-other-segment distances of :meth:`to_points` for the segments'
        own ends this makes the distance of two segments that do not cross.
        """
        ends = np.array([self.front, -self.back] if self.front + self.back else [self.front])
        q_x = ends.reshape((-1,) + (1,) * np.ndim(x0))
        along_x, along_y = x1 - x0, y1 - y0
        square = along_x * along_x + along_y * along_y
        share = (along_x * (q_x - x0) - along_y * y0) / np.where(square > 0.0, square, 1.0)
        share = np.minimum(np.maximum(share, 0.0), 1.0)
        x, y = x0 + share * along_x, y0 + share * along_y
        return _nearest(x - q_x, y, x, y)

    def crossed_by(self, x0: Array, y0: Array, x1: Array, y1: Array) -> NDArray[np.bool_]:
        """Which segments meet the axis, one that merely touches it included."""
        opposite = y0 * y1 <= 0.0
        apart = np.abs(y1 - y0)
        flat = apart == 0.0
        at = (x0 * np.abs(y1) + x1 * np.abs(y0)) / np.where(flat, 1.0, apart)
        low = np.where(flat, np.minimum(x0, x1), at)
        high = np.where(flat, np.maximum(x0, x1), at)
        return np.asarray(opposite & (low <= self.front) & (high >= -self.back))


def _nearest(d_x: Array, d_y: Array, x: Array, y: Array) -> Nearest:
    distance = np.sqrt(d_x * d_x + d_y * d_y)
    inverse = 1.0 / np.where(distance > 0.0, distance, 1.0)
    return Nearest(distance, d_x * inverse, d_y * inverse, x, y)


def _columns(point: Point) -> tuple[Array, Array]:
    return np.array([point[0]]), np.array([point[1]])
