"""Dock a robot whose wheels are turned by two CiA-402 drives on a CAN bus, both simulated.

    python examples/dock_can.py              # in real time (needs clfcbf[can])
    python examples/dock_can.py --simulated  # as fast as the machine can

With real drives: ``open_bus("socketcan", "can0")``, their node numbers and units, and a sensor
of your own. The frames on the bus are the same.
"""

from __future__ import annotations

import math
import sys

import numpy as np

from clfcbf import DockingController, Pose2
from clfcbf.hardware.can_drives import CanDrives, CanTiming, WheelDrive, open_bus
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.runtime import ControlLoop, LoopReport, PlantInTheLoop
from clfcbf.simulation.can_drives import CanPlant, SimulatedDrives
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from clfcbf.wheels import WheelLimits

LEFT, RIGHT = WheelDrive(1, 1e4), WheelDrive(2, -1e4)  # 0.1 mrad/s; the right motor is mirrored
WHEELS = WheelLimits(track=0.4, radius=0.08, speed=0.5, acceleration=2.0)


def dock(start: Pose2, simulated: bool, seed: int = 0) -> tuple[LoopReport, Pose2]:
    """How the run went, and where the robot came to stand, in the goal's frame."""
    world, limits, body = World(), LIMITS["approaching"], Body()
    rng = np.random.default_rng(seed)
    base = KinematicPlant(start, limits, body, rng)
    drives = SimulatedDrives("dock_can", LEFT.node, RIGHT.node, now=lambda: base.time)
    plant = CanPlant(base, drives, LEFT, RIGHT, WHEELS)
    sensor = PoseSensor(plant, world.camera, world.standoff, SensorModel.named("A"), rng)
    robot = PlantInTheLoop(plant, sensor, None if simulated else MonotonicClock())
    timing = CanTiming(timeout=2.0, silence=2.0) if simulated else CanTiming()
    bus = open_bus("virtual", "dock_can")
    chassis = CanDrives(bus, LEFT, RIGHT, WHEELS, timing=timing, quick_stop=limits)
    controller = DockingController(limits, world.camera, world.standoff, world.period, lag=body.lag)
    loop = ControlLoop(controller, chassis, robot, robot, period=world.period, limits=limits)
    try:
        report = loop.run(duration=60.0)
        robot.sleep_until(robot.now() + 0.5)
        return report, plant.pose()
    finally:
        chassis.close()
        robot.close()


if __name__ == "__main__":
    report, pose = dock(Pose2(-1.5, 0.3, 0.0), "--simulated" in sys.argv[1:])
    off = f"{1e3 * pose.x:.1f} mm along, {1e3 * pose.y:.1f} mm across"
    print(f"{report.ending.value}: {off}, {math.degrees(pose.theta):.2f}°")
