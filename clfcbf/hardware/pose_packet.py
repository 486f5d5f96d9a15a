r"""One pose in one packet of fixed size, authenticated; and the key that two robots share.

Big-endian: magic and version, sender, session, sequence, stamp, pose, and the tag, the HMAC-SHA256
[Krawczyk1997]_ of all before it. Anybody who listens can read the pose; nobody without the key can
make one, or change one.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import stat
import struct
from pathlib import Path
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2

__all__ = ["PACKET_SIZE", "SESSION_SIZE", "Packet", "create_key", "pack", "read_key", "unpack"]

SESSION_SIZE = 16
"""[byte] Of a session's random name: 128 bits, two are never the same."""

KEY_SIZE = 32
"""[byte] Least length of a key: the length of the hash, as its standard recommends."""

_LONGEST = 1024
"""[byte] Of a key's file; a longer one holds something else."""

_MAGIC = b"CFP1"
_LAYOUT = struct.Struct(">4sH16sQdddd")
_TAG_SIZE = 32

PACKET_SIZE = _LAYOUT.size + _TAG_SIZE
"""[byte] Of every packet, without exception."""


class Packet(NamedTuple):
    """What a packet says.

    Attributes
    ----------
    sender : number of the robot, 0 to 65535
    session : random bytes, drawn each time the sender starts
    sequence : counts the packets of a session
    stamp : when the pose was true [s], on a clock that both robots share
    pose : of the sender, in a frame that both robots share
    """

    sender: int
    session: bytes
    sequence: int
    stamp: float
    pose: Pose2


def pack(packet: Packet, key: bytes) -> bytes:
    """The bytes of a packet."""
    sender, session, sequence, stamp, pose = packet
    body = _LAYOUT.pack(_MAGIC, sender, session, sequence, stamp, *pose)
    return body + _tag(body, key)


def unpack(data: bytes, key: bytes) -> Packet | None:
    """What ``data`` (of ``PACKET_SIZE`` bytes) says; None unless its tag is the key's.

    The tags are compared in a time that does not tell how much of them agrees.
    """
    body = data[: _LAYOUT.size]
    if not hmac.compare_digest(_tag(body, key), data[_LAYOUT.size :]) or body[:4] != _MAGIC:
        return None
    _, sender, session, sequence, stamp, x, y, theta = _LAYOUT.unpack(body)
    return Packet(sender, session, sequence, stamp, Pose2(x, y, theta))


def _tag(body: bytes, key: bytes) -> bytes:
    return hmac.digest(key, body, hashlib.sha256().name)


def create_key(path: Path | str) -> None:
    """Write a new random key, in hexadecimal, that only its owner may read.

    Raises
    ------
    ConfigurationError : the file exists or cannot be made
    """
    try:
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise ConfigurationError(f"cannot make key {str(path)!r}: {error.strerror}") from error
    with os.fdopen(number, "w", encoding="ascii") as file:
        file.write(secrets.token_hex(KEY_SIZE) + "\n")


def read_key(path: Path | str) -> bytes:
    """The key in a file, in hexadecimal; a key that others may read is none.

    Raises
    ------
    ConfigurationError : the file cannot be read, is not the user's own regular file, may be
        read or written by others (where the system has such permissions), or holds no key of
        ``KEY_SIZE`` bytes at least. The message never holds any of the content.
    """
    name = repr(str(path))
    try:
        # Not waiting for who might write to a pipe of that name.
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (OSError, ValueError) as error:  # a name may be none
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigurationError(f"cannot read key {name}: {reason}") from error
    try:
        _check_owner(os.fstat(number), name)
        content = os.read(number, _LONGEST + 1)
    finally:
        os.close(number)
    if len(content) > _LONGEST:
        raise ConfigurationError(f"key {name} must have at most {_LONGEST} characters, got more")
    try:
        key = bytes.fromhex(content.decode("ascii").strip())
    except ValueError:
        raise ConfigurationError(
            f"key {name} must be hexadecimal digits and nothing else"
        ) from None
    if len(key) < KEY_SIZE:
        raise ConfigurationError(f"key {name} must have at least {KEY_SIZE} bytes, got {len(key)}")
    return key


def _check_owner(status: os.stat_result, name: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise ConfigurationError(f"key {name} is no regular file")
    if os.name != "posix":
        return  # where files have access lists, their modes say nothing
    if stat.S_IMODE(status.st_mode) & 0o077:
        mode = stat.S_IMODE(status.st_mode)
        raise ConfigurationError(
            f"key {name} must be its owner's alone, mode 0600 or 0400, got {mode:04o}"
        )
    if status.st_uid not in (0, os.geteuid()):
        raise ConfigurationError(
            f"key {name} must belong to user {os.geteuid()} or 0, got {status.st_uid}"
        )
