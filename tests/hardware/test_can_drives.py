"""Two drives on a virtual bus: what is on the bus, and what becomes of every fault."""

from __future__ import annotations

import importlib.util
import itertools
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("canopen", reason="needs the extra can")

from benchmarks.robot.wire import open_wire
from clfcbf import Limits, Pose2, Twist
from clfcbf.errors import ConfigurationError, GeometryError, MissingExtraError
from clfcbf.hardware.can_drives import CanDriveError, CanDrives, CanTiming, WheelDrive, open_bus
from clfcbf.hardware.cia402 import DriveState
from clfcbf.hardware.conformance import check_chassis
from clfcbf.runtime import Ending
from clfcbf.simulation.can_drives import CanPlant, SimulatedDrives
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.wheels import WheelLimits

REST = Twist(0.0, 0.0)
SCALE = 10_000.0
LEFT, RIGHT = WheelDrive(1, SCALE), WheelDrive(2, -SCALE)
WHEELS = WheelLimits(track=0.4, radius=0.08, speed=1.0, acceleration=50.0)
STOP = 50.0
"""[m/s²] Ramps that are over before anybody looks."""
FAST = CanTiming(startup=0.5)
SLOW = CanTiming(timeout=5.0, startup=0.5)
WAIT = 2.0
"""[s] Longest wait for what takes 0.3 s: other processes may hold the machine."""
CHANNELS = (f"can-test-{number}" for number in itertools.count())


def until(condition):
    deadline = time.monotonic() + WAIT
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.002)
    return True


@pytest.fixture
def make():
    """Makes drives and their chassis, and takes them down."""
    made = []

    def both(timing=SLOW, objects=None, prepare=None, quick_stop=STOP):
        channel = next(CHANNELS)
        drives = SimulatedDrives(channel, objects=objects)
        made.append(drives)
        if prepare is not None:
            prepare(drives)
        chassis = CanDrives(
            open_bus("virtual", channel), LEFT, RIGHT, WHEELS, timing=timing, quick_stop=quick_stop
        )
        made.insert(0, chassis)
        return chassis, drives, channel

    yield both
    for part in made:
        part.close()


class Pair(CanDrives):
    """A chassis that powers its simulated drives off when closed."""

    def __init__(self):
        channel = next(CHANNELS)
        self.simulated = SimulatedDrives(channel)
        super().__init__(open_bus("virtual", channel), LEFT, RIGHT, WHEELS, quick_stop=STOP)

    def close(self):
        super().close()
        self.simulated.close()


def test_keeps_the_rules_of_a_chassis():
    # The stamp of a command and the look at it may be 10 ms apart on a loaded machine.
    check_chassis(Pair, timeout=CanTiming().timeout, resolution=1e-5, prompt=0.02).require()


def test_frames_of_a_command(make):
    """Both targets, and only then the SYNC at which the drives take them."""
    chassis, _, channel = make()
    listener = open_bus("virtual", channel)
    try:
        chassis.send(Twist(0.2, -0.3))
        seen = []
        while (message := listener.recv(0.2)) is not None and len(seen) < 3:
            if message.arbitration_id in (0x301, 0x302, 0x80):
                seen.append((message.arbitration_id, bytes(message.data)))
    finally:
        listener.shutdown()
    while seen and seen[0] == (0x301, bytes(4)):  # zeros of standing before it
        seen = seen[3:]
    left = round(SCALE * (0.2 + 0.5 * 0.4 * 0.3) / 0.08)
    right = -round(SCALE * (0.2 - 0.5 * 0.4 * 0.3) / 0.08)
    assert seen[:3] == [
        (0x301, left.to_bytes(4, "little", signed=True)),
        (0x302, right.to_bytes(4, "little", signed=True)),
        (0x080, b""),
    ]


def test_drives_turn_as_commanded_and_applied_says_it(make):
    chassis, drives, _ = make()
    chassis.send(Twist(0.11, 0.07))
    expected = (SCALE * (0.11 - 0.014) / 0.08, -SCALE * (0.11 + 0.014) / 0.08)
    assert until(lambda: drives.velocities() == pytest.approx(expected, abs=0.5))
    assert chassis.applied() == pytest.approx(Twist(0.11, 0.07), abs=0.08 / SCALE / 0.4)
    assert until(lambda: tuple(chassis.velocity()) == pytest.approx((0.11, 0.07), abs=1e-5))


