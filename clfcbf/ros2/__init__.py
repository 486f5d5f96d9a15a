"""ROS 2: a docking node on the topics of Nav2, with rclpy or without any ROS through Cyclone DDS.

The same node runs on either transport. Adapters, conversions and parameters know of neither, see
:mod:`clfcbf.ros2.transport` for what they ask of one.
"""

from clfcbf.ros2.chassis import TopicChassis
from clfcbf.ros2.client import TaskClient
from clfcbf.ros2.dds import DdsTransport
from clfcbf.ros2.detection import DetectionFrame, Refusal
from clfcbf.ros2.node import DockingNode
from clfcbf.ros2.parameters import NodeSettings, settings_of
from clfcbf.ros2.rcl import RclTransport
from clfcbf.ros2.simulated import SimulatedRobot
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.tasks import Action, Goal
from clfcbf.ros2.transport import Quality, Transport, TransportError

__all__ = [
    "Action",
    "DdsTransport",
    "DetectionFrame",
    "DockingNode",
    "Goal",
    "NodeSettings",
    "Quality",
    "RclTransport",
    "Refusal",
    "SimulatedRobot",
    "TaskClient",
    "TopicChassis",
    "TopicTarget",
    "Transport",
    "TransportError",
    "settings_of",
]
