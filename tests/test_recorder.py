"""The flight recorder: nothing waits for it, nothing crashes on its logs, all is reproduced."""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clfcbf import cli
from clfcbf.camera import FieldOfView
from clfcbf.constraints.capsule import Capsule
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.obstacle_set import Obstacles
from clfcbf.constraints.obstacles import ObstacleBarrier
from clfcbf.constraints.range_band import RangeBarrier
from clfcbf.controller import DockingController, TrackingController, TrackingInputs
from clfcbf.decision import Decision, Status
from clfcbf.docking import DockingInputs, DockingState
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.explain import explain
from clfcbf.limits import Limits
from clfcbf.recorder import (
    FlightRecorder,
    LogEnd,
    LogError,
    LoggedTask,
    LoggedTick,
    SessionInputs,
    SessionRecorder,
    Unrecorded,
    configuration_from_json,
    configuration_to_json,
    is_log,
    read_log,
    replay,
)
from clfcbf.recorder import flight as flight_module
from clfcbf.recorder.entries import Given, message_of
from clfcbf.runtime import ControlLoop, LoopPolicy, Overrun, PlantInTheLoop
from clfcbf.runtime.loop import Tick
from clfcbf.safety_filter import FilterInputs, SafetyFilter
from clfcbf.scene import Observation, Reference, Scene
from clfcbf.se2 import Pose2, Twist
from clfcbf.session import Dock, DockDatabase, DockingSession, DockType, PhaseControllers
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from tests.strategies import any_float

pytest.importorskip("mcap", reason="the flight recorder needs the extra record")
needs_cli = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("tyro", "matplotlib")),
    reason="the command line needs the extras cli and viz",
)

PERIOD = 1.0 / 30.0
ROBOT = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
REST = Twist(0.0, 0.0)
SCENE = Scene(Pose2(1.4, 0.1, 0.0), Pose2(2.0, 0.1, 0.0), 0.0)
DECISION = Decision(Twist(0.01, 0.0), Status.OPTIMAL, True, Twist(0.2, 0.0), 0.3)


START = Pose2(-1.6, 0.2, 0.0)


def robot(start=START):
    world = World()
    rng = np.random.default_rng(5)
    plant = KinematicPlant(start, LIMITS["approaching"], Body(), rng)
    sensor = PoseSensor(plant, world.camera, world.standoff, SensorModel.named("A"), rng)
    controller = DockingController(
        LIMITS["approaching"], world.camera, world.standoff, world.period, lag=Body().lag
    )
    return PlantInTheLoop(plant, sensor), controller


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The log of a whole simulated run, in many chunks, and the commands that were sent."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    parts, controller = robot()
    sent = []
    with FlightRecorder(path, controller.config, synchronous=False, chunk_time=0.02) as recorder:

        def on_tick(tick):
            recorder.on_tick(tick)
            sent.append(tick.command)
            time.sleep(0.001)

        ControlLoop(
            controller, parts, parts, parts, period=PERIOD, limits=LIMITS["approaching"],
            on_tick=on_tick,
        ).run(60.0)  # fmt: skip
    return path, sent


def bits(values):
    return np.array(values).tobytes()


def filtered(path, ticks=40, wish=lambda k: Twist(0.3 * math.sin(0.2 * k), 0.3), **options):
    """A log of a bare filter."""
    safe = SafetyFilter(ROBOT, options.pop("barriers", [CAMERA]), PERIOD, lag=0.12)
    applied = REST
    with FlightRecorder(path, safe.config, synchronous=False, **options) as recorder:
        for k in range(ticks):
            inputs = FilterInputs(wish(k), SCENE, applied)
            decision = safe.filter(*inputs, k * PERIOD)
            recorder.record(inputs, k * PERIOD, decision)
            applied = decision.twist
    return path


# A log and its replay ----------------------------------------------------------------------------


def test_a_run_is_recorded_whole_and_reproduced_to_the_last_bit(run):
    path, sent = run
    log = read_log(path)
    entries = list(log.entries())
    assert entries[-1] == LogEnd(True, False, "", 0)
    assert [type(entry) for entry in entries[:-1]] == [LoggedTick] * len(sent)
    assert bits([entry.command for entry in entries[:-1]]) == bits(sent)
    assert entries[-2].decision.done
    found = replay(log)
    assert found.reproduced
    assert (found.ticks, found.commands, found.decisions) == (len(sent), 0, 0)
    assert found.first is None
    assert str(found) == f"{len(sent)} ticks replayed: every command to the last bit"


def test_another_configuration_is_told_from_the_log_s_own(run):
    path, _ = run
    log = read_log(path)
    own = log.configuration()
    other = dataclasses.replace(
        own, filter=dataclasses.replace(own.filter, weight=(1.0, 0.0, 0.300001))
    )
    found = replay(log, other)
    assert found.decisions > 0
    assert found.first is not None
    assert "weight" in found.first.fields


