"""A log read from its file, entry by entry, as far as it is whole.

The file is untrusted: every piece is checked (size, checksum, types) before it is used, and none
larger than ``LARGEST`` is taken. An hour of ticks never is in memory at once.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from clfcbf.errors import LogError, MissingExtraError
from clfcbf.recorder.blueprint import Configuration, configuration_from_json
from clfcbf.recorder.entries import Entry, LogEnd, LoggedTask, LoggedTick, Unrecorded, entry_of
from clfcbf.recorder.header import FORMAT, HEADER, TASK_TOPIC, TICK_TOPIC, TRAILER, is_sealed

if TYPE_CHECKING:
    from mcap.records import Chunk

__all__ = ["LARGEST", "FlightLog", "is_log", "read_log"]

LARGEST = 1 << 24
"""[byte] Of a piece of the file, also unpacked: 64 times what the recorder writes."""

_HOLD = 1.0
"""[s] That the last command of a log is taken to be in force: a chassis's own time-out."""

_MAGIC = b"\x89MCAP0\r\n"
_FRAME = struct.Struct("<BQ")  # opcode and length of a record
_HEADER, _FOOTER, _CHUNK, _METADATA, _LAST = 0x01, 0x02, 0x06, 0x0C, 0x0F  # MCAP's opcodes


class _CutError(Exception):
    """The file ends within a record."""


class _DamagedError(Exception):
    """A record is not what was written."""


class _Record(NamedTuple):
    opcode: int
    content: bytes
    at: int


class FlightLog:
    """A log: its header, and its entries whenever they are asked for.

    Attributes
    ----------
    path : of the file
    header : the texts at its head: configuration, versions, when it was begun
    """

    def __init__(self, path: Path, header: Mapping[str, str]) -> None:
        self.path = path
        self.header = header

    def configuration(self) -> Configuration:
        """The controller's configuration; takes a tenth of a second.

        Raises
        ------
        LogError : it holds a part that is not the library's own
        """
        return configuration_from_json(self.header.get("configuration", ""))

    def entries(self) -> Iterator[Entry]:
        """The entries as they were handed over; the last one, and no other, is a ``LogEnd``.

        Raises
        ------
        LogError : the file cannot be read any more
        """
        try:
            with self.path.open("rb") as file:
                yield from _entries(file)
        except OSError as error:
            raise _unreadable(self.path, error) from error

    def ticks(self) -> Iterator[LoggedTick]:
        """The ticks among the entries, at least one.

        Raises
        ------
        LogError : there is none
        """
        empty = True
        for entry in self.entries():
            if isinstance(entry, LoggedTick):
                empty = False
                yield entry
            elif isinstance(entry, LogEnd) and empty:
                reason = f": {entry.reason}" if entry.reason else ""
                raise LogError(f"{str(self.path)!r} holds no tick{reason}")

    def tick_at(self, time: float) -> LoggedTick:
        """The tick whose command was in force ``time`` [s] after the log's first tick.

        Raises
        ------
        LogError : the time is negative, or after the last tick by more than a second
        """
        start: float | None = None
        found: LoggedTick | None = None
        last = -math.inf
        for tick in self.ticks():
            start = tick.now if start is None else start
            last = tick.now - start
            if last > time:
                break
            found = tick
        if found is None or not 0.0 <= time <= last + _HOLD:
            raise LogError(f"the log has ticks from 0 to {last:.3f} s, got {time!r}")
        return found


