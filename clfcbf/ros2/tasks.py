"""The docking session on topics: goals in, feedback and results out.

The fields are those of Nav2's ``DockRobot`` and ``UndockRobot``, as JSON in a
``std_msgs/msg/String``; what is not JSON is a ``dock_id``. An action would need ``nav2_msgs``, and
services of DDS differ from one ROS middleware to the next; a string on a topic does not.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum
from typing import Any

from clfcbf.errors import ConfigurationError
from clfcbf.ros2.messages import Empty, String
from clfcbf.ros2.transport import EVENTS, LATCHED, Transport, absolute
from clfcbf.se2 import Pose2
from clfcbf.session import DockingSession, ErrorCode, Feedback, SessionResult

__all__ = ["Action", "Goal", "TaskServer", "parse_goal", "task_topics"]

NODE = "docking"
"""Name of the node, before the names of its own topics."""

REJECTED = 1
"""``GOAL_REJECTED`` of Nav2's actions: the task was not begun."""


class Action(Enum):
    """What a goal asks for, and the topic it comes on."""

    DOCK = "dock"
    UNDOCK = "undock"


@dataclass(frozen=True, slots=True)
class Goal:
    """A task that was asked for.

    Attributes
    ----------
    action : to dock or to undock
    dock_id : name in the database; empty to dock at what is seen, or to leave the last dock
    dock_pose : pose of the dock in place of a name
    dock_type : of a dock that has no name; may be empty where one type is known
    goal_id : told again in feedback and result, so that whoever asked knows its own
    """

    action: Action
    dock_id: str = ""
    dock_pose: Pose2 | None = None
    dock_type: str = ""
    goal_id: str = ""

    def begin(self, session: DockingSession) -> None:
        """Give the task to a session; raises ``ConfigurationError`` where that refuses it."""
        if self.action is Action.UNDOCK:
            session.undock(self.dock_id or None)
        elif self.dock_id:
            session.dock(self.dock_id)
        else:
            session.dock_at(self.dock_pose or Pose2(0.0, 0.0, 0.0), self.dock_type)

    def to_text(self) -> str:
        """As a message holds it."""
        fields: dict[str, Any] = {
            "dock_id": self.dock_id, "dock_type": self.dock_type, "goal_id": self.goal_id,
        }  # fmt: skip
        if self.dock_pose is not None:
            fields["dock_pose"] = list(self.dock_pose)
        return json.dumps(fields)

    @property
    def _named(self) -> dict[str, Any]:
        return {"action": self.action.value, "goal_id": self.goal_id, "dock_id": self.dock_id}


_FIELDS = {"dock_id": str, "dock_type": str, "goal_id": str}


def parse_goal(action: Action, text: str) -> Goal:
    """The goal in a message.

    Raises
    ------
    ConfigurationError : a field is unknown or of the wrong kind
    """
    if not text.lstrip().startswith("{"):
        return Goal(action, text.strip())
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"goal is not JSON: {error}") from error
    pose = fields.pop("dock_pose", None)
    for name, value in fields.items():
        if name not in _FIELDS:
            valid = ", ".join([*_FIELDS, "dock_pose"])
            raise ConfigurationError(f"unknown field {name!r} of a goal (valid: {valid})")
        if not isinstance(value, _FIELDS[name]):
            raise ConfigurationError(f"{name} must be a string, got {value!r}")
    if pose is not None:
        if not (isinstance(pose, list) and len(pose) == 3 and all(map(_is_number, pose))):
            raise ConfigurationError(f"dock_pose must be a list of x, y and theta, got {pose!r}")
        pose = Pose2(*map(float, pose))
    return Goal(action, dock_pose=pose, **fields)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e9


class TaskServer:
    """Goals in, feedback and results out; looked at from the control loop's own thread.

    Parameters
    ----------
    transport : that carries the messages
    namespace : of the topics, before the node's name
    """

    def __init__(self, transport: Transport, namespace: str = "") -> None:
        names = task_topics(namespace)
        self._goals = [
            (action, transport.subscription(String, names[action.value], EVENTS))
            for action in Action
        ]
        self._cancel = transport.subscription(Empty, names["cancel"], EVENTS)
        self._feedback = transport.publisher(String, names["feedback"], EVENTS)
        self._result = transport.publisher(String, names["result"], LATCHED)

    def goals(self) -> list[Goal]:
        """Those that have come; what is none is rejected here."""
        found = []
        for action, subscription in self._goals:
            for message in subscription.take():
                try:
                    found.append(parse_goal(action, message.data))
                except ConfigurationError as error:
                    self.reject(Goal(action), str(error))
        return found

    def canceled(self) -> bool:
        """Whether somebody has asked to cancel since the last look."""
        return bool(self._cancel.take())

    def reject(self, goal: Goal, why: str) -> None:
        """Tell that a goal was not begun."""
        self._tell(goal, False, REJECTED, "GOAL_REJECTED", 0, why, False)

    def feedback(self, goal: Goal, feedback: Feedback) -> None:
        """Tell how it is going."""
        state = feedback.state
        told = {
            **goal._named, "state": int(state), "state_name": state.name,
            "docking_time": feedback.docking_time, "num_retries": feedback.num_retries,
        }  # fmt: skip
        self._feedback.publish(String(json.dumps(told)))

    def result(self, goal: Goal, result: SessionResult) -> None:
        """Tell how it went."""
        code = ErrorCode(result.error_code)
        self._tell(
            goal, result.success, int(code), code.name, result.num_retries, result.error_msg,
            result.canceled,
        )  # fmt: skip

    def flush(self, timeout: float) -> bool:
        """Wait until the last result has arrived where it is listened to."""
        return self._result.flush(timeout)

    def _tell(
        self, goal: Goal, success: bool, code: int, name: str, retries: int, why: str,
        canceled: bool,
    ) -> None:  # fmt: skip
        told = {
            **goal._named, "success": success, "error_code": code, "error_name": name,
            "error_msg": why, "num_retries": retries, "canceled": canceled,
        }  # fmt: skip
        self._result.publish(String(json.dumps(told)))


def task_topics(namespace: str) -> dict[str, str]:
    """Absolute names of the topics of tasks."""
    names = ("dock", "undock", "cancel", "feedback", "result")
    return {name: absolute(namespace, f"{NODE}/{name}") for name in names}
