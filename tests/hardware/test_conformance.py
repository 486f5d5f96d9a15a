"""The conformance suites: good adapters pass, and for every rule a bad one fails just there."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

import pytest

from clfcbf.errors import ConfigurationError
from clfcbf.hardware._chassis_rules import ChassisRules
from clfcbf.hardware._other_rules import ClockRules, ManipulatorRules
from clfcbf.hardware._sensor_rules import SensorRules
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.conformance import (
    TWISTS,
    check_chassis,
    check_clock,
    check_manipulator,
    check_sensor,
)
from clfcbf.hardware.protocols import Chassis, Clock, Grip, Manipulator, TargetSensor
from clfcbf.se2 import Pose2, Twist
from tests.hardware.fakes import REST, FakeClock, GoodChassis, GoodGripper, GoodSensor

TIMEOUT = 0.5


def chassis_report(kind, **options):
    clock = FakeClock()
    return check_chassis(lambda: kind(clock, TIMEOUT), clock=clock, timeout=TIMEOUT, **options)


def sensor_report(kind, **options):
    clock = FakeClock()
    return check_sensor(lambda: kind(clock), clock=clock, standoff=0.6, duration=0.2, **options)


def gripper_report(kind):
    clock = FakeClock()
    return check_manipulator(lambda: kind(clock), clock=clock, timeout=1.0)


# Chassis --------------------------------------------------------------------------------------


class MovingAtStart(GoodChassis):
    def __init__(self, clock, timeout):
        super().__init__(clock, timeout)
        self.send(Twist(0.1, 0.0))


class WrongUnits(GoodChassis):
    def send(self, twist):
        super().send(Twist(twist.v, math.degrees(twist.omega)))


class Odometry(GoodChassis):
    """Reports the body, which follows with a lag of 0.2 s."""

    def applied(self):
        share = 1.0 - math.exp(-(self.clock.now() - self.at) / 0.2)
        return super().applied().scaled(share)


class Decaying(GoodChassis):
    """Reports the command at first, and the body's speed later."""

    def applied(self):
        return super().applied().scaled(math.exp(self.at - self.clock.now()))


class TakesAnything(GoodChassis):
    def send(self, twist):
        self.command, self.at = twist, self.clock.now()


class RefusesTooLate(GoodChassis):
    def send(self, twist):
        self.command, self.at = twist, self.clock.now()
        super().send(twist)


class Blocking(GoodChassis):
    def applied(self):
        time.sleep(0.007)
        return super().applied()


class CoastsOn(GoodChassis):
    def stop(self):
        pass


class StopsOnce(GoodChassis):
    """A stop that fails where there is nothing to stop."""

    def stop(self):
        if self.command == REST:
            raise RuntimeError("not running")
        super().stop()


class OneThread(GoodChassis):
    def __init__(self, clock, timeout):
        super().__init__(clock, timeout)
        self.owner = threading.get_ident()

    def stop(self):
        if threading.get_ident() != self.owner:
            raise RuntimeError("wrong thread")
        super().stop()


class SilentlyLatched(GoodChassis):
    """Swallows commands after a stop."""

    stopped = False

    def send(self, twist):
        if not self.stopped:
            super().send(twist)

    def stop(self):
        super().stop()
        self.stopped = True


class NeverStops(GoodChassis):
    def applied(self):
        return self.command


class Latched(GoodChassis):
    """Refuses commands after a stop until it is released: allowed."""

    stopped = False

    def send(self, twist):
        if self.stopped:
            raise RuntimeError("stopped")
        super().send(twist)

    def stop(self):
        super().stop()
        self.stopped = True


class TupleChassis(GoodChassis):
    def applied(self):
        return tuple(super().applied())


BAD_CHASSIS = {
    "starts at rest": MovingAtStart,
    "applied is the command sent": WrongUnits,
    "applied holds until the next command": Decaying,
    "refuses what is not finite": TakesAnything,
    "returns without waiting": Blocking,
    "stop stops": CoastsOn,
    "stop at any time": StopsOnce,
    "stop from another thread": OneThread,
    "no command is swallowed after stop": SilentlyLatched,
    "stops by itself": NeverStops,
}

# Sensors --------------------------------------------------------------------------------------


class Blind(GoodSensor):
    def observe(self):
        return None


class NotFinite(GoodSensor):
    def observation(self, stamp):
        return replace(super().observation(stamp), goal=Pose2(1.4, math.nan, 0.0))


class Degrees(GoodSensor):
    def observation(self, stamp):
        return replace(super().observation(stamp), goal=Pose2(1.4, 0.1, 12.0))


