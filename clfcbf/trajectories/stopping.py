r"""The fastest stop of a body that lags behind its commands, and how to end it at a goal.

One coordinate: commands :math:`u` change by at most :math:`a` a second, the body follows with
:math:`\tau\dot b = u - b`, and the point it coasts to moves with :math:`u` exactly. To let go of
the command and wait takes the body some :math:`4\tau`; the fastest stop drives the command through
zero to :math:`-w` and back, so that both come to rest together. From :math:`(u, b)`

.. math::
    z = e^{-w/(a\tau)} = \frac{1}{1 + \sqrt{1 + k}}, \qquad
    k = \Big(\frac{b - u}{a\tau} - 1\Big)e^{-u/(a\tau)}, \qquad
    D = \frac{u^2 - 2w^2}{2a},

with :math:`D` the way of the coasting point. After a long brake :math:`k = 0`: :math:`w =
a\tau\ln 2`, and the stop is over :math:`\tau\ln 4` after a command that stops at zero, where
waiting for one percent would take :math:`4.6\tau`.
"""

from __future__ import annotations

import math

__all__ = ["command_to", "stopping_distance", "undershoot"]

_STILL = 0.3
"""Steps of the command below which a body counts as at rest: 3 mm/s at 0.3 m/s² and 30 Hz."""

_HALVINGS = 12
"""Of an interval of two steps: a two-thousandth of one."""


def undershoot(command: float, body: float, slope: float, lag: float) -> float:
    r"""How far the fastest stop drives the command below zero, :math:`w`.

    Parameters
    ----------
    command, body : :math:`u` and :math:`b`, at least 0 in the direction of motion
    slope : :math:`a`, largest change of the command a second
    lag : :math:`\tau` [s], positive
    """
    scale = slope * lag
    k = ((body - command) / scale - 1.0) * math.exp(-command / scale)
    return scale * math.log1p(math.sqrt(max(1.0 + k, 0.0)))


def stopping_distance(command: float, body: float, slope: float, lag: float) -> float:
    """Way of the coasting point in the fastest stop; negative where the body has to come back."""
    w = undershoot(command, body, slope, lag)
    return (command * command - 2.0 * w * w) / (2.0 * slope)


def command_to(
    error: float,
    command: float,
    body: float,
    slope: float,
    top: float,
    period: float,
    lag: float,
    tolerance: float = 0.0,
) -> float:
    """Next command of the fastest way to a goal at ``error`` from where the body coasts to.

    The largest one after which the fastest stop still ends at the goal or before it; while the
    command is below zero, the one that brings it back as the body comes to rest.

    Parameters
    ----------
    error : distance from the coasting point to the goal, either sign
    command, body : :math:`u` in force and :math:`b`
    slope, top : largest change of the command a second, and largest command
    period, lag : of the control loop, and of the body [s]
    tolerance : error at which a body that is as good as at rest is left alone
    """
    step = slope * period
    if abs(error) <= tolerance and abs(command) <= step and abs(body) <= _STILL * step:
        return 0.0
    forward = command + body if abs(command + body) > 1e-9 * top else error
    if forward < 0.0:
        return -command_to(-error, -command, -body, slope, top, period, lag, tolerance)
    if command < 0.0:  # on the way back to zero, or about to turn there
        scale = slope * lag
        left = (body - command + scale) * math.exp(command / scale) - scale
        return min(command + step, 0.0) if left <= 0.0 else command - step
    share = 1.0 - math.exp(-period / lag)

    def beyond(wanted: float) -> float:
        after = body + (wanted - body) * share
        return wanted * period + stopping_distance(wanted, after, slope, lag) - error

    low, high = max(command - step, -step), min(command + step, top)
    if low < 0.0:  # the stop itself goes through zero
        low = 0.0 if beyond(0.0) <= 0.0 else command - step
        if low < 0.0:
            return low
    if beyond(low) >= 0.0:
        return low
    if beyond(high) <= 0.0:
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if beyond(middle) <= 0.0 else (low, middle)
    return low
