"""What a plan comes to when it is driven: the law, the limits and the guard, simulated.

A geometric path knows nothing of the angular acceleration at its joints or of the look-ahead
of the guard. So a candidate is judged by driving it, with the very law and guard that will
drive the robot, on the modelled body: the limits hold by construction, and its time, its
smallest clearance and its error at the end are those of the motion itself.
"""

from __future__ import annotations

from dataclasses import dataclass

from clfcbf.estimation import body_after, coast
from clfcbf.guard import Guard, Verdict
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist
from clfcbf.trajectories.following import FollowingGains, follow, is_over
from clfcbf.trajectories.legs import Leg

__all__ = ["Rollout", "roll_out"]

_ORIGIN = Pose2(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Rollout:
    """A simulated run.

    Attributes
    ----------
    times, poses, twists : time [s], pose in the goal's frame and command of each tick
    clearance : smallest clearance of the barriers on the way, in their unit
    guarded : ticks in which the guard changed the command
    arrived : whether it came to rest at the goal in the time given
    """

    times: tuple[float, ...]
    poses: tuple[Pose2, ...]
    twists: tuple[Twist, ...]
    clearance: float
    guarded: int
    arrived: bool

    @property
    def duration(self) -> float:
        """Time to rest [s]."""
        return self.times[-1]

    @property
    def error(self) -> Pose2:
        """Pose at the end, seen from the goal."""
        return self.poses[-1]


def roll_out(
    legs: tuple[Leg, ...],
    start: Pose2,
    feature: Pose2,
    guard: Guard,
    lag: float,
    gains: FollowingGains,
    applied: Twist = Twist(0.0, 0.0),  # noqa: B008 - immutable
    patience: float = 60.0,
) -> Rollout:
    """Drive ``legs`` from ``start`` on the modelled body.

    Parameters
    ----------
    legs : the last one ends at the goal, the origin of the frame
    start : robot in the goal's frame
    feature : viewed feature in the goal's frame
    guard, lag, gains : as they will drive the robot; the body lags by ``lag`` [s]
    applied : command in force at the start, which the body follows already
    patience : longest time simulated [s]
    """
    limits, period = guard.limits, guard.period
    pose, body, command = start, applied, applied
    brake = guard.brake_from(applied)
    index, s, time, guarded, arrived = 0, 0.0, 0.0, 0, False
    clearance = float("inf")
    times, poses, twists = [0.0], [start], [applied]
    while time < patience and not arrived:
        box = limits.input_box(command, period)
        ahead = pose.compose(coast(body, lag))
        last = index == len(legs) - 1
        wanted = follow(legs[index], last, ahead, s, box, limits, period, gains)
        s = wanted.s
        if is_over(legs[index], wanted, command):
            arrived = last
            index, s = min(index + 1, len(legs) - 1), 0.0
        scene = Scene(pose.relative(_ORIGIN), pose.relative(feature), time)
        outcome = guard.filter(wanted.twist, scene, body, box, brake)
        brake, command = outcome.brake, outcome.twist
        guarded += outcome.verdict is not Verdict.ADMITTED
        body, mean = body_after(body, command, period, lag)
        pose = pose.moved(mean, period)
        time += period
        clearance = min(clearance, outcome.clearance)
        times.append(time)
        poses.append(pose)
        twists.append(command)
    return Rollout(tuple(times), tuple(poses), tuple(twists), clearance, guarded, arrived)
