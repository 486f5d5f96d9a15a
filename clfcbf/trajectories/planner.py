"""The planner: the fastest of the approaches it tried that keeps the view and the limits.

Forward approaches (an arc, a line, a terminal curve) are ranked by an estimate of their time;
the best are driven in simulation and the fastest that arrives is taken. Where none does, the
closed-form path of :mod:`~clfcbf.trajectories.visible` is tried, and then approaches after a
first leg that turns on the spot or goes back. The geometry of the view demands one close to the
goal: going forward with bearings up to the edge, the direction of the approach can change by no
more than the integral of ``tan(edge) d ln(range)``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.errors import ConfigurationError, GeometryError, LimitsError, PlanningError
from clfcbf.guard import Guard
from clfcbf.limits import Limits, check_period
from clfcbf.se2 import Pose2, Twist, is_finite
from clfcbf.trajectories.build import approach_path, timed_path
from clfcbf.trajectories.first_legs import PRICE, FirstLegs
from clfcbf.trajectories.following import FollowingGains
from clfcbf.trajectories.legs import Leg
from clfcbf.trajectories.rollout import Rollout, roll_out
from clfcbf.trajectories.sight import TOLERANCE, Sight
from clfcbf.trajectories.tangent import Candidates, tangent_candidates
from clfcbf.trajectories.terminal import TerminalCurves, nominal_offsets, terminal_curves
from clfcbf.trajectories.timing import time_path
from clfcbf.trajectories.visible import VisiblePath
from clfcbf.unicycle import Polar

__all__ = ["Plan", "Planner", "plan_approach"]

Array = NDArray[np.float64]

_ORIGIN = Pose2(0.0, 0.0, 0.0)
_REST = Twist(0.0, 0.0)

_SHORTEST = 1e-3
"""[m] A visible path shorter than that corrects nothing; one of no length has no samples."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Legs that lead to the goal, and how driving them turned out in simulation."""

    legs: tuple[Leg, ...]
    rollout: Rollout


