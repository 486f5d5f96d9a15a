r"""Reversals: back, and through the change of gear to full speed ahead without a stop of the turn.

What the fastest approaches do where the view forbids to go forward at once: they reverse, turn
one way and then the other, and turn at full rate while the speed rises through zero, where a
turn costs no way. Of such motions, all bang-bang, this is a family of four parameters: the
length :math:`L` driven in reverse, the turn rates :math:`\omega_1` and then :math:`\omega_2`,
and the time between the change of turn rate and that of speed,

.. math::
    v(t) = -\min(a t, \hat v),\quad t \le t_2;\qquad
    v(t) = -\hat v + a (t - t_2) \le v_{max}, \quad t > t_2

with :math:`\hat v = \min(v_{rev}, \sqrt{a L})` and :math:`t_2 = L/\hat v`; the turn rate ramps
at :math:`\alpha` from zero to :math:`\omega_1`, and from :math:`t_1 = t_2 -` lead on to
:math:`\omega_2`, with which the robot goes on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.trajectories.legs import Trajectory

__all__ = ["Reversals"]

Array = NDArray[np.float64]

_NODES = 60
"""Instants of a motion in the table, about 50 ms apart."""

_FINER = 3
"""Instants of a leg for one of the table: about a tick apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Reversals:
    """The family tabulated, one motion a row, from rest at the origin.

    Attributes
    ----------
    limits : that the motions keep
    back, first, second, lead : the parameters [m, rad/s, rad/s, s], shape (m,)
    durations : until full speed ahead is reached [s], shape (m,)
    poses : x, y [m] and unwrapped heading [rad], shape (m, n, 3)
    turn_rates : at these poses [rad/s], shape (m, n)
    """

    limits: Limits
    back: Array
    first: Array
    second: Array
    lead: Array
    durations: Array
    poses: Array
    turn_rates: Array

    @classmethod
    def tabulated(
        cls,
        limits: Limits,
        lengths: tuple[float, ...],
        shares: tuple[float, ...],
        leads: tuple[float, ...],
    ) -> Reversals:
        """All combinations of lengths [m], shares of the largest turn rate, and leads [s].

        The second turn rate is none of the shares that are zero; none in all where the limits
        forbid to reverse.
        """
        rates = [share * limits.omega_max for share in shares]
        grid = np.meshgrid(
            lengths if limits.reverse_speed < 0.0 else (),
            rates, [rate for rate in rates if rate], leads, indexing="ij",
        )  # fmt: skip
        back, first, second, lead = (column.ravel() for column in grid)
        durations, poses, _, turn_rates = _motions(limits, back, first, second, lead, _NODES)
        return cls(limits, back, first, second, lead, durations, poses, turn_rates)

    def __len__(self) -> int:
        return len(self.durations)

    def seen_from(self, start: Pose2, rows: NDArray[np.intp]) -> Array:
        """The poses of some motions for a start other than the origin, shape (len(rows), n, 3)."""
        x, y, theta = np.moveaxis(self.poses[rows], 2, 0)
        c, s = math.cos(start.theta), math.sin(start.theta)
        return np.stack(
            (start.x + c * x - s * y, start.y + s * x + c * y, start.theta + theta), axis=2
        )

    def leg(self, row: int, start: Pose2) -> Trajectory:
        """One of the motions as a leg that begins at rest at ``start``."""
        back, first, second, lead = (
            column[[row]] for column in (self.back, self.first, self.second, self.lead)
        )
        durations, poses, speeds, rates = _motions(
            self.limits, back, first, second, lead, _FINER * _NODES
        )
        times = np.linspace(0.0, float(durations[0]), len(poses[0]))
        return Trajectory(
            tuple(times.tolist()),
            tuple([
                start.compose(Pose2(x, y, wrap_angle(theta))) for x, y, theta in poses[0].tolist()
            ]),
            tuple(map(Twist, speeds[0].tolist(), rates[0].tolist())),
        )  # fmt: skip


def _motions(
    limits: Limits, back: Array, first: Array, second: Array, lead: Array, count: int
) -> tuple[Array, Array, Array, Array]:
    """Durations, poses, speeds and turn rates at ``count + 1`` instants of each motion."""
    a, top = limits.a_max, limits.v_max
    peak = np.minimum(-limits.reverse_speed, np.sqrt(a * back))
    change = back / peak  # that of speed: a ramp to the peak takes as long as it saves way
    turned = np.maximum(change - lead, 0.0)
    durations = change + (peak + top) / a
    times = durations[:, None] * np.linspace(0.0, 1.0, count + 1)
    middle = 0.5 * (times[:, 1:] + times[:, :-1])
    step = durations[:, None] / count

    def speed(t: Array) -> Array:
        late = np.minimum(a * (t - change[:, None]) - peak[:, None], top)
        return np.where(t < change[:, None], -np.minimum(a * t, peak[:, None]), late)

    def rate(t: Array) -> Array:
        begun = _toward(np.zeros(1), first, limits.alpha_max * turned)[:, None]
        early = _toward(np.zeros(1), first[:, None], limits.alpha_max * t)
        late = _toward(begun, second[:, None], limits.alpha_max * (t - turned[:, None]))
        return np.where(t < turned[:, None], early, late)

    theta = np.pad(np.cumsum(step * rate(middle), axis=1), ((0, 0), (1, 0)))
    heading = 0.5 * (theta[:, 1:] + theta[:, :-1])
    way = step * speed(middle)
    x = np.pad(np.cumsum(way * np.cos(heading), axis=1), ((0, 0), (1, 0)))
    y = np.pad(np.cumsum(way * np.sin(heading), axis=1), ((0, 0), (1, 0)))
    return durations, np.stack((x, y, theta), axis=2), speed(times), rate(times)


def _toward(start: Array, end: Array, most: Array) -> Array:
    """``end``, or as far as ``most`` leads there from ``start``."""
    reached: Array = start + np.clip(end - start, -most, most)
    return reached