def test_one_bit_of_one_command_is_found(run, tmp_path):
    """The log of the run, written again with the last bit of one command turned."""
    path, _ = run
    log = read_log(path)
    ticks = list(log.ticks())
    changed = ticks[100].decision.twist
    changed = changed._replace(v=math.nextafter(changed.v, 1.0))
    with FlightRecorder(tmp_path / "one", log.configuration(), synchronous=False) as recorder:
        for k, tick in enumerate(ticks):
            wrong = tick.decision._replace(twist=changed)
            recorder.record(tick.inputs, tick.now, wrong if k == 100 else tick.decision)
    found = replay(read_log(tmp_path / "one"))
    assert not found.reproduced
    assert (found.commands, found.decisions) == (1, 1)
    assert found.first is not None
    assert (found.first.tick, found.first.fields) == (100, ("command", "twist"))
    assert found.first.recorded == changed
    assert found.first.replayed == ticks[100].decision.twist
    assert repr(changed.v) in str(found)
    assert repr(ticks[100].decision.twist.v) in str(found)


def test_a_zero_s_sign_is_a_difference(tmp_path):
    path = filtered(tmp_path / "a", 1, lambda k: REST)
    (tick,) = read_log(path).ticks()
    assert bits(tick.decision.twist) == bits(REST)
    negative = tick.decision._replace(twist=Twist(-0.0, 0.0))
    with FlightRecorder(tmp_path / "b", read_log(path).configuration()) as recorder:
        recorder.record(tick.inputs, tick.now, negative)
    assert replay(read_log(tmp_path / "b")).commands == 1


def test_tasks_between_ticks_are_replayed(tmp_path):
    parts, controller = robot(Pose2(-0.4, 0.0, 0.0))
    path = tmp_path / "run"
    with FlightRecorder(path, controller.config, synchronous=False) as recorder:
        loop = ControlLoop(
            controller, parts, parts, parts, period=PERIOD, limits=LIMITS["approaching"],
            on_tick=recorder.on_tick,
        )  # fmt: skip
        loop.run(30.0)
        controller.undock(0.1)
        recorder.task(0.1)
        loop.run(30.0)
        controller.dock()
        recorder.task()
        loop.run(2.0)
    tasks = [e for e in read_log(path).entries() if isinstance(e, LoggedTask)]
    assert [task.undock for task in tasks] == [0.1, 0.0]
    found = replay(read_log(path))
    assert found.reproduced
    assert found.decisions == 0
    assert min(tick.command.v for tick in read_log(path).ticks()) < -0.05


def test_the_loop_s_own_brake_is_replayed(tmp_path):
    """Ticks that come too late are answered by the loop's brake: commands of the log, too."""
    parts, controller = robot()

    class Slow:
        """A controller that takes two periods for some of its ticks."""

        def __init__(self):
            self.number = 0

        def step(self, observation, applied, now):
            self.number += 1
            decision = controller.step(observation, applied, now)
            if self.number % 40 > 31:
                parts.sleep_until(now + 2.5 * PERIOD)
            return decision

    path = tmp_path / "run"
    with FlightRecorder(path, controller.config, synchronous=False) as recorder:
        ControlLoop(
            Slow(), parts, parts, parts, period=PERIOD, limits=LIMITS["approaching"],
            on_tick=recorder.on_tick, policy=LoopPolicy(overrun=Overrun.BRAKE, misses=20),
        ).run(8.0)  # fmt: skip
    ticks = list(read_log(path).ticks())
    braked = [tick for tick in ticks if tick.command != tick.decision.twist]
    assert len(braked) > 5
    assert all(tick.loop is not None and tick.loop.missed for tick in braked)
    found = replay(read_log(path))
    assert found.reproduced
    assert found.decisions == 0


def test_each_run_of_the_loop_begins_with_its_own_brake(run, tmp_path):
    """A first tick that is late, with no command known: the loop knows of none and stands."""
    path, _ = run
    log = read_log(path)
    before = list(itertools.islice(log.ticks(), 60))
    assert before[-1].command != REST
    controller = DockingController.__new__(DockingController)
    controller.config, controller.state = log.configuration(), DockingState()
    nothing = Twist(math.nan, math.nan)
    with FlightRecorder(tmp_path / "run", controller.config, synchronous=False) as recorder:
        for tick in before:
            controller.step(*tick.inputs, tick.now)
            recorder.on_tick(Tick(*tick.loop[:4], *tick.inputs, tick.decision, *tick.loop[4:]))
        now = before[-1].now + PERIOD
        decision = controller.step(None, nothing, now)
        assert decision.twist != REST
        recorder.on_tick(Tick(0, now, now, now, None, nothing, decision, REST, True))
    found = replay(read_log(tmp_path / "run"))
    assert found.reproduced, str(found)
    assert found.ticks == 61


def test_tracking_is_replayed(tmp_path):
    controller = TrackingController(ROBOT, [CAMERA], PERIOD)
    applied, path = REST, tmp_path / "run"
    with FlightRecorder(path, controller.config) as recorder:
        for k in range(30):
            reference = Reference(Pose2(0.1, 0.02, 0.1), Twist(0.1, 0.0))
            inputs = TrackingInputs(reference, SCENE, applied)
            decision = controller.step(*inputs, k * PERIOD)
            recorder.record(inputs, k * PERIOD, decision)
            applied = decision.twist
    found = replay(read_log(path))
    assert found.reproduced
    assert found.ticks == 30
    assert found.decisions == 0


