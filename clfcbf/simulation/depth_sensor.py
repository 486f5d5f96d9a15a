"""A pose sensor on a plant that sees columns of depth and fits the board to them."""

from __future__ import annotations

import math

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.perception.board import BoardDetector, NotSeen
from clfcbf.perception.compensation import uncompensated
from clfcbf.perception.observation import observation_of
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2
from clfcbf.simulation.depth import DepthCamera, DepthModel
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.sensor import PoseSensor, measured_board
from clfcbf.simulation.sensor_noise import FrameDraw, ViewError

__all__ = ["DepthSensor"]

_NONE = ViewError(0.0, 0.0, 0.0)


class DepthSensor(PoseSensor):
    r"""A :class:`~clfcbf.simulation.sensor.PoseSensor` that measures by geometry.

    A frame is a row of depth columns, and the board is found in it by
    :class:`~clfcbf.perception.board.BoardDetector`, which is told the board's width, the
    camera's nominal mount and the noise of its columns, and nothing else. It works on any part
    of the board in view that is large enough, its centre or not.

    When frames are due, their latency, jitter and drop-outs, and the run's calibration error,
    drift and bias, are those of ``PoseSensor`` with the same seed. The calibration error and
    its drift act as a depth error (along) and as a camera that is mounted
    :math:`(0, \Delta y, \Delta\theta)` away from where the robot believes it to be (across, yaw);
    the bias and the outliers of whole frames move the surface that the camera sees.

    Parameters
    ----------
    plant : whose pose and clock are read
    camera : mount and half angle
    standoff : distance from the goal to the board [m]
    model : errors
    rng : draws the run's and the frames' errors
    width : of the board [m]
    compensated : find the centre of a board that the view cuts from its free end; if not, the
        middle of what is visible is taken for it, to see what the compensation is worth

    Raises
    ------
    ConfigurationError : the standoff is not finite or negative, or the width not positive

    Notes
    -----
    The covariance in an observation is that of the fit: white noise of the columns, the frame's
    common error, and the columns' spacing. Mount, drift, bias and outliers of whole frames are
    what a sensor does not know about itself.
    """

    def __init__(
        self,
        plant: Plant,
        camera: FieldOfView,
        standoff: float,
        model: DepthModel,
        rng: np.random.Generator,
        width: float,
        *,
        compensated: bool = True,
    ) -> None:
        (self._column_rng,) = rng.spawn(1)  # leaves the stream of rng itself as it is
        super().__init__(plant, camera, standoff, model.frames, rng)
        self._compensated = compensated
        self._eye = DepthCamera(model, camera.half_angle, width)
        self._detector = BoardDetector(width, camera.camera, model.noise, model.span)

    def _measure(self, draw: FrameDraw, now: float) -> Observation | None:
        columns = self._eye.draw(self._column_rng)
        if draw.lost:
            return None
        nominal = self._camera.camera
        board = self._board()
        distance = math.hypot(board.x - nominal.x, board.y - nominal.y)
        moved = self._noise.error(draw._replace(white=_NONE, slow=_NONE), distance)
        mount = nominal.compose(Pose2(0.0, draw.slow.across, draw.slow.yaw))
        seen = mount.relative(measured_board(board, nominal, moved))
        found = self._detector.detect(self._eye.columns(seen, columns, draw.slow.along))
        if isinstance(found, NotSeen):
            return None
        if not self._compensated:
            found = uncompensated(found, nominal)
        return observation_of(found, self._standoff, now)
