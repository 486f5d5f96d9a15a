r"""The paper's tracking controller: a virtual target followed through the CLF-CBF-QP.

The nominal command is Kanayama's law as far as the tick's input box lets it, which is also the
witness of the Lyapunov row: that asks for a fraction of the law's own decay, and never for more
than the nominal command has. So limits alone never force a slack; only a barrier can.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import Barrier
from clfcbf.constraints.clf import witnessed_clf
from clfcbf.decision import Decision, Phase, Status
from clfcbf.docking import DockingConfig, DockingInputs, DockingState, docking_tick
from clfcbf.errors import ConfigurationError
from clfcbf.laws.kanayama import Kanayama
from clfcbf.limits import Limits, check_period
from clfcbf.qp import Backend
from clfcbf.safety_filter import as_barriers
from clfcbf.scene import Observation, Reference, Scene
from clfcbf.se2 import Twist
from clfcbf.tick import (
    Begun,
    FilterConfig,
    FilterState,
    begin,
    failed,
    finish,
    motion_to_now,
    stop,
)

__all__ = [
    "DockingController",
    "TrackingConfig",
    "TrackingController",
    "TrackingInputs",
    "tracking_tick",
]


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """The filter's configuration, the law, and the decay asked for.

    ``fraction`` in (0, 1] is the share of the nominal law's own decay that the row demands.
    """

    filter: FilterConfig
    law: Kanayama
    fraction: float = defaults.CLF_FRACTION

    def __post_init__(self) -> None:
        if not 0.0 < self.fraction <= 1.0:
            raise ConfigurationError(f"fraction must be in (0, 1], got {self.fraction!r}")


class TrackingInputs(NamedTuple):
    """Inputs of one tick, see :meth:`TrackingController.step`."""

    reference: Reference
    scene: Scene
    applied: Twist


def tracking_tick(
    config: TrackingConfig,
    state: FilterState,
    inputs: TrackingInputs,
    now: float,
    since: float | None = None,
) -> tuple[Decision, FilterState]:
    """One tick of the controller as a pure function, but for the timing if ``since`` is given."""
    reference, scene, applied = inputs
    base = config.filter
    begun = begin(base, state, applied, now, since)
    if begun.fault is not None:
        return stop(begun, begun.fault, base)
    try:
        return _tracked(config, begun, reference, scene)
    except Exception as error:  # whatever a barrier or a backend raises, a command must go out
        return failed(begun, error, base)


def _tracked(
    config: TrackingConfig, begun: Begun, reference: Reference, scene: Scene
) -> tuple[Decision, FilterState]:
    base = config.filter
    motion = motion_to_now(base, begun, scene)
    if isinstance(motion, Status):
        return stop(begun, motion, base)
    pose, twist = reference
    total = pose[0] + pose[1] + pose[2] + twist[0] + twist[1]
    if total - total != 0.0:  # NaN and infinity alike
        return stop(begun, Status.INVALID_INPUT, base)
    ahead = motion.moved(begun.reckoning.body, base.lag)
    error = ahead.relative(pose)
    nominal = begun.box.clip(config.law.command(error, twist))
    row = witnessed_clf(error, twist, config.law, config.fraction, nominal)
    return finish(base, begun, nominal, scene, motion, ahead, (row,))


class TrackingController:
    """Follows a virtual target while the feature stays in view (the paper's CLF-CBF-QP).

    Parameters are those of :class:`SafetyFilter`, the law and the share of its decay asked for.
    """

    def __init__(
        self,
        limits: Limits,
        barriers: Sequence[Barrier | FieldOfView],
        period: float,
        backend: str | Backend = "exact",
        *,
        law: Kanayama | None = None,
        fraction: float = defaults.CLF_FRACTION,
        weight: tuple[float, float, float] = defaults.QP_WEIGHT,
        lag: float = 0.0,
        guard_lag: float = defaults.GUARD_LAG,
        patience: float = defaults.PATIENCE,
    ) -> None:
        made = as_barriers(barriers, limits, check_period(period), guard_lag)
        base = FilterConfig(limits, made, period, backend, weight, lag, guard_lag, patience)
        self.config = TrackingConfig(base, law or Kanayama(), fraction)
        self.state = FilterState()

    def step(self, reference: Reference, scene: Scene, applied: Twist, now: float) -> Decision:
        """The command toward the virtual target.

        Parameters
        ----------
        reference : virtual target as seen from the robot at ``scene.stamp``, and its twist
        scene : goal and feature as seen from the robot at ``scene.stamp``
        applied : the command the chassis last accepted, never odometry
        now : time [s], on the clock of the stamps
        """
        since = time.perf_counter()
        inputs = tuple.__new__(TrackingInputs, (reference, scene, applied))
        decision, self.state = tracking_tick(self.config, self.state, inputs, now, since)
        return decision


class DockingController:
    """Plans, tracks, backs off and tries again, and says when it is done.

    Its command always comes out of the program and the guard; planner and law only give the
    nominal one. The controller asks nothing of the robot but the commands it accepted.

    Parameters
    ----------
    limits : of the chassis
    camera : camera and field of view that the feature has to stay in
    standoff : distance from the goal to the feature straight ahead of it [m]
    period : of the control loop [s]
    backend : a QP backend, by name or one of your own
    lag : first-order lag of the body, as identified [s]
    barriers : more barriers, beside the camera's
    options : any field of :class:`DockingConfig`

    Examples
    --------
    >>> import math
    >>> from clfcbf import DockingController, FieldOfView, Limits, Observation, Pose2, Twist
    >>> limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
    >>> camera = FieldOfView(math.radians(35), camera=Pose2(0.2, 0.0, 0.0))
    >>> controller = DockingController(limits, camera, standoff=0.6, period=1 / 30)
    >>> controller.step(None, applied=Twist(0.0, 0.0), now=0.0).status.value
    'no target'
    """

    def __init__(
        self,
        limits: Limits,
        camera: FieldOfView,
        standoff: float,
        period: float,
        backend: str | Backend = "exact",
        *,
        weight: tuple[float, float, float] = defaults.QP_WEIGHT,
        lag: float = 0.0,
        guard_lag: float = defaults.GUARD_LAG,
        barriers: Sequence[Barrier | FieldOfView] = (),
        **options: Any,
    ) -> None:
        made = as_barriers((camera, *barriers), limits, check_period(period), guard_lag)
        base = FilterConfig(limits, made, period, backend, weight, lag=lag, guard_lag=guard_lag)
        self.config = DockingConfig(base, camera, standoff, **options)
        self.state = DockingState()

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick.

        Parameters
        ----------
        observation : a new measurement, or None where there is none
        applied : the command the chassis last accepted, never odometry
        now : time [s], on the clock of the stamps
        """
        begun = time.perf_counter()
        decision, self.state = docking_tick(
            self.config, self.state, DockingInputs(observation, applied), now
        )
        return decision.timed(time.perf_counter() - begun)

    def undock(self, distance: float) -> None:
        """From the next tick on reverse straight out by ``distance`` [m], then be done."""
        if not (math.isfinite(distance) and distance > 0.0):
            raise ConfigurationError(f"distance must be finite and positive [m], got {distance!r}")
        if self.config.filter.limits.reverse_speed == 0.0:
            raise ConfigurationError("undocking needs reverse, which v_min = 0 forbids")
        self._begin_task(distance)

    def dock(self) -> None:
        """Start anew from the next tick on, keeping what is known of target and motion."""
        self._begin_task(0.0)

    def _begin_task(self, undock: float) -> None:
        self.state = self.state._replace(
            legs=(), undock=undock, phase=Phase.WAITING, reason="", attempts=0, unseen=0.0,
            failure=None,
        )  # fmt: skip
