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
from clfcbf.estimation import NoiseModel, TargetEstimate, grown, measured, reckoned
from clfcbf.laws.kanayama import Kanayama
from clfcbf.scene import Observation, Scene
from clfcbf.se2 import Pose2, Twist, arc, is_finite
from clfcbf.tick import Begun, FilterConfig, FilterState, begin, failed, finish, stop
from clfcbf.trajectories.build import arc_path
from clfcbf.trajectories.following import Following, FollowingGains, at_rest, follow
from clfcbf.trajectories.legs import Leg, Path
from clfcbf.trajectories.planner import Planner

_HERE = Pose2(0.0, 0.0, 0.0)

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
        for name in ("lateral_tolerance", "patience", "give_up"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")
        if self.attempts < 1:
            raise ConfigurationError(f"attempts must be at least 1, got {self.attempts!r}")
        planner = Planner(
            self.filter.guard, self.camera, self.standoff, self.filter.lag, self.gains
        )
        object.__setattr__(self, "planner", planner)
        gains = self.gains
        object.__setattr__(self, "law", Kanayama(gains.settle_x, gains.k2, gains.k3))


class DockingState(NamedTuple):
    """What a tick leaves to the next.

    ``legs`` is the plan in the goal's frame (empty: none), ``leg`` the index of the leg in
    progress and ``s`` the arc length reached on it; ``stuck`` counts the ticks at rest in the
    middle of a leg, ``attempts`` the plans made.
    """

    base: FilterState = FilterState()
    target: TargetEstimate | None = None
    offset: Pose2 = Pose2(0.0, 0.0, 0.0)
    seen: float = -math.inf
    legs: tuple[Leg, ...] = ()
    leg: int = 0
    s: float = 0.0
    stuck: int = 0
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
    if begun.fault is not None:
        return _stopped(config, state, begun, begun.fault)
    elapsed = begun.reckoning.time - before.time if before is not None else 0.0
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
        return _stopped(config, state, begun, Status.OPTIMAL)
    if fault is not None:
        return _stopped(config, state, begun, fault)
    if state.target is None:
        return _stopped(config, state, begun, Status.NO_TARGET)
    pose = state.target.goal.relative(begun.reckoning.pose)
    coast = arc(begun.reckoning.body, base.lag)
    ahead = pose.compose(coast)
    if not state.legs:
        if not at_rest(begun.applied):
            return _stopped(config, state._replace(phase=Phase.STOPPING), begun, Status.OPTIMAL)
        if state.target.accepted < defaults.FIRST_LOOKS:
            return _stopped(config, state, begun, Status.NO_TARGET)
        state = _planned(config, state, ahead)
        if state.phase is Phase.FAILED:
            return _stopped(config, state, begun, Status.OPTIMAL)
    state, following = _followed(config, state, begun, ahead)
    if following is None:
        return _stopped(config, state, begun, Status.OPTIMAL)
    goal = pose.inverse()
    scene = Scene(goal, goal.compose(state.offset), begun.reckoning.time)
    reference = following.reference
    nominal = following.twist
    row = witnessed_clf(reference.pose, reference.twist, config.law, config.fraction, nominal)
    decision, after = finish(base, begun, nominal, scene, _HERE, coast, (row,))
    resting = at_rest(decision.twist) and not following.arrived
    state = state._replace(base=after, s=following.s, stuck=state.stuck + 1 if resting else 0)
    if state.stuck * base.period > defaults.STUCK_TIME:
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
    if target is not None:
        target = grown(target, reckoning.body, elapsed, config.noise, reckoning.pose)
        state = state._replace(target=target)
    if observation is not None:
        fault = _unsound(config, observation, reckoning.time)
        if fault is None:
            captured_from = reckoned(reckoning, observation.stamp)
            target, verdict = measured(target, observation, captured_from, config.noise)
            state = state._replace(target=target)
            if verdict.accepted:
                offset = observation.goal.relative(Pose2(*observation.feature))
                state = state._replace(offset=offset, seen=reckoning.time)
    unseen = reckoning.time - state.seen
    if target is not None and unseen > config.patience and state.phase is not Phase.DONE:
        if unseen > config.give_up and state.phase is not Phase.FAILED:
            state = state._replace(phase=Phase.FAILED, reason=f"target lost for {unseen:.1f} s")
        return state._replace(legs=()), Status.STALE
    return state, fault


def _unsound(config: DockingConfig, observation: Observation, now: float) -> Status | None:
    values = [*observation.goal, *observation.feature, observation.stamp]
    for row in observation.covariance or ():
        values += row
    if not is_finite(tuple(values)):
        return Status.INVALID_INPUT
    if observation.stamp > now + config.filter.period:
        return Status.CLOCK_ERROR
    if now - observation.stamp > config.patience:
        return Status.STALE
    if (
        abs(config.camera.bearing((observation.feature[0], observation.feature[1])))
        >= 0.5 * math.pi
    ):
        return Status.OUT_OF_VIEW
    return None


def _planned(config: DockingConfig, state: DockingState, pose: Pose2) -> DockingState:
    """A plan from where the robot stands; failed, with the reason, where there is none."""
    if state.undock > 0.0:
        leg = arc_path(pose, state.undock, 0.0, config.planner.limits, -1)
        return state._replace(legs=(leg,), leg=0, s=0.0, phase=Phase.UNDOCKING)
    if state.attempts >= config.attempts:
        reason = f"gave up after {state.attempts} plans; the last one: {state.reason}"
        return state._replace(phase=Phase.FAILED, reason=reason)
    try:
        plan = config.planner.plan(pose)
    except PlanningError as error:
        return state._replace(phase=Phase.FAILED, reason=str(error))
    return state._replace(
        legs=plan.legs, leg=0, s=0.0, stuck=0, attempts=state.attempts + 1,
        phase=_phase(plan.legs, 0),
    )  # fmt: skip


def _phase(legs: tuple[Leg, ...], index: int) -> Phase:
    leg = legs[index]
    if not isinstance(leg, Path):
        return Phase.TURNING
    return Phase.APPROACHING if leg.gear > 0 else Phase.BACKING_OFF


def _replan(state: DockingState, reason: str) -> DockingState:
    return state._replace(legs=(), leg=0, s=0.0, stuck=0, reason=reason)


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
            return _replan(state._replace(attempts=state.attempts - 1), state.reason), None
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
