r"""The view of a camera whose edges are unequal, or which a part of the robot cuts.

Any number of half-planes, each of them an :class:`~clfcbf.constraints.cbf.Edge`, and the feature
in all of them: the centre, both ends of its width, or every point of the region in which it may
be. Clearances are distances to the edges [m], which do not ask for a common apex.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.cbf import Edge, half_plane_rows
from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.robust import sector_polygon, vertex_rows
from clfcbf.constraints.rows import Rows
from clfcbf.constraints.swept import ROUNDING, Bundle, Grid, Seen, least_along
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.scene import Scene
from clfcbf.se2 import Point, Pose2, is_finite

__all__ = ["ViewBarrier"]

_RIGHT_ANGLE = 0.5 * math.pi


@dataclass(frozen=True, slots=True)
class ViewBarrier:
    r"""Keeps the feature between a left and a right edge, and inside of further cuts.

    Attributes
    ----------
    camera : pose of the camera in the robot frame [m, m, rad]; its heading is only what the
        two angles are counted from
    left, right : angles from the camera's heading to its left edge, counter-clockwise, and to
        its right edge, clockwise [rad]; each in (-pi/2, pi/2), their sum positive
    gain : class-K gain :math:`\lambda` [1/s], see ``edge_rows``
    cuts : edges of robot parts that stand in the view, in the robot frame
    width : extent of the feature across its heading that is kept in view [m]
    bearing_error, range_error : bounds of the errors of the feature as seen from the camera
        [rad, m]; all points within them are kept, see ``sector_polygon``
    margin : by which left and right edge are turned in [rad], at least 0
    setback : by which all edges are moved in [m], at least 0; the only reserve of the cuts
    name : prefix of the rows' names

    Raises
    ------
    ConfigurationError : a number out of its range, or nothing left of the view

    Notes
    -----
    On an arc the feature's bearing off the forward direction is largest at an end, so for edges
    that have that direction inside, the ends of an arc answer for it. For others (a camera that
    looks aside, a cut) they do not. Here no edge is asked for it: the arcs themselves are
    bounded, by tangents (``clfcbf.constraints.swept``).
    """

    camera: Pose2
    left: float
    right: float
    gain: float
    cuts: tuple[Edge, ...] = ()
    width: float = 0.0
    bearing_error: float = 0.0
    range_error: float = 0.0
    margin: float = 0.0
    setback: float = 0.0
    name: str = "view"
    _edges: tuple[Edge, ...] = field(init=False, repr=False, compare=False)
    _names: tuple[str, ...] = field(init=False, repr=False, compare=False)
    _front: Edge = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_positive("gain", self.gain)
        if not is_finite(tuple(self.camera)):
            raise ConfigurationError(f"camera pose must be finite, got {self.camera!r}")
        for name in ("left", "right"):
            angle = getattr(self, name)
            if not -_RIGHT_ANGLE < angle < _RIGHT_ANGLE:
                raise ConfigurationError(
                    f"{name} must be in (-pi/2, pi/2) rad, got {angle!r}; for degrees use "
                    "math.radians(...)"
                )
        for name in ("width", "range_error", "margin", "setback"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"{name} must be finite and at least 0, got {value!r}")
        if not 0.0 <= self.bearing_error < _RIGHT_ANGLE:
            raise ConfigurationError(
                f"bearing_error must be in [0, pi/2) rad, got {self.bearing_error!r}"
            )
        opening = self.left + self.right - 2.0 * (self.margin + self.bearing_error)
        if not opening > 0.0:
            raise ConfigurationError(
                "left + right must exceed twice margin + bearing_error, or nothing is left of the "
                f"view: got left={self.left!r}, right={self.right!r}, margin={self.margin!r}, "
                f"bearing_error={self.bearing_error!r}"
            )
        x, y, yaw = self.camera
        sides = (
            Edge.through((x, y), yaw + self.left - self.margin, inward=-1.0),
            Edge.through((x, y), yaw - self.right + self.margin, inward=+1.0),
        )
        edges = []
        for edge in (*sides, *self.cuts):
            if not (is_finite(tuple(edge)) and abs(math.hypot(edge[0], edge[1]) - 1.0) < 1e-9):
                raise ConfigurationError(f"cuts need finite unit normals, got {edge!r}")
            edges.append(Edge(edge[0], edge[1], edge[2] + self.setback))
        names = ("left", "right", *(f"cut{i}" for i in range(len(self.cuts))))
        object.__setattr__(self, "_edges", tuple(edges))
        object.__setattr__(self, "_front", Edge.through((x, y), yaw - _RIGHT_ANGLE, inward=1.0))
        object.__setattr__(self, "_names", tuple(f"{self.name}.{name}" for name in names))

    @property
    def bare(self) -> ViewBarrier:
        """The same without margin and setback."""
        return replace(self, margin=0.0, setback=0.0)

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The edges that are kept: left, right and the cuts, turned and moved inward."""
        return self._edges

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """Rows of all that is kept, before each edge; values h [m].

        Named "view.left", "view.right", "view.cut0" and so on; where several points are kept,
        with the number of the point behind, and only those that can ask for most.

        Raises
        ------
        GeometryError : the feature or the motion is not finite, or a width has no heading
        """
        points = self._points(scene[1])
        if motion is not None:
            check_finite("motion", motion)
            points = tuple([motion.seen(point) for point in points])
        if len(points) == 1:
            return half_plane_rows(self._names, self._edges, points, self.gain)
        return vertex_rows(self._names, self._edges, points, self.gain)

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Distance from the deepest point that is kept to the nearest edge [m].

        Negative outside. Minus infinity behind the camera, from where turning to one edge is
        turning from the other.

        Raises
        ------
        GeometryError : as ``rows``
        """
        check_finite("motion", motion)
        least, ahead = self._least(self._points(scene[1]), motion)
        return least if ahead > 0.0 else -math.inf

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        """A lower bound of the clearance at any pose of the sweep [m], see ``least_along``."""
        check_finite("motion", sweep[0])
        points = self._points(scene[1])
        start, budget = sweep[0], self._budget(sweep, points)
        least, ahead = self._least(points, start)
        if least > budget:
            return least - budget
        reach = max(math.dist(point, start[:2]) for point in points) + sweep[6]
        bound = least_along(sweep, (Bundle(_look(points, self._edges), reach),), sweep[7])
        bound = max(bound, least - budget)
        # Inside all edges is ahead of the camera; elsewhere it may be carried behind.
        if bound > 2.0 * ROUNDING or ahead > budget:
            return bound
        front = Bundle(_look(points, (self._front,)), reach)
        return bound if least_along(sweep, (front,), sweep[7]) > 2.0 * ROUNDING else -math.inf

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        """Clearance at the sweep's start, and that less the most its points can move [m]."""
        check_finite("motion", sweep[0])
        points = self._points(scene[1])
        least, ahead = self._least(points, sweep[0])
        budget = self._budget(sweep, points)
        here = least if ahead > 0.0 else -math.inf
        return here, (here - budget if ahead > budget else -math.inf)

    def _points(self, feature: Pose2) -> tuple[Point, ...]:
        """What is kept in view: the feature, its ends, or polygons around where they may be."""
        x, y = feature[0], feature[1]
        check_finite("feature", (x, y))
        points: tuple[Point, ...] = ((x, y),)
        if self.width > 0.0:
            if len(feature) < 3 or not math.isfinite(feature[2]):
                raise GeometryError(
                    f"a feature of width {self.width!r} m needs a finite heading, got {feature!r}"
                )
            half = 0.5 * self.width
            d_x, d_y = -half * math.sin(feature[2]), half * math.cos(feature[2])
            points = ((x + d_x, y + d_y), (x - d_x, y - d_y))
        if not self.bearing_error and not self.range_error:
            return points
        centre, errors = self.camera[:2], (self.bearing_error, self.range_error)
        polygons = [sector_polygon(point, centre, *errors) for point in points]
        return tuple([vertex for polygon in polygons for vertex in polygon])

    def _least(self, points: tuple[Point, ...], motion: Pose2) -> tuple[float, float]:
        """The smallest distance to an edge, and how far ahead of the camera all points are."""
        front_x, front_y, behind = self._front
        least = ahead = math.inf
        for point in points:
            p_x, p_y = motion.seen(point)
            ahead = min(ahead, front_x * p_x + front_y * p_y - behind)
            for n_x, n_y, offset in self._edges:
                least = min(least, n_x * p_x + n_y * p_y - offset)
        return least, ahead

    def _budget(self, sweep: Sweep, points: tuple[Point, ...]) -> float:
        """The most by which a point moves in the robot frame over a sweep [m]."""
        start = sweep[0][:2]
        reach = max(math.dist(point, start) for point in points) + sweep[6]
        return sweep[6] + reach * sweep[5] + sweep[7]


def _look(points: tuple[Point, ...], edges: tuple[Edge, ...]) -> Callable[[Grid], Seen]:
    """Distances of all points to all edges, which are linear in the points."""
    x, y = np.array(points).T

    def look(grid: Grid) -> Seen:
        at_x, at_y = grid.seen(x, y)
        flat = np.zeros_like(at_x)
        values = [n_x * at_x + n_y * at_y - offset for n_x, n_y, offset in edges]
        return Seen(
            np.concatenate(values, axis=-1),
            np.concatenate([flat + edge[0] for edge in edges], axis=-1),
            np.concatenate([flat + edge[1] for edge in edges], axis=-1),
            np.concatenate([at_x] * len(edges), axis=-1),
            np.concatenate([at_y] * len(edges), axis=-1),
        )

    return look
