r"""Inputs of a chassis that takes accelerations, and high-order barriers of the view on them.

Elsewhere in this package an input is a command :math:`(v, \omega)` that changes by a bounded
step a tick. Here **the inputs are accelerations**, :math:`a = \dot v` [m/s²] and
:math:`\alpha = \dot\omega` [rad/s²], and the twist is part of the state: the columns of a
row's ``A`` belong to :math:`a` and :math:`\alpha`, and the solution of the program is what the
twist changes by, not what is sent in its place. ``clfcbf.constraints.viable`` has the set that
bounded accelerations can always keep.
"""

from __future__ import annotations

from typing import NamedTuple

from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import Edge, camera_edges
from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.limits import Limits
from clfcbf.se2 import Point, Twist

__all__ = ["AccelerationBox", "acceleration_box", "high_order_edge_rows"]


class AccelerationBox(NamedTuple):
    """Accelerations allowed now: ``a_lo <= a <= a_hi``, ``alpha_lo <= alpha <= alpha_hi``."""

    a_lo: float
    a_hi: float
    alpha_lo: float
    alpha_hi: float


def acceleration_box(limits: Limits, twist: Twist, period: float) -> AccelerationBox:
    r"""Accelerations that, held for one period :math:`T`, keep the speed limits.

    .. math:: \max(-a_{max}, (v_{min} - v)/T) \le a \le \min(a_{max}, (v_{max} - v)/T)

    and the same for the turn rate. Outside the speed limits it is what moves back toward them
    within the acceleration limits, so it is never empty.
    """
    v, omega = twist
    a_max, alpha_max = limits.a_max, limits.alpha_max
    return AccelerationBox(
        min(max(-a_max, (limits.reverse_speed - v) / period), a_max),
        max(min(a_max, (limits.v_max - v) / period), -a_max),
        min(max(-alpha_max, (-limits.omega_max - omega) / period), alpha_max),
        max(min(alpha_max, (limits.omega_max - omega) / period), -alpha_max),
    )


def high_order_edge_rows(
    point: Point,
    twist: Twist,
    camera: FieldOfView,
    gains: tuple[float, float],
    margin: float = 0.0,
) -> Rows:
    r"""High-order barrier rows of the camera's edges, on the accelerations :math:`(a, \alpha)`.

    For an edge :math:`h = n^\top(p - c)` and a point at rest

    .. math::
        \ddot h = -n_xa + (n_xy - n_yx)\,\alpha - \omega^2\,n^\top p + \omega v\,n_y

    and with :math:`\psi = \dot h + \lambda_1h` each row states
    :math:`\dot\psi \ge -\lambda_2\psi`, which keeps :math:`\{h \ge 0,\ \psi \ge 0\}`
    [Xiao2022]_. Smooth everywhere, any camera pose, either direction of travel. Under bounded
    accelerations the two rows can be infeasible inside that set, those of
    :class:`clfcbf.constraints.viable.ViableSet` cannot.

    Parameters
    ----------
    point : point at rest, in the robot frame [m]
    twist : twist of the body now [m/s, rad/s]
    camera : half angle and pose of the camera in the robot frame
    gains : :math:`(\lambda_1, \lambda_2)` [1/s]
    margin : taken off the half angle [rad], in [0, half_angle)

    Returns
    -------
    Rows named "fov.left" and "fov.right", priority SAFETY, A of shape (2, 2) with columns
    :math:`a` and :math:`\alpha`, values :math:`\psi` [m/s]; h itself is that of ``edge_rows``

    Raises
    ------
    GeometryError : the point or the twist is not finite
    ConfigurationError : a gain is not positive, or the margin out of range
    """
    first, second = gains
    check_positive("gains[0]", first)
    check_positive("gains[1]", second)
    check_finite("point and twist", point, twist)
    edges = camera_edges(camera.eroded(margin))
    coefficients, values = zip(
        *(_second_order_row(edge, point, twist, gains) for edge in edges), strict=True
    )
    return Rows(("fov.left", "fov.right"), coefficients, Priority.SAFETY, values)


def _second_order_row(
    edge: Edge, point: Point, twist: Twist, gains: tuple[float, float]
) -> tuple[Row, float]:
    r"""Row of one edge and :math:`\psi`, in arithmetic alone, which takes symbols too."""
    (n_x, n_y, offset), (x, y), (v, omega), (first, second) = edge, point, twist, gains
    along, across = n_x * x + n_y * y, n_x * y - n_y * x
    h = along - offset
    rate = -n_x * v + across * omega
    drift = -omega * omega * along + omega * v * n_y
    bound = drift + (first + second) * rate + first * second * h
    return (n_x, -across, bound), rate + first * h
