"""A safety filter around somebody else's velocity commands, such as a ROS ``cmd_vel``.

    python examples/filter_cmd_vel.py

Here the commands come from a joystick that is pushed hard to one side: the filter lets it turn
as far as the camera keeps the board in view. After 2 s the joystick falls silent, and the robot
stands. With ROS 2, ``safe.command`` is what the subscription's callback calls, from any thread:

    node.create_subscription(TwistStamped, "cmd_vel", lambda m: safe.command(
        Twist(m.twist.linear.x, m.twist.angular.z), clock.now()), 1)
"""

from __future__ import annotations

import math

import numpy as np

from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Twist
from clfcbf.runtime import CommandFilter, ControlLoop, PlantInTheLoop, Tick
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.sensor import PoseSensor, SensorModel

PERIOD = 1.0 / 30.0
WANTED = Twist(0.2, 0.4)


def main() -> list[Tick]:
    """Four seconds of it; prints what was wanted, sent and left of the view twice a second."""
    limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
    camera = FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
    rng = np.random.default_rng(0)
    plant = KinematicPlant(Pose2(-2.0, 0.0, 0.0), limits, Body(), rng)
    model = SensorModel(outlier=0.0)  # the filter believes what it is told: reject them before
    robot = PlantInTheLoop(plant, PoseSensor(plant, camera, 0.6, model, rng))
    safe = CommandFilter(SafetyFilter(limits, [camera], PERIOD, lag=Body().lag), timeout=0.2)
    ticks: list[Tick] = []

    def joystick(tick: Tick) -> None:
        ticks.append(tick)
        if tick.sent < 2.0:
            safe.command(WANTED, tick.sent)
        if tick.number % 15 == 0:
            left = math.degrees(camera.margin(plant.pose().seen((0.6, 0.0))))
            v, omega = tick.command
            print(f"{tick.sent:4.1f} s  sent {v:5.2f} m/s {omega:5.2f} rad/s, {left:4.1f}° left")

    ControlLoop(safe, robot, robot, robot, period=PERIOD, limits=limits, on_tick=joystick).run(
        duration=4.0
    )
    return ticks


if __name__ == "__main__":
    main()