class Planner:
    """Plans approaches to a goal whose feature has to stay in the camera's view.

    Parameters
    ----------
    guard : limits, period and barriers that the motion has to pass
    camera : the camera, with its true half angle
    standoff : distance from the goal to the feature straight ahead of it [m]
    lag : first-order lag of the body [s]
    gains : of the law that follows the plan
    """

    def __init__(
        self,
        guard: Guard,
        camera: FieldOfView,
        standoff: float,
        lag: float = 0.0,
        gains: FollowingGains | None = None,
    ) -> None:
        if not (math.isfinite(standoff) and standoff > max(camera.camera.x, 0.0)):
            raise ConfigurationError(
                "standoff must put the feature ahead of the camera "
                f"(> {max(camera.camera.x, 0.0)} m), got {standoff!r}"
            )
        limits = guard.limits
        self.guard = guard
        self.camera = camera
        self.standoff = standoff
        self.lag = lag
        self.gains = gains or FollowingGains()
        self.limits = Limits(
            limits.v_max,  # the virtual target waits for the robot, so there is nothing to catch up
            defaults.PLAN_TURN_RATE * limits.omega_max,
            defaults.PLAN_ACCELERATION * limits.a_max,
            defaults.PLAN_ACCELERATION * limits.alpha_max,
            limits.reverse_speed,
        )
        self.edge = camera.eroded(defaults.PLAN_EDGE, defaults.VIEW_SETBACK)
        self.curves, self.thinned = _curves(self.limits, self.edge, standoff)
        widest = self.limits.v_max / self.limits.omega_max
        self.radii = np.array([0.25, 0.5, 1.0]) * widest
        self._sight = Sight(self.edge, standoff)
        self._first_legs = FirstLegs(self._sight, self.limits, guard.lag)

    @property
    def feature(self) -> Pose2:
        """The feature in the goal's frame."""
        return Pose2(self.standoff, 0.0, 0.0)

    def plan(self, start: Pose2, applied: Twist = _REST) -> Plan:
        """The fastest approach found from ``start`` (goal's frame) while ``applied`` is in force.

        Raises
        ------
        GeometryError : the start is not finite
        PlanningError : no candidate arrives; ``reasons`` counts what forbade them
        """
        if not is_finite(tuple(start)):
            raise GeometryError(f"start must be finite, got {start!r}")
        reasons = dict.fromkeys(("no path", "field of view", "limits", "does not arrive"), 0)
        for search in (self._forward, self._visible, self._backed_off):
            best = self._fastest(search(start, reasons), start, applied, reasons)
            if best is not None:
                return best
        raise PlanningError(
            f"no approach from {start!r}: " + ", ".join(f"{k}: {n}" for k, n in reasons.items()),
            reasons,
        )

    def _fastest(
        self, tries: Iterable[tuple[float, tuple[Leg, ...]]], start: Pose2, applied: Twist,
        reasons: dict[str, int],
    ) -> Plan | None:  # fmt: skip
        best: Plan | None = None
        for estimate, legs in tries:
            if best is not None and best.rollout.duration <= estimate + defaults.PLAN_SLACK:
                break
            rollout = roll_out(
                legs, start, self.feature, self.guard, self.lag, self.gains, applied,
                patience=estimate + defaults.PLAN_PATIENCE,
            )  # fmt: skip
            x, y, theta = rollout.error
            farthest = max(pose.x for pose in rollout.poses)
            if not (
                rollout.arrived
                and farthest <= max(defaults.PLAN_PAST, start.x)
                and math.hypot(x, y) < defaults.PLAN_ERROR
                and abs(theta) < defaults.PLAN_ERROR_THETA
            ):
                reasons["does not arrive"] += 1
            elif best is None or rollout.duration < best.rollout.duration:
                best = Plan(legs, rollout)
        return best

    def _forward(
        self, start: Pose2, reasons: dict[str, int]
    ) -> Iterator[tuple[float, tuple[Leg, ...]]]:
        starts = np.array([start])
        found = tangent_candidates(starts, self.radii, self.curves)
        cost = self._cost(found, starts, np.zeros(1), self.curves, reasons)
        for i in np.argsort(cost)[: defaults.PLAN_TRIES]:
            if np.isfinite(cost[i]):
                path = approach_path(start, found, int(i), self.curves, self.limits)
                yield float(cost[i]), (path,)

    def _visible(
        self, start: Pose2, reasons: dict[str, int]
    ) -> Iterator[tuple[float, tuple[Leg, ...]]]:
        try:
            path = VisiblePath(Polar.of(start.relative(self.feature)), self.standoff)
        except GeometryError:
            reasons["no path"] += 1
            return
        if path.start.rho - self.standoff < _SHORTEST:
            reasons["no path"] += 1
            return
        if path.margin(self.edge) < 0.0:
            reasons["field of view"] += 1
            return
        try:
            timed = time_path(path.sampled(), self.limits)
        except PlanningError:
            reasons["limits"] += 1
            return
        yield timed.duration, (timed_path(timed, start, _ORIGIN),)

    def _backed_off(
        self, start: Pose2, reasons: dict[str, int]
    ) -> Iterator[tuple[float, tuple[Leg, ...]]]:
        firsts = self._first_legs.choices(start)
        if not firsts:
            return
        starts = np.array([first.end for first in firsts])
        times = np.array([first.time for first in firsts])
        found = tangent_candidates(starts, self.radii[[0, 2]], self.thinned)
        cost = self._cost(found, starts, times, self.thinned, reasons)
        # A reversal ends at full speed, from which the rest of the way has to be enough to stop.
        moving = np.array([isinstance(first.choice, int) for first in firsts])[found.start]
        rest = np.abs(found.swept * found.radius) + found.straight
        rest += self.thinned.to_go[found.curve, found.sample]
        stop = 0.5 * self.limits.v_max**2 / self.limits.a_max
        cost = np.where(moving & (rest < stop), np.inf, cost)
        taken: set[int] = set()
        for i in np.argsort(cost):
            row = int(found.start[i])
            if not np.isfinite(cost[i]) or len(taken) == defaults.PLAN_TRIES:
                break
            if row in taken:
                continue
            taken.add(row)
            first = firsts[row]
            path = approach_path(
                first.end, found, int(i), self.thinned, self.limits, first.turn_rate
            )
            yield float(cost[i]), (self._first_legs.leg(first, start), path)

    def _cost(
        self, found: Candidates, starts: Array, before: Array, curves: TerminalCurves,
        reasons: dict[str, int],
    ) -> Array:  # fmt: skip
        """Estimated time of each candidate with a soft price on bearings near the edge."""
        limits = self.limits
        radius = np.abs(found.radius)
        speed = np.minimum(limits.v_max, limits.omega_max * radius)
        rate = speed / radius
        step = curves.time[:, 1:] - curves.time[:, :-1]
        time = before[found.start] + np.abs(found.swept) * radius / speed
        time += found.straight / limits.v_max + 0.5 * limits.v_max / limits.a_max
        time += curves.time[found.curve, found.sample]
        time += found.part * step[found.curve, found.sample]
        ticks = np.maximum(speed / limits.a_max, rate / limits.alpha_max)
        overrun = np.minimum(rate * (0.5 * ticks + self.guard.lag), 0.35)
        end = self._bearing_on_arc(found, starts, 0.0)
        beyond = self._bearing_on_arc(found, starts, overrun)
        worst = np.maximum(end, beyond)
        reasons["no path"] += len(found) == 0
        outside = end > self.edge.half_angle + TOLERANCE
        reasons["field of view"] += int(np.count_nonzero(outside))
        time += 20.0 * np.maximum(0.0, worst - math.radians(30.0)) ** 2
        time += PRICE * np.maximum(0.0, worst - self.camera.half_angle) ** 2
        return np.where(outside, np.inf, time)

    def _bearing_on_arc(self, found: Candidates, starts: Array, overrun: Array | float) -> Array:
        """Magnitude of the bearing where each arc ends, or ``overrun`` [rad] further on it."""
        x, y, theta = starts[found.start].T
        end = theta + found.swept + np.sign(found.radius) * overrun
        px = x - found.radius * (np.sin(theta) - np.sin(end))
        py = y + found.radius * (np.cos(theta) - np.cos(end))
        return np.abs(self._sight.bearings(px, py, end))