def test_what_a_wheel_cannot_do_is_slower_on_the_same_curve(make):
    chassis, _, _ = make()
    chassis.send(Twist(1.0, 2.0))
    v, omega = chassis.applied()
    assert v + 0.2 * omega == pytest.approx(1.0, abs=1e-4)
    assert v / omega == pytest.approx(0.5, rel=1e-4)


def test_what_is_not_finite_is_refused(make):
    chassis, _, _ = make()
    with pytest.raises(GeometryError):
        chassis.send(Twist(math.nan, 0.0))


@pytest.mark.parametrize("word", [0x06, 0x07, 0x0F, 0x02, None])
def test_start_from_any_state(make, word):
    def prepare(drives):
        if word is None:
            drives.left.fail(0x7121)
            return
        for control in (0x06, 0x07, 0x0F, word):
            drives.left._control(control)

    chassis, drives, _ = make(prepare=prepare)
    assert drives.left.state is drives.right.state is DriveState.OPERATION_ENABLED
    assert drives.velocities() == (0.0, 0.0)
    assert chassis.fault == ""


def test_ceased_commands_stop_both_wheels_and_the_next_is_taken(make):
    chassis, drives, _ = make(FAST)
    chassis.send(Twist(0.1, 0.0))
    begun = time.monotonic()
    assert until(lambda: drives.left.state is DriveState.QUICK_STOP)
    assert time.monotonic() - begun >= FAST.timeout - 1e-3
    assert until(lambda: drives.right.state is DriveState.QUICK_STOP)
    assert until(lambda: drives.velocities() == (0.0, 0.0))
    assert chassis.applied() == REST
    assert chassis.fault == ""

    def goes_on():  # as soon as the drives have told that they stand
        chassis.send(Twist(0.1, 0.0))
        return drives.left.velocity() > 0.0 > drives.right.velocity()

    assert until(goes_on)


def test_drives_stop_by_themselves_when_this_side_is_gone(make):
    chassis, drives, _ = make()
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.velocities()[0] > 0.0)
    with chassis._lock:  # as a process that hangs: no commands, no heartbeat, no watch
        assert until(lambda: drives.left.state is drives.right.state is DriveState.QUICK_STOP)
        assert until(lambda: drives.velocities() == (0.0, 0.0))
    assert until(lambda: "0x8130: heartbeat of the master lost" in chassis.fault)


FAULTS = {
    "no heartbeat": lambda drive: drive.silence(),
    "no status frame": lambda drive: setattr(drive, "mute", True),
    "emergency 0x4310: motor or drive too hot": lambda drive: drive.emergency(0x4310),
    "emergency 0x2310: continuous overcurrent": lambda drive: drive.fail(0x2310),
    "emergency 0x8250: command frames ceased": lambda drive: setattr(drive, "deaf", True),
}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("told", FAULTS)
def test_every_fault_of_one_drive_stops_both(make, told, side):
    chassis, drives, _ = make(CanTiming(timeout=0.25, startup=0.5))
    chassis.send(Twist(0.1, 0.05))
    FAULTS[told](getattr(drives, side))

    def tripped():
        try:
            chassis.send(Twist(0.1, 0.05))
        except CanDriveError:
            return True
        return False

    assert until(tripped)
    assert chassis.fault.startswith(f"{side} drive (node {1 if side == 'left' else 2}): {told}")
    assert chassis.applied() == REST
    assert until(lambda: drives.velocities() == (0.0, 0.0))
    with pytest.raises(CanDriveError, match=side):
        chassis.send(REST)


def test_an_idle_robot_is_not_at_fault(make):
    """Longer than every time-out without a command."""
    chassis, drives, _ = make(CanTiming(timeout=0.05))
    time.sleep(0.4)
    assert chassis.fault == ""
    assert drives.left.state is DriveState.OPERATION_ENABLED


def test_release_resets_a_fault(make):
    chassis, drives, _ = make()
    drives.right.fail(0x3210)
    assert until(lambda: chassis.fault)
    chassis.release()
    assert chassis.fault == ""
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.left.velocity() > 0.0 > drives.right.velocity())


