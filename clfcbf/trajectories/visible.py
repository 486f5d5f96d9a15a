r"""A closed-form path that keeps the viewed feature in sight and ends on its axis.

In polar coordinates about the feature the path's shape does not depend on speed:
:math:`d\delta/d\ln\rho = -\tan\varphi`. Prescribing :math:`m = \tan\varphi` over
:math:`\tau = \ln(\rho_0/\rho) \in [0, T]`, :math:`z = \tau/T`, as

.. math:: m(z) = (1 - z)^2 (m_0 + b z), \qquad b = -12\,\delta_0/T - 4 m_0

starts at the present bearing and ends at the standoff with bearing, line of sight and
curvature all zero. Position and heading follow without integration, from

.. math:: \delta(z) = -T (1-z)^3 \Big(\frac{m_0 + b}{3} - \frac{b\,(1-z)}{4}\Big)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clfcbf.camera import FieldOfView
from clfcbf.errors import GeometryError
from clfcbf.se2 import Pose2, is_finite
from clfcbf.trajectories.path import SampledPath
from clfcbf.unicycle import Polar

__all__ = ["MARGIN_SAMPLES", "PATH_SAMPLES", "VisiblePath", "view_margins", "visible_curvature"]

FloatArray = NDArray[np.float64]

PATH_SAMPLES = 200
"""Samples of a path: a bend of it is then 20 or more, so linear curvature is close."""

MARGIN_SAMPLES = 129
"""Samples in which the smallest margin is bracketed, before one refinement by 64."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


def _log_range(start: Polar, standoff: float) -> float:
    if not is_finite((*start, standoff)):
        raise GeometryError(f"feature and standoff must be finite, got {start!r}, {standoff!r}")
    if not 0.0 < standoff < start.rho:
        raise GeometryError(
            f"the standoff must be above 0 m and below the range {start.rho:.3f} m of the "
            f"feature, got {standoff!r}: back off first"
        )
    if not abs(start.phi) < 0.5 * math.pi:
        raise GeometryError(
            f"the feature must be ahead, |bearing| < 90 degrees, got "
            f"{math.degrees(start.phi):.1f}: turn first"
        )
    return math.log(start.rho / standoff)


def view_margins(
    rho: FloatArray, phi: FloatArray, delta: FloatArray, camera: FieldOfView
) -> FloatArray:
    """Angle from the feature to the nearer edge of the view [rad], at many polar states.

    With a width the ends of the feature count, and with none its centre.
    """
    x, y, theta = rho * np.cos(phi), rho * np.sin(phi), phi - delta
    cx, cy, yaw = camera.camera
    ends = (0.5 * camera.width, -0.5 * camera.width) if camera.width else (0.0,)
    bearings = np.array(
        [np.arctan2(y + s * np.cos(theta) - cy, x - s * np.sin(theta) - cx) for s in ends]
    )
    off_axis = np.abs(np.remainder(bearings - yaw + np.pi, 2.0 * np.pi) - np.pi)
    margins: FloatArray = camera.half_angle - off_axis.max(axis=0)
    return margins


def visible_curvature(start: Polar, standoff: float) -> float:
    r"""Curvature with which the path from the present state begins: the path as feedback.

    .. math::
        \kappa = \frac{m_0 - m'_0/(1 + m_0^2)}{\rho\sqrt{1 + m_0^2}}, \qquad
        m'_0 = \frac{b - 2 m_0}{T}

    Parameters
    ----------
    start : range, bearing and line of sight of the feature, about the robot's centre
    standoff : range of the feature at the goal [m]

    Returns
    -------
    :math:`\omega/v` [1/m], to be driven forward.

    Raises
    ------
    GeometryError : as :class:`VisiblePath`. Degenerate near it: with T to 0 the curvature grows
        as :math:`\delta/T^2`, so the last stretch belongs to a tracker of the axis
    """
    T = _log_range(start, standoff)
    m = math.tan(start.phi)
    slope = (-12.0 * start.delta / T - 6.0 * m) / T
    bent = 1.0 + m * m
    return (m - slope / bent) / (start.rho * math.sqrt(bent))


