"""One simulated run and its judge, who knows the truth and tells no controller."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clfcbf.decision import Decision, Phase, Status
from clfcbf.limits import Limits
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensor import PoseSensor

__all__ = ["EpisodeController", "EpisodeResult", "Trace", "run_episode"]

_REST = Twist(0.0, 0.0)


class EpisodeController(Protocol):
    """What the runner asks of a controller."""

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Everything a plot or a post-mortem needs, one entry a tick.

    Attributes
    ----------
    times : time of each tick [s]
    poses : true pose at the tick, in the goal's frame
    decisions : what the controller decided
    twists : true body twist at the tick
    """

    times: list[float]
    poses: list[Pose2]
    decisions: list[Decision]
    twists: list[Twist]


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """Ground truth of one run, after standstill.

    Attributes
    ----------
    outcome : "ok", "miss", "lost", "timeout", "failed" (the controller gave up), "contact" or
        "limit violated"
    success, strict : within 30 mm and 5°, within 10 mm and 2°, and nothing else went wrong
    e_lon_mm, e_lat_mm, e_theta_deg : signed pose error in the goal's frame
    time_s : from the first tick to standstill
    path_m : distance driven, in whichever direction
    min_fov_margin_deg : smallest angle from the feature to the edge, between ticks too
    fov_lost : whether that was negative
    ticks : commands sent, those of the wait after "done" included
    limit_violations : commands outside the input box of their tick, by more than 1e-9
    infeasible_ticks : ticks whose barrier rows could not all hold
    unguarded_ticks : of those and all others, ticks without a certified brake
    guarded_ticks : ticks in which the guard replaced the command
    step_us_p50, step_us_p99 : duration of the controller's tick [µs]
    reason : the controller's own last word on why it stopped or failed
    """

    outcome: str
    success: bool
    strict: bool
    e_lon_mm: float
    e_lat_mm: float
    e_theta_deg: float
    time_s: float
    path_m: float
    min_fov_margin_deg: float
    fov_lost: bool
    ticks: int
    limit_violations: int
    infeasible_ticks: int
    unguarded_ticks: int
    guarded_ticks: int
    step_us_p50: float
    step_us_p99: float
    reason: str


def run_episode(
    plant: Plant,
    sensor: PoseSensor,
    controller: EpisodeController,
    world: World,
    limits: Limits,
    disturbance: Callable[[Plant], None] | None = None,
) -> tuple[EpisodeResult, Trace]:
    """Run until the controller is done or fails, or the patience ends; then wait and judge.

    Parameters
    ----------
    plant, sensor : the simulated robot
    controller : anything with ``step``
    world, limits : what the run is judged against
    disturbance : called once a tick before sensing, such as a nudge of the target
    """
    trace = Trace([], [], [], [])
    view = world.camera.margin
    feature = (world.feature.x, world.feature.y)
    margin = view(plant.pose().seen(feature))
    acquired = margin >= 0.0
    margin = margin if acquired else math.inf
    violations, path, moved_until = 0, 0.0, 0.0
    wait = round(world.wait / world.period)
    finished = False
    contact = getattr(plant, "contact", None)
    touched = False
    for _ in range(round(world.patience / world.period) + wait):
        if disturbance is not None:
            disturbance(plant)
        sensor.capture()
        now, pose, applied = plant.time, plant.pose(), plant.applied()
        decision = controller.step(sensor.observe(), applied, now)
        twist = decision.twist
        violations += not limits.input_box(applied, world.period).contains(twist, 1e-9)
        trace.times.append(now)
        trace.poses.append(pose)
        trace.decisions.append(decision)
        trace.twists.append(plant.twist())
        plant.send(twist)
        for after in plant.advance(world.period):
            here = view(after.seen(feature))
            acquired = acquired or here >= 0.0
            if acquired:
                margin = min(margin, here)
            path += math.hypot(after.x - pose.x, after.y - pose.y)
            pose = after
        body = plant.twist()
        if abs(body.v) >= 1e-3 or abs(body.omega) >= 1e-3:
            moved_until = plant.time
        touched = touched or (contact is not None and bool(contact()))
        finished = finished or decision.done or decision.phase is Phase.FAILED
        if finished:
            wait -= 1
            if wait <= 0:
                break
    if not acquired:
        margin = view(plant.pose().seen(feature))
    return _judged(plant.pose(), trace, margin, violations, path, moved_until, touched), trace


def _judged(
    end: Pose2, trace: Trace, margin: float, violations: int, path: float, time: float,
    touched: bool,
) -> EpisodeResult:  # fmt: skip
    decisions = trace.decisions
    last = decisions[-1]
    theta = wrap_angle(end.theta)
    distance = math.hypot(end.x, end.y)
    if violations:
        outcome = "limit violated"
    elif touched or end.x > 0.05:
        outcome = "contact"
    elif last.phase is Phase.FAILED:
        outcome = "lost" if "lost" in last.reason else "failed"
    elif not last.done:
        outcome = "timeout"
    else:
        outcome = "ok" if distance < 0.030 and abs(theta) < math.radians(5.0) else "miss"
    strict = outcome == "ok" and distance < 0.010 and abs(theta) < math.radians(2.0)
    steps = np.array([decision.timing for decision in decisions]) * 1e6
    return EpisodeResult(
        outcome=outcome,
        success=outcome == "ok",
        strict=strict,
        e_lon_mm=1e3 * end.x,
        e_lat_mm=1e3 * end.y,
        e_theta_deg=math.degrees(theta),
        time_s=time,
        path_m=path,
        min_fov_margin_deg=math.degrees(margin),
        fov_lost=margin < 0.0,
        ticks=len(decisions),
        limit_violations=violations,
        infeasible_ticks=sum(
            d.status in (Status.BARRIER_RELAXED, Status.SOLVER_FAILED) or d.barrier_slack > 1e-9
            for d in decisions
        ),
        unguarded_ticks=sum(not d.certified for d in decisions),
        guarded_ticks=sum(d.status in (Status.GUARDED, Status.BRAKING) for d in decisions),
        step_us_p50=float(np.percentile(steps, 50)),
        step_us_p99=float(np.percentile(steps, 99)),
        reason=last.reason,
    )
