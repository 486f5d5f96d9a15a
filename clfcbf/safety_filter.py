"""The safety filter: around any controller's command, the closest safe one at every tick."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import Barrier
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.decision import Decision, Status
from clfcbf.limits import Limits, check_period
from clfcbf.qp import Backend
from clfcbf.scene import Scene
from clfcbf.se2 import Twist, is_finite
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

__all__ = ["FilterInputs", "SafetyFilter", "as_barriers", "filter_tick"]


class FilterInputs(NamedTuple):
    """Inputs of one tick of the filter, see :meth:`SafetyFilter.filter`."""

    nominal: Twist
    scene: Scene
    applied: Twist


def filter_tick(
    config: FilterConfig,
    state: FilterState,
    inputs: FilterInputs,
    now: float,
    since: float | None = None,
) -> tuple[Decision, FilterState]:
    """One tick of the filter as a pure function, but for the timing if ``since`` is given."""
    nominal, scene, applied = inputs
    begun = begin(config, state, applied, now, since)
    if begun.fault is not None:
        return stop(begun, begun.fault, config)
    try:
        return _filtered(config, begun, nominal, scene)
    except Exception as error:  # whatever a barrier or a backend raises, a command must go out
        return failed(begun, error, config)


def _filtered(
    config: FilterConfig, begun: Begun, nominal: Twist, scene: Scene
) -> tuple[Decision, FilterState]:
    motion = motion_to_now(config, begun, scene)
    if isinstance(motion, Status):
        return stop(begun, motion, config)
    if not is_finite(nominal):
        return stop(begun, Status.INVALID_INPUT, config)
    ahead = motion.moved(begun.reckoning.body, config.lag)
    return finish(config, begun, Twist(*nominal), scene, motion, ahead)


def as_barriers(
    barriers: Sequence[Barrier | FieldOfView], limits: Limits, period: float, lag: float
) -> tuple[Barrier, ...]:
    r"""Barriers as given; a bare camera becomes one with the default gain and margin.

    The gain is :math:`1/(\bar T + \tau)`, the inverse of the guard's longest look-ahead: a
    larger one asks for more than the acceleration limits can give.
    """
    gain = 1.0 / (limits.brake_horizon(period) + lag)
    made: list[Barrier] = []
    cameras = 0
    for barrier in barriers:
        if isinstance(barrier, FieldOfView):
            cameras += 1
            name = "fov" if cameras == 1 else f"fov{cameras}"
            barrier = FieldOfViewBarrier(
                barrier, gain, defaults.VIEW_MARGIN, name, defaults.VIEW_SETBACK
            )
        made.append(barrier)
    return tuple(made)


class SafetyFilter:
    """Wraps any controller's command: the closest safe one, at every tick.

    Parameters
    ----------
    limits : of the chassis
    barriers : barriers, or cameras (:class:`FieldOfView`) to be made into one
    period : of the control loop [s]
    backend : a QP backend by name, see :func:`clfcbf.available_backends`, or one of your own
    weight : (q11, q12, q22) of the distance to the nominal command
    lag, guard_lag, patience : see :class:`FilterConfig`

    Examples
    --------
    >>> import math
    >>> from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Scene, Twist
    >>> limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
    >>> safe = SafetyFilter(limits, [FieldOfView(math.radians(35))], period=1 / 30)
    >>> scene = Scene(goal=Pose2(1.4, 0.8, 0.0), feature=Pose2(2.0, 0.8, 0.0), stamp=0.0)
    >>> decision = safe.filter(Twist(0.22, -0.4), scene, applied=Twist(0.0, 0.0), now=0.0)
    >>> decision.status.value, decision.certified
    ('optimal', True)
    """

    def __init__(
        self,
        limits: Limits,
        barriers: Sequence[Barrier | FieldOfView],
        period: float,
        backend: str | Backend = "exact",
        *,
        weight: tuple[float, float, float] = defaults.QP_WEIGHT,
        lag: float = 0.0,
        guard_lag: float = defaults.GUARD_LAG,
        patience: float = defaults.PATIENCE,
    ) -> None:
        made = as_barriers(barriers, limits, check_period(period), guard_lag)
        self.config = FilterConfig(limits, made, period, backend, weight, lag, guard_lag, patience)
        self.state = FilterState()

    def filter(self, nominal: Twist, scene: Scene, applied: Twist, now: float) -> Decision:
        """The safe command closest to ``nominal``.

        Parameters
        ----------
        nominal : what the controller wants [m/s, rad/s]
        scene : goal and feature as seen from the robot at ``scene.stamp``
        applied : the command the chassis last accepted, never odometry
        now : time [s], on the clock of the stamps
        """
        since = time.perf_counter()
        inputs = FilterInputs(nominal, scene, applied)
        decision, self.state = filter_tick(self.config, self.state, inputs, now, since)
        return decision
