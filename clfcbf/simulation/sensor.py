"""A simulated camera that measures where the board is, late and with errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.sensor_model import SensorModel, Sigma
from clfcbf.simulation.sensor_noise import FrameDraw, SensorNoise, ViewError

__all__ = ["PoseSensor", "SensorModel", "goal_covariance", "measured_board"]

RESOLUTION = 1e-6
"""[m, rad] added in quadrature to reported sigmas: an exact sensor's covariance has an inverse."""

_CLOCK_ROUNDING = 1e-9  # of a clock that sums ticks: far below a tick, far above its rounding


class _Frame(NamedTuple):
    arrival: float
    observation: Observation


def measured_board(board: Pose2, camera: Pose2, error: ViewError) -> Pose2:
    r"""The board's pose with an error given along and across the line of sight.

    With :math:`\beta` the direction from the camera to the board's centre,
    :math:`\hat p = p + R(\beta)(e_\parallel, e_\perp)` and
    :math:`\hat\theta = \theta + e_\theta`, all in the robot frame.

    Parameters
    ----------
    board, camera : poses in the robot frame
    error : along and across the line of sight [m], and of the yaw [rad]
    """
    c, s = _line_of_sight(board, camera)
    return Pose2(
        board.x + c * error.along - s * error.across,
        board.y + s * error.along + c * error.across,
        wrap_angle(board.theta + error.yaw),
    )


def goal_covariance(board: Pose2, camera: Pose2, standoff: float, sigma: Sigma) -> Covariance:
    r"""Covariance of the goal pose that independent errors of the board's pose give.

    The goal is :math:`g = p - d\,(\cos\theta, \sin\theta)` behind the board, so to first order

    .. math::
        \Sigma_g = J \begin{pmatrix} R\,\mathrm{diag}(\sigma_\parallel^2, \sigma_\perp^2)R^\top
        & 0 \\ 0 & \sigma_\theta^2 \end{pmatrix} J^\top, \qquad
        J = \begin{pmatrix} 1 & 0 & d\sin\theta \\ 0 & 1 & -d\cos\theta \\ 0 & 0 & 1
        \end{pmatrix}

    with :math:`R` the rotation to the line of sight.

    Parameters
    ----------
    board, camera : poses in the robot frame
    standoff : distance :math:`d` from goal to board [m]
    sigma : standard deviations of the board's pose

    Returns
    -------
    Covariance of (x, y, theta) in the robot frame [m², m rad, rad²], row by row.
    """
    c, s = _line_of_sight(board, camera)
    along, across, yaw = (value * value + RESOLUTION * RESOLUTION for value in sigma)
    jx = standoff * math.sin(board.theta)
    jy = -standoff * math.cos(board.theta)
    xx = c * c * along + s * s * across + jx * jx * yaw
    xy = c * s * (along - across) + jx * jy * yaw
    yy = s * s * along + c * c * across + jy * jy * yaw
    return (xx, xy, jx * yaw), (xy, yy, jy * yaw), (jx * yaw, jy * yaw, yaw)


class PoseSensor:
    """A camera on a plant that measures the board's pose, out of which feature and goal follow.

    The errors act on the pose of the board; the goal is the standoff ahead of the measured
    board, so that an error of the yaw moves it as well. A frame measures nothing when the
    board's centre is outside the camera's view or the frame drops out. Frames are delivered
    after their latency and may overtake one another: they are handed out in the order of
    their stamps. Only the newest that has come is handed out and older ones are dropped, also
    where jitter brings two within one tick.

    Parameters
    ----------
    plant : whose pose and clock are read
    camera : the true field of view
    standoff : distance from the goal to the board [m]
    model : timing and errors
    rng : draws the run's and the frames' errors

    Raises
    ------
    ConfigurationError : the standoff is not finite or negative

    Notes
    -----
    The covariance in an observation is that of the model's white noise at the measured pose:
    biases, drift and outliers are what a sensor does not know about itself.
    """

    def __init__(
        self,
        plant: Plant,
        camera: FieldOfView,
        standoff: float,
        model: SensorModel,
        rng: np.random.Generator,
    ) -> None:
        if not 0.0 <= standoff < math.inf:
            raise ConfigurationError(f"standoff must be finite and >= 0 m, got {standoff!r}")
        self._plant = plant
        self._camera = camera
        self._standoff = standoff
        self._noise = SensorNoise(model, rng)
        self._last_index = -1
        self._frames: list[_Frame] = []

    def capture(self) -> None:
        """Take a frame if one is due at the plant's time; call it at every tick.

        Frames are due at multiples of the period since time 0 and are taken at the first call
        at or after it, stamped with the time of the call; those missed altogether are skipped.
        """
        now = self._plant.time
        index = math.floor((now + _CLOCK_ROUNDING) * self._noise.model.rate)
        if index <= self._last_index:
            return
        self._last_index = index
        draw = self._noise.draw(now)
        observation = self._measure(draw, now)
        if observation is not None:
            self._frames.append(_Frame(now + draw.delay, observation))

    def _measure(self, draw: FrameDraw, now: float) -> Observation | None:
        """What a frame taken now sees, None if nothing; a sensor of another kind has its own."""
        board = self._board()
        if draw.lost or self._camera.margin((board.x, board.y)) < 0.0:
            return None
        camera = self._camera.camera
        error = self._noise.error(draw, _distance(board, camera))
        seen = measured_board(board, camera, error)
        return self._observation(seen, self._noise.model.sigma(_distance(seen, camera)), now)

    def _board(self) -> Pose2:
        """True pose of the board's centre in the robot frame."""
        return self._plant.pose().relative(Pose2(self._standoff, 0.0, 0.0))

    def _observation(self, board: Pose2, sigma: Sigma, now: float) -> Observation:
        """The observation of a board measured with that much white noise."""
        return Observation(
            goal=board.compose(Pose2(-self._standoff, 0.0, 0.0)),
            feature=board,
            stamp=now,
            covariance=goal_covariance(board, self._camera.camera, self._standoff, sigma),
        )

    def observe(self) -> Observation | None:
        """The newest frame delivered by now and newer than any handed out before, or None."""
        now = self._plant.time + _CLOCK_ROUNDING
        newest: Observation | None = None  # frames lie in the order of their stamps
        for arrival, observation in self._frames:
            if arrival <= now:
                newest = observation
        if newest is None:
            return None
        self._frames = [frame for frame in self._frames if frame.observation.stamp > newest.stamp]
        return newest


def _distance(board: Pose2, camera: Pose2) -> float:
    return math.hypot(board.x - camera.x, board.y - camera.y)


def _line_of_sight(board: Pose2, camera: Pose2) -> tuple[float, float]:
    """Cosine and sine of the direction from the camera to the board's centre."""
    direction = math.atan2(board.y - camera.y, board.x - camera.x)
    return math.cos(direction), math.sin(direction)
