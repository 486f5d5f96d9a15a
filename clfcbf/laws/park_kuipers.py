"""The graceful-motion law of Park and Kuipers, and its form saturated to the field of view."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.laws.kanayama import check_gains
from clfcbf.limits import Limits
from clfcbf.se2 import Twist
from clfcbf.unicycle import Polar

__all__ = ["ParkKuipers"]


@dataclass(frozen=True, slots=True)
class ParkKuipers:
    r"""Park and Kuipers' law [Park2011]_, as the docking server of Nav2 uses it.

    With the manifold :math:`\varphi = -\psi(\delta)`,
    :math:`\psi = \beta_m\arctan(k_\varphi\delta/\beta_m)`, :math:`\beta_m = 2\Phi_m/\pi`:

    .. math::
        \kappa = \frac1\rho\big[k_\delta(\varphi + \psi(\delta))
            + (1 + \psi'(\delta))\sin\varphi\big], \qquad
        v = \frac{v_{max}}{1 + \beta|\kappa|^\lambda}, \qquad \omega = \kappa v

    :math:`z = \varphi + \psi(\delta)` then obeys :math:`\dot z = -k_\delta (v/\rho) z`, so
    :math:`V = \tfrac12 z^2` has :math:`\dot V = -k_\delta (v/\rho) z^2`. The bearing on the
    manifold is below :math:`\Phi_m`: the standard law has :math:`\Phi_m = \pi/2`. With
    :math:`\Phi_m` below a view's half angle :math:`\Phi`, :math:`|\varphi| \le \Phi` is
    forward invariant, for at :math:`\varphi = \Phi`,
    :math:`\dot\varphi = (v/\rho)[-k_\delta(\Phi + \psi) - \psi'\sin\Phi] < 0`.

    Attributes
    ----------
    k_phi : approach to the axis; 3, Nav2's. Curvature stays bounded at the goal from 1 up
    k_delta : approach to the manifold; 2, Nav2's. As ``k_phi``
    beta, exponent : slow-down in curves; 0.4 and 2, Nav2's
    slowdown_radius : range below which the speed is proportional to it [m]; 0.25, Nav2's
    bearing_limit : :math:`\Phi_m` [rad], in (0, pi/2]; pi/2 is the law as published

    Raises
    ------
    ConfigurationError : a gain is not finite and positive, or the bearing limit is outside its
        range
    """

    k_phi: float = 3.0
    k_delta: float = 2.0
    beta: float = 0.4
    exponent: float = 2.0
    slowdown_radius: float = 0.25
    bearing_limit: float = 0.5 * math.pi

    def __post_init__(self) -> None:
        check_gains(
            "ParkKuipers",
            k_phi=self.k_phi,
            k_delta=self.k_delta,
            beta=self.beta,
            exponent=self.exponent,
            slowdown_radius=self.slowdown_radius,
        )
        if not 0.0 < self.bearing_limit <= 0.5 * math.pi:
            raise ConfigurationError(
                f"ParkKuipers: bearing_limit must be in (0, pi/2] rad, got {self.bearing_limit!r}"
            )

    def manifold(self, delta: float) -> float:
        r""":math:`\psi(\delta)`, minus the bearing wanted at the line of sight ``delta`` [rad]."""
        scale = 2.0 * self.bearing_limit / math.pi
        return scale * math.atan(self.k_phi * delta / scale)

    def manifold_slope(self, delta: float) -> float:
        r""":math:`\psi'(\delta) = k_\varphi/(1 + (k_\varphi\delta/\beta_m)^2)`."""
        scale = 2.0 * self.bearing_limit / math.pi
        return self.k_phi / (1.0 + (self.k_phi * delta / scale) ** 2)

    def curvature(self, state: Polar) -> float:
        r""":math:`\kappa = \omega/v` [1/m].

        Raises
        ------
        GeometryError : the range is not positive
        """
        rho, phi, delta = state
        if not rho > 0.0:
            raise GeometryError(f"the law needs a range above 0 m, got {rho!r}")
        z = phi + self.manifold(delta)
        return (self.k_delta * z + (1.0 + self.manifold_slope(delta)) * math.sin(phi)) / rho

    def command(self, state: Polar, limits: Limits) -> Twist:
        """The twist toward the target, its speed lowered until both speed limits hold.

        Parameters
        ----------
        state : the target about the robot's centre: the goal, or a point behind it on its axis
        limits : ``v_max`` and ``omega_max`` are used; the accelerations are the caller's

        Raises
        ------
        GeometryError : the range is not positive
        """
        kappa = self.curvature(state)
        v = limits.v_max / (1.0 + self.beta * abs(kappa) ** self.exponent)
        v = min(v, limits.v_max * state.rho / self.slowdown_radius)
        if abs(kappa) * v > limits.omega_max:
            v = limits.omega_max / abs(kappa)
        return Twist(v, kappa * v)

    def lyapunov(self, state: Polar) -> float:
        r""":math:`V = \tfrac12(\varphi + \psi(\delta))^2`; zero on the whole manifold."""
        z = state.phi + self.manifold(state.delta)
        return 0.5 * z * z

    def decay(self, state: Polar, v: float) -> float:
        r""":math:`-\dot V = k_\delta (v/\rho) z^2` [1/s] under the law at speed ``v``."""
        return 2.0 * self.k_delta * v / state.rho * self.lyapunov(state)
