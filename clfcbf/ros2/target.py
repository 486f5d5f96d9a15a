"""A target sensor that listens to poses of the feature, and says what it ignored, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping

from clfcbf import defaults
from clfcbf.errors import ConfigurationError
from clfcbf.hardware.protocols import Clock
from clfcbf.ros2.detection import DetectionFrame, Refusal
from clfcbf.ros2.messages import PoseStamped
from clfcbf.ros2.stamps import MAX_AHEAD, Stamps
from clfcbf.ros2.transport import DETECTIONS, Quality, Transport
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2

__all__ = ["DETECTED", "TopicTarget"]

DETECTED = "detected_dock_pose"
"""Nav2's topic of what a detector has seen of the dock."""


class TopicTarget:
    """Takes ``geometry_msgs/msg/PoseStamped`` of the viewed feature.

    The goal is the standoff in front of it. What is ignored is counted by its reason; nothing is
    handed out twice, and nothing that is older than ``max_age``.

    Parameters
    ----------
    transport : that carries the messages
    clock, stamps : the loop's, and of that clock
    standoff : distance from the goal to the feature straight ahead of it [m]
    topic : absolute name
    frame : that poses come in
    max_age : of a pose [s]
    quality : of the subscription

    Raises
    ------
    ConfigurationError : the standoff is negative, or the age not positive
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        stamps: Stamps,
        standoff: float,
        topic: str = f"/{DETECTED}",
        *,
        frame: DetectionFrame | None = None,
        max_age: float = defaults.PATIENCE,
        quality: Quality = DETECTIONS,
    ) -> None:
        if not 0.0 <= standoff < math.inf:
            raise ConfigurationError(f"standoff must be finite and >= 0 m, got {standoff!r}")
        if not 0.0 < max_age < math.inf:
            raise ConfigurationError(f"max_age must be finite and positive [s], got {max_age!r}")
        self._subscription = transport.subscription(PoseStamped, topic, quality)
        self._clock = clock
        self._stamps = stamps
        self._goal = Pose2(-standoff, 0.0, 0.0)
        self._frame = frame if frame is not None else DetectionFrame()
        self._max_age = max_age
        self._counts = dict.fromkeys(Refusal, 0)
        self._accepted = 0
        self._latest = -math.inf
        self._complaint = ""

    @property
    def counts(self) -> Mapping[Refusal, int]:
        """Poses ignored, by the reason."""
        return dict(self._counts)

    @property
    def accepted(self) -> int:
        """Poses that passed."""
        return self._accepted

    @property
    def complaint(self) -> str:
        """What was wrong with the last pose that was ignored, with its values; empty if none."""
        return self._complaint

    @property
    def latest(self) -> float:
        """Stamp of the newest pose that passed, on the loop's clock [s]; -inf before the first."""
        return self._latest

    def sources(self) -> int:
        """Publishers of poses."""
        return self._subscription.sources()

    def observe(self) -> Observation | None:
        """The newest pose that passes and was not handed out, or None."""
        newest: Observation | None = None
        for message in self._subscription.take():
            found = self._judged(message)
            if isinstance(found, Observation):
                newest = found
                self._accepted += 1
                self._latest = found.stamp
            else:
                self._counts[found] += 1
        return newest

    def _judged(self, message: PoseStamped) -> Observation | Refusal:
        frame_id = message.header.frame_id
        if frame_id.removeprefix("/") != self._frame.name.removeprefix("/"):
            expected = f"frame_id {frame_id!r}, expected {self._frame.name!r}"
            return self._refused(Refusal.FRAME, expected)
        feature = self._frame.decode(message.pose)
        if isinstance(feature, Refusal):
            return self._refused(feature, f"{message.pose!r}")
        stamp = self._stamps.instant(message.header.stamp)
        if stamp is None:
            return self._refused(Refusal.CLOCK_SET, f"{message.header.stamp!r}")
        now = self._clock.now()
        age = now - stamp
        if age > self._max_age:
            return self._refused(Refusal.STALE, f"{age:.3f} s old")
        if age < -MAX_AHEAD:
            return self._refused(Refusal.AHEAD, f"{-age:.3f} s ahead")
        stamp = min(stamp, now)  # a little ahead counts as now
        if stamp <= self._latest:
            return self._refused(Refusal.REPEATED, f"{self._latest - stamp:.6f} s before another")
        return Observation(feature.compose(self._goal), feature, stamp)

    def _refused(self, refusal: Refusal, values: str) -> Refusal:
        self._complaint = f"{refusal.value}: {values}"
        return refusal
