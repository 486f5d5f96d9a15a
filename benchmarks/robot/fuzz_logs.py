"""Flight recorder's logs: cut, damaged, and sound in every checksum but hostile in content."""

from __future__ import annotations

import functools
import json
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robot.broken import BrokenError, HungError
from benchmarks.robot.mutation import mutated_bytes, mutated_tree
from benchmarks.robot.rig import DOCKS, Setting, make_rig
from clfcbf.errors import ClfcbfError, MissingExtraError
from clfcbf.explain import explain
from clfcbf.recorder import FlightRecorder, LogEnd, LoggedTick, SessionRecorder, read_log, replay
from clfcbf.recorder.header import HEADER, TASK_TOPIC, TICK_TOPIC, TRAILER, sealed
from clfcbf.runtime import ControlLoop
from clfcbf.safety_filter import FilterInputs, SafetyFilter
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist
from clfcbf.session import DockingSession, PhaseControllers

__all__ = ["check"]

EXPLAINED = 5
"""Ticks of a log that are explained."""

DRAWN = 0.04
"""Share of the logs that are drawn too, which takes a third of a second."""

FLIGHT, OUT = 1.2, 0.5
"""[s] Of the recorded run, toward the dock and out again."""


def _session(path: Path) -> None:
    setting = Setting(0, 0)
    rig = make_rig("direct", setting)
    with FlightRecorder(path, setting.controller().config, synchronous=False) as recorder:
        watch = SessionRecorder(recorder)
        session = DockingSession(
            PhaseControllers(lambda dock: watch.controller(setting.controller())), DOCKS,
            setting.bounds, setting.period,
        )  # fmt: skip
        loop = ControlLoop(
            session, rig.chassis, rig.sensor, rig.clock, period=setting.period,
            limits=setting.bounds, on_tick=watch.on_tick,
        )  # fmt: skip
        session.dock("a")
        loop.run(FLIGHT)
        session.cancel()
        loop.run(FLIGHT)
        session.undock("a")
        loop.run(OUT)
    rig.close()


def _filter(path: Path) -> None:
    setting = Setting(0, 0)
    config = setting.controller().config
    safety = SafetyFilter(setting.bounds, config.filter.barriers, setting.period, lag=0.12)
    scene = Scene(Pose2(1.4, 0.1, 0.0), Pose2(2.0, 0.1, 0.0), 0.0)
    applied = Twist(0.0, 0.0)
    with FlightRecorder(path, safety.config, synchronous=False) as recorder:
        for k in range(15):
            inputs = FilterInputs(Twist(0.2, 0.3), scene, applied)
            decision = safety.filter(*inputs, k * setting.period)
            recorder.record(inputs, k * setting.period, decision)
            applied = decision.twist


class _Base:
    """A sound log in its pieces."""

    def __init__(self, path: Path) -> None:
        from mcap.records import Channel, Message
        from mcap.stream_reader import StreamReader

        self.whole = path.read_bytes()
        log = read_log(path)
        self.header = dict(log.header)
        self.messages: list[tuple[str, Any]] = []
        topics: dict[int, str] = {}
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    entry = topics[record.channel_id], json.loads(record.data)
                    self.messages.append(entry)


@functools.cache
def _bases() -> tuple[_Base, ...]:
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, record in (("session", _session), ("filter", _filter)):
            path = Path(folder) / name
            record(path)
            found.append(_Base(path))
    return tuple(found)


def _rewritten(rng: np.random.Generator, base: _Base) -> bytes:
    """The log with some of its content changed, and every checksum made to fit."""
    from io import BytesIO

    from mcap.writer import CompressionType, Writer

    header, messages = dict(base.header), list(base.messages)
    if rng.random() < 0.4:
        tree, _ = mutated_tree(rng, json.loads(header["configuration"]), 3)
        header["configuration"] = json.dumps(tree)
    elif rng.random() < 0.1:
        header = {key: text for key, text in header.items() if rng.random() < 0.8}
    else:
        for _ in range(int(rng.integers(1, 5))):
            at = int(rng.integers(len(messages)))
            topic, content = messages[at]
            messages[at] = topic, mutated_tree(rng, content, 4)[0]
    match int(rng.integers(8)):
        case 0:
            at, other = rng.integers(len(messages), size=2)
            messages[at], messages[other] = messages[other], messages[at]
        case 1:
            messages = messages[: int(rng.integers(len(messages) + 1))]
        case 2:
            messages = [
                (TASK_TOPIC if rng.random() < 0.1 else topic, content)
                for topic, content in messages
            ]
        case _:
            pass
    sink = BytesIO()
    packed = CompressionType.ZSTD if rng.random() < 0.5 else CompressionType.NONE
    writer = Writer(sink, compression=packed, chunk_size=int(rng.choice([1 << 12, 1 << 18])))
    writer.start()
    writer.add_metadata(HEADER, sealed(header))
    channels = {topic: writer.register_channel(topic, "json", 0)
                for topic in (TICK_TOPIC, TASK_TOPIC)}  # fmt: skip
    for topic, content in messages:
        writer.add_message(channels[topic], 0, json.dumps(content).encode(), 0)
    count = len(messages) if rng.random() < 0.9 else int(rng.integers(-5, 1000))
    writer.add_metadata(TRAILER, sealed({"entries": str(count), "dropped": "0"}))
    writer.finish()  # type: ignore[no-untyped-call]
    return sink.getvalue()


def check(rng: np.random.Generator) -> Counter[str]:
    """One log through every reader."""
    bases = _bases()
    base = bases[int(rng.integers(len(bases)))]
    data = mutated_bytes(rng, base.whole) if rng.random() < 0.4 else _rewritten(rng, base)
    if rng.random() < 0.1:
        data = mutated_bytes(rng, data, 1)
    drawn = rng.random() < DRAWN
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        path.write_bytes(data)
        try:
            return Counter([_read(path, drawn)])
        except HungError as hung:
            raise BrokenError("its readers hang", data) from hung
        except Exception as error:
            raise BrokenError(f"{type(error).__name__}: {error}", data) from error


def _read(path: Path, drawn: bool) -> str:
    """What the readers make of a file."""
    try:
        log = read_log(path)
    except MissingExtraError:
        raise
    except ClfcbfError:
        return "no log"
    entries = list(log.entries())
    assert isinstance(entries[-1], LogEnd)
    ticks = [entry for entry in entries if isinstance(entry, LoggedTick)]
    for tick in ticks[:: max(1, len(ticks) // EXPLAINED)]:
        str(explain(tick.decision))
        try:
            log.tick_at(tick.now - ticks[0].now)
        except ClfcbfError:
            continue
    try:
        if drawn:
            from clfcbf.recorder.figure import log_figure

            log_figure(log).canvas.draw()
    except ClfcbfError:
        pass
    try:
        found = replay(log)
    except ClfcbfError:
        return "replay refused"
    if found.reproduced:
        return "reproduced"
    return "damaged" if not (found.end.intact or found.end.cut) else "differs or ends early"
