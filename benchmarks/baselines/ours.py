"""Our own controllers as methods of the comparison: the docking controller and the paper's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.baselines.law import DEADLINE
from benchmarks.baselines.method import Method, Range, Setup
from clfcbf import defaults
from clfcbf.controller import DockingController
from clfcbf.decision import Decision, Failure, Phase, Status
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.paper import CLF_DECAY, ERROR_WEIGHTS, INPUT_WEIGHTS, SLACK_WEIGHT, PaperConfig
from clfcbf.paper_docking import PaperDocking
from clfcbf.scene import Observation
from clfcbf.se2 import Twist
from clfcbf.simulation.episode import EpisodeController
from clfcbf.trajectories.following import FollowingGains

__all__ = ["CLF_CBF", "PAPER", "PAPER_TUNED", "Deadline", "OurGains", "PaperWeights"]


class Deadline:
    """Any controller, given up after a time, and for good once it has failed.

    ``seconds`` count from the first tick.
    """

    def __init__(
        self, controller: EpisodeController, limits: Limits, period: float,
        seconds: float = DEADLINE,
    ) -> None:  # fmt: skip
        if not (math.isfinite(seconds) and seconds > 0.0):
            raise ConfigurationError(f"seconds must be finite and positive, got {seconds!r}")
        self.controller, self.limits, self.period = controller, limits, period
        self.seconds = seconds
        self.started = math.inf
        self.failure = ""
        self.kind: Failure | None = Failure.GAVE_UP

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The controller's decision until the deadline or its failure, a brake from then on."""
        decision = self.controller.step(observation, applied, now)
        if not self.failure:
            self.started = min(self.started, now)
            if decision.phase is Phase.FAILED:
                self.failure, self.kind = decision.reason or "failed", decision.failure
                return decision
            if decision.done or now - self.started <= self.seconds:
                return decision
            self.failure = f"gave up after {self.seconds:g} s"
        box = self.limits.input_box(applied, self.period)
        return decision._replace(
            twist=box.clip(Twist(0.0, 0.0)), status=Status.STOPPED, done=False,
            phase=Phase.FAILED, reason=self.failure, failure=self.kind,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class OurGains:
    """What is tunable of the docking controller; the defaults are the library's.

    Attributes
    ----------
    k2, k3, heading, settle_x, settle_theta : of the path-following law
    fraction : share of the law's decay that the Lyapunov row demands
    turn_weight : weight of the turn rate in the program, that of the speed being 1
    """

    k2: float = defaults.FOLLOW_K2
    k3: float = defaults.FOLLOW_K3
    heading: float = defaults.FOLLOW_HEADING
    settle_x: float = defaults.SETTLE_X
    settle_theta: float = defaults.SETTLE_THETA
    fraction: float = defaults.CLF_FRACTION
    turn_weight: float = defaults.QP_WEIGHT[2]


def _ours(setup: Setup, gains: OurGains) -> Deadline:
    law = FollowingGains(gains.k2, gains.k3, gains.heading, gains.settle_x, gains.settle_theta)
    controller = DockingController(
        setup.limits, setup.camera, setup.standoff, setup.period, lag=setup.lag,
        weight=(1.0, 0.0, gains.turn_weight), gains=law, fraction=gains.fraction,
    )  # fmt: skip
    return Deadline(controller, setup.limits, setup.period)


@dataclass(frozen=True, slots=True)
class PaperWeights:
    """The paper's weights and gains as plain numbers, see :class:`clfcbf.paper.PaperConfig`.

    Attributes
    ----------
    h_x, h_y, h_theta : diagonal of H
    q_v, q_omega : diagonal of the input weight
    c_delta : weight of the squared slack
    mu, lam : decay of the Lyapunov row and gain of the barrier row [1/s]
    """

    h_x: float = ERROR_WEIGHTS[0]
    h_y: float = ERROR_WEIGHTS[1]
    h_theta: float = ERROR_WEIGHTS[2]
    q_v: float = INPUT_WEIGHTS[0]
    q_omega: float = INPUT_WEIGHTS[1]
    c_delta: float = SLACK_WEIGHT
    mu: float = CLF_DECAY
    lam: float = 1.0

    def config(self, half_angle: float) -> PaperConfig:
        """As printed in all else, but for the acceleration limits, which are per second."""
        return PaperConfig(
            H=(self.h_x, self.h_y, self.h_theta),
            Q_u=(self.q_v, self.q_omega),
            c_delta=self.c_delta,
            mu=self.mu,
            lam=self.lam,
            half_angle=half_angle,
            per_step_acceleration=False,
        )


def _paper(setup: Setup, weights: PaperWeights) -> Deadline:
    controller = PaperDocking(
        setup.limits, setup.camera, setup.standoff, setup.period, lag=setup.lag,
        config=weights.config(setup.camera.half_angle),
    )  # fmt: skip
    return Deadline(controller, setup.limits, setup.period)


CLF_CBF = Method(
    name="clf-cbf",
    about="ours: plan, CLF-CBF program, guard",
    source="clfcbf.DockingController",
    departures=(),
    stock=OurGains(),
    space={
        "k2": Range(5.0, 100.0), "k3": Range(3.0, 30.0), "heading": Range(0.5, 6.0),
        "settle_x": Range(1.0, 8.0), "settle_theta": Range(1.0, 10.0),
        "fraction": Range(0.05, 1.0, False), "turn_weight": Range(0.03, 3.0),
    },
    build=_ours,
)  # fmt: skip

_PAPER_DEPARTURES = (
    "The paper prints neither weights nor gains: these are assumptions.",
    "The acceleration limits are per second, as the chassis has them; it prints increments of one "
    "step.",
    "Its barrier is on the viewed feature; on the goal pose it would be undefined at the end.",
    "The quintic leaves and arrives with an acceleration along the headings; with none it would "
    "be a straight line.",
    "Over when the trajectory has ended and the commands are those of rest; the paper does not "
    "say when. It gives up after 55 s.",
    "The pose is predicted over the latency but not over the body's lag, which it does not model.",
)
_PAPER_SPACE = {
    "h_x": Range(0.3, 30.0), "h_y": Range(0.3, 30.0), "h_theta": Range(0.1, 10.0),
    "q_v": Range(0.01, 10.0), "q_omega": Range(0.01, 10.0), "c_delta": Range(1e2, 1e10),
    "mu": Range(0.2, 10.0), "lam": Range(0.2, 5.0),
}  # fmt: skip

PAPER = Method(
    name="paper",
    about="the paper's CLF-CBF program as printed",
    source="Xie et al., arXiv 2401.08433",
    departures=_PAPER_DEPARTURES,
    stock=PaperWeights(),
    space=_PAPER_SPACE,
    build=_paper,
)

PAPER_TUNED = Method(
    name="paper-tuned",
    about="the paper's CLF-CBF program, weights tuned",
    source="Xie et al., arXiv 2401.08433",
    departures=(
        "The paper prints neither weights nor gains: these are the best of 59 drawn at random and "
        "around the best, on 8 starts of R1 with sensor A and the usual body.",
        *_PAPER_DEPARTURES[1:],
    ),
    stock=PaperWeights(
        h_x=1.55, h_y=3.18, h_theta=0.16, q_v=2.81, q_omega=0.131, c_delta=6.56e9, mu=3.7, lam=2.29
    ),
    space=_PAPER_SPACE,
    build=_paper,
)
