r"""The pose of a partner robot over UDP: authenticated, fresh, each at most once and in order.

What is handed out was sent by who holds the key, is at most ``max_age`` old, and is newer than
whatever was handed out before. A packet may be lost, and a listener may read it; somebody in
between can delay packets by ``max_age`` and stop them, and nothing else.

Freshness rests on stamps, so both robots' clocks have to agree (NTP, PTP) to a fraction of
``max_age``; a clock that an attacker sets is outside of what is promised. A session is a start of
the sender. Packets of a session that was followed by another count as replayed, and those of one
that is not known are taken as long as they are fresh and newer than all before: so a restart of
either side needs no handshake, and what was recorded yesterday is stale.
"""

from __future__ import annotations

import math
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from types import TracebackType
from typing import NamedTuple

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.hardware.pose_packet import PACKET_SIZE, SESSION_SIZE, Packet, pack, unpack
from clfcbf.se2 import Pose2

__all__ = ["Gate", "PartnerPose", "PoseReceiver", "PoseSender", "Rejection"]

LOOPBACK = "127.0.0.1"
"""Reached from this machine alone; a robot that is to be reached has to be told its address."""

MAX_AGE = 0.5
"""[s] Of a pose: a robot at 0.5 m/s is a quarter of a metre further by then."""

MAX_AHEAD = 0.05
"""[s] By which a stamp may be ahead: more than clocks kept by NTP on one network differ."""

WINDOW = 64
"""Sequence numbers back to which a packet that is late is told from one that is replayed, by a
sliding window as in IPsec [Kent2005]_."""

SESSIONS = 16
"""Sessions remembered that were followed by another, to be counted as replayed; what is forgotten
is kept out by its stamps."""

BATCH = 64
"""Packets looked at in one call, 0.5 ms: a flood costs no more of the loop's time than that."""

_BUFFER = 1 << 16  # [byte] more than any UDP packet holds


class Rejection(Enum):
    """Why a packet was ignored."""

    HUGE = "huge"
    """Longer than a packet of the link."""
    TRUNCATED = "truncated"
    """Shorter than one."""
    FORGED = "forged"
    """Its tag is not the key's: noise, another key, or an attack."""
    FOREIGN = "foreign"
    """Genuine, but of another robot with the same key: one's own packet, sent back, for one."""
    NOT_FINITE = "not finite"
    """Genuine, but its pose or its stamp is no number."""
    STALE = "stale"
    """Too old, or no newer than what was received before."""
    AHEAD = "ahead"
    """Its stamp is in the future: the clocks differ."""
    REPLAYED = "replayed"
    """Received before, or of a session that is over."""
    REORDERED = "reordered"
    """Overtaken by a later one."""


class PartnerPose(NamedTuple):
    """A pose received.

    Attributes
    ----------
    pose : of the partner, in the frame that both robots share
    stamp : when it was true [s]
    received : when it was received [s], on the same clock
    """

    pose: Pose2
    stamp: float
    received: float


class Gate:
    """Judges packets, without a socket: what is genuine, fresh and new passes.

    Parameters
    ----------
    key : shared with the partner, see :func:`~clfcbf.hardware.pose_packet.read_key`
    partner : the partner's number
    max_age : oldest stamp that passes [s]
    max_ahead : by how much a stamp may be ahead of this robot's clock [s]

    Raises
    ------
    ConfigurationError : a number is out of range, or the key is empty
    """

    def __init__(
        self, key: bytes, partner: int, max_age: float = MAX_AGE, max_ahead: float = MAX_AHEAD
    ) -> None:
        _check_key(key)
        self._key = key
        self._partner = _check_number("partner", partner)
        for name, value in (("max_age", max_age), ("max_ahead", max_ahead)):
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"{name} must be finite and at least 0 s, got {value!r}")
        self._max_age = max_age
        self._max_ahead = max_ahead
        self._session = b""
        self._over: deque[bytes] = deque(maxlen=SESSIONS)
        self._highest = -1
        self._window = 0
        self._stamp = -math.inf

    def judge(self, data: bytes, now: float) -> PartnerPose | Rejection:
        """The pose in a packet received at ``now`` [s], or why it is ignored."""
        if len(data) != PACKET_SIZE:
            return Rejection.HUGE if len(data) > PACKET_SIZE else Rejection.TRUNCATED
        packet = unpack(data, self._key)
        if packet is None:
            return Rejection.FORGED
        if packet.sender != self._partner:
            return Rejection.FOREIGN
        if not all(map(math.isfinite, (packet.stamp, *packet.pose))):
            return Rejection.NOT_FINITE
        rejection = self._repeated(packet) or self._untimely(packet, now)
        if rejection is not None:
            return rejection
        self._accept(packet)
        return PartnerPose(packet.pose, packet.stamp, now)

    def _repeated(self, packet: Packet) -> Rejection | None:
        """By its place among the packets before it; one that is late counts as seen now."""
        if packet.session in self._over:
            return Rejection.REPLAYED
        if packet.session != self._session or packet.sequence > self._highest:
            return None
        behind = self._highest - packet.sequence
        if behind >= WINDOW or self._window >> behind & 1:
            return Rejection.REPLAYED
        self._window |= 1 << behind
        return Rejection.REORDERED

    def _untimely(self, packet: Packet, now: float) -> Rejection | None:
        age = now - packet.stamp
        if age < -self._max_ahead:
            return Rejection.AHEAD
        return None if age <= self._max_age and packet.stamp > self._stamp else Rejection.STALE

    def _accept(self, packet: Packet) -> None:
        if packet.session != self._session:
            if self._session:
                self._over.append(self._session)
            self._session, self._highest, self._window = packet.session, -1, 0
        step = packet.sequence - self._highest
        self._window = (self._window << step | 1) & ((1 << WINDOW) - 1) if step < WINDOW else 1
        self._highest, self._stamp = packet.sequence, packet.stamp


