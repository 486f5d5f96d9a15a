"""The flight recorder: the control thread hands a tick over, another thread writes it.

Handing over is an append to a queue in memory, a fraction of a microsecond; it never waits. The
queue is bounded: where the writer falls behind it by ``capacity`` entries (a disk that hangs), new
entries are dropped and counted, and their numbers are missing in the log.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import threading
import time
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple

import clfcbf
from clfcbf.decision import Decision
from clfcbf.errors import ConfigurationError, LogError, MissingExtraError
from clfcbf.recorder.blueprint import Configuration
from clfcbf.recorder.entries import (
    SCHEMA,
    TASK_SCHEMA,
    Given,
    Inputs,
    given_by,
    message_of,
)
from clfcbf.recorder.header import HEADER, TASK_TOPIC, TICK_TOPIC, TRAILER, header_of, sealed
from clfcbf.runtime.loop import Tick

if TYPE_CHECKING:
    from mcap.writer import Writer

__all__ = ["FlightRecorder"]

CAPACITY = 2048
"""Entries that may wait: a minute at 30 Hz, longer than an SD card stalls, and some 10 MB."""

CHUNK_TIME = 1.0
"""[s] Between two chunks: what a power failure costs at most; shorter ones compress worse."""

POLL = 0.02
"""[s] Between two looks at the queue: waking the writer would cost the control thread more than
the hand-over itself."""

CHUNK_SIZE = 1 << 18
"""[byte] At which a chunk is ended before its time."""

JOIN_TIME = 10.0
"""[s] That closing waits for the writer; a disk that hangs for longer does not come back."""


class _Task(NamedTuple):
    undock: float
    fresh: bool


class FlightRecorder:
    """Writes every tick of a controller to an MCAP file, from its first on.

    As ``on_tick`` of a :class:`~clfcbf.runtime.ControlLoop` give it :meth:`on_tick`; without a
    loop, call :meth:`record` after each tick. A chunk is on the disk every ``chunk_time``, so that
    a process that is killed, or a machine that loses power, leaves a log that ends there.

    Parameters
    ----------
    path : of the log; a file that exists is not overwritten
    configuration : of the controller (its ``config``), for the replay
    chunk_time : between two chunks [s]
    capacity : entries that may wait to be written
    synchronous : each chunk is forced to the disk, for power failures; ``kill -9`` needs no such

    Raises
    ------
    ConfigurationError : the file exists or cannot be made, or a number is out of range
    MissingExtraError : ``mcap`` is not installed
    """

    def __init__(
        self,
        path: Path | str,
        configuration: Configuration,
        *,
        chunk_time: float = CHUNK_TIME,
        capacity: int = CAPACITY,
        synchronous: bool = True,
    ) -> None:
        if not 0.0 < chunk_time < math.inf:
            raise ConfigurationError(
                f"chunk_time must be finite and positive [s], got {chunk_time!r}"
            )
        if not (isinstance(capacity, int) and capacity >= 1):
            raise ConfigurationError(f"capacity must be an integer >= 1, got {capacity!r}")
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise MissingExtraError("mcap", "record") from error
        self._header = header_of(configuration)
        try:
            self._file = open(path, "xb")  # noqa: SIM115  # closed by its writer
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigurationError(f"cannot record to {str(path)!r}: {reason}") from error
        self._writer = Writer(self._file, chunk_size=CHUNK_SIZE)
        self._chunk_time = chunk_time
        self._capacity = capacity
        self._synchronous = synchronous
        self._queue: deque[tuple[int, Tick | Given | _Task]] = deque()
        self._number = 0
        self._dropped = 0
        self._error: Exception | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flight recorder", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    @property
    def dropped(self) -> int:
        """Entries dropped because the queue was full."""
        return self._dropped

    @property
    def error(self) -> Exception | None:
        """Why nothing is written any more; None as long as all is well."""
        return self._error

    def on_tick(self, tick: Tick) -> None:
        """Take a tick of the loop around a docking controller; never waits, never raises."""
        self._put(tick)

    def record(self, inputs: Inputs, now: float, decision: Decision) -> None:
        """Take a tick with the inputs of its pure function; never waits, never raises."""
        self._put(Given(inputs, now, decision))

    def given(self, given: Given) -> None:
        """Take a tick as it is to be written; never waits, never raises."""
        self._put(given)

    def task(self, undock: float = 0.0, *, fresh: bool = False) -> None:
        """Note that the controller's ``dock()`` or ``undock(distance)`` was called, for replay.

        ``fresh`` notes that another controller has taken its place.
        """
        self._put(_Task(float(undock), fresh))

    def _put(self, entry: Tick | Given | _Task) -> None:
        number = self._number
        self._number = number + 1
        if len(self._queue) < self._capacity:
            self._queue.append((number, entry))
        else:
            self._dropped += 1

    def close(self) -> None:
        """Write what is left and end the log; a second call does nothing.

        Raises
        ------
        LogError : something could not be written
        """
        if self._closing.is_set():
            return
        self._closing.set()
        atexit.unregister(self.close)
        self._thread.join(JOIN_TIME)
        if self._thread.is_alive():
            raise LogError(f"the log was not written within {JOIN_TIME:g} s; it may be incomplete")
        if self._error is not None:
            raise LogError(f"the log is incomplete: {self._error}") from self._error

    def __enter__(self) -> FlightRecorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except LogError:
            if error is None:  # what has ended the run matters more; ``self.error`` is kept
                raise

    def _run(self) -> None:
        """The writer's thread, until the log is closed or cannot be written."""
        try:
            with self._file:
                self._write()
        except Exception as error:  # such as a full disk: the robot drives on without a recorder
            self._error = error

    def _write(self) -> None:
        writer = self._writer
        writer.start(profile="x-clfcbf", library=f"clfcbf {clfcbf.__version__}")
        writer.add_metadata(HEADER, self._header)
        channels = _Channels(writer)
        self._finish_chunk()
        due = time.monotonic() + self._chunk_time
        while True:
            closing = self._closing.wait(POLL)
            while self._queue:
                number, entry = self._queue.popleft()
                channels.add(number, entry)
                # Between two entries the control thread may have the interpreter back.
                time.sleep(0.0)
            if closing:
                break
            if time.monotonic() >= due:
                self._finish_chunk()
                due = time.monotonic() + self._chunk_time
        writer.flush()  # type: ignore[no-untyped-call]
        told = {"entries": str(self._number), "dropped": str(self._dropped)}
        writer.add_metadata(TRAILER, sealed(told))
        writer.finish()  # type: ignore[no-untyped-call]
        self._finish_file()

    def _finish_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._finish_file()

    def _finish_file(self) -> None:
        self._file.flush()
        if self._synchronous:
            os.fsync(self._file.fileno())


