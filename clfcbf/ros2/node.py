"""The docking node: goals in, commands, feedback, results and diagnostics out.

Without a task it is silent, so that teleoperation or navigation have the base to themselves. A
task is one run of the control loop around the docking session; whatever ends it, zero is the last
command of it. All messages are looked at in the loop's own thread: nothing of it runs beside the
loop.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from pathlib import Path

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.protocols import Clock
from clfcbf.recorder import FlightRecorder, SessionRecorder
from clfcbf.ros2.chassis import TopicChassis
from clfcbf.ros2.diagnostics import Diagnostics
from clfcbf.ros2.messages import Clock as ClockMessage
from clfcbf.ros2.parameters import NodeSettings
from clfcbf.ros2.reports import Reports
from clfcbf.ros2.sim_time import SimulatedTime
from clfcbf.ros2.stamps import Stamps
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.tasks import Goal, TaskServer
from clfcbf.ros2.transport import CLOCK, Transport, absolute
from clfcbf.runtime import ControlLoop, Ending, LoopReport, Tick
from clfcbf.runtime.loop import LoopController
from clfcbf.runtime.signals import caught
from clfcbf.session import (
    Dock,
    DockContact,
    DockingSession,
    ErrorCode,
    PhaseControllers,
    SessionResult,
)

__all__ = ["DockingNode"]

IDLE = 0.02
"""[s] Between two looks for a goal: nobody minds it, and it takes no computing time."""

DISCOVERY = 5.0
"""[s] That a goal waits for base and detector: between two announcements of a participant, of which
the first may come too early, Fast DDS lets three pass."""

WINDOW = 900
"""Ticks that the diagnostics' percentiles are of: 30 s at 30 Hz, sorted in 0.1 ms."""


_ASKED = (Ending.SIGNAL, Ending.STOPPED)


