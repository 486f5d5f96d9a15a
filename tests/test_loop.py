"""The control loop on a clock that the test moves: ticks, misses, and every way out."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.controller import DockingController
from clfcbf.decision import Decision, Event, Phase, Status
from clfcbf.errors import ConfigurationError, LimitsError
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.conformance import check_chassis, check_clock, check_sensor
from clfcbf.limits import Limits
from clfcbf.qp.exact import BackendHealth, LexicographicSolution
from clfcbf.runtime import (
    CommandFilter,
    ControlLoop,
    Ending,
    LoopPolicy,
    Overrun,
    Part,
    Percentiles,
    PlantInTheLoop,
)
from clfcbf.safety_filter import SafetyFilter
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from tests.hardware.fakes import REST, FakeClock, GoodChassis, GoodSensor

PERIOD = 1.0 / 32.0  # a power of two: sums of periods are exact
ROBOT = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)


class Recorded(GoodChassis):
    """Keeps every command with its time, and counts the stops."""

    def __init__(self, clock):
        super().__init__(clock)
        self.sent = []
        self.stops = 0

    def send(self, twist):
        super().send(twist)
        self.sent.append((self.clock.now(), twist))

    def stop(self):
        super().stop()
        self.stops += 1


class Cruise:
    """Drives along a bend as fast as the limits let it; ``work`` is what a tick does besides."""

    def __init__(self, work=lambda number: None):
        self.work = work
        self.seen = []
        self.number = 0

    def step(self, observation, applied, now):
        self.seen.append(observation)
        twist = ROBOT.input_box(applied, PERIOD).clip(Twist(0.22, 0.3))
        self.work(self.number)
        self.number += 1
        return Decision(twist, Status.OPTIMAL, True, twist, 0.0)


def loop_of(controller, clock=None, chassis=None, sensor=None, **options):
    clock = clock or FakeClock()
    chassis = chassis or Recorded(clock)
    sensor = sensor or GoodSensor(clock)
    loop = ControlLoop(controller, chassis, sensor, clock, period=PERIOD, limits=ROBOT, **options)
    return loop, chassis


def assert_within_limits(sent, least_gap=PERIOD):
    """Every command inside the input box of the one before, and none too soon after it."""
    before, at = REST, -math.inf
    for when, twist in sent:
        assert ROBOT.input_box(before, PERIOD).contains(twist, 1e-9)
        assert when - at >= least_gap - 1e-12
        before, at = twist, when


def assert_at_rest(chassis):
    assert chassis.sent[-1][1] == REST
    assert chassis.applied() == REST
    assert chassis.stops >= 1


def assert_braked(sent, last):
    """What follows ``last`` is the same-curvature brake of as few ticks as the limits allow."""
    ticks = ROBOT.brake_ticks(last, PERIOD)
    assert len(sent) == ticks
    for k, (_, twist) in enumerate(sent, start=1):
        share = 1.0 - k / ticks
        assert twist == pytest.approx((share * last.v, share * last.omega), abs=1e-12)


# Ticks in time ----------------------------------------------------------------------------------


def test_ticks_at_a_fixed_rate():
    loop, chassis = loop_of(Cruise())
    report = loop.run(duration=2.0)
    assert report.ending is Ending.TIMEOUT
    ticks = report.statistics.ticks
    assert ticks == 64
    times = [when for when, _ in chassis.sent[:ticks]]
    assert np.diff(times) == pytest.approx(PERIOD, abs=0.0)
    assert report.statistics.missed == report.statistics.skipped == 0
    assert_within_limits(chassis.sent)
    assert_braked(chassis.sent[ticks:], chassis.sent[ticks - 1][1])
    assert_at_rest(chassis)


@given(work=st.lists(st.floats(0.0, 0.9 * PERIOD), min_size=3, max_size=40))
def test_work_within_the_deadline_does_not_shift_the_ticks(work):
    clock = FakeClock()
    begun = []

    def busy(number):
        begun.append(clock.time)
        clock.time += work[number % len(work)]

    loop, chassis = loop_of(Cruise(busy), clock)
    report = loop.run(duration=len(work) * PERIOD)
    assert report.statistics.missed == 0
    assert begun == [100.0 + k * PERIOD for k in range(len(begun))]
    sent = [when - start for (when, _), start in zip(chassis.sent, begun, strict=False)]
    assert sent == pytest.approx(work[: len(begun)], abs=1e-12)


@given(
    work=st.lists(
        st.one_of(
            st.just(0.0),
            st.builds(lambda n, x: (n + x) * PERIOD, st.integers(1, 9), st.floats(0.01, 0.99)),
        ),
        min_size=3,
        max_size=30,
    ),
    overrun=st.sampled_from([Overrun.BRAKE, Overrun.SEND]),
)
def test_late_ticks_are_counted_and_never_crowd_the_next(work, overrun):
    clock = FakeClock()

    def busy(number):
        clock.time += work[number % len(work)]

    policy = LoopPolicy(overrun=overrun, misses=1000)
    loop, chassis = loop_of(Cruise(busy), clock, policy=policy)
    report = loop.run(duration=sum(work) + len(work) * PERIOD)
    statistics = report.statistics
    late = [work[k % len(work)] > 0.0 for k in range(statistics.ticks)]
    assert statistics.missed == sum(late)
    skipped = [math.floor(work[k % len(work)] / PERIOD) for k in range(statistics.ticks)]
    assert statistics.skipped == sum(skipped)
    assert_within_limits(chassis.sent)
    assert_at_rest(chassis)


def test_outdated_decision_is_replaced_by_the_brake():
    clock = FakeClock()
    records = []

    def busy(number):
        clock.time += 3.0 * PERIOD if number == 20 else 0.0

    loop, _ = loop_of(Cruise(busy), clock, on_tick=records.append)
    loop.run(duration=1.0)
    late = records[20]
    assert late.missed
    assert late.command != late.decision.twist
    applied = late.applied
    ticks = ROBOT.brake_ticks(applied, PERIOD)
    assert late.command == pytest.approx(applied.scaled(1.0 - 1.0 / ticks), abs=1e-12)
    assert [record.missed for record in records].count(True) == 1
    assert all(r.command == r.decision.twist for r in records if r is not late)


def test_outdated_decision_is_sent_where_that_is_the_policy():
    clock = FakeClock()
    records = []

    def busy(number):
        clock.time += 3.0 * PERIOD if number == 20 else 0.0

    policy = LoopPolicy(overrun=Overrun.SEND)
    loop, _ = loop_of(Cruise(busy), clock, policy=policy, on_tick=records.append)
    report = loop.run(duration=1.0)
    assert report.statistics.missed == 1
    assert all(record.command == record.decision.twist for record in records)


@pytest.mark.parametrize(
    ("policy", "ticks"), [(LoopPolicy(overrun=Overrun.STOP), 9), (LoopPolicy(misses=4), 12)]
)
def test_misses_end_the_run(policy, ticks):
    clock = FakeClock()

    def busy(number):
        clock.time += 1.5 * PERIOD if number >= 9 else 0.0

    loop, chassis = loop_of(Cruise(busy), clock, policy=policy)
    report = loop.run()
    assert report.ending is Ending.OVERRUN
    assert report.statistics.ticks == ticks
    assert_within_limits(chassis.sent)
    assert_at_rest(chassis)


def test_misses_that_recover_do_not_end_the_run():
    clock = FakeClock()

    def busy(number):
        clock.time += 1.5 * PERIOD if number % 2 else 0.0

    loop, _ = loop_of(Cruise(busy), clock, policy=LoopPolicy(misses=2))
    assert loop.run(duration=2.0).ending is Ending.TIMEOUT


def test_a_tick_that_begins_late_sends_what_it_decides():
    """The decision was made for now: only its deadline was missed."""

    class Oversleeps(FakeClock):
        naps = 0

        def sleep_until(self, time):
            self.naps += 1
            super().sleep_until(time + (2.5 * PERIOD if self.naps == 10 else 0.0))

    records = []
    loop, _ = loop_of(Cruise(), Oversleeps(), on_tick=records.append)
    report = loop.run(duration=1.0)
    assert report.statistics.missed == 1
    assert report.statistics.skipped == 2
    assert records[10].missed
    assert records[10].command == records[10].decision.twist


# Measurements -----------------------------------------------------------------------------------


def test_a_measurement_is_passed_on_once():
    class Repeating(GoodSensor):
        kept = None

        def observe(self):
            seen = super().observe()
            self.kept = self.kept if seen is None else seen
            return self.kept

    clock = FakeClock()
    controller = Cruise()
    loop, _ = loop_of(controller, clock, sensor=Repeating(clock))
    statistics = loop.run(duration=2.0).statistics
    stamps = [seen.stamp for seen in controller.seen if seen is not None]
    assert len(stamps) == len(set(stamps)) == statistics.fresh
    assert statistics.repeated == statistics.ticks - statistics.fresh > 0
    assert statistics.latency.p50 == pytest.approx(0.1, abs=1.0 / 30.0)


def test_an_old_measurement_is_left_out():
    class Late(GoodSensor):
        def observation(self, stamp):
            return super().observation(stamp - 0.4)

    for max_age, passed in ((0.49, 0), (0.6, 1)):
        clock = FakeClock()
        controller = Cruise()
        policy = LoopPolicy(max_age=max_age)
        loop, _ = loop_of(controller, clock, sensor=Late(clock), policy=policy)
        statistics = loop.run(duration=1.0).statistics
        assert (statistics.fresh > 0) == bool(passed)
        assert (statistics.stale > 0) == (not passed)
        assert any(seen is not None for seen in controller.seen) == bool(passed)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, 1e9])
def test_a_stamp_that_cannot_be_is_for_the_controller_to_judge(stamp):
    """And one of the future does not make all that follow it old."""

    class Once(GoodSensor):
        def observation(self, true):
            return super().observation(stamp if true < 100.2 else true)

    clock = FakeClock()
    controller = Cruise()
    loop, _ = loop_of(controller, clock, sensor=Once(clock))
    loop.run(duration=1.0)
    seen = [observation.stamp for observation in controller.seen if observation is not None]
    assert any(s == stamp or (s != s and stamp != stamp) for s in seen)
    assert sum(100.2 <= s <= 101.0 for s in seen) > 15


# Ways out ---------------------------------------------------------------------------------------


def failing(after, error, method, kind):
    """A part whose ``method`` raises ``error`` at its call number ``after``, once."""

    class Failing(kind):
        calls = 0

        def __getattribute__(self, name):
            if name != method:
                return super().__getattribute__(name)
            self.calls += 1
            if self.calls == after:
                raise error
            return super().__getattribute__(name)

    return Failing


class ChassisError(Exception):
    pass


@pytest.mark.parametrize("after", [1, 2, 7, 30])
@pytest.mark.parametrize("method", ["send", "applied", "observe", "now", "sleep_until", "step"])
@pytest.mark.parametrize("error", [ChassisError("gone"), KeyboardInterrupt(), SystemExit(3)])
def test_an_exception_anywhere_ends_in_the_brake_then_stop(after, method, error):
    clock = failing(after, error, method, FakeClock)()
    chassis = failing(after, error, method, Recorded)(clock)
    sensor = failing(after, error, method, GoodSensor)(clock)
    controller = failing(after, error, method, Cruise)()
    # Only one of them has the method that fails; the chassis and the sensor read a sound clock.
    chassis.clock = sensor.clock = sound = FakeClock()
    type(clock).time = property(lambda self: sound.time, lambda self, t: setattr(sound, "time", t))
    loop = ControlLoop(controller, chassis, sensor, clock, period=PERIOD, limits=ROBOT)
    with pytest.raises(type(error)):
        loop.run(duration=5.0)
    assert loop.report is not None
    assert loop.report.ending is Ending.ERROR
    assert loop.report.error is error
    assert loop.report.brake_error is loop.report.stop_error is None
    assert chassis.applied() == REST
    assert chassis.stops == 1
    if method in ("now", "sleep_until"):  # the times of a clock that failed say nothing
        assert_within_limits(chassis.sent, -math.inf)
    else:
        assert_within_limits(chassis.sent)
    if chassis.sent:
        assert chassis.sent[-1][1] == REST


def test_a_brake_that_cannot_be_sent_is_a_stop():
    class Dead(Recorded):
        def send(self, twist):
            if len(self.sent) >= 20:
                raise ChassisError("link lost")
            super().send(twist)

    clock = FakeClock()
    chassis = Dead(clock)
    loop, _ = loop_of(Cruise(), clock, chassis)
    with pytest.raises(ChassisError):
        loop.run()
    assert isinstance(loop.report.brake_error, ChassisError)
    assert loop.report.braked == 0
    assert chassis.applied() == REST
    assert chassis.stops == 1


@pytest.mark.parametrize("failures", [1, 2, 99])
def test_stop_is_tried_again_and_its_failure_told(failures):
    class Deaf(Recorded):
        def stop(self):
            self.stops += 1
            if self.stops <= failures:
                raise ChassisError("deaf")

    clock = FakeClock()
    chassis = Deaf(clock)
    loop, _ = loop_of(Cruise(), clock, chassis)
    if failures < 3:
        assert loop.run(duration=1.0).stop_error is None
        assert chassis.stops == failures + 1
    else:
        with pytest.raises(ChassisError):
            loop.run(duration=1.0)
        assert isinstance(loop.report.stop_error, ChassisError)
        assert chassis.stops == 3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_in_the_brake(number):
    before = signal.getsignal(number)

    def work(tick):
        if tick == 25:
            os.kill(os.getpid(), number)
            time.sleep(0.001)  # lets the handler run

    loop, chassis = loop_of(Cruise(work))
    report = loop.run()
    assert (report.ending, report.signal) == (Ending.SIGNAL, number)
    assert report.statistics.ticks == 25  # the decision of that tick is not sent
    assert_braked(chassis.sent[25:], chassis.sent[24][1])
    assert_within_limits(chassis.sent)
    assert_at_rest(chassis)
    assert signal.getsignal(number) is before


def test_a_second_signal_does_not_cut_the_brake_short():
    class Impatient(Recorded):
        def send(self, twist):
            super().send(twist)
            if len(self.sent) >= 20:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.001)

    clock = FakeClock()
    loop, chassis = loop_of(Cruise(), clock, Impatient(clock))
    assert loop.run().ending is Ending.SIGNAL
    assert_braked(chassis.sent[20:], chassis.sent[19][1])


def test_stop_from_another_thread():
    clock = FakeClock()
    loop = None

    def work(tick):
        if tick == 12:
            thread = threading.Thread(target=loop.stop)
            thread.start()
            thread.join()

    loop, chassis = loop_of(Cruise(work), clock)
    report = loop.run()
    assert report.ending is Ending.STOPPED
    assert report.statistics.ticks == 12
    assert_at_rest(chassis)
    assert loop.run(duration=0.5).ending is Ending.TIMEOUT  # it can run again


def test_runs_in_a_thread_without_signals():
    loop, chassis = loop_of(Cruise())
    endings = []
    thread = threading.Thread(target=lambda: endings.append(loop.run(duration=1.0).ending))
    thread.start()
    thread.join()
    assert endings == [Ending.TIMEOUT]
    assert_at_rest(chassis)


@pytest.mark.parametrize("bad", [Twist(math.nan, 0.0), Twist(0.5, 0.0), Twist(0.0, 0.05)])
def test_a_command_out_of_its_box_is_never_sent(bad):
    class Wild(Cruise):
        def step(self, observation, applied, now):
            decision = super().step(observation, applied, now)
            return decision._replace(twist=bad) if self.number == 15 else decision

    loop, chassis = loop_of(Wild())
    with pytest.raises(LimitsError, match="outside of InputBox"):
        loop.run()
    assert bad not in [twist for _, twist in chassis.sent]
    assert_within_limits(chassis.sent)
    assert_at_rest(chassis)


def test_done_and_failed_end_the_run():
    class Ends(Cruise):
        def __init__(self, **ending):
            super().__init__()
            self.ending = ending

        def step(self, observation, applied, now):
            decision = super().step(observation, applied, now)
            if self.number <= 8:
                return decision
            stop = ROBOT.input_box(applied, PERIOD).clip(REST)
            done = self.ending.get("done", False) and applied == REST
            return decision._replace(twist=stop, done=done, phase=self.ending.get("phase"))

    for options, ending in (
        ({"done": True}, Ending.DONE),
        ({"phase": Phase.FAILED}, Ending.FAILED),
    ):
        loop, chassis = loop_of(Ends(**options))
        report = loop.run(duration=60.0)
        assert report.ending is ending
        assert report.braked == 0  # it stands already
        assert report.decision.twist == REST
        assert_at_rest(chassis)


def test_brake_the_controller_has_begun_is_counted_down():
    """Half way through a brake of its own, the loop's goes on where that was."""

    class Braking(Cruise):
        def step(self, observation, applied, now):
            decision = super().step(observation, applied, now)
            if self.number <= 20:
                return decision
            ticks = ROBOT.brake_ticks(self.top, PERIOD)
            share = 1.0 - (self.number - 20) / ticks
            return decision._replace(twist=self.top.scaled(share))

    controller = Braking()
    clock = FakeClock()
    chassis = Recorded(clock)
    stop_at = 30
    controller.work = lambda number: loop.stop() if number == stop_at else None
    loop, _ = loop_of(controller, clock, chassis)
    controller.top = ROBOT.input_box(REST, 20 * PERIOD).clip(Twist(0.22, 0.3))
    loop.run()
    top = chassis.sent[19][1]
    assert top == pytest.approx(controller.top, abs=1e-12)
    assert_braked(chassis.sent[20:], top)


