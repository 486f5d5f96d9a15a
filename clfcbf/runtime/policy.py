"""What the loop does about late ticks and old measurements, and how a run can end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from clfcbf import defaults
from clfcbf.decision import Decision
from clfcbf.errors import ConfigurationError
from clfcbf.runtime.parts import Part, PartFailure
from clfcbf.runtime.statistics import LoopStatistics

__all__ = ["Ending", "LoopPolicy", "LoopReport", "Overrun"]

MISSES = 15
"""Deadlines missed in a row that end a run: half a second at 30 Hz in which nothing of what was
certified was true, and by which no garbage collection or other process goes on."""

WINDOW = 36_000
"""Ticks that the statistics remember: 20 minutes at 30 Hz, 1.2 MB."""

LARGEST_WINDOW = 10_000_000
"""Four days at 30 Hz, 320 MB: more is another number in the wrong place."""


class Overrun(Enum):
    """What goes out in a tick whose decision comes after its deadline."""

    BRAKE = "brake"
    """The brake's next command: the decision was made for a time that is over."""
    SEND = "send"
    """The decision all the same: inside the limits, but not certified."""
    STOP = "stop"
    """The brake, to the end: one late decision ends the run."""


class Ending(Enum):
    """Why a run ended."""

    DONE = "done"
    """The controller said so, and the robot stands."""
    FAILED = "failed"
    """The controller gave up, and the robot stands."""
    TIMEOUT = "timeout"
    """The time given to ``run`` was over."""
    STOPPED = "stopped"
    """``ControlLoop.stop`` was called."""
    SIGNAL = "signal"
    """SIGINT or SIGTERM."""
    OVERRUN = "overrun"
    """Too many deadlines were missed in a row."""
    ERROR = "error"
    """Something raised an exception."""


@dataclass(frozen=True, slots=True)
class LoopPolicy:
    """What is done where a tick is late or a measurement old.

    Attributes
    ----------
    overrun : what goes out in place of a decision that comes after its deadline
    misses : deadlines missed in a row that end the run, at least 1
    max_age : age of a measurement above which it is not passed on [s]
    window : ticks that the statistics remember, at least 1 and at most ten million

    Raises
    ------
    ConfigurationError : a value is out of its range
    """

    overrun: Overrun = Overrun.BRAKE
    misses: int = MISSES
    max_age: float = defaults.PATIENCE
    window: int = WINDOW

    def __post_init__(self) -> None:
        if not isinstance(self.overrun, Overrun):
            choices = ", ".join(str(choice) for choice in Overrun)
            raise ConfigurationError(f"overrun must be one of {choices}, got {self.overrun!r}")
        for name in ("misses", "window"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise ConfigurationError(f"{name} must be an integer >= 1, got {value!r}")
        if self.window > LARGEST_WINDOW:
            raise ConfigurationError(f"window must be at most {LARGEST_WINDOW}, got {self.window}")
        if not (math.isfinite(self.max_age) and self.max_age > 0.0):
            raise ConfigurationError(
                f"max_age must be finite and positive [s], got {self.max_age!r}"
            )


@dataclass(frozen=True, slots=True)
class LoopReport:
    """How a run ended.

    Attributes
    ----------
    ending : why
    decision : the controller's last, None where it made none
    statistics : of the ticks
    braked : commands that the loop's own brake sent at the end
    signal : number of the signal that ended it, 0 where none did
    error : what was raised, None where nothing was
    brake_error : what cut the brake short, so that ``stop`` came at speed
    stop_error : what the chassis's ``stop`` raised at the end; then it may still be moving
    part : whose exception ended the run, or whose slowness; None where neither did
    failures : all failures of parts, in order, also those that the run survived
    """

    ending: Ending
    decision: Decision | None
    statistics: LoopStatistics
    braked: int = 0
    signal: int = 0
    error: BaseException | None = None
    brake_error: BaseException | None = None
    stop_error: BaseException | None = None
    part: Part | None = None
    failures: tuple[PartFailure, ...] = ()
