"""What a docking run is made of: its configuration, what a tick leaves to the next, its inputs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.decision import Event, Failure, Phase
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import NoiseModel, TargetEstimate
from clfcbf.laws.kanayama import Kanayama
from clfcbf.recovery import Search
from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Pose2, Twist
from clfcbf.tick import FilterConfig, FilterState
from clfcbf.trajectories.following import FollowingGains
from clfcbf.trajectories.legs import Leg
from clfcbf.trajectories.planner import Planner

__all__ = [
    "DockingConfig",
    "DockingInputs",
    "DockingState",
    "failed_run",
    "is_blind",
    "is_lost",
    "without_plan",
]

_NOTHING = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


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
    lateral_tolerance : lateral error at the end above which it backs off and tries again [m]; from
        the third approach on half of it for each approach made
    patience : longest time without a measurement before it stops [s]; dead reckoning until then
    give_up : time without a measurement after which it fails, the search included [s]
    watchdog : longest time the chassis holds a command that is not renewed [s]; after a longer
        silence of the loop the target has to be seen before the robot moves again
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
    watchdog: float = defaults.WATCHDOG
    planner: Planner = field(init=False)
    law: Kanayama = field(init=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.fraction <= 1.0:
            raise ConfigurationError(f"fraction must be in (0, 1], got {self.fraction!r}")
        for name in ("lateral_tolerance", "patience", "give_up", "watchdog"):
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
    accepted measurement [s], ``latest`` the newest stamp, ``seen`` the estimate's covariance
    right after that measurement, ``seen_at`` the arc length then and ``flips`` the mirrored ones
    since. ``search`` is how far the search for a lost target has come, ``events`` what happened
    in this tick.
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
    seen: Covariance = _NOTHING
    seen_at: float = 0.0
    flips: int = 0
    search: Search = Search()
    events: tuple[Event, ...] = ()
    failure: Failure | None = None


class DockingInputs(NamedTuple):
    """Inputs of one tick: a measurement if there is a new one, and the command in force."""

    observation: Observation | None
    applied: Twist


def is_blind(state: DockingState) -> bool:
    """Whether the run needs no measurement: it is over, or it reverses out."""
    return state.undock > 0.0 or state.phase in (Phase.DONE, Phase.FAILED)


def is_lost(config: DockingConfig, state: DockingState) -> bool:
    """Whether the target was not seen for longer than dead reckoning bridges."""
    return state.target is not None and state.unseen > config.patience and not is_blind(state)


def failed_run(state: DockingState, failure: Failure, reason: str) -> DockingState:
    """The run is over, for that reason."""
    return state._replace(phase=Phase.FAILED, failure=failure, reason=reason, legs=())


def without_plan(state: DockingState, reason: str) -> DockingState:
    """The plan is dropped, for that reason; the next one is made at rest."""
    return state._replace(legs=(), leg=0, s=0.0, mark=0.0, idle=0, reason=reason, seen_at=0.0)
