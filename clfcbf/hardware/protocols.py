"""What the library asks of a robot: a chassis that takes twists and a sensor that sees."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from clfcbf.scene import Observation
from clfcbf.se2 import Twist

__all__ = ["Chassis", "TargetSensor"]


@runtime_checkable
class Chassis(Protocol):
    """A base that follows twists (x forward, counter-clockwise; SI units)."""

    def send(self, twist: Twist) -> None:
        """Take ``twist`` as the command from now on; returns without waiting."""

    def applied(self) -> Twist:
        """The command last accepted, as it was sent: never odometry."""

    def stop(self) -> None:
        """Stop at once; must work at any time and any number of times."""


@runtime_checkable
class TargetSensor(Protocol):
    """Whatever measures where the target is."""

    def observe(self) -> Observation | None:
        """The newest measurement not yet handed out, or None; returns without waiting."""