def test_a_fault_whose_cause_stays_cannot_be_released(make):
    chassis, drives, _ = make()
    drives.right.fail(0x3210, persistent=True)
    assert until(lambda: chassis.fault)
    with pytest.raises(CanDriveError, match=r"right drive .* fault instead of operation enabled"):
        chassis.release()
    with pytest.raises(CanDriveError):
        chassis.send(REST)
    drives.right.repair()
    chassis.release()
    chassis.send(REST)


def test_a_drive_that_leaves_operation_by_itself_is_a_fault(make):
    chassis, drives, _ = make()
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.velocities()[0] > 0.0)  # every frame of the command is taken
    drives.left._control(0x07)
    assert until(lambda: "switched on instead of operation enabled" in chassis.fault)
    assert until(lambda: drives.velocities()[1] == 0.0)


def test_a_bus_that_takes_no_frames(make, monkeypatch):
    chassis, drives, _ = make()
    chassis.send(Twist(0.1, 0.0))

    def broken(*_, **__):
        raise OSError("cable")

    with monkeypatch.context() as patched:
        patched.setattr(chassis._network.bus, "send", broken)
        with pytest.raises(CanDriveError, match="does not take frames: cable"):
            chassis.send(Twist(0.2, 0.0))
        assert chassis.applied() == REST
        with pytest.raises(CanDriveError):
            chassis.stop()
        assert until(lambda: drives.velocities() == (0.0, 0.0))
    chassis.release()
    chassis.send(Twist(0.1, 0.0))


OPTIONAL = {
    (0x1016, 1): "heartbeat consumer",
    (0x1401, 5): "deadline of command frames",
    (0x6007, 0): "reaction to a lost connection",
}


@pytest.mark.parametrize("item", OPTIONAL)
def test_optional_objects_may_be_missing_and_are_told(make, item):
    chassis, _, _ = make(objects={item: None})
    for drive in chassis.drives:
        assert len(drive.unsupported) == 1
        assert drive.unsupported[0].startswith(OPTIONAL[item])


@pytest.mark.parametrize(
    ("objects", "told"),
    [
        ({(0x1016, 1): None, (0x1401, 5): None}, "drive on when this process is gone"),
        ({(0x1000, 0): 0x00020191}, "device profile 401"),
        ({(0x6502, 0): 0x00000001}, "profile velocity"),
        ({(0x605A, 0): None}, "refuses 0x605A:0"),
    ],
)
def test_drives_that_will_not_do_are_refused(make, objects, told):
    with pytest.raises(CanDriveError, match=told):
        make(objects=objects)


def test_nobody_on_the_bus():
    with pytest.raises(CanDriveError, match=r"left drive \(node 1\)"):
        CanDrives(open_bus("virtual", next(CHANNELS)), LEFT, RIGHT, WHEELS)


@pytest.mark.parametrize(
    ("right", "stop", "told"),
    [(1, None, "node numbers"), (127, None, "node numbers"), (2, 0.0, "quick_stop"),
     (2, math.nan, "quick_stop")],
)  # fmt: skip
def test_wrong_configurations_are_refused_before_the_bus_is_touched(right, stop, told):
    with pytest.raises(ConfigurationError, match=told):
        CanDrives(None, LEFT, WheelDrive(right, SCALE), WHEELS, quick_stop=stop)


def test_missing_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "canopen", None)
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[can\]"):
        CanDrives(None, LEFT, RIGHT, WHEELS)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[can\]"):
        open_bus("virtual", "x")


@pytest.mark.parametrize("stale", [False, True])
def test_close_brakes_first_and_leaves_no_voltage(make, stale):
    """Also where the last report, of a drive that has fallen mute, was of standing."""
    chassis, drives, _ = make(quick_stop=1.0)
    if stale:
        chassis.stop()
        assert until(lambda: all(d.state is DriveState.QUICK_STOP for d in chassis.drives))
        drives.left.mute = drives.right.mute = True
    chassis.send(Twist(0.3, 0.0))
    assert until(lambda: drives.velocities()[0] > 0.0)
    chassis.close()
    assert until(lambda: drives.left.state is drives.right.state is DriveState.DISABLED)
    assert drives.velocities() == (0.0, 0.0)
    chassis.close()
    chassis.stop()
    with pytest.raises(CanDriveError, match="closed"):
        chassis.send(REST)


