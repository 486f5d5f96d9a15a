"""The docking controller: see, plan, follow, back off, arrive; one tick as a pure function.

A tick goes down this file once: the observation enters the estimate, the estimate is brought
to now, a plan is made where there is none (always at rest), its leg gives the virtual target
and the nominal command, and rows, program and guard turn that into the command sent. Where the
target is lost the legs are those of a search, see :mod:`clfcbf.recovery`, and otherwise nothing
is different.
"""

from __future__ import annotations

import math

from clfcbf import defaults, recovery
from clfcbf.constraints.clf import witnessed_clf
from clfcbf.decision import Decision, Event, Failure, Phase, Status
from clfcbf.docking_state import (
    DockingConfig,
    DockingInputs,
    DockingState,
    failed_run,
    is_blind,
    is_lost,
    without_plan,
)
from clfcbf.errors import PlanningError
from clfcbf.estimation import coast
from clfcbf.recovery import Search
from clfcbf.scene import Observation, Scene
from clfcbf.se2 import Pose2
from clfcbf.sighting import observed
from clfcbf.tick import Begun, begin, failed, finish, stop
from clfcbf.trajectories.build import arc_path
from clfcbf.trajectories.following import Following, Inertia, at_rest, follow, is_over
from clfcbf.trajectories.legs import Leg, Path, Trajectory, Turn

_HERE = Pose2(0.0, 0.0, 0.0)
_PROGRESS = 0.01  # [m] along the leg, above what noise alone can feign

__all__ = ["DockingConfig", "DockingInputs", "DockingState", "docking_tick", "observed"]


def docking_tick(
    config: DockingConfig, state: DockingState, inputs: DockingInputs, now: float
) -> tuple[Decision, DockingState]:
    """One tick of the docking controller as a pure function."""
    observation, applied = inputs
    base = config.filter
    before = state.base.reckoning
    begun = begin(base, state.base, applied, now)
    elapsed = begun.reckoning.time - before.time if before is not None else 0.0
    state = state._replace(events=(Event.LATE,) if begun.late else ())
    if begun.fault is not None:
        if elapsed < 0.0:  # the stamps of a clock that jumped back mean nothing any more
            state = state._replace(latest=-math.inf)
        state = state._replace(unseen=state.unseen + base.period)
        if state.unseen > config.give_up and state.target is not None and not is_blind(state):
            reason = f"{begun.fault.value} for longer than {config.give_up:g} s"
            state = failed_run(state, Failure.FAULT, reason)
        return _stopped(config, state, begun, begun.fault)
    try:
        return _docked(config, state, begun, observation, elapsed)
    except Exception as error:  # whatever a barrier or a backend raises, a command must go out
        decision, after = failed(begun, error, base)
        told = decision._replace(phase=state.phase, events=state.events, failure=state.failure)
        return told, state._replace(base=after)


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
    target = state.target
    if target is None:
        return _stopped(config, state, begun, fault or Status.NO_TARGET)
    pose = target.goal.relative(begun.reckoning.pose)
    coasted = coast(begun.reckoning.body, base.lag)
    ahead = pose.compose(coasted)
    if is_lost(config, state):
        state = _searched(config, state, begun, pose)
        if not state.legs:
            return _stopped(config, state, begun, Status.STALE)
    elif state.phase is Phase.SEARCHING:  # found again
        state = without_plan(state, state.reason)._replace(phase=Phase.STOPPING, search=Search())
    searching = state.phase is Phase.SEARCHING
    if fault is not None and not searching:
        return _stopped(config, state, begun, fault)
    if state.phase is Phase.APPROACHING:
        lateral = config.lateral_tolerance
        if recovery.is_uncertain(target, state.seen, pose, lateral):
            state = state._replace(events=(*state.events, Event.UNCERTAIN))
            return _stopped(config, state, begun, Status.STALE)
        if Event.MOVED in state.events and _out_of_reach(config, state, ahead):
            state = without_plan(state, "the target has moved")
    if not state.legs:
        if not at_rest(begun.applied):
            return _stopped(config, state._replace(phase=Phase.STOPPING), begun, Status.STOPPED)
        looks = defaults.FIRST_LOOKS if not target.flipped else config.noise.settled
        if target.accepted < looks:
            return _stopped(config, state, begun, Status.NO_TARGET)
        state = _planned(config, state, ahead)
        if state.phase in (Phase.FAILED, Phase.DONE):
            return _stopped(config, state, begun, Status.STOPPED)
    state, following = _followed(config, state, begun, ahead)
    if following is None:
        return _stopped(config, state, begun, Status.STALE if searching else Status.STOPPED)
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
        state = without_plan(state, "stuck")
    return decision._replace(phase=state.phase, reason=state.reason, events=state.events), state


def _stopped(
    config: DockingConfig, state: DockingState, begun: Begun, status: Status
) -> tuple[Decision, DockingState]:
    """A tick that brakes, or stands; done once it stands at the goal."""
    decision, after = stop(begun, status, config.filter)
    state = state._replace(base=after)
    done = state.phase is Phase.DONE and at_rest(begun.applied)
    told = decision._replace(
        done=done, phase=state.phase, reason=state.reason, events=state.events,
        failure=state.failure,
    )  # fmt: skip
    return told, state