def test_a_base_that_stopped_by_itself_is_not_sped_up_again():
    class Halts(Recorded):
        def applied(self):
            return REST if len(self.sent) >= 20 else super().applied()

    class Blind(GoodSensor):
        def observe(self):
            if chassis.sent and len(chassis.sent) >= 20:
                raise ChassisError("and the sensor is dead")
            return

    clock = FakeClock()
    chassis = Halts(clock)
    loop, _ = loop_of(Cruise(), clock, chassis, Blind(clock))
    with pytest.raises(ChassisError):
        loop.run()
    assert len(chassis.sent) == 20
    assert chassis.stops == 1


def test_handover_from_a_faster_stage_brakes_toward_the_limits():
    clock = FakeClock()
    chassis = Recorded(clock)
    chassis.command = Twist(0.55, 0.1)
    loop, _ = loop_of(Cruise(lambda number: loop.stop()), clock, chassis)
    report = loop.run()
    assert report.statistics.ticks == 0
    before = Twist(0.55, 0.1)
    for _, twist in chassis.sent:
        assert ROBOT.input_box(before, PERIOD).contains(twist, 1e-9)
        assert abs(twist.v) < abs(before.v)
        before = twist
    assert before == REST
    assert len(chassis.sent) == ROBOT.brake_ticks(Twist(0.55, 0.1), PERIOD)


