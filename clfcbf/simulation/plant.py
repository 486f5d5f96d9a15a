"""What a simulated robot is: a chassis with a clock and a true pose, and how real bodies differ."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.hardware.protocols import Chassis
from clfcbf.se2 import Pose2, Twist, is_finite

__all__ = ["Body", "BodyErrors", "Plant", "check_command", "check_start", "sub_steps"]

DEFAULT_LAG = 0.12
"""[s] velocity lag of a small differential drive under its own speed control."""
DEFAULT_SLIP = 0.01
"""One sigma of the scale errors of speed and turn rate: tyre wear, load, an uneven floor."""
DEFAULT_GYRO_BIAS = math.radians(0.1)
"""[rad/s] one sigma of the bias of an uncompensated consumer gyro."""
DEFAULT_RATE = 240.0
"""[Hz] sub-steps: at least 200, and a whole number in ticks of 10, 30 and 60 Hz."""

_ROUNDING = 1e-9  # a duration of 1/30 s holds 8 sub-steps at 240 Hz, not 9


class BodyErrors(NamedTuple):
    """What one run's body does differently from its command: drawn once, constant since.

    ``scale_v`` and ``scale_omega`` multiply the commanded speed and turn rate;
    ``gyro_bias`` [rad/s] is added to the turn rate.
    """

    scale_v: float
    scale_omega: float
    gyro_bias: float


@dataclass(frozen=True, slots=True)
class Body:
    """How far a body's motion is from its commands; one run's errors are drawn from it.

    Attributes
    ----------
    lag : time constant of the first-order velocity lag [s]; with 0 the body takes each command
        at once, the zero-order hold that speed and acceleration limits are stated for
    slip : standard deviation of the scale errors of speed and of turn rate, 0.01 is 1 %
    gyro_bias : standard deviation of the bias of the turn rate [rad/s]
    rate : sub-steps per second of simulated time [Hz]

    Raises
    ------
    ConfigurationError : a value is not finite or negative, or the rate is not positive
    """

    lag: float = DEFAULT_LAG
    slip: float = DEFAULT_SLIP
    gyro_bias: float = DEFAULT_GYRO_BIAS
    rate: float = DEFAULT_RATE

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigurationError(f"{field.name} must be finite and >= 0, got {value!r}")
        if self.rate == 0.0:
            raise ConfigurationError("rate must be positive [Hz], got 0.0")

    @classmethod
    def ideal(cls) -> Body:
        """The body that does exactly what it is told: no lag, no slip, no bias."""
        return cls(lag=0.0, slip=0.0, gyro_bias=0.0)

    def draw(self, rng: np.random.Generator) -> BodyErrors:
        """One run's errors; always three draws, so that seeds stay paired between bodies."""
        slip_v, slip_omega, bias = rng.standard_normal(3).tolist()
        return BodyErrors(
            1.0 + self.slip * slip_v, 1.0 + self.slip * slip_omega, self.gyro_bias * bias
        )


@runtime_checkable
class Plant(Chassis, Protocol):
    """A simulated chassis, and the truth about it.

    Poses are those of the rotation centre in the goal's frame: the goal pose is the origin
    with heading 0, and the viewed feature lies at (standoff, 0).
    """

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""

    def pose(self) -> Pose2:
        """True pose in the goal's frame."""

    def twist(self) -> Twist:
        """True body twist [m/s, rad/s], not the command."""

    def advance(self, duration: float) -> tuple[Pose2, ...]:
        """Let ``duration`` [s] pass under the command last sent.

        Returns the true pose at the end of every sub-step, the last one included, so that the
        view can be judged between ticks. Raises ``ConfigurationError`` unless the duration is
        finite and positive.
        """

    def move_target(self, shift: Pose2) -> None:
        """Move the target by ``shift``, given in the goal's frame, while the robot stays.

        Poses are in the moved goal's frame from then on.
        """

    def close(self) -> None:
        """Release what the simulation holds; any number of times."""


def sub_steps(duration: float, rate: float) -> tuple[int, float]:
    """Number and length [s] of equal sub-steps that fill ``duration`` at ``rate`` [Hz] or more."""
    if not (math.isfinite(duration) and duration > 0.0):
        raise ConfigurationError(f"duration must be finite and positive [s], got {duration!r}")
    count = max(1, math.ceil(duration * rate - _ROUNDING))
    return count, duration / count


def check_start(start: Pose2) -> Pose2:
    """Return ``start`` if it is finite, else raise ``GeometryError``."""
    if not is_finite(tuple(start)):
        raise GeometryError(f"start pose must be finite, got {start!r}")
    return Pose2(*start)


def check_command(twist: Twist) -> Twist:
    """Return ``twist`` if it is finite, else raise ``GeometryError``, as a driver would refuse."""
    if not is_finite(tuple(twist)):
        raise GeometryError(f"command must be finite, got {twist!r}")
    return Twist(*twist)
