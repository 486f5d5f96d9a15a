"""What a run of the loop tells of its parts: who raised, who was silent, who took the time."""

from __future__ import annotations

import math
from typing import NamedTuple

from clfcbf.decision import Decision, Event, Status
from clfcbf.runtime.braking import Braking
from clfcbf.runtime.parts import Part, PartFailure, Tally
from clfcbf.se2 import Twist

__all__ = ["TickTimes", "Watch"]

_REST = Twist(0.0, 0.0)

STANDING = 1e-3
"""[m/s, rad/s] Command up to which a base that reports zero has merely rounded it."""

_FAULTS = {
    Status.INTERNAL_ERROR: (Part.CONTROLLER, "raised inside"),
    Status.SOLVER_FAILED: (Part.SOLVER, "gave no answer"),
    Status.CLOCK_ERROR: (Part.CLOCK, "did not advance"),
}
"""What a decision's status says of a part."""


class TickTimes(NamedTuple):
    """When a tick was due, when it began, and when each part in turn had answered [s]."""

    due: float
    begun: float
    observed: float
    asked: float
    decided: float


class Watch:
    """Follows one run; the loop says which part it is ``at``.

    Parameters
    ----------
    period : of the ticks [s]
    patience : longest time without a new measurement [s]
    """

    def __init__(self, period: float, patience: float) -> None:
        self._period = period
        self._patience = patience
        self._tally = Tally()
        self._crowded: tuple[Part, float] | None = None
        self.at = Part.CLOCK
        """The part that answers now: the one to blame for an exception."""
        self.now = math.nan
        """When the tick began [s]."""
        self.heard = math.nan
        """When a new measurement was taken last, or the run began [s]."""

    def failures(self) -> tuple[PartFailure, ...]:
        """All that was noted, in the order in which it was first."""
        return self._tally.failures()

    def raised(self, part: Part, error: BaseException) -> None:
        """A part raised; what is no Exception, such as an interrupt, is nobody's failure."""
        if isinstance(error, Exception):
            self._tally.note(part, "raised", f"{type(error).__name__}: {error}", self.now)

    def decided(
        self, decision: Decision, applied: Twist, braking: Braking, times: TickTimes
    ) -> None:
        """Note what a tick that goes on tells of the parts.

        Parameters
        ----------
        applied : what the chassis gave as the command in force
        braking : knows the command sent last
        """
        now, note = times.begun, self._tally.note
        silence = now - self.heard
        # Near the goal a controller stops for want of measurements before that.
        if silence > self._patience or Event.UNCERTAIN in decision.events:
            note(Part.SENSOR, "silent", f"no new measurement for {silence:.1f} s", now)
        known = braking.known(applied)
        if known != applied:
            note(Part.CHASSIS, "unusable", f"command in force given as {applied!r}", now)
        sent = braking.sent
        if known == _REST and max(abs(sent[0]), abs(sent[1])) > STANDING:
            note(Part.CHASSIS, "stopped by itself", f"after the command {sent!r}", now)
        answer, status = decision.answer, decision.status
        if answer is not None and answer.health is not None and not answer.health.used:
            health = answer.health
            how = "gave a wrong answer" if health.refused else "gave no answer"
            note(Part.SOLVER, how, f"{health.backend!r}: {health.note or health.status}", now)
        if status in _FAULTS:
            note(*_FAULTS[status], decision.reason or status.value, now)
        elif status is Status.INVALID_INPUT and known == applied:
            note(Part.SENSOR, "unusable", "a measurement or its stamp is not sound", now)
        if times.decided > times.due + self._period:
            part, duration = self.culprit(times)
            late = f"took {duration:.3f} s of a period of {self._period:.3f} s"
            if part is Part.CONTROLLER and answer is not None and answer.health is not None:
                late += f", with the solver {answer.health.backend!r} in it"
            note(part, "late", late, now)

    def ended(self, due: float, decided: float, sent: float, told: float) -> None:
        """A tick is over: who made the next one late, if it is due already.

        Parameters
        ----------
        due : when the next tick is [s]
        decided, sent, told : when this one's command was decided, sent and passed on [s]
        """
        self._crowded = None
        if told > due:
            part = Part.CHASSIS if sent - decided > told - sent else Part.OBSERVER
            self._crowded = part, max(sent - decided, told - sent)

    def culprit(self, times: TickTimes) -> tuple[Part, float]:
        """Who took most of a tick that missed its deadline, and how long [s]."""
        due, begun, observed, asked, decided = times
        before = self._crowded or (Part.MACHINE, begun - due)
        spent = [
            before, (Part.SENSOR, observed - begun), (Part.CHASSIS, asked - observed),
            (Part.CONTROLLER, decided - asked),
        ]  # fmt: skip
        return max(spent, key=lambda entry: entry[1])
