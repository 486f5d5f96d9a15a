r"""Rows of the field of view in terms of the bearing, the paper's among them.

The *bearings* :math:`\Phi \mp \varphi` are undefined at the camera. The *paper's*
:math:`\tfrac12(\Phi^2 - \varphi^2)` has the effective gain
:math:`\lambda(\Phi^2 + \varphi^2)/(2\varphi^2)`, which grows without bound toward the axis:
inside the view it asks for more braking than at its edge.
"""

from __future__ import annotations

import math

from clfcbf.camera import FieldOfView
from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.se2 import Point

__all__ = ["bearing_rows", "paper_row"]

_AT_REST: Point = (0.0, 0.0)


def bearing_rows(
    point: Point,
    camera: FieldOfView,
    gain: float,
    margin: float = 0.0,
    point_velocity: Point = _AT_REST,
) -> Rows:
    r"""Rows of the bearing barriers :math:`h = \Phi \mp \varphi` at the camera.

    With :math:`q = p - c` and :math:`\varphi` the bearing off the camera's axis,

    .. math::
        \dot\varphi = \frac{q_y}{|q|^2}\,v - \frac{q^\top p}{|q|^2}\,\omega
                      + \frac{q_x\dot p_{ext,y} - q_y\dot p_{ext,x}}{|q|^2}

    For a camera at the robot's centre this is :math:`(v/\rho)\sin\varphi - \omega`, plus
    :math:`(v_T/\rho)\sin(\theta_T - \varphi)` for a target that drives.

    Parameters, raises and shape of the result as ``edge_rows``; values h [rad]. In addition

    Raises
    ------
    GeometryError : the point is at the camera centre, where the bearing is undefined
    """
    check_positive("gain", gain)
    check_finite("point and its velocity", point, point_velocity)
    half_angle = camera.eroded(margin).half_angle
    bearing = camera.bearing(point)
    a_v, a_w, drift = _bearing_rate(point, (camera.camera[0], camera.camera[1]), point_velocity)
    left, right = half_angle - bearing, half_angle + bearing
    return Rows(
        ("fov.left", "fov.right"),
        ((a_v, a_w, gain * left - drift), (-a_v, -a_w, gain * right + drift)),
        Priority.SAFETY,
        (left, right),
    )


def paper_row(
    point: Point, half_angle: float, gain: float, point_velocity: Point = _AT_REST
) -> Rows:
    r"""The paper's row, :math:`h = \tfrac12(\Phi^2 - \varphi^2)` at the robot's centre.

    .. math:: \dot h = \frac{\varphi}{\rho^2}\left[(x^2 + y^2)\,\omega - y\,v\right]
              \ge -\lambda h

    as printed, for a target at rest [Xie2024]_; ``point_velocity`` adds what that leaves out.
    The bearing is atan2(y, x): the printed arctan(y/x) takes a target behind for one ahead.
    On the axis the row is :math:`0 \le \tfrac12\lambda\Phi^2`, harmless.

    Parameters
    ----------
    point : seen point in the robot frame, (x, y) [m]
    half_angle : :math:`\Phi` [rad], half of the field of view
    gain : :math:`\lambda` [1/s]
    point_velocity : velocity of the point over ground, in the robot's axes [m/s]

    Returns
    -------
    One row named "fov.paper", priority SAFETY, values h [rad²]

    Raises
    ------
    GeometryError : the point or its velocity is not finite, or the point is at the origin
    ConfigurationError : the gain is not positive, or the half angle not in (0, pi)
    """
    check_positive("gain", gain)
    check_finite("point and its velocity", point, point_velocity)
    if not 0.0 < half_angle < math.pi:
        raise ConfigurationError(f"half_angle must be in (0, pi) rad, got {half_angle!r}")
    bearing = math.atan2(point[1], point[0])
    value = 0.5 * (half_angle * half_angle - bearing * bearing)
    a_v, a_w, drift = _bearing_rate(point, _AT_REST, point_velocity)
    row = (bearing * a_v, bearing * a_w, gain * value - bearing * drift)
    return Rows(("fov.paper",), (row,), Priority.SAFETY, (value,))


def _bearing_rate(point: Point, origin: Point, velocity: Point) -> tuple[float, float, float]:
    """Coefficients of v and omega in the rate of the bearing seen from ``origin``, and drift."""
    x, y = point
    q_x, q_y = x - origin[0], y - origin[1]
    square = q_x * q_x + q_y * q_y
    if square == 0.0:
        raise GeometryError(f"the bearing of {point!r} is undefined: it is where it is seen from")
    return (
        q_y / square,
        -(q_x * x + q_y * y) / square,
        (q_x * velocity[1] - q_y * velocity[0]) / square,
    )
