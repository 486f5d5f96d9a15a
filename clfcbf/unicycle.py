r"""Dynamics of the unicycle as drift plus input matrix, :math:`\dot x = f(x) + g(x) u`.

Every function here returns an :class:`AffineDynamics` of plain floats, because Lie
derivatives of barriers and Lyapunov functions are built from them in each tick. The input is
the robot's command :math:`u = (v, \omega)` unless a function says otherwise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from clfcbf.errors import GeometryError
from clfcbf.se2 import Point, Pose2, Twist, wrap_angle

__all__ = [
    "AffineDynamics",
    "Polar",
    "bearing_acceleration",
    "polar",
    "relative_pose",
    "seen_point",
    "tracking_error",
]

_AT_REST = Twist(0.0, 0.0)


class AffineDynamics(NamedTuple):
    r"""Control-affine dynamics at one state, :math:`\dot x = f + g u`.

    Attributes
    ----------
    drift : :math:`f`, n values
    input_matrix : :math:`g`, n rows of two values, columns in the order of the input
    """

    drift: tuple[float, ...]
    input_matrix: tuple[tuple[float, float], ...]

    def rate(self, twist: tuple[float, float]) -> tuple[float, ...]:
        r""":math:`f + g u` under the input ``twist``."""
        first, second = twist
        return tuple(
            f + g[0] * first + g[1] * second
            for f, g in zip(self.drift, self.input_matrix, strict=True)
        )


class Polar(NamedTuple):
    r"""A target pose in polar coordinates about the robot.

    Attributes
    ----------
    rho : range of the target :math:`\rho` [m]
    phi : its bearing off the robot's heading :math:`\varphi` [rad]
    delta : direction of the line of sight in the target frame,
        :math:`\delta = \varphi - \theta_T` [rad]; the robot's heading there is
        :math:`\delta - \varphi`

    Notes
    -----
    Park and Kuipers write :math:`-\varphi` for their delta and :math:`-\delta` for their phi.
    """

    rho: float
    phi: float
    delta: float

    @classmethod
    def of(cls, target: Pose2) -> Polar:
        """Polar coordinates of a pose seen from the robot; degenerate at range 0, phi = 0."""
        x, y, theta = target
        phi = math.atan2(y, x)
        return cls(math.hypot(x, y), phi, wrap_angle(phi - theta))

    def pose(self) -> Pose2:
        """The target's pose seen from the robot."""
        rho, phi, delta = self
        return Pose2(rho * math.cos(phi), rho * math.sin(phi), wrap_angle(phi - delta))


def tracking_error(error: Pose2, reference: Twist) -> AffineDynamics:
    r"""Dynamics of the pose of a virtual target seen from the robot ([Xie2024]_, tracking error).

    .. math::
        \dot x = v_V\cos\theta - v + y\,\omega,\quad
        \dot y = v_V\sin\theta - x\,\omega,\quad
        \dot\theta = \omega_V - \omega

    Parameters
    ----------
    error : pose of the virtual target V in the robot frame [m, m, rad]
    reference : the virtual target's own twist :math:`(v_V, \omega_V)`

    Returns
    -------
    Dynamics of (x, y, theta); smooth everywhere. The input matrix has rank 2 of 3: a pure
    lateral error cannot be changed at once.
    """
    x, y, theta = error
    v, omega = reference
    return AffineDynamics(
        (v * math.cos(theta), v * math.sin(theta), omega),
        ((-1.0, y), (0.0, -x), (0.0, -1.0)),
    )


def relative_pose(pose: Pose2, observer: Twist) -> AffineDynamics:
    r"""Dynamics of a body seen from a moving observer; the *body's* twist is the input.

    The planar case of :math:`\dot T^j_i = -[V_j]\,T^j_i + T^j_i\,[V_i]` ([Xie2024]_, relative
    motion) with the observer j as the drift:

    .. math::
        \dot x = v_i\cos\theta - v_j + y\,\omega_j,\quad
        \dot y = v_i\sin\theta - x\,\omega_j,\quad
        \dot\theta = \omega_i - \omega_j

    :func:`tracking_error` is the same equation with the observer as the input.

    Parameters
    ----------
    pose : pose of the body i in the observer's frame j, such as the robot in a goal frame
    observer : twist of the observer; zero for a goal at rest
    """
    x, y, theta = pose
    v, omega = observer
    return AffineDynamics(
        (omega * y - v, -omega * x, -omega),
        ((math.cos(theta), 0.0), (math.sin(theta), 0.0), (0.0, 1.0)),
    )


def seen_point(point: Point, point_velocity: Point = (0.0, 0.0)) -> AffineDynamics:
    r"""Motion of a point seen from the robot.

    .. math:: \dot x = \dot p_x - v + y\,\omega,\quad \dot y = \dot p_y - x\,\omega

    Parameters
    ----------
    point : the point in the robot frame [m]
    point_velocity : velocity of the point over ground, in the axes of the robot frame [m/s]
    """
    x, y = point
    return AffineDynamics(tuple(point_velocity), ((-1.0, y), (0.0, -x)))


def polar(state: Polar, target: Twist = _AT_REST) -> AffineDynamics:
    r"""Dynamics of a target pose in polar coordinates, also for a target that moves.

    .. math::
        \dot\rho = -v\cos\varphi + v_T\cos\delta,\quad
        \dot\varphi = \frac{v}{\rho}\sin\varphi - \omega - \frac{v_T}{\rho}\sin\delta,\quad
        \dot\delta = \frac{v}{\rho}\sin\varphi - \frac{v_T}{\rho}\sin\delta - \omega_T

    For a target at rest these are the equations of [Aicardi1995]_.

    Parameters
    ----------
    state : range, bearing and line of sight of the target
    target : the target's own twist in its own frame

    Raises
    ------
    GeometryError : the range is not positive; the bearing is undefined there
    """
    rho, phi, delta = state
    _check_range(rho)
    v, omega = target
    across = math.sin(phi) / rho
    swept = v * math.sin(delta) / rho
    return AffineDynamics(
        (v * math.cos(delta), -swept, -swept - omega),
        ((-math.cos(phi), 0.0), (across, -1.0), (across, 0.0)),
    )


def bearing_acceleration(rho: float, phi: float, twist: Twist) -> AffineDynamics:
    r"""Second derivative of the bearing of a point at rest; the input is :math:`(a, \alpha)`.

    .. math::
        \ddot\varphi = \frac{2v^2}{\rho^2}\sin\varphi\cos\varphi
            - \frac{v\,\omega}{\rho}\cos\varphi + \frac{a}{\rho}\sin\varphi - \alpha

    Parameters
    ----------
    rho, phi : range [m] and bearing [rad] of the point
    twist : the present twist :math:`(v, \omega)`

    Returns
    -------
    Dynamics of one state, the bearing rate, with input linear and angular acceleration.

    Raises
    ------
    GeometryError : the range is not positive
    """
    _check_range(rho)
    v, omega = twist
    s, c = math.sin(phi), math.cos(phi)
    q = v / rho
    return AffineDynamics((2.0 * q * q * s * c - q * omega * c,), ((s / rho, -1.0),))


def _check_range(rho: float) -> None:
    if not rho > 0.0:
        raise GeometryError(f"polar coordinates need a range above 0 m, got {rho!r}")
