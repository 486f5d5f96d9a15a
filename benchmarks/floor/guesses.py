"""Where the search for the floor starts: one motion of each kind, for the problem is not convex.

None of them needs to be feasible. Each is a list of poses, timed by the speed limits.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from benchmarks.floor.program import Motion
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, wrap_angle

__all__ = ["guesses"]

Array = NDArray[np.float64]

SIDE = 0.6
"""[rad] Turn on the spot before a curve to one side: as wide as the view of the usual camera."""
BACK = 0.3
"""[m] First leg in reverse: half of the standoff; what a close start needs is 0.1 to 0.6 m."""
BACK_TURN = 0.5
"""[rad] Turn during that leg."""

_SHARE = np.linspace(0.0, 1.0, 41)


def guesses(start: Pose2, limits: Limits, intervals: int) -> dict[str, Motion]:
    """Motions from ``start`` to the goal, by name.

    ``straight`` slides to the goal; ``turn`` turns, drives and turns; ``curve`` is one curve
    along both headings, ``left`` and ``right`` the same after a turn to that side; ``back...``
    the same after a leg in reverse, straight or turning.
    """
    here = np.array(start)
    chord = math.atan2(-start.y, -start.x) if math.hypot(start.x, start.y) else 0.0
    # The chord is driven in the gear that turns less.
    if abs(wrap_angle(chord - start.theta)) > 0.5 * math.pi:
        chord = wrap_angle(chord + math.pi)
    facing = np.array([start.x, start.y, start.theta + wrap_angle(chord - start.theta)])
    arriving = np.array([0.0, 0.0, facing[2]])
    legs = {
        "straight": _between(here, np.zeros(3)),
        "turn": np.vstack(
            (_between(here, facing), _between(facing, arriving), _between(arriving, np.zeros(3)))
        ),
        "curve": _curve(here),
    }
    for name, turn in (("left", SIDE), ("right", -SIDE)):
        turned = here + np.array([0.0, 0.0, turn])
        legs[name] = np.vstack((_between(here, turned), _curve(turned)))
    if limits.reverse_speed < 0.0:
        for name, turn in (("back", 0.0), ("back-left", BACK_TURN), ("back-right", -BACK_TURN)):
            back = _backward(here, turn)
            legs[name] = np.vstack((back, _curve(back[-1])))
    return {name: _timed(poses, limits, intervals) for name, poses in legs.items()}


def _between(a: Array, b: Array) -> Array:
    return a + _SHARE[:, None] * (b - a)


def _curve(start: Array) -> Array:
    """The cubic that leaves along the start's heading and arrives along the goal's."""
    x, y, theta = start.tolist()
    reach, k = math.hypot(x, y), _SHARE
    stay, leave = (1.0 + 2.0 * k) * (1.0 - k) ** 2, k * (1.0 - k) ** 2
    arrive = -(k**2) * (1.0 - k)
    cubic = np.column_stack(
        (
            stay * x + reach * (leave * math.cos(theta) + arrive),
            stay * y + reach * leave * math.sin(theta),
        )
    )
    along = np.gradient(cubic, k, axis=0)
    heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    heading += theta - heading[0]
    # Back to the goal's own heading, which the program has as 0.
    heading -= k * heading[-1]
    return np.column_stack((cubic, heading))


def _backward(start: Array, turn: float) -> Array:
    theta = start[2] + turn * _SHARE
    step = -BACK / (len(_SHARE) - 1)
    middle = 0.5 * (theta[1:] + theta[:-1])
    x = start[0] + step * np.concatenate(([0.0], np.cumsum(np.cos(middle))))
    y = start[1] + step * np.concatenate(([0.0], np.cumsum(np.sin(middle))))
    return np.column_stack((x, y, theta))


def _timed(poses: Array, limits: Limits, intervals: int) -> Motion:
    """The poses at equal times, each stretch as long as its slower limit asks."""
    change = np.abs(np.diff(poses, axis=0))
    times = np.concatenate(
        (
            [0.0],
            np.cumsum(
                np.maximum(
                    np.hypot(change[:, 0], change[:, 1]) / limits.v_max,
                    change[:, 2] / limits.omega_max,
                )
            ),
        )
    )
    # What starting and stopping takes besides.
    ramps = limits.v_max / limits.a_max + limits.omega_max / limits.alpha_max
    at = np.linspace(0.0, times[-1], intervals + 1)
    path = np.column_stack([np.interp(at, times, column) for column in poses.T])
    duration = float(times[-1]) + ramps
    rates = np.gradient(path, duration / intervals, axis=0)
    v = rates[:, 0] * np.cos(path[:, 2]) + rates[:, 1] * np.sin(path[:, 2])
    states = np.column_stack((path, v, rates[:, 2]))
    states[0, 3:] = states[-1, 3:] = 0.0
    steps = np.diff(states[:, 3:], axis=0) * (intervals / duration)
    return Motion(duration, states, steps)
