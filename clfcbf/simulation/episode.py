"""One simulated run: sense, decide, move, tick by tick, under the eyes of its judge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from clfcbf.decision import Decision, Phase
from clfcbf.limits import Limits
from clfcbf.scene import Observation
from clfcbf.se2 import Twist
from clfcbf.simulation.judge import EpisodeResult, Trace, Watch
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensor import PoseSensor

__all__ = ["EpisodeController", "EpisodeResult", "Trace", "run_episode"]


class EpisodeController(Protocol):
    """What the runner asks of a controller."""

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick."""


def run_episode(
    plant: Plant,
    sensor: PoseSensor,
    controller: EpisodeController,
    world: World,
    limits: Limits,
    disturbance: Callable[[Plant], None] | None = None,
) -> tuple[EpisodeResult, Trace]:
    """Run until the controller is done or fails, or the patience ends; then wait and judge.

    Parameters
    ----------
    plant, sensor : the simulated robot
    controller : anything with ``step``
    world, limits : what the run is judged against
    disturbance : called once a tick before sensing, such as a nudge of the target
    """
    watch = Watch(plant.pose(), world, limits)
    wait = round(world.wait / world.period)
    finished = False
    contact = getattr(plant, "contact", None)
    for _ in range(round(world.patience / world.period) + wait):
        if disturbance is not None:
            disturbance(plant)
        sensor.capture()
        now, pose, applied = plant.time, plant.pose(), plant.applied()
        observation = sensor.observe()
        decision = controller.step(observation, applied, now)
        watch.decided(now, pose, plant.twist(), applied, observation is not None, decision)
        plant.send(decision.twist)
        watch.moved(pose, plant.advance(world.period), world.period)
        watch.ended(plant.time, plant.twist(), contact is not None and bool(contact()))
        finished = finished or decision.done or decision.phase is Phase.FAILED
        if finished:
            wait -= 1
            if wait <= 0:
                break
    return watch.verdict(plant.pose()), watch.trace
