"""The drive's closed forms and the kinematic plant against numerical integration."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.drive import follow
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body, Plant, sub_steps

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
START = Pose2(-2.0, 0.3, 0.1)
REST = Twist(0.0, 0.0)
TICK = 1.0 / 30.0

speeds = st.floats(-1.0, 1.0)
slopes = st.floats(0.05, 5.0)
lags = st.floats(0.01, 0.5)
commands = st.builds(Twist, st.floats(-0.22, 0.22), st.floats(-0.4, 0.4))


def plant(body=None, *, seed=0, start=START, initial=REST):
    return KinematicPlant(start, LIMITS, body or Body(), np.random.default_rng(seed), initial)


def saturated(error, lag, slope):
    return max(-slope, min(slope, error / lag))


@settings(max_examples=40, deadline=None)
@given(speeds, speeds, slopes, lags, st.floats(0.001, 2.0))
def test_follow_is_the_solution_of_the_saturated_lag(value, target, slope, lag, duration):
    assume(value == target or abs(value - target) > 1e-9)  # the reference divides by its square
    result = solve_ivp(
        lambda _, state: (saturated(target - state[0], lag, slope), state[0]),
        (0.0, duration),
        (value, 0.0),
        method="DOP853",
        rtol=1e-10,
        atol=1e-12,
        max_step=duration / 20,
    )
    end, mean = follow(value, target, slope, lag, duration)
    assert end == pytest.approx(result.y[0, -1], abs=1e-7)
    assert mean * duration == pytest.approx(result.y[1, -1], abs=1e-7)


@given(speeds, speeds, slopes, st.one_of(st.just(0.0), lags), *2 * [st.floats(0.001, 1.0)])
def test_follow_in_two_parts_is_follow_in_one(value, target, slope, lag, first, second):
    middle, mean_first = follow(value, target, slope, lag, first)
    end, mean_second = follow(middle, target, slope, lag, second)
    whole, mean = follow(value, target, slope, lag, first + second)
    assert end == pytest.approx(whole, abs=1e-12)
    area = mean_first * first + mean_second * second
    assert area == pytest.approx(mean * (first + second), abs=1e-12)


@given(speeds, speeds, slopes, lags, st.floats(0.001, 1.0))
def test_follow_keeps_the_slope_and_does_not_overshoot(value, target, slope, lag, duration):
    end, mean = follow(value, target, slope, lag, duration)
    low, high = min(value, target), max(value, target)
    assert abs(end - value) <= slope * duration + 1e-12
    assert low - 1e-12 <= end <= high + 1e-12
    assert min(value, end) - 1e-12 <= mean <= max(value, end) + 1e-12


def integrate(start, ticks, body, errors):
    """The lagged unicycle by an adaptive Runge-Kutta method, tick by tick."""
    state = np.array([*start, 0.0, 0.0])
    for v, omega in ticks:
        moving = (v, omega) != (0.0, 0.0)
        target_v = errors.scale_v * v
        target_w = errors.scale_omega * omega + errors.gyro_bias * moving

        def rate(_, s, target_v=target_v, target_w=target_w):
            return (
                s[3] * math.cos(s[2]),
                s[3] * math.sin(s[2]),
                s[4],
                saturated(target_v - s[3], body.lag, LIMITS.a_max),
                saturated(target_w - s[4], body.lag, LIMITS.alpha_max),
            )

        state = solve_ivp(
            rate, (0.0, TICK), state, method="DOP853", rtol=1e-10, atol=1e-12, max_step=TICK / 4
        ).y[:, -1]
    return state


@settings(max_examples=25, deadline=None)
@given(st.lists(commands, min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_plant_matches_runge_kutta(sent, seed):
    body = Body(slip=0.05, gyro_bias=0.02)
    robot = plant(body, seed=seed)
    ticks = [command for command in sent for _ in range(5)]
    for command in ticks:
        robot.send(command)
        robot.advance(TICK)
    errors = body.draw(np.random.default_rng(seed))
    x, y, theta, v, omega = integrate(START, ticks, body, errors)
    assert robot.pose().theta == pytest.approx(theta, abs=1e-7)
    assert tuple(robot.twist()) == pytest.approx((v, omega), abs=1e-7)
    assert robot.pose()[:2] == pytest.approx((x, y), abs=1e-6)


def test_position_error_is_second_order_in_the_sub_step():
    ticks = [Twist(0.22, 0.4)] * 20 + [Twist(-0.2, -0.3)] * 20
    ends = []
    for rate in (240.0, 480.0, 1920.0):
        robot = plant(Body(slip=0.0, gyro_bias=0.0, rate=rate))
        for command in ticks:
            robot.send(command)
            robot.advance(TICK)
        ends.append(np.array(robot.pose()[:2]))
    coarse, fine = (np.linalg.norm(end - ends[2]) for end in ends[:2])
    assert 1e-12 < coarse < 1e-6
    assert coarse / fine == pytest.approx((64 - 1) / (16 - 1), rel=0.05)


@given(commands)
def test_ideal_plant_is_the_arc_of_its_command(command):
    robot = plant(Body.ideal())
    robot.send(command)
    poses = robot.advance(TICK)
    pose = START
    for reached in poses:
        pose = pose.moved(command, TICK / len(poses))
        assert reached == pose
    assert tuple(pose) == pytest.approx(tuple(START.moved(command, TICK)), abs=1e-14)
    assert robot.twist() == command


@pytest.mark.parametrize("tiny", [Twist(1e-9, 0.0), Twist(0.0, 1e-9), Twist(-1e-9, 1e-9)])
def test_no_dead_band(tiny):
    robot = plant(Body.ideal(), start=Pose2(0.0, 0.0, 0.0))
    robot.send(tiny)
    robot.advance(1.0)
    assert tuple(robot.pose()) == pytest.approx((tiny.v, 0.0, tiny.omega), rel=1e-9, abs=1e-17)


def test_errors_have_the_declared_spread():
    body = Body(slip=0.01, gyro_bias=0.002)
    rng = np.random.default_rng(7)
    draws = np.array([body.draw(rng) for _ in range(4000)])
    assert draws.mean(axis=0) == pytest.approx((1.0, 1.0, 0.0), abs=5e-4)
    assert draws.std(axis=0) == pytest.approx((0.01, 0.01, 0.002), rel=0.05)
    assert np.abs(np.corrcoef(draws.T) - np.eye(3)).max() < 0.06


def test_settled_body_moves_at_the_scaled_and_biased_command():
    body = Body(slip=0.05, gyro_bias=0.01)
    errors = body.draw(np.random.default_rng(3))
    robot = plant(body, seed=3)
    robot.send(Twist(0.2, 0.3))
    robot.advance(5.0)
    expected = (0.2 * errors.scale_v, 0.3 * errors.scale_omega + errors.gyro_bias)
    assert tuple(robot.twist()) == pytest.approx(expected, abs=1e-12)


def test_biased_gyro_does_not_turn_a_robot_at_rest():
    robot = plant(Body(gyro_bias=0.1), seed=1)
    poses = robot.advance(10.0)
    assert set(poses) == {START}
    robot.send(Twist(0.1, 0.0))
    robot.advance(2.0)
    assert abs(robot.twist().omega) > 1e-3
    robot.stop()
    robot.advance(3.0)
    settled = robot.pose()
    robot.advance(2.0)
    assert tuple(robot.pose()) == pytest.approx(tuple(settled), abs=1e-9)


@given(st.lists(st.builds(Twist, st.floats(-3, 3), st.floats(-5, 5)), min_size=1, max_size=4))
def test_body_acceleration_is_bounded_whatever_is_commanded(sent):
    robot = plant(Body(slip=0.1, gyro_bias=0.05))
    step = TICK / 8
    for command in sent:
        robot.send(command)
        for _ in range(8):
            before = robot.twist()
            robot.advance(step)
            after = robot.twist()
            assert abs(after.v - before.v) <= LIMITS.a_max * step * (1 + 1e-9)
            assert abs(after.omega - before.omega) <= LIMITS.alpha_max * step * (1 + 1e-9)


@given(st.lists(commands, min_size=1, max_size=10))
def test_mirror_symmetry(sent):
    left, right = (
        plant(Body(gyro_bias=0.0), seed=5, start=Pose2(0.0, sign * 0.3, sign * 0.1))
        for sign in (1.0, -1.0)
    )
    for v, omega in sent:
        left.send(Twist(v, omega))
        right.send(Twist(v, -omega))
        left.advance(TICK)
        right.advance(TICK)
    x, y, theta = right.pose()
    assert tuple(left.pose()) == pytest.approx((x, -y, -theta), abs=1e-14)


def test_a_seed_decides_the_run():
    def run(seed):
        robot = plant(seed=seed)
        robot.send(Twist(0.2, 0.2))
        return robot.advance(1.0)

    assert run(4) == run(4)
    assert run(4) != run(5)


def test_hand_over_starts_at_the_speed_of_the_initial_command():
    robot = plant(Body(slip=0.0, gyro_bias=0.0), initial=Twist(0.55, 0.1))
    assert robot.applied() == Twist(0.55, 0.1)
    assert robot.twist() == Twist(0.55, 0.1)
    assert robot.advance(TICK)[-1].x > START.x + 0.018


def test_chassis_and_clock():
    robot = plant()
    assert isinstance(robot, Plant)
    assert robot.time == 0.0
    assert len(robot.advance(TICK)) == 8
    assert robot.time == TICK
    robot.send(Twist(0.1, 0.2))
    assert robot.applied() == Twist(0.1, 0.2)
    robot.stop()
    robot.stop()
    assert robot.applied() == Twist(0.0, 0.0)
    assert robot.advance(TICK)[-1] == robot.pose()
    robot.close()
    robot.close()


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3))
def test_moving_the_target_leaves_the_robot_where_it_is(x, y, theta):
    shift = Pose2(x, y, theta)
    robot = plant()
    robot.move_target(shift)
    assert tuple(shift.compose(robot.pose())) == pytest.approx(tuple(START), abs=1e-12)


@given(st.floats(1e-4, 2.0), st.floats(1.0, 1000.0))
def test_sub_steps_fill_the_duration_at_the_rate(duration, rate):
    count, step = sub_steps(duration, rate)
    assert count * step == pytest.approx(duration, rel=1e-12)
    assert step * rate <= 1.0 + 1e-6
    assert count == 1 or duration / (count - 1) * rate > 1.0 - 1e-6


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf])
def test_bad_duration_is_refused(duration):
    with pytest.raises(ConfigurationError, match="duration"):
        plant().advance(duration)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(bad):
    robot = plant()
    for twist in (Twist(bad, 0.0), Twist(0.0, bad)):
        with pytest.raises(GeometryError, match="command"):
            robot.send(twist)
    assert robot.applied() == Twist(0.0, 0.0)
    with pytest.raises(GeometryError, match="start"):
        plant(start=Pose2(bad, 0.0, 0.0))


@pytest.mark.parametrize(
    "values", [{"lag": -0.1}, {"slip": math.nan}, {"gyro_bias": -1.0}, {"rate": 0.0}]
)
def test_bad_body_is_refused(values):
    with pytest.raises(ConfigurationError, match=next(iter(values))):
        Body(**values)