class DockingNode:
    """Exposes a docking session on ROS 2 topics, by whatever transport.

    Parameters
    ----------
    settings : see :func:`~clfcbf.ros2.parameters.settings_of`
    transport : that carries the messages; it is not closed with the node
    namespace : of the topics
    contact : what the dock tells; by default nothing, and the pose decides
    record : log of all ticks of all tasks, for replay (needs the extra ``record``)

    Raises
    ------
    ConfigurationError : a topic's name is none, or a setting is refused by what it is for

    Attributes
    ----------
    chassis, target : the adapters
    """

    def __init__(
        self,
        settings: NodeSettings,
        transport: Transport,
        namespace: str = "",
        *,
        contact: DockContact | None = None,
        record: Path | str | None = None,
    ) -> None:
        self._settings = settings
        config = settings.config
        self._clock: Clock = MonotonicClock()
        self._stamps = Stamps(self._clock)
        if settings.use_sim_time:
            clock = transport.subscription(ClockMessage, "/clock", CLOCK)
            self._clock = SimulatedTime(clock)
            self._stamps = Stamps(self._clock, None)
        self.chassis = TopicChassis(
            transport, self._clock, self._stamps, absolute(namespace, settings.cmd_vel_topic),
            stamped=settings.stamped, frame=settings.base_frame, timeout=settings.cmd_vel_timeout,
        )  # fmt: skip
        self.target = TopicTarget(
            transport, self._clock, self._stamps, config.standoff,
            absolute(namespace, settings.detection_topic), frame=settings.detection,
            max_age=config.loop.max_age,
        )  # fmt: skip
        self._tasks = TaskServer(transport, namespace)
        self._recorder = (
            None if record is None else FlightRecorder(record, config.controller().config)
        )
        self._reports = Reports(
            self._tasks, Diagnostics(transport, self._stamps), self.target, self._recorder
        )
        self._watch: SessionRecorder | None = None
        self._contact = contact
        self._policy = replace(config.loop, window=min(config.loop.window, WINDOW))
        self._session = self._new_session()
        self._loop: ControlLoop | None = None
        self._goal: Goal | None = None
        self._asked = threading.Event()
        self._trouble = ""

    @property
    def busy(self) -> bool:
        """Whether a task is in progress."""
        return self._goal is not None

    def stop(self) -> None:
        """Ask the node to end, from any thread; a task in progress brakes first."""
        self._asked.set()
        if (loop := self._loop) is not None:
            loop.stop()

    def run(self, tasks: float = math.inf) -> None:
        """Serve goals until ``stop``, SIGINT or SIGTERM, or until as many tasks have ended.

        Parameters
        ----------
        tasks : to perform; rejected goals do not count

        Notes
        -----
        What raises in a task ends that task, not the node: the robot brakes, the result says so.
        """
        with caught(lambda _: self.stop()):
            while tasks > 0 and not self._asked.is_set():
                goals = self._tasks.goals()
                if goals:
                    tasks -= self._perform(goals[0])
                    for goal in goals[1:]:
                        self._tasks.reject(goal, "another goal came first")
                else:
                    self._tasks.canceled()  # there is nothing to end
                    self._idle()
                    time.sleep(IDLE)

    def close(self) -> None:
        """Publish zero, see it off, and end the logs."""
        try:
            self.chassis.close()
            self._tasks.flush(self._settings.cmd_vel_timeout)
        finally:
            if self._recorder is not None:
                self._recorder.close()

    # Tasks ---------------------------------------------------------------------------------

    def _perform(self, goal: Goal) -> bool:
        """Do a task from its begin to its result; whether it was begun."""
        if not self._is_heard():
            self._tasks.reject(goal, "nobody listens to the commands")
            return False
        try:
            goal.begin(self._session)
        except ConfigurationError as error:
            self._tasks.reject(goal, str(error))
            return False
        self._goal, self._trouble = goal, ""
        try:
            result = self._session.result or self._driven()
        finally:
            self._goal = None
        if not result.success and not result.canceled:
            self._trouble = f"{result.error_code.name}: {result.error_msg}"
        self._tasks.result(goal, result)
        return True

    def _driven(self) -> SessionResult:
        """Run the loop until the session has ended, or the loop has for another reason."""
        config = self._settings.config
        self._loop = ControlLoop(
            self._session, self.chassis, self.target, self._clock, period=config.filter.period,
            limits=config.limits, policy=self._policy, on_tick=self._on_tick,
        )  # fmt: skip
        if self._asked.is_set():
            self._loop.stop()
        try:
            # Asked to end meanwhile, the loop ends at its first look.
            why, asked = _words(report := self._loop.run()), report.ending in _ASKED
        except Exception as error:  # of a part; the loop has braked, as far as it could
            why, asked = f"{type(error).__name__}: {error}", False
        finally:
            self._loop = None
        if (result := self._session.result) is not None:
            return result
        self._session = self._new_session()
        if asked:
            self._asked.set()
        code = ErrorCode.NONE if asked else ErrorCode.UNKNOWN
        return SessionResult(False, code, 0, why, canceled=asked)

    def _is_heard(self) -> bool:
        """Whether somebody listens to the commands; waits a while for base and detector."""
        end = time.monotonic() + DISCOVERY
        while not (self.chassis.listeners() and self.target.sources()):
            if time.monotonic() > end or self._asked.is_set():
                break
            time.sleep(IDLE)
        return self.chassis.listeners() > 0

    def _new_session(self) -> DockingSession:
        settings = self._settings
        # What was recorded of a tick that never ended must not be taken for the next one.
        self._watch = None if self._recorder is None else SessionRecorder(self._recorder)
        return DockingSession(
            PhaseControllers(self._approach), settings.docks, settings.config.limits,
            settings.config.filter.period, contact=self._contact, policy=settings.policy,
        )  # fmt: skip

    def _approach(self, _: Dock) -> LoopController:
        made = self._settings.config.controller()
        return made if self._watch is None else self._watch.controller(made)

    # Ticks ---------------------------------------------------------------------------------

    def _on_tick(self, tick: Tick) -> None:
        """Beside each command: record it, look for goals, tell how it goes."""
        if self._watch is not None:
            self._watch.on_tick(tick)
        if self._goal is None or self._loop is None:
            return
        if self._tasks.canceled():
            self._session.cancel()
        for goal in self._tasks.goals():
            self._tasks.reject(goal, f"{self._goal.action.value} is in progress; cancel it first")
        self._reports.of_tick(self._goal, self._session.feedback, tick, self._loop)

    def _idle(self) -> None:
        """Without a task: listen all the same, so that diagnostics tell what would be seen."""
        self.target.observe()
        self._reports.without_task(self._trouble, self._clock.now())


def _words(report: LoopReport) -> str:
    if report.ending is Ending.SIGNAL:
        return f"the node got signal {report.signal}"
    failures = "".join(f"; {failure}" for failure in report.failures)
    return f"the control loop ended: {report.ending.value}{failures}"