class _Channels:
    """The two channels of a log, and what is written to them."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        tick = writer.register_schema("clfcbf.Tick", "jsonschema", SCHEMA)
        task = writer.register_schema("clfcbf.Task", "jsonschema", TASK_SCHEMA)
        self._tick = writer.register_channel(TICK_TOPIC, "json", tick)
        self._task = writer.register_channel(TASK_TOPIC, "json", task)
        self._start: float | None = None
        self._wall = self._latest = time.time_ns()

    def add(self, number: int, entry: Tick | Given | _Task) -> None:
        if isinstance(entry, _Task):
            channel = self._task
            data = json.dumps({"number": number, **entry._asdict()}).encode()
        else:
            given = given_by(entry) if isinstance(entry, Tick) else entry
            channel, data = self._tick, message_of(number, given)
            self._latest = self._time_of(given.now)
        self._writer.add_message(channel, self._latest, data, self._latest, number & 0xFFFFFFFF)

    def _time_of(self, now: float) -> int:
        """Time of day [ns] for viewers, as far as the loop's clock means anything."""
        if not (isinstance(now, int | float) and math.isfinite(now)):
            return self._latest
        if self._start is None:
            self._start = now
        elapsed = now - self._start
        return self._wall + round(1e9 * elapsed) if 0.0 <= elapsed < 1e9 else self._latest
