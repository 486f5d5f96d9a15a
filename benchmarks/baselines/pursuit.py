"""Pure pursuit along the axis of approach, with a rotation on the spot at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.baselines.driver import LawController
from benchmarks.baselines.law import Answer, View, arrival_speed, within
from benchmarks.baselines.method import Method, Range, Setup
from clfcbf.laws.kanayama import check_gains
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle

__all__ = ["PURE_PURSUIT", "PursuitGains", "PursuitLaw"]


@dataclass(frozen=True, slots=True)
class PursuitGains:
    """Parameters of the law.

    Attributes
    ----------
    lookahead : distance of the carrot along the axis, from the foot of the robot on it [m];
        0.6, the default of Nav2's regulated pure pursuit
    approach : gain of the remaining distance near the end [1/s]; 1 slows down within the
        acceleration limit from 0.22 m/s
    rotate : gain of the heading in the final rotation [1/s]; 2 settles 20° in 1.5 s
    brake : share of the acceleration limits that slows down toward the end; the rest is for
        what the clipping delays
    """

    lookahead: float = 0.6
    approach: float = 1.0
    rotate: float = 2.0
    brake: float = 0.8

    def __post_init__(self) -> None:
        check_gains(
            "PursuitGains", lookahead=self.lookahead, approach=self.approach, rotate=self.rotate,
            brake=self.brake,
        )  # fmt: skip


class PursuitLaw:
    r"""Coulter's law toward a carrot on the axis, then a turn to the goal's heading.

    A carrot at :math:`(x, y)` in the robot's frame is reached along the circle of curvature
    :math:`\kappa = 2y/(x^2 + y^2)`. The carrot runs on beyond the goal, so the curvature stays
    bounded. Past the goal's lateral axis the robot turns on the spot for good.
    """

    def __init__(self, gains: PursuitGains, limits: Limits) -> None:
        self.gains, self.limits = gains, limits
        self.turning = False

    def curvature(self, pose: Pose2) -> float:
        """Curvature from ``pose`` in the goal's frame [1/m]."""
        x, y = pose.seen((pose.x + self.gains.lookahead, 0.0))
        return 2.0 * y / (x * x + y * y)

    def command(self, view: View) -> Answer:
        """The command at a tick."""
        gains, limits = self.gains, self.limits
        if view.pose.x > -_END:
            self.turning = True
        if self.turning:
            theta = wrap_angle(view.pose.theta)
            slowest = math.sqrt(2.0 * gains.brake * limits.alpha_max * abs(theta))
            omega = min(gains.rotate * abs(theta), slowest, limits.omega_max)
            return Answer(Twist(0.0, -math.copysign(omega, theta)))
        v = arrival_speed(-view.pose.x, gains.approach, gains.brake, limits)
        return Answer(within(Twist(v, v * self.curvature(view.pose)), limits))


_END = 0.003
"""[m] Before the goal's lateral axis: where the approach gain asks for a few mm/s only."""


def _build(setup: Setup, gains: PursuitGains) -> LawController:
    return LawController(setup, PursuitLaw(gains, setup.limits))


PURE_PURSUIT = Method(
    name="pure-pursuit",
    about="pure pursuit on the axis, then a rotation",
    source="Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01, "
    "1992; look-ahead of Nav2's regulated pure pursuit",
    departures=(
        "The look-ahead is measured along the axis from the robot's foot on it, so that there is "
        "a carrot at any lateral distance.",
        "The path goes on beyond the goal, else the look-ahead would shrink to nothing there.",
        "It does not know of the field of view.",
    ),
    stock=PursuitGains(),
    space={
        "lookahead": Range(0.15, 1.5), "approach": Range(0.5, 4.0), "rotate": Range(0.5, 5.0),
        "brake": Range(0.4, 1.0, False),
    },
    build=_build,
)  # fmt: skip
