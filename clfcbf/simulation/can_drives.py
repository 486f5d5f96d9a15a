"""Two simulated CiA-402 drives on a virtual CAN bus, and a robot whose wheels they turn.

They answer on python-can's ``virtual`` interface, through which everything in one process can
talk: what is tested or shown with them is the adapter
:class:`~clfcbf.hardware.can_drives.CanDrives` with its real frames. Needs the extra ``can``.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.can_drive import import_canopen
from clfcbf.hardware.can_drives import open_bus
from clfcbf.hardware.can_settings import WheelDrive
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.can_drive import Objects, SimulatedDrive
from clfcbf.simulation.plant import Plant, sub_steps
from clfcbf.wheels import WheelLimits

__all__ = ["CanPlant", "SimulatedDrives"]

POLL = 1e-3
"""[s] Between two looks at the bus: a frame takes a quarter of it at 500 kbit/s."""

RATE = 120.0
"""[Hz] At which a robot takes over its drives' velocities: four times in a tick at 30 Hz."""


class SimulatedDrives:
    """A left and a right drive, served from a thread of their own until ``close``.

    Parameters
    ----------
    channel : of the virtual bus, or a python-can bus to be on in its place
    left, right : node numbers
    now : time [s] that the drives' ramps run on, such as a plant's
    objects : of both drives that differ, see :class:`~clfcbf.simulation.can_drive.SimulatedDrive`

    Attributes
    ----------
    left, right : the drives, into which faults are injected

    Raises
    ------
    MissingExtraError : python-can or canopen is not installed
    """

    def __init__(
        self,
        channel: str | Any,
        left: int = 1,
        right: int = 2,
        now: Callable[[], float] = time.monotonic,
        objects: Objects | None = None,
    ) -> None:
        self._bus = open_bus("virtual", channel) if isinstance(channel, str) else channel
        self._network: Any = import_canopen().Network(self._bus)
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self.left = SimulatedDrive(self._network, left, now, objects)
        self.right = SimulatedDrive(self._network, right, now, objects)
        self._thread = threading.Thread(target=self._serving, name="simulated drives", daemon=True)
        self._thread.start()

    def serve(self) -> None:
        """Let both drives take what is on the bus and report; from any thread."""
        with self._lock:
            while not self._closed.is_set() and (message := self._bus.recv(0.0)) is not None:
                identifier, frame = message.arbitration_id, message.data
                self._network.notify(identifier, frame, message.timestamp)
                for drive in (self.left, self.right):
                    drive.take(identifier, bytes(frame))
            for drive in (self.left, self.right):
                drive.tick()

    def velocities(self) -> tuple[float, float]:
        """Velocities of both shafts now, with everything on the bus taken [drive units]."""
        with self._lock:
            self.serve()
            return self.left.velocity(), self.right.velocity()

    def close(self) -> None:
        """Power off; any number of times."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._thread.join()
        self._bus.shutdown()

    def _serving(self) -> None:
        while not self._closed.wait(POLL):
            self.serve()


class CanPlant:
    """A simulated robot that follows its drives, in place of the commands sent to it.

    The twist of the wheels' rates, as the drives turn them, is the command of the plant behind
    it, whose lag and slip come on top. Stands where a ``Plant`` does, as sensor's subject and as
    clock; commands go to :class:`~clfcbf.hardware.can_drives.CanDrives` instead.

    Parameters
    ----------
    plant : the body, whose time the drives' ramps should run on
    drives : that turn its wheels
    left, right, wheels : units and geometry, as the adapter has them
    """

    def __init__(
        self,
        plant: Plant,
        drives: SimulatedDrives,
        left: WheelDrive,
        right: WheelDrive,
        wheels: WheelLimits,
    ) -> None:
        self._plant = plant
        self._drives = drives
        self._settings = (left, right)
        self._wheels = wheels

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return self._plant.time

    def pose(self) -> Pose2:
        """True pose in the goal's frame."""
        return self._plant.pose()

    def twist(self) -> Twist:
        """True body twist [m/s, rad/s]."""
        return self._plant.twist()

    def send(self, twist: Twist) -> None:
        """Nothing: the drives are the only way to the wheels. Raises ``ConfigurationError``."""
        raise ConfigurationError("commands go through the drives, by CanDrives")

    def applied(self) -> Twist:
        """The twist that the drives turn the wheels for."""
        rates = zip(self._settings, self._drives.velocities(), strict=True)
        return self._wheels.twist_of(*(drive.rate(units) for drive, units in rates))

    def stop(self) -> None:
        """As ``send``."""
        raise ConfigurationError("commands go through the drives, by CanDrives")

    def advance(self, duration: float) -> tuple[Pose2, ...]:
        """Let ``duration`` [s] pass; returns the true pose at the end of every sub-step."""
        count, step = sub_steps(duration, RATE)
        poses: tuple[Pose2, ...] = ()
        for _ in range(count):
            self._plant.send(self.applied())
            poses += self._plant.advance(step)
        return poses

    def contact(self) -> bool:
        """Whether the body has touched anything since the start, if it can tell."""
        touched = getattr(self._plant, "contact", None)
        return touched is not None and bool(touched())

    def move_target(self, shift: Pose2) -> None:
        """Move the target by ``shift``, given in the goal's frame."""
        self._plant.move_target(shift)

    def close(self) -> None:
        """Power the drives off, and release what the body holds."""
        self._drives.close()
        self._plant.close()
