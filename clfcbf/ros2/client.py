"""Asks a docking node for tasks: what a mission, a button or a test needs of it."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from clfcbf.ros2.messages import Empty, String
from clfcbf.ros2.tasks import Action, Goal, task_topics
from clfcbf.ros2.transport import EVENTS, LATCHED, Transport, TransportError

__all__ = ["TaskClient"]

POLL = 0.005
"""[s] Between two looks of a client that waits."""


class TaskClient:
    """Asks a node for tasks, from any process, and waits for their results.

    Parameters
    ----------
    transport : that carries the messages
    namespace : of the node's topics
    """

    def __init__(self, transport: Transport, namespace: str = "") -> None:
        names = task_topics(namespace)
        self._goals = {
            action: transport.publisher(String, names[action.value], EVENTS) for action in Action
        }
        self._cancel = transport.publisher(Empty, names["cancel"], EVENTS)
        self._feedback = transport.subscription(String, names["feedback"], EVENTS)
        self._result = transport.subscription(String, names["result"], LATCHED)

    def wait_for_node(self, timeout: float) -> None:
        """Return as soon as a node listens; ``TransportError`` if none does in that time [s]."""
        end = time.monotonic() + timeout
        while not (
            all(goal.listeners() for goal in self._goals.values()) and self._result.sources()
        ):
            if time.monotonic() > end:
                raise TransportError(f"no docking node within {timeout:g} s")
            time.sleep(POLL)

    def send(self, goal: Goal) -> Goal:
        """Ask for a task; the goal with its number."""
        numbered = replace(goal, goal_id=goal.goal_id or secrets.token_hex(8))
        self._goals[goal.action].publish(String(numbered.to_text()))
        return numbered

    def cancel(self) -> None:
        """Ask the task in progress to end."""
        self._cancel.publish(Empty())

    def states(self) -> list[Mapping[str, Any]]:
        """Feedback that has come and was not yet taken."""
        return [json.loads(message.data) for message in self._feedback.take()]

    def result(self, goal: Goal) -> Mapping[str, Any] | None:
        """Of that goal, None as long as it has not come; others are dropped."""
        for message in self._result.take():
            told: Mapping[str, Any] = json.loads(message.data)
            if told["goal_id"] == goal.goal_id:
                return told
        return None

    def perform(self, goal: Goal, timeout: float) -> Mapping[str, Any]:
        """Ask for a task and wait for its result; ``TransportError`` if none comes in time [s]."""
        numbered = self.send(goal)
        end = time.monotonic() + timeout
        while (told := self.result(numbered)) is None:
            if time.monotonic() > end:
                raise TransportError(f"no result of {numbered} within {timeout:g} s")
            time.sleep(POLL)
        return told
