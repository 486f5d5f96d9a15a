"""What happens to the target during a run: it is nudged."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clfcbf.se2 import Pose2
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.regions import Nudge

__all__ = ["Nudges"]


class Nudges:
    """Moves a plant's target, each nudge once; a ``disturbance`` of ``run_episode``.

    Directions and sides are drawn when it is made, so that two controllers with one seed meet
    the same ones, whenever they come to it.

    Parameters
    ----------
    nudges : what moves the target by how much, and when
    rng : draws the directions, uniform, and the sides
    """

    def __init__(self, nudges: Sequence[Nudge], rng: np.random.Generator) -> None:
        self._pending = [(nudge, _shift(nudge, rng)) for nudge in nudges]

    def __call__(self, plant: Plant) -> None:
        """Move the target if it is time to."""
        for entry in tuple(self._pending):
            nudge, shift = entry
            if _is_due(nudge, plant):
                self._pending.remove(entry)
                plant.move_target(shift)


def _is_due(nudge: Nudge, plant: Plant) -> bool:
    if nudge.time is not None:
        return plant.time >= nudge.time
    return nudge.e_lon is not None and plant.pose().x >= nudge.e_lon


def _shift(nudge: Nudge, rng: np.random.Generator) -> Pose2:
    direction = float(rng.uniform(-math.pi, math.pi))
    side = float(rng.choice((-1.0, 1.0)))
    return Pose2(
        nudge.distance * math.cos(direction), nudge.distance * math.sin(direction),
        side * nudge.turn,
    )  # fmt: skip
