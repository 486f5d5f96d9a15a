r"""Closed-form view compensation: a board cut by the view's edge, from its visible middle.

:class:`~clfcbf.perception.board.BoardDetector` does without: it starts from the free end. The
formulas here are for an estimate that has only the middle of the visible part, its bearing and
its range, and for comparison with the ones printed in [Xie2024]_. All of it is in the camera's
frame, x along the axis.
"""

from __future__ import annotations

import math
from dataclasses import replace

from clfcbf.perception.board import BoardPose
from clfcbf.se2 import Point, Pose2

__all__ = [
    "compensated_centre",
    "printed_centre",
    "printed_length",
    "uncompensated",
    "visible_length",
]


def visible_length(middle: Point, theta: float, half_angle: float, side: int) -> float:
    r"""Length of the visible part of a board cut by one edge of the view.

    In the triangle of camera, visible middle and cut end the angles are
    :math:`\Phi - s\varphi` at the camera and, at the cut end, one whose sine is
    :math:`\cos(\theta - s\Phi)`; the law of sines gives

    .. math:: \hat l = \frac{2\hat\rho\,\sin(\Phi - s\varphi)}{\cos(\theta - s\Phi)}

    Degenerate where the board lies along the edge of the view, :math:`\theta - s\Phi =
    \pm\pi/2`, near which noise grows as :math:`1/\cos(\theta - s\Phi)`.

    Parameters
    ----------
    middle : middle of the visible part (x, y) [m]; not the mean of its pixels, which are denser
        on the nearer half
    theta : yaw of the board :math:`\theta` [rad]
    half_angle : of the view :math:`\Phi` [rad]
    side : :math:`s`, +1 if the left edge cuts the board and -1 if the right one does
    """
    phi, rho = math.atan2(middle[1], middle[0]), math.hypot(*middle)
    return 2.0 * rho * math.sin(half_angle - side * phi) / math.cos(theta - side * half_angle)


def compensated_centre(
    middle: Point, theta: float, half_angle: float, width: float, side: int
) -> Point:
    r"""Centre of a board cut by one edge of the view, from the middle of its visible part.

    .. math:: d_{cp} = \hat d + s\,\frac{l - \hat l}{2}\,(-\sin\theta,\ \cos\theta)

    Parameters
    ----------
    middle, theta, half_angle, side : as for :func:`visible_length`
    width : of the board :math:`l` [m]
    """
    hidden = width - visible_length(middle, theta, half_angle, side)
    shift = 0.5 * side * hidden
    return middle[0] - shift * math.sin(theta), middle[1] + shift * math.cos(theta)


def printed_length(middle: Point, theta: float, half_angle: float) -> float:
    r"""Visible length as [Xie2024]_ prints it, for comparison; not the geometry.

    .. math::
        \hat l = \frac{2\hat\rho\,\sin(\varphi_{fov} - \varphi)}
        {-\cos(\hat\theta + 2\varphi - \varphi_{fov})}

    Only at :math:`\varphi = \varphi_{fov}` with :math:`\hat\theta = \pi - \theta` or the like
    does its denominator meet the right one; taken literally with a board that faces the camera
    the length is negative.

    Parameters
    ----------
    middle, theta, half_angle : as for :func:`visible_length`
    """
    phi, rho = math.atan2(middle[1], middle[0]), math.hypot(*middle)
    return 2.0 * rho * math.sin(half_angle - phi) / -math.cos(theta + 2.0 * phi - half_angle)


def printed_centre(middle: Point, theta: float, half_angle: float, width: float) -> Point:
    r"""Centre as [Xie2024]_ prints it, for comparison; not the geometry.

    .. math:: d_{cp} = \hat d + \tfrac12(\hat l - l)\,[\cos\hat\theta,\ -\sin\hat\theta]

    With x forward and y to the left the correction is along the board's normal instead of
    along the board.

    Parameters
    ----------
    middle, theta, half_angle, width : as for :func:`compensated_centre`
    """
    shift = 0.5 * (printed_length(middle, theta, half_angle) - width)
    return middle[0] + shift * math.cos(theta), middle[1] - shift * math.sin(theta)


def uncompensated(board: BoardPose, camera: Pose2) -> BoardPose:
    """The board with the middle of its visible part taken for its centre, all else as it was.

    What an estimate without compensation would be, covariance included: such an estimate does
    not know that it errs.

    Parameters
    ----------
    board : as the detector found it
    camera : where the camera is on the robot
    """
    line, extent = board.fit.line, board.extent
    (rx, ry), (lx, ly) = line.at(extent.right.tangent), line.at(extent.left.tangent)
    middle = Pose2(0.5 * (rx + lx), 0.5 * (ry + ly), line.theta)
    return replace(board, pose=camera.compose(middle))