@lru_cache(maxsize=8)
def _curves(
    limits: Limits, edge: FieldOfView, standoff: float
) -> tuple[TerminalCurves, TerminalCurves]:
    """Terminal curves and a choice of them, tabulated once for the same robot: 30 ms."""
    offsets = nominal_offsets(limits, edge, standoff, defaults.PLAN_CURVES)
    curves = terminal_curves(limits, edge, standoff, offsets, defaults.PLAN_REACH)
    return curves, curves.thinned(defaults.PLAN_THIN_CURVES, defaults.PLAN_THIN_SAMPLES)


def plan_approach(
    start: Pose2,
    goal: Pose2,
    limits: Limits,
    camera: FieldOfView,
    standoff: float,
    period: float,
    *,
    applied: Twist = _REST,
    lag: float = 0.0,
    guard_lag: float = defaults.GUARD_LAG,
) -> Plan:
    """The fastest approach found from ``start`` to ``goal`` that keeps the view and the limits.

    Parameters
    ----------
    start, goal : robot and goal pose in one frame
    limits, period : of the chassis and its control loop
    camera : the view the feature has to stay in
    standoff : distance from the goal to the feature straight ahead of it [m]
    applied : command in force at the start
    lag, guard_lag : lag of the body, and the longest one to be safe for [s]

    Returns
    -------
    Plan, whose legs and rollout are in the goal's frame

    Raises
    ------
    GeometryError : a pose is not finite, or the feature is behind the camera at the start
    LimitsError : ``applied`` is beyond the speed limits
    PlanningError : none of the candidates arrives; the message says what forbids them
    """
    if not is_finite((*start, *goal)):
        raise GeometryError(f"start and goal must be finite, got {start!r} and {goal!r}")
    if not limits.contains(applied, 1e-9):
        raise LimitsError(
            f"the start is beyond a limit: {applied!r} with v in "
            f"[{limits.reverse_speed}, {limits.v_max}] m/s, |omega| <= {limits.omega_max} rad/s"
        )
    seen = goal.relative(start)
    camera.check_ahead(seen.seen((standoff, 0.0)))
    gain = 1.0 / (limits.brake_horizon(check_period(period)) + guard_lag)
    barrier = FieldOfViewBarrier(camera, gain, defaults.VIEW_MARGIN, setback=defaults.VIEW_SETBACK)
    guard = Guard(limits, (barrier,), period, guard_lag)
    return Planner(guard, camera, standoff, lag).plan(seen, applied)
