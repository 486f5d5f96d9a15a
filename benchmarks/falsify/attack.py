"""An attack: everything the adversary chooses in one run, as numbers in [-1, 1].

Two arrays hold it, so that a random attack, a scripted one and an optimiser's are one thing.
Each number scales one bound of the assumptions: no attack can leave them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["CHANNELS", "CONSTANTS", "Attack", "Constants", "Move"]


class Constants(NamedTuple):
    """What holds for a whole run.

    ``distance`` and ``bearing`` of the start, ``lag`` from the shortest to the longest, scale
    errors of speed and turn rate, gyro ``drift``, instant and direction of the nudge.
    """

    distance: float
    bearing: float
    lag: float
    scale_v: float
    scale_omega: float
    drift: float
    nudge_time: float
    nudge_direction: float


class Move(NamedTuple):
    """What holds for one tick.

    ``v`` and ``omega`` are the nominal command, in units of more than the limits. ``bearing``,
    ``range`` and ``stamp`` are the errors of a frame that arrives now and ``latency`` its age,
    -1 for a new one; ``frame`` > 0.5 withholds it as long as the assumptions allow, ``tick`` >
    0.5 withholds the whole tick.
    """

    v: float
    omega: float
    bearing: float
    range: float
    latency: float
    stamp: float
    frame: float
    tick: float


CONSTANTS, CHANNELS = len(Constants._fields), len(Move._fields)


class Attack(NamedTuple):
    """A plan: ``constants`` (8,), and ``moves`` (K, 8) that are held for ``hold`` ticks each.

    Where it is ``outward``, turn rate and bearing error count from the side on which the
    feature is: +1 turns it out of view and reports it farther inside than it is. Otherwise they
    are those of the robot frame.
    """

    constants: NDArray[np.float64]
    moves: NDArray[np.float64]
    hold: int
    outward: bool

    @property
    def ticks(self) -> int:
        """Length of the run, if nothing ends it before."""
        return len(self.moves) * self.hold
