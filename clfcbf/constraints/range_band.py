r"""The barrier that keeps the distance to the viewed feature in a band.

Depth cameras see nothing too near and nothing too far. With :math:`q = p - c` from the camera
centre and :math:`n = q/|q|`,

.. math::
    \dot\rho = -n_xv + (n_xp_y - n_yp_x)\,\omega, \qquad
    \dot\rho \ge -\lambda(\rho - \rho_{min}), \quad -\dot\rho \ge -\lambda(\rho_{max} - \rho)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.constraints.swept import ROUNDING, Array, Bundle, Grid, Seen, least_along
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.scene import Scene
from clfcbf.se2 import Point, Pose2

__all__ = ["RangeBarrier"]


@dataclass(frozen=True, slots=True)
class RangeBarrier:
    r"""Keeps the feature at least ``nearest`` and at most ``farthest`` away.

    Attributes
    ----------
    nearest, farthest : :math:`\rho_{min}, \rho_{max}` [m], ``0 <= nearest < farthest``; 0 and
        infinity leave that side open
    gain : class-K gain :math:`\lambda` [1/s]
    origin : where the distance is measured from, in the robot frame [m]: the camera's centre, or
        the robot's, which is the default
    margin : the band is narrower by this on both sides [m], at least 0
    name : prefix of the rows' names

    Raises
    ------
    ConfigurationError : the gain is not positive, or no band is left between the margins

    Notes
    -----
    Within the band standing still meets both rows. Degenerate at distance 0, where there is no
    direction away from the feature: the clearance is minus infinity there if ``nearest > 0``.
    """

    nearest: float
    farthest: float
    gain: float
    origin: Point = (0.0, 0.0)
    margin: float = 0.0
    name: str = "range"

    def __post_init__(self) -> None:
        check_positive("gain", self.gain)
        if not (0.0 <= self.nearest < math.inf and self.nearest < self.farthest):
            raise ConfigurationError(
                "the band needs 0 <= nearest < farthest [m], got "
                f"nearest={self.nearest!r}, farthest={self.farthest!r}"
            )
        sides = 2.0 if self.nearest else 1.0
        most = (self.farthest - self.nearest) / sides
        if not (0.0 <= self.margin < math.inf and self.margin < most):
            raise ConfigurationError(
                f"margin must be in [0, {most:.6g}) m, or nothing is left of the band, got "
                f"{self.margin!r}"
            )
        if not math.isfinite(self.origin[0] + self.origin[1]):
            raise ConfigurationError(f"origin must be finite, got {self.origin!r}")

    @property
    def bare(self) -> RangeBarrier:
        """The same without margin."""
        return replace(self, margin=0.0)

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """Rows "range.near" and "range.far", without the one of a side left open; values h [m].

        Raises
        ------
        GeometryError : the feature or the motion is not finite
        """
        motion = HERE if motion is None else motion
        rho = self._distance(scene, motion)
        x, y = motion.seen(scene[1])
        q_x, q_y = x - self.origin[0], y - self.origin[1]
        n_x, n_y = (q_x / rho, q_y / rho) if rho else (0.0, 0.0)
        across = n_x * y - n_y * x
        names: list[str] = []
        coefficients: list[Row] = []
        values: list[float] = []
        for side, sign, h in zip(("near", "far"), (1.0, -1.0), self._sides(rho), strict=True):
            if h < math.inf:
                names.append(f"{self.name}.{side}")
                coefficients.append((sign * n_x, -sign * across, self.gain * h))
                values.append(h)
        return Rows(tuple(names), tuple(coefficients), Priority.SAFETY, tuple(values))

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Distance to the nearer end of the band [m]; negative outside.

        Raises
        ------
        GeometryError : as ``rows``
        """
        return self._room(self._distance(scene, motion))

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        """A lower bound of the clearance at any pose of the sweep [m], see ``least_along``.

        On an arc the distance can be smallest, or largest, between the ends.
        """
        rho = self._distance(scene, sweep[0])
        budget = self._budget(sweep)
        crude = self._room(rho, budget)
        if not crude < 0.0:
            return crude
        x, y = np.array([scene[1][0]]), np.array([scene[1][1]])
        # A distance does not ask which way the robot turns: what moves is the origin.
        reach = math.hypot(*self.origin) + sweep[6]
        near, far = (side - budget for side in self._sides(rho))
        if near < 0.0:
            bundle = Bundle(self._looks(False, x, y, 0.0), reach)
            near = max(near, least_along(sweep, (bundle,), sweep[7]))
        if far < 0.0 and rho > budget:  # about a distance of 0 it bends without bound
            bundle = Bundle(self._looks(True, x, y, rho - budget), reach)
            far = max(far, least_along(sweep, (bundle,), sweep[7]))
        return min(self._off_feature(near, 2.0 * ROUNDING), far)

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        """Clearance at the sweep's start, and that less the most the origin can move [m]."""
        rho = self._distance(scene, sweep[0])
        return self._room(rho), self._room(rho, self._budget(sweep), 4.0 * ROUNDING)

    def _distance(self, scene: Scene, motion: Pose2) -> float:
        check_finite("feature and motion", scene[1][:2], motion)
        x, y = motion.seen(scene[1])
        q_x, q_y = x - self.origin[0], y - self.origin[1]
        # Not hypot, which rounds otherwise: on a grid the same pose is to give the same number.
        rho = math.sqrt(q_x * q_x + q_y * q_y)
        if rho == math.inf:
            raise GeometryError(f"feature must be finite, got {scene[1]!r}")
        return rho

    def _sides(self, rho: float) -> tuple[float, float]:
        """Clearance to the near end and to the far end; infinity where that side is open."""
        near = rho - (self.nearest + self.margin) if self.nearest else math.inf
        return near, (self.farthest - self.margin) - rho

    def _room(self, rho: float, budget: float = 0.0, rounding: float = 0.0) -> float:
        near, far = self._sides(rho)
        return min(self._off_feature(near - budget, rounding), far - budget)

    def _off_feature(self, near: float, rounding: float = 0.0) -> float:
        """``near``, or minus infinity where that is at the feature itself, to ``rounding``."""
        return near if near > -(self.nearest + self.margin) + rounding else -math.inf

    def _budget(self, sweep: Sweep) -> float:
        """The most by which the distance changes over a sweep [m]."""
        return sweep[6] + math.hypot(*self.origin) * sweep[5] + sweep[7]

    def _looks(self, far: bool, x: Array, y: Array, least: float) -> Callable[[Grid], Seen]:
        """Clearance to one end of the band; ``least`` is the smallest distance there can be."""
        sign = -1.0 if far else 1.0
        end = sign * (self.farthest - self.margin if far else self.nearest + self.margin)
        bend = 1.0 / least if far else 0.0

        def look(grid: Grid) -> Seen:
            at_x, at_y = grid.seen(x, y)
            q_x, q_y = at_x - self.origin[0], at_y - self.origin[1]
            rho = np.sqrt(q_x * q_x + q_y * q_y)
            scale = sign / np.where(rho > 0.0, rho, 1.0)
            return Seen(sign * rho - end, scale * q_x, scale * q_y, at_x, at_y, bend)

        return look
