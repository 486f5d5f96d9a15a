r"""The nominal law that follows a leg: Kanayama's with the virtual target abreast of the robot.

The virtual target is the place of the path abreast of the robot, moving at the speed that this
tick can reach, so its longitudinal error is zero and the law [Kanayama1990]_ reads

.. math::

    v = v_V, \qquad
    \omega = \omega_V + k_2 v_V y_e + k_3 |v_V| \sin\theta_e .

Per metre travelled the lateral error obeys :math:`e'' + k_3 e' + k_2 e = 0`. On a leg by time
the target moves on by a period a tick, with a longitudinal term added, and waits for a robot that
falls behind. The last millimetres are a regulator to the end pose, longitudinal and by turning
on the spot; what is left sideways no nonholonomic robot can remove there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.errors import ConfigurationError
from clfcbf.limits import InputBox, Limits
from clfcbf.scene import Reference
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.trajectories.legs import Leg, Path, Trajectory, Turn
from clfcbf.trajectories.stopping import command_to

__all__ = ["Following", "FollowingGains", "Inertia", "at_rest", "follow", "is_over"]

_AT_REST = Twist(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FollowingGains:
    """Gains of the law and the tolerances of its last millimetres.

    Attributes
    ----------
    k2 : gain on the lateral error [1/m²]
    k3 : gain on the heading error [1/m]; ``2 sqrt(k2)`` is critical
    heading : gain on the heading error that fades in as the robot slows down [1/s]
    settle_x : gain of the longitudinal regulator [1/s]
    settle_theta : gain of the heading regulator [1/s]
    settle_from : distance before the end at which the regulator takes over [m]
    stop_from, face_from : at which the fastest stop takes over, of the speed and of the turn [m]
    done_x, done_theta : errors at which the goal counts as reached [m, rad]
    """

    k2: float = defaults.FOLLOW_K2
    k3: float = defaults.FOLLOW_K3
    heading: float = defaults.FOLLOW_HEADING
    settle_x: float = defaults.SETTLE_X
    settle_theta: float = defaults.SETTLE_THETA
    settle_from: float = defaults.SETTLE_FROM
    stop_from: float = defaults.STOP_FROM
    face_from: float = defaults.FACE_FROM
    done_x: float = defaults.DONE_X
    done_theta: float = defaults.DONE_THETA

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0.0 or (name == "heading" and value == 0.0))):
                raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")


class Inertia(NamedTuple):
    """What of the body's motion is left at this tick: command in force, its twist, its lag [s]."""

    applied: Twist
    body: Twist
    lag: float


class Following(NamedTuple):
    """The law at one tick.

    ``twist`` is the command; ``reference`` the virtual target as seen from the robot, with its
    own twist; ``s`` the arc length reached, or the time on a leg by time; ``arrived`` whether
    position and heading are those of the leg's end, the speeds left aside.
    """

    twist: Twist
    reference: Reference
    s: float
    arrived: bool


def at_rest(twist: Twist) -> bool:
    """Whether a command is as good as zero: below 2 mm/s and 10 mrad/s."""
    return abs(twist[0]) < 2e-3 and abs(twist[1]) < 1e-2


def is_over(leg: Leg, following: Following, applied: Twist) -> bool:
    """Whether the next leg may begin: after a leg by time at once, after others at rest."""
    return following.arrived and (isinstance(leg, Trajectory) or at_rest(applied))


