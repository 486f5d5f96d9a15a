"""The time scaling against dense finite differences, closed forms and a linear program."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import coo_array

from clfcbf.errors import ConfigurationError, GeometryError, PlanningError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, arc
from clfcbf.trajectories.path import SampledPath
from clfcbf.trajectories.timing import time_path

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)


@st.composite
def paths(draw, samples=81):
    """A path of 0.2 to 4 m with a smooth curvature of up to some 6 1/m."""
    length = draw(st.floats(0.2, 4.0))
    waves = draw(
        st.lists(
            st.tuples(st.floats(-2.0, 2.0), st.floats(0.0, 2.0), st.floats(0.0, 6.3)),
            min_size=0,
            max_size=3,
        )
    )
    s = np.linspace(0.0, length, samples)
    k = sum((a * np.sin(2.0 * math.pi * f * s / length + p) for a, f, p in waves), 0.0 * s)
    return SampledPath.from_curvature(s, k, draw(st.sampled_from([1, -1])))


limits = st.builds(
    Limits,
    st.floats(0.1, 1.0),
    st.floats(0.1, 1.5),
    st.floats(0.05, 1.0),
    st.floats(0.1, 3.0),
    v_min=st.floats(-0.5, -0.05),
)


@settings(max_examples=50, deadline=None)
@given(paths(), limits, st.floats(0.0, 0.3))
def test_limits_hold_between_samples(path, limits, v0):
    try:
        timed = time_path(path, limits, path.gear * v0)
    except PlanningError:
        timed = time_path(path, limits)
    t = np.linspace(0.0, timed.duration, 1203)
    v, omega = np.array([timed.twist(x) for x in t]).T
    dt = t[1] - t[0]
    top = limits.v_max if path.gear > 0 else -limits.v_min
    assert np.max(np.abs(v)) <= top + 1e-9
    assert np.max(np.abs(omega)) <= limits.omega_max + 1e-9
    assert np.max(np.abs(np.diff(v))) <= limits.a_max * dt + 1e-9
    assert np.max(np.abs(np.diff(omega))) <= limits.alpha_max * dt + 1e-9
    assert np.all(path.gear * v >= 0.0)
    assert timed.v[-1] == 0.0
    assert max(timed.utilisation(limits)) <= 1.0 + 1e-9


@settings(max_examples=40, deadline=None)
@given(paths(), limits)
def test_something_binds_to_a_percent_and_peaks_are_those_of_dense_sampling(path, limits):
    timed = time_path(path, limits)
    # The forward pass is greedy: where the turn changes sign it may leave a little unused.
    assert 0.99 < max(timed.utilisation(limits)) <= 1.0 + 1e-9
    t = np.linspace(0.0, timed.duration, 3001)
    v, omega = np.array([timed.twist(x) for x in t]).T
    peaks = timed.peaks()
    assert peaks.speed == pytest.approx(np.max(np.abs(v)), rel=1e-2)
    assert peaks.turn_rate == pytest.approx(np.max(np.abs(omega)), rel=1e-2, abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(paths(samples=201), limits)
def test_profile_is_the_optimum_of_the_linear_program(path, limits):
    """Maximise the sum of z over the whole path at once; the two passes must near it."""
    s, k = path.s, path.curvature
    n, h, jump = len(s), np.diff(s), np.diff(k)
    top = limits.v_max if path.gear > 0 else -limits.v_min
    i = np.arange(n - 1)
    rows = []
    for left, right, bound in (
        (jump - k[:-1] / 2, k[:-1] / 2, limits.alpha_max * h),
        (-k[1:] / 2, jump + k[1:] / 2, limits.alpha_max * h),
        (-np.ones(n - 1), np.ones(n - 1), 2 * limits.a_max * h),
    ):
        for sign in (1.0, -1.0):
            rows.append((sign * left, sign * right, bound))
    data = np.concatenate([np.concatenate((a, b)) for a, b, _ in rows])
    row = np.concatenate([np.concatenate((i, i)) + j * (n - 1) for j in range(len(rows))])
    column = np.concatenate([np.concatenate((i, i + 1)) for _ in rows])
    A = coo_array((data, (row, column)), shape=(len(rows) * (n - 1), n)).tocsr()
    sharpest = np.maximum(np.abs(k[:-1]), np.abs(k[1:]))
    ceiling = np.full(n, top**2)
    with np.errstate(divide="ignore", over="ignore"):
        segment = (limits.omega_max / sharpest) ** 2
    ceiling[:-1] = np.minimum(ceiling[:-1], segment)
    ceiling[1:] = np.minimum(ceiling[1:], segment)
    ceiling[[0, -1]] = 0.0
    b = np.concatenate([bound for _, _, bound in rows])
    best = linprog(-np.ones(n), A, b, bounds=np.column_stack((np.zeros(n), ceiling)))
    assert best.status == 0
    timed = time_path(path, limits)
    assert np.max(A @ timed.v**2 - b) <= 1e-9
    v = np.sqrt(np.maximum(best.x, 0.0))
    assert timed.duration <= 1.01 * np.sum(2.0 * h / (v[:-1] + v[1:]))


@settings(deadline=None)
@given(st.floats(0.05, 5.0), st.floats(0.0, 0.2))
def test_straight_line_is_the_trapezoid(length, v0):
    """Without curvature the optimum is known: accelerate, cruise, brake."""
    s = np.linspace(0.0, length, 2001)
    path = SampledPath.from_curvature(s, 0.0 * s)
    a, top = LIMITS.a_max, LIMITS.v_max
    if v0 * v0 / (2.0 * a) > length:
        with pytest.raises(PlanningError, match="binding: acceleration"):
            time_path(path, LIMITS, v0)
        return
    peak = min(top, math.sqrt(a * length + 0.5 * v0 * v0))
    cruise = length - (2.0 * peak**2 - v0**2) / (2.0 * a)
    expected = (2.0 * peak - v0) / a + cruise / peak
    assert time_path(path, LIMITS, v0).duration == pytest.approx(expected, rel=2e-3)


def test_circle_moves_on_its_arc():
    """On a constant curvature the exact arc of the mean twist is the path."""
    s = np.linspace(0.0, 1.0, 41)
    for gear in (1, -1):
        path = SampledPath.from_curvature(s, 0.0 * s + 2.0, gear)
        timed = time_path(path, LIMITS)
        for t in np.linspace(0.0, timed.duration, 9):
            travelled = timed.arc_length(t)
            expected = arc(Twist(gear * 1.0, 2.0), travelled)
            assert timed.at(t)[0] == pytest.approx(expected, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(paths(), st.floats(0.05, 0.95))
def test_pose_moves_with_the_twist(path, share):
    timed = time_path(path, LIMITS)
    t, h = share * timed.duration, 1e-6
    pose, twist = timed.at(t)
    moved = timed.at(t - h)[0].relative(timed.at(t + h)[0])
    assert moved.x / (2 * h) == pytest.approx(twist.v, abs=1e-5)
    assert moved.y / (2 * h) == pytest.approx(0.0, abs=1e-5)
    assert moved.theta / (2 * h) == pytest.approx(twist.omega, abs=1e-5)
    assert pose == path.pose(timed.arc_length(t))


@settings(max_examples=20, deadline=None)
@given(paths())
def test_path_poses_against_runge_kutta(path):
    s = np.linspace(0.0, path.length, 2001)
    x = y = theta = 0.0

    def slope(theta):
        return path.gear * math.cos(theta), path.gear * math.sin(theta)

    for a, b in pairwise(s):
        h = b - a
        k0, km, k1 = (path.curvature_at(q) for q in (a, 0.5 * (a + b), b))
        middle = theta + 0.25 * h * (k0 + km)
        last = theta + h * (k0 + 4.0 * km + k1) / 6.0
        (x0, y0), (xm, ym), (x1, y1) = slope(theta), slope(middle), slope(last)
        x, y = x + h * (x0 + 4 * xm + x1) / 6.0, y + h * (y0 + 4 * ym + y1) / 6.0
        theta = last
    end = path.pose(path.length)
    assert (end.x, end.y) == pytest.approx((x, y), abs=1e-6)
    assert math.remainder(end.theta - theta, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("start", [Pose2(0.0, 0.0, 0.0), Pose2(1.0, -2.0, 2.5)])
def test_path_follows_its_start(start):
    s = np.linspace(0.0, 1.0, 21)
    base = SampledPath.from_curvature(s, np.sin(s))
    moved = SampledPath.from_curvature(s, np.sin(s), start=start)
    for q in (0.0, 0.33, 1.0):
        assert moved.pose(q) == pytest.approx(start.compose(base.pose(q)), abs=1e-12)


def test_jump_of_the_curvature_is_a_stop():
    s = np.concatenate((np.linspace(0.0, 1.0, 51), np.linspace(1.0, 2.0, 51)))
    k = np.concatenate((np.full(51, 1.0), np.full(51, -1.0)))
    timed = time_path(SampledPath.from_curvature(s, k), LIMITS)
    assert timed.v[50] == timed.v[51] == 0.0
    assert np.all(timed.v[1:50] > 0.0)
    assert np.all(timed.v[52:-1] > 0.0)
    assert max(timed.utilisation(LIMITS)) <= 1.0 + 1e-9
    t = np.linspace(0.0, timed.duration, 4001)
    omega = np.array([timed.twist(x).omega for x in t])
    assert np.max(np.abs(np.diff(omega))) <= LIMITS.alpha_max * (t[1] - t[0]) + 1e-10


def test_repeated_sample_without_a_jump_is_no_stop():
    s = np.linspace(0.0, 1.0, 51)
    k = np.sin(s)
    plain = time_path(SampledPath.from_curvature(s, k), LIMITS)
    twice = np.insert(s, 20, s[20]), np.insert(k, 20, k[20])
    assert time_path(SampledPath.from_curvature(*twice), LIMITS).duration == plain.duration


@pytest.mark.parametrize(
    ("name", "length", "kappa", "v0"),
    [
        ("speed", 2.0, 0.0, 0.25),
        ("turn_rate", 2.0, 2.5, 0.18),
        ("acceleration", 0.05, 0.0, 0.2),
        ("joint", 0.05, 0.0, 0.4),
    ],
)
def test_impossible_initial_speed_names_the_limit(name, length, kappa, v0):
    s = np.linspace(0.0, length, 101)
    with pytest.raises(PlanningError, match=name) as caught:
        time_path(SampledPath.from_curvature(s, 0.0 * s + kappa), LIMITS, v0)
    assert caught.value.reasons == {name: 1}


def test_impossible_initial_speed_by_angular_acceleration():
    """A curvature that rises fast asks for an angular acceleration at any speed but a low one."""
    s = np.linspace(0.0, 1.0, 101)
    k = 3.0 * np.minimum(s / 0.1, 1.0)
    roomy = Limits(0.22, 10.0, 10.0, 0.5)
    with pytest.raises(PlanningError) as caught:
        time_path(SampledPath.from_curvature(s, k), roomy, 0.22)
    assert caught.value.reasons == {"angular_acceleration": 1}


@given(paths(), st.floats(0.0, 0.3))
@settings(max_examples=25, deadline=None)
def test_refusal_states_the_largest_possible_speed(path, v0):
    try:
        timed = time_path(path, LIMITS, path.gear * v0)
    except PlanningError as error:
        possible = float(str(error).split("at most ")[1].split(" ")[0])
        assert possible < v0 + 5e-4
        time_path(path, LIMITS, path.gear * max(0.0, possible - 5e-4))
    else:
        assert abs(timed.v[0]) == pytest.approx(v0, abs=1e-9)


def test_bad_inputs():
    s = np.linspace(0.0, 1.0, 11)
    path = SampledPath.from_curvature(s, 0.0 * s)
    with pytest.raises(PlanningError, match="gear"):
        time_path(path, LIMITS, -0.1)
    with pytest.raises(GeometryError, match="finite"):
        time_path(path, LIMITS, math.nan)
    with pytest.raises(PlanningError, match="reverse"):
        time_path(SampledPath.from_curvature(s, 0.0 * s, -1), Limits(0.2, 0.4, 0.3, 1.0, v_min=0.0))
    for bad_s in (s[::-1], s + 1.0, 0.0 * s, s * math.nan):
        with pytest.raises(GeometryError):
            SampledPath.from_curvature(bad_s, 0.0 * s)
    with pytest.raises(GeometryError, match="shape"):
        SampledPath.from_curvature(s, s[1:])
    with pytest.raises(ConfigurationError, match="gear"):
        SampledPath.from_curvature(s, s, gear=2)
