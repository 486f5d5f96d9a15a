r"""Quintic trajectory through boundary positions, velocities and accelerations.

The trajectory of [Xie2024]_: :math:`p(t) = \sum_{k=0}^{5} c_k t^k` in x and in y. Its heading
is the direction of travel, which is 0/0 where the speed vanishes. Writing the velocity about
an end of the trajectory as :math:`\dot p(\tau) = \tau^n w(\tau)` with :math:`w(0) \ne 0`
removes that zero for good: heading and turn rate

.. math:: \theta = \arg(\pm w), \qquad \omega = \frac{w \times \dot w}{|w|^2}

are those of :math:`w`. At :math:`\tau = 0` they are the known limits
:math:`\tfrac12 (a \times j)/|a|^2` at zero speed and :math:`\tfrac13 (j \times s)/|j|^2` at
zero speed and acceleration (a, j, s: acceleration, jerk, snap).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import GeometryError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.trajectories.expansion import BoundaryState, Expansion, extent, settled, taylor
from clfcbf.trajectories.path import Peaks, check_gear

__all__ = ["HEADING_TOLERANCE", "PEAK_SAMPLES", "BoundaryState", "Quintic", "minimum_duration"]

HEADING_TOLERANCE = math.radians(0.01)
"""Largest disagreement of a boundary heading [rad]: far under any sensor's, above rounding."""

PEAK_SAMPLES = 2000
"""Samples in which peaks are bracketed before one refinement: enough beside a near cusp."""

