"""ROS 2 topics without ROS: the same names, types and qualities of service by Cyclone DDS.

A topic ``/cmd_vel`` is ``rt/cmd_vel`` in DDS and a type ``geometry_msgs/msg/Twist`` is
``geometry_msgs::msg::dds_::Twist_``; the rest is the same protocol, so that nodes of any ROS 2
middleware based on DDS hear and are heard. Needs the extra ``dds``.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import os
import threading
import types
import typing
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.ros2.messages import MESSAGES, Message
from clfcbf.ros2.transport import LOCALHOST, Quality, TransportError

__all__ = ["DdsTransport"]

M = TypeVar("M", bound=Message)

DOMAINS = (0, 232)
"""Domains that have ports of their own."""

BLOCKING = 0.1
"""[s] That a reliable write waits where a receiver has stopped taking: ROS's own value."""

COMPATIBILITY = """<CycloneDDS><Domain><Compatibility>
<IgnoreTypeInformation>1.15</IgnoreTypeInformation>
</Compatibility></Domain></CycloneDDS>"""
"""Types of Fast DDS (vendor 1.15, the default of ROS) are matched by name alone, as ROS's own
middleware does: what it tells of types with sequences, Cyclone DDS takes for invalid."""

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""Discovery on this machine alone, among its first 32 participants."""

_lock = threading.Lock()
_domains: dict[int, Any] = {}  # a domain's settings last as long as the process
_wire_types: dict[type[Message], Any] = {}


class DdsTransport:
    """A DDS participant.

    With ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` in the environment it keeps to this machine,
    as ROS's nodes do; what ``CYCLONEDDS_URI`` says comes after that. Both are read at the first
    participant of a domain in a process.

    Parameters
    ----------
    domain : number of the domain; ``ROS_DOMAIN_ID`` of the environment if not given, else 0

    Raises
    ------
    MissingExtraError : ``cyclonedds`` is not installed
    ConfigurationError : the domain is none
    TransportError : no participant can be made, such as without a network interface
    """

    def __init__(self, domain: int | None = None) -> None:
        try:
            from cyclonedds.core import DDSException
            from cyclonedds.domain import Domain, DomainParticipant
        except ImportError as error:
            raise MissingExtraError("cyclonedds", "dds") from error
        self.domain = _domain(domain)
        self._made: list[_Publisher[Any] | _Subscription[Any]] = []
        try:
            with _lock:
                if self.domain not in _domains:
                    _domains[self.domain] = Domain(self.domain, _configuration())
                self._participant: Any = DomainParticipant(self.domain)
        except DDSException as error:
            raise TransportError(f"no participant in domain {self.domain}: {error}") from error

    def publisher(self, kind: type[M], topic: str, quality: Quality) -> _Publisher[M]:
        """One for messages of that kind; see :class:`~clfcbf.ros2.transport.Transport`."""
        made = _Publisher(self._open(), kind, topic, quality)
        self._made.append(made)
        return made

    def subscription(self, kind: type[M], topic: str, quality: Quality) -> _Subscription[M]:
        """One for messages of that kind; see :class:`~clfcbf.ros2.transport.Transport`."""
        made = _Subscription(self._open(), kind, topic, quality)
        self._made.append(made)
        return made

    def _open(self) -> Any:
        if self._participant is None:
            raise TransportError("the transport is closed")
        return self._participant

    def close(self) -> None:
        """End all of it; what was published reliably is still delivered, as far as it can be."""
        for made in self._made:
            made.close()
        self._made.clear()
        self._participant = None


class _Publisher(Generic[M]):
    def __init__(self, participant: Any, kind: type[M], topic: str, quality: Quality) -> None:
        from cyclonedds.pub import DataWriter

        self._wire, qos = _wire_type(kind), _qos(quality)
        self._topic = topic
        self._writer: Any = DataWriter(participant, _topic(participant, topic, self._wire), qos)

    def publish(self, message: M) -> None:
        if (writer := self._writer) is None:
            raise TransportError("the transport is closed")
        try:
            writer.write(_to_wire(message, self._wire))
        except Exception as error:  # of the middleware, or a value that the type cannot hold
            raise TransportError(f"{self._topic} does not take {message!r}: {error}") from error

    def listeners(self) -> int:
        writer = self._writer
        return 0 if writer is None else int(writer.get_publication_matched_status().current_count)

    def flush(self, timeout: float) -> bool:
        writer = self._writer
        return writer is None or bool(writer.wait_for_acks(round(1e9 * timeout)))

    def close(self) -> None:
        self._writer = None


class _Subscription(Generic[M]):
    def __init__(self, participant: Any, kind: type[M], topic: str, quality: Quality) -> None:
        from cyclonedds.sub import DataReader

        self._kind, wire = kind, _wire_type(kind)
        self._topic = topic
        self._depth = quality.depth
        self._reader: Any = DataReader(participant, _topic(participant, topic, wire), _qos(quality))

    def take(self) -> list[M]:
        reader = self._reader
        if reader is None:
            raise TransportError("the transport is closed")
        try:
            samples = reader.take(self._depth)
            return [_from_wire(s, self._kind) for s in samples if s.sample_info.valid_data]
        except Exception as error:  # of the middleware, or a text that is not UTF-8
            raise TransportError(f"{self._topic} cannot be read: {error}") from error

    def sources(self) -> int:
        reader = self._reader
        return 0 if reader is None else int(reader.get_subscription_matched_status().current_count)

    def close(self) -> None:
        self._reader = None


def _domain(domain: int | None) -> int:
    given: Any = os.environ.get("ROS_DOMAIN_ID") or 0 if domain is None else domain
    lowest, highest = DOMAINS
    try:
        number = int(given)
    except ValueError:
        number = -1
    if not lowest <= number <= highest:
        raise ConfigurationError(f"domain must be from {lowest} to {highest}, got {given!r}")
    return number


def _configuration() -> str:
    """Of a domain: ours, and over it whatever the environment says."""
    parts = [COMPATIBILITY]
    if os.environ.get(LOCALHOST) == "LOCALHOST":
        parts.append(LOOPBACK)
    if given := os.environ.get("CYCLONEDDS_URI"):
        parts.append(given)
    return ",".join(parts)


def _topic(participant: Any, name: str, wire: Any) -> Any:
    from cyclonedds.topic import Topic

    return Topic(participant, f"rt{name}", wire)


def _qos(quality: Quality) -> Any:
    from cyclonedds.core import Policy, Qos

    return Qos(
        Policy.Reliability.Reliable(round(1e9 * BLOCKING))
        if quality.reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if quality.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(quality.depth),
    )


def _wire_type(kind: type[Message]) -> Any:
    """The IDL structure of a kind of message, made of its fields."""
    with _lock:
        if not _wire_types:
            for each in MESSAGES:
                _wire_types[each] = _made_of(each)
    return _wire_types[kind]


def _made_of(kind: type[Message]) -> Any:
    from cyclonedds.idl import IdlStruct

    package, _, name = kind.NAME.split("/")
    described: Any = kind
    members = {name: _member(hint) for name, hint in _hints(described).items()}
    made = types.new_class(
        kind.__name__,
        (IdlStruct,),
        {"typename": f"{package}::msg::dds_::{name}_"},
        lambda namespace: namespace.update(__annotations__=members, __module__=__name__),
    )
    return dataclasses.dataclass(made)


@functools.cache
def _hints(kind: Any) -> Mapping[str, Any]:
    """Fields and their types, those of numbers annotated with the type on the wire."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _member(hint: Any) -> Any:
    idl: Any = importlib.import_module("cyclonedds.idl.types")
    if typing.get_origin(hint) is typing.Annotated:
        return getattr(idl, hint.__metadata__[0])
    if typing.get_origin(hint) is tuple:
        return idl.sequence[_member(typing.get_args(hint)[0])]
    return _wire_types.get(hint, hint)


def _to_wire(value: Any, wire: Any) -> Any:
    """A message as its IDL structure."""
    members = []
    for name, kind in wire.__annotations__.items():
        member = getattr(value, name)
        if isinstance(member, Message):
            member = _to_wire(member, kind)
        elif isinstance(member, tuple):
            member = [_to_wire(item, _wire_types[type(item)]) for item in member]
        members.append(member)
    return wire(*members)


def _from_wire(sample: Any, kind: Any) -> Any:
    """An IDL structure as its message."""
    members = []
    for name, hint in _hints(kind).items():
        member = getattr(sample, name)
        if isinstance(member, list):
            item = typing.get_args(hint)[0]
            member = tuple(_from_wire(each, item) for each in member)
        elif isinstance(hint, type) and issubclass(hint, Message):
            member = _from_wire(member, hint)
        members.append(member)
    return kind(*members)