def follow(
    leg: Leg,
    last: bool,
    pose: Pose2,
    since: float,
    box: InputBox,
    limits: Limits,
    period: float,
    gains: FollowingGains,
    inertia: Inertia | None = None,
) -> Following:
    """Command that follows ``leg`` from ``pose``.

    Parameters
    ----------
    leg : path, turn on the spot or trajectory, in the goal's frame
    last : whether the leg ends at the goal, where the last millimetres count
    pose : where the body coasts to, in the goal's frame
    since : arc length reached before, or time; progress never goes back
    box : commands reachable this tick
    limits, period : of the chassis
    inertia : of the body, with which it stops at the goal as fast as it can; without, the command
        ends there and the body coasts out
    """
    if isinstance(leg, Turn):
        error = Pose2(0.0, 0.0, wrap_angle(leg.heading - pose.theta))
        twist = box.clip(Twist(0.0, _spin(error.theta, limits, gains)))
        arrived = abs(error.theta) < 5.0 * gains.done_theta
        return Following(twist, Reference(error, _AT_REST), since, arrived)
    if isinstance(leg, Trajectory):
        return _track(leg, pose, since, box, limits, period, gains)
    place = leg.nearest(pose, since)
    if place.rest < gains.settle_from:
        s = max(place.s, since)
        if last and inertia is not None and inertia.lag > 0.0:
            return _stop(leg, pose, s, box, limits, period, gains, inertia)
        return _settle(leg, last, pose, s, box, limits, gains)
    error = pose.relative(place.pose)
    speed = max(abs(box.v_lo), abs(box.v_hi))
    ahead = leg.at(place.s + 0.5 * period * speed)
    v = min(max(leg.gear * ahead.speed, box.v_lo), box.v_hi)
    feed = ahead.turn_rate
    if place.speed > abs(v):
        feed *= abs(v) / place.speed
    sin = math.sin(error.theta)
    omega = feed + gains.k2 * v * error.y + gains.k3 * abs(v) * sin
    slow = max(0.0, 1.0 - abs(v) / limits.v_max) * max(0.0, 1.0 - 10.0 * place.rest)
    omega += gains.heading * slow * sin
    stopping = last and inertia is not None and inertia.lag > 0.0 and leg.gear > 0
    if stopping and inertia is not None and place.rest < gains.stop_from:
        v, turned = _stopped(leg, pose, limits, period, gains, inertia)
        omega = turned if place.rest < gains.face_from else omega
    twist = box.clip(Twist(v, omega))
    return Following(twist, Reference(error, Twist(v, feed)), max(place.s, since), False)


def _track(
    leg: Trajectory, pose: Pose2, time: float, box: InputBox, limits: Limits, period: float,
    gains: FollowingGains,
) -> Following:  # fmt: skip
    """The law on a leg by time; over a tick, its twist's mean is that of the middle."""
    error = pose.relative(leg.at(time).pose)
    v, omega = leg.at(time + 0.5 * period).twist
    sin = math.sin(error.theta)
    slow = max(0.0, 1.0 - abs(v) / limits.v_max)
    turned = omega + gains.k2 * v * error.y + (gains.k3 * abs(v) + gains.heading * slow) * sin
    along = v * math.cos(error.theta) + gains.settle_x * error.x
    waits = abs(error.x) > defaults.TRACK_WAIT or abs(error.theta) > defaults.TRACK_WAIT_THETA
    reached = time if waits else time + period
    reference = Reference(error, Twist(v, omega))
    return Following(box.clip(Twist(along, turned)), reference, reached, time >= leg.duration)


def _spin(theta: float, limits: Limits, gains: FollowingGains) -> float:
    """Turn rate toward a heading error: proportional, and never more than can be braked.

    Two thirds of the angular acceleration are planned on, for the rate is held over each tick.
    """
    rate = min(
        limits.omega_max,
        math.sqrt(4.0 / 3.0 * limits.alpha_max * abs(theta)),
        gains.settle_theta * abs(theta),
    )
    return math.copysign(rate, theta)


def _settle(
    leg: Path, last: bool, pose: Pose2, s: float, box: InputBox, limits: Limits,
    gains: FollowingGains,
) -> Following:  # fmt: skip
    error = pose.relative(leg.end)
    near = abs(error.x) < gains.done_x
    facing = abs(error.theta) < gains.done_theta or not last
    v = 0.0 if near else gains.settle_x * error.x
    omega = 0.0 if facing else _spin(error.theta, limits, gains)
    twist = box.clip(Twist(v, omega))
    return Following(twist, Reference(error, _AT_REST), s, (near and facing) or not last)


def _stopped(
    leg: Path, pose: Pose2, limits: Limits, period: float, gains: FollowingGains, inertia: Inertia
) -> tuple[float, float]:
    """Speed and turn rate of the fastest stop at the end of the leg."""
    (v, omega), (v_body, omega_body), lag = inertia
    error = pose.relative(leg.end)
    return (
        command_to(error.x, v, v_body, limits.a_max, limits.v_max, period, lag, gains.done_x),
        command_to(
            error.theta, omega, omega_body, limits.alpha_max, limits.omega_max, period, lag,
            gains.done_theta,
        ),
    )  # fmt: skip


def _stop(
    leg: Path, pose: Pose2, s: float, box: InputBox, limits: Limits, period: float,
    gains: FollowingGains, inertia: Inertia,
) -> Following:  # fmt: skip
    twist = box.clip(Twist(*_stopped(leg, pose, limits, period, gains, inertia)))
    error = pose.relative(leg.end)
    near = abs(error.x) < gains.done_x and abs(error.theta) < gains.done_theta
    return Following(twist, Reference(error, _AT_REST), s, near and at_rest(inertia.body))
