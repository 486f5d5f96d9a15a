"""The quintic against SciPy's Hermite interpolation, finite differences and its known limits."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.trajectories.quintic import BoundaryState, Quintic, minimum_duration

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)

value = st.floats(-2.0, 2.0)
pair = st.tuples(value, value)
states = st.builds(BoundaryState, pair, pair, pair)
durations = st.floats(0.5, 20.0)
headings = st.floats(-3.0, 3.0)


def make(*args, **kwargs):
    """A quintic, or skip the rare draw that has a cusp or does not move."""
    try:
        return Quintic(*args, **kwargs)
    except GeometryError:
        assume(False)


def hermite(start, end, T):
    """The same polynomial by SciPy: a piecewise Bernstein polynomial per axis."""
    return [
        BPoly.from_derivatives(
            [0.0, T],
            [
                [start.position[k], start.velocity[k], start.acceleration[k]],
                [end.position[k], end.velocity[k], end.acceleration[k]],
            ],
        )
        for k in (0, 1)
    ]


@settings(deadline=None)
@given(states, states, durations, st.floats(0.0, 1.0), st.sampled_from([1, -1]))
def test_position_and_twist_agree_with_hermite_interpolation(start, end, T, u, gear):
    trajectory = make(start, end, T, gear)
    x, y = hermite(trajectory.start, trajectory.end, T)
    t = u * T
    pose, twist = trajectory.at(t)
    scale = 1.0 + T * T
    assert (pose.x, pose.y) == pytest.approx((float(x(t)), float(y(t))), abs=1e-12 * scale)
    vx, vy, ax, ay = (float(p.derivative(k)(t)) for k in (1, 2) for p in (x, y))
    assert twist.v == pytest.approx(gear * math.hypot(vx, vy), abs=1e-10 * scale)
    assume(math.hypot(vx, vy) > 1e-2)
    assert twist.omega == pytest.approx(
        (vx * ay - vy * ax) / (vx * vx + vy * vy), rel=1e-6, abs=1e-7 * scale
    )
    assert wrap_angle(pose.theta - math.atan2(gear * vy, gear * vx)) == pytest.approx(
        0.0, abs=1e-8 * scale
    )


@settings(deadline=None)
@given(states, states, durations)
def test_coefficients_are_those_of_the_power_basis(start, end, T):
    trajectory = make(start, end, T)
    t = np.linspace(0.0, T, 7)
    for row, reference in zip(
        trajectory.coefficients, hermite(trajectory.start, trajectory.end, T), strict=True
    ):
        values = np.polynomial.polynomial.polyval(t, row)
        assert values == pytest.approx(reference(t), abs=1e-10 * (1.0 + T * T))


@settings(deadline=None)
@given(
    headings,
    st.floats(0.05, 1.0),
    pair,
    st.sampled_from([1, -1]),
    st.sampled_from(["start", "end"]),
)
def test_turn_rate_at_rest_is_half_a_cross_j(heading, size, other, gear, which):
    """At zero speed the heading is that of the acceleration and omega = (a x j) / (2 |a|^2)."""
    a = (size * math.cos(heading), size * math.sin(heading))
    rest = BoundaryState((0.0, 0.0), (0.0, 0.0), a)
    moving = BoundaryState((1.5, 0.7), other, (0.3, -0.2))
    start, end = (rest, moving) if which == "start" else (moving, rest)
    trajectory = make(start, end, 3.0, gear)
    t = 0.0 if which == "start" else 3.0
    x, y = hermite(trajectory.start, trajectory.end, 3.0)
    jx, jy = float(x.derivative(3)(t)), float(y.derivative(3)(t))
    twist = trajectory.twist(t)
    assert twist.v == 0.0
    assert twist.omega == pytest.approx(
        (a[0] * jy - a[1] * jx) / (2.0 * size**2), rel=1e-9, abs=1e-9
    )
    sign = gear if which == "start" else -gear
    assert wrap_angle(
        trajectory.pose(t).theta - math.atan2(sign * a[1], sign * a[0])
    ) == pytest.approx(0.0, abs=1e-12)


@settings(deadline=None)
@given(pair, pair, st.sampled_from(["start", "end"]))
def test_turn_rate_at_rest_without_acceleration_is_a_third_of_j_cross_s(velocity, a, which):
    """At zero speed and acceleration, omega = (j x s) / (3 |j|^2), along the jerk."""
    rest = BoundaryState((0.0, 0.0))
    moving = BoundaryState((1.5, 0.7), velocity, a)
    start, end = (rest, moving) if which == "start" else (moving, rest)
    trajectory = make(start, end, 3.0)
    t = 0.0 if which == "start" else 3.0
    x, y = hermite(trajectory.start, trajectory.end, 3.0)
    jx, jy, sx, sy = (float(p.derivative(k)(t)) for k in (3, 4) for p in (x, y))
    size = math.hypot(jx, jy)
    assume(size > 1e-2)
    assert trajectory.twist(t).omega == pytest.approx(
        (jx * sy - jy * sx) / (3.0 * size**2), rel=1e-7, abs=1e-7
    )
    assert wrap_angle(trajectory.pose(t).theta - math.atan2(jy, jx)) == pytest.approx(0, abs=1e-9)


@settings(deadline=None)
@given(pair, pair, st.sampled_from([1, -1]), st.sampled_from([0, 1, 2]))
def test_heading_and_turn_rate_are_smooth_into_rest(velocity, acceleration, gear, order):
    """Near a rest the twist is no 0/0: it approaches its limit in proportion to the time."""
    a = ((0.0, 0.0), (0.2, 0.1))[order == 1]
    start = BoundaryState((0.0, 0.0), (0.0, 0.0) if order else (0.2, 0.1), a)
    trajectory = make(start, BoundaryState((1.0, 0.4), velocity, acceleration), 4.0, gear)
    limit = trajectory.at(0.0)
    omega = [trajectory.twist(t).omega for t in (1e-12, 1e-9, 1e-6)]
    slope = (trajectory.twist(1e-3).omega - limit[1].omega) / 1e-3
    for t, value in zip((1e-12, 1e-9, 1e-6), omega, strict=True):
        assert value == pytest.approx(limit[1].omega, abs=2.0 * (abs(slope) + 1.0) * t + 1e-12)
    ahead = trajectory.pose(1e-6).theta - limit[0].theta
    assert wrap_angle(ahead) == pytest.approx(1e-6 * limit[1].omega, abs=1e-9 * (1 + abs(slope)))


@settings(deadline=None)
@given(states, states, durations, st.floats(0.05, 0.95), st.sampled_from([1, -1]))
def test_pose_moves_with_the_twist(start, end, T, u, gear):
    """Finite differences of the pose give (v cos, v sin, omega)."""
    trajectory = make(start, end, T, gear)
    t, h = u * T, 1e-5 * T
    pose, twist = trajectory.at(t)
    assume(abs(twist.omega) * h < 1e-3 and abs(twist.v) > 1e-2)
    before, after = trajectory.pose(t - h), trajectory.pose(t + h)
    scale = 1.0 + abs(twist.v) + abs(twist.omega) ** 3 * h
    assert (after.x - before.x) / (2 * h) == pytest.approx(
        twist.v * math.cos(pose.theta), abs=1e-4 * scale
    )
    assert (after.y - before.y) / (2 * h) == pytest.approx(
        twist.v * math.sin(pose.theta), abs=1e-4 * scale
    )
    assert wrap_angle(after.theta - before.theta) / (2 * h) == pytest.approx(
        twist.omega, rel=1e-2, abs=1e-3
    )


@settings(deadline=None)
@given(headings, headings, st.floats(0.05, 0.5), st.floats(0.05, 0.5), st.sampled_from([1, -1]))
def test_poses_and_speeds_are_met(theta0, theta1, v0, v1, gear):
    start, end = Pose2(0.0, 0.0, theta0), Pose2(1.0, 0.5, theta1)
    twists = Twist(gear * v0, 0.2), Twist(gear * v1, -0.3)
    try:
        trajectory = Quintic.between(
            start, end, 6.0, start_twist=twists[0], end_twist=twists[1], gear=gear
        )
    except GeometryError as error:
        assume("flips" not in str(error))
        raise
    for t, pose, twist in ((0.0, start, twists[0]), (6.0, end, twists[1])):
        assert trajectory.pose(t) == pytest.approx(pose, abs=1e-12)
        assert trajectory.twist(t) == pytest.approx(twist, abs=1e-10)


@pytest.mark.parametrize("gear", [1, -1])
def test_rest_to_rest_with_accelerations_along_the_headings(gear):
    start, end = Pose2(0.0, 0.0, 0.4), Pose2(gear * 2.0, 0.5, -0.2)
    trajectory = Quintic.between(
        start, end, 12.0, start_acceleration=gear * 0.1, end_acceleration=-gear * 0.1, gear=gear
    )
    assert trajectory.pose(0.0) == pytest.approx(start, abs=1e-12)
    assert trajectory.pose(12.0) == pytest.approx(end, abs=1e-12)
    assert all(gear * trajectory.twist(t).v > 0.0 for t in np.linspace(0.1, 11.9, 50))


def test_straight_line_that_contradicts_the_headings_says_by_how_much():
    start, end = Pose2(0.0, 0.0, math.radians(-20.0)), Pose2(2.5, -1.0, 0.0)
    with pytest.raises(GeometryError, match=r"start is off by -1\.80 degrees"):
        Quintic.between(start, end, 10.0)
    with pytest.raises(GeometryError, match=r"end is off by -21\.80 degrees"):
        Quintic.between(start._replace(theta=math.atan2(-1.0, 2.5)), end, 10.0)


def test_wrong_sign_of_the_acceleration_is_half_a_turn_off():
    start, end = Pose2(0.0, 0.0, 0.3), Pose2(2.0, 0.5, 0.0)
    with pytest.raises(GeometryError, match=r"start is off by [+-]180\.00 degrees"):
        Quintic.between(start, end, 8.0, start_acceleration=-0.01, end_acceleration=-0.1)


def test_rest_to_rest_is_the_known_straight_line():
    trajectory = Quintic(BoundaryState((1.0, 2.0)), BoundaryState((4.0, 6.0)), 5.0)
    for u in np.linspace(0.0, 1.0, 11):
        share = 10 * u**3 - 15 * u**4 + 6 * u**5
        pose = trajectory.pose(5.0 * u)
        assert pose == pytest.approx((1 + 3 * share, 2 + 4 * share, math.atan2(4, 3)), abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1e-150, 1e-12, 1e-7])
def test_an_immeasurable_speed_does_not_decide_the_heading(speed):
    """Sideways at next to nothing, the robot still leaves along its acceleration."""
    start = BoundaryState((0.0, 0.0), (0.0, speed), (0.1, 0.0))
    trajectory = Quintic(start, BoundaryState((1.0, 0.2), (0.1, 0.0)), 5.0)
    at_rest = Quintic(BoundaryState((0.0, 0.0), (0.0, 0.0), (0.1, 0.0)), trajectory.end, 5.0)
    assert trajectory.pose(0.0).theta == pytest.approx(0.0, abs=1e-12)
    assert trajectory.twist(0.0).v == 0.0
    assert trajectory == at_rest


@settings(deadline=None)
@given(states, states, durations)
def test_boundary_values_are_met_to_the_tolerance_of_rest(start, end, T):
    trajectory = make(start, end, T)
    size = max(math.dist(start.position, end.position), 3.0 * T, 3.0 * T * T)
    for given_state, state in ((start, trajectory.start), (end, trajectory.end)):
        assert state.position == given_state.position
        assert math.dist(state.velocity, given_state.velocity) * T <= 1e-5 * size
        assert math.dist(state.acceleration, given_state.acceleration) * T * T <= 1e-5 * size


def test_rests_outside_its_duration():
    start, end = Pose2(0.0, 0.0, 0.0), Pose2(1.0, 0.2, 0.3)
    trajectory = Quintic.between(
        start, end, 5.0, start_twist=Twist(0.2, 0.0), end_twist=Twist(0.1, 0.0)
    )
    for t, pose in ((5.0 + 1e-9, end), (1e9, end), (-1e-9, start)):
        assert trajectory.pose(t) == pytest.approx(pose, abs=1e-12)
        assert trajectory.twist(t) == Twist(0.0, 0.0)
    assert trajectory.twist(5.0).v == pytest.approx(0.1)


def test_cusp_is_refused():
    """Straight ahead at speed to a point behind: the speed passes through zero."""
    with pytest.raises(GeometryError, match="flips"):
        Quintic(BoundaryState((0.0, 0.0), (0.5, 0.0)), BoundaryState((-1.0, 0.0), (-0.5, 0.0)), 6.0)


def test_motion_without_a_cusp_but_a_slow_middle_is_accepted():
    trajectory = Quintic(
        BoundaryState((0.0, 0.0), (0.5, 0.0)), BoundaryState((-1.0, 0.05), (-0.5, 0.0)), 6.0
    )
    assert all(trajectory.twist(t).v > 0.0 for t in np.linspace(0.0, 6.0, 400))


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf])
def test_duration_must_be_positive(duration):
    with pytest.raises(GeometryError, match="duration"):
        Quintic(BoundaryState((0.0, 0.0)), BoundaryState((1.0, 0.0)), duration)


def test_degenerate_inputs():
    with pytest.raises(GeometryError, match="all derivatives"):
        Quintic(BoundaryState((1.0, 1.0)), BoundaryState((1.0, 1.0)), 1.0)
    with pytest.raises(GeometryError, match="all derivatives"):
        Quintic(BoundaryState((0.0, 0.0)), BoundaryState((0.0, 1e-144)), 1.0)
    with pytest.raises(GeometryError, match="finite"):
        BoundaryState((0.0, math.nan))
    with pytest.raises(ConfigurationError, match="gear"):
        Quintic(BoundaryState((0.0, 0.0)), BoundaryState((1.0, 0.0)), 1.0, gear=0)


@settings(deadline=None)
@given(st.floats(0.05, 10.0), st.sampled_from([1, -1]))
def test_minimum_duration_is_tight(length, gear):
    limits = Limits(0.22, 0.4, 0.3, 1.0, v_min=-0.1)
    T = minimum_duration(length, limits, gear)
    trajectory = Quintic(BoundaryState((0.0, 0.0)), BoundaryState((gear * length, 0.0)), T, gear)
    use = trajectory.peaks().utilisation(limits, gear)
    assert max(use.speed, use.acceleration) == pytest.approx(1.0, abs=1e-4)
    faster = Quintic(BoundaryState((0.0, 0.0)), BoundaryState((gear * length, 0.0)), 0.99 * T, gear)
    assert faster.limits_exceeded(limits)


def test_minimum_duration_of_two_metres():
    assert minimum_duration(2.0, LIMITS) == pytest.approx(17.0, abs=0.05)
    with pytest.raises(GeometryError, match="length"):
        minimum_duration(-1.0, LIMITS)
    with pytest.raises(GeometryError, match="reverse"):
        minimum_duration(1.0, Limits(0.2, 0.4, 0.3, 1.0, v_min=0.0), gear=-1)


@settings(max_examples=25, deadline=None)
@given(states, states, durations)
def test_peaks_against_finite_differences(start, end, T):
    trajectory = make(start, end, T)
    peaks = trajectory.peaks()
    assume(peaks.turn_rate < 20.0 and peaks.angular_acceleration < 100.0)
    h = 1e-7 * T
    t = np.linspace(0.0, T - h, 2001)
    v, omega = np.array([trajectory.twist(x) for x in t]).T
    v_after, omega_after = np.array([trajectory.twist(x + h) for x in t]).T
    dense = (v, omega, (v_after - v) / h, (omega_after - omega) / h)
    for peak, values in zip(peaks, dense, strict=True):
        highest = np.max(np.abs(values))
        assert highest * (1.0 - 1e-3) - 1e-5 <= peak <= highest * (1.0 + 5e-2) + 1e-5


def test_limits_exceeded_names_the_limit():
    trajectory = Quintic(BoundaryState((0.0, 0.0)), BoundaryState((2.0, 0.0)), 10.0)
    exceeded = trajectory.limits_exceeded(LIMITS)
    assert list(exceeded) == ["speed"]
    assert exceeded["speed"] == pytest.approx(1.875 * 2.0 / 10.0 / 0.22, rel=1e-4)
