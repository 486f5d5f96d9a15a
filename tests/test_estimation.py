import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf import defaults
from clfcbf.estimation import (
    DeadReckoning,
    advance,
    body_after,
    coast,
    grown,
    is_covariance,
    measured,
    motion_since,
    reckoned,
)
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist, arc
from tests.strategies import poses, twists

ORIGIN = Pose2(0.0, 0.0, 0.0)
REST = Twist(0.0, 0.0)
MODEL = defaults.NOISE
SMALL = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))


def observation(goal, stamp=0.0, covariance=SMALL):
    return Observation(goal, goal, stamp, covariance)


@given(twists, twists, st.floats(0.0, 1.0), st.floats(0.01, 0.5))
def test_the_lagged_body_solves_its_differential_equation(body, command, duration, lag):
    after, mean = body_after(body, command, duration, lag)
    steps = 4000
    h, b, total = duration / steps, np.array(body), np.zeros(2)
    for _ in range(steps):
        middle = b + 0.5 * h * (np.array(command) - b) / lag
        total += h * middle
        b = b + h * (np.array(command) - middle) / lag
    np.testing.assert_allclose(after, b, atol=1e-6)
    if duration > 0:
        np.testing.assert_allclose(np.array(mean) * duration, total, atol=1e-6)


@given(twists, twists, st.floats(0.001, 1.0))
def test_without_lag_the_body_is_the_command(body, command, duration):
    assert body_after(body, command, duration, 0.0) == (command, command)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.01, 0.3), st.floats(0.02, 0.5))
def test_coasting_makes_straight_motion_lag_free(v0, command, lag, duration):
    """x + tau b has the command as its derivative: exactly, on a straight line."""
    after, mean = body_after(Twist(v0, 0.0), Twist(command, 0.0), duration, lag)
    before_x = coast(Twist(v0, 0.0), lag).x
    after_x = mean.v * duration + coast(after, lag).x
    assert after_x - before_x == pytest.approx(command * duration, abs=1e-12)


@given(st.lists(st.tuples(twists, st.floats(0.01, 0.1)), min_size=1, max_size=20),
       st.floats(0.0, 1.0))  # fmt: skip
def test_reckoning_replays_the_commands(log, share):
    """Without lag the motion is the product of exact arcs, and any past instant can be asked."""
    reckoning, pose, now = DeadReckoning(0.0, ORIGIN, REST), ORIGIN, 0.0
    instants = [(0.0, ORIGIN)]
    for twist, duration in log:
        now += duration
        pose = pose.compose(arc(twist, now - instants[-1][0]))
        instants.append((now, pose))
        reckoning = advance(reckoning, twist, now, 0.0)
    np.testing.assert_allclose(reckoning.pose[:2], pose[:2], atol=1e-12)
    k = min(int(share * len(log)), len(log) - 1)
    start, at = instants[k]
    twist = log[k][0]
    stamp = start + 0.5 * (instants[k + 1][0] - start)
    np.testing.assert_allclose(
        reckoned(reckoning, stamp)[:2], at.moved(twist, stamp - start)[:2], atol=1e-12
    )
    moved = motion_since(reckoning, start)
    np.testing.assert_allclose(moved[:2], at.relative(pose)[:2], atol=1e-12)


def test_a_clock_that_stands_still_or_runs_back_changes_nothing():
    reckoning = advance(DeadReckoning(0.0, ORIGIN, REST), Twist(0.2, 0.1), 1.0, 0.1)
    for now in (1.0, 0.5, math.nan):
        assert advance(reckoning, Twist(0.2, 0.1), now, 0.1) == reckoning


def test_the_memory_is_bounded_and_asking_beyond_it_gives_the_oldest():
    reckoning = DeadReckoning(0.0, ORIGIN, REST)
    for k in range(1, 200):
        reckoning = advance(reckoning, Twist(0.1, 0.0), k / 30, 0.0, memory=1.0)
    instants = reckoning.instants
    assert len(instants) <= 31 + 16
    assert instants[0][0] <= reckoning.time - 1.0
    assert all(earlier[0] < later[0] for earlier, later in itertools.pairwise(instants))
    assert reckoned(reckoning, -5.0) == instants[0][1]
    assert reckoned(reckoning, 1e9) == reckoning.pose


@given(poses, st.lists(st.tuples(*[st.floats(-0.02, 0.02)] * 3), min_size=2, max_size=12))
def test_the_filter_is_the_mean_of_equal_measurements(goal, errors):
    """With equal noise and no motion the Kalman filter averages; compared with least squares."""
    estimate = None
    seen = []
    for e in errors:
        z = Pose2(goal.x + e[0], goal.y + e[1], goal.theta + e[2])
        seen.append(z)
        estimate, verdict = measured(estimate, observation(z), ORIGIN, MODEL)
        assert verdict.accepted
    mean = np.mean([np.array(z) - np.array(goal) for z in seen], axis=0) + np.array(goal)
    np.testing.assert_allclose(estimate.goal[:2], mean[:2], atol=1e-9)
    assert math.cos(estimate.goal.theta - mean[2]) == pytest.approx(1.0, abs=1e-12)
    assert estimate.covariance[0][0] == pytest.approx(1e-4 / len(errors), rel=1e-6)


@given(poses, poses)
def test_a_measurement_is_placed_where_it_was_taken(robot, goal):
    estimate, _ = measured(None, observation(robot.relative(goal)), robot, MODEL)
    np.testing.assert_allclose(estimate.goal[:2], goal[:2], atol=1e-9)
    assert math.cos(estimate.goal.theta - goal.theta) == pytest.approx(1.0, abs=1e-12)


