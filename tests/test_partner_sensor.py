"""The target through its own pose link: where it is, when that was, and that its side has died."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.conformance import check_sensor
from clfcbf.hardware.partner_sensor import PartnerSensor, SilentPartnerError
from clfcbf.hardware.pose_link import PoseReceiver, PoseSender
from clfcbf.se2 import Pose2
from tests.hardware.fakes import FakeClock

KEY = bytes(range(32))
OTHER_KEY = bytes(range(1, 33))
PARTNER = 7
AHEAD = 12_345.0
"""[s] By which the clock that both robots share is ahead of the loop's own."""


class Link:
    """Both ends, on clocks that the test moves."""

    def __init__(self, standoff=0.6, key=KEY, **options):
        self.clock = FakeClock()
        self.robot = Pose2(0.0, 0.0, 0.0)
        self.asked = []
        self.receiver = PoseReceiver(KEY, PARTNER, clock=self.shared)
        self.sender = PoseSender(key, PARTNER, self.receiver.address[1], clock=self.shared)
        self.sensor = PartnerSensor(
            self.receiver, self.pose, self.clock, standoff, **options
        )  # fmt: skip

    def shared(self):
        return self.clock.time + AHEAD

    def pose(self, stamp):
        self.asked.append(stamp)
        return self.robot

    def close(self):
        self.sender.close()
        self.receiver.close()


@pytest.fixture
def link():
    made = Link()
    yield made
    made.close()


poses = st.builds(
    Pose2, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.0, 3.0)
)  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(robot=poses, partner=poses, standoff=st.floats(0.0, 3.0), age=st.floats(0.0, 0.4))
def test_feature_and_goal_by_plain_trigonometry(robot, partner, standoff, age):
    link = Link(standoff)
    try:
        link.robot = robot
        link.sender.send(partner, link.shared() - age)
        seen = link.sensor.observe()
    finally:
        link.close()
    assert seen is not None
    c, s = math.cos(robot.theta), math.sin(robot.theta)
    goal = (
        partner.x - standoff * math.cos(partner.theta),
        partner.y - standoff * math.sin(partner.theta),
    )
    for found, (x, y) in ((seen.feature, partner[:2]), (seen.goal, goal)):
        dx, dy = x - robot.x, y - robot.y
        assert found.x == pytest.approx(c * dx + s * dy, abs=1e-9)
        assert found.y == pytest.approx(c * dy - s * dx, abs=1e-9)
        turned = found.theta - (partner.theta - robot.theta)
        assert math.cos(turned) == pytest.approx(1.0, abs=1e-12)
    # on the loop's clock, at the time at which the pose was true
    assert seen.stamp == pytest.approx(link.clock.time - age, abs=1e-6)
    assert link.asked == [seen.stamp]


def test_each_pose_is_handed_out_once(link):
    link.sender.send(Pose2(2.0, 0.0, 0.0))
    assert link.sensor.observe() is not None
    assert link.sensor.observe() is None


def test_a_stamp_from_the_future_counts_as_now(link):
    link.sender.send(Pose2(2.0, 0.0, 0.0), link.shared() + 0.04)
    assert link.sensor.observe().stamp == link.clock.time


def test_silence_is_an_error_until_the_partner_is_back(link):
    link.sender.send(Pose2(2.0, 0.0, 0.0))
    assert link.sensor.observe() is not None
    link.clock.time += 0.5
    assert link.sensor.observe() is None
    link.clock.time += 0.1
    for _ in range(3):
        with pytest.raises(SilentPartnerError, match=r"no pose of partner 7 for 0\.60 s$"):
            link.sensor.observe()
    link.sender.close()
    link.sender = PoseSender(KEY, PARTNER, link.receiver.address[1], clock=link.shared)
    link.sender.send(Pose2(2.1, 0.0, 0.0))
    assert link.sensor.observe() is not None
    assert link.sensor.observe() is None


def test_silence_says_what_came_in_place_of_poses():
    link = Link(key=OTHER_KEY)
    try:
        link.clock.time += 0.6
        link.sender.send(Pose2(2.0, 0.0, 0.0))
        with pytest.raises(SilentPartnerError, match=r"ignored meanwhile: 1 forged"):
            link.sensor.observe()
    finally:
        link.close()


def test_keeps_the_rules_of_a_sensor():
    made = []

    class Alive:
        """A partner that sends whenever the time has moved on."""

        def __init__(self):
            made.append(Link(silence=math.inf))
            self.link, self.sent = made[-1], -math.inf
            self.link.clock = clock
            self.link.sensor._clock = clock

        def observe(self):
            if clock.time > self.sent:
                self.sent = clock.time
                self.link.sender.send(Pose2(2.0, 0.1, 0.0))
            return self.link.sensor.observe()

    clock = FakeClock()
    check_sensor(Alive, clock=clock, standoff=0.6, prompt=0.02).require()
    for link in made:
        link.close()


@pytest.mark.parametrize(
    ("standoff", "options", "told"),
    [(-0.1, {}, "standoff"), (math.nan, {}, "standoff"), (0.6, {"silence": 0.0}, "silence"),
     (0.6, {"silence": math.nan}, "silence")],
)  # fmt: skip
def test_wrong_values_are_refused(standoff, options, told):
    with PoseReceiver(KEY, PARTNER) as receiver, pytest.raises(ConfigurationError, match=told):
        PartnerSensor(
            receiver, lambda stamp: Pose2(0.0, 0.0, 0.0), FakeClock(), standoff, **options
        )
