"""Where a task is: its stage, the one that follows once the robot stands, its clock, its end."""

from __future__ import annotations

import math
from enum import Enum

from clfcbf.session.docks import Dock
from clfcbf.session.interface import ErrorCode, Feedback, SessionResult, SessionState
from clfcbf.session.policy import SessionPolicy

__all__ = ["Progress", "Stage"]


class Stage(Enum):
    """What the session does, and the state that the feedback shows for it."""

    IDLE = ("idle", SessionState.NONE)
    STAGING = ("staging", SessionState.NAV_TO_STAGING_POSE)
    PERCEIVING = ("perceiving", SessionState.INITIAL_PERCEPTION)
    APPROACHING = ("approaching", SessionState.CONTROLLING)
    CONFIRMING = ("confirming", SessionState.WAIT_FOR_CHARGE)
    RETREATING = ("retreating", SessionState.RETRY)
    PAUSING = ("pausing", SessionState.RETRY)
    UNDOCKING = ("undocking", SessionState.NONE)
    ENDED = ("ended", SessionState.NONE)


class Progress:
    """Stages follow one another only at rest: what is decided under way waits in ``following``.

    Attributes
    ----------
    stage, following : now, and once the robot stands; None where it goes on
    dock : of the task, or of the last one
    ending : how the task ends once the robot stands
    result : how it has ended, None until then
    retries : attempts after the first
    """

    __slots__ = (
        "_begun", "_now", "_policy", "_since", "dock", "ending", "following", "result", "retries",
        "stage",
    )  # fmt: skip

    def __init__(self, policy: SessionPolicy) -> None:
        self._policy = policy
        self.stage = Stage.IDLE
        self.following: Stage | None = None
        self.dock: Dock | None = None
        self.ending: SessionResult | None = None
        self.result: SessionResult | None = None
        self.retries = 0
        self._begun = self._since = self._now = math.nan

    @property
    def active(self) -> bool:
        """Whether a task is in progress."""
        return self.stage not in (Stage.IDLE, Stage.ENDED) or self.following is not None

    @property
    def feedback(self) -> Feedback:
        """State, duration and retries as of the last tick."""
        elapsed = self._now - self._begun
        return Feedback(self.stage.value[1], elapsed if elapsed > 0.0 else 0.0, self.retries)

    def begin(self, dock: Dock, first: Stage) -> None:
        """A new task, whose time runs from the next tick on."""
        self.dock, self.following = dock, first
        self.ending = self.result = None
        self.retries = 0
        self._begun = math.nan

    def refuse(self, code: ErrorCode, message: str) -> None:
        """A task that cannot begin has ended."""
        self.ending = self.result = SessionResult(False, code, 0, message)
        self.stage = Stage.ENDED

    def tick(self, now: float, canceled: bool) -> None:
        """It is ``now`` [s]: a task in progress may have to end for it."""
        self._now = now
        if not self.active or self.ending is not None:
            return
        if math.isnan(self._begun):
            self._begun = now
        if canceled:
            self.end(ErrorCode.NONE, "canceled", canceled=True)
        elif now - self._begun > self._policy.max_time:
            self.end(ErrorCode.TIMEOUT, f"not done within {self._policy.max_time:g} s")

    def enter(self, stage: Stage) -> None:
        """The robot stands, and the stage begins."""
        self.stage, self.following, self._since = stage, None, self._now
        if stage is Stage.ENDED:
            self.result = self.ending

    def waited(self, duration: float) -> bool:
        """Whether the stage has lasted for longer than that [s]."""
        return self._now - self._since > duration

    def end(self, code: ErrorCode, message: str = "", canceled: bool = False) -> None:
        """End the task once the robot stands."""
        success = code is ErrorCode.NONE and not canceled
        self.ending = SessionResult(success, code, self.retries, message, canceled)
        self.following = Stage.ENDED

    def failed(self, code: ErrorCode, message: str) -> None:
        """An attempt has failed: another follows, from further back if it had begun to move."""
        if self.retries >= self._policy.max_retries:
            self.end(code, message)
            return
        self.retries += 1
        seen = self.stage is not Stage.PERCEIVING
        self.following = Stage.RETREATING if seen else Stage.PAUSING
