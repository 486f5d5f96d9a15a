r"""What the robot must not touch: discs that may move, and walls, in one frame.

Stored as columns of numbers, so that a thousand of them cost a few array operations a tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf.errors import GeometryError
from clfcbf.se2 import Pose2

__all__ = ["FARTHEST", "Array", "Columns", "Disc", "Obstacles", "Wall"]

Array = NDArray[np.float64]

FARTHEST = 1e9
"""[m, m/s] Larger numbers count as not finite: no robot is there, and squares cannot overflow."""


class Disc(NamedTuple):
    """A round obstacle: centre and radius [m], and velocity over ground in the set's axes [m/s]."""

    x: float
    y: float
    radius: float
    v_x: float = 0.0
    v_y: float = 0.0


class Wall(NamedTuple):
    """A straight wall at rest from one point to another, ``radius`` thick to each side [m]."""

    x0: float
    y0: float
    x1: float
    y1: float
    radius: float = 0.0


class Columns(NamedTuple):
    """Obstacles as columns: points that may move, and segments at rest.

    Attributes
    ----------
    points : ``(x, y, radius)`` of each disc's centre and each wall's ends, shape (3, k)
    velocities : of these points, shape (2, k) [m/s]
    edges : ``(x0, y0, x1, y1, radius)`` of the walls, shape (5, m)
    speeds : of the points, shape (k,) [m/s]
    discs : how many of the points are discs, the first ones
    """

    points: Array
    velocities: Array
    edges: Array
    speeds: Array
    discs: int

    def seen_in(self, frame: Pose2) -> Columns:
        """The same in the parent of ``frame``, in which they are given."""
        points, edges = self.points.copy(), self.edges.copy()
        points[0], points[1] = _placed(frame, *self.points[:2])
        edges[0], edges[1] = _placed(frame, *self.edges[:2])
        edges[2], edges[3] = _placed(frame, *self.edges[2:4])
        velocities = np.array(_placed(Pose2(0.0, 0.0, frame[2]), *self.velocities))
        return Columns(points, velocities, edges, self.speeds, self.discs)

    def subset(self, points: NDArray[np.bool_], edges: NDArray[np.bool_]) -> Columns:
        """The points and edges where these are true."""
        return Columns(
            self.points[:, points],
            self.velocities[:, points],
            self.edges[:, edges],
            self.speeds[points],
            int(np.count_nonzero(points[: self.discs])),
        )

    def swept(self, duration: float, spread: float) -> Columns:
        """Columns at rest that cover all that the discs pass in ``duration`` [s].

        A disc that moves becomes the stadium from where it is to where it will be; each grows
        by ``spread`` times ``duration``.
        """
        grow = spread * duration
        moving = self.speeds > 0.0
        moves = duration > 0.0 and bool(moving.any())
        if not moves and not grow:
            return self
        points = self.points.copy()
        points[2, : self.discs] += grow
        edges = self.edges
        if moves:
            ends = points[:, moving]
            ends[:2] += duration * self.velocities[:, moving]
            paths = np.concatenate([points[:2, moving], ends])
            points = np.concatenate([points, ends], axis=1)
            edges = np.concatenate([edges, paths], axis=1)
        still = np.zeros((2, points.shape[1]))
        return Columns(points, still, edges, still[0], self.discs)


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    r"""A snapshot of obstacles, all in one frame.

    Attributes
    ----------
    discs : rows ``(x, y, radius, v_x, v_y)`` or :class:`Disc`, shape (n, 5)
    walls : rows ``(x0, y0, x1, y1, radius)`` or :class:`Wall`, shape (m, 5)
    columns : the same as columns, read only
    speed : largest speed of a disc [m/s]

    Raises
    ------
    GeometryError : a number is not finite, a radius negative, or a shape not the above
    """

    discs: ArrayLike = ()
    walls: ArrayLike = ()
    columns: Columns = field(init=False, repr=False)
    speed: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        discs, walls = _table("discs", self.discs, 2), _table("walls", self.walls, 4)
        edges = np.ascontiguousarray(walls.T)
        ends = [edges[[0, 1, 4]], edges[[2, 3, 4]]] if walls.size else []
        points = np.concatenate([discs.T[:3], *ends], axis=1)
        velocities = np.zeros((2, points.shape[1]))
        velocities[:, : len(discs)] = discs.T[3:]
        speeds = np.sqrt((velocities**2).sum(axis=0))
        for array in (discs, walls, edges, points, velocities, speeds):
            array.flags.writeable = False
        columns = Columns(points, velocities, edges, speeds, len(discs))
        object.__setattr__(self, "discs", discs)
        object.__setattr__(self, "walls", walls)
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "speed", float(speeds.max(initial=0.0)))

    @classmethod
    def from_points(cls, points: ArrayLike, radius: float) -> Obstacles:
        """Points at rest, such as those of a scan, shape (n, 2), each with one radius [m]."""
        xy = np.asarray(points, dtype=float).reshape(-1, 2)
        table = np.zeros((len(xy), 5))
        table[:, :2], table[:, 2] = xy, radius
        return cls(table)

    def __len__(self) -> int:
        return self.columns.discs + int(self.columns.edges.shape[1])

    def name(self, point: int) -> str:
        """What a column of the points is, such as "disc3" or "wall0.end"."""
        discs = self.columns.discs
        if point < discs:
            return f"disc{point}"
        end, wall = divmod(point - discs, self.columns.edges.shape[1])
        return f"wall{wall}.{'end' if end else 'start'}"

    def after(self, duration: float, spread: float = 0.0) -> Obstacles:
        """The discs moved on by ``duration`` [s]; each grown by ``spread`` [m/s] times that.

        For a measurement that is ``duration`` old: the velocities carry it on, and ``spread``
        bounds how far they can be wrong.
        """
        discs = np.array(self.discs)
        discs[:, :2] += duration * discs[:, 3:]
        discs[:, 2] += spread * duration
        return Obstacles(discs, self.walls)

    def seen_in(self, frame: Pose2) -> Obstacles:
        """The same obstacles in the parent of ``frame``, in which they are given."""
        points, velocities, edges, _, count = self.columns.seen_in(frame)
        discs = np.concatenate([points[:, :count], velocities[:, :count]])
        return Obstacles(discs.T, edges.T)

    def merged(self, others: Sequence[Obstacles]) -> Obstacles:
        """These and ``others``, all in the same frame."""
        sets = (self, *others)
        return Obstacles(
            np.concatenate([np.asarray(each.discs) for each in sets]),
            np.concatenate([np.asarray(each.walls) for each in sets]),
        )


def _placed(frame: Pose2, x: Array, y: Array) -> tuple[Array, Array]:
    """Points given in ``frame``, in its parent."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return frame[0] + c * x - s * y, frame[1] + s * x + c * y


def _table(name: str, rows: ArrayLike, radius: int) -> Array:
    """``rows`` as a new array of shape (n, 5), radii in column ``radius``."""
    try:
        table = np.array(rows, dtype=float)
    except (TypeError, ValueError) as error:
        raise GeometryError(f"{name} must be rows of five numbers, got {rows!r}") from error
    table = table.reshape(0, 5) if table.size == 0 else table
    if table.ndim != 2 or table.shape[1] != 5:
        raise GeometryError(f"{name} must have shape (n, 5), got {table.shape}")
    sound = (np.abs(table) < FARTHEST).all(axis=1) & (table[:, radius] >= 0.0)
    if not sound.all():
        wrong = table[~sound][0].tolist()
        raise GeometryError(f"{name} must be finite, radii at least 0 m, got {wrong}")
    return table