class Optical(GoodSensor):
    """z forward, x right, taken for x forward and y left."""

    def observation(self, stamp):
        seen = super().observation(stamp)
        return replace(
            seen, goal=Pose2(-0.1, 1.4, math.pi / 2), feature=Pose2(-0.1, 2.0, math.pi / 2)
        )


class Repeating(GoodSensor):
    """The last measurement again where there is no new one."""

    kept = None

    def observe(self):
        seen = super().observe()
        self.kept = self.kept if seen is None else seen
        return self.kept


class Overtaking(GoodSensor):
    """Every other frame comes after the next."""

    def observation(self, stamp):
        frame = round(30.0 * stamp)
        return super().observation((frame + (1 if frame % 2 else -1)) / 30.0)


class Prophet(GoodSensor):
    def observation(self, stamp):
        return super().observation(stamp + 0.2)


class WallClock(GoodSensor):
    """Stamps since the epoch of another clock."""

    def observation(self, stamp):
        return super().observation(stamp - 50.0)


class ZeroCovariance(GoodSensor):
    def observation(self, stamp):
        return replace(super().observation(stamp), covariance=((0.0,) * 3,) * 3)


class NegativeVariance(GoodSensor):
    def observation(self, stamp):
        covariance = ((1e-4, 0.0, 0.0), (0.0, -1e-4, 0.0), (0.0, 0.0, 1e-4))
        return replace(super().observation(stamp), covariance=covariance)


class Waiting(GoodSensor):
    def observe(self):
        time.sleep(0.007)
        return super().observe()


class ElsewhereFeature(GoodSensor):
    """Goal and feature are one thing to it."""

    def observation(self, stamp):
        seen = super().observation(stamp)
        return replace(seen, feature=seen.goal)


BAD_SENSORS = {
    "sees the target": Blind,
    "poses are finite": Degrees,
    "target is ahead": Optical,
    "hands out each measurement once": Repeating,
    "stamps increase": Overtaking,
    "stamps are of the past": Prophet,
    "stamps are on the clock": WallClock,
    "covariance is one": ZeroCovariance,
    "returns without waiting": Waiting,
    "feature is at the standoff": ElsewhereFeature,
}

# Clocks and manipulators ------------------------------------------------------------------------


class Backward(FakeClock):
    def now(self):
        self.time -= 1e-6
        return self.time


class Early(FakeClock):
    def sleep_until(self, time):
        self.time = max(self.time, time - 1e-3)


class Sleepy(FakeClock):
    def sleep_until(self, time):
        super().sleep_until(time + (0.05 if time > self.time else 0.0))


class WaitsForThePast(FakeClock):
    def sleep_until(self, time):
        self.time += abs(time - self.time)


BAD_CLOCKS = {
    "never runs backward": Backward,
    "never wakes early": Early,
    "wakes in time": Sleepy,
    "does not wait for the past": WaitsForThePast,
}


class TextGripper(GoodGripper):
    def grip(self):
        return "open"


class Jammed(GoodGripper):
    def grasp(self):
        self.until = math.inf


class StaysClosed(GoodGripper):
    def release(self):
        pass


class Toggle(GoodGripper):
    def grasp(self):
        self._go(Grip.OPEN if self.end is Grip.HOLDING else Grip.HOLDING)


class Unstoppable(GoodGripper):
    def stop(self):
        pass


class WaitingGripper(GoodGripper):
    def grasp(self):
        time.sleep(0.007)
        super().grasp()


BAD_GRIPPERS = {
    "grip is a Grip": TextGripper,
    "grasp closes": Jammed,
    "release opens": StaysClosed,
    "grasp twice is as once": Toggle,
    "stop holds still": Unstoppable,
    "returns without waiting": WaitingGripper,
}


def broken(report):
    return {failure.rule for failure in report.failures}


def test_good_adapters_keep_every_rule():
    for report in (
        chassis_report(GoodChassis),
        chassis_report(Latched),
        sensor_report(GoodSensor),
        gripper_report(GoodGripper),
        check_clock(FakeClock),
        check_clock(MonotonicClock, tolerance=0.1),
    ):
        report.require()
        assert report.passed
        assert str(report).endswith(f"all {len(report.rules)} rules kept")


@pytest.mark.parametrize(("rule", "kind"), BAD_CHASSIS.items(), ids=str)
def test_each_rule_of_a_chassis_has_one_that_breaks_it(rule, kind):
    assert rule in broken(chassis_report(kind))


@pytest.mark.parametrize(("rule", "kind"), BAD_SENSORS.items(), ids=str)
def test_each_rule_of_a_sensor_has_one_that_breaks_it(rule, kind):
    report = sensor_report(kind)
    assert rule in broken(report)
    if kind is not Blind:  # which breaks all that need something to be seen
        assert len(report.failures) < len(report.rules) // 2


