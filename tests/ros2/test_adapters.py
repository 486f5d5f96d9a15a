"""Stamps, chassis and target over a transport in memory, on a clock that the test moves."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.hardware.conformance import check_chassis, check_clock, check_sensor
from clfcbf.ros2.chassis import TopicChassis, twist_message, twist_of
from clfcbf.ros2.detection import DetectionFrame, Refusal
from clfcbf.ros2.messages import Clock, Header, PoseStamped, Time, TwistStamped
from clfcbf.ros2.messages import Twist as TwistMessage
from clfcbf.ros2.sim_time import SimulatedTime
from clfcbf.ros2.stamps import JUMP, MAX_AHEAD, Stamps
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.transport import CLOCK, COMMANDS, LATEST, Quality, TransportError, absolute
from clfcbf.se2 import Pose2, Twist
from tests.hardware.fakes import REST, FakeClock
from tests.ros2.bus import Bus
from tests.strategies import poses, twists

EPOCH = 1_790_000_000_000_000_000


class WallClock:
    """Time of day beside a loop's clock; the test may set it."""

    def __init__(self, clock, ahead=EPOCH):
        self.clock = clock
        self.ahead = ahead

    def __call__(self):
        return round(1e9 * self.clock.now()) + self.ahead


# Stamps ---------------------------------------------------------------------------------------


@given(st.floats(0.0, 1e5), st.integers(-(10**18), 2 * 10**18))
def test_stamps_and_back(instant, ahead):
    clock = FakeClock(1e5)
    stamps = Stamps(clock, WallClock(clock, ahead))
    stamp = stamps.at(instant)
    assert stamp.nanoseconds == round(1e9 * instant) + ahead
    assert 0 <= stamp.nanosec < 1_000_000_000
    assert stamps.instant(stamp) == pytest.approx(instant, abs=2e-9)


def test_nanoseconds_survive_although_seconds_of_the_epoch_do_not_hold_them():
    clock = FakeClock(10.0)
    stamps = Stamps(clock, WallClock(clock))
    one, other = (stamps.instant(Time.of(EPOCH + 9_000_000_000 + n)) for n in (0, 100))
    assert other - one == pytest.approx(1e-7, rel=1e-3)


@pytest.mark.parametrize("step", [-3600.0, -0.06, -0.05, -0.02, 0.02, 0.05, 3600.0])
def test_what_was_stamped_before_the_time_was_set_has_no_instant(step):
    clock = FakeClock(10.0)
    wall = WallClock(clock)
    stamps = Stamps(clock, wall)
    before = stamps.now()
    wall.ahead += round(1e9 * step)
    clock.time += 0.001
    found = stamps.instant(before)  # far ahead where it was set back by far: refused for that
    assert found is None or found > clock.now() + MAX_AHEAD
    clock.time += 0.1
    assert stamps.instant(stamps.now()) == pytest.approx(clock.now(), abs=1e-8)


def test_a_clock_that_is_slewed_is_not_set():
    clock = FakeClock(10.0)
    wall = WallClock(clock)
    stamps = Stamps(clock, wall)
    for _ in range(100):
        stamp = stamps.now()
        clock.time += 0.033
        wall.ahead += JUMP // 2
        assert stamps.instant(stamp) is not None


def test_a_process_that_is_put_to_sleep_between_two_clocks_reads_again():
    class Sleepy(FakeClock):
        naps = 0

        def now(self):
            if self.naps:
                self.naps -= 1
                self.time += 0.5
            return self.time

    clock = Sleepy(10.0)
    stamps = Stamps(clock, lambda: round(1e9 * clock.time) + EPOCH)
    stamp = stamps.now()
    clock.naps = 2  # between the readings of the loop's clock on either side of the other one
    assert stamps.instant(stamp) == pytest.approx(10.0, abs=1e-8)
    assert clock.time == 11.0


def test_simulated_time_is_the_stamp():
    clock = FakeClock(12.5)
    stamps = Stamps(clock, None)
    assert stamps.now() == Time(12, 500_000_000)
    assert stamps.instant(Time(3, 33_333_334)) == 1e-9 * 3_033_333_334


# Simulated time -------------------------------------------------------------------------------


def test_simulated_time_follows_and_never_runs_back():
    bus = Bus()
    publisher = bus.transport().publisher(Clock, "/clock", Quality())
    clock = SimulatedTime(bus.transport().subscription(Clock, "/clock", CLOCK), silence=0.05)
    assert clock.now() == 0.0
    for told, now in ((5, 5.0), (3, 5.0), (6, 6.0)):
        publisher.publish(Clock(Time(told)))
        assert clock.now() == now
    clock.sleep_until(4.0)
    with pytest.raises(TransportError, match="no new time"):
        clock.sleep_until(7.0)


def test_simulated_time_is_a_clock():
    """As fast as somebody looks: each look lets a tenth of a millisecond pass."""

    class Running:
        def __init__(self):
            self.begun = time.monotonic_ns()

        def take(self):
            return [Clock(Time.of(time.monotonic_ns() - self.begun + 1))]

        def sources(self):
            return 1

    assert check_clock(lambda: SimulatedTime(Running()), tolerance=0.1).passed


