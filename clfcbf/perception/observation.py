"""From the pose of a board to what a controller takes: goal and feature with a covariance."""

from __future__ import annotations

import math

import numpy as np

from clfcbf.errors import ConfigurationError
from clfcbf.perception.board import BoardPose
from clfcbf.perception.columns import Array
from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Pose2

__all__ = ["covariance_of_goal", "observation_of"]


def covariance_of_goal(board: Pose2, covariance: Array, standoff: float) -> Covariance:
    r"""Covariance of the goal pose from that of the board's.

    The goal is :math:`g = p - d\,(\cos\theta, \sin\theta)`, so to first order
    :math:`\Sigma_g = J\Sigma J^\top` with

    .. math::
        J = \begin{pmatrix} 1 & 0 & d\sin\theta \\ 0 & 1 & -d\cos\theta \\ 0 & 0 & 1
        \end{pmatrix}

    Parameters
    ----------
    board : pose in the robot frame
    covariance : of it, (3, 3) [m², m rad, rad²]
    standoff : distance :math:`d` from goal to board [m]
    """
    slope = np.eye(3)
    slope[0, 2] = standoff * math.sin(board.theta)
    slope[1, 2] = -standoff * math.cos(board.theta)
    full = slope @ covariance @ slope.T
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = full.tolist()
    return (xx, xy, xt), (xy, yy, yt), (xt, yt, tt)


def observation_of(board: BoardPose, standoff: float, stamp: float) -> Observation:
    """The observation that a board's pose is.

    Parameters
    ----------
    board : as the detector found it
    standoff : distance from the goal to the board's centre [m]
    stamp : time of capture [s]

    Raises
    ------
    ConfigurationError : the standoff is not finite or negative
    """
    if not 0.0 <= standoff < math.inf:
        raise ConfigurationError(f"standoff must be finite and >= 0 m, got {standoff!r}")
    return Observation(
        goal=board.pose.compose(Pose2(-standoff, 0.0, 0.0)),
        feature=board.pose,
        stamp=stamp,
        covariance=covariance_of_goal(board.pose, board.covariance, standoff),
    )
