"""What a log holds, entry by entry, and each as a JSON message.

A message has two halves. Its plain numbers and words (``v``, ``clearance``, ``status`` ...) are
for viewers such as Foxglove and are described by the channel's JSON schema; a number that is not
finite is left out there. ``record`` holds inputs and decision whole, to the last bit.
"""

from __future__ import annotations

import json
import math
from typing import Any, NamedTuple

from clfcbf.controller import TrackingInputs
from clfcbf.decision import Decision
from clfcbf.docking import DockingInputs
from clfcbf.errors import ClfcbfError, LogError
from clfcbf.explain import decision_from_json, decision_to_json
from clfcbf.explain.codec import reader, writer
from clfcbf.runtime.loop import Tick
from clfcbf.safety_filter import FilterInputs
from clfcbf.scene import Observation
from clfcbf.se2 import Twist

__all__ = [
    "SCHEMA",
    "TASK_SCHEMA",
    "Entry",
    "Given",
    "InTheLoop",
    "Inputs",
    "LogEnd",
    "LoggedTask",
    "LoggedTick",
    "SessionInputs",
    "Unrecorded",
    "entry_of",
    "given_by",
    "in_the_loop",
    "message_of",
]


class SessionInputs(NamedTuple):
    """Inputs of a tick in which a docking session did not pass its controller's command on.

    Attributes
    ----------
    observation, applied : as the session was told them
    foreign : the command is that of a controller which is not recorded, such as of staging;
        otherwise it is the session's own brake
    """

    observation: Observation | None
    applied: Twist
    foreign: bool = False


Inputs = DockingInputs | TrackingInputs | FilterInputs | SessionInputs
"""What a tick was told beside the time."""

_INPUTS: dict[str, Any] = {
    "docking": DockingInputs, "tracking": TrackingInputs, "filter": FilterInputs,
    "session": SessionInputs,
}  # fmt: skip
_KIND_OF = {kind: name for name, kind in _INPUTS.items()}


class InTheLoop(NamedTuple):
    """What the control loop made of a tick, see :class:`~clfcbf.runtime.loop.Tick`."""

    number: int
    due: float
    begun: float
    sent: float
    command: Twist
    missed: bool
    in_force: Twist | None = None


class Given(NamedTuple):
    """A tick as it is handed to the recorder."""

    inputs: Inputs
    now: float
    decision: Decision
    loop: InTheLoop | None = None


class LoggedTick(NamedTuple):
    """A tick read from a log.

    Attributes
    ----------
    number : of the entry; what was dropped leaves a gap
    inputs, now, decision : of the tick
    loop : what the loop made of it; None where there was no loop
    """

    number: int
    inputs: Inputs
    now: float
    decision: Decision
    loop: InTheLoop | None

    @property
    def command(self) -> Twist:
        """The command sent: the decision's, or the loop's brake where that came too late."""
        return self.decision.twist if self.loop is None else self.loop.command


class LoggedTask(NamedTuple):
    """The docking controller was given a task: to dock, or to undock by a distance [m].

    ``fresh`` says that another controller took its place, which knows nothing yet.
    """

    number: int
    undock: float
    fresh: bool = False


class Unrecorded(NamedTuple):
    """A tick that could not be written, and why."""

    number: int
    reason: str


class LogEnd(NamedTuple):
    """How a log ends.

    Attributes
    ----------
    intact : the recorder was closed, and everything is there
    cut : the log ends with an unfinished piece, as after a power failure or ``kill -9``; neither
        intact nor cut, it is damaged, and what follows the damage is not read
    reason : in words; empty where it is intact
    dropped : entries that the recorder says it dropped
    """

    intact: bool
    cut: bool
    reason: str
    dropped: int


Entry = LoggedTick | LoggedTask | Unrecorded | LogEnd


def _object(**properties: str) -> bytes:
    described = {name: {"type": kind} for name, kind in properties.items()}
    return json.dumps({"type": "object", "properties": described}).encode()


SCHEMA = _object(
    number="integer", time="number", v="number", omega="number", nominal_v="number",
    nominal_omega="number", applied_v="number", applied_omega="number", clearance="number",
    slack="number", barrier_slack="number", timing="number", certified="boolean", done="boolean",
    missed="boolean", seen="boolean", status="string", phase="string", reason="string",
    error="string", record="object",
)  # fmt: skip
"""JSON schema of a tick: SI units, radians."""

TASK_SCHEMA = _object(number="integer", undock="number", fresh="boolean")
"""JSON schema of a task; 0 m is docking."""


def given_by(tick: Tick) -> Given:
    """A tick of the loop around a docking controller as the recorder takes it."""
    inputs = DockingInputs(tick.observation, tick.applied)
    return Given(inputs, tick.begun, tick.decision, in_the_loop(tick))


def in_the_loop(tick: Tick) -> InTheLoop:
    """What the loop made of a tick."""
    number, due, begun, sent, _, _, _, command, missed, in_force = tick
    return InTheLoop(number, due, begun, sent, Twist(*command), missed, in_force)


def message_of(number: int, given: Given) -> bytes:
    """The message of a tick; one that says why, where an input is nothing that JSON can hold."""
    try:
        content = _content(number, given)
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    except Exception as error:  # an input may be anything at all, and the next tick counts
        content = {"number": number, "error": f"{type(error).__name__}: {error}"}
        return json.dumps(content).encode("ascii", "replace")


def _content(number: int, given: Given) -> dict[str, Any]:
    inputs, now, decision, loop = given
    kind = _KIND_OF[type(inputs)]
    command = decision.twist if loop is None else loop.command
    shown = {
        "time": now, "v": command[0], "omega": command[1],
        "nominal_v": decision.nominal[0], "nominal_omega": decision.nominal[1],
        "applied_v": inputs.applied[0], "applied_omega": inputs.applied[1],
        "clearance": decision.clearance, "slack": decision.slack,
        "barrier_slack": decision.barrier_slack, "timing": decision.timing,
    }  # fmt: skip
    content: dict[str, Any] = {"number": number}
    content |= {name: float(x) for name, x in shown.items() if math.isfinite(x)}
    content |= {
        "certified": decision.certified, "done": decision.done, "status": decision.status.value,
        "phase": decision.phase.value if decision.phase is not None else "",
        "reason": decision.reason, "missed": loop is not None and loop.missed,
        "seen": getattr(inputs, "observation", inputs) is not None,
    }  # fmt: skip
    content["record"] = {
        "kind": kind,
        "inputs": writer(_INPUTS[kind])(inputs),
        "now": writer(float)(now),
        "decision": decision_to_json(decision),
        "loop": writer(InTheLoop | None)(loop),
    }
    return content


def entry_of(topic_is_task: bool, data: bytes) -> LoggedTick | LoggedTask | Unrecorded:
    """The entry that a message holds.

    Raises
    ------
    LogError : it is none
    """
    try:
        content = json.loads(data)
        number = reader(int)(content["number"], "number")
        if topic_is_task:
            fresh = reader(bool)(content.get("fresh", False), "fresh")
            return LoggedTask(number, reader(float)(content["undock"], "undock"), fresh)
        if "record" not in content:
            return Unrecorded(number, reader(str)(content["error"], "error"))
        record = content["record"]
        return LoggedTick(
            number,
            reader(_INPUTS[record["kind"]])(record["inputs"], "inputs"),
            reader(float)(record["now"], "now"),
            decision_from_json(record["decision"]),
            reader(InTheLoop | None)(record["loop"], "loop"),
        )
    except (ClfcbfError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise LogError(f"a message is no tick of a flight recorder: {error}") from error
