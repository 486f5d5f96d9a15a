r"""What is checked of a floor, without the program: its motion, and that nothing can be faster."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from benchmarks.floor.program import Motion
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.simulation.scenarios import World

__all__ = ["Certificate", "certify", "least_time", "rest_to_rest"]

STEP = 1e-3
"""[s] Of the integration and of the check of the view: a tenth of a millimetre at full speed."""

_State = tuple[float, float, float, float, float]


class Certificate(NamedTuple):
    """What a motion comes to when it is integrated afresh from the start.

    Attributes
    ----------
    end_error, end_turn : distance and heading from the goal at the end [m, rad], magnitudes
    end_speed, end_rate : what is left of the speeds there [m/s, rad/s], magnitudes
    violation : largest angle of the feature beyond the edge of the view [rad]; negative is the
        smallest margin inside
    excess : largest overrun of the four limits, as a share of the limit; negative inside
    """

    end_error: float
    end_turn: float
    end_speed: float
    end_rate: float
    violation: float
    excess: float


def certify(motion: Motion, start: Pose2, world: World, limits: Limits) -> Certificate:
    """Integrate the accelerations alone by Runge-Kutta of order 4, in steps of 1 ms or less."""
    state: _State = (*start, 0.0, 0.0)
    feature = world.feature
    worst = -world.camera.margin(start.seen(feature))
    interval = motion.duration / len(motion.accelerations)
    count = max(1, math.ceil(interval / STEP))
    step = interval / count
    speeds = [state[3:]]
    for a, alpha in motion.accelerations.tolist():
        for _ in range(count):
            state = _runge_kutta(state, a, alpha, step)
            pose = Pose2(*state[:3])
            worst = max(worst, -world.camera.margin(pose.seen(feature)))
        speeds.append(state[3:])  # linear in between, so the largest are here
    x, y, theta, v, omega = state
    v_all, omega_all = np.array(speeds).T
    a_all, alpha_all = np.abs(motion.accelerations).T
    excess = max(
        (v_all.max() - limits.v_max) / limits.v_max,
        # A robot that may not reverse has no speed of reverse to take a share of.
        (limits.reverse_speed - v_all.min()) / limits.v_max,
        (np.abs(omega_all).max() - limits.omega_max) / limits.omega_max,
        (a_all.max() - limits.a_max) / limits.a_max,
        (alpha_all.max() - limits.alpha_max) / limits.alpha_max,
    )
    turn = abs(wrap_angle(theta))
    return Certificate(math.hypot(x, y), turn, abs(v), abs(omega), worst, float(excess))


def _rate(state: _State, a: float, alpha: float) -> _State:
    _, _, theta, v, omega = state
    return v * math.cos(theta), v * math.sin(theta), omega, a, alpha


def _runge_kutta(state: _State, a: float, alpha: float, h: float) -> _State:
    def ahead(slope: _State, share: float) -> _State:
        x, y, theta, v, omega = (s + share * h * k for s, k in zip(state, slope, strict=True))
        return x, y, theta, v, omega

    first = _rate(state, a, alpha)
    second = _rate(ahead(first, 0.5), a, alpha)
    third = _rate(ahead(second, 0.5), a, alpha)
    fourth = _rate(ahead(third, 1.0), a, alpha)
    mean = tuple(
        (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
        for k1, k2, k3, k4 in zip(first, second, third, fourth, strict=True)
    )
    x, y, theta, v, omega = (s + h * k for s, k in zip(state, mean, strict=True))
    return x, y, theta, v, omega


def rest_to_rest(distance: float, speed: float, acceleration: float) -> float:
    r"""Least time of a scalar motion from rest to rest [s].

    .. math:: 2\sqrt{d/a}\ \text{ if } d\,a < v^2, \qquad d/v + v/a\ \text{ else}
    """
    if distance * acceleration < speed * speed:
        return 2.0 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


def least_time(start: Pose2, limits: Limits) -> float:
    r"""A bound that no motion from ``start`` at rest to the goal at rest is faster than [s].

    Whatever the path, :math:`\int |v|\,dt` is at least the distance to the goal and
    :math:`\int |\omega|\,dt` at least the heading error. :math:`|v|` starts and ends at 0,
    changes by at most :math:`a_{max}` and stays below the larger of the two speed limits, so
    its integral over T is at most that of a trapezium; likewise for :math:`|\omega|`.
    """
    fastest = max(limits.v_max, -limits.reverse_speed)
    return max(
        rest_to_rest(math.hypot(start.x, start.y), fastest, limits.a_max),
        rest_to_rest(abs(wrap_angle(start.theta)), limits.omega_max, limits.alpha_max),
    )
