"""What a docking session tells and what it asks: states and error codes, contact, controllers.

States and codes are those of Nav2's ``DockRobot`` action, by name and by number, so that a server
in front of a session passes them on as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol, runtime_checkable

from clfcbf.decision import Decision
from clfcbf.errors import ConfigurationError
from clfcbf.runtime.loop import LoopController
from clfcbf.scene import Observation
from clfcbf.se2 import Twist
from clfcbf.session.docks import Dock

__all__ = [
    "DockContact",
    "ErrorCode",
    "Feedback",
    "PhaseControllers",
    "SessionResult",
    "SessionState",
    "UndockingController",
    "Unsensed",
    "reverse_out",
]


class SessionState(IntEnum):
    """What a session does; numbers as in the action's feedback."""

    NONE = 0
    """Nothing, or it undocks, for which the action has no state."""
    NAV_TO_STAGING_POSE = 1
    INITIAL_PERCEPTION = 2
    CONTROLLING = 3
    WAIT_FOR_CHARGE = 4
    """Waiting for confirmation, of whatever kind."""
    RETRY = 5
    """Backing off, and waiting before the next attempt."""


class ErrorCode(IntEnum):
    """Why a session failed; numbers as in the action's result."""

    NONE = 0
    DOCK_NOT_IN_DB = 901
    DOCK_NOT_VALID = 902
    FAILED_TO_STAGE = 903
    FAILED_TO_DETECT_DOCK = 904
    FAILED_TO_CONTROL = 905
    FAILED_TO_CHARGE = 906
    """Docked, but not confirmed."""
    TIMEOUT = 907
    """The session as a whole took too long."""
    UNKNOWN = 999
    """A part raised an exception, which the message names."""


class Feedback(NamedTuple):
    """How a session is doing: its state, its duration so far [s], and the retries begun."""

    state: SessionState
    docking_time: float
    num_retries: int


class SessionResult(NamedTuple):
    """How a session ended.

    Attributes
    ----------
    success : the robot is docked and confirmed, or undocked
    error_code : why not
    num_retries : attempts after the first
    error_msg : the same in words
    canceled : it was asked to end, and stands; then there is no error
    """

    success: bool
    error_code: ErrorCode
    num_retries: int
    error_msg: str = ""
    canceled: bool = False


@runtime_checkable
class DockContact(Protocol):
    """What dock and robot know of each other; every method returns without waiting."""

    def docked(self) -> bool:
        """Whether there is contact now: a switch, a motor current, a voltage at the pins."""

    def confirmed(self) -> bool:
        """Whether docking has had its effect: it charges, or the gripper holds."""

    def release(self) -> None:
        """Begin to let go: switch the charging current off, open the gripper."""

    def released(self) -> bool:
        """Whether it has let go."""


class Unsensed:
    """A dock that tells nothing: the pose alone decides."""

    def docked(self) -> bool:
        """No contact is ever sensed."""
        return False

    def confirmed(self) -> bool:
        """Confirmed by standing there."""
        return True

    def release(self) -> None:
        """There is nothing to let go of."""

    def released(self) -> bool:
        """There is nothing that holds."""
        return True


@runtime_checkable
class UndockingController(Protocol):
    """A controller that can also reverse out, such as ``DockingController``."""

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick."""

    def undock(self, distance: float) -> None:
        """From the next tick on reverse straight out by ``distance`` [m], then be done."""


def reverse_out(approach: LoopController, dock: Dock, distance: float) -> LoopController:
    """The approach's own controller, told to reverse, with all that it knows of the target.

    Raises
    ------
    ConfigurationError : it cannot
    """
    if not isinstance(approach, UndockingController):
        raise ConfigurationError(
            f"{type(approach).__name__} has no undock(); give a controller for retreat"
        )
    approach.undock(distance)
    return approach


@dataclass(frozen=True, slots=True)
class PhaseControllers:
    """Who drives in which phase.

    Attributes
    ----------
    approach : makes the controller of one attempt
    stage : makes the one that drives to ``dock.staging_pose``, such as a client of a navigation
        stack; None where the robot is brought there otherwise
    retreat : makes the one that goes back, out of the approach's controller, the dock and the
        distance [m]; by default the approach's own reverses
    """

    approach: Callable[[Dock], LoopController]
    stage: Callable[[Dock], LoopController] | None = None
    retreat: Callable[[LoopController, Dock, float], LoopController] = reverse_out
