"""What the node tells beside its commands: feedback of the task, and diagnostics of the parts."""

from __future__ import annotations

import math

from clfcbf.recorder import FlightRecorder
from clfcbf.ros2.diagnostics import (
    Diagnostics,
    Level,
    decision_status,
    loop_status,
    status_of,
    target_status,
)
from clfcbf.ros2.messages import DiagnosticStatus
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.tasks import Goal, TaskServer
from clfcbf.runtime import ControlLoop, Tick
from clfcbf.session import Feedback, SessionState

__all__ = ["Reports"]

FEEDBACK = 0.1
"""[s] Between two feedbacks of one state: what people see as continuous."""


class Reports:
    """Says how things are, as often as somebody wants to know.

    Parameters
    ----------
    tasks, diagnostics : where it is told
    target, recorder : parts that it is told of
    """

    def __init__(
        self,
        tasks: TaskServer,
        diagnostics: Diagnostics,
        target: TopicTarget,
        recorder: FlightRecorder | None,
    ) -> None:
        self._tasks = tasks
        self._diagnostics = diagnostics
        self._target = target
        self._recorder = recorder
        self._told: tuple[SessionState, int, float] = (SessionState.NONE, 0, -math.inf)
        self._ignored: dict[str, int] = {}

    def of_tick(self, goal: Goal, feedback: Feedback, tick: Tick, loop: ControlLoop) -> None:
        """After a tick of a task."""
        state, retries, told_at = self._told
        now = tick.sent
        news = (feedback.state, feedback.num_retries) != (state, retries)
        if news or now - told_at >= FEEDBACK:
            self._told = (feedback.state, feedback.num_retries, now)
            self._tasks.feedback(goal, feedback)
        status = decision_status(tick.decision)
        level = Level(status.level)
        if self._diagnostics.due(now, level):
            running = loop_status(loop.statistics)
            self._diagnostics.tell(now, status, *self._parts(now), running, levels=(level,))

    def without_task(self, trouble: str, now: float) -> None:
        """While nothing is asked for; ``trouble`` is what the last task failed of."""
        if self._diagnostics.due(now):
            level = Level.ERROR if trouble else Level.OK
            status = status_of(level, "controller", trouble or "no task")
            self._diagnostics.tell(now, status, *self._parts(now))

    def _parts(self, now: float) -> list[DiagnosticStatus]:
        """How the parts around the controller are doing."""
        statuses = [target_status(self._target, now, self._ignored)]
        self._ignored = {
            refusal.value.replace(" ", "_"): n for refusal, n in self._target.counts.items()
        }
        if (recorder := self._recorder) is not None:
            error = recorder.error
            level = Level.OK if error is None else Level.WARN
            text = "recording" if error is None else f"not recording: {error}"
            statuses.append(status_of(level, "recorder", text, dropped=recorder.dropped))
        return statuses
