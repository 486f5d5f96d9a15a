"""Which part of a control loop failed, how, when, and how often: also what a run survived."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

__all__ = ["Part", "PartFailure", "Tally"]


class Part(Enum):
    """What a loop is made of."""

    SENSOR = "sensor"
    CHASSIS = "chassis"
    CONTROLLER = "controller"
    SOLVER = "solver"
    """The controller's backend of the quadratic program."""
    CLOCK = "clock"
    OBSERVER = "observer"
    """What is called after each tick, ``on_tick``."""
    MACHINE = "machine"
    """Everything else that runs on the computer: the process was not given its time."""


class PartFailure(NamedTuple):
    """One way in which one part failed during a run.

    Attributes
    ----------
    part : which
    what : in a word or two: "raised", "silent", "late" ...
    reason : in words, as of the last time
    first, last : when it was noticed first and last, on the loop's clock [s]
    ticks : in which it was
    """

    part: Part
    what: str
    reason: str
    first: float
    last: float
    ticks: int

    def __str__(self) -> str:
        times = f", {self.ticks} ticks" if self.ticks > 1 else ""
        return f"{self.part.value} {self.what}: {self.reason}{times}"


class Tally:
    """Collects the failures of a run; the same way of the same part is one failure."""

    __slots__ = ("_found",)

    def __init__(self) -> None:
        self._found: dict[tuple[Part, str], PartFailure] = {}

    def note(self, part: Part, what: str, reason: str, now: float) -> None:
        """``part`` failed at ``now`` [s]."""
        before = self._found.get((part, what))
        first, ticks = (now, 0) if before is None else (before.first, before.ticks)
        self._found[part, what] = PartFailure(part, what, reason, first, now, ticks + 1)

    def failures(self) -> tuple[PartFailure, ...]:
        """All of them, in the order in which they were first noticed."""
        return tuple(self._found.values())
