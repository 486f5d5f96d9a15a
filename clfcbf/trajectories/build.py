"""From a candidate to a path: its samples, its speed within the limits, its turn rate smoothed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, arc
from clfcbf.trajectories.legs import Path
from clfcbf.trajectories.tangent import Candidates
from clfcbf.trajectories.terminal import TerminalCurves
from clfcbf.trajectories.timing import TimedPath

__all__ = ["approach_path", "arc_path", "timed_path"]

Array = NDArray[np.float64]

_SPACING = 0.01
"""Distance between samples on an arc or a line [m]; poses in between are interpolated."""

_MOST = 20_000
"""Samples of an arc or a line at most, coarser beyond 200 m: no length takes the memory away."""


def _cells(length: float) -> int:
    """Cells between the samples of an arc or a line."""
    return math.ceil(min(length / _SPACING, _MOST))


def _arc_samples(start: Pose2, radius: float, swept: float, limits: Limits) -> Array:
    """Samples (x, y, heading, speed, turn rate) along an arc, the start left out."""
    count = max(1, _cells(abs(swept * radius)))
    speed = min(limits.v_max, limits.omega_max * abs(radius))
    twist = Twist(speed, speed / radius)
    times = np.linspace(0.0, abs(swept * radius) / speed, count + 1)[1:]
    poses = [start.compose(arc(twist, t)) for t in times.tolist()]
    headings = start.theta + twist.omega * times  # unwrapped
    return np.array(
        [(p.x, p.y, h, *twist) for p, h in zip(poses, headings.tolist(), strict=True)]
    ).reshape(-1, 5)


def _line_samples(start: Pose2, length: float, limits: Limits) -> Array:
    along = np.linspace(0.0, length, max(2, _cells(length) + 1))[1:]
    columns = np.ones((len(along), 5)) * [0.0, 0.0, start.theta, limits.v_max, 0.0]
    columns[:, 0] = start.x + along * math.cos(start.theta)
    columns[:, 1] = start.y + along * math.sin(start.theta)
    return columns


def _slowed(speed: Array, steps: Array, deceleration: float) -> Array:
    """The largest speeds below ``speed`` from which each next one can be braked to."""
    allowed = speed.copy()
    for i in range(len(steps) - 1, -1, -1):
        reach = math.sqrt(allowed[i + 1] ** 2 + 2.0 * deceleration * steps[i])
        allowed[i] = min(allowed[i], reach)
    return allowed


def _smoothed(time: Array, turn_rate: Array, ramp: float, until: float, turning: float) -> Array:
    """Turn rate with its jumps made ramps of the given duration, centred on them.

    A centred ramp turns by as much as the jump did and moves the path by less than
    ``v omega ramp² / 24``, half a millimetre. ``turning`` is the rate before the path; what comes
    after ``until`` is kept.
    """
    time = np.concatenate([[time[0] - ramp, time[0]], time])
    turn_rate = np.concatenate([[turning, turning], turn_rate])
    swept = np.concatenate(
        [[0.0], np.cumsum(0.5 * (turn_rate[1:] + turn_rate[:-1]) * np.diff(time))]
    )
    later = np.interp(time + 0.5 * ramp, time, swept)
    sooner = np.interp(time - 0.5 * ramp, time, swept)
    return np.where(time < until, (later - sooner) / ramp, turn_rate)[2:]


def approach_path(
    start: Pose2, candidates: Candidates, row: int, curves: TerminalCurves, limits: Limits,
    turning: float = 0.0,
) -> Path:  # fmt: skip
    """The path of one candidate, from ``start`` to rest at the goal.

    ``curves`` must be the table the candidate refers to; ``limits`` those of the plan;
    ``turning`` is the turn rate with which the robot comes [rad/s].
    """
    j, i = int(candidates.curve[row]), int(candidates.sample[row])
    radius, swept = float(candidates.radius[row]), float(candidates.swept[row])
    pieces = [np.array([(start.x, start.y, start.theta, limits.v_max, 0.0)])]
    if abs(swept * radius) > 1e-4:
        bend = _arc_samples(start, radius, swept, limits)
        pieces[0][0, 3:] = bend[0, 3:]
        pieces.append(bend)
    straight = float(candidates.straight[row])
    if straight > 1e-4:
        x, y, theta = pieces[-1][-1, :3].tolist()
        pieces.append(_line_samples(Pose2(x, y, theta), straight, limits))
    entry = sum(len(piece) for piece in pieces) - 1
    table = (curves.x, curves.y, curves.heading, curves.speed, curves.turn_rate)
    pieces.append(np.stack([column[j, i::-1] for column in table], axis=1))
    samples = np.concatenate(pieces)
    steps = np.hypot(np.diff(samples[:, 0]), np.diff(samples[:, 1]))
    keep = np.concatenate([[True], steps > 1e-5])
    keep[-1] = True
    entry = int(np.count_nonzero(keep[: entry + 1])) - 1
    samples = samples[keep]
    x, y, _, profile, turn_rate = samples.T
    steps = np.maximum(np.hypot(np.diff(x), np.diff(y)), 1e-9)
    speed = _slowed(profile, steps, limits.a_max)
    turn_rate = np.where(profile > 0.0, turn_rate * speed / np.maximum(profile, 1e-9), turn_rate)
    time = np.concatenate(
        [[0.0], np.cumsum(steps / np.maximum(0.5 * (speed[1:] + speed[:-1]), 1e-3))]
    )
    ramp = limits.omega_max / limits.alpha_max
    until = min(float(time[entry]) + 0.5 * ramp, float(time[-1]) - ramp)
    turn_rate = _smoothed(time, turn_rate, ramp, until, turning)
    return _path(samples[:, :3], speed, turn_rate, steps, Pose2(0.0, 0.0, 0.0), 1)


def arc_path(start: Pose2, length: float, swept: float, limits: Limits, gear: int) -> Path:
    """A single arc from rest to rest: ``length`` [m] of travel while turning by ``swept`` [rad].

    The turn rate follows the speed, so the curvature is constant and limits of all four kinds
    are kept: the speed is that of the tighter of speed and turn rate, its slope likewise.
    """
    curvature = swept / length
    ratio = max(abs(curvature), 1e-9)
    top = min(limits.v_max if gear > 0 else -limits.reverse_speed, limits.omega_max / ratio)
    slope = min(limits.a_max, limits.alpha_max / ratio)
    count = max(2, _cells(length) + 1)
    along = np.linspace(0.0, length, count)
    speed = np.minimum(top, np.sqrt(2.0 * slope * (length - along)))
    poses = [start.compose(arc(Twist(float(gear), curvature), s)) for s in along.tolist()]
    return _path(np.array(poses), speed, curvature * speed, np.diff(along), poses[-1], gear)


def timed_path(timed: TimedPath, start: Pose2, end: Pose2) -> Path:
    """A timed path, seen from ``start``, as a leg that ends at rest in ``end``."""
    poses = np.array([start.compose(timed.path.pose(s)) for s in timed.s.tolist()])
    return _path(poses, np.abs(timed.v), timed.omega, np.diff(timed.s), end, timed.path.gear)


def _path(
    poses: Array, speed: Array, turn_rate: Array, steps: Array, end: Pose2, gear: int
) -> Path:
    s = np.concatenate([[0.0], np.cumsum(steps)])
    return Path(
        tuple(s.tolist()),
        tuple([Pose2(*pose) for pose in poses.tolist()]),
        tuple(speed.tolist()),
        tuple(turn_rate.tolist()),
        end,
        gear,
    )
