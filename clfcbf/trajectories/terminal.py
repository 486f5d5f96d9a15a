r"""Terminal curves: how a time-optimal approach ends, tabulated backward from the goal.

Every curve brakes at a constant deceleration and turns at a constant rate that ramps down at
the acceleration limit; the curves differ by when the turn ends relative to the stop. A turn
that ends after the stop finishes on the spot. Going back in time the camera's bearing of the
feature grows; where it would pass the edge of the view the curve rides that edge, on which

.. math:: \kappa = \sin\beta / (\rho_c + c_x\cos\beta)

keeps the bearing :math:`\beta` constant (range :math:`\rho_c` from a camera :math:`c_x` ahead
of the rotation centre), a logarithmic spiral for :math:`c_x = 0` [Bhattacharya2007]_. What
comes before is a straight line tangent to the curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits

__all__ = ["TerminalCurves", "terminal_curves"]

Array = NDArray[np.float64]

_STEP = 0.025
"""Time between samples [s]: 5 mm at 0.2 m/s."""

_LONGEST = 600.0
"""[s] Of a curve: at 5 mm/s over the longest reach; a table of more is one of wrong limits."""


@dataclass(frozen=True, slots=True)
class TerminalCurves:
    """Curves that end at the goal, one a row; sample 0 is the stop, time runs backward.

    Attributes (each of shape (curves, samples))
    --------------------------------------------
    x, y, heading : pose of the robot in the goal's frame [m, m, rad]
    speed, turn_rate : profile [m/s, rad/s], signs as driven forward in time
    to_go : length of the curve up to the stop [m], increasing
    time : time up to the end of the motion, the turn on the spot included [s]
    """

    x: Array
    y: Array
    heading: Array
    speed: Array
    turn_rate: Array
    to_go: Array
    time: Array

    def thinned(self, curves: int, samples: int) -> TerminalCurves:
        """Every ``curves``-th curve and ``samples``-th sample, for wide searches."""
        keep = (slice(None, None, curves), slice(None, None, samples))
        return TerminalCurves(
            self.x[keep], self.y[keep], self.heading[keep], self.speed[keep],
            self.turn_rate[keep], self.to_go[keep], self.time[keep],
        )  # fmt: skip


def terminal_curves(
    limits: Limits, camera: FieldOfView, standoff: float, offsets: Array, reach: float
) -> TerminalCurves:
    """Tabulate the curves that turn left of the goal's axis and their mirror images.

    Parameters
    ----------
    limits : what the plan may use; leave the tracker a share of the real ones
    camera : edge of the view that the plan may use
    standoff : distance from the goal to the feature ahead of it [m]
    offsets : times from the end of the turn to the stop, shape (curves,) [s]; negative where
        the turn ends on the spot, after the stop
    reach : length to tabulate [m]

    Raises
    ------
    ConfigurationError : so long a curve takes minutes, at such a ``v_max`` and ``a_max``
    """
    longest = reach / limits.v_max + limits.v_max / limits.a_max
    if not longest <= _LONGEST:
        raise ConfigurationError(
            f"v_max and a_max must let {reach:g} m and a stop be driven in {_LONGEST:g} s, got "
            f"v_max={limits.v_max!r} and a_max={limits.a_max!r}"
        )
    cx, cy, yaw = camera.camera
    half_angle = camera.half_angle
    ramp = limits.omega_max / limits.alpha_max

    def rate(to_stop: Array) -> Array:
        clipped = np.clip((to_stop - offsets) * limits.alpha_max, 0.0, limits.omega_max)
        return np.asarray(clipped)

    late = np.maximum(-offsets, 0.0)
    heading = np.where(
        late < ramp,
        0.5 * limits.alpha_max * late**2,
        0.5 * limits.omega_max * ramp + limits.omega_max * (late - ramp),
    )
    samples = int(reach / (limits.v_max * _STEP)) + int(limits.v_max / limits.a_max / _STEP) + 2
    shape = (len(offsets), samples)
    x, y, psi = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    speed, turn, to_go = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    psi[:, 0], turn[:, 0] = heading, -rate(np.zeros(len(offsets)))
    for i in range(1, samples):
        middle = (i - 0.5) * _STEP
        v = min(limits.v_max, limits.a_max * middle)
        c, s = np.cos(psi[:, i - 1]), np.sin(psi[:, i - 1])
        eye_x = x[:, i - 1] + c * cx - s * cy
        eye_y = y[:, i - 1] + s * cx + c * cy
        bearing = psi[:, i - 1] + yaw - np.arctan2(-eye_y, standoff - eye_x)
        distance = np.hypot(standoff - eye_x, eye_y)
        inward = v * np.sin(bearing) / distance
        room = (half_angle - bearing) / _STEP
        edge = (inward + room) / (1.0 + cx * np.cos(bearing) / distance)
        omega = np.maximum(np.minimum(rate(np.full(len(offsets), middle)), edge), 0.0)
        theta = psi[:, i - 1] + 0.5 * omega * _STEP
        x[:, i] = x[:, i - 1] - v * _STEP * np.cos(theta)
        y[:, i] = y[:, i - 1] - v * _STEP * np.sin(theta)
        psi[:, i] = psi[:, i - 1] + omega * _STEP
        speed[:, i] = min(limits.v_max, limits.a_max * i * _STEP)
        turn[:, i] = -omega
        to_go[:, i] = to_go[:, i - 1] + v * _STEP
    time = late[:, None] + _STEP * np.arange(samples)[None, :]
    return TerminalCurves(
        np.concatenate([x, x]),
        np.concatenate([y, -y]),
        np.concatenate([psi, -psi]),
        np.concatenate([speed, speed]),
        np.concatenate([turn, -turn]),
        np.concatenate([to_go, to_go]),
        np.concatenate([time, time]),
    )


def nominal_offsets(limits: Limits, camera: FieldOfView, standoff: float, count: int) -> Array:
    """Offsets from the largest turn on the spot that the view allows to a turn ended early."""
    ahead = standoff - camera.camera.x
    # Bearing of the feature from the camera when the robot stands at the goal, turned by chi:
    # tan(b) = d sin(chi) / (d cos(chi) - c_x); the largest chi keeps b at the edge.
    low, high = 0.0, 0.5 * math.pi
    for _ in range(60):
        chi = 0.5 * (low + high)
        bearing = math.atan2(
            standoff * math.sin(chi), standoff * math.cos(chi) - (standoff - ahead)
        )
        low, high = (chi, high) if bearing <= camera.half_angle else (low, chi)
    ramp = limits.omega_max / limits.alpha_max
    swept = 0.5 * limits.omega_max * ramp
    latest = (
        (low - swept) / limits.omega_max + ramp
        if low > swept
        else math.sqrt(2.0 * low / limits.alpha_max)
    )
    return np.linspace(-0.95 * latest, 1.2, count)
