"""The flight recorder of a docking session: who decided each tick, and what was decided.

A session passes a tick on to the controller of its phase, or brakes by itself; which of the two,
and when an attempt begins with another controller, depends on time-outs, contacts and requests.
Those choices are recorded as they were made, and every command is computed again in the replay:
the controller's by its tick, the session's own by its brake.
"""

from __future__ import annotations

from typing import NamedTuple

from clfcbf.controller import DockingController
from clfcbf.decision import Decision
from clfcbf.docking import DockingInputs
from clfcbf.recorder.entries import Given, SessionInputs, in_the_loop
from clfcbf.recorder.flight import FlightRecorder
from clfcbf.runtime.loop import LoopController, Tick
from clfcbf.scene import Observation
from clfcbf.se2 import Twist

__all__ = ["SessionRecorder"]


class _Driven(NamedTuple):
    """The step of a controller within a session's tick; no inputs where it is not recorded."""

    now: float
    decision: Decision
    inputs: DockingInputs | None


class SessionRecorder:
    """Stands between a docking session and a flight recorder.

    Parameters
    ----------
    recorder : made with the configuration that all recorded controllers of the session have

    Examples
    --------
    >>> with FlightRecorder("run.mcap", make().config) as recorder:  # doctest: +SKIP
    ...     watch = SessionRecorder(recorder)
    ...     approach = PhaseControllers(lambda dock: watch.controller(make()))
    ...     session = DockingSession(approach, docks, limits, period)
    ...     loop = ControlLoop(session, ..., on_tick=watch.on_tick)
    """

    def __init__(self, recorder: FlightRecorder) -> None:
        self._recorder = recorder
        self._driven: _Driven | None = None

    def controller(self, controller: DockingController) -> LoopController:
        """A controller that has decided nothing yet, recorded from its first tick on."""
        self._recorder.task(fresh=True)
        return _Recorded(controller, self)

    def foreign(self, controller: LoopController) -> LoopController:
        """A controller that a replay cannot compute, such as of staging; its commands are kept."""
        return _Foreign(controller, self)

    def on_tick(self, tick: Tick) -> None:
        """Take a tick of the loop around the session; never waits, never raises."""
        driven, self._driven = self._driven, None
        if driven is not None and driven.now != tick.begun:  # of a tick that something else ended
            driven = None
        loop = in_the_loop(tick)
        if driven is not None and driven.inputs is not None:
            self._recorder.given(Given(driven.inputs, tick.begun, driven.decision, loop))
            return
        inputs = SessionInputs(tick.observation, tick.applied, driven is not None)
        self._recorder.given(Given(inputs, tick.begun, tick.decision, loop))

    def _step(self, driven: _Driven) -> None:
        self._driven = driven

    def _undocks(self, distance: float) -> None:
        self._recorder.task(distance)


class _Recorded:
    """A docking controller whose every step is told to the recorder."""

    def __init__(self, controller: DockingController, recorder: SessionRecorder) -> None:
        self._controller = controller
        self._recorder = recorder

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        decision = self._controller.step(observation, applied, now)
        self._recorder._step(_Driven(now, decision, DockingInputs(observation, applied)))
        return decision

    def undock(self, distance: float) -> None:
        self._controller.undock(distance)
        self._recorder._undocks(distance)


class _Foreign:
    def __init__(self, controller: LoopController, recorder: SessionRecorder) -> None:
        self._controller = controller
        self._recorder = recorder

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        decision = self._controller.step(observation, applied, now)
        self._recorder._step(_Driven(now, decision, None))
        return decision
