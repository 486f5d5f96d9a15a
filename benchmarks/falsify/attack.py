"""An attack: everything the adversary may choose in one run, as numbers in [-1, 1].

One vector holds it, so that a random attack, a scripted one and an optimiser's are one thing.
Each number scales one bound of the assumptions, and an attack is therefore within any of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["CHANNELS", "CONSTANTS", "Attack", "Constants", "Move"]


class Constants(NamedTuple):
    """What holds for a whole run.

    ``distance`` and ``bearing`` of the start, ``lag`` from the shortest to the longest, scale
    errors of speed and turn rate, gyro ``drift``, instant and direction of the ``nudge``.
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

    ``v`` and ``omega`` are the nominal command, in units of the limits; ``omega`` and
    ``bearing`` count toward the nearer edge where the attack is ``outward``, so that +1 turns
    the feature out of view and reports it farther inside than it is. ``frame`` > 0.5 holds the
    frame back as long as the assumptions let it, ``tick`` > 0.5 the whole tick.
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
    """A plan of attack: constants, and moves that are held for ``hold`` ticks each.

    ``outward`` gives the signs of turn rate and bearing error the meaning of :class:`Move`;
    otherwise they are those of the robot frame.
    """

    constants: NDArray[np.float64]
    moves: NDArray[np.float64]
    hold: int
    outward: bool

    @property
    def ticks(self) -> int:
        """Length of the run, if nothing ends it before."""
        return len(self.moves) * self.hold
