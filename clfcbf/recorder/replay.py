"""A log replayed: every command computed again from the recorded inputs, and compared bit by bit.

A tick is a pure function of configuration, state, inputs and time, so with the same versions on
the same kind of machine each command comes out to the last bit. State is handed from tick to
tick: after a gap nothing can be said, and the replay ends there.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from clfcbf.controller import DockingController, TrackingConfig, TrackingController, TrackingInputs
from clfcbf.decision import Decision
from clfcbf.docking import DockingConfig, DockingInputs, DockingState
from clfcbf.errors import LogError
from clfcbf.explain import decision_to_json
from clfcbf.recorder.blueprint import Configuration
from clfcbf.recorder.entries import (
    Inputs,
    LogEnd,
    LoggedTask,
    LoggedTick,
    SessionInputs,
    Unrecorded,
)
from clfcbf.recorder.header import platform_versions
from clfcbf.recorder.log import FlightLog
from clfcbf.runtime.braking import Braking
from clfcbf.safety_filter import FilterInputs, SafetyFilter
from clfcbf.se2 import Twist
from clfcbf.tick import FilterConfig, FilterState

__all__ = ["Difference", "ReplayReport", "replay"]


@dataclass(frozen=True, slots=True)
class Difference:
    """A tick that came out differently.

    Attributes
    ----------
    tick, now : which, from 0, and at what time [s]
    recorded, replayed : the commands sent; the same where only another field differs
    fields : of the decision that differ; ``command`` where the loop's own command does
    """

    tick: int
    now: float
    recorded: Twist
    replayed: Twist
    fields: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"tick {self.tick} at {self.now!r} s differs in {', '.join(self.fields)}: "
            f"recorded {_show(self.recorded)}, replayed {_show(self.replayed)}"
        )


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay found.

    Attributes
    ----------
    ticks : that were replayed
    commands, decisions : how many of them differ in the command sent, and in anything
    first : the first of those; None if all are the same
    stopped : why the replay ended before the log did; empty if it did not
    end : how the log ends
    versions : what computed then and now, where that differs
    """

    ticks: int
    commands: int
    decisions: int
    first: Difference | None
    stopped: str
    end: LogEnd
    versions: tuple[str, ...]

    @property
    def reproduced(self) -> bool:
        """Whether every command of the log came out to the last bit.

        A log that is cut short counts up to there; one that is damaged does not.
        """
        whole = self.end.intact or self.end.cut
        return self.commands == 0 and not self.stopped and whole

    def __str__(self) -> str:
        lines = [f"{self.ticks} ticks replayed: {self._verdict()}"]
        if self.first is not None:
            lines.append(str(self.first))
        if self.stopped:
            lines.append(f"the replay ends before the log: {self.stopped}")
        if self.end.reason:
            kind = "cut short" if self.end.cut else "damaged"
            lines.append(f"the log is {kind}: {self.end.reason}")
        lines += [f"another version: {told}" for told in self.versions]
        return "\n".join(lines)

    def _verdict(self) -> str:
        if self.commands:
            return f"{self.commands} commands differ"
        if self.decisions:
            return f"every command to the last bit; {self.decisions} decisions differ besides"
        return "every command to the last bit"


def replay(log: FlightLog, configuration: Configuration | None = None) -> ReplayReport:
    """Compute every tick of a log again.

    Parameters
    ----------
    log : see :func:`~clfcbf.recorder.read_log`
    configuration : in place of the log's own, such as where that holds parts that are not the
        library's, or to see what another one would have done with the same measurements

    Raises
    ------
    LogError : the configuration cannot be built, or inputs are not those of its controller
    """
    again = _Again(configuration if configuration is not None else log.configuration())
    ticks = commands = decisions = 0
    first: Difference | None = None
    stopped = ""
    expected = 0
    end = LogEnd(False, False, "the log has no end", 0)
    for entry in log.entries():
        if isinstance(entry, LogEnd):
            end = entry
            break
        if not stopped and entry.number != expected:
            stopped = f"entries {expected} to {entry.number - 1} are missing"
        if not stopped and isinstance(entry, Unrecorded):
            stopped = f"entry {entry.number} could not be recorded: {entry.reason}"
        if stopped:
            continue
        expected = entry.number + 1
        if isinstance(entry, LoggedTask):
            again.task(entry)
        elif isinstance(entry, LoggedTick):
            found = again.difference(ticks, entry)
            ticks += 1
            if found is not None:
                first = first or found
                decisions += 1
                commands += _bits(found.recorded) != _bits(found.replayed)
    return ReplayReport(ticks, commands, decisions, first, stopped, end, _versions(log))


