r"""The viable set of a bearing under bounded accelerations, as barrier rows that never conflict.

**The inputs are accelerations** :math:`(a, \alpha)`, as in ``clfcbf.constraints.acceleration``.
A barrier of the bearing alone asks, near an edge, for more braking than the acceleration limits
have. Here the braking is part of the set. ``ViableSet.rows`` are its barrier rows in continuous
time; ``clfcbf.constraints.viable_held`` has those for accelerations held from tick to tick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from clfcbf.constraints.acceleration import AccelerationBox, acceleration_box
from clfcbf.constraints.checks import check_finite
from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits, check_period
from clfcbf.se2 import Point, Twist

__all__ = ["ViableSet", "stopping_angle"]

_SERIES_BELOW = 1e-3
"""Share of alpha_max/k_v under which the braking angle is a series: its two terms cancel."""

_MOST_GROWTH = 0.5
"""Bound on k_v T: k_v T exp(k_v T) < 1 is needed to brake what a period of alpha_max starts."""


@dataclass(frozen=True, slots=True)
class ViableSet:
    r"""The states from which bounded accelerations can keep a point in view, in closed form.

    For a point at rest at range :math:`\rho` and bearing :math:`\varphi` **seen from the
    rotation centre**, with bearing rate :math:`\dot\varphi = (v/\rho)\sin\varphi - \omega`,

    .. math::
        S = \{0 \le v \le \min(v_{max}, k_v\rho),\quad d(s\dot\varphi) \le \Phi - s\varphi,
              \quad s = \pm1\}

    .. math::
        d(p) = -\frac{p}{k_v} - \frac{\alpha_{max}}{k_v^2}\ln\!\left(1 -
               \frac{k_vp}{\alpha_{max}}\right) \ \text{for } p > 0,\qquad d = 0
               \ \text{otherwise}

    where :math:`d(p)` is the angle by which the bearing still grows when an outward rate
    :math:`p` is braked with :math:`\alpha_{max}` while the approach amplifies it by up to
    :math:`k_v`. S is control invariant: ``witness`` meets every row, inside the acceleration
    limits, at every state of S. Forward speeds only; a camera that sits away from the rotation
    centre needs ``high_order_edge_rows`` or the guard.

    Attributes
    ----------
    limits : speeds and accelerations of the chassis; a negative ``v_min`` is not used
    half_angle : :math:`\Phi` [rad], in (0, pi/2); take a margin off here
    period : time for which an acceleration is held [s]
    approach_rate : :math:`k_v` [1/s], the speed allowed per range. Larger drives faster at the
        end and brakes a bearing rate earlier. See ``largest``.
    gain : class-K gain :math:`\gamma` [1/s] of every row, at least ``approach_rate``

    Raises
    ------
    LimitsError, ConfigurationError : the limits, the period or the half angle are not usable;
        the approach rate is not in :math:`(0, a_{max}/v_{max}]` or leaves no turn rate to
        brake with, :math:`k_v\sin\Phi + \alpha_{max}T > \omega_{max}`; the gain is below it

    References
    ----------
    Feasibility of high-order barriers: [Xiao2022]_; barriers with bounded inputs: [Breeden2021]_.
    """

    limits: Limits
    half_angle: float
    period: float
    approach_rate: float
    gain: float
    _forward: Limits = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.half_angle < 0.5 * math.pi:
            raise ConfigurationError(
                f"half_angle must be in (0, pi/2) rad, got {self.half_angle!r}"
            )
        check_period(self.period)
        largest = _largest_approach_rate(self.limits, self.half_angle, self.period)
        if not 0.0 < self.approach_rate <= largest:
            raise ConfigurationError(
                f"approach_rate must be in (0, {largest:.6g}] 1/s for these limits, half angle "
                f"and period, got {self.approach_rate!r}"
            )
        if not self.approach_rate <= self.gain < math.inf:
            raise ConfigurationError(
                f"gain must be finite and at least approach_rate = {self.approach_rate:.6g} 1/s, "
                f"got {self.gain!r}"
            )
        object.__setattr__(self, "_forward", replace(self.limits, v_min=0.0))
        # So that of two opposite rows at most one can ask for braking within a period.
        step = self.limits.alpha_max * self.period
        swing = math.exp(self.approach_rate * self.period) * step
        turned = 0.5 * self.period * swing + self.braking_angle(swing)
        room = self.half_angle - 0.5 * self.braking_angle(step)
        if not turned <= min(1.0, self.gain * self.period) * room:
            raise ConfigurationError(
                f"half_angle {self.half_angle!r} rad is too narrow for alpha_max * period = "
                f"{step:.6g} rad/s at a gain of {self.gain!r} 1/s; shorten the period or raise "
                "the gain"
            )

    @classmethod
    def largest(cls, limits: Limits, half_angle: float, period: float, gain: float) -> ViableSet:
        r"""The set of the largest admissible approach rate.

        .. math::
            k_v = \min\!\left(\frac{a_{max}}{v_{max}},
                  \frac{\omega_{max} - \alpha_{max}T}{\sin\Phi}, \frac1{2T}\right)

        The deceleration :math:`k_vv` is then at hand, so is the turn rate that follows a bearing
        at the edge with one period of :math:`\alpha_{max}` to spare, and a period of growth
        is within what the next can brake.

        Raises
        ------
        ConfigurationError : as the class; also where one period of :math:`\alpha_{max}` is
            more than the turn rate allowed, so that there is no admissible rate
        """
        return cls(
            limits, half_angle, period, _largest_approach_rate(limits, half_angle, period), gain
        )

    def braking_angle(self, rate: float) -> float:
        r"""The angle :math:`d(p)` that an outward bearing rate ``rate`` still covers [rad].

        About :math:`p^2/(2\alpha_{max}) + k_vp^3/(3\alpha_{max}^2)`. 0 for a rate inward,
        infinite from :math:`p = \alpha_{max}/k_v` on, which no braking stops.
        """
        return stopping_angle(rate, self.limits.alpha_max, self.approach_rate)

    def margins(self, point: Point, twist: Twist) -> tuple[float, float, float]:
        r"""The barriers :math:`(b_L, b_R, b_v)`: two angles [rad] and a speed [m/s].

        .. math:: b_L = \Phi - \varphi - d(\dot\varphi),\quad
                  b_R = \Phi + \varphi - d(-\dot\varphi),\quad b_v = k_v\rho - v
        """
        rho, phi, rate = _bearing(point, twist)
        return (
            self.half_angle - phi - self.braking_angle(rate),
            self.half_angle + phi - self.braking_angle(-rate),
            self.approach_rate * rho - twist[0],
        )

    def braked_bearing(self, point: Point, twist: Twist) -> tuple[float, float, float]:
        """Range [m], bearing [rad] and bearing rate [rad/s], a rate that can be braked.

        Raises
        ------
        GeometryError : as ``rows``
        """
        rho, phi, rate = _bearing(point, twist)
        if not self.approach_rate * abs(rate) < self.limits.alpha_max:
            raise GeometryError(
                f"a bearing rate of {rate!r} rad/s cannot be braked: the viable set needs less "
                f"than {self.limits.alpha_max / self.approach_rate:.6g} rad/s"
            )
        return rho, phi, rate

    def contains(self, point: Point, twist: Twist) -> bool:
        """Whether the state is in S and inside the speed limits."""
        return min(self.margins(point, twist)) >= 0.0 and self._forward.contains(twist)

    def box(self, twist: Twist) -> AccelerationBox:
        """``acceleration_box`` of the forward speeds."""
        return acceleration_box(self._forward, twist, self.period)

    def witness(self, point: Point, twist: Twist) -> tuple[float, float]:
        r"""Accelerations that meet every row, and the limits, at every state of S.

        .. math:: a = -\frac{v^2}{\rho}\cos\varphi,\qquad
                  \alpha = \alpha_{max}\,\mathrm{sgn}\,\dot\varphi

        They keep :math:`v/(k_v\rho)` from growing and stop the bearing as fast as they can.
        """
        rho, phi, rate = _bearing(point, twist)
        alpha = self.limits.alpha_max if rate > 0.0 else -self.limits.alpha_max if rate else 0.0
        return -twist[0] * twist[0] / rho * math.cos(phi), alpha

    def rows(self, point: Point, twist: Twist) -> Rows:
        r"""Rows :math:`\dot b \ge -\gamma b` on the accelerations :math:`(a, \alpha)`.

        With :math:`p = s\dot\varphi` and :math:`d'(p) = p/(\alpha_{max} - k_vp)`, 0 for
        :math:`p \le 0`,

        .. math::
            d'\,s\left(\alpha - \frac a\rho\sin\varphi\right) \ge
            p + d'\,s\left(\frac{v^2}{\rho^2}\sin\varphi\cos\varphi +
            \frac v\rho\cos\varphi\,\dot\varphi\right) - \gamma\,b_s,\qquad
            a \le \gamma\,b_v - k_vv\cos\varphi

        They bound the accelerations of this instant. Where a bearing at rest is at the edge
        (:math:`p = b_s = 0`) no acceleration is excluded, so held for a period one may leave
        the set: use ``held_rows`` in a loop that ticks.

        Parameters
        ----------
        point : point at rest to be kept in view, seen from the rotation centre [m]
        twist : twist of the body now

        Returns
        -------
        Rows named "viable.left", "viable.right" and "viable.approach", priority SAFETY, A of
        shape (3, 2) with columns :math:`a` and :math:`\alpha`, values as ``margins``

        Raises
        ------
        GeometryError : point or twist is not finite; the point is at the rotation centre; the
            bearing moves outward at :math:`\alpha_{max}/k_v` or more, where no braking angle
            exists
        """
        rho, phi, rate = self.braked_bearing(point, twist)
        k, alpha_max, v = self.approach_rate, self.limits.alpha_max, twist[0]
        q, s, c = v / rho, math.sin(phi), math.cos(phi)
        values = self.margins(point, twist)
        drift = q * q * s * c + q * c * rate
        coefficients: list[Row] = []
        for sign, value in ((1.0, values[0]), (-1.0, values[1])):
            p = sign * rate
            slope = sign * p / (alpha_max - k * p) if p > 0.0 else 0.0
            coefficients.append((slope * s / rho, -slope, self.gain * value - p - slope * drift))
        coefficients.append((1.0, 0.0, self.gain * values[2] - k * v * c))
        return Rows(
            ("viable.left", "viable.right", "viable.approach"),
            tuple(coefficients),
            Priority.SAFETY,
            values,
        )


def stopping_angle(rate: float, brake: float, growth: float) -> float:
    r"""Angle covered until :math:`\dot p = -w + kp` has stopped an outward rate p [rad].

    .. math:: -\frac pk - \frac w{k^2}\ln\!\left(1 - \frac{kp}w\right)

    0 for a rate that is not outward, infinite where :math:`kp \ge w`.
    """
    share = growth * rate / brake
    if not share > 0.0:
        return 0.0
    if share >= 1.0:
        return math.inf
    if share < _SERIES_BELOW:
        series = share * share * (0.5 + share * (1 / 3 + share * (0.25 + share * 0.2)))
    else:
        series = -share - math.log1p(-share)
    return brake / (growth * growth) * series


def _largest_approach_rate(limits: Limits, half_angle: float, period: float) -> float:
    return min(
        limits.a_max / limits.v_max,
        (limits.omega_max - limits.alpha_max * period) / math.sin(half_angle),
        _MOST_GROWTH / period,
    )


def _bearing(point: Point, twist: Twist) -> tuple[float, float, float]:
    """Range, bearing and bearing rate of a point at rest."""
    check_finite("point and twist", point, twist)
    x, y = point
    rho = math.hypot(x, y)
    if rho == 0.0:
        raise GeometryError(f"the bearing of {point!r} is undefined: it is where it is seen from")
    return rho, math.atan2(y, x), twist[0] * y / (rho * rho) - twist[1]
