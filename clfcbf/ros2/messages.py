"""The ROS 2 messages that the node speaks, as plain dataclasses without ROS.

Fields, their order and their wire types are those of the packages of the same names; a transport
turns them into what its middleware takes. A number is annotated with its type on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

__all__ = [
    "MESSAGES",
    "Clock",
    "DiagnosticArray",
    "DiagnosticStatus",
    "Empty",
    "Header",
    "KeyValue",
    "Message",
    "Point",
    "Pose",
    "PoseStamped",
    "Quaternion",
    "String",
    "Time",
    "Twist",
    "TwistStamped",
    "Vector3",
]

Int32 = Annotated[int, "int32"]
UInt32 = Annotated[int, "uint32"]
UInt8 = Annotated[int, "uint8"]
Octet = Annotated[int, "byte"]
Float64 = Annotated[float, "float64"]


class Message:
    """Any of them."""

    __slots__ = ()

    NAME: ClassVar[str]
    """Package and type, such as ``geometry_msgs/msg/TwistStamped``."""


@dataclass(frozen=True, slots=True)
class Time(Message):
    """An instant in ROS time: seconds and nanoseconds since the epoch."""

    NAME: ClassVar[str] = "builtin_interfaces/msg/Time"
    sec: Int32 = 0
    nanosec: UInt32 = 0

    @classmethod
    def of(cls, nanoseconds: int) -> Time:
        """From nanoseconds since the epoch."""
        return cls(*divmod(nanoseconds, 1_000_000_000))

    @property
    def nanoseconds(self) -> int:
        """Since the epoch."""
        return 1_000_000_000 * self.sec + self.nanosec


@dataclass(frozen=True, slots=True)
class Clock(Message):
    """The time of a simulation."""

    NAME: ClassVar[str] = "rosgraph_msgs/msg/Clock"
    clock: Time = field(default_factory=Time)


@dataclass(frozen=True, slots=True)
class Header(Message):
    """When, and in which frame."""

    NAME: ClassVar[str] = "std_msgs/msg/Header"
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class String(Message):
    """A text."""

    NAME: ClassVar[str] = "std_msgs/msg/String"
    data: str = ""


@dataclass(frozen=True, slots=True)
class Empty(Message):
    """Nothing but that it was sent; IDL needs a member all the same."""

    NAME: ClassVar[str] = "std_msgs/msg/Empty"
    structure_needs_at_least_one_member: UInt8 = 0


@dataclass(frozen=True, slots=True)
class Vector3(Message):
    """A direction with a length."""

    NAME: ClassVar[str] = "geometry_msgs/msg/Vector3"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass(frozen=True, slots=True)
class Twist(Message):
    """Linear [m/s] and angular [rad/s] velocity."""

    NAME: ClassVar[str] = "geometry_msgs/msg/Twist"
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass(frozen=True, slots=True)
class TwistStamped(Message):
    """The same with a time and a frame."""

    NAME: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass(frozen=True, slots=True)
class Point(Message):
    """A position [m]."""

    NAME: ClassVar[str] = "geometry_msgs/msg/Point"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass(frozen=True, slots=True)
class Quaternion(Message):
    """A rotation; the identity by default, as the package has it."""

    NAME: ClassVar[str] = "geometry_msgs/msg/Quaternion"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0
    w: Float64 = 1.0


@dataclass(frozen=True, slots=True)
class Pose(Message):
    """A position and a rotation."""

    NAME: ClassVar[str] = "geometry_msgs/msg/Pose"
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass(frozen=True, slots=True)
class PoseStamped(Message):
    """The same with a time and a frame."""

    NAME: ClassVar[str] = "geometry_msgs/msg/PoseStamped"
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass(frozen=True, slots=True)
class KeyValue(Message):
    """One thing that a diagnostic status tells."""

    NAME: ClassVar[str] = "diagnostic_msgs/msg/KeyValue"
    key: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True)
class DiagnosticStatus(Message):
    """How a part is doing: level 0 is ok, 1 a warning, 2 an error, 3 stale."""

    NAME: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticStatus"
    level: Octet = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: tuple[KeyValue, ...] = ()


@dataclass(frozen=True, slots=True)
class DiagnosticArray(Message):
    """How several parts are doing."""

    NAME: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"
    header: Header = field(default_factory=Header)
    status: tuple[DiagnosticStatus, ...] = ()


MESSAGES: tuple[type[Message], ...] = (
    Time, Clock, Header, String, Empty, Vector3, Twist, TwistStamped, Point, Quaternion, Pose,
    PoseStamped, KeyValue, DiagnosticStatus, DiagnosticArray,
)  # fmt: skip
"""All of them, each after those that it holds."""
