"""Drives any law as a docking controller: the shared estimator in front, the limits behind.

What every rival gets is what ours has of it: the target's estimate by dead reckoning and filter,
predicted over the latency and the body's lag, the chassis's input box, and a stop rule. What a
rival does not get is the program, the barriers, the guard and the planner.
"""

from __future__ import annotations

import math
import time

from benchmarks.baselines.law import Answer, Law, StopRule, View, near
from benchmarks.baselines.method import Setup
from clfcbf import defaults
from clfcbf.decision import Decision, Failure, Phase, Status
from clfcbf.docking import DockingConfig, DockingState, observed
from clfcbf.docking_state import failed_run
from clfcbf.estimation import coast
from clfcbf.guard import Brake
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.tick import Begun, FilterConfig, FilterState, begin, failed, stop
from clfcbf.trajectories.following import at_rest

__all__ = ["LawController"]


class LawController:
    """A law behind the estimator and before the limits; ``step`` as in ``DockingController``.

    Parameters
    ----------
    setup : of the robot
    law : what is compared; it is asked once a tick, from the second accepted measurement on
    rule : when to stop
    blind : time without a measurement over which it dead-reckons before it stops [s]
    give_up : time without a measurement after which it fails [s]

    Notes
    -----
    A command outside the input box is clipped coordinate by coordinate, as velocity smoothers
    and motor controllers do. Done and failed runs brake along the circle they are on.
    """

    def __init__(
        self,
        setup: Setup,
        law: Law,
        rule: StopRule | None = None,
        *,
        blind: float = defaults.PATIENCE,
        give_up: float = defaults.GIVE_UP,
    ) -> None:
        base = FilterConfig(
            setup.limits, (), setup.period, lag=setup.lag,
            guard_lag=max(setup.lag, defaults.GUARD_LAG), patience=blind,
        )  # fmt: skip
        self.docking = DockingConfig(
            base, setup.camera, setup.standoff, patience=blind, give_up=give_up
        )
        self.law = law
        self.rule = rule or StopRule()
        self.state = DockingState()
        self.running = 0.0
        self.resting = 0.0

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick."""
        clock = time.perf_counter()
        decision = self._step(observation, applied, now)
        return decision.timed(time.perf_counter() - clock)

    def _step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        before = self.state.base.reckoning
        begun = begin(self.docking.filter, self.state.base, applied, now)
        elapsed = begun.reckoning.time - before.time if before is not None else 0.0
        self.running += max(elapsed, 0.0)
        if begun.fault is not None:
            if elapsed < 0.0:  # the stamps of a clock that jumped back mean nothing any more
                self.state = self.state._replace(latest=-math.inf)
            return self._stop(begun, begun.fault)
        self.state, fault = observed(self.docking, self.state, begun, observation, elapsed)
        if self.state.phase in (Phase.DONE, Phase.FAILED):
            return self._stop(begun, Status.STOPPED)
        if self.running > self.rule.deadline:
            reason = f"gave up after {self.rule.deadline:g} s"
            self.state = failed_run(self.state, Failure.GAVE_UP, reason)
            return self._stop(begun, Status.STOPPED)
        target = self.state.target
        if fault is not None or target is None or target.accepted < defaults.FIRST_LOOKS:
            return self._stop(begun, fault or Status.NO_TARGET)
        try:
            view = self._view(begun, target.goal)
            answer = self.law.command(view)
        except Exception as error:  # a law that raises has no command, and one must go out
            decision, after = failed(begun, error, self.docking.filter)
            self.state = self.state._replace(base=after)
            return decision._replace(phase=self.state.phase)
        phase, reason = self._verdict(view, answer)
        failure = answer.kind if phase is Phase.FAILED else None
        self.state = self.state._replace(phase=phase, reason=reason, failure=failure)
        if phase is not Phase.APPROACHING:
            return self._stop(begun, Status.STOPPED)
        return self._send(begun, view, answer)

    def _view(self, begun: Begun, target: Pose2) -> View:
        base = self.docking.filter
        ahead = target.relative(begun.reckoning.pose).compose(coast(begun.reckoning.body, base.lag))
        goal = ahead.inverse()
        feature = goal.compose(self.state.offset)
        duration = 0.5 * base.period * (base.limits.brake_ticks(begun.applied, base.period) - 1)
        stopping = ahead.moved(begun.applied, max(duration, 0.0))
        return View(
            ahead, goal, (feature.x, feature.y), stopping, begun.applied, begun.box,
            self.state.unseen, begun.reckoning.time,
        )  # fmt: skip

    def _verdict(self, view: View, answer: Answer) -> tuple[Phase, str]:
        """Whether the run goes on, is done or has failed, and why."""
        rule = self.rule
        if answer.failure:
            return Phase.FAILED, answer.failure
        if answer.arrived or near(view.stopping, rule.reached, rule.reached_theta):
            return Phase.DONE, ""
        resting = at_rest(view.applied) and at_rest(view.box.clip(answer.twist))
        self.resting = self.resting + self.docking.filter.period if resting else 0.0
        if self.resting > rule.settle:
            if near(view.pose, rule.accepted, rule.accepted_theta):
                return Phase.DONE, ""
            return Phase.FAILED, f"came to rest {_off(view.pose)} off the goal"
        return Phase.APPROACHING, ""

    def _send(self, begun: Begun, view: View, answer: Answer) -> Decision:
        base = self.docking.filter
        twist = begun.box.clip(answer.twist)
        ticks = base.limits.brake_ticks(twist, base.period)
        after = FilterState(begun.reckoning, Brake(twist, ticks), twist)
        self.state = self.state._replace(base=after)
        status = Status.OPTIMAL if answer.solved else Status.SOLVER_FAILED
        return Decision(
            twist, status, False, answer.twist, self.docking.camera.margin(view.feature),
            box=begun.box, phase=Phase.APPROACHING, limits=base.limits,
        )  # fmt: skip

    def _stop(self, begun: Begun, status: Status) -> Decision:
        decision, after = stop(begun, status, self.docking.filter)
        self.state = self.state._replace(base=after)
        done = self.state.phase is Phase.DONE and at_rest(begun.applied)
        return decision._replace(
            done=done, phase=self.state.phase, reason=self.state.reason, failure=self.state.failure
        )


def _off(pose: Pose2) -> str:
    theta = math.degrees(wrap_angle(pose.theta))
    return f"{1e3 * pose.x:.0f} mm, {1e3 * pose.y:.0f} mm, {theta:.1f} degrees"
