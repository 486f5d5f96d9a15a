"""Reversals: limits, kinematics against Runge-Kutta, and the law that follows them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import defaults
from clfcbf.errors import GeometryError
from clfcbf.estimation import body_after
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.trajectories.following import FollowingGains, follow, is_over
from clfcbf.trajectories.legs import Trajectory
from clfcbf.trajectories.reversal import Reversals

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.375, 0.27, 0.9)
LENGTHS, SHARES, LEADS = (0.05, 0.2, 0.6), (-1.0, 0.0, 0.5), (0.0, 0.7)
TABLE = Reversals.tabulated(LIMITS, LENGTHS, SHARES, LEADS)
ORIGIN = Pose2(0.0, 0.0, 0.0)

some_limits = st.builds(
    Limits,
    v_max=st.floats(0.1, 0.5),
    omega_max=st.floats(0.2, 0.8),
    a_max=st.floats(0.2, 1.0),
    alpha_max=st.floats(0.5, 3.0),
    v_min=st.floats(-0.5, -0.05),
)
poses = st.builds(Pose2, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))


def test_the_table_has_every_combination_but_a_turn_of_nothing():
    assert len(TABLE) == 3 * 3 * 2 * 2
    rows = set(zip(TABLE.back, TABLE.first, TABLE.second, TABLE.lead, strict=True))
    assert len(rows) == len(TABLE)
    assert np.all(TABLE.second != 0.0)


def test_without_reverse_there_is_none():
    forward = Limits(0.22, 0.4, 0.3, 1.0, v_min=0.0)
    assert len(Reversals.tabulated(forward, LENGTHS, SHARES, LEADS)) == 0


@settings(max_examples=30)
@given(some_limits, poses, st.data())
def test_a_leg_keeps_all_four_limits_from_rest_to_full_speed(limits, start, data):
    table = Reversals.tabulated(limits, LENGTHS, SHARES, LEADS)
    row = data.draw(st.integers(0, len(table) - 1))
    leg = table.leg(row, start)
    v, omega = np.array(leg.twists).T
    t = np.array(leg.times)
    assert leg.duration == pytest.approx(table.durations[row], rel=1e-12)
    assert leg.twists[0] == (0.0, 0.0)
    assert v[-1] == pytest.approx(limits.v_max, rel=1e-9)
    assert v.min() >= limits.reverse_speed - 1e-12
    assert v.max() <= limits.v_max + 1e-12
    assert np.abs(omega).max() <= limits.omega_max + 1e-12
    assert (np.abs(np.diff(v)) / np.diff(t)).max() <= limits.a_max * (1 + 1e-9)
    assert (np.abs(np.diff(omega)) / np.diff(t)).max() <= limits.alpha_max * (1 + 1e-9)
    backward = -0.5 * (np.minimum(v[1:], 0.0) + np.minimum(v[:-1], 0.0)) @ np.diff(t)
    assert backward == pytest.approx(table.back[row], rel=0.02)


def driven(table, row, limits):
    """End of a motion by Runge-Kutta on the definition of its speeds, 1 ms a step."""
    back, first, second, lead = (
        float(column[row]) for column in (table.back, table.first, table.second, table.lead)
    )
    peak = min(-limits.reverse_speed, math.sqrt(limits.a_max * back))
    change = back / peak
    turned = max(change - lead, 0.0)
    begun = math.copysign(min(abs(first), limits.alpha_max * turned), first)

    def twist(t):
        v = -min(limits.a_max * t, peak)
        if t > change:
            v = min(limits.a_max * (t - change) - peak, limits.v_max)
        if t < turned:
            return v, math.copysign(min(abs(first), limits.alpha_max * t), first)
        most = limits.alpha_max * (t - turned)
        return v, begun + min(max(second - begun, -most), most)

    state, steps = np.zeros(3), 4000
    h = float(table.durations[row]) / steps

    def rate(t, state):
        v, omega = twist(t)
        return np.array([v * math.cos(state[2]), v * math.sin(state[2]), omega])

    for i in range(steps):
        t = i * h
        k1 = rate(t, state)
        k2 = rate(t + h / 2, state + h / 2 * k1)
        k3 = rate(t + h / 2, state + h / 2 * k2)
        k4 = rate(t + h, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


@pytest.mark.parametrize("row", range(0, len(TABLE), 5))
def test_poses_are_those_of_the_motion(row):
    end = driven(TABLE, row, LIMITS)
    np.testing.assert_allclose(TABLE.poses[row, -1], end, atol=5e-4)
    leg = TABLE.leg(row, ORIGIN)
    fine = leg.poses[-1]
    np.testing.assert_allclose((fine.x, fine.y), end[:2], atol=5e-5)
    assert wrap_angle(fine.theta - end[2]) == pytest.approx(0.0, abs=5e-5)
    assert leg.twists[-1].omega == pytest.approx(TABLE.turn_rates[row, -1])


@given(poses)
def test_a_start_elsewhere_moves_the_poses_with_it(start):
    rows = np.array([0, len(TABLE) // 2, len(TABLE) - 1])
    for seen, row in zip(TABLE.seen_from(start, rows), rows.tolist(), strict=True):
        x, y, theta = TABLE.poses[row, -1].tolist()
        expected = start.compose(Pose2(x, y, wrap_angle(theta)))
        np.testing.assert_allclose(seen[-1, :2], expected[:2], atol=1e-12)
        assert wrap_angle(seen[-1, 2] - expected.theta) == pytest.approx(0.0, abs=1e-12)
        end = TABLE.leg(row, start).poses[-1]
        assert math.hypot(end.x - expected.x, end.y - expected.y) < 1e-3


def test_a_trajectory_is_linear_between_samples_and_held_at_its_ends():
    leg = Trajectory(
        (0.0, 1.0, 2.0),
        (ORIGIN, Pose2(-0.2, 0.0, math.pi - 0.1), Pose2(-0.2, 0.2, -math.pi + 0.1)),
        (Twist(0.0, 0.0), Twist(-0.2, 0.1), Twist(0.2, 0.3)),
    )
    pose, twist = leg.at(1.5)
    assert pose[:2] == pytest.approx((-0.2, 0.1))
    assert abs(pose.theta) == pytest.approx(math.pi)
    assert twist == pytest.approx((0.0, 0.2))
    assert leg.at(-1.0) == leg.at(0.0)
    assert leg.at(3.0) == leg.at(2.0) == (leg.poses[-1], leg.twists[-1])
    assert leg.duration == 2.0
    with pytest.raises(GeometryError, match="columns"):
        Trajectory((0.0, 1.0), (ORIGIN,), (Twist(0.0, 0.0), Twist(0.0, 0.0)))
    with pytest.raises(GeometryError, match="2 or more"):
        Trajectory((0.0,), (ORIGIN,), (Twist(0.0, 0.0),))


def follow_through(leg, limits, start, held=range(0), lag=0.12):
    """Drive a lagging body along the leg; pose ahead, command and following of each tick."""
    pose, body, command, s, ticks = start, Twist(0.0, 0.0), Twist(0.0, 0.0), 0.0, []
    for k in range(600):
        box = limits.input_box(command, PERIOD)
        ahead = pose.moved(body, lag)
        following = follow(leg, False, ahead, s, box, limits, PERIOD, FollowingGains())
        ticks.append((ahead, command, following))
        if is_over(leg, following, command):
            return ticks
        s = following.s
        # The guard may hold a robot back: here it brakes it.
        command = box.clip(Twist(0.0, 0.0)) if k in held else following.twist
        body, mean = body_after(body, command, PERIOD, lag)
        pose = pose.moved(mean, PERIOD)
    raise AssertionError("the leg never ends")


@settings(max_examples=20)
@given(
    st.integers(0, len(TABLE) - 1), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01),
    st.floats(-0.02, 0.02),
)  # fmt: skip
def test_the_law_follows_a_reversal_and_goes_on_at_speed(row, x, y, theta):
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    leg = TABLE.leg(row, ORIGIN)
    ticks = follow_through(leg, limits, Pose2(x, y, theta))
    ahead, command, _ = ticks[-1]
    end = leg.poses[-1]
    assert (len(ticks) - 1) * PERIOD == pytest.approx(leg.duration, abs=PERIOD)
    assert command.v > 0.9 * LIMITS.v_max
    assert math.hypot(ahead.x - end.x, ahead.y - end.y) < 0.025
    assert abs(wrap_angle(ahead.theta - end.theta)) < 0.05


def test_the_virtual_target_waits_for_a_robot_that_is_held():
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    row = int(np.flatnonzero((TABLE.back == 0.6) & (TABLE.first == 0.0))[0])
    leg = TABLE.leg(row, ORIGIN)
    ticks = follow_through(leg, limits, ORIGIN, held=range(30, 90))
    behind = [abs(following.reference.pose.x) for _, _, following in ticks]
    assert max(behind) < defaults.TRACK_WAIT + 0.22 * PERIOD * 2
    assert len(ticks) * PERIOD > leg.duration + 1.5
    ahead, end = ticks[-1][0], leg.poses[-1]
    assert math.hypot(ahead.x - end.x, ahead.y - end.y) < 0.05