# Data -------------------------------------------------------------------------------------------


def test_statistics_are_those_of_the_window_and_json():
    clock = FakeClock()
    rng = np.random.default_rng(1)
    work = rng.uniform(0.0, 0.9 * PERIOD, 200).tolist()

    def busy(number):
        clock.time += work[number]

    loop, chassis = loop_of(Cruise(busy), clock, policy=LoopPolicy(window=50))
    statistics = loop.run(duration=150 * PERIOD).statistics
    assert statistics.ticks == 150
    gaps = np.diff([when for when, _ in chassis.sent[:150]])[-50:]
    expected = [*np.percentile(gaps, (50, 90, 99)), gaps.max()]
    assert statistics.period == pytest.approx(expected, rel=1e-9)
    assert statistics.lateness == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-12)
    record = json.loads(json.dumps(statistics.to_dict(), allow_nan=False))
    assert record["ticks"] == 150
    assert record["period"]["p50"] == statistics.period.p50


def test_percentiles_of_nothing_are_told_apart_from_zero():
    nothing = Percentiles.of(np.array([math.nan, math.inf]))
    assert all(math.isnan(value) for value in nothing)
    loop, _ = loop_of(Cruise())
    assert loop.statistics.to_dict()["period"] == dict.fromkeys(Percentiles._fields)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: LoopPolicy(overrun="brake"), "overrun must be one of Overrun.BRAKE"),
        (lambda: LoopPolicy(misses=0), "misses must be an integer >= 1, got 0"),
        (lambda: LoopPolicy(window=1.5), "window must be an integer >= 1, got 1.5"),
        (lambda: LoopPolicy(max_age=math.nan), "max_age must be finite"),
        (lambda: loop_of(Cruise(), chassis=object()), "chassis lacks a method of Chassis"),
        (lambda: loop_of(Cruise(), sensor=object()), "sensor lacks a method of TargetSensor"),
        (lambda: loop_of(Cruise())[0].run(duration=math.nan), "duration must be at least 0"),
        (lambda: CommandFilter(None, 0.0), "timeout must be finite and positive"),
    ],
)
def test_bad_arguments(call, told):
    with pytest.raises(ConfigurationError, match=told):
        call()