def test_an_outlier_is_left_out_and_a_moved_target_is_found_again():
    estimate = None
    for _ in range(10):
        estimate, _ = measured(estimate, observation(Pose2(2.0, 0.1, 0.0)), ORIGIN, MODEL)
    before = estimate.goal
    estimate, verdict = measured(estimate, observation(Pose2(2.4, -0.3, 0.4)), ORIGIN, MODEL)
    assert not verdict.accepted
    assert verdict.distance > MODEL.gate
    assert estimate.goal == before
    estimate, verdict = measured(estimate, observation(Pose2(2.0, 0.1, 0.0)), ORIGIN, MODEL)
    assert verdict.accepted
    moved = Pose2(2.05, 0.15, 0.05)
    verdicts = []
    for _ in range(MODEL.rejections):
        estimate, verdict = measured(estimate, observation(moved), ORIGIN, MODEL)
        verdicts.append(verdict.accepted)
    assert verdicts == [False] * (MODEL.rejections - 1) + [True]
    assert estimate.goal == moved


def test_scattered_outliers_never_replace_the_estimate():
    rng = np.random.default_rng(3)
    estimate, _ = measured(None, observation(Pose2(2.0, 0.0, 0.0)), ORIGIN, MODEL)
    for _ in range(50):
        x, y, theta = rng.uniform(-1, 1, 3)
        outlier = Pose2(2.0 + x, y + math.copysign(0.2, y), theta)
        estimate, _ = measured(estimate, observation(outlier), ORIGIN, MODEL)
    assert math.hypot(estimate.goal.x - 2.0, estimate.goal.y) < 1e-9


@given(poses, poses, twists, st.floats(0.01, 0.5))
def test_uncertainty_grows_with_motion_and_stays_a_covariance(goal, robot, body, duration):
    estimate, _ = measured(None, observation(robot.relative(goal)), robot, MODEL)
    later = grown(estimate, body, duration, MODEL, robot)
    increase = np.array(later.covariance) - np.array(estimate.covariance)
    assert np.linalg.eigvalsh(increase).min() >= -1e-12
    assert np.allclose(increase, increase.T)


def test_uncertainty_of_a_turn_moves_a_far_goal_sideways():
    """Monte Carlo: the robot turns by a random small angle; a goal 2 m ahead swings."""
    estimate, _ = measured(None, observation(Pose2(2.0, 0.0, 0.0)), ORIGIN, MODEL)
    duration = 0.5
    later = grown(estimate, Twist(0.0, 0.4), duration, MODEL, ORIGIN)
    sigma = math.hypot(MODEL.turn * 0.4 * duration, MODEL.drift * duration)
    draws = np.random.default_rng(0).normal(0.0, sigma, 200_000)
    expected = np.var(2.0 * np.sin(draws))
    added = later.covariance[1][1] - estimate.covariance[1][1]
    assert added == pytest.approx(expected, rel=0.02)


def test_noise_is_turned_into_the_reckoning_frame():
    long = ((0.04, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6))
    facing_left = Pose2(0.0, 0.0, math.pi / 2)
    estimate, _ = measured(None, observation(Pose2(2.0, 0.0, 0.0), 0.0, long), facing_left, MODEL)
    assert estimate.covariance[1][1] == pytest.approx(0.04)
    assert estimate.covariance[0][0] == pytest.approx(1e-6)


entries = st.floats(-2.0, 2.0).map(lambda x: round(x, 3))
powers = st.integers(-6, 6).map(lambda k: 10.0**k)


@given(
    st.lists(entries, min_size=9, max_size=9), st.lists(powers, min_size=3, max_size=3),
    st.integers(1, 3), st.sampled_from([0.0, 1e-12, 1e-6, 1e-2, 0.5]),
)  # fmt: skip
def test_a_covariance_has_no_negative_eigenvalue(numbers, scales, rank, taken):
    """Also one of low rank; and what is taken off its diagonal is noticed, rounding left aside."""
    root = np.array(numbers).reshape(3, 3)[:, :rank] * np.array(scales)[:, None]
    matrix = root @ root.T
    assume(matrix.any())
    matrix -= taken * np.abs(matrix).max() * np.eye(3)
    largest = np.abs(matrix).max()
    least = float(np.linalg.eigvalsh(matrix / largest).min())
    assume(not -2e-9 < least < -5e-10)
    assert is_covariance(matrix.tolist()) == (least >= -1e-9)
    assert is_covariance(matrix) == (least >= -1e-9)


@pytest.mark.parametrize("place", [(0, 1), (0, 2), (1, 2)])
def test_a_covariance_is_symmetric(place):
    matrix = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.5], [0.5, -0.5, 2.0]])
    assert is_covariance(matrix)
    matrix[place] *= 1.0 + 1e-7
    assert is_covariance(matrix)
    matrix[place] *= 1.0 + 1e-5
    assert not is_covariance(matrix)


@pytest.mark.parametrize(
    "values",
    [None, "abc", ((1, 2), (3, 4)), [[1.0, 0.0, 0.0]] * 2, np.zeros((3, 3)),
     np.full((3, 3), math.nan), np.diag([1.0, math.inf, 1.0]), [[1, 0, 0], [0, 1, 0], [0, 0, "x"]],
     np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0])],
)  # fmt: skip
def test_what_is_no_covariance(values):
    assert not is_covariance(values)
