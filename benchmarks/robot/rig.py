"""The robot of the campaigns: a MuJoCo body, and by which way commands and measurements travel."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmarks.robot.witness import Witness
from clfcbf.controller import DockingController
from clfcbf.hardware.can_settings import SILENCE as CAN_SILENCE
from clfcbf.hardware.can_settings import CanTiming, WheelDrive
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.protocols import Chassis, Clock, TargetSensor
from clfcbf.limits import Limits
from clfcbf.runtime import PlantInTheLoop
from clfcbf.se2 import Pose2
from clfcbf.session import Dock, DockDatabase, DockType
from clfcbf.simulation.mujoco_plant import MujocoPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World, draw_start, region_named
from clfcbf.simulation.sensors import make_sensor
from clfcbf.wheels import WheelLimits

__all__ = [
    "DOCKS",
    "LEFT",
    "RIGHT",
    "SILENCE",
    "VIAS",
    "WHEELS",
    "Rig",
    "Setting",
    "can_timing",
    "make_rig",
]

LEFT, RIGHT = WheelDrive(1, 1e4), WheelDrive(2, -1e4)  # 0.1 mrad/s; the right motor is mirrored
WHEELS = WheelLimits(track=0.42, radius=0.08, speed=0.5, acceleration=2.0)

PHYSICS = 480.0
"""[Hz] Sub-steps of the body: its physics steps, each of which is judged."""

SILENCE = 0.12
"""[s] After which a drive stops without heartbeat where parts are killed: six of them, at 20 ms."""

_STAGED = DockType(staging_offset=Pose2(-1.2, 0.0, 0.0))
DOCKS = DockDatabase({"a": Dock("a", _STAGED, Pose2(0.0, 0.0, 0.0))}, {"default": _STAGED})
_CHANNELS = itertools.count()


@dataclass(frozen=True, slots=True)
class Setting:
    """One run's robot, reproducible from these values where time is simulated.

    Attributes
    ----------
    seed, index : of the campaign, and of the run in it
    real : whether time is the machine's
    silence : after which a drive stops without this side's heartbeat, where it is [s]
    rate : of the control loop [Hz]
    region, limits, sensor : by name
    """

    seed: int
    index: int
    real: bool = False
    silence: float = CAN_SILENCE
    rate: float = 30.0
    region: str = "R1"
    limits: str = "approaching"
    sensor: str = "A"

    @property
    def period(self) -> float:
        """Of the loop [s]."""
        return 1.0 / self.rate

    @property
    def bounds(self) -> Limits:
        """The limits themselves."""
        return LIMITS[self.limits]

    def stream(self, what: int) -> np.random.Generator:
        """Random numbers: 0 start, 1 body, 2 sensor, 3 what happens to it."""
        return np.random.default_rng([self.seed, self.index, what])

    def start(self) -> Pose2:
        """Where the robot starts, in the goal's frame."""
        return draw_start(region_named(self.region), World(), self.stream(0))

    def body(self) -> Witness:
        """The robot's body at its start, and what watches it."""
        world, body = World(), Body(rate=PHYSICS)
        plant = MujocoPlant(
            self.start(), self.bounds, body, self.stream(1), standoff=world.standoff,
            board_width=world.board_width,
        )  # fmt: skip
        return Witness(plant, world, self.bounds, self.period, 2 if self.real else 1)

    def controller(self, backend: Any = "exact") -> DockingController:
        """A controller whose guard also covers how long a drive drives on without this process."""
        world, lag = World(), Body().lag
        return DockingController(
            self.bounds, world.camera, world.standoff, self.period, backend, lag=lag,
            guard_lag=lag + self.silence + 2.0 * self.period,
        )  # fmt: skip


class Rig(NamedTuple):
    """A robot as the loop meets it, and the truth behind it.

    Attributes
    ----------
    witness : the body
    robot : its time, and what lets it pass
    chassis, sensor, clock : for the loop
    parts : whatever else there is to be killed, by name
    close : takes everything down
    """

    witness: Witness
    robot: PlantInTheLoop
    chassis: Chassis
    sensor: TargetSensor
    clock: Clock
    parts: dict[str, Any]
    close: Callable[[], None]


def _wall(setting: Setting) -> Clock | None:
    return MonotonicClock() if setting.real else None


def _direct(setting: Setting) -> Rig:
    """Commands and measurements by function calls."""
    witness = setting.body()
    sensor = make_sensor(setting.sensor, witness, World(), setting.stream(2))
    robot = PlantInTheLoop(witness, sensor, _wall(setting))
    return Rig(witness, robot, robot, robot, robot, {}, robot.close)


def can_timing(setting: Setting) -> CanTiming:
    """Of the bus; where time is simulated its watchdogs, on the machine's, only have to exist."""
    if not setting.real:
        return CanTiming(timeout=5.0, silence=5.0, heartbeat=0.2)
    return CanTiming(timeout=1.25 * setting.silence, silence=setting.silence, heartbeat=0.02)


def _can(setting: Setting) -> Rig:
    """Commands through two CiA-402 drives on a virtual CAN bus."""
    from clfcbf.hardware.can_drives import CanDrives, open_bus
    from clfcbf.simulation.can_drives import CanPlant, SimulatedDrives

    witness = setting.body()
    channel = f"robot-{os.getpid()}-{next(_CHANNELS)}"
    drives = SimulatedDrives(channel, LEFT.node, RIGHT.node, now=lambda: witness.time)
    plant = CanPlant(witness, drives, LEFT, RIGHT, WHEELS)
    sensor = make_sensor(setting.sensor, plant, World(), setting.stream(2))
    bus = open_bus("virtual", channel)
    try:
        chassis = CanDrives(
            bus, LEFT, RIGHT, WHEELS, timing=can_timing(setting), quick_stop=setting.bounds
        )
    except BaseException:
        plant.close()
        raise
    robot = PlantInTheLoop(plant, sensor, _wall(setting))

    def close() -> None:
        try:
            chassis.close()
        finally:
            robot.close()

    return Rig(witness, robot, chassis, robot, robot, {"bus": bus, "drives": drives}, close)


VIAS: dict[str, Callable[[Setting], Rig]] = {"direct": _direct, "can": _can}
"""Ways of commands and measurements by name; another one is another entry."""


def make_rig(via: str, setting: Setting) -> Rig:
    """The robot of a run."""
    return VIAS[via](setting)
