r"""Rows of the viable set for accelerations that are held for one period.

With :math:`p = s\dot\varphi` the outward bearing rate and

.. math:: w(u) = s\left(\alpha - \frac{\sin\varphi}{\rho}
                 \left(a + \frac{v^2}{\rho}\cos\varphi\right)\right)

what the accelerations brake it with, :math:`\dot p = -w + (v/\rho)\cos\varphi\,p \le -w +
k_v\max(p, 0)`. The bound is linear, so what a held :math:`w` leads to within a period
:math:`T` is known in closed form; the angle it still uses up, turned and braked for, falls
with :math:`w`. Hence "enough of the view is left a period on" is :math:`w(u) \ge w^*`: one
number found by bisection, and a half-plane of accelerations, whatever the shape of the set.
"""

from __future__ import annotations

import math

from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.constraints.viable import ViableSet, stopping_angle
from clfcbf.se2 import Point, Twist

__all__ = ["held_rows"]

_HALVINGS = 40
"""Steps of the bisection: what is left of a braking range of a few rad/s² is under 1e-11."""


def held_rows(viable: ViableSet, point: Point, twist: Twist) -> Rows:
    r"""Rows that keep the viable set from one tick to the next.

    .. math:: b_s(t + T) \ge (1 - \gamma T)\,b_s(t)

    for the bound on :math:`\dot p` above, and the row of the approach as in
    ``ViableSet.rows``. The accelerations of ``ViableSet.witness`` meet them wherever one edge
    asks for more than :math:`|\dot\varphi|/T`; elsewhere a brake of :math:`|\dot\varphi|/T`
    does. So they are feasible inside the acceleration limits at every state of the set, and
    from outside it they ask for the hardest brake, not for more.

    What is neglected is the change of :math:`(\sin\varphi/\rho)` and of the speed within one
    period, of third order in :math:`T`: some :math:`10^{-5}` of a degree at 30 Hz.

    Parameters
    ----------
    viable : set, limits, period and gain
    point : point at rest to be kept in view, seen from the rotation centre [m]
    twist : twist of the body now

    Returns
    -------
    Rows named, valued and shaped as those of ``ViableSet.rows``, on accelerations

    Raises
    ------
    GeometryError : as ``ViableSet.rows``
    """
    rho, phi, rate = viable.braked_bearing(point, twist)
    values = viable.margins(point, twist)
    v, share = twist[0], min(1.0, viable.gain * viable.period)
    across, along = math.sin(phi) / rho, v * math.cos(phi)
    turn = along * v / rho
    weakest = -viable.limits.alpha_max - abs(across) * (viable.limits.a_max + turn)
    coefficients: list[Row] = []
    for sign, value in ((1.0, values[0]), (-1.0, values[1])):
        p = sign * rate
        allowed = viable.braking_angle(p) + share * max(value, 0.0)
        brake = _weakest_brake(viable, p, allowed, weakest)
        coefficients.append((sign * across, -sign, -brake - sign * across * turn))
    coefficients.append((1.0, 0.0, viable.gain * values[2] - viable.approach_rate * along))
    return Rows(
        ("viable.left", "viable.right", "viable.approach"),
        tuple(coefficients),
        Priority.SAFETY,
        values,
    )


def _weakest_brake(viable: ViableSet, rate: float, allowed: float, weakest: float) -> float:
    """The least brake, from ``weakest`` to ``alpha_max``, that uses up no more than ``allowed``."""
    low, high = weakest, viable.limits.alpha_max
    if _used_angle(viable, rate, low) <= allowed:
        return low
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _used_angle(viable, rate, middle) <= allowed:
            high = middle
        else:
            low = middle
    return high


def _used_angle(viable: ViableSet, rate: float, brake: float) -> float:
    r"""Angle turned outward within a period of ``brake``, and still needed to brake after it.

    For :math:`p \ge 0`, :math:`p(T) = e^{k_vT}p - wE` with :math:`E = (e^{k_vT} - 1)/k_v`. If
    it stops earlier, the angle to there. For :math:`p < 0` the growth counts for the whole of
    the period and the angle turned inward for nothing.
    """
    k, period = viable.approach_rate, viable.period
    growth = math.exp(k * period)
    if rate <= 0.0:
        after = growth * max(0.0, rate - brake * period)
        return 0.5 * period * after + viable.braking_angle(after)
    reach = math.expm1(k * period) / k
    after = growth * rate - reach * brake
    if after <= 0.0:
        return stopping_angle(rate, brake, k)
    return reach * rate - brake * (reach - period) / k + viable.braking_angle(after)
