"""Dock a simulated robot through the control loop, in real time or as fast as the machine can.

    python examples/dock_mujoco.py              # in real time, with MuJoCo (clfcbf[sim])
    python examples/dock_mujoco.py --simulated  # the same on a simulated clock, in a second

For a robot of your own, put its adapters where ``robot`` stands, as chassis, sensor and clock.
Ctrl-C brakes it and then ends the program.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from clfcbf import DockingController, Pose2
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.runtime import ControlLoop, LoopReport, PlantInTheLoop
from clfcbf.simulation.mujoco_plant import MujocoPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel


def dock(start: Pose2, simulated: bool, seed: int = 0) -> tuple[LoopReport, Pose2]:
    """How the run went, and where the robot came to stand, in the goal's frame."""
    world, limits, body = World(), LIMITS["approaching"], Body()
    rng = np.random.default_rng(seed)
    plant = MujocoPlant(start, limits, body, rng, standoff=world.standoff)
    sensor = PoseSensor(plant, world.camera, world.standoff, SensorModel.named("A"), rng)
    robot = PlantInTheLoop(plant, sensor, None if simulated else MonotonicClock())
    controller = DockingController(limits, world.camera, world.standoff, world.period, lag=body.lag)
    loop = ControlLoop(controller, robot, robot, robot, period=world.period, limits=limits)
    report = loop.run(duration=60.0)
    robot.sleep_until(robot.now() + 0.5)
    return report, plant.pose()


def main(arguments: list[str] | None = None) -> None:
    """Run it and print how it went."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--simulated", action="store_true", help="do not wait for the time to pass")
    report, pose = dock(Pose2(-1.5, 0.3, 0.0), parser.parse_args(arguments).simulated)
    ran, degrees = report.statistics, math.degrees(pose.theta)
    period, latency = ran.period, ran.latency
    off = f"{1e3 * pose.x:.1f} mm along, {1e3 * pose.y:.1f} mm across, {degrees:.2f}°"
    print(f"{report.ending.value}: {off}, {ran.ticks} ticks, {ran.missed} missed")
    print(f"period  {1e3 * period.p50:.2f} ms, worst {1e3 * period.worst:.2f} ms")
    print(f"latency {1e3 * latency.p50:.0f} ms, worst {1e3 * latency.worst:.0f} ms")


if __name__ == "__main__":
    main()