@dataclass(frozen=True, slots=True)
class VisiblePath:
    r"""The path from one view of the feature to the goal, a standoff in front of it.

    Attributes
    ----------
    start : the feature's polar coordinates about the robot's centre at the start; its heading
        is that of the goal
    standoff : :math:`d_f`, distance from goal to feature along that heading [m]

    Raises
    ------
    GeometryError : a value is not finite; the standoff is not between 0 and the range; or the
        feature is not ahead

    Notes
    -----
    The path always exists then; whether the feature stays in view along it is :meth:`margin`.
    """

    start: Polar
    standoff: float

    def __post_init__(self) -> None:
        _log_range(self.start, self.standoff)

    @property
    def log_range(self) -> float:
        r""":math:`T = \ln(\rho_0/d_f)`."""
        return math.log(self.start.rho / self.standoff)

    @property
    def shape(self) -> tuple[float, float]:
        r"""The shape parameters :math:`(m_0, b)`."""
        m0 = math.tan(self.start.phi)
        return m0, -12.0 * self.start.delta / self.log_range - 4.0 * m0

    @property
    def peak_bearing(self) -> float:
        r"""Largest absolute bearing about the robot's centre [rad], in closed form.

        :math:`\arctan\max(|m_0|, |m(z_e)|)` with :math:`z_e = (b - 2 m_0)/(3 b)` if in (0, 1).
        """
        m0, b = self.shape
        peak = abs(m0)
        if b and 0.0 < (z := (b - 2.0 * m0) / (3.0 * b)) < 1.0:
            peak = max(peak, abs((1.0 - z) ** 2 * (m0 + b * z)))
        return math.atan(peak)

    def _state(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Range, tangent of the bearing, its slope in tau, and line of sight."""
        (m0, b), T, u = self.shape, self.log_range, 1.0 - z
        rho = self.start.rho * np.exp(-T * z)
        slope = u * (b - 2.0 * m0 - 3.0 * b * z) / T
        delta = -T * u**3 * ((m0 + b) / 3.0 - 0.25 * b * u)
        return rho, u * u * (m0 + b * z), slope, delta

    def polar(self, z: float) -> Polar:
        """The feature's polar coordinates at the fraction ``z`` in [0, 1] of the log range."""
        rho, m, _, delta = self._state(np.array([z]))
        return Polar(float(rho[0]), math.atan(m[0]), float(delta[0]))

    def curvature(self, z: float) -> float:
        """Curvature [1/m] at the fraction ``z`` of the log range; 0 at the goal."""
        return float(self._curvature(np.array([z]))[0])

    def _curvature(self, z: FloatArray) -> FloatArray:
        rho, m, slope, _ = self._state(z)
        bent = 1.0 + m * m
        curvature: FloatArray = (m - slope / bent) / (rho * np.sqrt(bent))
        return curvature

    def pose(self, z: float) -> Pose2:
        """The robot's pose at ``z``, seen from its start."""
        return self.start.pose().compose(self.polar(z).pose().inverse())

    def margin(self, camera: FieldOfView) -> float:
        r"""Smallest angle between the feature and the nearer edge of the view along the path.

        Counts where the camera sits: about a camera :math:`c_x` ahead the tangent of the
        bearing is :math:`m/(1 - c_x\sqrt{1 + m^2}/\rho)`. With a ``width``, both ends of the
        feature count. Sampled and refined about the smallest sample.

        Returns
        -------
        Margin [rad]; the path keeps the feature in view where it is not negative.
        """
        z = np.linspace(0.0, 1.0, MARGIN_SAMPLES)
        worst = int(np.argmin(self._margins(z, camera)))
        lo, hi = z[max(worst - 1, 0)], z[min(worst + 1, MARGIN_SAMPLES - 1)]
        return float(np.min(self._margins(np.linspace(lo, hi, MARGIN_SAMPLES), camera)))

    def _margins(self, z: FloatArray, camera: FieldOfView) -> FloatArray:
        rho, m, _, delta = self._state(z)
        return view_margins(rho, np.arctan(m), delta, camera)

    def sampled(self, samples: int = PATH_SAMPLES) -> SampledPath:
        r"""The path by arc length, :math:`ds = \rho\sqrt{1 + m^2}\,d\tau`, seen from its start.

        Parameters
        ----------
        samples : number of samples, at equal steps of the log range, so finer near the goal

        Returns
        -------
        Path with exact poses and curvatures, arc length by five-point Gauss-Legendre.
        """
        z = np.linspace(0.0, 1.0, samples)
        step = z[1] - z[0]
        inner = z[:-1, None] + 0.5 * step * (1.0 + _NODES)
        rho, m, _, _ = self._state(inner)
        ds = 0.5 * step * self.log_range * (rho * np.sqrt(1.0 + m * m)) @ _WEIGHTS
        rho, m, _, delta = self._state(z)
        feature = self.start.pose()
        towards = feature.theta + delta
        poses = np.column_stack(
            (
                feature.x - rho * np.cos(towards),
                feature.y - rho * np.sin(towards),
                towards - np.arctan(m),
            )
        )
        s = np.concatenate(([0.0], np.cumsum(ds)))
        return SampledPath(s, self._curvature(z), poses)