# Chassis --------------------------------------------------------------------------------------


def chassis_on(bus, clock=None, listen=True, **options):
    clock = clock or FakeClock()
    stamps = Stamps(clock, WallClock(clock))
    made = TopicChassis(bus.transport(), clock, stamps, **options)
    if listen:
        kind = TwistStamped if options.get("stamped", True) else TwistMessage
        bus.transport().subscription(kind, "/cmd_vel", LATEST)
    return made


@given(twists)
def test_a_twist_and_back(twist):
    message = twist_message(twist)
    assert twist_of(message) == twist
    assert (message.linear.y, message.linear.z) == (message.angular.x, message.angular.y) == (0, 0)


@pytest.mark.parametrize("stamped", [True, False])
def test_chassis_keeps_the_rules(stamped):
    clock = FakeClock()
    report = check_chassis(
        lambda: chassis_on(Bus(), clock, stamped=stamped, timeout=0.5), clock=clock, timeout=0.5
    )
    report.require()


def test_each_command_is_sent_once_with_time_and_frame():
    bus, clock = Bus(), FakeClock(7.0)
    chassis = chassis_on(bus, clock, frame="rover_base")
    chassis.send(Twist(0.1, -0.2))
    clock.time += 0.4
    (sent,) = bus.messages("/cmd_vel")
    assert twist_of(sent.twist) == Twist(0.1, -0.2)
    assert sent.header == Header(Time.of(EPOCH + 7_000_000_000), "rover_base")


def test_a_command_that_nobody_hears_is_refused():
    bus = Bus()
    chassis = chassis_on(bus, listen=False)
    with pytest.raises(TransportError, match="nobody listens to /cmd_vel"):
        chassis.send(Twist(0.1, 0.0))
    assert chassis.applied() == REST
    assert bus.messages("/cmd_vel") == []
    chassis.stop()  # goes out all the same
    assert len(bus.messages("/cmd_vel")) == 1


def test_an_unstamped_chassis_does_not_reach_a_stamped_base():
    bus = Bus()
    chassis = chassis_on(bus, listen=False, stamped=False)
    bus.transport().subscription(TwistStamped, "/cmd_vel", COMMANDS)
    assert chassis.listeners() == 0


def test_zero_is_the_last_command():
    bus = Bus()
    chassis = chassis_on(bus)
    chassis.send(Twist(0.2, 0.1))
    chassis.close()
    chassis.close()
    assert [twist_of(m.twist) for m in bus.messages("/cmd_vel")] == [Twist(0.2, 0.1), REST]
    assert chassis.applied() == REST
    with pytest.raises(TransportError, match="closed"):
        chassis.send(Twist(0.2, 0.1))
    chassis.stop()
    assert len(bus.messages("/cmd_vel")) == 2


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.nan])
def test_a_base_stops_at_some_time(timeout):
    with pytest.raises(ConfigurationError, match="time-out"):
        chassis_on(Bus(), timeout=timeout)


def test_a_command_that_is_no_number_is_not_sent():
    bus = Bus()
    with pytest.raises(GeometryError):
        chassis_on(bus).send(Twist(math.nan, 0.0))
    assert bus.messages("/cmd_vel") == []


# Target ---------------------------------------------------------------------------------------

OPTICAL = DetectionFrame("camera_optical_frame", Pose2(0.2, 0.0, 0.1), optical=True)


class Eye:
    """A detector and the target that listens to it."""

    def __init__(self, frame=OPTICAL, clock=None, max_age=2.0):
        self.bus, self.clock, self.frame = Bus(), clock or FakeClock(), frame
        self.wall = WallClock(self.clock)
        self.stamps = Stamps(self.clock, self.wall)
        self.target = TopicTarget(
            self.bus.transport(), self.clock, self.stamps, 0.6, frame=frame, max_age=max_age
        )
        self.publisher = self.bus.transport().publisher(
            PoseStamped, "/detected_dock_pose", Quality()
        )

    def tell(self, feature, age=0.1, **changes):
        header = Header(self.stamps.at(self.clock.now() - age), self.frame.name)
        message = PoseStamped(header, self.frame.encode(feature))
        self.publisher.publish(replace(message, **changes))
        return message


@given(poses)
def test_an_observation_is_what_was_told(feature):
    eye = Eye()
    eye.tell(feature, age=0.08)
    seen = eye.target.observe()
    assert math.dist(seen.feature[:2], feature[:2]) < 1e-12
    goal = feature.compose(Pose2(-0.6, 0.0, 0.0))
    assert math.dist(seen.goal[:2], goal[:2]) < 1e-12
    assert seen.stamp == pytest.approx(eye.clock.now() - 0.08, abs=2e-9)
    assert eye.target.observe() is None
    assert eye.target.accepted == 1
    assert not any(eye.target.counts.values())


