"""The docking controller: see, plan, follow, back off, arrive; one tick as a pure function.

A tick goes down this file once: the observation enters the estimate, the estimate is brought
to now, a plan is made where there is none (always at rest), its leg gives the virtual target
and the nominal command, and rows, program and guard turn that into the command sent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.clf import witnessed_clf
from clfcbf.decision import Decision, Phase, Status
from clfcbf.errors import ConfigurationError, PlanningError
from clfcbf.estimation import (
    NoiseModel,
    TargetEstimate,
    coast,
    grown,
    is_covariance,
    measured,
    reckoned,
)
from clfcbf.laws.kanayama import Kanayama
from clfcbf.scene import Observation, Scene
from clfcbf.se2 import Pose2, Twist, is_finite
from clfcbf.tick import Begun, FilterConfig, FilterState, begin, failed, finish, stop
from clfcbf.trajectories.build import arc_path
from clfcbf.trajectories.following import Following, FollowingGains, at_rest, follow
from clfcbf.trajectories.legs import Leg, Path
from clfcbf.trajectories.planner import Planner

_HERE = Pose2(0.0, 0.0, 0.0)
_PROGRESS = 0.01  # [m] along the leg, above what noise alone can feign

__all__ = ["DockingConfig", "DockingInputs", "DockingState", "docking_tick", "observed"]


@dataclass(frozen=True, slots=True)
class DockingConfig:
    """Everything fixed about a docking controller.

    Attributes
    ----------
    filter : limits, period, barriers, backend and guard
    camera : the camera whose view the plan keeps to
    standoff : distance from the goal to the feature straight ahead of it [m]
    gains : of the path-following law
    noise : what is believed of measurements and of dead reckoning
    fraction : share of the law's own decay that the Lyapunov row demands, in (0, 1]
    lateral_tolerance : lateral error at the end above which it backs off and tries again [m]
    patience : longest time without a measurement before it stops [s]; dead reckoning until then
    give_up : time without a measurement after which it fails [s]
    attempts : plans made before it fails
    planner : made of the above
    """

    filter: FilterConfig
    camera: FieldOfView
    standoff: float
    gains: FollowingGains = field(default_factory=FollowingGains)
    noise: NoiseModel = defaults.NOISE
    fraction: float = defaults.CLF_FRACTION
    lateral_tolerance: float = defaults.LATERAL_TOLERANCE
    patience: float = defaults.PATIENCE
    give_up: float = defaults.GIVE_UP
    attempts: int = defaults.ATTEMPTS
    planner: Planner = field(init=False)
    law: Kanayama = field(init=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.fraction <= 1.0:
            raise ConfigurationError(f"fraction must be in (0, 1], got {self.fraction!r}")
        for name in ("lateral_tolerance", "patience", "give_up"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")
        if not self.patience <= min(self.give_up, self.filter.patience):
            raise ConfigurationError(
                f"patience must be at most give_up and the filter's, {self.give_up!r} s and "
                f"{self.filter.patience!r} s, got {self.patience!r}"
            )
        if not (isinstance(self.attempts, int) and self.attempts >= 1):
            raise ConfigurationError(f"attempts must be an integer >= 1, got {self.attempts!r}")
        planner = Planner(
            self.filter.guard, self.camera, self.standoff, self.filter.lag, self.gains
        )
        object.__setattr__(self, "planner", planner)
        gains = self.gains
        object.__setattr__(self, "law", Kanayama(gains.settle_x, gains.k2, gains.k3))


class DockingState(NamedTuple):
    """What a tick leaves to the next.

    ``legs`` is the plan in the goal's frame (empty: none), ``leg`` the index of the leg in
    progress and ``s`` the arc length reached on it; ``idle`` counts the ticks since it last came
    a centimetre further, ``attempts`` the plans made. ``unseen`` is the time since the last
    accepted measurement [s], ``latest`` the newest stamp.
    """

    base: FilterState = FilterState()
    target: TargetEstimate | None = None
    offset: Pose2 = Pose2(0.0, 0.0, 0.0)
    unseen: float = 0.0
    latest: float = -math.inf
    legs: tuple[Leg, ...] = ()
    leg: int = 0
    s: float = 0.0
    mark: float = 0.0
    idle: int = 0
    attempts: int = 0
    undock: float = 0.0
    phase: Phase = Phase.WAITING
    reason: str = ""


class DockingInputs(NamedTuple):
    """Inputs of one tick: a measurement if there is a new one, and the command in force."""

    observation: Observation | None
    applied: Twist


def docking_tick(
    config: DockingConfig, state: DockingState, inputs: DockingInputs, now: float
) -> tuple[Decision, DockingState]:
    """One tick of the docking controller as a pure function."""
    observation, applied = inputs
    base = config.filter
    before = state.base.reckoning
    begun = begin(base, state.base, applied, now)
    elapsed = begun.reckoning.time - before.time if before is not None else 0.0
    if begun.fault is not None:
        if elapsed < 0.0:  # the stamps of a clock that jumped back mean nothing any more
            state = state._replace(latest=-math.inf)
        state = state._replace(unseen=state.unseen + base.period)
        return _stopped(config, state, begun, begun.fault)
    try:
        return _docked(config, state, begun, observation, elapsed)
    except Exception as error:  # whatever a barrier or a backend raises, a command must go out
        decision, after = failed(begun, error, base)
        return decision._replace(phase=state.phase), state._replace(base=after)


def _docked(
    config: DockingConfig,
    state: DockingState,
    begun: Begun,
    observation: Observation | None,
    elapsed: float,
) -> tuple[Decision, DockingState]:
    base = config.filter
    state, fault = observed(config, state, begun, observation, elapsed)
    if state.phase in (Phase.DONE, Phase.FAILED):
        return _stopped(config, state, begun, Status.STOPPED)
    if fault is not None:
        return _stopped(config, state, begun, fault)
    if state.target is None:
        return _stopped(config, state, begun, Status.NO_TARGET)
    pose = state.target.goal.relative(begun.reckoning.pose)
    coasted = coast(begun.reckoning.body, base.lag)
    ahead = pose.compose(coasted)
    if not state.legs:
        if not at_rest(begun.applied):
            return _stopped(config, state._replace(phase=Phase.STOPPING), begun, Status.STOPPED)
        if state.target.accepted < defaults.FIRST_LOOKS:
            return _stopped(config, state, begun, Status.NO_TARGET)
        state = _planned(config, state, ahead)
        if state.phase in (Phase.FAILED, Phase.DONE):
            return _stopped(config, state, begun, Status.STOPPED)
    state, following = _followed(config, state, begun, ahead)
    if following is None:
        return _stopped(config, state, begun, Status.STOPPED)
    goal = pose.inverse()
    scene = Scene(goal, goal.compose(state.offset), begun.reckoning.time)
    reference = following.reference
    nominal = following.twist
    row = witnessed_clf(reference.pose, reference.twist, config.law, config.fraction, nominal)
    decision, after = finish(base, begun, nominal, scene, _HERE, coasted, (row,))
    state = state._replace(base=after, s=following.s, idle=state.idle + 1)
    if following.s > state.mark + _PROGRESS or following.s < state.mark:
        state = state._replace(mark=following.s, idle=0)
    if state.idle * base.period > defaults.STUCK_TIME:
        state = _replan(state, "stuck")
    return decision._replace(phase=state.phase, reason=state.reason), state


def _stopped(
    config: DockingConfig, state: DockingState, begun: Begun, status: Status
) -> tuple[Decision, DockingState]:
    """A tick that brakes, or stands; done once it stands at the goal."""
    decision, after = stop(begun, status, config.filter)
    state = state._replace(base=after)
    done = state.phase is Phase.DONE and at_rest(begun.applied)
    return decision._replace(done=done, phase=state.phase, reason=state.reason), state


def observed(
    config: DockingConfig,
    state: DockingState,
    begun: Begun,
    observation: Observation | None,
    elapsed: float,
) -> tuple[DockingState, Status | None]:
    """The estimate brought to now and corrected with the measurement, if there is a sound one."""
    reckoning, target = begun.reckoning, state.target
    fault: Status | None = None
    state = state._replace(unseen=state.unseen + max(elapsed, 0.0))
    if target is not None:
        target = grown(target, reckoning.body, elapsed, config.noise, reckoning.pose)
        state = state._replace(target=target)
    if observation is not None and not observation.stamp <= state.latest:
        fault = _unsound(config, observation, reckoning.time)
        if fault is None:
            captured_from = reckoned(reckoning, observation.stamp)
            target, verdict = measured(target, observation, captured_from, config.noise)
            state = state._replace(target=target, latest=observation.stamp)
            if verdict.accepted:
                offset = observation.goal.relative(_pose(observation.feature))
                unseen = max(reckoning.time - observation.stamp, 0.0)
                state = state._replace(offset=offset, unseen=unseen)
    blind = state.undock > 0.0 or state.phase in (Phase.DONE, Phase.FAILED)
    if target is not None and state.unseen > config.patience and not blind:
        if state.unseen > config.give_up:
            reason = f"target lost for {state.unseen:.1f} s"
            state = state._replace(phase=Phase.FAILED, reason=reason)
        return state._replace(legs=()), Status.STALE
    return state, fault


def _pose(feature: Pose2) -> Pose2:
    """A feature as a pose; a bare point has no heading of its own."""
    return Pose2(feature[0], feature[1], feature[2] if len(feature) > 2 else 0.0)


def _unsound(config: DockingConfig, observation: Observation, now: float) -> Status | None:
    if not is_finite((*observation.goal, *observation.feature, observation.stamp)):
        return Status.INVALID_INPUT
    if observation.covariance is not None and not is_covariance(observation.covariance):
        return Status.INVALID_INPUT
    if observation.stamp > now + config.filter.period:
        return Status.CLOCK_ERROR
    if now - observation.stamp > config.patience:
        return Status.STALE
    seen = (observation.feature[0], observation.feature[1])
    if abs(config.camera.bearing(seen)) >= 0.5 * math.pi:
        return Status.OUT_OF_VIEW
    x, y = observation.goal.seen(seen)
    if math.hypot(x - config.standoff, y) > defaults.STANDOFF_ERROR:
        return Status.INVALID_INPUT
    return None


def _planned(config: DockingConfig, state: DockingState, pose: Pose2) -> DockingState:
    """A plan from where the robot stands; failed, with the reason, where there is none."""
    if state.undock > 0.0 and state.attempts == 0:
        leg = arc_path(pose, state.undock, 0.0, config.planner.limits, -1)
        return state._replace(
            legs=(leg,), leg=0, s=0.0, mark=0.0, idle=0, attempts=1, phase=Phase.UNDOCKING
        )
    if state.undock > 0.0:
        return state._replace(phase=Phase.FAILED, reason=f"undocking stopped: {state.reason}")
    gains = config.gains
    if (
        abs(pose.x) < gains.done_x
        and abs(pose.y) <= config.lateral_tolerance
        and abs(pose.theta) < gains.done_theta
    ):
        return state._replace(phase=Phase.DONE)
    if state.attempts >= config.attempts:
        reason = f"gave up after {state.attempts} plans; the last one: {state.reason}"
        return state._replace(phase=Phase.FAILED, reason=reason)
    try:
        plan = config.planner.plan(pose)
    except PlanningError as error:
        return state._replace(phase=Phase.FAILED, reason=str(error))
    return state._replace(
        legs=plan.legs, leg=0, s=0.0, mark=0.0, idle=0, attempts=state.attempts + 1,
        phase=_phase(plan.legs, 0),
    )  # fmt: skip


def _phase(legs: tuple[Leg, ...], index: int) -> Phase:
    leg = legs[index]
    if not isinstance(leg, Path):
        return Phase.TURNING
    return Phase.APPROACHING if leg.gear > 0 else Phase.BACKING_OFF


def _replan(state: DockingState, reason: str) -> DockingState:
    return state._replace(legs=(), leg=0, s=0.0, mark=0.0, idle=0, reason=reason)


def _followed(
    config: DockingConfig, state: DockingState, begun: Begun, ahead: Pose2
) -> tuple[DockingState, Following | None]:
    """The law on the leg in progress; None where the tick has to brake instead."""
    base = config.filter
    last = state.leg == len(state.legs) - 1 and state.undock == 0.0
    following = follow(
        state.legs[state.leg], last, ahead, state.s, begun.box, base.limits, base.period,
        config.gains,
    )  # fmt: skip
    if following.arrived and at_rest(begun.applied):
        if state.undock > 0.0:
            return state._replace(phase=Phase.DONE, legs=()), None
        if not last:
            # The estimate is better now than when the plan was made, so the rest is planned anew.
            return _replan(state, state.reason), None
        sideways = abs(following.reference.pose.y)
        if sideways <= config.lateral_tolerance:
            return state._replace(phase=Phase.DONE, legs=()), None
        return _replan(state, f"{1e3 * sideways:.0f} mm beside the goal"), None
    if _off_course(following):
        return _replan(state, "off course"), None
    return state, following


def _off_course(following: Following) -> bool:
    error = following.reference.pose
    return abs(error.y) > defaults.OFF_COURSE or abs(error.theta) > defaults.OFF_COURSE_THETA