@given(
    ticks=st.lists(
        st.tuples(
            st.lists(any_float, min_size=8, max_size=8), st.sampled_from([0.0, PERIOD, 0.2, -1.0])
        ),
        min_size=1, max_size=8,
    )
)  # fmt: skip
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
def test_whatever_goes_in_is_replayed(ticks, tmp_path_factory):
    """NaN, infinities, clocks that jump: recorded and reproduced like any other tick."""
    path = tmp_path_factory.mktemp("any") / "run"
    controller = DockingController(ROBOT, CAMERA, 0.6, PERIOD)
    now = 0.0
    with FlightRecorder(path, controller.config, synchronous=False) as recorder:
        for values, step in ticks:
            now += step
            goal, feature = Pose2(*values[:3]), Pose2(*values[3:6])
            inputs = DockingInputs(Observation(goal, feature, now), Twist(*values[6:]))
            recorder.record(inputs, now, controller.step(*inputs, now))
    found = replay(read_log(path))
    assert found.reproduced, str(found)
    assert (found.ticks, found.decisions) == (len(ticks), 0)


def test_what_json_cannot_hold_is_told_and_ends_the_replay(tmp_path):
    safe = SafetyFilter(ROBOT, [CAMERA], PERIOD)
    with FlightRecorder(tmp_path / "run", safe.config) as recorder:
        for k in range(3):
            inputs = FilterInputs(Twist(0.1, 0.0), SCENE, object() if k == 1 else REST)
            decision = safe.filter(*inputs, k * PERIOD)
            recorder.record(inputs, k * PERIOD, decision)
    log = read_log(tmp_path / "run")
    kinds = [type(entry) for entry in log.entries()]
    assert kinds == [LoggedTick, Unrecorded, LoggedTick, LogEnd]
    found = replay(log)
    assert not found.reproduced
    assert found.ticks == 1
    assert "entry 1 could not be recorded: TypeError" in found.stopped


# Configurations ----------------------------------------------------------------------------------

CIRCLE = Obstacles(discs=[(1.0, 1.0, 0.2, 0.0, 0.0), (0.5, -1.0 / 3.0, 0.1, 0.1, 0.0)])
BARRIERS = [
    FieldOfViewBarrier(CAMERA, 1.0 / 3.0, 0.05, "eye", 0.01),
    RangeBarrier(0.3, 3.0, 1.0),
    ObstacleBarrier(Capsule(0.2, 0.1, 0.1), 1.0, CIRCLE, limits=ROBOT),
]


def test_every_barrier_of_the_library_is_written_and_replayed(tmp_path):
    path = filtered(tmp_path / "run", barriers=BARRIERS)
    found = replay(read_log(path))
    assert found.reproduced
    assert found.decisions == 0


@given(
    v=st.floats(0.01, 2.0), a=st.floats(0.01, 2.0), angle=st.floats(0.1, 1.5),
    x=st.floats(-1.0, 1.0), standoff=st.floats(0.3, 2.0), lag=st.floats(0.0, 0.25),
)  # fmt: skip
@settings(max_examples=50)
def test_a_configuration_comes_back_to_the_last_bit(v, a, angle, x, standoff, lag):
    controller = SafetyFilter(
        Limits(v, 0.4, a, 1.0, -0.5 * v), [FieldOfView(angle, Pose2(x, 0.0, 0.0), 0.1)],
        PERIOD, lag=lag,
    )  # fmt: skip
    text = configuration_to_json(controller.config)
    back = configuration_from_json(text)
    assert back == controller.config
    assert configuration_to_json(back) == text


def test_parts_of_one_s_own_need_the_configuration(tmp_path):
    class Mine(FieldOfViewBarrier):
        pass

    path = filtered(tmp_path / "run", barriers=[Mine(CAMERA, 1.0)])
    log = read_log(path)
    assert len(list(log.ticks())) == 40
    with pytest.raises(LogError, match=r"Mine.*give replay the configuration"):
        replay(log)
    safe = SafetyFilter(ROBOT, [Mine(CAMERA, 1.0)], PERIOD, lag=0.12)
    assert replay(log, safe.config).reproduced


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "unusable"),
        ("[" * 100_000, "unusable"),
        ("{}", "holds a None"),
        ('{"kind": "os.system"}', "holds a 'os.system'; valid: Capsule"),
        ('{"kind": ["Limits"]}', "holds a"),
        ('{"kind": "Limits", "v_max": 1.0}', "unusable"),
        ('{"kind": "Limits", "power": 1.0}', "has a 'power'; valid: v_max"),
        ('{"kind": "Frame", "value": "moon"}', "unusable"),
        ('{"kind": "Pose2", "x": 1, "y": 2, "theta": 3}', "no controller's but a Pose2"),
        ('{"number": "many"}', "unusable"),
    ],
)
def test_a_configuration_is_built_of_nothing_else(text, told):
    with pytest.raises(LogError, match=told):
        configuration_from_json(text)


def test_inputs_of_another_controller_are_refused(run, tmp_path):
    path, _ = run
    safe = SafetyFilter(ROBOT, [CAMERA], PERIOD)
    with pytest.raises(LogError, match="DockingInputs, but the configuration's controller takes"):
        replay(read_log(path), safe.config)
    with FlightRecorder(tmp_path / "run", safe.config) as recorder:
        recorder.task()
    with pytest.raises(LogError, match="only a docking controller"):
        replay(read_log(tmp_path / "run"))


