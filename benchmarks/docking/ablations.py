"""Ours with one part left out, each a method of its own: what is that part worth?"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines.method import Method, Setup
from benchmarks.baselines.ours import CLF_CBF, Deadline, OurGains
from clfcbf.controller import DockingController
from clfcbf.decision import Decision
from clfcbf.docking import DockingConfig
from clfcbf.errors import GeometryError, PlanningError
from clfcbf.guard import Guard
from clfcbf.paper_docking import quintic_to_goal
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.episode import EpisodeController
from clfcbf.simulation.sensors import SensorName
from clfcbf.tick import FilterConfig
from clfcbf.trajectories.build import timed_path
from clfcbf.trajectories.legs import Leg
from clfcbf.trajectories.path import SampledPath
from clfcbf.trajectories.planner import Plan, Planner
from clfcbf.trajectories.quintic import Quintic
from clfcbf.trajectories.rollout import roll_out
from clfcbf.trajectories.timing import time_path

__all__ = ["ABLATIONS", "Ablation", "sampled"]

SAMPLES = 400
"""Of the quintic: one a centimetre on its longest."""

_ORIGIN = Pose2(0.0, 0.0, 0.0)
_REST = Twist(0.0, 0.0)


class Ablation(NamedTuple):
    """A method that lacks a part, and the kind of sensor it is given in place of ``depth``."""

    method: Method[OurGains]
    kind: str = "depth"

    def sensor(self, name: str) -> str | None:
        """The sensor to run with; None where the part left out plays no role."""
        kind, level = SensorName.of(name)
        if self.kind == "depth":
            return name
        return f"{self.kind}-{level}" if kind == "depth" else None


class Unpredicted:
    """Takes what it sees for what is there now: the stamps are thrown away."""

    def __init__(self, controller: EpisodeController) -> None:
        self.controller = controller

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The controller's decision on the observation as if it had been made now."""
        if observation is not None:
            observation = replace(observation, stamp=now)
        return self.controller.step(observation, applied, now)


class ForwardPlanner(Planner):
    """Plans without a first leg: no turn on the spot, no reverse."""

    def _backed_off(
        self, start: Pose2, reasons: dict[str, int]
    ) -> Iterator[tuple[float, tuple[Leg, ...]]]:
        yield from ()


class QuinticPlanner(Planner):
    """Plans the paper's quintic, within the limits but blind to the view."""

    def plan(self, start: Pose2, applied: Twist = _REST) -> Plan:
        """The quintic from ``start``; ``PlanningError`` where there is none."""
        try:
            path = sampled(quintic_to_goal(start, self.limits))
        except GeometryError as error:
            raise PlanningError(f"no quintic from {start!r}: {error}") from error
        legs = (timed_path(time_path(path, self.limits), _ORIGIN, _ORIGIN),)
        unseen = Guard(self.guard.limits, (), self.guard.period, self.guard.lag)
        rollout = roll_out(legs, start, self.feature, unseen, self.lag, self.gains, applied)
        return Plan(legs, rollout)


def sampled(quintic: Quintic, count: int = SAMPLES) -> SampledPath:
    """The path of a quintic; at its ends, at rest, the curvature of the sample beside them."""
    times = np.linspace(0.0, quintic.duration, count + 1).tolist()
    poses = np.array([quintic.pose(t) for t in times])
    poses[:, 2] = np.unwrap(poses[:, 2])
    v, omega = np.array([quintic.twist(t) for t in times[1:-1]]).T
    curvature = np.pad(omega / v, 1, mode="edge")
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    return SampledPath(s, curvature, poses)


def _ours(setup: Setup, lag: float | None = None) -> DockingController:
    return DockingController(
        setup.limits, setup.camera, setup.standoff, setup.period,
        lag=setup.lag if lag is None else lag,
    )  # fmt: skip


def _with(config: Any, **parts: Any) -> Any:
    """A copy of a frozen configuration with derived parts exchanged, which ``replace`` makes anew.

    Everything derived is kept but for ``parts``: exactly what is named differs.
    """
    copy = replace(config)
    derived = {f: getattr(config, f) for f in config.__slots__}
    for name, value in {**derived, **parts}.items():
        object.__setattr__(copy, name, value)
    return copy


def _altered(
    setup: Setup, change: Callable[[DockingConfig], DockingConfig]
) -> EpisodeController:  # fmt: skip
    controller = _ours(setup)
    controller.config = change(controller.config)
    return controller


def _no_prediction(setup: Setup) -> EpisodeController:
    return Unpredicted(_ours(setup, lag=0.0))


def _no_barrier(setup: Setup) -> EpisodeController:
    return _altered(setup, lambda config: _filtered(config, barriers=()))


def _no_guard(setup: Setup) -> EpisodeController:
    def change(config: DockingConfig) -> DockingConfig:
        base = config.filter
        return _filtered(config, guard=Guard(base.limits, (), base.period, base.guard_lag))

    return _altered(setup, change)


def _filtered(config: DockingConfig, **parts: Any) -> DockingConfig:
    base: FilterConfig = _with(config.filter, **parts)
    changed: DockingConfig = _with(config, filter=base)
    return changed


def _planning(kind: type[Planner]) -> Callable[[Setup], EpisodeController]:
    def change(config: DockingConfig) -> DockingConfig:
        old = config.planner
        planner = kind(old.guard, old.camera, old.standoff, old.lag, old.gains)
        changed: DockingConfig = _with(config, planner=planner)
        return changed

    return lambda setup: _altered(setup, change)


def _method(
    name: str, about: str, departure: str, make: Callable[[Setup], EpisodeController]
) -> Method[OurGains]:
    def build(setup: Setup, gains: OurGains) -> Deadline:
        return Deadline(make(setup), setup.limits, setup.period)

    return Method(name, about, CLF_CBF.source, (departure,), OurGains(), {}, build)


ABLATIONS: dict[str, Ablation] = {
    ablation.method.name: ablation
    for ablation in (
        Ablation(
            _method(
                "no-compensation", "ours without view compensation",
                "The middle of the board's visible part is taken for its centre.", _ours,
            ),
            kind="middle",
        ),
        Ablation(
            _method(
                "no-prediction", "ours without prediction",
                "Measurements count as made when they come, and the body as without lag.",
                _no_prediction,
            )
        ),
        Ablation(
            _method(
                "no-barrier", "ours without the barrier's rows",
                "The program has no rows for the view; the guard still watches it.", _no_barrier,
            )
        ),
        Ablation(
            _method(
                "no-guard", "ours without the guard",
                "The program's answer goes out as it is.", _no_guard,
            )
        ),
        Ablation(
            _method(
                "no-planner", "ours along the paper's quintic",
                "The plan is the paper's quintic, driven as fast as the limits allow.",
                _planning(QuinticPlanner),
            )
        ),
        Ablation(
            _method(
                "no-back-off", "ours without a first leg",
                "Plans neither turn on the spot nor reverse before the approach.",
                _planning(ForwardPlanner),
            )
        ),
    )
}  # fmt: skip
"""By name; none has parameters of its own to tune."""
