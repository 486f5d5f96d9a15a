import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.se2 import Pose2, Twist, arc, is_finite, wrap_angle
from tests.strategies import any_float, lengths, points, poses, twists


def matrix(pose):
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])


def runge_kutta(twist, duration, steps=400):
    """The unicycle integrated by the classical Runge-Kutta method."""

    def rate(state):
        return np.array([twist.v * math.cos(state[2]), twist.v * math.sin(state[2]), twist.omega])

    state, h = np.zeros(3), duration / steps
    for _ in range(steps):
        a = rate(state)
        b = rate(state + h / 2 * a)
        c = rate(state + h / 2 * b)
        d = rate(state + h * c)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return state


@given(poses, poses)
def test_compose_is_the_matrix_product(a, b):
    np.testing.assert_allclose(matrix(a.compose(b)), matrix(a) @ matrix(b), atol=1e-12)


@given(poses)
def test_inverse_undoes(a):
    for product in (a.compose(a.inverse()), a.inverse().compose(a)):
        np.testing.assert_allclose(matrix(product), np.eye(3), atol=1e-12)


@given(poses, poses)
def test_relative_is_inverse_then_compose(a, b):
    np.testing.assert_allclose(
        matrix(a.relative(b)), np.linalg.inv(matrix(a)) @ matrix(b), atol=1e-12
    )


@given(poses, points)
def test_transform_and_seen_are_inverse(pose, point):
    np.testing.assert_allclose(pose.seen(pose.transform(point)), point, atol=1e-12)
    np.testing.assert_allclose(
        pose.transform(point), (matrix(pose) @ [*point, 1.0])[:2], atol=1e-12
    )


@given(twists, st.floats(0.0, 3.0))
def test_arc_is_runge_kutta(twist, duration):
    end = arc(twist, duration)
    x, y, theta = runge_kutta(twist, duration)
    assert math.hypot(end.x - x, end.y - y) < 1e-9
    assert abs(wrap_angle(end.theta - theta)) < 1e-12


@given(twists, st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_arcs_compose(twist, first, second):
    np.testing.assert_allclose(
        matrix(arc(twist, first).compose(arc(twist, second))),
        matrix(arc(twist, first + second)),
        atol=1e-12,
    )


@given(st.floats(-1.0, 1.0), st.floats(0.01, 2.0), st.sampled_from([0.0, 5e-324, 1e-200, 1e-12]))
def test_arc_is_smooth_through_straight(v, duration, omega):
    end = arc(Twist(v, omega), duration)
    assert end.x == pytest.approx(v * duration, rel=1e-15)
    assert end.y == pytest.approx(0.5 * v * omega * duration**2, rel=1e-9, abs=1e-300)


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_pure_speed_and_pure_turn(rate, duration):
    assert arc(Twist(rate, 0.0), duration) == Pose2(rate * duration, 0.0, 0.0)
    turned = arc(Twist(0.0, rate), duration)
    assert (turned.x, turned.y) == (0.0, 0.0)
    assert turned.theta == pytest.approx(wrap_angle(rate * duration), abs=1e-15)


@given(poses, twists, st.floats(0.0, 2.0), points)
def test_a_seen_point_turns_about_the_instantaneous_centre(pose, twist, duration, point):
    """p+ = c + R(-omega t)(p - c), c = (0, v/omega)."""
    if abs(twist.omega) < 1e-3:
        return
    seen = pose.seen(point)
    after = pose.moved(twist, duration).seen(point)
    centre = np.array([0.0, twist.v / twist.omega])
    a = -twist.omega * duration
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    np.testing.assert_allclose(after, centre + turn @ (seen - centre), atol=1e-9)


@given(st.floats(-1e6, 1e6))
def test_wrap_angle(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-9)


def test_wrap_angle_keeps_pi():
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == math.pi


@given(st.lists(any_float, max_size=6))
def test_is_finite(values):
    finite = all(math.isfinite(v) for v in values)
    if not finite or all(abs(v) < 1e300 for v in values):
        assert is_finite(tuple(values)) == finite


def test_is_finite_gives_up_where_the_sum_overflows():
    assert not is_finite((1e308, 1e308))


@given(lengths, lengths, st.floats(-2.0, 2.0))
def test_scaled_keeps_the_curvature(v, omega, factor):
    scaled = Twist(v, omega).scaled(factor)
    assert scaled.v * omega == pytest.approx(scaled.omega * v, abs=1e-12)


@given(poses, twists, st.floats(0.0, 2.0))
def test_moved_is_the_arc_composed(pose, twist, duration):
    np.testing.assert_allclose(
        matrix(pose.moved(twist, duration)), matrix(pose.compose(arc(twist, duration))), atol=1e-12
    )


@given(poses, poses, twists, st.floats(-40.0, 40.0))
def test_every_heading_is_wrapped(a, b, twist, duration):
    moved = (a.moved(twist, duration), arc(twist, duration))
    for pose in (a.compose(b), a.relative(b), a.inverse(), *moved):
        assert -math.pi < pose.theta <= math.pi


def test_straight_back_has_one_name():
    """Minus pi, which no wrapped angle is, becomes pi on every way."""
    here, back = Pose2(0.0, 0.0, 0.0), Pose2(0.0, 0.0, -math.pi)
    rest, about = Twist(0.0, 0.0), Twist(0.0, -math.pi)
    for pose in (
        back.compose(here),
        here.relative(back),
        back.inverse(),
        back.moved(rest, 1.0),
        here.moved(about, 1.0),
        arc(about, 1.0),
    ):
        assert pose.theta == math.pi


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_headings_beyond_half_a_turn_come_back_from_the_other_side(sign):
    two, rest = sign * 2.0, Twist(0.0, 0.0)
    expected = pytest.approx(sign * (4.0 - 2.0 * math.pi), abs=1e-15)
    start = Pose2(0.0, 0.0, two)
    assert start.compose(start).theta == expected
    assert Pose2(0.0, 0.0, -two).relative(start).theta == expected
    assert start.moved(Twist(0.0, two), 1.0).theta == expected
    assert arc(Twist(0.0, two), 2.0).theta == expected
    assert wrap_angle(2.0 * two) == expected
    assert start.moved(rest, 1.0) == start
