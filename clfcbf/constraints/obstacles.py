r"""The barrier that keeps a capsule clear of discs, moving ones too, and of walls.

With :math:`p` the point of an obstacle nearest to the axis of the footprint and :math:`n` the
unit vector from the axis to it,

.. math::
    h = n^\top(p - q) - r - R - m, \qquad
    \dot h = -n_xv + (n_xp_y - n_yp_x)\,\omega + n^\top\dot p_{ext} \ge -\lambda h

for a footprint of radius :math:`R`, an obstacle of radius :math:`r` and a margin :math:`m`. The
foot :math:`q` on the axis is where the distance is smallest, so its own motion along the axis
does not count. A wall is its two ends before the axis, and the axis' two ends before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.capsule import Array, Capsule, Nearest
from clfcbf.constraints.checks import check_positive
from clfcbf.constraints.obstacle_set import FARTHEST, Columns, Obstacles
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.constraints.swept import ROUNDING, Bundle, Grid, Seen, least_along
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2

__all__ = ["MOST_ROWS", "STANDING", "Frame", "ObstacleBarrier", "Provider", "stopping_time"]

MOST_ROWS = 8
"""Rows in the program at most: a tick solves 8 in 7 us, and the guard looks at every obstacle."""

STANDING = 3.0
"""Lags after which a body that is told to stand counts as standing: 5 % of its speed is left."""

_SIDES = ("front", "back")

Provider: TypeAlias = Obstacles | Callable[[Scene], Obstacles]
"""Obstacles, or the function that gives those that belong to a scene."""


class Frame(Enum):
    """The frame in which obstacles are given."""

    ROBOT = "robot"
    """The robot's at the scene's stamp: what its own sensors see."""
    GOAL = "goal"
    """The scene's goal: what is known about the place of the dock, such as its walls."""


def stopping_time(sweep: Sweep) -> float:
    r"""Time after which a braking body counts as standing, :math:`2T_{eff} + 3\tau` [s].

    The brake of N ticks takes :math:`NT = 2T_{eff} - T`.
    """
    return 2.0 * sweep[4] + STANDING * sweep[2]