def test_target_keeps_the_rules_of_a_sensor():
    clock = FakeClock()

    class Live(Eye):
        told = -math.inf

        def observe(self):
            if self.clock.now() - self.told >= 1.0 / 30.0 - 1e-9:
                self.told = self.clock.now()
                self.tell(Pose2(1.8, 0.1, 0.05))
            return self.target.observe()

    check_sensor(lambda: Live(clock=clock), clock=clock, standoff=0.6, max_age=0.2).require()


def test_only_the_newest_of_several_is_handed_out():
    eye = Eye()
    for age, x in ((0.3, 1.0), (0.2, 1.1), (0.1, 1.2)):
        eye.tell(Pose2(x, 0.0, 0.0), age)
    assert eye.target.observe().feature.x == pytest.approx(1.2)
    assert eye.target.accepted == 3


AHEAD = Pose2(1.5, 0.0, 0.0)


def refused(eye):
    assert eye.target.observe() is None
    (found,) = [refusal for refusal, count in eye.target.counts.items() if count]
    assert eye.target.complaint.startswith(found.value)
    return found


def test_another_frame_is_refused():
    eye = Eye()
    message = eye.tell(AHEAD)
    eye.target.observe()
    eye.clock.time += 0.1
    eye.publisher.publish(replace(message, header=Header(eye.stamps.now(), "camera_link")))
    assert refused(eye) is Refusal.FRAME
    assert "'camera_link', expected 'camera_optical_frame'" in eye.target.complaint


def test_a_leading_slash_is_the_same_frame():
    eye = Eye(replace(OPTICAL, name="/camera_optical_frame"))
    eye.tell(AHEAD)
    assert eye.target.observe() is not None


@pytest.mark.parametrize(
    ("age", "expected"), [(2.01, Refusal.STALE), (-0.06, Refusal.AHEAD), (1e9, Refusal.STALE)]
)
def test_a_stamp_of_another_time_is_refused(age, expected):
    eye = Eye()
    eye.tell(AHEAD, age)
    assert refused(eye) is expected


def test_a_stamp_that_was_not_set_is_stale():
    eye = Eye()
    message = eye.tell(AHEAD)
    eye.target.observe()
    eye.publisher.publish(replace(message, header=replace(message.header, stamp=Time())))
    assert refused(eye) is Refusal.STALE


def test_a_stamp_a_little_ahead_counts_as_now():
    eye = Eye()
    eye.tell(AHEAD, age=-0.9 * MAX_AHEAD)
    assert eye.target.observe().stamp == eye.clock.now()


@pytest.mark.parametrize("older", [0.0, 0.05])
def test_a_measurement_that_is_not_newer_is_refused(older):
    eye = Eye()
    eye.tell(AHEAD, 0.1)
    assert eye.target.observe() is not None
    eye.tell(AHEAD, 0.1 + older)
    assert refused(eye) is Refusal.REPEATED


def test_a_measurement_from_before_the_time_was_set_is_refused():
    eye = Eye()
    eye.tell(AHEAD, 0.01)
    eye.wall.ahead += 60_000_000  # by NTP: not enough to be stale, or ahead
    assert refused(eye) is Refusal.CLOCK_SET
    eye.clock.time += 0.1
    eye.tell(AHEAD, 0.01)
    assert eye.target.observe() is not None


def test_one_that_is_refused_does_not_hide_a_good_one():
    eye = Eye()
    eye.tell(AHEAD, 0.2)
    eye.tell(Pose2(math.nan, 0.0, 0.0), 0.1)
    assert eye.target.observe() is not None
    assert eye.target.counts[Refusal.NOT_FINITE] == 1


@pytest.mark.parametrize("wrong", [{"standoff": -0.1}, {"standoff": math.nan}, {"max_age": 0.0}])
def test_target_settings_are_checked(wrong):
    clock = FakeClock()
    with pytest.raises(ConfigurationError):
        TopicTarget(Bus().transport(), clock, Stamps(clock), **{"standoff": 0.6, **wrong})


# Names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("namespace", "topic", "expected"),
    [
        ("", "cmd_vel", "/cmd_vel"), ("/", "cmd_vel", "/cmd_vel"),
        ("rob1", "cmd_vel", "/rob1/cmd_vel"), ("/rob1/", "a/b", "/rob1/a/b"),
        ("/rob1", "/diagnostics", "/diagnostics"),
    ],
)  # fmt: skip
def test_names_are_absolute(namespace, topic, expected):
    assert absolute(namespace, topic) == expected


@pytest.mark.parametrize("topic", ["", "/", "a//b", "a b", "1a", "a/2", "ä", "cmd_vel/"])
def test_names_are_those_of_ros(topic):
    with pytest.raises(ConfigurationError, match="topic"):
        absolute("", topic)


@pytest.mark.parametrize("depth", [0, -1, 1.5])
def test_a_topic_keeps_something(depth):
    with pytest.raises(ConfigurationError, match="depth"):
        Quality(depth=depth)
