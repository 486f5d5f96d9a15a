"""From a measurement to the estimate: what is refused, what is left out, what is believed.

A measurement is checked first for what no sound one can be (not finite, from the future, too
old, behind the camera, not where the standoff puts it, of the target's back), then held against
the estimate, which tells outliers and mirror images.
"""

from __future__ import annotations

import math

from clfcbf import defaults
from clfcbf.decision import Event, Failure, Status
from clfcbf.docking_state import DockingConfig, DockingState, failed_run, is_blind, is_lost
from clfcbf.estimation import (
    Innovation,
    grown,
    is_covariance,
    is_from_behind,
    measured,
    reckoned,
)
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, is_finite
from clfcbf.tick import Begun

__all__ = ["observed"]

_EVENTS = {
    Innovation.OUTLIER: Event.OUTLIER,
    Innovation.FLIPPED: Event.FLIPPED,
    Innovation.MOVED: Event.MOVED,
}


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
    if elapsed > config.watchdog and not is_blind(state):
        state, elapsed = _lapsed(config, state, reckoning.time), config.watchdog
        target = state.target
    state = state._replace(unseen=state.unseen + max(elapsed, 0.0))
    if target is not None:
        target = grown(target, reckoning.body, elapsed, config.noise, reckoning.pose)
        state = state._replace(target=target)
    if observation is not None and not observation.stamp <= state.latest:
        fault = _unsound(config, observation, reckoning.time)
        if fault is None:
            state = _measured(config, state, begun, observation)
    if state.unseen > defaults.BLIND_TIME:
        state = state._replace(events=(*state.events, Event.UNSEEN))
    if is_lost(config, state):
        if state.unseen > config.give_up:
            flipped = state.flips >= config.noise.rejections
            reason = f"target lost for {state.unseen:.1f} s"
            if flipped:
                reason += f"; {state.flips} measurements of its mirror image were left out"
            state = failed_run(state, Failure.AMBIGUOUS if flipped else Failure.LOST, reason)
        return state, Status.STALE
    return state, fault


def _measured(
    config: DockingConfig, state: DockingState, begun: Begun, observation: Observation
) -> DockingState:
    """The estimate corrected with a sound measurement, unless that is an outlier or a flip."""
    eye = (config.camera.camera.x, config.camera.camera.y)
    state = state._replace(latest=observation.stamp)
    if is_from_behind(observation, eye):
        return state._replace(flips=state.flips + 1, events=(*state.events, Event.FLIPPED))
    captured_from = reckoned(begun.reckoning, observation.stamp)
    target, verdict = measured(state.target, observation, captured_from, config.noise, eye)
    state = state._replace(target=target)
    event = _EVENTS.get(verdict.innovation)
    if event is not None:
        flips = state.flips + (event is Event.FLIPPED)
        state = state._replace(flips=flips, events=(*state.events, event))
    if verdict.accepted:
        offset = observation.goal.relative(_pose(observation.feature))
        unseen = max(begun.reckoning.time - observation.stamp, 0.0)
        state = state._replace(
            offset=offset, unseen=unseen, seen=target.covariance, seen_at=state.s, flips=0
        )
    return state


def _lapsed(config: DockingConfig, state: DockingState, now: float) -> DockingState:
    """After so long a silence nobody knows what the chassis did: the target has to be seen."""
    state = state._replace(
        latest=now, unseen=max(state.unseen, config.patience),
        events=(*state.events, Event.LAPSED),
    )  # fmt: skip
    if state.target is None:
        return state
    guess = state.target._replace(accepted=0, rejected=0, candidate=None, flipped=0)
    return state._replace(target=guess)


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
