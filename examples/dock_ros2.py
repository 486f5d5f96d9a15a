"""Dock the MuJoCo robot through ROS 2 topics, and undock it; ROS itself is not needed.

    python examples/dock_ros2.py              # in real time (needs clfcbf[dds,sim])
    python examples/dock_ros2.py --simulated  # in step with the simulation's /clock

The robot is one participant on the network, the docking node another, and who gives the goals a
third. With ROS 2 installed, watch it from a second terminal: ``ros2 topic echo /cmd_vel``; for
your own robot leave the simulated one out. ``python -m clfcbf.ros2`` is the node alone.
"""

from __future__ import annotations

import os
import sys
import threading

import numpy as np

from clfcbf import Pose2, ros2
from clfcbf.config import parse_config, template
from clfcbf.simulation.mujoco_plant import MujocoPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.sensor import PoseSensor, SensorModel

FRAME = "camera_optical_frame"  # by REP-103: z forward, x right, y down


def dock(start: Pose2, simulated: bool, seed: int = 0) -> list[tuple[dict, Pose2]]:
    """Results of docking and undocking, and where the robot came to stand each time."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    config, rng = parse_config(template()), np.random.default_rng(seed)
    plant = MujocoPlant(start, config.limits, Body(), rng, standoff=config.standoff)
    sensor = PoseSensor(plant, config.camera, config.standoff, SensorModel.named("A"), rng)
    network, over = [ros2.DdsTransport() for _ in range(3)], threading.Event()
    frame = ros2.DetectionFrame(FRAME, config.camera.camera, optical=True)
    step = config.filter.period if simulated else None
    robot = ros2.SimulatedRobot(plant, sensor, network[0], frame=frame, step=step)
    given = {"detection_frame": FRAME, "use_sim_time": simulated}
    node = ros2.DockingNode(ros2.settings_of(config, given), network[1])
    threads = [threading.Thread(target=robot.run, args=(over,)), threading.Thread(target=node.run)]
    for thread in threads:
        thread.start()
    client = ros2.TaskClient(network[2])
    client.wait_for_node(10.0)
    results = [(client.perform(ros2.Goal(do), 90.0), robot.pose()) for do in ros2.Action]
    node.stop()
    over.set()
    for thread, part in zip(threads, (robot, node), strict=True):
        thread.join()
        part.close()
    for participant in network:
        participant.close()
    return results


if __name__ == "__main__":
    for result, pose in dock(Pose2(-1.5, 0.3, 0.0), "--simulated" in sys.argv[1:]):
        told = "ok" if result["success"] else result["error_name"]
        print(f"{result['action']}: {told}, {pose.x:.4f} m along, {pose.y:.4f} m across")