# With the real parts ----------------------------------------------------------------------------


def simulated(start, wall=None, body=None, model=None):
    world = World()
    limits = LIMITS["approaching"]
    rng = np.random.default_rng(5)
    plant = KinematicPlant(start, limits, body or Body(), rng)
    model = model or SensorModel.named("A")
    sensor = PoseSensor(plant, world.camera, world.standoff, model, rng)
    controller = DockingController(
        limits, world.camera, world.standoff, world.period, lag=(body or Body()).lag
    )
    robot = PlantInTheLoop(plant, sensor, wall)
    return plant, robot, controller, world, limits


def docked(wall=None, **options):
    plant, robot, controller, world, limits = simulated(Pose2(-1.6, 0.2, 0.0), wall)
    loop = ControlLoop(
        controller, robot, robot, robot, period=world.period, limits=limits, **options
    )
    report = loop.run(duration=40.0)
    robot.sleep_until(robot.now() + 0.5)
    return report, plant.pose()


def test_docks_through_the_loop_and_the_same_every_time():
    commands = []
    report, pose = docked(on_tick=lambda tick: commands.append(tick.command))
    assert report.ending is Ending.DONE
    assert math.hypot(pose.x, pose.y) < 0.010
    assert abs(pose.theta) < math.radians(2.0)
    assert report.statistics.missed == 0
    assert report.braked == 0
    again = []
    assert docked(on_tick=lambda tick: again.append(tick.command))[1] == pose
    assert again == commands