def test_targets_wait_for_the_sync(make):
    chassis, drives, _ = make()
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.velocities() == pytest.approx((12_500.0, -12_500.0)))
    chassis.drives[0].target(0)
    assert drives.velocities() == pytest.approx((12_500.0, -12_500.0))
    chassis._network.send_message(0x80, b"")
    assert until(lambda: drives.velocities() == pytest.approx((0.0, -12_500.0)))


def test_ramps_against_the_closed_form(make):
    """To 0.2 m/s at the ramp, and back in a quick stop at its own, on a clock of the test."""
    clock, channel = [0.0], next(CHANNELS)
    drives = SimulatedDrives(channel, now=lambda: clock[0])
    soft = WheelLimits(0.4, 0.08, 1.0, 0.5)
    chassis = CanDrives(
        open_bus("virtual", channel), LEFT, RIGHT, soft, timing=SLOW, quick_stop=2.0
    )
    try:
        chassis.send(Twist(0.2, 0.0))
        for _ in range(5):
            drives.serve()
            clock[0] += 0.1
            rim = drives.velocities()[0] / SCALE * 0.08
            assert rim == pytest.approx(min(0.2, 0.5 * clock[0]), abs=1e-6)
        chassis.stop()
        for tick in range(1, 4):
            drives.serve()
            clock[0] += 0.04
            rim = drives.velocities()[0] / SCALE * 0.08
            assert rim == pytest.approx(max(0.0, 0.2 - 2.0 * 0.04 * tick), abs=1e-6)
    finally:
        chassis.close()
        drives.close()


def test_a_robot_follows_its_drives(make):
    chassis, drives, _ = make()
    limits = Limits(1.0, 2.0, 5.0, 10.0)
    base = KinematicPlant(Pose2(0.0, 0.0, 0.0), limits, Body.ideal(), np.random.default_rng(0))
    plant = CanPlant(base, drives, LEFT, RIGHT, WHEELS)
    chassis.send(Twist(0.2, 0.5))
    assert until(lambda: plant.applied().v == pytest.approx(0.2, abs=1e-5))
    poses = plant.advance(1.0)
    assert plant.time == pytest.approx(1.0)
    # A circle of radius 0.4 m, by chord and angle.
    x, y, theta = poses[-1]
    assert theta == pytest.approx(0.5, abs=1e-4)
    assert math.hypot(x, y) == pytest.approx(2 * 0.4 * math.sin(0.25), abs=1e-4)
    assert math.atan2(y, x) == pytest.approx(0.25, abs=1e-4)
    with pytest.raises(ConfigurationError, match="CanDrives"):
        plant.send(REST)
    with pytest.raises(ConfigurationError, match="CanDrives"):
        plant.stop()


def test_unknown_objects_of_a_simulated_drive_are_refused():
    channel = next(CHANNELS)
    with pytest.raises(ConfigurationError, match="0x6099:1"):
        SimulatedDrives(channel, objects={(0x6099, 1): 0})