class _Again:
    """The controller of a log, as it was when it was made; beside it the brakes of the loop and of
    a docking session, which both take a controller's place where they have to.
    """

    def __init__(self, configuration: Configuration) -> None:
        base = configuration if isinstance(configuration, FilterConfig) else configuration.filter
        self._base = base
        self._braking = Braking(base.limits, base.period)
        self._session = Braking(base.limits, base.period)
        self._kind, self._step, self._docking = _controller(configuration)

    def task(self, task: LoggedTask) -> None:
        if self._docking is None:
            raise LogError(f"entry {task.number} is a task, which only a docking controller takes")
        if task.fresh:
            self._docking.state = DockingState()
        if task.undock == 0.0:
            if not task.fresh:
                self._docking.dock()
        else:
            self._docking.undock(task.undock)

    def difference(self, tick: int, entry: LoggedTick) -> Difference | None:
        """What comes out differently in a tick, which is taken here."""
        braked = isinstance(entry.inputs, SessionInputs) and self._docking is not None
        if type(entry.inputs) is not self._kind and not braked:
            raise LogError(
                f"entry {entry.number} holds {type(entry.inputs).__name__}, "
                f"but the configuration's controller takes {self._kind.__name__}"
            )
        decision = self._braked(entry) if braked else self._step(entry.inputs, entry.now)
        self._session.accepted(decision.twist)
        command = self._command(entry, decision)
        fields = _different(entry.decision, decision)
        if _bits(entry.command) != _bits(command):
            fields = ("command", *fields)
        if not fields:
            return None
        return Difference(tick, entry.now, entry.command, command, fields)

    def _braked(self, entry: LoggedTick) -> Decision:
        """The decision with the session's own brake; one that is foreign is taken as it is."""
        inputs = entry.inputs
        assert isinstance(inputs, SessionInputs)
        if inputs.foreign:
            return entry.decision
        twist = self._session.command(self._session.known(inputs.applied))
        return entry.decision._replace(twist=twist)

    def _command(self, entry: LoggedTick, decision: Decision) -> Twist:
        """What the loop sends: the decision's command, or its brake's if that came too late.

        Whether it did is a matter of the clock, and so taken from the log.
        """
        loop = entry.loop
        if loop is None:
            return decision.twist
        if loop.number == 0:  # each run of the loop begins with a brake at rest
            self._braking = Braking(self._base.limits, self._base.period)
        command = decision.twist
        if _bits(loop.command) != _bits(entry.decision.twist):
            known = self._braking.known(entry.inputs.applied)
            command = self._braking.command(known if loop.in_force is None else loop.in_force)
        self._braking.accepted(command)
        return command


_Step = Callable[[Any, float], Decision]


def _controller(
    configuration: Configuration,
) -> tuple[type[Inputs], _Step, DockingController | None]:
    """The inputs a configuration's controller takes, its step, and itself where it docks."""
    if isinstance(configuration, DockingConfig):
        docking = _Docking(configuration)
        return DockingInputs, lambda i, now: docking.step(i.observation, i.applied, now), docking
    if isinstance(configuration, TrackingConfig):
        tracking = _Tracking(configuration)
        step: _Step = lambda i, now: tracking.step(i.reference, i.scene, i.applied, now)  # noqa: E731
        return TrackingInputs, step, None
    safety = _Filter(configuration)
    return FilterInputs, lambda i, now: safety.filter(i.nominal, i.scene, i.applied, now), None


class _Docking(DockingController):
    def __init__(self, config: DockingConfig) -> None:
        self.config, self.state = config, DockingState()


class _Tracking(TrackingController):
    def __init__(self, config: TrackingConfig) -> None:
        self.config, self.state = config, FilterState()


class _Filter(SafetyFilter):
    def __init__(self, config: FilterConfig) -> None:
        self.config, self.state = config, FilterState()


def _different(one: Decision, other: Decision) -> tuple[str, ...]:
    """Fields in which two decisions differ, but for how long they took."""
    left, right = decision_to_json(one), decision_to_json(other)
    return tuple(
        name
        for name in left
        # As text, for a zero has a sign and a NaN equals itself there.
        if name != "timing" and json.dumps(left[name]) != json.dumps(right[name])
    )


def _bits(twist: Twist) -> bytes:
    return struct.pack("<2d", *twist)


def _show(twist: Twist) -> str:
    return f"(v = {twist[0]!r} m/s, omega = {twist[1]!r} rad/s)"


def _versions(log: FlightLog) -> tuple[str, ...]:
    now = platform_versions()
    return tuple(
        f"{name} {log.header.get(name, 'unknown')} then, {text} now"
        for name, text in now.items()
        if log.header.get(name) != text
    )