def test_simulated_robot_keeps_the_rules_of_the_protocols():
    quiet = SensorModel(outlier=0.0, dropout=0.0)

    def make():
        return simulated(Pose2(-1.6, 0.0, 0.0), model=quiet)[1]

    check_clock(make, wait=0.02).require()
    robot = make()

    def stopped():
        robot.stop()
        return robot

    check_chassis(stopped, clock=robot).require()
    robot = make()
    check_sensor(lambda: robot, clock=robot, standoff=0.6).require()


def test_simulated_robot_keeps_up_with_the_wall_clock():
    plant, robot, *_ = simulated(Pose2(-1.6, 0.0, 0.0), MonotonicClock(), Body.ideal())
    begun = robot.now()
    robot.send(Twist(0.2, 0.0))
    time.sleep(0.05)
    robot.send(Twist(0.0, 0.0))
    moved = plant.pose().x + 1.6
    assert moved == pytest.approx(0.2 * (robot.now() - begun), abs=0.002)
    assert moved >= 0.2 * 0.05 - 1e-4


def test_filter_stands_without_a_fresh_wish():
    clock = FakeClock()
    camera = FieldOfView(math.radians(35.0))
    controller = CommandFilter(SafetyFilter(ROBOT, [camera], PERIOD), timeout=0.2)
    records = []

    def wish(tick):
        records.append(tick)
        if clock.now() < 101.0:  # then the source dies
            controller.command(Twist(0.2, 0.0), clock.now())

    loop, chassis = loop_of(controller, clock, on_tick=wish)
    loop.run(duration=3.0)
    speeds = {tick.sent: tick.command.v for tick in records}
    assert max(speeds.values()) == pytest.approx(0.2, abs=1e-9)
    stopping = 101.0 + 0.2 + 0.2 / 0.3 + 3.0 * PERIOD
    assert all(v == 0.0 for when, v in speeds.items() if when > stopping)
    assert speeds[102.5] == 0.0
    assert_within_limits(chassis.sent)


