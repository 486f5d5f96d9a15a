r"""From a pose in space, in the frame of whoever measured it, to a pose on the floor.

A detector tells where the feature (a marker, a board) is in its own frame :math:`c`, with axes of
its own convention. In the base frame :math:`b`

.. math::
    p_b = t_{bc} + R_{bc}\,p_c, \qquad R_b = R_{bc}\,R_c\,R_e

with :math:`R_{bc}` the mounting, for an optical frame times its fixed rotation, and :math:`R_e`
the rotation from the detector's axes of the feature to those meant here: x into the feature, level,
where the robot is to face (Nav2's ``external_detection_rotation``). Height is dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from clfcbf.errors import ConfigurationError
from clfcbf.ros2.messages import Point, Pose, Quaternion
from clfcbf.ros2.rotations import OPTICAL, Rotation, from_rpy, inverse, product, rotated, yaw
from clfcbf.se2 import Pose2, is_finite

__all__ = ["DetectionFrame", "Refusal"]

UNIT = 1e-3
"""By which the norm of a quaternion may differ from 1: single precision or three typed digits,
but neither zeros nor angles in place of a quaternion."""

TILT = math.radians(30.0)
"""[rad] Of the feature's x axis out of the floor above which it is no dock that a robot on the
floor could face: the axes are of another convention than was declared."""

HERE = Pose2(0.0, 0.0, 0.0)
"""At the base's own place."""

_LEVEL = math.cos(TILT)
_FORWARD = (1.0, 0.0, 0.0)


class Refusal(Enum):
    """Why a pose was ignored."""

    NOT_FINITE = "not finite"
    """A number of it is none."""
    FRAME = "frame"
    """It is in another frame than the one expected."""
    QUATERNION = "quaternion"
    """Its rotation is none: the norm is not 1."""
    TILTED = "tilted"
    """Its x axis points out of the floor: another convention of axes than declared."""
    STALE = "stale"
    """It is too old."""
    AHEAD = "ahead"
    """Its stamp is in the future: the clocks differ."""
    REPEATED = "repeated"
    """Its stamp is no newer than that of one taken before."""
    CLOCK_SET = "clock set"
    """Between its stamp and now somebody set the time."""


@dataclass(frozen=True, slots=True)
class DetectionFrame:
    """The frame that poses of the feature come in, and how it sits on the robot.

    Attributes
    ----------
    name : ``frame_id`` that poses have to carry
    mount : pose of the frame on the robot, of an optical one that of its body frame
    roll, pitch : of it [rad], about fixed axes before the mount's theta; a camera that looks down
        has a positive pitch
    optical : z forward, x right, y down, as images have it, and not x forward, y left, z up
    rotation : roll, pitch and yaw from the detector's axes of the feature to those meant here [rad]

    Raises
    ------
    ConfigurationError : a value is not finite, or the name is empty
    """

    name: str = "base_link"
    mount: Pose2 = HERE
    roll: float = 0.0
    pitch: float = 0.0
    optical: bool = False
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.name:
            raise ConfigurationError("the frame of detections must have a name, got ''")
        for name in ("mount", "rotation"):
            if not is_finite(tuple(getattr(self, name))):
                raise ConfigurationError(f"{name} must be finite, got {getattr(self, name)!r}")
        if not is_finite((self.roll, self.pitch)):
            raise ConfigurationError(
                f"roll and pitch must be finite [rad], got {self.roll!r}, {self.pitch!r}"
            )

    @property
    def _mounting(self) -> Rotation:
        body = from_rpy(self.roll, self.pitch, self.mount.theta)
        return product(body, OPTICAL) if self.optical else body

    def decode(self, pose: Pose) -> Pose2 | Refusal:
        """The feature's pose in the robot frame, or why there is none."""
        p, q = pose.position, pose.orientation
        position, given = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
        if not is_finite(position + given):
            return Refusal.NOT_FINITE
        norm = math.hypot(*given)
        if abs(norm - 1.0) > UNIT:
            return Refusal.QUATERNION
        unit = (q.x / norm, q.y / norm, q.z / norm, q.w / norm)
        mounting = self._mounting
        turned = product(product(mounting, unit), from_rpy(*self.rotation))
        ahead = rotated(turned, _FORWARD)
        if math.hypot(ahead[0], ahead[1]) < _LEVEL:
            return Refusal.TILTED
        x, y, _ = rotated(mounting, position)
        return Pose2(self.mount.x + x, self.mount.y + y, yaw(turned))

    def encode(self, feature: Pose2) -> Pose:
        """The pose that a detector in this frame would tell, of a feature at the frame's height."""
        back = inverse(self._mounting)
        offset = (feature.x - self.mount.x, feature.y - self.mount.y, 0.0)
        turned = product(back, from_rpy(0.0, 0.0, feature.theta))
        return Pose(
            Point(*rotated(back, offset)),
            Quaternion(*product(turned, inverse(from_rpy(*self.rotation)))),
        )
