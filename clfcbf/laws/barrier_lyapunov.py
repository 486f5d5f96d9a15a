"""A polar law whose Lyapunov function is also a barrier: it grows without bound at the edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.laws.kanayama import check_gains, sinc
from clfcbf.limits import Limits
from clfcbf.se2 import Twist
from clfcbf.unicycle import Polar

__all__ = ["BarrierLyapunov"]


@dataclass(frozen=True, slots=True)
class BarrierLyapunov:
    r"""Law that keeps :math:`|\varphi| < \Phi` and turns the line of sight to the axis.

    .. math::
        v = k\rho\cos\varphi, \qquad \omega = k\,\Omega, \qquad
        \Omega = \sin\varphi\cos\varphi
            + \kappa\frac{\sin\varphi}{\varphi}\cos\varphi\Big(1 - \frac{\varphi^2}{\Phi^2}\Big)
              \delta + c\,\varphi

    .. math::
        W = \tfrac12\delta^2 - \frac{\Phi^2}{2\kappa}\ln\Big(1 - \frac{\varphi^2}{\Phi^2}\Big),
        \qquad
        \dot W = -\frac{k c}{\kappa}\,\frac{\varphi^2}{1 - \varphi^2/\Phi^2}

    and :math:`\tfrac{d}{dt}\tfrac12\rho^2 = -k\rho^2\cos^2\varphi`. No term blows up at the
    edge, where :math:`\dot\varphi = \mp k c\,\Phi`. Barrier Lyapunov functions: [Tee2009]_;
    in polar coordinates for parking: [Todorovski2025]_.

    The rate k is a free scaling of time: it may vary at will without leaving the path, so
    limits are kept by lowering it, and lowering it to 0 brakes on the same path.

    Attributes
    ----------
    half_angle : :math:`\Phi` [rad], in (0, pi/2), of the bearing about the robot's centre
    stiffness : :math:`\kappa`; 25, with damping 10 a double root of 5 per unit of log range,
        which settles within the log range of a usual approach
    damping : c; 10, critical for a stiffness of 25
    rate : largest k [1/s]; at 0.5 the speed limit rules down to the last half metre

    Raises
    ------
    ConfigurationError : a gain is not finite and positive, or the half angle is outside its
        range

    Notes
    -----
    Centre it on the viewed feature, whose range never vanishes, and stop at the standoff. At or
    beyond the edge the factor :math:`1 - \varphi^2/\Phi^2` is held at 0, so the bearing still
    decays and the command is continuous. Linearised, the rates r per unit of log range solve
    :math:`r^2 - c\,r + \kappa = 0`; both above 1 bring the curvature to 0.
    """

    half_angle: float
    stiffness: float = 25.0
    damping: float = 10.0
    rate: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 < self.half_angle < 0.5 * math.pi:
            raise ConfigurationError(
                f"BarrierLyapunov: half_angle must be in (0, pi/2) rad, got {self.half_angle!r}"
            )
        check_gains(
            "BarrierLyapunov", stiffness=self.stiffness, damping=self.damping, rate=self.rate
        )

    def _inside(self, phi: float) -> float:
        return max(0.0, 1.0 - (phi / self.half_angle) ** 2)

    def shape(self, state: Polar) -> Twist:
        r"""The twist per unit of k, :math:`(\rho\cos\varphi, \Omega)`: [m], [rad]."""
        rho, phi, delta = state
        c = math.cos(phi)
        pull = self.stiffness * sinc(phi) * c * self._inside(phi) * delta
        return Twist(rho * c, math.sin(phi) * c + pull + self.damping * phi)

    def largest_rate(self, state: Polar, limits: Limits) -> float:
        r"""Largest k within the speed limits, at most ``rate`` [1/s].

        :math:`k = \min(k_0,\ v_{max}/(\rho\cos\varphi),\ \omega_{max}/|\Omega|)`
        """
        v, omega = self.shape(state)
        k = self.rate
        # Behind the robot's axis the law reverses, and the reverse speed bounds it.
        top = limits.v_max if v > 0.0 else -limits.reverse_speed
        if k * abs(v) > top:
            k = top / abs(v)
        if k * abs(omega) > limits.omega_max:
            k = limits.omega_max / abs(omega)
        return k

    def command(self, state: Polar, limits: Limits) -> Twist:
        """The twist toward the feature at the largest rate that keeps both speed limits.

        Parameters
        ----------
        state : the feature about the robot's centre
        limits : ``v_max``, ``v_min`` and ``omega_max`` are used; the accelerations are the
            caller's, by lowering the rate of :meth:`shape`
        """
        return self.shape(state).scaled(self.largest_rate(state, limits))

    def lyapunov(self, state: Polar) -> float:
        """W [rad²].

        Raises
        ------
        GeometryError : the bearing is at or beyond the half angle, where W is infinite
        """
        _, phi, delta = state
        self._check(phi)
        squared = (phi / self.half_angle) ** 2
        wall = self.half_angle**2 / (2.0 * self.stiffness) * math.log1p(-squared)
        return 0.5 * delta * delta - wall

    def decay(self, state: Polar, rate: float) -> float:
        """-dW/dt under the law at the rate k [rad²/s]; zero on phi = 0, so only semidefinite.

        Raises
        ------
        GeometryError : the bearing is at or beyond the half angle
        """
        phi = state.phi
        self._check(phi)
        return rate * self.damping / self.stiffness * phi * phi / self._inside(phi)

    def predicted_delta(self, state: Polar, standoff: float) -> float:
        r"""Line of sight left at the standoff, linearised; times the standoff, the lateral error.

        Over :math:`T = \ln(\rho/d_f)`, with :math:`\sigma = c/2`, :math:`D = \sigma^2 - \kappa`:
        :math:`\delta(T) = e^{-\sigma T}[\delta_0\cosh\sqrt D T
        + (\varphi_0 + \sigma\delta_0)\sinh(\sqrt D T)/\sqrt D]`; for a double root
        :math:`(\delta_0 + (\varphi_0 + r\delta_0)T)e^{-rT}`.

        Parameters
        ----------
        state : the feature about the robot's centre
        standoff : range at which the approach ends [m]

        Raises
        ------
        GeometryError : the standoff is not between 0 and the range
        """
        rho, phi, delta = state
        if not 0.0 < standoff <= rho:
            raise GeometryError(f"standoff must be in (0, {rho!r}] m, got {standoff!r}")
        T = math.log(rho / standoff)
        sigma = 0.5 * self.damping
        D = sigma * sigma - self.stiffness
        root = math.sqrt(abs(D))
        if D > 0.0:
            even, odd = math.cosh(root * T), math.sinh(root * T) / root
        elif D < 0.0:
            even, odd = math.cos(root * T), math.sin(root * T) / root
        else:
            even, odd = 1.0, T
        return math.exp(-sigma * T) * (delta * even + (phi + sigma * delta) * odd)

    def _check(self, phi: float) -> None:
        if not abs(phi) < self.half_angle:
            raise GeometryError(
                f"bearing {math.degrees(phi):.2f} degrees is not inside the half angle "
                f"{math.degrees(self.half_angle):.2f}: the barrier is infinite there"
            )