@dataclass(frozen=True, slots=True)
class ObstacleBarrier:
    r"""Keeps the footprint clear of obstacles.

    Attributes
    ----------
    footprint : the robot's
    gain : class-K gain :math:`\lambda` [1/s], see ``edge_rows``
    obstacles : a snapshot, or a function that gives the one that belongs to a scene. The
        function is asked several times a tick and must then give the same; to replay a tick
        from a log, log what it gave.
    frame : in which they are given. Positions are those at the tick: bring an older measurement
        forward by :meth:`Obstacles.after`. ``ROBOT`` is the robot at ``scene.stamp``, so a scene
        and obstacles from one instant need nothing else.
    margin : clearance kept beside [m], at least 0
    spread : largest error of the discs' velocities [m/s], at least 0: with a velocity of 0, the
        largest speed of one that moves as it likes
    limits : with them, rows that no command inside the speed limits can break are left out
    most_rows : of the program; those with the least to spare, at least 1
    name : prefix of the rows' names

    Raises
    ------
    ConfigurationError : a number out of range, or obstacles of neither kind

    Notes
    -----
    What is guaranteed, by the guard and for obstacles as they are given:

    * At rest (all velocities and ``spread`` 0): no contact, ever. Standing still meets every
      row, and a certified brake ends where it is clear.
    * Moving: none until the robot stands, whatever the nominal command; in the time to brake
      (:func:`stopping_time`) each disc is taken to be anywhere on its way, as wide as ``spread``
      makes it. The robot may be hit while it stands (passive safety [Bouraine2012]_): it does not
      flee.

    The body that is docked with is no obstacle: leave it out of the set, within the corridor of
    the approach at least, or the robot never arrives.
    """

    footprint: Capsule
    gain: float
    obstacles: Provider = field(default_factory=Obstacles)
    frame: Frame = Frame.ROBOT
    margin: float = 0.0
    spread: float = 0.0
    limits: Limits | None = None
    most_rows: int = MOST_ROWS
    name: str = "obstacle"

    def __post_init__(self) -> None:
        check_positive("gain", self.gain)
        for name in ("margin", "spread"):
            if not 0.0 <= getattr(self, name) < math.inf:
                value = getattr(self, name)
                raise ConfigurationError(f"{name} must be finite and at least 0, got {value!r}")
        if not self.most_rows >= 1:
            raise ConfigurationError(f"most_rows must be at least 1, got {self.most_rows!r}")
        if not (isinstance(self.obstacles, Obstacles) or callable(self.obstacles)):
            raise ConfigurationError(
                "obstacles must be Obstacles or a function of the scene that returns them, got "
                f"{self.obstacles!r}"
            )
        try:
            object.__setattr__(self, "frame", Frame(self.frame))
        except ValueError as error:
            choices = ", ".join(repr(frame.value) for frame in Frame)
            raise ConfigurationError(f"frame must be {choices}, got {self.frame!r}") from error

    @property
    def bare(self) -> ObstacleBarrier:
        """The same without margin."""
        return replace(self, margin=0.0)

    def with_obstacles(self, obstacles: Provider) -> ObstacleBarrier:
        """The same barrier for other obstacles."""
        return replace(self, obstacles=obstacles)

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """Rows of the obstacles that have the least to spare, none where all have enough.

        Named "obstacle.disc3", "obstacle.wall0.start" and ".end" (ends of a wall) and
        "obstacle.wall0.front" and ".back" (ends of the footprint's axis before it), by the
        index in the set; values h [m].

        Raises
        ------
        GeometryError : the motion, or in the goal's frame the goal, is not finite
        """
        obstacles, columns = self._given(scene)
        pose = HERE if motion is None else motion
        _check_near("motion", pose)
        near, radii = self._nearest(pose, columns)
        h = near.distance - radii
        a_v, a_omega = near.n_x, near.n_y * near.x - near.n_x * near.y
        b = self.gain * h
        if obstacles.speed:
            c, s = math.cos(pose[2]), math.sin(pose[2])
            v_x, v_y = columns.velocities
            count = len(v_x)
            b[:count] += near.n_x[:count] * (c * v_x + s * v_y)
            b[:count] += near.n_y[:count] * (c * v_y - s * v_x)
        b[: columns.discs] -= self.spread
        names, coefficients, values = [], [], []
        for index in self._tightest(a_v, a_omega, b):
            names.append(f"{self.name}.{_label(obstacles, int(index))}")
            coefficients.append((float(a_v[index]), float(a_omega[index]), float(b[index])))
            values.append(float(h[index]))
        return Rows(tuple(names), tuple(coefficients), Priority.SAFETY, tuple(values))

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Distance from the footprint to the nearest obstacle, less the margin [m].

        Negative inside, plus infinity without obstacles. Minus infinity where an obstacle
        reaches the axis itself, from where no direction is sure to lead out.

        Raises
        ------
        GeometryError : as ``rows``
        """
        _check_near("motion", motion)
        return self._clearance(motion, self._given(scene)[1])

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        """A lower bound of the clearance at any pose of the sweep [m], see ``least_along``.

        Discs that move are taken to be everywhere on their way of :func:`stopping_time`. Minus
        infinity where an obstacle may come as deep as the axis.
        """
        start = sweep[0]
        _check_near("motion", start)
        columns = self._given(scene)[1]
        duration, budget = stopping_time(sweep), self._budget(sweep)
        near, radii = self._nearest(start, columns)
        low = near.distance - radii - budget
        count, walls = columns.points.shape[1], columns.edges.shape[1]
        low[:count] -= duration * columns.speeds
        low[: columns.discs] -= duration * self.spread
        # What cannot be touched, however both move, is not looked at again.
        kept = low < 0.0
        spare = float(low[~kept].min(initial=math.inf))
        if self._crossed(start, columns.edges):
            return -math.inf
        if not kept.any():
            return spare
        beside = np.any(kept[count:].reshape(-1, max(walls, 1)), axis=0)[:walls]
        left = columns.subset(kept[:count], beside).swept(duration, self.spread)
        if self._crossed(start, left.edges):
            return -math.inf
        bound = least_along(sweep, self._bundles(sweep, left), sweep[7])
        bound = min(max(bound, float(low.min())), spare)
        # No wall comes to cross the axis but through one of its ends, or one of the axis.
        return self._off_axis(bound, 2.0 * ROUNDING)

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        r"""Clearance at the sweep's start, and that less all that can be moved in it [m].

        A point of the axis at the distance :math:`l` from the rotation centre moves by at most
        the travel and :math:`l` times the turn.
        """
        _check_near("motion", sweep[0])
        obstacles, columns = self._given(scene)
        here = self._clearance(sweep[0], columns)
        moved = (obstacles.speed + self.spread) * stopping_time(sweep)
        return here, self._off_axis(here - self._budget(sweep) - moved, 4.0 * ROUNDING)

    def _given(self, scene: Scene) -> tuple[Obstacles, Columns]:
        """The obstacles, and their columns in the frame of the robot at the scene's stamp."""
        given = self.obstacles if isinstance(self.obstacles, Obstacles) else self.obstacles(scene)
        if self.frame is Frame.ROBOT:
            return given, given.columns
        _check_near("goal", scene[0])
        return given, given.columns.seen_in(scene[0])

    def _budget(self, sweep: Sweep) -> float:
        """The most by which any distance shrinks over a sweep [m]."""
        return sweep[6] + self.footprint.lever * sweep[5] + sweep[7]

    def _nearest(self, pose: Pose2, columns: Columns) -> tuple[Nearest, Array]:
        """Every pair of an obstacle and the axis, seen from ``pose``, and their radii in all.

        First the points, then the walls before the front end of the axis, then before the back.
        """
        points, edges = columns.points, columns.edges
        fixed = self.footprint.radius + self.margin
        near, radii = self.footprint.to_points(*_seen(pose, *points[:2])), points[2] + fixed
        if not edges.size:
            return near, radii
        sides = self.footprint.to_segments(*_seen(pose, *edges[:2]), *_seen(pose, *edges[2:4]))
        joined = [np.concatenate([a, b.ravel()]) for a, b in zip(near, sides, strict=True)]
        return Nearest(*joined), np.concatenate([radii, *[edges[4] + fixed] * len(sides.n_x)])

    def _crossed(self, pose: Pose2, edges: Array) -> bool:
        if not edges.size:
            return False
        ends = _seen(pose, *edges[:2]) + _seen(pose, *edges[2:4])
        return bool(self.footprint.crossed_by(*ends).any())

    def _clearance(self, pose: Pose2, columns: Columns) -> float:
        near, radii = self._nearest(pose, columns)
        if not radii.size:
            return math.inf
        if self._crossed(pose, columns.edges):
            return -math.inf
        return self._off_axis(float((near.distance - radii).min()))

    def _off_axis(self, clearance: float, rounding: float = 0.0) -> float:
        """``clearance``, or minus infinity where it is no more than ``rounding`` off the axis."""
        deepest = -(self.footprint.radius + self.margin) + rounding
        return clearance if clearance > deepest else -math.inf

    def _tightest(self, a_v: Array, a_omega: Array, b: Array) -> NDArray[np.intp]:
        """Indices of the rows that can bind, at most so many, in their order."""
        if self.limits is None:
            spare = b
            indices = np.arange(len(b))
        else:
            limits = self.limits
            most = np.maximum(limits.v_max * a_v, limits.reverse_speed * a_v)
            spare = b - most - limits.omega_max * np.abs(a_omega)
            indices = np.flatnonzero(spare < 0.0)
        if len(indices) > self.most_rows:
            order = np.argpartition(spare[indices], self.most_rows - 1)[: self.most_rows]
            indices = np.sort(indices[order])
        return indices

    def _bundles(self, sweep: Sweep, columns: Columns) -> tuple[Bundle, ...]:
        """Clearances of points before the axis, and of its ends before walls."""
        start, footprint, bundles = sweep[0], self.footprint, []
        points, _, edges, *_ = columns
        span = self._budget(sweep) + footprint.lever
        if points.size:
            x, y, radius = points
            reach = span
            # Of an axis that is a point it is the point that moves before the obstacles.
            if footprint.front + footprint.back:
                reach += math.sqrt(float(((x - start[0]) ** 2 + (y - start[1]) ** 2).max()))
            bundles.append(Bundle(self._before_axis(x, y, radius), reach))
        if edges.size:
            sides = footprint.to_segments(*_seen(start, *edges[:2]), *_seen(start, *edges[2:4]))
            reach = float(sides.distance.max()) + span
            bundles.append(Bundle(self._before_walls(edges), reach))
        return tuple(bundles)

    def _before_axis(self, x: Array, y: Array, radius: Array) -> Callable[[Grid], Seen]:
        """Clearance of points of obstacles before the axis, a convex set of the robot."""
        radius = radius + (self.footprint.radius + self.margin)

        def look(grid: Grid) -> Seen:
            distance, n_x, n_y, at_x, at_y = self.footprint.to_points(*grid.seen(x, y))
            return Seen(distance - radius, n_x, n_y, at_x, at_y)

        return look

    def _before_walls(self, edges: Array) -> Callable[[Grid], Seen]:
        """Clearance of the ends of the axis before walls, convex sets of the ground."""
        radius = edges[4] + (self.footprint.radius + self.margin)

        def look(grid: Grid) -> Seen:
            ends = grid.seen(edges[0], edges[1]) + grid.seen(edges[2], edges[3])
            sides = self.footprint.to_segments(*ends)
            joined = [np.concatenate(list(part), axis=-1) for part in sides]
            distance = joined[0] - np.concatenate([radius] * len(sides.distance))
            return Seen(distance, joined[1], joined[2], joined[3], joined[4])

        return look


def _check_near(name: str, pose: Pose2) -> None:
    if not (abs(pose[0]) < FARTHEST and abs(pose[1]) < FARTHEST and math.isfinite(pose[2])):
        raise GeometryError(f"{name} must be finite, got {pose!r}")


def _seen(pose: Pose2, x: Array, y: Array) -> tuple[Array, Array]:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    d_x, d_y = x - pose[0], y - pose[1]
    return c * d_x + s * d_y, c * d_y - s * d_x


def _label(obstacles: Obstacles, index: int) -> str:
    """Name of a row, by its place in the order of ``ObstacleBarrier._nearest``."""
    count = obstacles.columns.points.shape[1]
    if index < count:
        return obstacles.name(index)
    side, wall = divmod(index - count, obstacles.columns.edges.shape[1])
    return f"wall{wall}.{_SIDES[side]}"
