"""What is attacked: the safety filter as it is by default, and the same with parts of it off."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from benchmarks.falsify.duel import Arena
from clfcbf import Barrier, Pose2, SafetyFilter, Scene
from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.rows import Rows
from clfcbf.defaults import GUARD_LAG
from clfcbf.safety_filter import as_barriers
from clfcbf.simulation.plant import DEFAULT_LAG
from clfcbf.simulation.scenarios import World, limits_named

__all__ = ["ARENA", "make_filter"]

_WORLD = World()
ARENA = Arena(limits_named("approaching"), _WORLD.camera, _WORLD.period)
"""The world that all figures refer to, at the speed limits of the approach."""


@dataclass(frozen=True, slots=True)
class _RowsAlone:
    """A barrier that the guard finds safe everywhere: only its rows are left."""

    barrier: Barrier

    @property
    def name(self) -> str:
        return self.barrier.name

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        return self.barrier.rows(scene, motion)

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        return math.inf

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        return math.inf

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        return math.inf, math.inf


def make_filter(protection: str = "full", arena: Arena = ARENA, gain: float = 0.0) -> SafetyFilter:
    """A new filter at its defaults, told the body's usual lag.

    ``protection`` is "full", "rows" for one without its guard, or "limits" for one that keeps
    nothing else; ``gain`` [1/s] is that of the rows, 0 for the default one.
    """
    (barrier,) = as_barriers([arena.camera], arena.limits, arena.period, GUARD_LAG)
    if gain:
        assert isinstance(barrier, FieldOfViewBarrier)
        barrier = replace(barrier, gain=gain)
    barriers = {"full": [barrier], "rows": [_RowsAlone(barrier)], "limits": []}[protection]
    return SafetyFilter(arena.limits, barriers, arena.period, lag=DEFAULT_LAG)
