"""A pose sensor on a plant that sees two markers beside the board's centre."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.scene import Observation
from clfcbf.se2 import Point, Pose2
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.regions import Markers
from clfcbf.simulation.sensor import PoseSensor, measured_board
from clfcbf.simulation.sensor_model import SensorModel, Sigma
from clfcbf.simulation.sensor_noise import FrameDraw, ViewError

__all__ = ["MarkerSensor", "pose_of_markers"]

_NONE = ViewError(0.0, 0.0, 0.0)


def pose_of_markers(right: Point, left: Point) -> Pose2:
    r"""Pose half-way between two markers, facing away from a viewer who sees them so.

    The direction from the right one to the left one is that of the y axis:
    :math:`\theta = \mathrm{atan2}(-\Delta x, \Delta y)`. Degenerate where they coincide.

    Parameters
    ----------
    right, left : positions (x, y) [m], in the frame of the result
    """
    dx, dy = left[0] - right[0], left[1] - right[1]
    return Pose2(0.5 * (right[0] + left[0]), 0.5 * (right[1] + left[1]), math.atan2(-dx, dy))


class MarkerSensor(PoseSensor):
    r"""A :class:`~clfcbf.simulation.sensor.PoseSensor` that measures two markers.

    Each coordinate of each marker has white noise of :math:`\sigma`; with the distance b between
    them the pose's is :math:`\sigma/\sqrt2` in position and :math:`\sqrt2\,\sigma/b` in yaw.
    Nothing is measured while one of them is out of view. Timing, losses and all that is not
    white noise are those of the model.

    Parameters
    ----------
    plant : whose pose and clock are read
    camera : pose and half angle of the scanner
    standoff : distance from the goal to the markers [m]
    model : timing, losses and slow errors; its rate and its white noise are not used
    rng : draws the run's and the frames' errors
    markers : distance, noise and rate

    Raises
    ------
    ConfigurationError : the standoff is not finite or negative
    """

    def __init__(
        self,
        plant: Plant,
        camera: FieldOfView,
        standoff: float,
        model: SensorModel,
        rng: np.random.Generator,
        markers: Markers,
    ) -> None:
        (self._marker_rng,) = rng.spawn(1)  # leaves the stream of rng itself as it is
        super().__init__(plant, camera, standoff, replace(model, rate=markers.rate), rng)
        self._markers = markers

    def _measure(self, draw: FrameDraw, now: float) -> Observation | None:
        scatter = self._markers.sigma * self._marker_rng.standard_normal((2, 2))
        board, scanner = self._board(), self._camera.camera
        half = 0.5 * self._markers.distance
        ends = [board.compose(Pose2(0.0, side * half, 0.0)) for side in (-1.0, 1.0)]
        if draw.lost or min(self._camera.margin((p.x, p.y)) for p in ends) < 0.0:
            return None
        error = self._noise.error(
            draw._replace(white=_NONE), math.hypot(board.x - scanner.x, board.y - scanner.y)
        )
        moved = measured_board(board, scanner, error)
        right, left = (
            moved.compose(Pose2(0.0, side * half, 0.0)) for side in (-1.0, 1.0)
        )  # fmt: skip
        (rx, ry), (lx, ly) = scatter.tolist()
        seen = pose_of_markers((right.x + rx, right.y + ry), (left.x + lx, left.y + ly))
        return self._observation(seen, self._sigma(), now)

    def _sigma(self) -> Sigma:
        position = self._markers.sigma / math.sqrt(2.0)
        return Sigma(position, position, 2.0 * position / self._markers.distance)
