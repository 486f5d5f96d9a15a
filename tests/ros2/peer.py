"""The other end of a test, in a process of its own: ``peer.py dds|rclpy DOMAIN echo|robot|base``.

``echo`` sends back every message that it gets, on the topic's twin; ``robot`` is a simulated one;
``base`` is a node of plain rclpy, without anything of clfcbf, that counts what it gets.
"""

from __future__ import annotations

import sys
import threading
import time

END = 60.0  # [s] that nobody is left behind for


def transport_of(kind, domain):
    if kind == "rclpy":
        from clfcbf.ros2 import RclTransport

        return RclTransport("peer", domain=domain)
    from clfcbf.ros2 import DdsTransport

    return DdsTransport(domain)


def wait_for_end(work):
    """Work until the other side closes our standard input."""
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    end = time.monotonic() + END
    while not over.is_set() and time.monotonic() < end:
        work()


def echo(transport):
    from tests.ros2.samples import SAMPLES

    ends = [
        (
            transport.subscription(type(message), f"/there{i}", quality),
            transport.publisher(type(message), f"/back{i}", quality),
        )
        for i, (message, quality) in enumerate(SAMPLES)
    ]

    def work():
        for subscription, publisher in ends:
            for message in subscription.take():
                publisher.publish(message)
        time.sleep(0.0005)

    wait_for_end(work)


def robot(transport):
    import numpy as np

    from clfcbf.config import parse_config, template
    from clfcbf.ros2 import DetectionFrame, SimulatedRobot
    from clfcbf.se2 import Pose2
    from clfcbf.simulation.kinematic import KinematicPlant
    from clfcbf.simulation.plant import Body
    from clfcbf.simulation.sensor import PoseSensor, SensorModel

    config, rng = parse_config(template()), np.random.default_rng(0)
    plant = KinematicPlant(Pose2(-1.2, 0.1, 0.0), config.limits, Body(), rng)
    sensor = PoseSensor(plant, config.camera, config.standoff, SensorModel.named("A"), rng)
    frame = DetectionFrame("camera_optical_frame", config.camera.camera, optical=True)
    made = SimulatedRobot(plant, sensor, transport, frame=frame, step=config.filter.period)
    wait_for_end(made.step)


def base(domain):
    import rclpy
    from geometry_msgs.msg import PoseStamped, TwistStamped

    rclpy.init(domain_id=domain)
    node = rclpy.create_node("base")
    got = []
    node.create_subscription(TwistStamped, "cmd_vel", got.append, 10)
    publisher = node.create_publisher(PoseStamped, "detected_dock_pose", 10)

    def work():
        rclpy.spin_once(node, timeout_sec=0.02)
        pose = PoseStamped()
        pose.header.stamp = node.get_clock().now().to_msg()
        pose.header.frame_id = "base_link"
        pose.pose.position.x, pose.pose.position.y = 1.5, 0.25
        publisher.publish(pose)

    wait_for_end(work)
    for message in got:
        stamp = message.header.stamp
        print(
            message.twist.linear.x, message.twist.angular.z, message.header.frame_id,
            1_000_000_000 * stamp.sec + stamp.nanosec, flush=True,
        )  # fmt: skip
    rclpy.shutdown()


def main(kind, domain, role):
    if role == "base":
        base(int(domain))
        return
    transport = transport_of(kind, int(domain))
    {"echo": echo, "robot": robot}[role](transport)
    transport.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
