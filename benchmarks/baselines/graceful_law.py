"""Nav2's smooth control law and the parameters of its docking.

Written from the behaviour of navigation2 (commit a3a9704, August 2026), packages
nav2_graceful_controller and opennav_docking; names and defaults are theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from clfcbf.errors import ConfigurationError
from clfcbf.laws.kanayama import check_gains
from clfcbf.laws.park_kuipers import ParkKuipers
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.unicycle import Polar

__all__ = ["GracefulLaw", "GracefulParameters", "Trigger"]

Trigger = Literal["braking", "threshold"]


@dataclass(frozen=True, slots=True)
class GracefulParameters:
    """Parameters of law and server; the defaults are Nav2's.

    Attributes
    ----------
    k_phi, k_delta, beta, lam : of the law, lam being its exponent lambda
    v_linear_min, v_linear_max : of the command [m/s], the latter at most the chassis's
    v_angular_max : as above [rad/s]
    slowdown_radius : range below which the speed falls with it [m]
    deceleration_max : of the approach [m/s²]
    projection : how far beyond the dock the target is put [m]
    docking_threshold : distance at which the robot counts as docked [m]
    trigger : "braking" stops where the brake ends at the dock; "threshold", as in Nav2, begins to
        brake at the docking threshold, for a dock that the robot is to run into
    max_retries : failed approaches after which it gives up; 0 leaves the server's loop out
    staging_x_offset : where a retry begins, in the dock's frame [m]
    staging_tolerance, staging_tolerance_theta : within which it has been reached [m, rad]
    detection_timeout : age of a measurement above which an approach has failed [s]
    approach_timeout : of an approach, and of the way back to the staging pose [s]
    """

    k_phi: float = 3.0
    k_delta: float = 2.0
    beta: float = 0.4
    lam: float = 2.0
    v_linear_min: float = 0.1
    v_linear_max: float = 0.25
    v_angular_max: float = 0.75
    slowdown_radius: float = 0.25
    deceleration_max: float = 2.5
    projection: float = 0.25
    docking_threshold: float = 0.05
    trigger: Trigger = "braking"
    max_retries: int = 3
    staging_x_offset: float = -0.7
    staging_tolerance: float = 0.05
    staging_tolerance_theta: float = 0.05
    detection_timeout: float = 1.0
    approach_timeout: float = 30.0

    def __post_init__(self) -> None:
        positive = {
            name: getattr(self, name)
            for name in self.__slots__
            if name not in ("trigger", "max_retries", "staging_x_offset", "v_linear_min",
                            "projection")
        }  # fmt: skip
        check_gains("GracefulParameters", **positive)
        for name in ("v_linear_min", "projection", "max_retries"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ConfigurationError(f"{name} must be finite and at least 0, got {value!r}")
        if self.v_linear_min > self.v_linear_max:
            raise ConfigurationError(
                f"v_linear_min must be at most v_linear_max = {self.v_linear_max!r}, "
                f"got {self.v_linear_min!r}"
            )
        if self.trigger not in get_args(Trigger):
            raise ConfigurationError(
                f"trigger must be one of {', '.join(get_args(Trigger))}; got {self.trigger!r}"
            )


@dataclass(frozen=True, slots=True)
class GracefulLaw:
    r"""The smooth control law toward a pose, forward or backward.

    .. math::
        v = \mathrm{clamp}\Big(\min\Big(\frac{v_{max}}{1 + \beta|\kappa|^\lambda},\
            v_{max}\frac{\rho}{r_s},\ \sqrt{2\rho d}\Big),\ v_{min},\ v_{max}\Big),\qquad
        \omega = \mathrm{clamp}(\kappa v, \pm\omega_{max}),\qquad v = \omega/\kappa

    with the curvature of :class:`clfcbf.laws.park_kuipers.ParkKuipers` [Park2011]_; Nav2's
    delta is :math:`-\varphi`, its phi :math:`-\delta`. Backward, bearing and line of sight are
    those of the robot's rear.
    """

    parameters: GracefulParameters

    def polar(self, target: Pose2, backward: bool = False) -> Polar:
        """The target about the robot's front, or its rear."""
        rho, phi, delta = Polar.of(target)
        if backward:
            return Polar(rho, wrap_angle(phi + math.pi), wrap_angle(delta + math.pi))
        return Polar(rho, phi, delta)

    def curvature(self, state: Polar) -> float:
        """Of the path, signed as when driving forward [1/m].

        Raises
        ------
        GeometryError : the range is not positive
        """
        p = self.parameters
        return ParkKuipers(p.k_phi, p.k_delta, p.beta, p.lam).curvature(state)

    def twist(self, target: Pose2, backward: bool = False) -> Twist:
        """The command toward ``target``, seen from the robot."""
        p, state = self.parameters, self.polar(target, backward)
        kappa = self.curvature(state)
        v = min(
            p.v_linear_max / (1.0 + p.beta * abs(kappa) ** p.lam),
            p.v_linear_max * state.rho / p.slowdown_radius,
            math.sqrt(2.0 * state.rho * p.deceleration_max),
        )
        v = min(max(v, p.v_linear_min), p.v_linear_max)
        omega = min(max(kappa * v, -p.v_angular_max), p.v_angular_max)
        v = omega / kappa if kappa else v
        return Twist(-v, omega) if backward else Twist(v, omega)
