r"""What the library asks of a robot: chassis, target sensor, clock and manipulator.

Units are SI, angles radians. The robot frame is REP-103's ``base_link``: its origin at the
rotation centre (the middle of the driven axle), x forward, y left, angles counter-clockwise.
What a camera measures in an optical frame (z forward, x right) is converted by the adapter;
poses are relative to the robot, so the ``map`` frame of REP-105, which may jump, never enters.

Timing: all stamps are on one monotonic clock, the loop's. No method waits: each returns within a
small part of the control period, and what takes longer (a bus, a camera) runs in the adapter's
own thread and leaves its newest result behind. The loop calls every method from one thread, but
for ``stop``, which any thread may call at any time, also while another method runs.

Failure: an adapter raises, whatever exception, and never pretends. The loop answers any exception
with the brake and then ``stop``. An adapter never repeats a command or a measurement by itself;
what must happen when the loop is gone is the chassis's own time-out.

:mod:`clfcbf.hardware.conformance` puts an adapter to these rules.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol, runtime_checkable

from clfcbf.scene import Observation
from clfcbf.se2 import Twist

__all__ = ["Chassis", "Clock", "Grip", "Manipulator", "TargetSensor"]


@runtime_checkable
class Chassis(Protocol):
    """A base that follows twists (x forward, counter-clockwise; SI units).

    On failure: a command that cannot be passed on raises, and is not reported as applied. With
    no command for longer than its own time-out (a few control periods) the base stops by itself:
    no process can promise to outlive every fault.
    """

    def send(self, twist: Twist) -> None:
        """Take ``twist`` [m/s, rad/s] as the command from now on; returns without waiting.

        A twist that is not finite is refused with an exception, and changes nothing.
        """

    def applied(self) -> Twist:
        """The command last accepted, as it was sent: never odometry.

        Where the base clips or rounds commands, the clipped one. Zero before the first command,
        after ``stop`` and after the base's own time-out.
        """

    def stop(self) -> None:
        """Stop at once; must work at any time, from any thread and any number of times.

        Either a later ``send`` is accepted again, or it raises until the base is released: it
        is not swallowed.
        """


@runtime_checkable
class TargetSensor(Protocol):
    """Whatever measures where the target is.

    On failure: what was not seen is None, not a guess and not the last measurement again; a
    sensor that has stopped working raises.
    """

    def observe(self) -> Observation | None:
        """The newest measurement not yet handed out, or None; returns without waiting.

        Its stamp is the time of capture [s], not of delivery, on the loop's clock; stamps
        increase from one measurement to the next.
        """


@runtime_checkable
class Clock(Protocol):
    """Monotonic time for the loop and the stamps, and the waiting for it."""

    def now(self) -> float:
        """Time [s] since a fixed instant; never jumps, never runs backward."""

    def sleep_until(self, time: float) -> None:
        """Return at ``time`` [s] on this clock or as soon after as can be, never before.

        A time that is past returns at once. Signal handlers run meanwhile.
        """


class Grip(Enum):
    """State of a manipulator's hold on the target."""

    OPEN = "open"
    MOVING = "moving"
    HOLDING = "holding"
    """Closed, and something is held."""
    EMPTY = "empty"
    """Closed, and nothing is held."""
    FAULT = "fault"
    """Neither is known; ``release`` may clear it."""


@runtime_checkable
class Manipulator(Protocol):
    """What takes hold of the target once the robot is docked: a gripper, a latch, a fork.

    On failure: ``grip`` says FAULT, and stays in it until ``release`` has cleared it; power that
    fails leaves the grip as it is, so that a load is not dropped.
    """

    def grasp(self) -> None:
        """Begin to close; returns without waiting. Closing or closed already, it does nothing."""

    def release(self) -> None:
        """Begin to open; returns without waiting. Opening or open already, it does nothing."""

    def grip(self) -> Grip:
        """The state now, as measured, not as commanded; returns without waiting."""

    def stop(self) -> None:
        """Hold still at once; must work at any time, from any thread, any number of times."""
