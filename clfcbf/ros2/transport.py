"""What carries messages: publishers and subscriptions on named topics, whatever the middleware.

Nothing waits, nothing calls back: a subscription keeps what has come until it is taken, so that
messages are looked at in the control loop's own thread and at its own time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.ros2.messages import Message

__all__ = [
    "CLOCK",
    "COMMANDS",
    "DETECTIONS",
    "EVENTS",
    "LATCHED",
    "LATEST",
    "LOCALHOST",
    "Publisher",
    "Quality",
    "Subscription",
    "Transport",
    "TransportError",
    "absolute",
]

M = TypeVar("M", bound=Message)
P = TypeVar("P", bound=Message, contravariant=True)

LOCALHOST = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Variable of the environment that, where it is LOCALHOST, keeps discovery on this machine."""


class TransportError(ClfcbfError):
    """A message cannot be passed on."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of service of a topic.

    Attributes
    ----------
    reliable : what is lost is sent again; a reliable subscription does not hear a publisher that
        is not, so subscriptions ask for it only where each message counts
    latched : who comes later gets what was sent before (transient local)
    depth : messages kept
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 1

    def __post_init__(self) -> None:
        if not (isinstance(self.depth, int) and self.depth >= 1):
            raise ConfigurationError(f"depth must be an integer >= 1, got {self.depth!r}")


COMMANDS = Quality(reliable=True, depth=1)
"""Velocity commands, as Nav2 publishes them; only the newest is worth sending again."""

LATEST = Quality(reliable=False, depth=1)
"""Velocity commands as a base takes them: from any publisher, and only the newest."""

DETECTIONS = Quality(reliable=False, depth=10)
"""Poses of the target: from any publisher, ten frames, a third of a second at 30 Hz."""

CLOCK = Quality(reliable=False, depth=1)
"""Simulated time, as ROS's own nodes subscribe to it."""

EVENTS = Quality(reliable=True, depth=10)
"""Goals, feedback and diagnostics: each counts."""

LATCHED = Quality(reliable=True, latched=True, depth=1)
"""The last result, also for who asks later."""


class Publisher(Protocol[P]):
    """The sending end of a topic; its methods may be called from any thread."""

    def publish(self, message: P) -> None:
        """Hand a message to the middleware, without waiting for anybody to get it.

        Raises
        ------
        TransportError : it does not take it
        """

    def listeners(self) -> int:
        """Matched subscriptions, of any process."""

    def flush(self, timeout: float) -> bool:
        """Wait until reliable subscriptions have all; False where it took longer than that [s]."""


class Subscription(Protocol[M]):
    """The receiving end of a topic."""

    def take(self) -> list[M]:
        """What has come and was not yet taken, the newest last; at most the depth; never waits.

        Raises
        ------
        TransportError : it is closed, or what has come cannot be read
        """

    def sources(self) -> int:
        """Matched publishers, of any process."""


class Transport(Protocol):
    """A participant of the network: makes publishers and subscriptions, and ends them."""

    def publisher(self, kind: type[M], topic: str, quality: Quality) -> Publisher[M]:
        """One for messages of that kind on a topic by its absolute name."""

    def subscription(self, kind: type[M], topic: str, quality: Quality) -> Subscription[M]:
        """One for messages of that kind on a topic by its absolute name."""

    def close(self) -> None:
        """End all of them; any number of times. Publishing raises from then on."""


def absolute(namespace: str, topic: str) -> str:
    """A topic's absolute name: one that begins with a slash stays as it is.

    Raises
    ------
    ConfigurationError : the name is not one that ROS allows
    """
    name = topic if topic.startswith("/") else "/".join((namespace.rstrip("/"), topic))
    name = name if name.startswith("/") else f"/{name}"
    for part in name[1:].split("/"):
        if not (part.isascii() and part.isidentifier()):
            raise ConfigurationError(
                f"topic {name!r} must be made of letters, digits and underscores between slashes, "
                "none of them empty or beginning with a digit"
            )
    return name
