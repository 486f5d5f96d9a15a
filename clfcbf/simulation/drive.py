"""The drive between command and motion: first-order lag, bounded acceleration, slip and bias."""

from __future__ import annotations

import math

from clfcbf.limits import Limits
from clfcbf.se2 import Twist
from clfcbf.simulation.plant import BodyErrors, check_command

__all__ = ["Drive", "follow"]

_REST = (0.0, 0.0)


def follow(
    value: float, target: float, slope: float, lag: float, duration: float
) -> tuple[float, float]:
    r"""First-order lag with bounded slope, in closed form.

    .. math:: \dot x = \mathrm{sat}_{a}\!\left(\frac{x_c - x}{\tau}\right)

    is a ramp of slope :math:`\pm a` until :math:`|x_c - x| = a\tau`, and from there
    :math:`x_c - x` decays as :math:`e^{-t/\tau}`; the two join with equal slopes.

    Parameters
    ----------
    value, target : :math:`x` at the start and the constant :math:`x_c`
    slope : largest rate of change :math:`a` [1/s]
    lag : time constant :math:`\tau` [s]; with 0 the value takes the target at once, unbounded
    duration : time that passes [s], positive

    Returns
    -------
    The value at the end, and its mean over the duration.
    """
    if lag == 0.0:
        return target, target
    error = target - value
    area = 0.0
    rest = duration
    ramp = abs(error) / slope - lag
    if ramp > 0.0:
        rate = math.copysign(slope, error)
        if ramp >= duration:
            change = rate * duration
            return value + change, value + 0.5 * change
        area = (value + 0.5 * rate * ramp) * ramp
        error = rate * lag
        rest = duration - ramp
    decay = -math.expm1(-rest / lag)
    area += target * rest - error * lag * decay
    return target - error * (1.0 - decay), area / duration


class Drive:
    """The body's twist as it follows the command last sent.

    The twist that the body tends to is the command with this run's scale errors, and with the
    gyro's bias added to the turn rate while the command is to move. At a zero command the
    wheels are held, and a biased gyro does not turn a robot that stands on held wheels.

    Parameters
    ----------
    command : command applied before the start; the body has settled to it
    limits : bounds of the body's accelerations (not of its speeds: those are the controller's)
    lag : time constant of the velocity [s]; 0 takes commands at once, with no bound
    errors : this run's scale errors and bias

    Attributes
    ----------
    command : the command last sent
    twist : the body's twist now
    """

    __slots__ = ("_a_max", "_alpha_max", "_errors", "_lag", "_target", "command", "twist")

    def __init__(self, command: Twist, limits: Limits, lag: float, errors: BodyErrors) -> None:
        self._a_max = limits.a_max
        self._alpha_max = limits.alpha_max
        self._lag = lag
        self._errors = errors
        self.send(command)
        self.twist = self._target

    def send(self, command: Twist) -> None:
        """Take ``command`` from now on; ``GeometryError`` if it is not finite."""
        self.command = check_command(command)
        scale_v, scale_omega, bias = self._errors
        v, omega = self.command
        turn = scale_omega * omega + (bias if self.command != _REST else 0.0)
        self._target = Twist(scale_v * v, turn)

    def step(self, duration: float) -> Twist:
        """Let ``duration`` [s] pass; returns the mean twist over it."""
        v, omega = self.twist
        target_v, target_omega = self._target
        v, mean_v = follow(v, target_v, self._a_max, self._lag, duration)
        omega, mean_omega = follow(omega, target_omega, self._alpha_max, self._lag, duration)
        self.twist = Twist(v, omega)
        return Twist(mean_v, mean_omega)