def test_filter_does_not_drive_before_the_target_was_seen():
    class Blind(GoodSensor):
        def observe(self):
            return None

    clock = FakeClock()
    controller = CommandFilter(SafetyFilter(ROBOT, [FieldOfView(0.6)], PERIOD), timeout=1e6)
    controller.command(Twist(0.2, 0.1), clock.now())
    loop, chassis = loop_of(controller, clock, sensor=Blind(clock))
    report = loop.run(duration=1.0)
    assert report.decision.status is Status.NO_TARGET
    assert all(twist == REST for _, twist in chassis.sent)


@settings(max_examples=20)
@given(wish=st.builds(Twist, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0)), seed=st.integers(0, 99))
def test_filter_keeps_the_board_in_view_whatever_is_wished(wish, seed):
    world = World()
    limits = LIMITS["approaching"]
    rng = np.random.default_rng(seed)
    start = Pose2(-1.6, float(rng.uniform(-0.3, 0.3)), 0.0)
    plant = KinematicPlant(start, limits, Body(), rng)
    sensor = PoseSensor(plant, world.camera, world.standoff, SensorModel.ideal(), rng)
    robot = PlantInTheLoop(plant, sensor)
    safety = SafetyFilter(limits, [world.camera], world.period, lag=Body().lag)
    controller = CommandFilter(safety, timeout=1e6)
    controller.command(wish, 0.0)
    margins = []

    def look(tick):
        pose = plant.pose()
        margins.append(world.camera.margin(pose.seen((world.standoff, 0.0))))

    loop = ControlLoop(
        controller, robot, robot, robot, period=world.period, limits=limits, on_tick=look
    )
    loop.run(duration=2.5)
    assert min(margins) >= 0.0


