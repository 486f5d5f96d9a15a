r"""What the field of view allows: its edge in range and bearing, and the leg in reverse.

Along any motion :math:`d\delta/d\ln\rho = -\tan\varphi`, whatever the speed. The edges of the
view bound :math:`\varphi`, so they bound how far the line of sight can turn between two
ranges; at a constant bearing the path is a logarithmic spiral ([Bhattacharya2007]_,
[Salaris2010]_).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.errors import GeometryError, PlanningError
from clfcbf.se2 import is_finite
from clfcbf.trajectories.path import SampledPath
from clfcbf.trajectories.visible import PATH_SAMPLES, VisiblePath, view_margins
from clfcbf.unicycle import Polar

__all__ = ["BACK_OFF_STEP", "ReverseLeg", "edge_bearings", "forward_limit", "visible_after_turn"]

BACK_OFF_STEP = 0.02
"""Step in which a leg in reverse is lengthened [m]: a fraction of the shortest useful leg."""

BEARING_SAMPLES = 41
"""Bearings tried for a turn in place: 1.75 degrees apart over a view of 70 degrees."""


def edge_bearings(rho: float, camera: FieldOfView) -> tuple[float, float]:
    r"""Bearings about the robot's centre at which a point of range ``rho`` meets the edges.

    An edge of direction :math:`a` through the camera centre c has the distance
    :math:`d = c_x\sin a - c_y\cos a` from the robot's centre, and there
    :math:`\varphi = a - \arcsin(d/\rho)`.

    Parameters
    ----------
    rho : range of the point from the robot's centre [m], beyond the camera
    camera : position, yaw and half angle

    Returns
    -------
    (right, left) [rad], right below left. A camera ahead of the centre sees a larger bearing
    than the centre does, so both lie inside the camera's own half angle.

    Raises
    ------
    GeometryError : the range is not larger than the camera's distance from the centre
    """
    cx, cy, yaw = camera.camera
    if not (math.isfinite(rho) and rho > math.hypot(cx, cy)):
        raise GeometryError(
            f"range must be finite and beyond the camera at {math.hypot(cx, cy):.3f} m, got {rho!r}"
        )
    right, left = (
        a - math.asin((cx * math.sin(a) - cy * math.cos(a)) / rho)
        for a in (yaw - camera.half_angle, yaw + camera.half_angle)
    )
    return right, left


def forward_limit(rho: float, standoff: float, camera: FieldOfView) -> tuple[float, float]:
    r"""Lines of sight from which driving forward alone can reach the axis in view.

    .. math::
        L = \int_{d_f}^{\rho_0} \tan\varphi_e(\rho)\, d\ln\rho
          = \tan a\,\ln\frac{\rho_0\cos\varphi_e(\rho_0)}{d_f\cos\varphi_e(d_f)}
            - \big(\varphi_e(\rho_0) - \varphi_e(d_f)\big)

    with :math:`\varphi_e` the bearing of an edge of direction a (:func:`edge_bearings`). For a
    camera at the robot's centre that is :math:`\tan\Phi\,\ln(\rho_0/d_f)`.

    Parameters
    ----------
    rho : present range of the feature's centre [m]
    standoff : its range at the goal [m], beyond the camera
    camera : the centre of the feature counts, not its width

    Returns
    -------
    (lowest, highest) :math:`\delta_0` [rad]. Necessary to arrive with :math:`\delta = 0`, and
    sharp: the extreme path rides the edge.

    Raises
    ------
    GeometryError : the standoff is above the range, or not beyond the camera
    """
    if not standoff <= rho:
        raise GeometryError(f"the standoff {standoff!r} m must not exceed the range {rho!r} m")
    yaw, half = camera.camera.theta, camera.half_angle
    right, left = (
        math.tan(a) * math.log(rho * math.cos(far) / (standoff * math.cos(near))) - (far - near)
        for a, far, near in zip(
            (yaw - half, yaw + half),
            edge_bearings(rho, camera),
            edge_bearings(standoff, camera),
            strict=True,
        )
    )
    return -left, -right


def visible_after_turn(
    start: Polar, standoff: float, camera: FieldOfView, margin: float = 0.0
) -> VisiblePath | None:
    """The visible path after the smallest turn in place that makes it one.

    A turn in place changes the bearing alone; in view before and after, it is in view
    throughout.

    Parameters
    ----------
    start : the feature about the robot's centre, before the turn
    standoff : distance from goal to feature [m]
    camera : view to be kept
    margin : angle to its edges to be kept [rad]

    Returns
    -------
    The path, whose ``start.phi`` is the bearing to turn to (the present one if that does), or
    None if no bearing gives one.
    """
    right, left = edge_bearings(start.rho, camera)
    bearings = [start.phi, *np.linspace(right, left, BEARING_SAMPLES)]
    for phi in sorted(bearings, key=lambda phi: abs(phi - start.phi)):
        path = VisiblePath(start._replace(phi=float(phi)), standoff)
        if path.margin(camera) >= margin:
            return path
    return None


@dataclass(frozen=True, slots=True)
class ReverseLeg:
    r"""A leg in reverse along a logarithmic spiral, which turns the line of sight home.

    With the bearing held, :math:`\delta(\rho) = \delta_0 - \tan\varphi\,\ln(\rho/\rho_0)` and
    :math:`\omega = (v/\rho)\sin\varphi`.

    Attributes
    ----------
    start : the feature about the robot's centre as the leg begins, at the bearing to be held
    rho_end : range at its end [m]

    Raises
    ------
    GeometryError : a value is not finite, the end is not beyond the start, or the feature is
        not ahead
    """

    start: Polar
    rho_end: float

    def __post_init__(self) -> None:
        rho, phi, _ = self.start
        if not (is_finite((*self.start, self.rho_end)) and 0.0 < rho < self.rho_end):
            raise GeometryError(
                f"a leg in reverse ends farther out than it starts, got {rho!r} to {self.rho_end!r}"
            )
        if not abs(phi) < 0.5 * math.pi:
            raise GeometryError(f"the feature must be ahead, got bearing {phi!r} rad")

    @classmethod
    def shortest(
        cls,
        state: Polar,
        standoff: float,
        camera: FieldOfView,
        margin: float,
        rho_max: float,
    ) -> ReverseLeg:
        r"""The shortest leg after which a visible path exists, a turn in place allowed.

        The bearing held is the one that brings :math:`\delta` to 0 at the end of the leg,
        :math:`\tan\varphi = \delta_0/\ln(\rho_1/\rho_0)`, or the edge with ``margin`` to
        spare where that one is out of view.

        Parameters
        ----------
        state : the feature now; the turn to the leg's bearing comes first
        standoff : distance from goal to feature [m]
        camera : view to be kept
        margin : angle to its edges to be kept [rad], below the half angle
        rho_max : farthest range allowed [m]

        Raises
        ------
        PlanningError : no range up to ``rho_max`` makes a visible path
        GeometryError : the margin is not below the half angle, or the camera is beyond the
            feature
        """
        if not 0.0 <= margin < camera.half_angle:
            raise GeometryError(
                f"margin must be in [0, {camera.half_angle:.3f}) rad, below the half angle, "
                f"got {margin!r}"
            )
        narrowed = FieldOfView(camera.half_angle - margin, camera.camera)
        right, left = edge_bearings(state.rho, narrowed)
        nearest = max(state.rho, standoff)
        steps = math.floor((rho_max - nearest) / BACK_OFF_STEP)
        for k in range(1, steps + 1):
            rho = nearest + k * BACK_OFF_STEP
            homing = math.atan(state.delta / math.log(rho / state.rho))
            leg = cls(state._replace(phi=min(max(homing, right), left)), rho)
            # An edge bearing has the margin to rounding only.
            in_view = leg.margin(camera) >= margin - 1e-9
            if in_view and visible_after_turn(leg.end, standoff, camera, margin) is not None:
                return leg
        raise PlanningError(
            f"no leg in reverse from {state.rho:.3f} m to at most {rho_max:.3f} m brings "
            f"the line of sight of {math.degrees(state.delta):.1f} degrees into reach",
            {"field of view": max(steps, 0)},
        )

    @property
    def end(self) -> Polar:
        """The feature about the robot's centre as the leg ends."""
        return self._at(self.rho_end)

    @property
    def length(self) -> float:
        r"""Arc length [m], :math:`(\rho_1 - \rho_0)/\cos\varphi`."""
        return (self.rho_end - self.start.rho) / math.cos(self.start.phi)

    def margin(self, camera: FieldOfView) -> float:
        """Smallest angle between the feature and the nearer edge along the leg [rad], sampled.

        A camera ahead of the robot's centre has it at the start, sampled exactly.
        """
        rho = np.linspace(self.start.rho, self.rho_end, PATH_SAMPLES)
        delta = self.start.delta - math.tan(self.start.phi) * np.log(rho / self.start.rho)
        phi = np.full_like(rho, self.start.phi)
        return float(np.min(view_margins(rho, phi, delta, camera)))

    def _at(self, rho: float) -> Polar:
        rho0, phi, delta = self.start
        return Polar(rho, phi, delta - math.tan(phi) * math.log(rho / rho0))

    def sampled(self, samples: int = PATH_SAMPLES) -> SampledPath:
        """The leg by arc length, gear -1, seen from its start."""
        feature, phi = self.start.pose(), self.start.phi
        rho = np.linspace(self.start.rho, self.rho_end, samples)
        delta = self.start.delta - math.tan(phi) * np.log(rho / self.start.rho)
        towards = feature.theta + delta
        poses = np.column_stack(
            (
                feature.x - rho * np.cos(towards),
                feature.y - rho * np.sin(towards),
                towards - phi,
            )
        )
        s = (rho - rho[0]) / math.cos(phi)
        return SampledPath(s, -math.sin(phi) / rho, poses, gear=-1)
