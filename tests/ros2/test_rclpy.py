"""Against real rclpy, in the interpreter that CLFCBF_ROS_PYTHON names; both ways, both transports.

A sourced ROS 2, or a virtual environment with the unofficial wheels: ros-rclpy,
ros-rmw-fastrtps-cpp, ros-rosgraph-msgs, ros-geometry-msgs, ros-std-msgs, ros-diagnostic-msgs; and
numpy, daqp, qpsolvers, mcap and zstandard for the node.
"""

from __future__ import annotations

import json
import threading
import time

import pytest

from clfcbf.config import parse_config, template
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.ros2.chassis import TopicChassis
from clfcbf.ros2.client import TaskClient
from clfcbf.ros2.node import DockingNode
from clfcbf.ros2.parameters import settings_of
from clfcbf.ros2.stamps import Stamps
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.tasks import Action, Goal
from clfcbf.ros2.transport import LOCALHOST
from clfcbf.se2 import Twist
from tests.ros2.network import DOMAIN, ROS_PYTHON, peer, sent_and_returned, wait_for

pytest.importorskip("cyclonedds", reason="needs the extra dds")

from clfcbf.ros2.dds import DdsTransport

pytestmark = pytest.mark.skipif(
    not ROS_PYTHON, reason="CLFCBF_ROS_PYTHON names no interpreter that has rclpy"
)


@pytest.fixture
def transport(monkeypatch):
    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    made = DdsTransport(DOMAIN)
    yield made
    made.close()


def test_every_message_to_rclpy_and_back(transport):
    with peer("rclpy", "echo"):
        for sent, back in sent_and_returned(transport):
            assert back == sent


def test_a_plain_rclpy_node_is_driven_and_seen(transport):
    clock = MonotonicClock()
    stamps = Stamps(clock)
    chassis = TopicChassis(transport, clock, stamps)
    target = TopicTarget(transport, clock, stamps, 0.6)
    with peer("rclpy", "base") as base:
        wait_for(lambda: chassis.listeners() and target.sources())
        begun = time.time_ns()
        seen = wait_for(target.observe)
        for v in (0.1, 0.2, 0.3):
            chassis.send(Twist(v, -v))
            time.sleep(0.05)
        chassis.close()
    assert seen.feature[:2] == pytest.approx((1.5, 0.25))
    assert 0.0 <= clock.now() - seen.stamp < 30.0
    assert not any(target.counts.values()), target.complaint
    lines = [line.split() for line in base.told.splitlines()]
    assert [(float(v), float(w)) for v, w, *_ in lines] == [
        (0.1, -0.1), (0.2, -0.2), (0.3, -0.3), (0.0, 0.0),
    ]  # fmt: skip
    assert {frame for *_, frame, _ in lines} == {"base_link"}
    assert all(begun <= int(stamp) <= time.time_ns() for *_, stamp in lines)


def test_a_robot_of_rclpy_is_docked_by_a_node_of_cyclone(transport):
    given = {"detection_frame": "camera_optical_frame", "use_sim_time": True}
    node = DockingNode(settings_of(parse_config(template()), given), transport)
    thread = threading.Thread(target=node.run)
    thread.start()
    other = DdsTransport(DOMAIN)
    client = TaskClient(other)
    try:
        with peer("rclpy", "robot"):
            client.wait_for_node(10.0)
            wait_for(lambda: node.chassis.listeners() and node.target.sources())
            docked = client.perform(Goal(Action.DOCK), 40.0)
            undocked = client.perform(Goal(Action.UNDOCK), 40.0)
    finally:
        node.stop()
        thread.join()
        node.close()
        other.close()
    assert docked["success"], docked
    assert undocked["success"], undocked


def test_a_robot_of_cyclone_is_docked_by_a_node_of_rclpy(tmp_path, monkeypatch):
    """The node from its command line, with ROS's own parameters and signals."""
    pytest.importorskip("mcap", reason="needs the extra record")
    from benchmarks.ros2_docking import Run, perform

    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    found = perform(Run(plant="kinematic", rclpy=ROS_PYTHON, domain=DOMAIN), tmp_path)
    assert found["success"], json.dumps(found)
    assert found["node_exit_status"] == 0
    assert found["reproduced"]
