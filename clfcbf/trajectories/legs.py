"""The legs of a plan: a path with its speed profile, a turn on the spot, or a timed trajectory."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from clfcbf.errors import GeometryError
from clfcbf.se2 import Pose2, Twist, wrap_angle

__all__ = ["Leg", "Moment", "Path", "Place", "Trajectory", "Turn"]

_COINCIDENT = 1e-18
"""[m²] Squared distance under which two samples are one: no direction is read off a nanometre."""


class Place(NamedTuple):
    """A place on a path: arc length from its start [m], pose, profile speed and turn rate.

    ``speed`` [m/s] is never negative, ``turn_rate`` [rad/s] belongs to that speed, and
    ``rest`` [m] is what remains to the end; negative once the robot is past it.
    """

    s: float
    pose: Pose2
    speed: float
    turn_rate: float
    rest: float


class Turn(NamedTuple):
    """A leg that turns on the spot to a heading in the goal's frame [rad]."""

    heading: float


@dataclass(frozen=True, slots=True)
class Path:
    """A leg without a change of gear, in the goal's frame.

    Attributes
    ----------
    s : arc length of each sample from the start, strictly increasing [m], shape (n,)
    poses : pose of the robot at each sample
    speed : profile speed [m/s], zero at the end, shape (n,)
    turn_rate : turn rate at that speed [rad/s], shape (n,)
    end : pose at rest after the leg; its heading differs from the last sample's where the path
        ends in a turn on the spot
    gear : +1 forward, -1 reverse

    Raises
    ------
    GeometryError : fewer than two samples, columns of different lengths, or arc lengths that
        do not increase
    """

    s: tuple[float, ...]
    poses: tuple[Pose2, ...]
    speed: tuple[float, ...]
    turn_rate: tuple[float, ...]
    end: Pose2
    gear: int = 1

    def __post_init__(self) -> None:
        lengths = {len(self.s), len(self.poses), len(self.speed), len(self.turn_rate)}
        if len(lengths) != 1 or len(self.s) < 2:
            raise GeometryError(
                f"a path needs columns of one length, 2 or more, got {sorted(lengths)}"
            )
        if not all(before < after for before, after in pairwise(self.s)):
            raise GeometryError(f"the arc lengths of a path must increase, got {self.s!r}")

    @property
    def length(self) -> float:
        """Length of the leg [m]."""
        return self.s[-1] - self.s[0]

    def at(self, s: float) -> Place:
        """The place at arc length ``s``, held at the ends."""
        i = min(max(bisect_left(self.s, s), 1), len(self.s) - 1)
        return self._between(i, (s - self.s[i - 1]) / (self.s[i] - self.s[i - 1]))

    def nearest(self, pose: Pose2, since: float = 0.0) -> Place:
        """The place abreast of ``pose``, at or after the arc length ``since``.

        Walks forward from ``since`` while the robot is beyond the normal of the next sample,
        so a path that comes near itself is never short-cut. Past the last sample the place
        runs on, with a negative ``rest``.
        """
        last = len(self.s) - 1
        i = min(max(bisect_left(self.s, since), 1), last)
        while i < last and self._beyond(self.poses[i], pose):
            i += 1
        a, b = self.poses[i - 1], self.poses[i]
        dx, dy = b.x - a.x, b.y - a.y
        square = dx * dx + dy * dy
        part = 1.0  # of samples that coincide the later one
        if square > _COINCIDENT:
            part = ((pose.x - a.x) * dx + (pose.y - a.y) * dy) / square
        if i < last:
            part = min(part, 1.0)
        return self._between(i, max(part, (since - self.s[i - 1]) / (self.s[i] - self.s[i - 1])))

    def _beyond(self, sample: Pose2, pose: Pose2) -> bool:
        along = (pose.x - sample.x) * math.cos(sample.theta)
        along += (pose.y - sample.y) * math.sin(sample.theta)
        return self.gear * along > 0.0

    def _between(self, i: int, part: float) -> Place:
        """The place ``part`` of the way from sample ``i - 1`` to ``i``."""
        held = min(max(part, 0.0), 1.0)
        a, b = self.poses[i - 1], self.poses[i]
        s = self.s[i - 1] + part * (self.s[i] - self.s[i - 1])
        return Place(
            s,
            _between(a, b, held),
            self.speed[i - 1] + held * (self.speed[i] - self.speed[i - 1]),
            self.turn_rate[i - 1] + held * (self.turn_rate[i] - self.turn_rate[i - 1]),
            self.s[-1] - s,
        )


class Moment(NamedTuple):
    """Where a trajectory is at a time: pose, and twist there."""

    pose: Pose2
    twist: Twist


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A leg by time, in the goal's frame, from rest; it need not end at rest.

    Through a change of gear a robot may turn where it makes no way, so that no arc length tells
    where it is.

    Attributes
    ----------
    times : of each sample, from 0, strictly increasing [s]
    poses, twists : of the robot at each sample

    Raises
    ------
    GeometryError : fewer than two samples, or columns of different lengths
    """

    times: tuple[float, ...]
    poses: tuple[Pose2, ...]
    twists: tuple[Twist, ...]

    def __post_init__(self) -> None:
        lengths = {len(self.times), len(self.poses), len(self.twists)}
        if len(lengths) != 1 or len(self.times) < 2:
            raise GeometryError(
                f"a trajectory needs columns of one length, 2 or more, got {sorted(lengths)}"
            )

    @property
    def duration(self) -> float:
        """Time from its start to its end [s]."""
        return self.times[-1]

    def at(self, time: float) -> Moment:
        """Pose and twist at ``time`` [s], linear between the samples, held at the ends."""
        i = min(max(bisect_left(self.times, time), 1), len(self.times) - 1)
        begin, end = self.times[i - 1], self.times[i]
        part = min(max((time - begin) / (end - begin), 0.0), 1.0)
        (v, omega), (v_next, omega_next) = self.twists[i - 1], self.twists[i]
        return Moment(
            _between(self.poses[i - 1], self.poses[i], part),
            Twist(v + part * (v_next - v), omega + part * (omega_next - omega)),
        )


def _between(a: Pose2, b: Pose2, part: float) -> Pose2:
    return Pose2(
        a.x + part * (b.x - a.x),
        a.y + part * (b.y - a.y),
        wrap_angle(a.theta + part * wrap_angle(b.theta - a.theta)),
    )


Leg = Path | Turn | Trajectory