SCRIPT = """
import sys
from tests.test_loop import Cruise, ROBOT, PERIOD
from tests.hardware.fakes import GoodSensor, GoodChassis
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.runtime import ControlLoop
clock = MonotonicClock()

class Chassis(GoodChassis):
    def send(self, twist):
        super().send(twist)
        print(f"{twist.v:.6f}", flush=True)

    def stop(self):
        super().stop()
        print("stop", flush=True)

loop = ControlLoop(
    Cruise(), Chassis(clock), GoodSensor(clock), clock, period=PERIOD, limits=ROBOT
)
print(loop.run().ending.value, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGTERM cannot be caught on Windows")
def test_a_process_told_to_terminate_brakes_in_real_time():
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-c", SCRIPT], stdout=subprocess.PIPE, text=True
    )
    try:
        lines = [process.stdout.readline() for _ in range(12)]
        process.send_signal(signal.SIGTERM)
        rest = process.stdout.read().split()
        assert process.wait(timeout=10.0) == 0
    finally:
        process.kill()
        process.stdout.close()
    assert rest[-2:] == ["stop", "signal"]
    speeds = [float(word) for word in (*lines, *rest[:-2])]
    top = max(speeds)
    assert top > 0.1
    assert speeds[-1] == 0.0
    for before, after in itertools.pairwise(speeds):
        assert abs(after - before) <= ROBOT.a_max * PERIOD + 2e-6


# Which part it was ------------------------------------------------------------------------------


def failing_loop(method, after=7, error=None):
    """A loop one of whose parts raises at a call of ``method``."""
    error = error or ChassisError("gone")
    clock, sound = failing(after, error, method, FakeClock)(), FakeClock()
    chassis = failing(after, error, method, Recorded)(clock)
    sensor = failing(after, error, method, GoodSensor)(clock)
    controller = failing(after, error, method, Cruise)()
    chassis.clock = sensor.clock = sound
    type(clock).time = property(lambda self: sound.time, lambda self, t: setattr(sound, "time", t))
    return ControlLoop(controller, chassis, sensor, clock, period=PERIOD, limits=ROBOT)


PARTS = {
    "send": Part.CHASSIS, "applied": Part.CHASSIS, "observe": Part.SENSOR,
    "step": Part.CONTROLLER, "sleep_until": Part.CLOCK,
}  # fmt: skip


@pytest.mark.parametrize("method", PARTS)
def test_the_part_that_raised_is_named(method):
    loop = failing_loop(method)
    with pytest.raises(ChassisError):
        loop.run(duration=5.0)
    assert loop.report.part is PARTS[method]
    (failure,) = loop.report.failures
    assert (failure.part, failure.what, failure.ticks) == (PARTS[method], "raised", 1)
    assert str(failure) == f"{PARTS[method].value} raised: ChassisError: gone"


def test_an_interrupt_is_no_part_s_failure():
    loop = failing_loop("step", error=KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    assert loop.report.part is None
    assert loop.report.failures == ()


def test_the_observer_that_raised_is_named():
    def look(tick):
        raise ChassisError("disk")

    loop, _ = loop_of(Cruise(), on_tick=look)
    with pytest.raises(ChassisError):
        loop.run()
    assert loop.report.part is Part.OBSERVER


def test_a_run_without_failures_names_none():
    loop, _ = loop_of(Cruise())
    report = loop.run(duration=3.0)
    assert (report.part, report.failures) == (None, ())


def test_a_silent_sensor_is_named_though_the_run_goes_on():
    clock = FakeClock()

    class Silenced(GoodSensor):
        def observe(self):
            seen = super().observe()
            return None if 101.0 <= clock.time < 104.0 else seen

    loop, _ = loop_of(Cruise(), clock, sensor=Silenced(clock))
    report = loop.run(duration=6.0)
    (failure,) = report.failures
    assert (failure.part, failure.what) == (Part.SENSOR, "silent")
    # from the patience of 2 s after the last measurement until the next
    assert failure.first == pytest.approx(103.0, abs=0.15)
    assert failure.last == pytest.approx(104.0, abs=0.15)
    assert failure.ticks == pytest.approx((failure.last - failure.first) / PERIOD + 1, abs=0.1)


def test_a_sensor_that_is_missed_sooner_is_named_sooner():
    """Near the goal a controller stops before the patience is over, and says so."""
    loop, _ = loop_of(deciding(events=(Event.UNCERTAIN,)), FakeClock())
    (failure,) = loop.run(duration=0.5).failures
    assert (failure.part, failure.what) == (Part.SENSOR, "silent")


def deciding(**fields):
    class Decides(Cruise):
        def step(self, observation, applied, now):
            return super().step(observation, applied, now)._replace(**fields)

    return Decides()


SOLVED = LexicographicSolution(0.0, 0.0, ())
NO_ANSWER = BackendHealth("mine", False, "numerical error", math.inf, "RuntimeError: no licence")


@pytest.mark.parametrize(
    ("fields", "part", "told"),
    [
        ({"answer": SOLVED._replace(health=NO_ANSWER)}, Part.SOLVER,
         "solver gave no answer: 'mine': RuntimeError: no licence"),
        ({"answer": SOLVED._replace(health=NO_ANSWER._replace(refused=True))}, Part.SOLVER,
         "solver gave a wrong answer: 'mine'"),
        ({"status": Status.INTERNAL_ERROR, "reason": "ValueError: barrier"}, Part.CONTROLLER,
         "controller raised inside: ValueError: barrier"),
        ({"status": Status.SOLVER_FAILED}, Part.SOLVER, "solver gave no answer"),
        ({"status": Status.CLOCK_ERROR}, Part.CLOCK, "clock did not advance"),
        ({"status": Status.INVALID_INPUT}, Part.SENSOR, "sensor unusable"),
    ],
)  # fmt: skip
def test_what_a_decision_says_of_a_part_is_noted(fields, part, told):
    loop, _ = loop_of(deciding(**fields))
    report = loop.run(duration=1.0)
    (failure,) = report.failures
    assert failure.part is part
    assert str(failure).startswith(told)
    assert failure.ticks == report.statistics.ticks


def test_a_solver_that_was_used_is_no_failure():
    used = BackendHealth("mine", True, "optimal", 0.0, "")
    loop, _ = loop_of(deciding(answer=SOLVED._replace(health=used)))
    assert loop.run(duration=1.0).failures == ()


@pytest.mark.parametrize("slow", ["observe", "applied", "step", "send", "on_tick", "machine"])
def test_the_part_that_was_slow_is_named(slow):
    clock = FakeClock()
    delay = {slow: 2.5 * PERIOD}

    def wait(name, number):
        clock.time += delay.get(name, 0.0) if number == 20 else 0.0

    class Chassis(Recorded):
        asked = 0

        def applied(self):
            self.asked += 1
            wait("applied", self.asked // 2)  # once a tick before the decision, and once after
            return super().applied()

        def send(self, twist):
            wait("send", len(self.sent))
            super().send(twist)

    class Sensor(GoodSensor):
        asked = 0

        def observe(self):
            self.asked += 1
            wait("observe", self.asked)
            return super().observe()

    class Clock(FakeClock):
        waits = 0

        def sleep_until(self, time):
            super().sleep_until(time)
            self.waits += 1
            wait("machine", self.waits)

    clock = Clock()
    ticks = []
    loop, _ = loop_of(
        Cruise(lambda number: wait("step", number)), clock, Chassis(clock), Sensor(clock),
        on_tick=lambda tick: (wait("on_tick", tick.number), ticks.append(tick)),
    )  # fmt: skip
    report = loop.run(duration=2.0)
    expected = {
        "observe": Part.SENSOR, "applied": Part.CHASSIS, "step": Part.CONTROLLER,
        "send": Part.CHASSIS, "on_tick": Part.OBSERVER, "machine": Part.MACHINE,
    }  # fmt: skip
    assert [(f.part, f.what) for f in report.failures] == [(expected[slow], "late")]
    assert f"took {2.5 * PERIOD:.3f} s of a period of {PERIOD:.3f} s" in str(report.failures[0])
    assert sum(tick.missed for tick in ticks) == 1


def test_a_solver_within_a_late_step_is_told():
    clock = FakeClock()
    health = BackendHealth("mine", True, "optimal", 0.0, "")

    class Slow(Cruise):
        def step(self, observation, applied, now):
            decision = super().step(observation, applied, now)
            return decision._replace(answer=SOLVED._replace(health=health))

    slow = Slow(lambda number: setattr(clock, "time", clock.time + 2.0 * PERIOD * (number > 9)))
    loop, _ = loop_of(slow, clock)
    report = loop.run()
    assert report.ending is Ending.OVERRUN
    assert report.part is Part.CONTROLLER
    assert str(report.failures[0]).endswith("with the solver 'mine' in it, 15 ticks")


@pytest.mark.parametrize("overrun", [Overrun.BRAKE, Overrun.SEND])
def test_a_base_that_stopped_by_itself_during_a_tick_is_not_sped_up_again(overrun):
    """Its time-out runs off while a decision takes long; what was in force is so no longer."""
    clock = FakeClock()
    ticks = []
    long = lambda number: setattr(clock, "time", clock.time + 0.3 * (number == 20))  # noqa: E731
    chassis = Recorded(clock)
    chassis.timeout = 0.2
    loop, _ = loop_of(
        Cruise(long), clock, chassis, policy=LoopPolicy(overrun), on_tick=ticks.append
    )  # fmt: skip
    report = loop.run(duration=1.5)
    late = ticks[20]
    assert late.applied.v > 0.15
    assert late.in_force == REST
    assert late.command == REST
    assert all(tick.in_force is None for tick in ticks if tick is not late)
    assert ROBOT.input_box(REST, PERIOD).contains(ticks[21].command, 1e-9)
    assert (Part.CONTROLLER, "late") in [(f.part, f.what) for f in report.failures]


def test_a_base_that_stops_by_itself_is_named():
    clock = FakeClock()

    class Tired(Recorded):
        def applied(self):
            return REST if len(self.sent) == 20 else super().applied()

    loop, _ = loop_of(Cruise(), clock, Tired(clock))
    report = loop.run(duration=1.5)
    assert [(f.part, f.what) for f in report.failures] == [(Part.CHASSIS, "stopped by itself")]


def test_a_base_that_gives_no_twist_is_named():
    clock = FakeClock()

    class Odd(Recorded):
        def applied(self):
            return Twist(math.nan, 0.0) if len(self.sent) in (20, 21) else super().applied()

    loop, _ = loop_of(Cruise(), clock, Odd(clock))
    with pytest.raises(LimitsError):
        loop.run()
    assert [f.part for f in loop.report.failures] == [Part.CHASSIS, Part.CONTROLLER]
