"""Dynamics against finite differences of exact arcs, mirror and frame invariance."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.errors import GeometryError
from clfcbf.se2 import Pose2, Twist, arc, wrap_angle
from clfcbf.unicycle import (
    AffineDynamics,
    Polar,
    bearing_acceleration,
    polar,
    relative_pose,
    seen_point,
    tracking_error,
)

H = 1e-5

metre = st.floats(-3.0, 3.0)
angle = st.floats(-3.0, 3.0)
speed = st.floats(-1.0, 1.0)
poses = st.builds(Pose2, metre, metre, angle)
twists = st.builds(Twist, speed, speed)


def difference(before, after, angles):
    """Central difference; the entries named in ``angles`` are differences of angles."""
    return [
        (wrap_angle(b - a) if i in angles else b - a) / (2.0 * H)
        for i, (a, b) in enumerate(zip(before, after, strict=True))
    ]


def seen_after(body, body_twist, observer_twist, t):
    """``body``, seen from an observer at the origin, after both moved along their arcs."""
    return arc(observer_twist, t).relative(body.compose(arc(body_twist, t)))


@settings(deadline=None)
@given(poses, twists, twists)
def test_tracking_error_is_the_derivative_of_exact_motion(error, reference, twist):
    rate = tracking_error(error, reference).rate(twist)
    ends = [seen_after(error, reference, twist, t) for t in (-H, H)]
    assert rate == pytest.approx(difference(*ends, {2}), abs=1e-8)


@settings(deadline=None)
@given(poses, twists, twists)
def test_relative_pose_is_the_derivative_of_exact_motion(pose, observer, twist):
    rate = relative_pose(pose, observer).rate(twist)
    ends = [seen_after(pose, twist, observer, t) for t in (-H, H)]
    assert rate == pytest.approx(difference(*ends, {2}), abs=1e-8)


@settings(deadline=None)
@given(poses, twists, twists)
def test_observer_and_body_are_two_readings_of_one_equation(pose, observer, body):
    one = tracking_error(pose, body).rate(observer)
    other = relative_pose(pose, observer).rate(body)
    assert one == pytest.approx(other, abs=1e-14)


@settings(deadline=None)
@given(metre, metre, speed, speed, twists)
def test_seen_point_also_of_a_moving_point(x, y, vx, vy, twist):
    rate = seen_point((x, y), (vx, vy)).rate(twist)
    ends = [arc(twist, t).seen((x + vx * t, y + vy * t)) for t in (-H, H)]
    assert rate == pytest.approx(difference(*ends, set()), abs=1e-8)


@settings(deadline=None)
@given(poses, twists, twists)
def test_polar_also_of_a_moving_target(target, target_twist, twist):
    assume(math.hypot(target.x, target.y) > 0.2)
    rate = polar(Polar.of(target), target_twist).rate(twist)
    ends = [Polar.of(seen_after(target, target_twist, twist, t)) for t in (-H, H)]
    assert rate == pytest.approx(difference(*ends, {1, 2}), abs=1e-6)


@settings(deadline=None)
@given(poses)
def test_polar_coordinates_round_trip(target):
    assume(math.hypot(target.x, target.y) > 1e-6)
    again = Polar.of(target).pose()
    assert again[:2] == pytest.approx(target[:2], abs=1e-12)
    assert wrap_angle(again.theta - target.theta) == pytest.approx(0.0, abs=1e-12)


@settings(deadline=None)
@given(st.floats(0.3, 4.0), angle, twists, speed, speed)
def test_bearing_acceleration_is_the_derivative_of_the_bearing_rate(rho, phi, twist, a, alpha):
    """Move along the exact arcs for a short time with the twist of each moment."""

    def rate_at(t):
        # v and omega ramp linearly: the mean twist over [0, t] moves to second order in t.
        mean = Twist(twist.v + 0.5 * a * t, twist.omega + 0.5 * alpha * t)
        x, y = arc(mean, t).seen((rho * math.cos(phi), rho * math.sin(phi)))
        state = Polar(math.hypot(x, y), math.atan2(y, x), 0.0)
        now = Twist(twist.v + a * t, twist.omega + alpha * t)
        return polar(state).rate(now)[1]

    (expected,) = bearing_acceleration(rho, phi, twist).rate((a, alpha))
    assert (rate_at(H) - rate_at(-H)) / (2.0 * H) == pytest.approx(expected, abs=1e-6)


@settings(deadline=None)
@given(poses, twists, twists)
def test_mirror_image(error, reference, twist):
    def mirrored(values):
        x, y, theta = values
        return x, -y, -theta

    rate = tracking_error(error, reference).rate(twist)
    flipped = tracking_error(Pose2(*mirrored(error)), Twist(reference.v, -reference.omega)).rate(
        Twist(twist.v, -twist.omega)
    )
    assert flipped == pytest.approx(mirrored(rate), abs=1e-14)


@settings(deadline=None)
@given(poses, poses, poses, twists, twists)
def test_frame_of_reference_does_not_matter(frame, robot, target, reference, twist):
    """The rates depend on the relative pose alone, wherever the pair stands."""
    error = robot.relative(target)
    moved = frame.compose(robot).relative(frame.compose(target))
    one = tracking_error(error, reference).rate(twist)
    other = tracking_error(moved, reference).rate(twist)
    assert one == pytest.approx(other, abs=1e-11)


def test_rate_is_drift_plus_input():
    dynamics = AffineDynamics((1.0, 2.0), ((3.0, 4.0), (5.0, 6.0)))
    assert dynamics.rate(Twist(10.0, 100.0)) == (431.0, 652.0)


@pytest.mark.parametrize("rho", [0.0, -1.0, math.nan])
def test_polar_form_refuses_range_zero(rho):
    with pytest.raises(GeometryError, match="range"):
        polar(Polar(rho, 0.0, 0.0))
    with pytest.raises(GeometryError, match="range"):
        bearing_acceleration(rho, 0.0, Twist(0.0, 0.0))