class PoseReceiver:
    """Receives a partner's poses; reading them never waits.

    Parameters
    ----------
    key, partner, max_age, max_ahead : see :class:`Gate`
    port : to listen on; 0 takes a free one, see :attr:`address`
    host : address to listen on; only this machine can reach the default
    clock : time [s] on the clock of the stamps, that both robots share

    Raises
    ------
    ConfigurationError : as :class:`Gate`, or the address cannot be listened on
    """

    def __init__(
        self,
        key: bytes,
        partner: int,
        port: int = 0,
        host: str = LOOPBACK,
        *,
        max_age: float = MAX_AGE,
        max_ahead: float = MAX_AHEAD,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._gate = Gate(key, partner, max_age, max_ahead)
        self._partner = partner
        self._clock = clock
        self._counts = dict.fromkeys(Rejection, 0)
        self._accepted = 0
        self._buffer = memoryview(bytearray(_BUFFER))
        self._socket = _socket_for(host, port)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise ConfigurationError(f"cannot listen on {host}:{port}: {error}") from error

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that are listened on."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    @property
    def partner(self) -> int:
        """Number of the robot whose poses pass."""
        return self._partner

    @property
    def counts(self) -> Mapping[Rejection, int]:
        """Packets ignored, by the reason."""
        return dict(self._counts)

    @property
    def accepted(self) -> int:
        """Packets that passed."""
        return self._accepted

    def poll(self) -> PartnerPose | None:
        """The newest pose not yet handed out, or None; of at most ``BATCH`` packets.

        Raises
        ------
        OSError : the socket has stopped working
        """
        newest: PartnerPose | None = None
        for _ in range(BATCH):
            try:
                size = self._socket.recv_into(self._buffer)
            except BlockingIOError:
                break
            # No more is copied, and hashed, than tells that a packet is too long.
            found = self._gate.judge(
                bytes(self._buffer[: min(size, PACKET_SIZE + 1)]), self._clock()
            )
            if isinstance(found, Rejection):
                self._counts[found] += 1
            else:
                self._accepted += 1
                newest = found
        return newest

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def __enter__(self) -> PoseReceiver:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class PoseSender:
    """Sends this robot's pose to a partner; each sender is a session of its own.

    Parameters
    ----------
    key : shared with the partner
    robot : this robot's number, as the partner knows it
    port, host : of the partner's :class:`PoseReceiver`
    clock : time [s] on the clock of the stamps, that both robots share

    Raises
    ------
    ConfigurationError : the number is out of range, the key is empty, or the host has no address
    """

    def __init__(
        self,
        key: bytes,
        robot: int,
        port: int,
        host: str = LOOPBACK,
        *,
        clock: Callable[[], float] = time.time,
    ) -> None:
        _check_key(key)
        self._key = key
        self._robot = _check_number("robot", robot)
        if not 0 < port < 1 << 16:
            raise ConfigurationError(f"port must be from 1 to 65535, got {port!r}")
        self._clock = clock
        self._session = secrets.token_bytes(SESSION_SIZE)
        self._sequence = 0
        self._socket = _socket_for(host, port)
        self._address = (host, port)

    def send(self, pose: Pose2, stamp: float | None = None) -> bool:
        """Send ``pose``, true at ``stamp`` [s] (now if None), in the frame that both share.

        Returns without waiting: False where the system has no room for a packet just now.

        Raises
        ------
        GeometryError : pose or stamp is not finite
        OSError : the network cannot be reached
        """
        stamp = self._clock() if stamp is None else stamp
        if not all(map(math.isfinite, (stamp, *pose))):
            raise GeometryError(f"pose and stamp must be finite, got {pose!r} at {stamp!r}")
        packet = Packet(self._robot, self._session, self._sequence, stamp, pose)
        self._sequence += 1
        try:
            self._socket.sendto(pack(packet, self._key), self._address)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()

    def __enter__(self) -> PoseSender:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _check_key(key: bytes) -> None:
    if not (isinstance(key, bytes) and key):
        raise ConfigurationError("key must be bytes, such as read_key gives, and not empty")


def _check_number(name: str, value: int) -> int:
    if not (isinstance(value, int) and 0 <= value < 1 << 16):
        raise ConfigurationError(f"{name} must be an integer from 0 to 65535, got {value!r}")
    return value


def _socket_for(host: str, port: int) -> socket.socket:
    """A socket that does not wait, of the family of an address given in digits or by name."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0][0]
    except (OSError, UnicodeError, OverflowError) as error:
        raise ConfigurationError(f"no address for {host!r}, port {port!r}: {error}") from error
    made = socket.socket(family, socket.SOCK_DGRAM)
    made.setblocking(False)
    return made
