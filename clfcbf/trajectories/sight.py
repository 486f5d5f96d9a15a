"""Where a plan sees the feature: its bearing from poses in the goal's frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.camera import FieldOfView
from clfcbf.se2 import Pose2

__all__ = ["TOLERANCE", "Sight"]

Array = NDArray[np.float64]

TOLERANCE = 1e-3
"""[rad] Rounding and interpolation in a bearing: a tenth of what a plan has to spare."""


class Sight(NamedTuple):
    """The view that a plan may use, and the feature ``standoff`` [m] straight ahead of the goal."""

    edge: FieldOfView
    standoff: float

    def bearing(self, pose: Pose2) -> float:
        """Bearing off the camera's axis [rad]."""
        return self.edge.bearing(pose.seen((self.standoff, 0.0)))

    def bearings(self, x: Array, y: Array, theta: Array) -> Array:
        """Bearing from many poses [rad]."""
        cx, cy, yaw = self.edge.camera
        eye_x = x + cx * np.cos(theta) - cy * np.sin(theta)
        eye_y = y + cx * np.sin(theta) + cy * np.cos(theta)
        bearing = np.arctan2(-eye_y, self.standoff - eye_x) - theta - yaw
        wrapped: Array = np.mod(bearing + np.pi, 2.0 * np.pi) - np.pi
        return wrapped

    def widest(self, start: Pose2) -> float:
        """Bearing up to which a motion from ``start`` may go: the edge's, or that at the start."""
        return max(self.edge.half_angle, abs(self.bearing(start))) + TOLERANCE