@pytest.mark.parametrize(("rule", "kind"), BAD_CLOCKS.items(), ids=str)
def test_each_rule_of_a_clock_has_one_that_breaks_it(rule, kind):
    assert rule in broken(check_clock(kind))


@pytest.mark.parametrize(("rule", "kind"), BAD_GRIPPERS.items(), ids=str)
def test_each_rule_of_a_manipulator_has_one_that_breaks_it(rule, kind):
    assert rule in broken(gripper_report(kind))


def test_no_rule_is_without_a_bad_adapter():
    clock = FakeClock()
    rules = {
        "chassis": ChassisRules(clock, TWISTS, 0.0, 0.1, 0.5, 1.0).rules(),
        "sensor": SensorRules(clock, 0.5, 0.1, 0.6, 1.0, 1.0).rules(),
        "clock": ClockRules(0.1, 0.1).rules(),
        "manipulator": ManipulatorRules(clock, 1.0, 1.0).rules(),
    }
    bad = {
        "chassis": BAD_CHASSIS,
        "sensor": BAD_SENSORS,
        "clock": BAD_CLOCKS,
        "manipulator": BAD_GRIPPERS,
    }
    for what, listed in rules.items():
        assert [rule.name for rule in listed] == list(bad[what])


@pytest.mark.parametrize(
    ("kind", "rule"),
    [
        (Odometry, "applied is the command sent"),
        (RefusesTooLate, "refuses what is not finite"),
        (TupleChassis, "starts at rest"),
    ],
)
def test_further_bad_chassis(kind, rule):
    assert rule in broken(chassis_report(kind))


@pytest.mark.parametrize(
    ("kind", "rule"), [(NotFinite, "poses are finite"), (NegativeVariance, "covariance is one")]
)
def test_further_bad_sensors(kind, rule):
    assert broken(sensor_report(kind)) == {rule}


def test_a_drive_that_rounds_says_so():
    class Millimetres(GoodChassis):
        def send(self, twist):
            super().send(Twist(round(twist.v, 3), round(twist.omega, 3)))

    odd = (Twist(0.0512, 0.0333),)
    assert "applied is the command sent" in broken(chassis_report(Millimetres, twists=odd))
    chassis_report(Millimetres, twists=odd, resolution=6e-4).require()


def test_what_is_no_adapter_at_all():
    report = check_chassis(object)
    assert not report.passed
    assert all("lacks a method of Chassis" in failure.reason for failure in report.failures)
    with pytest.raises(AssertionError, match="9 of 9 rules broken"):
        report.require()


def test_every_rule_gets_its_own_adapter_and_it_is_closed():
    made, closed = [], []

    class Closable(GoodChassis):
        def __init__(self):
            super().__init__(FakeClock())
            made.append(self)

        def close(self):
            closed.append(self)

    report = check_chassis(Closable, clock=FakeClock())
    assert report.passed
    assert made == closed
    assert len(made) == len(report.rules)


def test_protocols_are_told_apart():
    clock = FakeClock()
    assert isinstance(GoodChassis(clock), Chassis)
    assert isinstance(GoodSensor(clock), TargetSensor)
    assert isinstance(clock, Clock)
    assert isinstance(GoodGripper(clock), Manipulator)
    assert not isinstance(GoodSensor(clock), Chassis)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: check_chassis(GoodChassis(FakeClock())), "make must be a callable"),
        (lambda: check_chassis(GoodChassis, twists=()), "at least one"),
        (lambda: check_chassis(GoodChassis, twists=[Twist(math.nan, 0.0)]), "twists must be"),
        (lambda: check_chassis(GoodChassis, hold=-1.0), "hold must be"),
        (lambda: check_chassis(GoodChassis, timeout=0.0), "timeout must be positive"),
        (lambda: check_sensor(GoodSensor, duration=0.0), "duration must be"),
        (lambda: check_sensor(GoodSensor, standoff=-1.0), "standoff must be"),
        (lambda: check_clock(FakeClock, wait=math.inf), "wait must be"),
        (lambda: check_manipulator(GoodGripper, timeout=0.0), "timeout must be"),
        (lambda: MonotonicClock(spin=-1.0), "spin must be"),
    ],
)
def test_bad_arguments(call, told):
    with pytest.raises(ConfigurationError, match=told):
        call()


def test_spinning_clock_is_precise():
    clock = MonotonicClock(spin=0.002)
    late = []
    for _ in range(9):
        until = clock.now() + 0.004
        clock.sleep_until(until)
        late.append(clock.now() - until)
    assert min(late) >= 0.0
    assert min(late) < 1e-4
