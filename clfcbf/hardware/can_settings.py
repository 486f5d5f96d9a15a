"""What is fixed about two drives on a CAN bus: their nodes, their units, and the timing."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from clfcbf.errors import ConfigurationError

__all__ = ["CanTiming", "WheelDrive"]

NODES = (1, 127)
"""Node numbers that CANopen has."""

MASTER = 127
"""Node number of this side: the one with the lowest priority, which drives rarely have."""

TIMEOUT = 0.2
"""[s] Without a command until the quick stop: six periods at 30 Hz, 4 cm at 0.22 m/s, and less
than the controllers believe a command to be held."""

STATUS = 0.02
"""[s] Between status frames: faster than the loop, 1 % of a bus at 500 kbit/s for two drives."""

HEARTBEAT = 0.05
"""[s] Between heartbeats, of the drives and of this side."""

SILENCE = 0.25
"""[s] Without a heartbeat or a status frame until a drive is taken for lost: five heartbeats,
which no loaded machine mistakes for a broken cable."""

REACTION = 0.25
"""[s] For a drive to report the state it was led to: a dozen status frames."""

STARTUP = 3.0
"""[s] For each drive's start: some forty transfers and five states, each up to 0.05 s."""


@dataclass(frozen=True, slots=True)
class WheelDrive:
    r"""One wheel's drive.

    The target velocity is :math:`q = \mathrm{round}(k\,\dot\varphi)` for a wheel rate
    :math:`\dot\varphi` [rad/s]. A motor behind a gear :math:`i` commanded in rpm has
    :math:`k = 60\,i/2\pi`, in increments per second of an encoder of :math:`n`
    :math:`k = n\,i/2\pi`.

    Attributes
    ----------
    node : node number on the bus, 1 to 127
    scale : :math:`k` [drive units per rad/s of the wheel], negative where the motor is mounted
        the other way round
    acceleration_scale : of the ramps [drive units per rad/s²]; ``abs(scale)`` if not given

    Raises
    ------
    ConfigurationError : a value is out of its range
    """

    node: int
    scale: float
    acceleration_scale: float | None = None

    def __post_init__(self) -> None:
        low, high = NODES
        if isinstance(self.node, bool) or not isinstance(self.node, int):
            raise ConfigurationError(f"node must be an integer, got {self.node!r}")
        if not low <= self.node <= high:
            raise ConfigurationError(f"node must be in [{low}, {high}], got {self.node!r}")
        if not (math.isfinite(self.scale) and self.scale != 0.0):
            raise ConfigurationError(f"scale must be finite and not 0, got {self.scale!r}")
        ramps = self.acceleration_scale
        if ramps is not None and not 0.0 < ramps < math.inf:
            raise ConfigurationError(
                f"acceleration_scale must be finite and positive, got {ramps!r}"
            )

    def units(self, rate: float) -> int:
        """Target velocity [drive units] of a wheel rate [rad/s]."""
        return round(self.scale * rate)

    def rate(self, units: float) -> float:
        """Wheel rate [rad/s] of a velocity [drive units]."""
        return units / self.scale + 0.0  # no -0.0 from a mirrored drive at rest

    def ramp(self, acceleration: float) -> int:
        """A wheel's acceleration [rad/s²] in drive units, at least 1, for 0 would never stop."""
        scale = self.acceleration_scale
        return max(1, round((abs(self.scale) if scale is None else scale) * acceleration))


@dataclass(frozen=True, slots=True)
class CanTiming:
    """Periods and time-outs of the bus, all [s].

    Attributes
    ----------
    timeout : without a command, until both drives stop quickly
    status : between two status frames of a drive
    heartbeat : between two heartbeats, of the drives and of this side
    silence : without a drive's heartbeat or status frame, until it is taken for lost; as long
        the drives wait for this side's heartbeat, and twice ``timeout`` for a command frame
    reaction : for a drive to report the state that it was led to
    startup : for the start of one drive

    Raises
    ------
    ConfigurationError : a value is not finite and at least 1 ms, or ``silence`` is shorter than
        two heartbeats or status frames
    """

    timeout: float = TIMEOUT
    status: float = STATUS
    heartbeat: float = HEARTBEAT
    silence: float = SILENCE
    reaction: float = REACTION
    startup: float = STARTUP

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 1e-3 <= value <= 30.0:  # whole milliseconds in 16 bits, twice the time-out too
                raise ConfigurationError(f"{field.name} must be in [0.001, 30] s, got {value!r}")
        if self.silence < 2.0 * max(self.heartbeat, self.status):
            raise ConfigurationError(
                f"silence must be at least two heartbeats and status frames, {self.heartbeat:g} s "
                f"and {self.status:g} s, got {self.silence!r}"
            )