# The control thread ------------------------------------------------------------------------------


class Stuck:
    """Stands for a disk that hangs until it is let go."""

    def __init__(self, monkeypatch):
        self.go = threading.Event()
        self.stuck = threading.Event()
        fsync = os.fsync

        def hang(number):
            self.stuck.set()
            self.go.wait(30.0)
            fsync(number)

        monkeypatch.setattr(flight_module.os, "fsync", hang)


def test_a_full_queue_drops_and_counts_and_never_waits(tmp_path, monkeypatch):
    disk = Stuck(monkeypatch)
    safe = SafetyFilter(ROBOT, [CAMERA], PERIOD)
    recorder = FlightRecorder(tmp_path / "run", safe.config, capacity=50)
    assert disk.stuck.wait(10.0)
    since = time.perf_counter()
    for k in range(80):
        recorder.record(FilterInputs(REST, SCENE, REST), k * PERIOD, DECISION)
    assert time.perf_counter() - since < 1.0  # the disk hangs for as long as it likes
    assert recorder.dropped == 30
    disk.go.set()
    while recorder._queue:
        time.sleep(0.001)
    recorder.record(FilterInputs(REST, SCENE, REST), 80 * PERIOD, DECISION)
    recorder.close()
    entries = list(read_log(tmp_path / "run").entries())
    assert [entry.number for entry in entries[:-1]] == [*range(50), 80]
    assert entries[-1] == LogEnd(True, False, "", 30)
    found = replay(read_log(tmp_path / "run"))
    assert found.ticks == 50
    assert found.stopped == "entries 50 to 79 are missing"
    assert not found.reproduced


def test_handing_over_takes_no_three_microseconds(tmp_path):
    """The median of batches: what a tick of the loop pays, the writer running beside it."""
    safe = SafetyFilter(ROBOT, [CAMERA], PERIOD)
    tick = Tick(0, 0.0, 0.0, 0.0, None, REST, DECISION, REST, False)
    took = []
    with FlightRecorder(tmp_path / "run", safe.config, capacity=100_000) as recorder:
        for _ in range(50):
            since = time.perf_counter()
            for _ in range(20):
                recorder.on_tick(tick)
            took.append((time.perf_counter() - since) / 20)
            time.sleep(0.005)
    assert recorder.dropped == 0
    assert statistics.median(took) < 3e-6


