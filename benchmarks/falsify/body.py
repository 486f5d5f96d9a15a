"""A body that lags behind its commands, and a feature at rest as it is seen from there."""

from __future__ import annotations

import math

from clfcbf.camera import FieldOfView
from clfcbf.se2 import Point, Twist
from clfcbf.simulation.drive import follow

__all__ = ["SUBSAMPLES", "LaggingBody"]

SUBSAMPLES = 20
"""Instants of a tick at which the view is judged, 1.7 ms apart: under 0.05° of turning."""


class LaggingBody:
    r"""First-order lag, :math:`\tau\dot b = u - b`, and where the feature is in the robot frame.

    Each sub-sample is the exact arc of the mean twist over it. Where the chassis' own
    acceleration limits hold it back, the lag is that of :func:`clfcbf.simulation.drive.follow`.

    Parameters
    ----------
    lag : :math:`\tau` [s], positive
    slopes : largest accelerations of the body [m/s², rad/s²], infinite for none
    period : of a tick [s]
    camera : whose true edges the feature is judged against
    point : the feature in the robot frame [m]

    Attributes
    ----------
    twist : of the body now
    seen : the feature in the robot frame at every sub-sample since the start, ``step`` apart
    """

    __slots__ = (
        "_axis", "_decay", "_half_angle", "_lag", "_share", "_slopes", "seen", "step",
        "twist",
    )  # fmt: skip

    def __init__(
        self, lag: float, slopes: tuple[float, float], period: float, camera: FieldOfView,
        point: Point,
    ) -> None:  # fmt: skip
        self.step = period / SUBSAMPLES
        self._lag, self._slopes = lag, slopes
        self._decay = math.exp(-self.step / lag)
        self._share = lag * (1.0 - self._decay) / self.step
        x, y, yaw = camera.camera
        self._axis = x, y, yaw
        self._half_angle = camera.half_angle
        self.twist = Twist(0.0, 0.0)
        self.seen = [point]

    def follow(self, v: float, omega: float) -> tuple[float, int]:
        """Follow a twist for one tick; the smallest margin and the sub-samples out of view."""
        e_v, e_w = self.twist[0] - v, self.twist[1] - omega
        slope_v, slope_w = self._slopes
        held_back = abs(e_v) > slope_v * self._lag or abs(e_w) > slope_w * self._lag
        means = self._slow(v, omega) if held_back else self._lagging(v, omega, e_v, e_w)
        x, y = self.seen[-1]
        c_x, c_y, yaw = self._axis
        step, append = self.step, self.seen.append
        sin, cos, atan2 = math.sin, math.cos, math.atan2
        widest, outside, half_angle = 0.0, 0, self._half_angle
        for m_v, m_w in means:
            half = 0.5 * m_w * step
            s, c = sin(half), cos(half)
            chord = m_v * step * (s / half if half else 1.0)
            x -= chord * c
            y -= chord * s
            c, s = c * c - s * s, 2.0 * s * c
            x, y = c * x + s * y, c * y - s * x
            append((x, y))
            bearing = abs(atan2(y - c_y, x - c_x) - yaw)
            if bearing > widest:
                widest = bearing
            if bearing > half_angle:
                outside += 1
        return half_angle - widest, outside

    def _lagging(self, v: float, omega: float, e_v: float, e_w: float) -> list[tuple[float, float]]:
        """Mean twist of each sub-sample, the errors decaying exponentially."""
        decay, share = self._decay, self._share
        means = []
        for _ in range(SUBSAMPLES):
            means.append((v + e_v * share, omega + e_w * share))
            e_v *= decay
            e_w *= decay
        self.twist = Twist(v + e_v, omega + e_w)
        return means

    def _slow(self, v: float, omega: float) -> list[tuple[float, float]]:
        """The same where the chassis' acceleration is bounded."""
        b_v, b_w = self.twist
        slope_v, slope_w = self._slopes
        means = []
        for _ in range(SUBSAMPLES):
            b_v, m_v = follow(b_v, v, slope_v, self._lag, self.step)
            b_w, m_w = follow(b_w, omega, slope_w, self._lag, self.step)
            means.append((m_v, m_w))
        self.twist = Twist(b_v, b_w)
        return means
