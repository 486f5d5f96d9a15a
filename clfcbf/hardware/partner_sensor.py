"""The target as its own pose link tells it: another robot, or a dock that knows where it is.

Where the target says where it is and this robot knows where it is itself, both in one frame, no
camera is needed to see it. Only the link's silence then tells that the target's side has died.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.hardware.pose_link import PoseReceiver
from clfcbf.hardware.protocols import Clock
from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Pose2

__all__ = ["PartnerSensor", "SilentPartnerError"]

SILENCE = 0.5
"""[s] Without an accepted pose until the link counts as dead: as old as a pose may be at most."""


class SilentPartnerError(ClfcbfError):
    """The partner's poses stay away; the message says since when, and what came in their place."""


class PartnerSensor:
    r"""A target sensor out of a pose link.

    With the partner's pose :math:`P` and this robot's :math:`R` at the same time, the feature is
    seen at :math:`R^{-1}P` and the goal a standoff behind it, :math:`R^{-1}P\,(-d, 0, 0)`.

    Parameters
    ----------
    receiver : of the partner's poses: that of the feature, whose x is the direction of docking
    robot_pose : this robot's pose in the frame that both share, at a time of the loop's clock [s]
    clock : of the loop, on which the observations are stamped
    standoff : distance from the goal to the feature straight ahead of it [m]
    silence : without an accepted pose, until ``observe`` raises [s]; infinite if never
    covariance : of the goal seen from the robot, where it is known

    Raises
    ------
    ConfigurationError : the standoff is not finite or negative, or the silence not positive
    """

    def __init__(
        self,
        receiver: PoseReceiver,
        robot_pose: Callable[[float], Pose2],
        clock: Clock,
        standoff: float,
        *,
        silence: float = SILENCE,
        covariance: Covariance | None = None,
    ) -> None:
        if not 0.0 <= standoff < math.inf:
            raise ConfigurationError(f"standoff must be finite and at least 0 m, got {standoff!r}")
        if not silence > 0.0:
            raise ConfigurationError(f"silence must be positive [s], got {silence!r}")
        self._receiver = receiver
        self._robot_pose = robot_pose
        self._clock = clock
        self._offset = Pose2(-standoff, 0.0, 0.0)
        self._silence = silence
        self._covariance = covariance
        self._heard = clock.now()
        self._counts = receiver.counts

    def observe(self) -> Observation | None:
        """The partner's newest pose not yet handed out, as seen from here; None if there is none.

        Raises
        ------
        SilentPartnerError : there was none for longer than ``silence``
        """
        received = self._receiver.poll()
        now = self._clock.now()
        if received is None:
            if now - self._heard > self._silence:
                raise SilentPartnerError(self._told(now - self._heard))
            return None
        self._heard, self._counts = now, self._receiver.counts
        # Both clocks run alike; only their zeros differ. A stamp a little ahead counts as now.
        stamp = now - max(received.received - received.stamp, 0.0)
        feature = self._robot_pose(stamp).relative(received.pose)
        return Observation(feature.compose(self._offset), feature, stamp, self._covariance)

    def _told(self, silence: float) -> str:
        counts, partner = self._receiver.counts, self._receiver.partner
        ignored = ", ".join(
            f"{counts[kind] - before} {kind.value}"
            for kind, before in self._counts.items()
            if counts[kind] > before
        )
        text = f"no pose of partner {partner} for {silence:.2f} s"
        return f"{text}; ignored meanwhile: {ignored}" if ignored else text