def test_a_disk_that_fails_stops_no_robot(tmp_path, monkeypatch):
    def full(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(flight_module.os, "fsync", full)
    safe = SafetyFilter(ROBOT, [CAMERA], PERIOD)
    recorder = FlightRecorder(tmp_path / "run", safe.config, capacity=10)
    for k in range(30):
        recorder.record(FilterInputs(REST, SCENE, REST), k * PERIOD, DECISION)
    with pytest.raises(LogError, match="No space left"):
        recorder.close()
    assert isinstance(recorder.error, OSError)
    assert recorder.dropped >= 20
    recorder.close()
    with pytest.raises(ZeroDivisionError), FlightRecorder(tmp_path / "two", safe.config) as other:
        raise ZeroDivisionError  # what ended the run is not hidden by the disk
    assert isinstance(other.error, OSError)


def test_a_log_is_never_overwritten(run, tmp_path):
    path, _ = run
    before = path.read_bytes()
    config = read_log(path).configuration()
    with pytest.raises(ConfigurationError, match="File exists"):
        FlightRecorder(path, config)
    assert path.read_bytes() == before
    for name, value in (("chunk_time", 0.0), ("chunk_time", math.nan), ("capacity", 0)):
        with pytest.raises(ConfigurationError, match=name):
            FlightRecorder(tmp_path / "new", config, **{name: value})
    assert not (tmp_path / "new").exists()


def test_missing_library_is_named(run, monkeypatch, tmp_path):
    path, _ = run
    config = read_log(path).configuration()
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.setitem(sys.modules, "mcap.stream_reader", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[record\]"):
        FlightRecorder(tmp_path / "new", config)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[record\]"):
        read_log(path)


KILLED = """
import sys, time
from clfcbf import SafetyFilter, FieldOfView, Limits, Pose2, Scene, Twist
from clfcbf.recorder import FlightRecorder
from clfcbf.safety_filter import FilterInputs
safe = SafetyFilter(Limits(0.22, 0.4, 0.3, 1.0), [FieldOfView(0.6)], 1 / 30)
recorder = FlightRecorder(sys.argv[1], safe.config, chunk_time=0.1, synchronous=False)
scene, applied = Scene(Pose2(1.4, 0.1, 0.0), Pose2(2.0, 0.1, 0.0), 0.0), Twist(0.0, 0.0)
for k in range(10**9):
    inputs = FilterInputs(Twist(0.2, 0.1), scene, applied)
    decision = safe.filter(*inputs, k / 30)
    recorder.record(inputs, k / 30, decision)
    applied = decision.twist
    print(k, time.monotonic(), flush=True)
    time.sleep(0.002)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs kill -9")
def test_readable_after_kill_9(tmp_path):
    path = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    lines = []
    start = None
    for line in process.stdout:
        number, at = line.split()
        lines.append((int(number), float(at)))
        start = lines[0][1] if start is None else start
        if lines[-1][1] - start > 1.5:
            break
    process.kill()
    rest = process.stdout.read()
    assert process.wait(10.0) == -signal.SIGKILL
    process.stdout.close()
    handed = lines[-1][0] + 1 + rest.count("\n")
    # what was handed over a second before is there, whatever else this machine does
    safe_by_now = max(number for number, at in lines if at < lines[-1][1] - 1.0)
    log = read_log(path)
    entries = list(log.entries())
    end = entries.pop()
    assert isinstance(end, LogEnd)
    assert end.cut
    assert not end.intact
    assert [entry.number for entry in entries] == list(range(len(entries)))
    assert safe_by_now < len(entries) <= handed + 1
    found = replay(log)
    assert found.reproduced
    assert found.ticks == len(entries)
    assert "cut short" in str(found)


# Other readers -----------------------------------------------------------------------------------


def test_the_format_s_own_reader_and_its_schema_agree(run):
    """What a viewer sees: JSON with a JSON schema, in the order of time."""
    from mcap.reader import make_reader

    path, sent = run
    types = {"number": (int, float), "integer": int, "string": str, "boolean": bool, "object": dict}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "x-clfcbf"
        messages = list(reader.iter_messages())
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(sent) == len(messages)
    assert summary.statistics.chunk_count > 5
    times = [message.log_time for _, _, message in messages]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(1e9 * PERIOD * (len(sent) - 1), rel=0.01)
    for (schema, channel, message), command in zip(messages, sent, strict=True):
        assert schema is not None
        assert (channel.topic, channel.message_encoding) == ("/clfcbf/tick", "json")
        assert schema.encoding == "jsonschema"
        described = json.loads(schema.data)["properties"]
        content = json.loads(message.data)
        assert set(content) <= set(described)
        for name, value in content.items():
            assert isinstance(value, types[described[name]["type"]]), name
        assert (content["v"], content["omega"]) == command


# Damage ------------------------------------------------------------------------------------------


def all_entries(path):
    """Entries of a file that may be anything; None where it is refused. Nothing else happens."""
    try:
        log = read_log(path)
        entries = list(log.entries())
    except LogError:
        return None
    assert isinstance(entries[-1], LogEnd)
    assert not any(isinstance(entry, LogEnd) for entry in entries[:-1])
    return entries


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A log of several chunks, small enough to be damaged hundreds of times."""
    folder = tmp_path_factory.mktemp("small")
    config = SafetyFilter(ROBOT, [CAMERA], PERIOD).config
    path = folder / "log"
    with FlightRecorder(path, config, synchronous=False, chunk_time=1e-9) as recorder:
        for k in range(8):
            recorder.record(FilterInputs(REST, SCENE, REST), k * PERIOD, DECISION)
            while recorder._queue:
                time.sleep(0.001)
            time.sleep(0.03)
    whole = all_entries(path)
    assert whole is not None
    assert len(whole) == 9
    return path.read_bytes(), whole, folder / "damaged"


@given(data=st.data())
@settings(max_examples=200)
def test_a_log_cut_anywhere_is_read_up_to_there(data, small):
    whole, entries, path = small
    at = data.draw(st.integers(0, len(whole) - 1))
    path.write_bytes(whole[:at])
    found = all_entries(path)
    if found is not None:
        assert found[:-1] == entries[: len(found) - 1]
        # the magic of the end and the footer's own content say nothing that is missed
        assert found[-1].cut or at >= len(whole) - len(b"\x89MCAP0\r\n")
        assert not any(isinstance(e, LogEnd) for e in found[:-1])


@given(data=st.data())
@settings(max_examples=300)
def test_a_damaged_log_gives_nothing_that_was_not_recorded(data, small):
    whole, entries, path = small
    path.write_bytes(whole)
    header = read_log(path).header
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        kind = data.draw(st.sampled_from(["bit", "zero", "random", "insert", "remove"]))
        at = data.draw(st.integers(0, len(damaged) - 1))
        length = data.draw(st.integers(1, 40))
        if kind == "bit":
            damaged[at] ^= 1 << data.draw(st.integers(0, 7))
        elif kind == "zero":
            damaged[at : at + length] = bytes(length)
        elif kind == "random":
            damaged[at : at + length] = data.draw(st.binary(min_size=1, max_size=40))
        elif kind == "insert":
            damaged[at:at] = data.draw(st.binary(min_size=1, max_size=40))
        else:
            del damaged[at : at + length]
    path.write_bytes(bytes(damaged))
    found = all_entries(path)
    if found is not None:
        assert read_log(path).header == header
        assert all(entry in entries for entry in found[:-1])
        numbers = [entry.number for entry in found[:-1]]
        assert numbers == sorted(set(numbers))


@given(content=st.binary(max_size=200), magic=st.booleans())
@settings(max_examples=200)
def test_anything_else_is_refused(content, magic, small):
    _, _, path = small
    path.write_bytes((b"\x89MCAP0\r\n" if magic else b"") + content)
    with pytest.raises(LogError, match="log of a flight recorder"):
        read_log(path)


def log_of(small, *messages, **options):
    """A log with the small one's head and one chunk of these messages, all checksums sound."""
    from mcap.records import Metadata
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    whole, _, path = small
    path.write_bytes(whole)
    out = path.with_name("other")
    with path.open("rb") as source, out.open("wb") as sink:
        writer = Writer(sink, **options)
        writer.start()
        for record in StreamReader(source).records:
            if isinstance(record, Metadata):
                head = record
                break
        writer.add_metadata(head.name, head.metadata)
        channel = writer.register_channel("/clfcbf/tick", "json", 0)
        for data in messages:
            writer.add_message(channel, 0, data, 0)
        writer.finish()
    return out


GOOD = message_of(3, Given(FilterInputs(REST, SCENE, REST), 0.25, DECISION))


@pytest.mark.parametrize(
    ("messages", "told"),
    [
        ([b'{"number": 0, "record": {"kind": "docking"}}'], "no tick of a flight recorder"),
        ([b'{"number": 0, "record": {"kind": "walking"}}'], "no tick of a flight recorder"),
        ([b'{"number": "many"}'], "number must be an integer"),
        ([b"[]"], "no tick"),
        ([b"[" * 50_000], "no tick"),
        ([b"1" * 5000], "no tick"),
        ([b"\xff\xfe"], "no tick"),
        ([GOOD, GOOD], "entry 3 in the chunk at byte .* follows entry 3"),
        ([GOOD], "its trailer is missing"),
    ],
)
def test_sound_chunks_with_wrong_content_are_damage(messages, told, small):
    found = all_entries(log_of(small, *messages))
    assert found is not None
    assert not found[-1].cut
    assert not found[-1].intact
    assert re.search(told, found[-1].reason)
    assert all(isinstance(entry, LoggedTick) for entry in found[:-1])


def test_a_number_changed_in_a_chunk_or_in_the_head_is_damage(small):
    """With no compression between, which might notice: the checksums alone."""
    from mcap.writer import CompressionType

    path = log_of(small, GOOD, compression=CompressionType.NONE)
    whole = path.read_bytes()
    assert len(all_entries(path)) == 2
    for old, new in ((b'"now":0.25', b'"now":0.35'), (b'"v":0.01', b'"v":0.02')):
        assert old in whole
        path.write_bytes(whole.replace(old, new))
        (end,) = all_entries(path)
        assert "crc" in end.reason
    assert b'"v_max": 0.22' in whole
    path.write_bytes(whole.replace(b'"v_max": 0.22', b'"v_max": 2.22'))
    with pytest.raises(LogError, match="checksum is wrong"):
        read_log(path)


def test_a_chunk_that_unpacks_to_gigabytes_is_not_unpacked(small, monkeypatch):
    import zstandard

    bomb = log_of(small, bytes(1 << 25))
    assert bomb.stat().st_size < 1 << 14
    unpacked = []
    monkeypatch.setattr(zstandard, "decompress", lambda *args: unpacked.append(args))
    found = all_entries(bomb)
    assert found is not None
    assert "damaged" in found[-1].reason
    assert not unpacked


def test_no_file(tmp_path):
    for path in (tmp_path / "none", tmp_path, Path("a\0b")):
        assert not is_log(path)
        with pytest.raises(LogError, match="cannot read"):
            read_log(path)


def test_other_mcap_files_are_told_from_logs(tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "other").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("something", {"else": "1"})
        writer.finish()
    with pytest.raises(LogError, match="an MCAP file, but no log"):
        read_log(tmp_path / "other")


# The command line --------------------------------------------------------------------------------


@needs_cli
def test_replay_from_the_command_line(run, tmp_path, capsys):
    path, sent = run
    assert cli.main(["replay", str(path)]) == 0
    assert capsys.readouterr().out.startswith(f"{len(sent)} ticks replayed: every command to the")
    config = read_log(path).configuration()
    with FlightRecorder(tmp_path / "wrong", config) as recorder:
        for tick in itertools.islice(read_log(path).ticks(), 3):
            wrong = tick.decision._replace(twist=Twist(0.125, 0.0))
            recorder.record(tick.inputs, tick.now, wrong)
    assert cli.main(["replay", str(tmp_path / "wrong")]) == 1
    out = capsys.readouterr().out
    assert "3 commands differ" in out
    assert "tick 0 at" in out
    assert "recorded (v = 0.125 m/s" in out
    assert "replayed (v = 0.0 m/s" in out
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 0x10
    (tmp_path / "damaged").write_bytes(bytes(damaged))
    assert cli.main(["replay", str(tmp_path / "damaged")]) == 1
    (tmp_path / "empty").touch()
    assert cli.main(["replay", str(tmp_path / "empty")]) == 2
    assert "no log of a flight recorder" in capsys.readouterr().err


@needs_cli
def test_explain_a_time_of_a_log(run, capsys):
    path, sent = run
    ticks = list(read_log(path).ticks())
    for index in (0, 57, len(sent) - 1):
        at = ticks[index].now - ticks[0].now
        for arguments in (["--at", repr(at + 1e-3)], ["--tick", str(index)]):
            assert cli.main(["explain", str(path), *arguments]) == 0
            assert capsys.readouterr().out == f"{explain(ticks[index].decision)}\n"
    for arguments in (["--at", "-0.5"], ["--at", "1e6"], ["--at", "nan"], ["--tick", "99999"]):
        assert cli.main(["explain", str(path), *arguments]) == 2
        assert f"got {arguments[1].replace('1e6', '1000000.0')}" in capsys.readouterr().err
    assert cli.main(["explain", str(path), "--at", "1.0", "--tick", "0"]) == 2
    assert "not both" in capsys.readouterr().err


@needs_cli
def test_at_needs_a_log(tmp_path, capsys):
    (tmp_path / "tick.json").write_text("[]")
    assert cli.main(["explain", str(tmp_path / "tick.json"), "--at", "1.0"]) == 2
    assert "--at needs a flight recorder's log" in capsys.readouterr().err


@needs_cli
def test_plot_a_log(run, tmp_path, capsys):
    path, _ = run
    copy = tmp_path / "run.mcap"
    copy.write_bytes(path.read_bytes()[:-100])
    assert cli.main(["plot", str(copy)]) == 0
    picture = tmp_path / "run.png"
    assert capsys.readouterr().out == f"{picture}\n"
    assert picture.read_bytes().startswith(b"\x89PNG\r\n")
    assert picture.stat().st_size > 30_000
    assert cli.main(["plot", str(copy), "--out", str(tmp_path / "a.gif")]) == 2
    assert ".png, .svg, .pdf" in capsys.readouterr().err


@needs_cli
def test_plot_refuses_an_empty_log(tmp_path, capsys):
    config = SafetyFilter(ROBOT, [CAMERA], PERIOD).config
    FlightRecorder(tmp_path / "run", config).close()
    assert cli.main(["plot", str(tmp_path / "run")]) == 2
    assert cli.main(["explain", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err.count("holds no tick") == 2


# A docking session ------------------------------------------------------------------------------


def session_log(path, script, *, stage=False, cancel=math.inf):
    """The log of a session, and the commands that were sent.

    ``script`` gives the tasks; each is canceled at the speed ``cancel``.
    """
    parts, controller = robot(Pose2(-1.0, 0.05, 0.0))
    world, limits = World(), LIMITS["approaching"]
    kind = DockType(staging_offset=Pose2(-0.8, 0.0, 0.0))
    docks = DockDatabase({"a": Dock("a", kind, Pose2(0.0, 0.0, 0.0))}, {"default": kind})
    sent = []
    with FlightRecorder(path, controller.config, synchronous=False) as recorder:
        watch = SessionRecorder(recorder)

        class Ahead:
            """Somebody else's: a little straight on."""

            def step(self, observation, applied, now):
                box = limits.input_box(applied, PERIOD)
                done = now > 1.0
                twist = box.clip(REST if done else Twist(0.05, 0.0))
                ended = done and applied == REST
                return Decision(twist, Status.OPTIMAL, True, twist, 0.0, done=ended)

        session = DockingSession(
            PhaseControllers(
                lambda dock: watch.controller(robot()[1]),
                (lambda dock: watch.foreign(Ahead())) if stage else None,
            ),
            docks, limits, world.period,
        )  # fmt: skip

        def on_tick(tick):
            watch.on_tick(tick)
            sent.append(tick.command)
            if abs(tick.command.v) > cancel:
                session.cancel()

        loop = ControlLoop(
            session, parts, parts, parts, period=PERIOD, limits=limits, on_tick=on_tick
        )
        script(session, loop)
    return sent


def there_and_back(session, loop):
    session.dock("a")
    loop.run(60.0)
    assert session.result.success
    session.undock()
    loop.run(60.0)
    assert session.result.success


def test_a_step_of_a_tick_that_something_ended_is_not_taken_for_the_next_one_s(tmp_path):
    path = tmp_path / "run.mcap"
    controller = robot(Pose2(-1.0, 0.05, 0.0))[1]
    box = LIMITS["approaching"].input_box(REST, PERIOD)
    with FlightRecorder(path, controller.config) as recorder:
        watch = SessionRecorder(recorder)
        watched = watch.controller(controller)
        watched.step(None, REST, 0.0)  # and then an adapter raised
        own = Decision(REST, Status.STOPPED, True, REST, 0.0, box=box)
        watch.on_tick(Tick(0, 1.0, 1.0, 1.0, None, REST, own, REST, False))
        decided = watched.step(None, REST, 1.0 + PERIOD)
        begun = 1.0 + PERIOD
        watch.on_tick(Tick(1, begun, begun, begun, None, REST, decided, REST, False))
    first, second = read_log(path).ticks()
    assert isinstance(first.inputs, SessionInputs)
    assert isinstance(second.inputs, DockingInputs)


@pytest.mark.parametrize("stage", [False, True])
def test_a_session_is_recorded_and_reproduced_to_the_last_bit(tmp_path, stage):
    path = tmp_path / "log"
    sent = session_log(path, there_and_back, stage=stage)
    log = read_log(path)
    ticks = list(log.ticks())
    assert bits([tick.command for tick in ticks]) == bits(sent)
    kinds = {type(tick.inputs) for tick in ticks}
    assert kinds == {DockingInputs, SessionInputs}
    assert any(t.inputs.foreign for t in ticks if type(t.inputs) is SessionInputs) is stage
    tasks = [entry for entry in log.entries() if isinstance(entry, LoggedTask)]
    assert [(task.fresh, task.undock) for task in tasks] == [(True, 0.0), (False, 0.8)]
    found = replay(log)
    assert found.reproduced
    assert (found.ticks, found.decisions) == (len(sent), 0)


def test_a_session_s_own_brake_is_reproduced(tmp_path):
    """Canceled at speed, and again on the way out, and again with another controller."""

    def script(session, loop):
        for task in (lambda: session.dock("a"), session.undock, lambda: session.dock("a")):
            task()
            loop.run(20.0)
            assert session.result.canceled

    path = tmp_path / "log"
    session_log(path, script, cancel=0.12)
    ticks = list(read_log(path).ticks())
    braked = [t for t in ticks if type(t.inputs) is SessionInputs and t.inputs.applied != REST]
    assert max(abs(tick.command.v) for tick in braked) > 0.05
    assert replay(read_log(path)).reproduced


@pytest.mark.parametrize("which", [DockingInputs, SessionInputs])
def test_one_bit_of_a_session_s_command_is_found(tmp_path, which):
    path = tmp_path / "log"

    def script(session, loop):
        session.dock("a")
        loop.run(20.0)

    session_log(path, script, cancel=0.12)
    log = read_log(path)
    moving = [t.number for t in log.ticks() if type(t.inputs) is which and t.command.v > 0.02]
    with FlightRecorder(tmp_path / "other", log.configuration(), synchronous=False) as recorder:
        for entry in log.entries():
            if isinstance(entry, LoggedTask):
                recorder.task(entry.undock, fresh=entry.fresh)
            elif isinstance(entry, LoggedTick):
                decision, loop = entry.decision, entry.loop
                if entry.number == moving[3]:
                    v, omega = decision.twist
                    wrong = Twist(math.nextafter(v, 1.0), omega)
                    decision = decision._replace(twist=wrong)
                    loop = loop._replace(command=wrong)
                recorder.given(Given(entry.inputs, entry.now, decision, loop))
    found = replay(read_log(tmp_path / "other"))
    assert not found.reproduced
    assert found.commands == 1


def test_a_brake_from_what_was_in_force_after_all_is_reproduced(tmp_path):
    """A base whose time-out ran off within a tick: the loop asks again, and brakes from there."""
    parts, controller = robot()
    path = tmp_path / "log"
    limits = LIMITS["approaching"]
    asked = itertools.count()

    class Slips:
        """Half of a command is gone at some second question of a tick."""

        def __getattr__(self, name):
            return getattr(parts, name)

        def send(self, twist):
            parts.send(twist)

        def stop(self):
            parts.stop()

        def applied(self):
            v, omega = parts.applied()
            return Twist(0.5 * v, omega) if next(asked) % 40 == 39 else Twist(v, omega)

    with FlightRecorder(path, controller.config, synchronous=False) as recorder:
        ControlLoop(
            controller, Slips(), parts, parts, period=PERIOD, limits=limits,
            on_tick=recorder.on_tick,
        ).run(6.0)  # fmt: skip
    ticks = list(read_log(path).ticks())
    other = [tick for tick in ticks if tick.loop.in_force is not None]
    assert len(other) >= 3
    assert replay(read_log(path)).reproduced


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"half_angle": ', '"half_angle": "wide", "x": ', "FieldOfView has a 'x'"),
        ('"camera": {"kind": "FieldOfView"', '"camera": {"kind": "Limits"', "Limits has a"),
        ('"period": 0.0', '"period": 0.0000001, "y": 0.0', "FilterConfig has a 'y'"),
    ],
)
def test_configurations_of_other_fields_are_refused(old, new, told):
    text = configuration_to_json(robot()[1].config)
    assert old in text
    with pytest.raises(LogError, match=re.escape(told)):
        configuration_from_json(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (("gains",), "0.1", "has '0.1' for its gains"),
        (("camera", "half_angle"), "wide", "has 'wide' for its half_angle"),
        (("camera", "half_angle"), True, "has True for its half_angle"),
        (("attempts",), 1.5, "has 1.5 for its attempts"),
        (("filter", "barriers"), [1.0], "for its barriers"),
        (("filter", "barriers"), 1.0, "has 1.0 for its barriers"),
        (("filter", "weight"), [1.0, 0.0], "for its weight"),
        (("filter", "weight"), [1.0, 0.0, "x"], "for its weight"),
        (("filter", "backend"), 3, "has 3 for its backend"),
        (("filter", "limits", "v_min"), "slow", "has 'slow' for its v_min"),
        (("filter", "period"), 1e-7, "period must be at least 0.001 s, got 1e-07"),
        (("filter", "limits", "v_max"), 1e12, "v_max"),
        (("filter", "limits", "a_max"), 5e-324, "unusable"),
    ],
)
def test_values_of_another_type_or_beyond_reason_are_refused(path, value, told):
    tree = json.loads(configuration_to_json(robot()[1].config))
    node = tree
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    with pytest.raises(LogError, match=re.escape(told)):
        configuration_from_json(json.dumps(tree))


def test_a_filter_whose_brake_has_no_length_is_refused():
    tree = json.loads(configuration_to_json(SafetyFilter(ROBOT, [CAMERA], PERIOD).config))
    tree["limits"]["a_max"] = 5e-324
    with pytest.raises(LogError, match="unusable"):
        configuration_from_json(json.dumps(tree))
