r"""What errors of sensor, clock and body can do to where the feature is believed to be.

The guard is exact for a model whose lag is known and a feature seen without error. A real one
differs from it by a turn of the feature about the camera and a displacement; a view *eroded* by
bounds of both (:meth:`clfcbf.camera.FieldOfView.eroded`) is kept for the model, so the view
itself is kept for the robot. Here are such bounds, of the worst case within declared errors.

Let :math:`u` be one coordinate of the commands, :math:`b_\tau` the body's, which lags by
:math:`\tau` where the model lags by :math:`\tau_m`; a frame was captured at :math:`s'` and is
stamped :math:`s`. While the body has :math:`r \in [0, \tau]` seconds' worth of coasting before
it, the model that has as much before it is off by

.. math::
    e = \int_{s'}^{s} u\,dt + \tau\,[b_\tau(s') - b_m(0)] - \tau_m[b_m(s) - b_m(0)]
        + r\,[b_m(0) - b_\tau(0)]

and by :math:`\kappa` times what it really moved, for a scale error :math:`\kappa`. That is a
linear function of commands bounded in size and in slope, whose maximum is at a vertex.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits, check_period

__all__ = ["Budget", "ErrorBounds", "error_budget"]

Array = NDArray[np.float64]

_LAGS = 7
"""Lags between the shortest and the longest at which the worst case is sought."""

_AGES = 9
"""Ages of a frame, up to the longest."""

_FORGOTTEN = 5.0
"""Lags after which a command's trace in the body is under one percent, so may be left out once it
is added in full."""


@dataclass(frozen=True, slots=True)
class ErrorBounds:
    """Declared bounds of all that the estimate of the feature can err by.

    Attributes
    ----------
    bearing : of the feature as a frame shows it [rad]
    range_offset, range_scale : of its distance, [m] and share of it
    stamp : of a frame's stamp [s]
    age : longest age of the frame that is acted on [s], drop-outs included
    lag : shortest and longest first-order lag of the body [s]
    scale : of speed and turn rate, a share (slip)
    drift : of the turn rate while a command moves the robot [rad/s]

    Raises
    ------
    ConfigurationError : a bound is negative or not finite, or the lags are not in order
    """

    bearing: float = 0.0
    range_offset: float = 0.0
    range_scale: float = 0.0
    stamp: float = 0.0
    age: float = 0.0
    lag: tuple[float, float] = (0.0, 0.0)
    scale: float = 0.0
    drift: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high = value if field.name == "lag" else (value, value)
            if not 0.0 <= low <= high < math.inf:
                raise ConfigurationError(
                    f"{field.name} must be finite and at least 0, got {value!r}"
                )


class Budget(NamedTuple):
    """What a view has to be eroded by, and what that is made of.

    Attributes
    ----------
    margin : off the half angle [rad]: bearing and heading error
    setback : of the edges [m]: travel error, and what the turns displace
    heading, travel : largest errors of the heading [rad] and of the way [m] until rest
    """

    margin: float
    setback: float
    heading: float
    travel: float


def error_budget(
    bounds: ErrorBounds,
    limits: Limits,
    camera: FieldOfView,
    period: float,
    lag: float,
    nearest: float,
) -> Budget:
    r"""Margin and setback that cover ``bounds`` for whatever is commanded.

    With the errors of heading :math:`D_\theta` and way :math:`D_\ell`, the way :math:`L` and the
    turn :math:`\Theta` from a frame to rest, and a camera at the distance :math:`l_c` from the
    robot's centre, the feature is where it is believed to be but for a turn about the camera of
    at most :math:`\beta + D_\theta` and a displacement of at most

    .. math::
        D_\ell(1 + \Theta) + D_\theta(L + l_c) + \beta(L + l_c\Theta)
        + (r_0 + r_1(\rho + L))\,\frac{L}{\rho},

    the last for the error of the range, which shows only as far as the feature is passed by.

    Parameters
    ----------
    bounds : what is declared
    limits, period : of the chassis and its control loop
    camera : whose view it is
    lag : of the model [s], within the bounds
    nearest : least distance from the camera to the feature :math:`\rho` [m]

    Raises
    ------
    ConfigurationError : ``lag`` is outside its bounds, or ``nearest`` not positive
    """
    check_period(period)
    if not bounds.lag[0] <= lag <= bounds.lag[1]:
        raise ConfigurationError(f"lag must be within its bounds {bounds.lag}, got {lag!r}")
    if not 0.0 < nearest < math.inf:
        raise ConfigurationError(f"nearest must be finite and positive [m], got {nearest!r}")
    fastest = max(limits.v_max, -limits.reverse_speed)
    horizon = limits.brake_horizon(period)
    duration = bounds.age + bounds.stamp + horizon + bounds.lag[1]
    moving = bounds.age + bounds.stamp + 2.0 * horizon + bounds.lag[1]
    heading = _largest(bounds, limits.omega_max, limits.alpha_max, horizon, period, lag)
    heading += bounds.drift * moving
    travel = _largest(bounds, fastest, limits.a_max, horizon, period, lag)
    way = (1.0 + bounds.scale) * fastest * duration
    turn = (1.0 + bounds.scale) * limits.omega_max * duration + bounds.drift * moving
    lever = math.hypot(camera.camera.x, camera.camera.y)
    ranging = bounds.range_offset + bounds.range_scale * (nearest + way)
    setback = (
        travel * (1.0 + turn)
        + heading * (way + lever)
        + bounds.bearing * (way + lever * turn)
        + ranging * min(1.0, way / nearest)
    )
    return Budget(bounds.bearing + heading, setback, heading, travel)


def _largest(
    bounds: ErrorBounds, most: float, slope: float, horizon: float, period: float, lag: float
) -> float:
    """The largest error of one coordinate, over lags, ages, stamps and scales."""
    longest = max(bounds.lag[1], lag)
    ticks = math.ceil((bounds.age + bounds.stamp + _FORGOTTEN * longest) / period) + 1
    worst = 0.0
    for tau, age, early, scale in itertools.product(
        np.linspace(*bounds.lag, _LAGS).tolist(),
        np.linspace(0.0, bounds.age, _AGES).tolist(),
        {-bounds.stamp, bounds.stamp},
        {-bounds.scale, bounds.scale},
    ):
        captured = -age
        stamp = min(captured + early, 0.0)
        since, told = _held(captured, ticks, period), _held(stamp, ticks, period)
        before, now = (_body(tau, t, ticks, period) for t in (captured, 0.0))
        believed, modelled = (_body(lag, t, ticks, period) for t in (stamp, 0.0))
        for left in (0.0, tau):
            true = (1.0 + scale) * (since + tau * before - left * now)
            model = told + lag * believed - (lag - tau + left) * modelled
            brake = np.zeros(ticks + 1)
            brake[-1] = abs(scale) * horizon
            error = np.append(true - model, 0.0) + brake
            forgotten = (1.0 + scale) * tau * math.exp((captured + ticks * period) / -(tau or 1.0))
            forgotten += lag * math.exp((stamp + ticks * period) / -(lag or 1.0))
            worst = max(worst, _maximum(error, most, slope * period) + most * forgotten)
    return worst


def _held(start: float, ticks: int, period: float) -> Array:
    """How long each of the last commands is in force from ``start`` until now (time 0)."""
    begin = (np.arange(ticks) - ticks) * period
    return np.asarray(np.clip(begin + period - np.maximum(begin, start), 0.0, period))


def _body(lag: float, at: float, ticks: int, period: float) -> Array:
    """Share of each of the last commands in a body that lags, at the time ``at``."""
    begin = (np.arange(ticks) - ticks) * period
    end = np.minimum(begin + period, at)
    if lag == 0.0:
        return np.where((begin < at) & (at <= begin + period), 1.0, 0.0)
    share = np.exp((end - at) / lag) - np.exp((begin - at) / lag)
    return np.where(end > begin, share, 0.0)


def _maximum(weights: Array, most: float, step: float) -> float:
    r"""The maximum of :math:`\sum w_k u_k` over :math:`|u_k| \le U`, :math:`|u_{k+1} - u_k| \le d`.

    At a vertex every run of commands linked by full steps has one at :math:`\pm U`: all are whole
    steps away from one end or the other. So dynamic programming over those values is exact.
    """
    count = math.floor(2.0 * most / step) + 1
    ladder = most - step * np.arange(count)
    values = np.unique(np.concatenate((ladder, -ladder)))
    rounding = 1e-9 * step
    reach = np.abs(values[:, None] - values[None, :]) <= step + rounding
    best = np.zeros(len(values))
    for weight in weights:
        best = np.where(reach, best[None, :], -np.inf).max(axis=1) + weight * values
    return float(best.max())
