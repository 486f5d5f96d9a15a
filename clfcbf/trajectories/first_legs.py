"""First legs, from where an approach cannot begin forward: turns on the spot and ways back."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from clfcbf import defaults
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.trajectories.build import arc_path
from clfcbf.trajectories.legs import Leg, Path, Turn
from clfcbf.trajectories.reversal import Reversals
from clfcbf.trajectories.sight import Sight

__all__ = ["PRICE", "FirstLeg", "FirstLegs"]

PRICE = 50.0
"""[s/rad²] Of a look-ahead beyond the view, where the guard slows down: 1.5 s at 10°."""

_BESIDE = 0.1
"""[m] So near to the axis an approach may come from either side."""

_TURNS = np.radians(np.arange(-90.0, 90.1, 6.0)).tolist()
"""[rad] Turns on the spot that are tried."""


class FirstLeg(NamedTuple):
    """How an approach may begin, and go on from.

    Attributes
    ----------
    choice : the leg itself, or its row in the table of reversals, which go on at speed
    end : pose at its end
    time : it takes, before an approach from rest [s]
    turn_rate : with which it ends [rad/s]
    """

    choice: Turn | Path | int
    end: Pose2
    time: float
    turn_rate: float


class FirstLegs:
    """The first legs that keep the view, from any start.

    Parameters
    ----------
    sight : the view that may be used
    limits : of the plan
    lag : for which the guard looks ahead besides its brake [s]
    """

    def __init__(self, sight: Sight, limits: Limits, lag: float) -> None:
        self._sight = sight
        self._limits = limits
        self._lag = lag
        self._reversals = _table(limits)

    def choices(self, start: Pose2) -> list[FirstLeg]:
        """All of them from ``start``."""
        return [*self._turns(start), *self._straight_back(start), *self._backward(start)]

    def leg(self, first: FirstLeg, start: Pose2) -> Leg:
        """A first leg chosen from ``start``, to be driven."""
        choice = first.choice
        return self._reversals.leg(choice, start) if isinstance(choice, int) else choice

    def _turns(self, start: Pose2) -> list[FirstLeg]:
        """Turns on the spot, to either side."""
        limits, widest = self._limits, self._sight.widest(start)
        legs = []
        for turn in _TURNS:
            end = Pose2(start.x, start.y, wrap_angle(start.theta + turn))
            if abs(turn) > 0.05 and abs(self._sight.bearing(end)) <= widest:
                time = _rest_to_rest(abs(turn), limits.omega_max, limits.alpha_max)
                legs.append(FirstLeg(Turn(end.theta), end, time, 0.0))
        return legs

    def _straight_back(self, start: Pose2) -> list[FirstLeg]:
        """Ways straight back to a stop, best for small corrections at the goal."""
        limits, legs = self._limits, []
        for length in defaults.PLAN_BACKS if limits.reverse_speed < 0.0 else ():
            path = arc_path(start, length, 0.0, limits, -1)
            if abs(self._sight.bearing(path.end)) <= self._sight.widest(start):
                time = _rest_to_rest(length, -limits.reverse_speed, limits.a_max)
                legs.append(FirstLeg(path, path.end, time, 0.0))
        return legs

    def _backward(self, start: Pose2) -> list[FirstLeg]:
        """Reversals that go on toward the axis of the goal.

        They are dearer where the guard may see them turn out of the view.
        """
        table, limits = self._reversals, self._limits
        rows = np.flatnonzero((table.second * start.y <= 0.0) | (abs(start.y) < _BESIDE))
        poses = table.seen_from(start, rows)
        bearing = self._sight.bearings(*np.moveaxis(poses, 2, 0))
        rate = table.turn_rates[rows]
        further = bearing - rate * (0.5 * np.abs(rate) / limits.alpha_max + self._lag)
        widest = self._sight.widest(start)
        beyond = np.maximum(0.0, np.abs(further).max(axis=1) - widest)
        # They end at full speed, which the estimate of an approach is without.
        times = table.durations[rows] - 0.5 * limits.v_max / limits.a_max + PRICE * beyond**2
        legs = []
        for k in np.flatnonzero(np.abs(bearing).max(axis=1) <= widest).tolist():
            (x, y, theta), row = poses[k, -1].tolist(), int(rows[k])
            end = Pose2(x, y, wrap_angle(theta))
            legs.append(FirstLeg(row, end, float(times[k]), float(table.second[row])))
        return legs


@lru_cache(maxsize=8)
def _table(limits: Limits) -> Reversals:
    """Tabulated once for the same limits, in some milliseconds."""
    return Reversals.tabulated(
        limits, defaults.PLAN_REVERSES, defaults.PLAN_TURNS, defaults.PLAN_LEADS
    )


def _rest_to_rest(distance: float, speed: float, acceleration: float) -> float:
    """Time of a trapezoidal motion [s]."""
    if distance * acceleration < speed * speed:
        return 2.0 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration
