"""Nav2's docking: its graceful law in the loop of its docking server, written anew."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

from benchmarks.baselines.driver import LawController
from benchmarks.baselines.graceful_law import GracefulLaw, GracefulParameters
from benchmarks.baselines.law import Answer, StopRule, View
from benchmarks.baselines.method import Method, Range, Setup
from clfcbf.decision import Failure
from clfcbf.errors import GeometryError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.trajectories.following import at_rest

__all__ = ["GRACEFUL", "GRACEFUL_RETRY", "DockingServer"]

_REST = Twist(0.0, 0.0)


class _Stage(Enum):
    APPROACH = "approach"
    STOP = "stop"
    RESET = "reset"


class DockingServer:
    """The server's loop: approach, stop, and on failure back to the staging pose and again.

    An approach fails by an old measurement, by its timeout, or by coming to rest farther from the
    dock than the threshold. Without retries only the last is a failure of its own: what else
    ends the run is left to the driver, as for every law.
    """

    def __init__(self, parameters: GracefulParameters, limits: Limits) -> None:
        top = min(parameters.v_linear_max, limits.v_max)
        self.parameters = replace(
            parameters,
            v_linear_max=top,
            v_linear_min=min(parameters.v_linear_min, top),
            v_angular_max=min(parameters.v_angular_max, limits.omega_max),
        )
        self.law = GracefulLaw(self.parameters)
        self.stage = _Stage.APPROACH
        self.retries = 0
        self.since = math.nan

    def command(self, view: View) -> Answer:
        """The command at a tick."""
        p = self.parameters
        if math.isnan(self.since):
            self.since = view.time
        if self.stage is _Stage.RESET:
            return self._reset(view)
        if self.stage is _Stage.STOP:
            return self._stopping(view)
        if p.max_retries:
            if view.unseen > p.detection_timeout:
                return self._failed(view, "detection lost", Failure.LOST)
            if view.time - self.since > p.approach_timeout:
                return self._failed(view, "approach timed out")
        if self._docked(view):
            self.stage = _Stage.STOP
            return Answer(_REST)
        target = view.pose.relative(Pose2(p.projection, 0.0, 0.0))
        return Answer(self.law.twist(target))

    def _docked(self, view: View) -> bool:
        """Whether it is time to brake."""
        if self.parameters.trigger == "braking":
            return view.stopping.x >= 0.0
        return math.hypot(view.pose.x, view.pose.y) < self.parameters.docking_threshold

    def _stopping(self, view: View) -> Answer:
        if not at_rest(view.applied):
            return Answer(_REST)
        distance = math.hypot(view.pose.x, view.pose.y)
        if distance < self.parameters.docking_threshold:
            return Answer(_REST, arrived=True)
        return self._failed(view, f"stands {1e3 * distance:.0f} mm from the dock")

    def _failed(self, view: View, why: str, kind: Failure = Failure.GAVE_UP) -> Answer:
        self.retries += 1
        if self.retries > self.parameters.max_retries:
            told = f"{why}; {self.parameters.max_retries} retries used"
            return Answer(_REST, failure=told, kind=kind)
        self.stage, self.since = _Stage.RESET, view.time
        return Answer(_REST)

    def _reset(self, view: View) -> Answer:
        """Backward to the staging pose."""
        p = self.parameters
        staging = view.pose.relative(Pose2(p.staging_x_offset, 0.0, 0.0))
        distance, turn = math.hypot(staging.x, staging.y), abs(staging.theta)
        if distance < p.staging_tolerance and turn < p.staging_tolerance_theta:
            self.stage, self.since = _Stage.APPROACH, view.time
            return Answer(_REST)
        if view.time - self.since > p.approach_timeout:
            return Answer(_REST, failure="timed out on the way back to the staging pose")
        try:
            return Answer(self.law.twist(staging, backward=True))
        except GeometryError:  # exactly over the staging pose, where no curvature is defined
            return Answer(_REST)


def _build(setup: Setup, parameters: GracefulParameters) -> LawController:
    server = DockingServer(parameters, setup.limits)
    rule = StopRule() if parameters.trigger == "braking" else StopRule(reached=0.0)
    if not parameters.max_retries:
        return LawController(setup, server, rule)
    # The server goes back by dead reckoning for as long as its own timeout.
    blind = parameters.approach_timeout
    return LawController(setup, server, rule, blind=blind, give_up=blind)


_SOURCE = (
    "navigation2 at commit a3a9704: nav2_graceful_controller's smooth control law and "
    "opennav_docking's server, with their default parameters; the law is Park and Kuipers's"
)
_DEPARTURES = (
    "The shared estimator replaces its pose filter (coefficient 0.1).",
    "It brakes in time to stand at the dock; Nav2 begins to brake 50 mm before it, for a dock "
    'that is run into (trigger="threshold").',
    "Having come to rest more than 50 mm from the dock it has failed; Nav2 would push on.",
    "It starts where the run starts, not at a staging pose it navigated to, and runs at the "
    "period of the comparison, not at 50 Hz.",
    "Collision checking, stall and battery detection are left out: there is nothing to detect.",
)
_SPACE = {
    "k_phi": Range(1.0, 10.0), "k_delta": Range(1.0, 10.0), "beta": Range(0.02, 2.0),
    "lam": Range(1.0, 3.0, False), "slowdown_radius": Range(0.05, 1.0),
    "projection": Range(0.02, 0.6), "v_linear_min": Range(0.01, 0.2),
}  # fmt: skip

GRACEFUL = Method(
    name="graceful",
    about="Nav2's docking law",
    source=_SOURCE,
    departures=(*_DEPARTURES, "No retries: what ends the run is the stop rule of all laws."),
    stock=GracefulParameters(max_retries=0),
    space=_SPACE,
    build=_build,
)

GRACEFUL_RETRY = Method(
    name="graceful-retry",
    about="Nav2's docking law in its server's loop",
    source=_SOURCE,
    departures=_DEPARTURES,
    stock=GracefulParameters(),
    space={**_SPACE, "staging_x_offset": Range(-1.5, -0.4, False)},
    build=_build,
)