_AT_REST = Twist(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Quintic:
    r"""The quintic with given position, velocity and acceleration at both ends.

    Attributes
    ----------
    start, end : boundary states, in one frame; a negligible speed, and then a negligible
        acceleration, is set to 0
    duration : :math:`t_p` [s]
    gear : +1 faces the direction of travel, -1 faces away from it (v is negative)

    Raises
    ------
    GeometryError : the duration is not positive and finite; nothing moves (all derivatives
        vanish); or the speed passes through zero inside, a cusp, where the direction of
        travel flips: plan one leg to each side of it
    ConfigurationError : the gear is not +1 or -1

    Notes
    -----
    Nothing here knows of limits or of the camera: ask :meth:`peaks`. From rest with zero
    acceleration to rest with zero acceleration the quintic is the straight line
    :math:`p_0 + (p_f - p_0)(10\tau^3 - 15\tau^4 + 6\tau^5)` whatever headings were wanted.
    A boundary speed that is small but not negligible fixes the heading there, and the path may
    turn sharply just after.
    """

    start: BoundaryState
    end: BoundaryState
    duration: float
    gear: int = 1
    _ends: tuple[Expansion, Expansion] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_gear(self.gear)
        T = self.duration
        if not (math.isfinite(T) and T > 0.0):
            raise GeometryError(f"duration must be finite and positive [s], got {T!r}")
        scale = extent(self.start, self.end, T)
        p, q = settled(self.start, T, scale), settled(self.end, T, scale)
        ends = (
            Expansion.about(*taylor(p, q, T), half=0.5 * T, extent=scale),
            Expansion.about(*taylor(q, p, -T), half=-0.5 * T, extent=scale),
        )
        for expansion, origin in zip(ends, (0.0, T), strict=True):
            cusp = expansion.cusp()
            if cusp is not None:
                raise GeometryError(
                    f"the speed vanishes and the direction of travel flips at "
                    f"t = {origin + cusp:.3f} s of {T:.3f} s: plan one leg to each side of it"
                )
        for name, value in (("start", p), ("end", q), ("_ends", ends)):
            object.__setattr__(self, name, value)

    @classmethod
    def between(
        cls,
        start: Pose2,
        end: Pose2,
        duration: float,
        *,
        start_twist: Twist = _AT_REST,
        end_twist: Twist = _AT_REST,
        start_acceleration: float = 0.0,
        end_acceleration: float = 0.0,
        gear: int = 1,
    ) -> Quintic:
        r"""The quintic between two poses, refused unless it has their headings.

        Parameters
        ----------
        start, end : poses in one frame
        duration : [s]
        start_twist, end_twist : twists there; at v = 0 the turn rate follows from the path
        start_acceleration, end_acceleration : :math:`\dot v` [m/s²]. To leave a rest along its
            heading, the first has the sign of the gear; to arrive at one, the second has
            the opposite sign
        gear : +1 forward, -1 reverse

        Raises
        ------
        GeometryError : as the class, or a heading of the quintic differs from the wanted one
            by more than ``HEADING_TOLERANCE``; the message says by how many degrees
        """
        trajectory = cls(
            BoundaryState.of(start, start_twist, start_acceleration),
            BoundaryState.of(end, end_twist, end_acceleration),
            duration,
            gear,
        )
        for name, wanted, t in (("start", start, 0.0), ("end", end, trajectory.duration)):
            off = wrap_angle(trajectory.pose(t).theta - wanted.theta)
            if abs(off) > HEADING_TOLERANCE:
                raise GeometryError(
                    f"the quintic's heading at the {name} is off by {math.degrees(off):+.2f} "
                    f"degrees: a heading exists only through a velocity, or at rest an "
                    f"acceleration, along it; give the {name} one with the right sign"
                )
        return trajectory

    @property
    def coefficients(self) -> NDArray[np.float64]:
        r"""Coefficients :math:`c_0 \ldots c_5` in x and in y, ascending, shape (2, 6)."""
        return np.array(self._ends[0].position, dtype=float)

    def _near(self, t: float) -> tuple[Expansion, float]:
        # About the nearer end the expansion loses no digits, so the limits are met smoothly.
        if t <= 0.5 * self.duration:
            return self._ends[0], max(t, 0.0)
        return self._ends[1], min(t - self.duration, 0.0)

    def pose(self, t: float) -> Pose2:
        """Pose at time ``t`` [s]; the end poses before 0 and after the duration."""
        expansion, tau = self._near(t)
        x, y = expansion.point(tau)
        return Pose2(x, y, expansion.heading(tau, self.gear))

    def twist(self, t: float) -> Twist:
        r"""Feedforward :math:`(v_V, \omega_V)` at time ``t`` [s]; zero outside [0, duration].

        At zero speed within that interval the turn rate is its limit from inside.
        """
        if not 0.0 <= t <= self.duration:
            return _AT_REST
        expansion, tau = self._near(t)
        return Twist(self.gear * expansion.speed(tau), expansion.turn_rate(tau))

    def at(self, t: float) -> tuple[Pose2, Twist]:
        """Pose and twist at time ``t`` [s]; rests at the end pose after the duration."""
        return self.pose(t), self.twist(t)

    def peaks(self) -> Peaks:
        """Largest absolute speed, turn rate and accelerations, by refined sampling."""
        both = [expansion.magnitudes(PEAK_SAMPLES // 2) for expansion in self._ends]
        largest = [max(a, b) for a, b in zip(*both, strict=True)]
        return Peaks(*largest)

    def limits_exceeded(self, limits: Limits) -> dict[str, float]:
        """Ratio of peak to limit for each limit that is exceeded; empty if none is."""
        return self.peaks().exceeded(limits, self.gear)


def minimum_duration(length: float, limits: Limits, gear: int = 1) -> float:
    r"""Shortest rest-to-rest quintic along a straight line within the limits [s].

    .. math:: T = \max\Big(\frac{15 L}{8 v_{max}},\ \sqrt{\frac{10}{\sqrt 3}\frac{L}{a_{max}}}\Big)

    Parameters
    ----------
    length : L [m], finite and not negative
    limits : the chassis's limits; in reverse ``-v_min`` takes the place of ``v_max``
    gear : +1 forward, -1 reverse

    Raises
    ------
    GeometryError : the length is negative or not finite, or reverse is forbidden
    """
    check_gear(gear)
    if not (math.isfinite(length) and length >= 0.0):
        raise GeometryError(f"length must be finite and at least 0 m, got {length!r}")
    speed = limits.v_max if gear > 0 else -limits.reverse_speed
    if speed == 0.0:
        raise GeometryError("reverse is forbidden: v_min is 0")
    return max(15.0 * length / (8.0 * speed), math.sqrt(10.0 * length / (3.0**0.5 * limits.a_max)))
