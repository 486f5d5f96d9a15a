"""The judge of a run, who knows the truth: what is watched on the way, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clfcbf.decision import Decision, Failure, Phase, Status
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.simulation.scenarios import World, visible_share

__all__ = ["EpisodeResult", "Trace", "Watch", "is_docked"]

TOLERANCE, TOLERANCE_THETA = 0.030, math.radians(5.0)
"""[m, rad] Success as the paper has it, [Xie2024]_."""

STRICT, STRICT_THETA = 0.010, math.radians(2.0)
"""[m, rad] What a stricter customer asks for."""

PAST_GOAL = 0.05
"""[m] So far past the goal a robot has run into what it was to dock to."""

REST_V, REST_OMEGA = 1e-3, 1e-3
"""[m/s, rad/s] Below both the body stands."""

_LOST = (Failure.LOST, Failure.AMBIGUOUS)
_RELAXED = (Status.BARRIER_RELAXED, Status.SOLVER_FAILED)


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
    fov_lost_s : for how long the feature was outside
    min_visible : smallest share of the board's width in view
    blind_s : longest time between two measurements, or from the last one to the end
    chatter_v, chatter_omega : root mean square of the commands' increments [m/s, rad/s a tick]
    ticks : commands sent, those of the wait after "done" included
    limit_violations : commands outside the input box of their tick, by more than 1e-9
    infeasible_ticks : ticks whose barrier rows could not all hold
    unguarded_ticks : of those and all others, ticks without a certified brake
    guarded_ticks : ticks in which the guard replaced the command
    solver_failures : ticks in which a solver gave no answer that could be used
    step_us_p50, step_us_p99, step_us_max : duration of the controller's tick [µs]
    reason : the controller's own last word on why it stopped or failed

    Notes
    -----
    All of the view counts from the first moment in which it holds the feature.
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
    fov_lost_s: float
    min_visible: float
    blind_s: float
    chatter_v: float
    chatter_omega: float
    ticks: int
    limit_violations: int
    infeasible_ticks: int
    unguarded_ticks: int
    guarded_ticks: int
    solver_failures: int
    step_us_p50: float
    step_us_p99: float
    step_us_max: float
    reason: str


class Watch:
    """Follows one run and judges it at its end.

    Parameters
    ----------
    start : true pose of the robot in the goal's frame
    world, limits : what the run is judged against
    """

    def __init__(self, start: Pose2, world: World, limits: Limits) -> None:
        self._world, self._limits = world, limits
        self._feature = (world.feature.x, world.feature.y)
        self.trace = Trace([], [], [], [])
        self._acquired = False
        self._margin, self._outside, self._visible = math.inf, 0.0, 1.0
        self._measured: float | None = None
        self._blind = 0.0
        self._violations, self._path, self._moved_until = 0, 0.0, 0.0
        self._farthest, self._touched = -math.inf, False
        self._look(start, 0.0)

    def decided(
        self, now: float, pose: Pose2, twist: Twist, applied: Twist, seen: bool, decision: Decision
    ) -> None:
        """A tick: where the robot truly was, whether a measurement came, and what was decided."""
        trace = self.trace
        trace.times.append(now)
        trace.poses.append(pose)
        trace.decisions.append(decision)
        trace.twists.append(twist)
        box = self._limits.input_box(applied, self._world.period)
        self._violations += not box.contains(decision.twist, 1e-9)
        if self._acquired:
            self._visible = min(self._visible, visible_share(pose, self._world))
        if self._measured is not None:
            self._blind = max(self._blind, now - self._measured)
        if seen:
            self._measured = now

    def moved(self, before: Pose2, poses: tuple[Pose2, ...], duration: float) -> None:
        """The poses of the sub-steps after ``before``, over ``duration`` [s] in all."""
        for pose in poses:
            self._look(pose, duration / len(poses))
            self._path += math.hypot(pose.x - before.x, pose.y - before.y)
            self._farthest = max(self._farthest, pose.x)
            before = pose

    def ended(self, time: float, body: Twist, touched: bool) -> None:
        """The end of a tick: the body's twist, and whether it touches anything."""
        if abs(body.v) >= REST_V or abs(body.omega) >= REST_OMEGA:
            self._moved_until = time
        self._touched = self._touched or touched

    def _look(self, pose: Pose2, duration: float) -> None:
        margin = self._world.camera.margin(pose.seen(self._feature))
        self._acquired = self._acquired or margin >= 0.0
        if self._acquired:
            self._margin = min(self._margin, margin)
            self._outside += duration if margin < 0.0 else 0.0

    def _outcome(self, end: Pose2) -> str:
        last = self.trace.decisions[-1]
        if self._violations:
            return "limit violated"
        if self._touched or self._farthest > PAST_GOAL:
            return "contact"
        if last.phase is Phase.FAILED:
            return "lost" if last.failure in _LOST else "failed"
        if not last.done:
            return "timeout"
        return "ok" if is_docked(end) else "miss"

    def verdict(self, end: Pose2) -> EpisodeResult:
        """The result, with the true pose at its end."""
        world, decisions = self._world, self.trace.decisions
        outcome = self._outcome(end)
        margin = self._margin
        if not self._acquired:
            margin = world.camera.margin(end.seen(self._feature))
        steps = np.array([decision.timing for decision in decisions]) * 1e6
        increments = np.diff([decision.twist for decision in decisions], axis=0)
        chatter = np.sqrt(np.mean(increments**2, axis=0)) if len(increments) else np.zeros(2)
        return EpisodeResult(
            outcome=outcome,
            success=outcome == "ok",
            strict=outcome == "ok" and is_docked(end, strict=True),
            e_lon_mm=1e3 * end.x,
            e_lat_mm=1e3 * end.y,
            e_theta_deg=math.degrees(wrap_angle(end.theta)),
            time_s=self._moved_until,
            path_m=self._path,
            min_fov_margin_deg=math.degrees(margin),
            fov_lost=margin < 0.0,
            fov_lost_s=self._outside,
            min_visible=self._visible if self._acquired else visible_share(end, world),
            blind_s=self._blind,
            chatter_v=float(chatter[0]),
            chatter_omega=float(chatter[1]),
            ticks=len(decisions),
            limit_violations=self._violations,
            infeasible_ticks=sum(d.status in _RELAXED or d.barrier_slack > 1e-9 for d in decisions),
            unguarded_ticks=sum(not d.certified for d in decisions),
            guarded_ticks=sum(d.status in (Status.GUARDED, Status.BRAKING) for d in decisions),
            solver_failures=sum(d.status is Status.SOLVER_FAILED for d in decisions),
            step_us_p50=float(np.percentile(steps, 50)),
            step_us_p99=float(np.percentile(steps, 99)),
            step_us_max=float(steps.max()),
            reason=decisions[-1].reason,
        )


def is_docked(end: Pose2, strict: bool = False) -> bool:
    """Whether a pose in the goal's frame is within the tolerances, or within the strict ones."""
    distance, angle = (STRICT, STRICT_THETA) if strict else (TOLERANCE, TOLERANCE_THETA)
    return math.hypot(end.x, end.y) < distance and abs(wrap_angle(end.theta)) < angle