def test_example_docks():
    path = Path(__file__).parents[2] / "examples" / "dock_can.py"
    spec = importlib.util.spec_from_file_location("dock_can", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    report, pose = module.dock(Pose2(-1.5, 0.3, 0.0), simulated=True)
    assert report.ending is Ending.DONE
    assert math.hypot(pose.x, pose.y) < 0.010
    assert abs(pose.theta) < math.radians(2.0)


# Stops along the circle ---------------------------------------------------------------------

DOCKING = Limits(v_max=0.35, omega_max=0.4, a_max=0.3, alpha_max=1.0)
twists = st.tuples(st.floats(-0.35, 0.35), st.floats(-0.4, 0.4)).filter(
    lambda twist: abs(twist[0]) > 0.01 or abs(twist[1]) > 0.02
)


@pytest.fixture(scope="module")
def circling():
    """A chassis whose drives take the ramp of a quick stop from each command, and their time."""
    clock, channel = [0.0], next(CHANNELS)
    drives = SimulatedDrives(channel, now=lambda: clock[0])
    chassis = CanDrives(
        open_bus("virtual", channel), LEFT, RIGHT, WHEELS, timing=SLOW, quick_stop=DOCKING
    )
    yield chassis, drives, clock
    chassis.close()
    drives.close()


def measured_twist(drives):
    left, right = drives.velocities()
    return WHEELS.twist_of(LEFT.rate(left), RIGHT.rate(right))


@settings(max_examples=25, deadline=None)
@given(twist=twists)
def test_a_quick_stop_keeps_the_circle_and_the_limits(circling, twist):
    """Against the brake that the guard certifies, u (1 - t / t_rest), instant by instant."""
    chassis, drives, clock = circling
    chassis.release()
    chassis.send(Twist(*twist))
    drives.serve()
    clock[0] += 1.0
    assert tuple(measured_twist(drives)) == pytest.approx(twist, abs=1e-4)
    chassis.stop()
    drives.serve()
    rest = max(abs(twist[0]) / DOCKING.a_max, abs(twist[1]) / DOCKING.alpha_max)
    for share in (0.25, 0.5, 0.75, 1.0):
        clock[0] += 0.25 * rest
        left = 1.0 - share
        expected = (left * twist[0], left * twist[1])
        # A wheel that hardly turns stops sooner than the other: by a tenth of 0.2 m/s² for so long.
        assert tuple(measured_twist(drives)) == pytest.approx(expected, abs=2e-3 + 0.02 * rest)
    clock[0] += 0.5
    assert drives.velocities() == (0.0, 0.0)


def test_the_quick_stop_is_exact_where_both_wheels_turn(circling):
    chassis, drives, clock = circling
    chassis.release()
    chassis.send(Twist(0.2, 0.4))
    drives.serve()
    clock[0] += 1.0
    drives.serve()
    chassis.stop()
    drives.serve()
    clock[0] += 0.25
    v, omega = measured_twist(drives)
    assert v == pytest.approx(0.2 - 0.3 * 0.25, abs=1e-5)
    assert omega / v == pytest.approx(2.0, abs=1e-4)


def test_one_deceleration_for_both_wheels_where_frames_cannot_carry_it(make):
    def prepare(drives):
        drives.left.unmappable = drives.right.unmappable = {0x6085}

    chassis, drives, _ = make(prepare=prepare, quick_stop=DOCKING)
    for drive in chassis.drives:
        assert drive.unsupported == ("quick stop ramp in command frames (0x6085)",)
    chassis.send(Twist(0.1, 0.05))
    assert until(lambda: drives.velocities()[0] > 0.0)
    # min(a_max, alpha_max b / 2) = 0.2 m/s², at a wheel of 0.08 m
    expected = round(SCALE * 0.2 / 0.08)
    assert drives.left.value(0x6085) == drives.right.value(0x6085) == expected


def test_a_command_during_a_stop_counts_as_one_to_stand():
    """Taken up at once, it would stop the wheels as hard as their ramps can."""
    clock, channel = [0.0], next(CHANNELS)
    drives = SimulatedDrives(channel, now=lambda: clock[0])
    chassis = CanDrives(
        open_bus("virtual", channel), LEFT, RIGHT, WHEELS, timing=SLOW, quick_stop=DOCKING
    )
    try:
        chassis.send(Twist(0.2, 0.0))
        drives.serve()
        clock[0] += 1.0
        assert until(lambda: chassis.velocity().v > 0.19)
        chassis.stop()
        drives.serve()
        clock[0] += 0.1
        for command in (REST, Twist(0.01, 0.0)):
            chassis.send(command)
            assert chassis.applied() == REST
            assert measured_twist(drives).v == pytest.approx(0.2 - 0.3 * 0.1, abs=1e-4)
        clock[0] += 1.0

        def goes_on():
            chassis.send(Twist(0.01, 0.0))
            return chassis.applied() != REST

        assert until(goes_on)
    finally:
        chassis.close()
        drives.close()


# Parts that come back -----------------------------------------------------------------------


def test_a_release_does_not_drive_to_where_the_bus_was_cut(make, monkeypatch):
    """The zeros of the stop never arrived: the drives still hold the last target."""
    chassis, drives, _ = make(CanTiming(timeout=0.1, startup=0.5))
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.velocities()[0] > 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(chassis._network.bus, "send", lambda *_, **__: None)
        assert until(lambda: chassis.fault)
        assert until(lambda: drives.velocities() == (0.0, 0.0))
    seen = []
    serve = drives.serve
    monkeypatch.setattr(drives, "serve", lambda: (serve(), seen.append(drives.left.velocity())))
    chassis.release()
    time.sleep(0.05)
    assert drives.left.state is DriveState.OPERATION_ENABLED
    assert set(seen) == {0.0}


def test_a_bus_that_cannot_be_read_for_a_while(make, monkeypatch):
    chassis, drives, _ = make()
    bus = chassis._network.bus

    def broken(*_, **__):
        raise OSError("network is down")

    with monkeypatch.context() as patched:
        patched.setattr(bus, "recv", broken)
        assert until(lambda: "network is down" in chassis.fault)
        with pytest.raises(CanDriveError, match="network is down"):
            chassis.send(Twist(0.1, 0.0))
    chassis.release()
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.left.velocity() > 0.0 > drives.right.velocity())


