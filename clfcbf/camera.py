"""The camera's field of view: where it sits on the robot and how wide it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.se2 import Point, Pose2, is_finite

__all__ = ["FieldOfView"]

_AHEAD = Pose2(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class FieldOfView:
    r"""A camera that sees between two edges, ``half_angle`` to either side of its axis.

    Attributes
    ----------
    half_angle : half of the horizontal field of view :math:`\Phi` [rad], in (0, pi/2);
        the paper's :math:`\varphi_{fov}`, 35° for a camera of 70°
    camera : pose of the camera in the robot frame [m, m, rad]
    width : extent of the feature to be kept in view [m]; 0 keeps its centre

    Raises
    ------
    ConfigurationError : the half angle is outside (0, pi/2), which also catches degrees; the
        camera pose is not finite; the width is negative
    """

    half_angle: float
    camera: Pose2 = _AHEAD
    width: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.half_angle < 0.5 * math.pi:
            raise ConfigurationError(
                "half_angle must be in (0, pi/2) rad, half of the horizontal field of view, "
                f"got {self.half_angle!r}; for degrees use math.radians(...)"
            )
        if not is_finite(tuple(self.camera)):
            raise ConfigurationError(f"camera pose must be finite, got {self.camera!r}")
        if not (math.isfinite(self.width) and self.width >= 0.0):
            raise ConfigurationError(f"width must be finite and at least 0 m, got {self.width!r}")

    def eroded(self, margin: float, setback: float = 0.0) -> FieldOfView:
        r"""The points that stay in view when they are turned and displaced, again a view.

        A point turned about the camera by up to ``margin`` :math:`m` and then displaced by up to
        ``setback`` :math:`\delta` stays between the edges exactly if it lies between edges
        turned inward by the one and moved inward by the other: those of a camera that sits
        :math:`\delta / \sin(\Phi - m)` ahead and sees :math:`\Phi - m` to either side.

        Raises
        ------
        ConfigurationError : the margin is not in [0, half_angle), or the setback negative
        """
        if not 0.0 <= margin < self.half_angle:
            raise ConfigurationError(
                f"margin must be in [0, half_angle) = [0, {self.half_angle:.6g}) rad, "
                f"got {margin!r}"
            )
        if not 0.0 <= setback < math.inf:
            raise ConfigurationError(f"setback must be finite and at least 0 m, got {setback!r}")
        half_angle = self.half_angle - margin
        x, y, yaw = self.camera
        ahead = setback / math.sin(half_angle)
        eye = Pose2(x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), yaw)
        return FieldOfView(half_angle, eye, self.width)

    def bearing(self, point: Point) -> float:
        """Angle of ``point`` (robot frame) off the camera's axis, in (-pi, pi] [rad].

        Degenerate at the camera's own centre, where it is 0.
        """
        x, y = self.camera.seen(point)
        return math.atan2(y, x)

    def margin(self, point: Point) -> float:
        """Angle from ``point`` to the nearer edge [rad]; negative outside the view."""
        return self.half_angle - abs(self.bearing(point))

    def check_ahead(self, point: Point) -> None:
        """Raise ``GeometryError`` unless ``point`` is finite and in front of the camera."""
        if not is_finite((point[0], point[1])):
            raise GeometryError(f"feature must be finite, got ({point[0]!r}, {point[1]!r})")
        if abs(self.bearing(point)) >= 0.5 * math.pi:
            raise GeometryError(
                f"feature ({point[0]:.3f}, {point[1]:.3f}) m is behind the camera at "
                f"({self.camera.x:.3f}, {self.camera.y:.3f}) m; check its frame (x forward, y left)"
            )
