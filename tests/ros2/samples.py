"""One message of every kind that crosses the network, with values that are easily spoilt."""

from clfcbf.ros2.messages import (
    Clock,
    DiagnosticArray,
    DiagnosticStatus,
    Empty,
    Header,
    KeyValue,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    String,
    Time,
    Twist,
    TwistStamped,
    Vector3,
)
from clfcbf.ros2.transport import COMMANDS, DETECTIONS, EVENTS, LATCHED, LATEST

SAMPLES = [
    (TwistStamped(Header(Time(5, 6), "base_link"), Twist(Vector3(0.1), Vector3(z=-0.2))), COMMANDS),
    (Twist(Vector3(1e-300, -0.0, 3.0), Vector3(1.0, 2.0, 1e300)), LATEST),
    (
        PoseStamped(
            Header(Time(-3, 999_999_999), "kamera_ö"),
            Pose(Point(1.0, 2.0, 3.0), Quaternion(0.5, -0.5, 0.5, -0.5)),
        ),
        DETECTIONS,
    ),
    (
        DiagnosticArray(
            Header(Time(1, 2)),
            (
                DiagnosticStatus(2, "a", "b", "c", (KeyValue("k", "v"), KeyValue("é", "x" * 300))),
                DiagnosticStatus(),
            ),
        ),
        EVENTS,
    ),
    (DiagnosticArray(), EVENTS),
    (String('{"a": 1}'), LATCHED),
    (Empty(), EVENTS),
    (Clock(Time(7, 8)), EVENTS),
]
"""Each with the quality of its topic."""
