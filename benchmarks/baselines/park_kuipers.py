"""Park and Kuipers' law saturated to the field of view and centred on the viewed feature."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.baselines.driver import LawController
from benchmarks.baselines.law import Answer, View, arrival_speed, within
from benchmarks.baselines.method import Method, Range, Setup
from clfcbf.errors import ConfigurationError
from clfcbf.laws.kanayama import check_gains
from clfcbf.laws.park_kuipers import ParkKuipers
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.unicycle import Polar

__all__ = ["PARK_KUIPERS", "ParkKuipersGains", "SaturatedLaw", "centre_bearing"]


@dataclass(frozen=True, slots=True)
class ParkKuipersGains:
    """Parameters of the law.

    Attributes
    ----------
    k_phi, k_delta, beta, exponent : as in :class:`clfcbf.laws.park_kuipers.ParkKuipers`
    share : of the bearing that the view allows at the standoff, taken by the manifold
    approach : gain of the remaining range near the end [1/s]
    brake : share of the acceleration limit that slows down toward the end
    """

    k_phi: float = 3.0
    k_delta: float = 2.0
    beta: float = 0.4
    exponent: float = 2.0
    share: float = 0.9
    approach: float = 1.0
    brake: float = 0.8

    def __post_init__(self) -> None:
        check_gains("ParkKuipersGains", approach=self.approach, brake=self.brake)
        if not 0.0 < self.share < 1.0:
            raise ConfigurationError(f"share must be in (0, 1), got {self.share!r}")
        ParkKuipers(self.k_phi, self.k_delta, self.beta, self.exponent)


def centre_bearing(setup: Setup) -> float:
    r"""Largest bearing about the robot's centre that the camera sees at the standoff [rad].

    For a camera :math:`c` ahead of the centre, on its axis,
    :math:`\varphi = \Phi - \arcsin(c\sin\Phi/d_f)`; it only grows with the range.

    Raises
    ------
    ConfigurationError : the camera looks aside or sits beside the axis, or none is visible
    """
    x, y, yaw = setup.camera.camera
    if y or yaw:
        raise ConfigurationError(
            f"the law needs a camera on the robot's axis, looking ahead; got {setup.camera.camera}"
        )
    edge = setup.camera.half_angle
    reach = x * math.sin(edge) / setup.standoff
    bearing = edge - math.asin(reach) if abs(reach) <= 1.0 else 0.0
    if not bearing > 0.0:
        raise ConfigurationError(
            f"a camera {x!r} m ahead sees nothing of a feature {setup.standoff!r} m ahead"
        )
    return min(bearing, edge)


@dataclass(frozen=True, slots=True)
class SaturatedLaw:
    """The law toward the feature; the speed falls as the range nears ``standoff`` [m]."""

    law: ParkKuipers
    gains: ParkKuipersGains
    limits: Limits
    standoff: float

    def twist(self, state: Polar) -> Twist:
        """The command within the speed limits; rest at and inside the standoff."""
        gains, limits = self.gains, self.limits
        kappa = self.law.curvature(state)
        slow = limits.v_max / (1.0 + gains.beta * abs(kappa) ** gains.exponent)
        rest = state.rho - self.standoff
        v = min(slow, arrival_speed(rest, gains.approach, gains.brake, limits))
        return within(Twist(v, kappa * v), limits)

    def command(self, view: View) -> Answer:
        """The command at a tick."""
        x, y = view.feature
        return Answer(self.twist(Polar.of(Pose2(x, y, view.goal.theta))))


def _build(setup: Setup, gains: ParkKuipersGains) -> LawController:
    law = ParkKuipers(
        gains.k_phi, gains.k_delta, gains.beta, gains.exponent,
        bearing_limit=gains.share * centre_bearing(setup),
    )  # fmt: skip
    return LawController(setup, SaturatedLaw(law, gains, setup.limits, setup.standoff))


PARK_KUIPERS = Method(
    name="park-kuipers",
    about="Park-Kuipers law saturated to the view",
    source="Park and Kuipers, ICRA 2011; the saturation of its manifold is ours, "
    "clfcbf.laws.park_kuipers",
    departures=(
        "The manifold is bent to stay inside the field of view, and centred on the viewed "
        "feature, so that the bearing bounded is the camera's.",
        "It stops at the standoff, with a line of sight and so a lateral error left.",
        "Its invariance is for the path: the acceleration limits are met by clipping.",
    ),
    stock=ParkKuipersGains(),
    space={
        "k_phi": Range(1.0, 10.0), "k_delta": Range(1.0, 10.0), "beta": Range(0.02, 2.0),
        "share": Range(0.5, 0.98, False), "approach": Range(0.5, 4.0),
        "brake": Range(0.4, 1.0, False),
    },
    build=_build,
)  # fmt: skip