def test_a_release_on_a_dead_bus_is_told(make, monkeypatch):
    chassis, _, _ = make()

    def broken(*_, **__):
        raise OSError("bus off")

    with monkeypatch.context() as patched:
        patched.setattr(chassis._network.bus, "send", broken)
        with pytest.raises(CanDriveError, match="bus off"):
            chassis.release()
        with pytest.raises(CanDriveError):
            chassis.send(REST)
    chassis.release()
    chassis.send(REST)


@pytest.mark.parametrize("moving", [False, True])
def test_a_drive_that_was_switched_off_is_configured_anew(make, moving):
    chassis, drives, _ = make()
    if moving:
        chassis.send(Twist(0.1, 0.0))
    drives.right.restart()
    assert until(lambda: "right drive (node 2): was switched off and on" in chassis.fault)
    assert drives.right.value(0x1016, 1) == 0  # it would not notice that this side is gone
    assert until(lambda: drives.left.velocity() == 0.0)
    chassis.release()
    assert drives.right.value(0x1016, 1) == drives.left.value(0x1016, 1) != 0
    chassis.send(Twist(0.1, 0.0))
    assert until(lambda: drives.left.velocity() > 0.0 > drives.right.velocity())


CONTROL = """
import sys, time
from benchmarks.robot.wire import open_wire
from clfcbf import Limits, Twist
from clfcbf.hardware.can_drives import CanDrives, CanTiming, WheelDrive
from clfcbf.wheels import WheelLimits
wheels = WheelLimits(0.4, 0.08, 1.0, 50.0)
bus, _ = open_wire(int(sys.argv[1]))
timing = CanTiming(timeout=0.15, silence=0.2, heartbeat=0.02, status=0.02)
chassis = CanDrives(
    bus, WheelDrive(1, 1e4), WheelDrive(2, -1e4), wheels, timing=timing,
    quick_stop=Limits(0.35, 0.4, 0.3, 1.0),
)
while True:
    chassis.send(Twist(0.15, 0.3))
    time.sleep(0.02)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_drives_stop_on_the_circle_when_their_process_is_killed():
    wire, port = open_wire()
    drives = SimulatedDrives(wire)
    process = subprocess.Popen([sys.executable, "-W", "error", "-c", CONTROL, str(port)])
    try:
        deadline = time.monotonic() + 20.0
        while measured_twist(drives).v < 0.149:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.002)
        process.kill()
        process.wait()
        killed, seen = time.monotonic(), []
        while time.monotonic() < killed + 1.2:
            seen.append((time.monotonic() - killed, measured_twist(drives)))
            time.sleep(0.002)
    finally:
        process.kill()
        process.wait()
        drives.close()
    moving = [(when, twist) for when, twist in seen if twist.v > 0.01]
    # Silence, half a second of braking, and what a loaded machine needs.
    assert 0.5 < moving[-1][0] < 0.9
    assert seen[-1][1] == REST
    for _, (v, omega) in moving:
        assert omega / v == pytest.approx(2.0, abs=0.02)