def _searched(
    config: DockingConfig, state: DockingState, begun: Begun, pose: Pose2
) -> DockingState:
    """The search for a lost target: first a stop, then one leg after the other, each at rest."""
    assert state.target is not None
    if state.phase is not Phase.SEARCHING:
        way = state.legs[state.leg] if state.legs else None
        search = Search(way if isinstance(way, Path) else None, state.s, state.seen_at)
        return without_plan(state, state.reason)._replace(phase=Phase.SEARCHING, search=search)
    known = state.target.accepted > 0
    if state.legs or not known or not at_rest(begun.applied):
        return state
    search, leg = recovery.next_leg(
        state.search, pose, state.offset, config.camera, config.planner.limits,
        config.filter.period,
    )  # fmt: skip
    legs = () if leg is None else (leg,)
    return state._replace(search=search, legs=legs, leg=0, s=0.0, mark=0.0, idle=0)


def _out_of_reach(config: DockingConfig, state: DockingState, ahead: Pose2) -> bool:
    """Whether the leg in progress no longer leads to the goal, now that the target has moved."""
    leg = state.legs[state.leg] if state.legs else None
    if not isinstance(leg, Path):
        return True
    place = leg.nearest(ahead, state.s)
    error = ahead.relative(place.pose)
    if max(abs(error.x), abs(error.y)) > defaults.OFF_COURSE:
        return True
    if abs(error.theta) > defaults.OFF_COURSE_THETA:
        return True
    left = recovery.end_error(error.y, error.theta, max(place.rest, 0.0), config.gains.k2)
    return left > _conceded(config, state)


def _conceded(config: DockingConfig, state: DockingState) -> float:
    """Lateral error that is worth another approach [m]: more, the more there have been."""
    return config.lateral_tolerance * max(1.0, defaults.CONCESSION * state.attempts)


def _planned(config: DockingConfig, state: DockingState, pose: Pose2) -> DockingState:
    """A plan from where the robot stands; failed, with the reason, where there is none."""
    if state.undock > 0.0 and state.attempts == 0:
        leg = arc_path(pose, state.undock, 0.0, config.planner.limits, -1)
        return state._replace(
            legs=(leg,), leg=0, s=0.0, mark=0.0, idle=0, attempts=1, phase=Phase.UNDOCKING
        )
    if state.undock > 0.0:
        return failed_run(state, Failure.UNDOCKING, f"undocking stopped: {state.reason}")
    gains = config.gains
    if (
        abs(pose.x) < gains.done_x
        and abs(pose.y) <= _conceded(config, state)
        and abs(pose.theta) < gains.done_theta
    ):
        return state._replace(phase=Phase.DONE)
    if state.attempts >= config.attempts:
        reason = f"gave up after {state.attempts} plans; the last one: {state.reason}"
        return failed_run(state, Failure.GAVE_UP, reason)
    try:
        plan = config.planner.plan(pose)
    except PlanningError as error:
        return failed_run(state, Failure.NO_APPROACH, str(error))
    return state._replace(
        legs=plan.legs, leg=0, s=0.0, mark=0.0, idle=0, attempts=state.attempts + 1,
        phase=_phase(plan.legs, 0),
    )  # fmt: skip


def _phase(legs: tuple[Leg, ...], index: int) -> Phase:
    leg = legs[index]
    if isinstance(leg, Turn):
        return Phase.TURNING
    ahead = isinstance(leg, Path) and leg.gear > 0
    return Phase.APPROACHING if ahead else Phase.BACKING_OFF


def _followed(
    config: DockingConfig, state: DockingState, begun: Begun, ahead: Pose2
) -> tuple[DockingState, Following | None]:
    """The law on the leg in progress; None where the tick has to brake instead."""
    base = config.filter
    searching = state.phase is Phase.SEARCHING
    last = state.leg == len(state.legs) - 1 and state.undock == 0.0 and not searching
    leg = state.legs[state.leg]
    following = follow(
        leg, last, ahead, state.s, begun.box, base.limits, base.period,
        config.gains, Inertia(begun.applied, begun.reckoning.body, base.lag),
    )  # fmt: skip
    if is_over(leg, following, begun.applied):
        if isinstance(leg, Trajectory) and not last:  # it goes on at speed
            index = state.leg + 1
            state = state._replace(
                leg=index, s=0.0, mark=0.0, idle=0, phase=_phase(state.legs, index)
            )
            return _followed(config, state, begun, ahead)
        if state.undock > 0.0:
            return state._replace(phase=Phase.DONE, legs=()), None
        if not last:
            # The estimate is better now than when the plan was made, so the rest is planned anew.
            return without_plan(state, state.reason), None
        sideways = abs(following.reference.pose.y)
        if sideways <= _conceded(config, state):
            return state._replace(phase=Phase.DONE, legs=()), None
        return without_plan(state, f"{1e3 * sideways:.0f} mm beside the goal"), None
    if not isinstance(leg, Turn) and _off_course(following):
        return without_plan(state, "off course"), None
    return state, following


def _off_course(following: Following) -> bool:
    error = following.reference.pose
    return abs(error.y) > defaults.OFF_COURSE or abs(error.theta) > defaults.OFF_COURSE_THETA