def is_log(path: Path) -> bool:
    """Whether the file begins as a log does; False where it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except (OSError, ValueError):  # a name may be none
        return False


def read_log(path: Path | str) -> FlightLog:
    """Open a log.

    Raises
    ------
    LogError : the file cannot be read, is no log, or is damaged at its head
    MissingExtraError : ``mcap`` is not installed
    """
    path = Path(path)
    try:
        import mcap.stream_reader  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("mcap", "record") from error
    try:
        with path.open("rb") as file:
            records = _records(file)
            first, second = next(records, None), next(records, None)
    except (OSError, ValueError) as error:  # a name may be none
        raise _unreadable(path, error) from error
    except (_CutError, _DamagedError) as error:
        raise LogError(f"{str(path)!r} is no log of a flight recorder: {error}") from error
    if first is None or second is None or first.opcode != _HEADER:
        raise LogError(f"{str(path)!r} is no log of a flight recorder: its head is missing")
    try:
        header = _metadata(second, HEADER)
    except _DamagedError as error:
        raise LogError(f"{str(path)!r} is no log of a flight recorder: {error}") from error
    if header is None:
        raise LogError(f"{str(path)!r} is an MCAP file, but no log of a flight recorder")
    if header.get("format") != FORMAT:
        raise LogError(
            f"{str(path)!r} has format {header.get('format')!r}; this version reads {FORMAT!r}"
        )
    return FlightLog(path, header)


def _unreadable(path: Path, error: Exception) -> LogError:
    reason = getattr(error, "strerror", None) or str(error)
    return LogError(f"cannot read {str(path)!r}: {reason}")


def _records(file: BinaryIO) -> Iterator[_Record]:
    """The records up to the footer, whole ones only."""
    size = file.seek(0, 2)
    file.seek(0)
    if file.read(len(_MAGIC)) != _MAGIC:
        raise _DamagedError("it does not begin as an MCAP file")
    at = len(_MAGIC)
    while True:
        frame = file.read(_FRAME.size)
        if len(frame) < _FRAME.size:
            raise _CutError(f"the file ends at byte {size}, without a footer")
        opcode, length = _FRAME.unpack(frame)
        if not 0 < opcode <= _LAST or length > LARGEST:
            raise _DamagedError(f"the record at byte {at} is damaged")
        content = file.read(length)
        if len(content) < length:
            raise _CutError(f"the file ends at byte {size}, within the record at byte {at}")
        yield _Record(opcode, content, at)
        if opcode == _FOOTER:
            return
        at += _FRAME.size + length


def _entries(file: BinaryIO) -> Iterator[Entry]:
    topics: dict[int, str] = {}
    trailer: Mapping[str, str] | None = None
    latest = -1
    try:
        for record in _records(file):
            if record.opcode == _CHUNK:
                for entry in _chunk_entries(record, topics):
                    if not entry.number > latest:
                        where = f"in the chunk at byte {record.at}"
                        raise _DamagedError(f"entry {entry.number} {where} follows entry {latest}")
                    latest = entry.number
                    yield entry
            elif record.opcode == _METADATA:
                trailer = _metadata(record, TRAILER) or trailer
        if trailer is None:
            raise _DamagedError("the log has a footer, but its trailer is missing")
        entries, dropped = _counts(trailer)
    except _CutError as error:
        yield LogEnd(False, True, str(error), 0)
    except _DamagedError as error:
        yield LogEnd(False, False, str(error), 0)
    else:
        yield LogEnd(True, False, "", dropped) if latest < entries else _overfull(latest, entries)


def _overfull(latest: int, entries: int) -> LogEnd:
    return LogEnd(False, False, f"entry {latest} is there, of {entries} that were recorded", 0)


def _counts(trailer: Mapping[str, str]) -> tuple[int, int]:
    try:
        return int(trailer["entries"]), int(trailer["dropped"])
    except (KeyError, ValueError) as error:
        raise _DamagedError(f"the log's trailer is damaged: {error}") from error


def _metadata(record: _Record, name: str) -> Mapping[str, str] | None:
    """The texts of a metadata record; None where it has another name."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Metadata

    if record.opcode != _METADATA:
        return None
    found = _parsed(lambda: Metadata.read(ReadDataStream(BytesIO(record.content))), record)
    if found.name != name:
        return None
    if not is_sealed(found.metadata):
        raise _DamagedError(f"the {name} at byte {record.at} is damaged: its checksum is wrong")
    content: Mapping[str, str] = found.metadata
    return content


def _chunk_entries(
    record: _Record, topics: dict[int, str]
) -> Iterator[LoggedTick | LoggedTask | Unrecorded]:
    """The entries of a chunk, once the whole of it was found to be sound."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Channel, Chunk, Message
    from mcap.stream_reader import breakup_chunk

    chunk = _parsed(lambda: Chunk.read(ReadDataStream(BytesIO(record.content))), record)
    _check_size(chunk, record)
    for part in _parsed(lambda: breakup_chunk(chunk, validate_crc=True), record):
        if isinstance(part, Channel):
            topics[part.id] = part.topic
        elif isinstance(part, Message) and topics.get(part.channel_id) in (TICK_TOPIC, TASK_TOPIC):
            try:
                yield entry_of(topics[part.channel_id] == TASK_TOPIC, part.data)
            except LogError as error:
                raise _DamagedError(f"in the chunk at byte {record.at}: {error}") from error


def _check_size(chunk: Chunk, record: _Record) -> None:
    """Refuse what would unpack to more than it says, or has no checksum."""
    if chunk.compression == "zstd":
        import zstandard

        parameters = _parsed(lambda: zstandard.get_frame_parameters(chunk.data), record)
        size = parameters.content_size
    elif chunk.compression == "":
        size = len(chunk.data)
    else:
        raise _DamagedError(f"the chunk at byte {record.at} is packed by {chunk.compression!r}")
    if not size == chunk.uncompressed_size <= LARGEST or chunk.uncompressed_crc == 0:
        raise _DamagedError(f"the chunk at byte {record.at} is damaged")


def _parsed(parse: Any, record: _Record) -> Any:
    """What a parser of the library makes of a record; whatever it raises is damage."""
    try:
        return parse()
    except Exception as error:  # of struct, zlib, zstandard or mcap: their kinds are many
        told = str(error) or type(error).__name__
        raise _DamagedError(f"the record at byte {record.at} is damaged: {told}") from error
