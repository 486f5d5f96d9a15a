"""A simulated robot as the loop meets a real one: its chassis, its sensor and its clock."""

from __future__ import annotations

import math
from typing import Protocol

from clfcbf.hardware.protocols import Clock
from clfcbf.scene import Observation
from clfcbf.se2 import Twist
from clfcbf.simulation.plant import Plant

__all__ = ["CapturingSensor", "PlantInTheLoop"]

_LEAST = 1e-4
"""[s] Shorter than that the plant is not advanced: a motion of 0.05 mm at 0.5 m/s."""


class CapturingSensor(Protocol):
    """A simulated sensor, which has to be told to look."""

    def capture(self) -> None:
        """Take a frame if one is due at the plant's time."""

    def observe(self) -> Observation | None:
        """The newest measurement delivered and not yet handed out, or None."""


class PlantInTheLoop:
    """Chassis, target sensor and clock of a simulated robot, in one.

    Without ``wall`` time passes only while the loop waits: a run is as fast as the machine and
    the same every time. With the machine's clock as ``wall`` the simulation keeps up with it, so
    everything that a process does to its loop (late wake-ups, other threads, garbage collection)
    happens to the robot. Stamps are on this object's clock, which starts with the plant's.

    Parameters
    ----------
    plant : the simulated chassis
    sensor : a simulated sensor on it, such as ``PoseSensor``
    wall : a clock to keep up with, such as :class:`~clfcbf.hardware.clocks.MonotonicClock`
    """

    def __init__(self, plant: Plant, sensor: CapturingSensor, wall: Clock | None = None) -> None:
        self._plant = plant
        self._sensor = sensor
        self._wall = wall
        self._offset = wall.now() - plant.time if wall is not None else 0.0

    def now(self) -> float:
        """Time since the plant's start [s]."""
        return self._plant.time if self._wall is None else self._wall.now() - self._offset

    def sleep_until(self, time: float) -> None:
        """Let the robot drive until ``time`` [s]."""
        if self._wall is not None:
            self._wall.sleep_until(time + self._offset)
            time = self.now()
        self._advance_to(time)

    def send(self, twist: Twist) -> None:
        """Take ``twist`` as the command from now on."""
        self._catch_up()
        self._plant.send(twist)

    def applied(self) -> Twist:
        """The command last sent."""
        return self._plant.applied()

    def stop(self) -> None:
        """Command zero."""
        self._catch_up()
        self._plant.stop()

    def observe(self) -> Observation | None:
        """Look, and give what has been delivered by now."""
        self._catch_up()
        self._sensor.capture()
        return self._sensor.observe()

    def close(self) -> None:
        """Release what the simulation holds."""
        self._plant.close()

    def _catch_up(self) -> None:
        if self._wall is not None:
            self._advance_to(self.now())

    def _advance_to(self, time: float) -> None:
        """Advance the plant by the difference of the clocks, where it is worth it."""
        elapsed = time - self._plant.time
        if elapsed >= _LEAST or (self._wall is None and elapsed > 0.0):
            if self._plant.time + elapsed < time:  # by rounding, and no clock wakes early
                elapsed = math.nextafter(elapsed, math.inf)
            self._plant.advance(elapsed)
