"""The paper's docking: a quintic to the goal, followed by the paper's program as printed.

It runs behind the same estimator as ours, so that what differs is the plan and the program.
The paper leaves three things open, decided here in its favour: the quintic leaves and arrives
with an acceleration along the headings (at rest and without one it would be a straight line),
the barrier is on the viewed feature (on the goal pose it is undefined at the end), and the run
is over when the trajectory has ended and the robot has stopped.
"""

from __future__ import annotations

import math
import time

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.decision import Decision, Phase, Status
from clfcbf.docking import DockingConfig, DockingState, observed
from clfcbf.errors import GeometryError
from clfcbf.guard import Brake
from clfcbf.limits import Limits
from clfcbf.paper import PaperConfig, paper_command
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist
from clfcbf.tick import FilterConfig, FilterState, begin, stop
from clfcbf.trajectories.following import at_rest
from clfcbf.trajectories.quintic import Quintic, minimum_duration

__all__ = ["PaperDocking"]

_GOAL = Pose2(0.0, 0.0, 0.0)


def quintic_to_goal(start: Pose2, limits: Limits) -> Quintic:
    """A quintic from rest to rest at the goal that stays within the limits, as short as can be.

    The boundary acceleration is what a rest-to-rest motion of that length needs at its peak.
    Stretched by steps until all four limits hold; where none up to eight times the straight
    line's duration does, the longest is returned, and the tracker meets the limits.
    """
    length = math.hypot(start.x, start.y)
    shortest = minimum_duration(max(length, 1e-3), limits)
    for stretch in defaults.PAPER_STRETCHES:
        duration = stretch * shortest
        push = min(4.0 * length / duration**2, limits.a_max)
        trajectory = Quintic.between(
            start, _GOAL, duration, start_acceleration=push, end_acceleration=-push
        )
        if not trajectory.limits_exceeded(limits):
            break
    return trajectory


class PaperDocking:
    """Docking with the paper's trajectory and program; ``step`` as in ``DockingController``.

    Parameters
    ----------
    limits, camera, standoff, period : as in :class:`clfcbf.DockingController`
    lag : of the body, for the shared estimator [s]
    config : weights, gains and switches. By default the acceleration limits are per second, as
        the chassis has them, not per step, as printed
    """

    def __init__(
        self,
        limits: Limits,
        camera: FieldOfView,
        standoff: float,
        period: float,
        *,
        lag: float = 0.0,
        config: PaperConfig | None = None,
    ) -> None:
        base = FilterConfig(limits, (), period, lag=lag, guard_lag=max(lag, defaults.GUARD_LAG))
        self.base = base
        self.config = config or PaperConfig(
            half_angle=camera.half_angle, per_step_acceleration=False
        )
        self.docking = DockingConfig(base, camera, standoff)
        self.state = DockingState()
        self.trajectory: Quintic | None = None
        self.started = 0.0

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick."""
        clock = time.perf_counter()
        decision = self._step(observation, applied, now)
        return decision.timed(time.perf_counter() - clock)

    def _step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        before = self.state.base.reckoning
        begun = begin(self.base, self.state.base, applied, now)
        elapsed = begun.reckoning.time - before.time if before is not None else 0.0
        self.state, fault = observed(self.docking, self.state, begun, observation, elapsed)
        target = self.state.target
        ended = self.state.phase in (Phase.DONE, Phase.FAILED)
        unknown = target is None or target.accepted < defaults.FIRST_LOOKS
        if begun.fault or fault or ended or unknown or target is None:
            waiting = Status.STOPPED if ended else Status.NO_TARGET
            decision, after = stop(begun, begun.fault or fault or waiting, self.base)
            self.state = self.state._replace(base=after)
            done = self.state.phase is Phase.DONE and at_rest(begun.applied)
            return decision._replace(
                phase=self.state.phase, reason=self.state.reason, done=done,
                failure=self.state.failure,
            )  # fmt: skip
        pose = target.goal.relative(begun.reckoning.pose)
        if self.trajectory is None:
            self.trajectory = quintic_to_goal(pose, self.base.limits)
            self.started = now
        t = now - self.started
        virtual, twist = self.trajectory.at(t)
        goal = pose.inverse()
        feature = goal.compose(self.state.offset)
        try:
            answer = paper_command(
                self.config, pose.relative(virtual), twist, (feature.x, feature.y),
                begun.applied, self.base.limits, self.base.period,
            )  # fmt: skip
        except GeometryError:
            decision, after = stop(begun, Status.INVALID_INPUT, self.base)
            self.state = self.state._replace(base=after)
            return decision
        over = t > self.trajectory.duration + defaults.PAPER_WAIT
        done = over and at_rest(answer.twist) and at_rest(begun.applied)
        ticks = self.base.limits.brake_ticks(answer.twist, self.base.period)
        after = FilterState(begun.reckoning, Brake(answer.twist, ticks), answer.twist)
        phase = Phase.DONE if done else Phase.APPROACHING
        self.state = self.state._replace(base=after, phase=phase)
        return Decision(
            answer.twist,
            Status.OPTIMAL if answer.feasible else Status.BARRIER_RELAXED,
            False,
            answer.twist,
            answer.h,
            slack=answer.delta,
            barrier_slack=0.0 if answer.feasible else 1.0,
            box=begun.box,
            done=done,
            phase=phase,
        )
