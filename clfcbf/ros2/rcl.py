"""ROS 2 topics by rclpy, where ROS is installed and sourced.

Messages come in on an executor's thread, which does nothing but keep the newest until the control
loop takes them. Signals are left alone: the loop brakes on them, and what publishes must live
until the robot stands.
"""

from __future__ import annotations

import dataclasses
import importlib
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from clfcbf.errors import ConfigurationError
from clfcbf.ros2.messages import MESSAGES, Message
from clfcbf.ros2.transport import Quality, TransportError

__all__ = ["RclTransport"]

M = TypeVar("M", bound=Message)

POLL = 0.1
"""[s] That the executor waits for a message, so that closing takes no longer."""

JOIN = 2.0
"""[s] That closing waits for the executor's thread: some of its polls."""


_KINDS = {kind.NAME.split("/")[-1]: kind for kind in MESSAGES}


class RclTransport:
    """A ROS node.

    Parameters
    ----------
    name : of the node
    arguments : ``--ros-args`` and what follows it, as launch files give it
    domain : number of the domain; ``ROS_DOMAIN_ID`` of the environment if not given, else 0

    Raises
    ------
    ConfigurationError : rclpy is not there, or refuses name, arguments or domain
    """

    def __init__(
        self, name: str = "docking", arguments: Sequence[str] = (), domain: int | None = None
    ) -> None:
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise ConfigurationError(
                f"no rclpy in this interpreter ({error}): source ROS's setup file first, or use "
                "cyclonedds, which needs no ROS"
            ) from error
        self._context = Context()
        options = SignalHandlerOptions.NO
        try:
            rclpy.init(
                args=list(arguments), context=self._context, domain_id=domain,
                signal_handler_options=options,
            )  # fmt: skip
            self.node: Any = rclpy.create_node(name, context=self._context)
        except Exception as error:  # rclpy raises many kinds, none of them its users'
            self._context.try_shutdown()
            raise ConfigurationError(f"rclpy refuses to start node {name!r}: {error}") from error
        self._executor: Any = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._closing = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._spin, name="rclpy executor", daemon=True)
        self._thread.start()

    @property
    def namespace(self) -> str:
        """Of the node, as launch files may set it."""
        return str(self.node.get_namespace())

    @property
    def uses_sim_time(self) -> bool:
        """The parameter that every ROS node has."""
        return bool(self.node.get_parameter("use_sim_time").value)

    def parameters(self, defaults: Mapping[str, Any]) -> dict[str, Any]:
        """Declare parameters; their values, as given on the command line or in a file.

        Raises
        ------
        ConfigurationError : one was given that is of another kind than its default
        """
        values = {}
        for name, default in defaults.items():
            try:
                values[name] = self.node.declare_parameter(name, default).value
            except Exception as error:  # rclpy raises many kinds, none of them its users'
                raise ConfigurationError(f"parameter {name}: {error}") from error
        return values

    def publisher(self, kind: type[M], topic: str, quality: Quality) -> _Publisher[M]:
        """One for messages of that kind; see :class:`~clfcbf.ros2.transport.Transport`."""
        self._refuse()
        made = self.node.create_publisher(_ros_type(kind), topic, _profile(quality))
        return _Publisher(self, made, topic)

    def subscription(self, kind: type[M], topic: str, quality: Quality) -> _Subscription[M]:
        """One for messages of that kind; see :class:`~clfcbf.ros2.transport.Transport`."""
        self._refuse()
        queue: deque[Any] = deque(maxlen=quality.depth)

        def keep(message: Any) -> None:  # rclpy wants a function with a signature
            queue.append(message)

        made = self.node.create_subscription(_ros_type(kind), topic, keep, _profile(quality))
        return _Subscription(self, made, queue, kind)

    @property
    def closed(self) -> bool:
        """Whether it was closed."""
        return self._closing.is_set()

    def close(self) -> None:
        """End the node; any number of times."""
        if self.closed:
            return
        self._closing.set()
        self._executor.wake()
        self._thread.join(JOIN)
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _refuse(self) -> None:
        """Raise where nothing comes in or goes out any more."""
        if self.closed:
            raise TransportError("the transport is closed")
        if self._failure is not None:
            raise TransportError(f"rclpy's executor has failed: {self._failure}") from self._failure

    def _spin(self) -> None:
        try:
            while not self._closing.is_set():
                self._executor.spin_once(timeout_sec=POLL)
        except Exception as error:  # such as of a text that is not UTF-8; told at the next use
            self._failure = error


class _Publisher(Generic[M]):
    def __init__(self, transport: RclTransport, publisher: Any, topic: str) -> None:
        self._transport = transport
        self._publisher = publisher
        self._topic = topic

    def publish(self, message: M) -> None:
        self._transport._refuse()
        try:
            self._publisher.publish(_to_ros(message))
        except Exception as error:  # of the middleware, or a value that the type cannot hold
            raise TransportError(f"{self._topic} does not take {message!r}: {error}") from error

    def listeners(self) -> int:
        return 0 if self._transport.closed else int(self._publisher.get_subscription_count())

    def flush(self, timeout: float) -> bool:
        from rclpy.duration import Duration

        if self._transport.closed:
            return True
        return bool(self._publisher.wait_for_all_acked(Duration(seconds=timeout)))


class _Subscription(Generic[M]):
    def __init__(
        self, transport: RclTransport, subscription: Any, queue: deque[Any], kind: type[M]
    ) -> None:
        self._transport = transport
        self._subscription = subscription
        self._queue = queue
        self._kind = kind

    def take(self) -> list[M]:
        self._transport._refuse()
        taken = []
        while self._queue:
            taken.append(_from_ros(self._queue.popleft(), self._kind))
        return taken

    def sources(self) -> int:
        return 0 if self._transport.closed else int(self._subscription.get_publisher_count())


def _ros_type(kind: type[Message]) -> Any:
    package, group, name = kind.NAME.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{group}"), name)
    except ImportError as error:
        raise ConfigurationError(
            f"the ROS package {package} is not installed: {error}; it has to be, for {kind.NAME}"
        ) from error


def _profile(quality: Quality) -> Any:
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=ReliabilityPolicy.RELIABLE
        if quality.reliable
        else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL
        if quality.latched
        else DurabilityPolicy.VOLATILE,
    )


def _to_ros(message: Message) -> Any:
    """A message as rclpy's; a byte is ``bytes`` there, and an empty message has no member."""
    made = _ros_type(type(message))()
    for name, kind in made.get_fields_and_field_types().items():
        member: Any = getattr(message, name)
        if isinstance(member, Message):
            member = _to_ros(member)
        elif isinstance(member, tuple):
            member = [_to_ros(item) for item in member]
        elif kind == "octet":
            member = bytes([member])
        elif kind == "double":
            member = float(member)  # an integer's bytes would be sent as they are
        setattr(made, name, member)
    return made


def _from_ros(message: Any, kind: Any) -> Any:
    """A message of rclpy as ours."""
    members = {}
    for field in dataclasses.fields(kind):
        if not hasattr(message, field.name):
            continue
        member = getattr(message, field.name)
        if isinstance(member, bytes):
            member = member[0]
        elif isinstance(member, list):
            member = tuple(_from_ros(each, _kind_of(each)) for each in member)
        elif hasattr(member, "get_fields_and_field_types"):
            member = _from_ros(member, _kind_of(member))
        members[field.name] = member
    return kind(**members)


def _kind_of(message: Any) -> type[Message]:
    return _KINDS[type(message).__name__]
