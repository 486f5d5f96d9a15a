"""What one tick decided: the command, how it was reached, and why."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from clfcbf.constraints.rows import Row, Rows
from clfcbf.guard import Verdict
from clfcbf.limits import Limits
from clfcbf.qp.exact import LexicographicSolution, Weight
from clfcbf.se2 import Twist

__all__ = ["Decision", "Event", "Failure", "Phase", "Status"]


class Status(Enum):
    """How the command of a tick was reached, from the best case to the worst."""

    OPTIMAL = "optimal"
    """The program's answer: every row holds, and the guard admitted it."""
    RELAXED = "relaxed"
    """As above, but the Lyapunov row gave way to a barrier or to the limits."""
    BARRIER_RELAXED = "barrier relaxed"
    """The barrier rows could not all hold; the guard admitted the least violation."""
    GUARDED = "guarded"
    """The guard refused the program's answer and sent another admissible command."""
    BRAKING = "braking"
    """Nothing admissible was left: the certified brake."""
    STOPPED = "stopped"
    """No program was run: the controller stands or stops of its own accord, phase tells why."""
    STALE = "stale"
    """No measurement for longer than the patience, or near the goal for longer than dead
    reckoning can be trusted there: braking."""
    NO_TARGET = "no target"
    """The target has not been seen yet: standing, or braking."""
    OUT_OF_VIEW = "out of view"
    """A barrier is violated: turning back toward it, or braking where it is behind the camera."""
    INVALID_INPUT = "invalid input"
    """An input was not finite: braking on what was known before."""
    CLOCK_ERROR = "clock error"
    """The time did not advance: braking."""
    SOLVER_FAILED = "solver failed"
    """No backend gave an answer that stands verification: braking."""
    INTERNAL_ERROR = "internal error"
    """A part raised an exception, which the reason names: braking."""

    @property
    def is_fault(self) -> bool:
        """Whether an input or a part failed, so that the command is a brake."""
        return self in _FAULTS


_FAULTS = frozenset(
    {
        Status.STALE,
        Status.NO_TARGET,
        Status.INVALID_INPUT,
        Status.CLOCK_ERROR,
        Status.SOLVER_FAILED,
        Status.INTERNAL_ERROR,
    }
)


class Phase(Enum):
    """Where a docking run is."""

    WAITING = "waiting"
    TURNING = "turning"
    BACKING_OFF = "backing off"
    APPROACHING = "approaching"
    STOPPING = "stopping"
    UNDOCKING = "undocking"
    SEARCHING = "searching"
    """The target was lost: turning to where it should be, then back along the way it came."""
    DONE = "done"
    FAILED = "failed"


class Event(Enum):
    """What happened to a tick's inputs that its status need not show."""

    UNSEEN = "unseen"
    """No measurement for some frames: dead reckoning."""
    OUTLIER = "outlier"
    """A measurement outside the gate was left out."""
    FLIPPED = "flipped"
    """A measurement of the mirrored target, or of its back, was left out."""
    MOVED = "moved"
    """Several measurements in a row agreed that the target is elsewhere: believed."""
    UNCERTAIN = "uncertain"
    """Near the goal, and dead reckoning is not good enough to go on: waiting for a look."""
    LATE = "late"
    """The last command was held for longer than its period: nothing is certified now."""
    LAPSED = "lapsed"
    """It was held for longer than the chassis does: where the robot is now has to be seen."""


class Failure(Enum):
    """Why a docking run failed."""

    LOST = "lost"
    """The target was not seen for longer than the run waits, the search included."""
    AMBIGUOUS = "ambiguous"
    """As above, while what was measured were mirror images of it."""
    NO_APPROACH = "no approach"
    """No approach from where the robot stands keeps the view and the limits."""
    GAVE_UP = "gave up"
    """As many plans were made as are allowed, and none arrived."""
    UNDOCKING = "undocking"
    """Undocking stopped before its distance."""
    FAULT = "fault"
    """Clock or command in force were unusable for longer than the run waits."""


class Decision(NamedTuple):
    """The outcome of a tick.

    Attributes
    ----------
    twist : the command; finite and inside the tick's input box, whatever went in
    status : how it was reached
    certified : a verified brake is at hand that keeps the barriers, or at least stays inside the
        margins declared for estimates that err
    nominal : the command the law asked for
    clearance : smallest clearance of the barriers now, in their unit; negative outside
    slack : by how much the Lyapunov row gave way [its own unit per unit-norm row]
    barrier_slack : by how much the barrier rows gave way
    rows : the blocks of rows of this tick, most important first
    box : the tick's input box (v_lo, v_hi, w_lo, w_hi)
    done : the task is finished (and the robot stands)
    phase, reason : of a docking run, and why it stopped or failed
    timing : duration of the tick [s]; 0 where the tick was called without a clock
    weight : of the program's distance to the nominal command
    answer : the program's own answer, before the guard; None where there was no program
    verdict : what the guard did with it; None where it was not asked
    limits : of the chassis, which the box was made of
    events : what happened to the inputs that the status need not show
    failure : why a docking run failed; None as long as it has not
    """

    twist: Twist
    status: Status
    certified: bool
    nominal: Twist
    clearance: float
    slack: float = 0.0
    barrier_slack: float = 0.0
    rows: tuple[Rows, ...] = ()
    box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    done: bool = False
    phase: Phase | None = None
    reason: str = ""
    weight: Weight | None = None
    answer: LexicographicSolution | None = None
    verdict: Verdict | None = None
    limits: Limits | None = None
    events: tuple[Event, ...] = ()
    failure: Failure | None = None
    timing: float = 0.0

    def timed(self, duration: float) -> Decision:
        """The same decision with the duration of its tick [s]."""
        return tuple.__new__(Decision, self[:-1] + (duration,))  # noqa: RUF005  # in half the time

    @property
    def named_rows(self) -> dict[str, Row]:
        """Each row ``(a_v, a_omega, b)`` of this tick by name."""
        return {
            name: row
            for block in self.rows
            for name, row in zip(block.names, block.coefficients, strict=True)
        }

    @property
    def margins(self) -> dict[str, float]:
        r"""What each row has to spare at the command sent, :math:`b - a^\top u`, by name.

        Negative where the row gave way or the guard sent another command than the program's.
        """
        v, omega = self.twist
        return {name: b - (a * v + c * omega) for name, (a, c, b) in self.named_rows.items()}

    @property
    def values(self) -> dict[str, float]:
        """The barrier or Lyapunov function behind each row, by name."""
        return {
            name: value
            for block in self.rows
            for name, value in zip(block.names, block.values, strict=True)
        }
