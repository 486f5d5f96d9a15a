r"""Two polar laws of one form, each with its Lyapunov function: to a goal, and to a feature.

With range, bearing and line of sight as in :class:`clfcbf.unicycle.Polar`, a nominal speed
:math:`v = \gamma e\cos\varphi` (:math:`e` the distance still to go) and

.. math::
    \omega = k\varphi + \frac{v}{\rho}\,\frac{\sin\varphi}{\varphi}\,(\varphi + h\delta),\qquad
    V = \tfrac12 e^2 + \tfrac12(\varphi^2 + h\delta^2)

obey :math:`\dot V = -e\,v\cos\varphi - k\varphi^2`, which is at most 0 for every :math:`v` of
the sign of :math:`e\cos\varphi`. So the speed limit may cut :math:`v`, and the turn-rate limit
slow down both, without making V grow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.baselines.driver import LawController
from benchmarks.baselines.law import Answer, View, within
from benchmarks.baselines.method import Method, Range, Setup
from clfcbf.errors import GeometryError
from clfcbf.laws.kanayama import check_gains, sinc
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.unicycle import Polar

__all__ = ["AICARDI", "FEATURE_POLAR", "PolarGains", "PolarLaw"]


@dataclass(frozen=True, slots=True)
class PolarGains:
    """Gains of the law.

    Attributes
    ----------
    gamma : of the distance [1/s]
    k : of the bearing [1/s]
    h : weight of the line of sight against the bearing
    """

    gamma: float
    k: float
    h: float

    def __post_init__(self) -> None:
        check_gains("PolarGains", gamma=self.gamma, k=self.k, h=self.h)


@dataclass(frozen=True, slots=True)
class PolarLaw:
    """The law of this module toward a point that is ``standoff`` [m] behind its target.

    With standoff 0 the target is the goal itself [Aicardi1995]_, else the viewed feature.
    """

    gains: PolarGains
    limits: Limits
    standoff: float = 0.0

    def twist(self, state: Polar) -> Twist:
        """The command within the speed limits.

        Raises
        ------
        GeometryError : the range is not positive
        """
        return within(self._free(state), self.limits)

    def _free(self, state: Polar) -> Twist:
        """The command before the turn-rate limit slows it down."""
        rho, phi, delta = state
        if not rho > 0.0:
            raise GeometryError(f"the law needs a range above 0 m, got {rho!r}")
        gamma, k, h = self.gains.gamma, self.gains.k, self.gains.h
        v = gamma * (rho - self.standoff) * math.cos(phi)
        v = min(max(v, self.limits.reverse_speed), self.limits.v_max)
        return Twist(v, k * phi + v / rho * sinc(phi) * (phi + h * delta))

    def lyapunov(self, state: Polar) -> float:
        """V of the module's head."""
        rho, phi, delta = state
        return 0.5 * ((rho - self.standoff) ** 2 + phi * phi + self.gains.h * delta * delta)

    def decay(self, state: Polar) -> float:
        r""":math:`-\dot V` under :meth:`twist`: 0 at :math:`e = 0, \varphi = 0`, whatever δ."""
        rho, phi, _ = state
        free = self._free(state)
        slowed = self.twist(state).omega / free.omega if free.omega else 1.0
        pull = (rho - self.standoff) * free.v * math.cos(phi)
        return slowed * (pull + self.gains.k * phi * phi)

    def command(self, view: View) -> Answer:
        """The command at a tick."""
        if self.standoff == 0.0:
            return Answer(self.twist(Polar.of(view.goal)))
        x, y = view.feature
        # The feature's heading is the goal's: the standoff leads from one to the other.
        return Answer(self.twist(Polar.of(Pose2(x, y, view.goal.theta))))


def _to_goal(setup: Setup, gains: PolarGains) -> LawController:
    return LawController(setup, PolarLaw(gains, setup.limits))


def _to_feature(setup: Setup, gains: PolarGains) -> LawController:
    return LawController(setup, PolarLaw(gains, setup.limits, setup.standoff))


AICARDI = Method(
    name="aicardi",
    about="polar parking law to the goal",
    source="Aicardi, Casalino, Bicchi and Balestrino, IEEE Robotics & Automation Magazine 2(1), "
    "1995; gains of the Robotarium's create_parking_controller",
    departures=(
        "The speed limit cuts v before the turn rate is computed from it, and the turn-rate limit "
        "slows down both, so that V still falls; the Robotarium clips wheel speeds.",
        "It does not know of the field of view.",
    ),
    stock=PolarGains(gamma=1.0, k=1.0, h=1.0),
    space={"gamma": Range(0.2, 2.0), "k": Range(0.3, 6.0), "h": Range(0.3, 20.0)},
    build=_to_goal,
)

FEATURE_POLAR = Method(
    name="feature-polar",
    about="feature-centred polar law (Chen-like)",
    source="after the variables of arXiv 2107.13365 (virtual landmark, bearing of the object's "
    "centre, line of sight in the object's frame)",
    departures=(
        "That paper's own law and gains could not be obtained: this is a law in its variables "
        "with the Lyapunov function above, not theirs.",
        "The bearing is that about the robot's centre; theirs is the camera's, ahead of it.",
        "The field of view is not enforced: they restrict the initial states instead.",
        "Once the range is the standoff, V falls no more and the line of sight stays as it is: "
        "from beside the axis it ends beside the goal.",
    ),
    stock=PolarGains(gamma=0.5, k=2.0, h=5.0),
    space={"gamma": Range(0.2, 1.0), "k": Range(0.5, 4.0), "h": Range(0.5, 20.0)},
    build=_to_feature,
)
