"""The visible path against dense sampling, numeric curvature and integration of its dynamics."""

import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from clfcbf.camera import FieldOfView
from clfcbf.errors import GeometryError, PlanningError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.trajectories.log_spiral import (
    ReverseLeg,
    edge_bearings,
    forward_limit,
    visible_after_turn,
)
from clfcbf.trajectories.timing import time_path
from clfcbf.trajectories.visible import VisiblePath, visible_curvature
from clfcbf.unicycle import Polar, polar

HALF = math.radians(35.0)
CENTRED = FieldOfView(HALF)
AHEAD = FieldOfView(HALF, Pose2(0.2, 0.0, 0.0))
STANDOFF = 0.6
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)

starts = st.builds(Polar, st.floats(0.7, 3.5), st.floats(-0.6, 0.6), st.floats(-0.9, 0.9))
cameras = st.builds(
    FieldOfView,
    st.floats(0.3, 1.0),
    st.builds(Pose2, st.floats(-0.2, 0.3), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2)),
    st.sampled_from([0.0, 0.5]),
)


def paper_start(rng):
    """A start of the paper's region; the camera's bearing of the board uniform in 0.9 of Phi."""
    x, y = rng.uniform(-2.5, -1.5), rng.uniform(-1.0, 1.0)
    rho, delta = math.hypot(STANDOFF - x, -y), math.atan2(-y, STANDOFF - x)
    seen = rng.uniform(-0.9, 0.9) * HALF
    return Polar(rho, seen - math.asin(0.2 * math.sin(seen) / rho), delta)


@settings(deadline=None)
@given(starts)
def test_ends_at_the_goal_in_line_and_straight(start):
    path = VisiblePath(start, STANDOFF)
    goal = start.pose().compose(Pose2(-STANDOFF, 0.0, 0.0))
    assert path.pose(1.0) == pytest.approx(goal, abs=1e-12)
    assert path.pose(0.0) == pytest.approx(Pose2(0.0, 0.0, 0.0), abs=1e-12)
    assert path.curvature(1.0) == pytest.approx(0.0, abs=1e-12)
    assert path.polar(1.0) == pytest.approx((STANDOFF, 0.0, 0.0), abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(starts)
def test_closed_form_solves_the_polar_dynamics(start):
    """Drive with the curvature at unit speed from the start and arrive at the closed form."""
    path = VisiblePath(start, STANDOFF)
    T = path.log_range

    def slope(_, state):
        q = Polar(*state)
        kappa = path.curvature(math.log(start.rho / q.rho) / T)
        return polar(q).rate(Twist(1.0, kappa))

    end = path.sampled().length
    out = solve_ivp(slope, (0.0, 0.9 * end), start, rtol=1e-10, atol=1e-12)
    rho, phi, delta = out.y[:, -1]
    expected = path.polar(math.log(start.rho / rho) / T)
    assert (phi, delta) == pytest.approx(expected[1:], abs=1e-7)


@settings(deadline=None)
@given(starts, st.floats(0.02, 0.98))
def test_curvature_is_that_of_the_path(start, z):
    path, h = VisiblePath(start, STANDOFF), 1e-5
    before, after = path.pose(z - h), path.pose(z + h)
    step = before.relative(after)
    chord = math.hypot(step.x, step.y)
    assert step.theta / chord == pytest.approx(path.curvature(z), rel=1e-4, abs=1e-5)
    # No side slip: the chord lies along the mean heading, but for a term of the next order.
    slip = math.atan2(step.y, step.x) - 0.5 * step.theta
    assert abs(slip) <= 1e-3 * abs(step.theta) + 1e-8


@settings(deadline=None)
@given(starts)
def test_peak_bearing_against_dense_sampling(start):
    path = VisiblePath(start, STANDOFF)
    dense = max(abs(path.polar(z).phi) for z in np.linspace(0.0, 1.0, 1001))
    assert dense <= path.peak_bearing + 1e-12
    assert dense == pytest.approx(path.peak_bearing, abs=1e-4)


@settings(max_examples=60, deadline=None)
@given(starts, cameras)
def test_margin_against_dense_sampling(start, camera):
    """Every end of the feature, from the exact poses, through the camera's own bearing."""
    path = VisiblePath(start, STANDOFF)
    feature, half_width = start.pose(), 0.5 * camera.width
    dense = min(
        camera.margin(path.pose(z).seen(feature.transform((0.0, side))))
        for z in np.linspace(0.0, 1.0, 1501)
        for side in {half_width, -half_width}
    )
    margin = path.margin(camera)
    assert margin <= dense + 1e-6
    assert margin == pytest.approx(dense, abs=1e-3)


@settings(deadline=None)
@given(starts)
def test_margin_of_a_centred_camera_is_the_closed_form(start):
    path = VisiblePath(start, STANDOFF)
    assert path.margin(CENTRED) == pytest.approx(HALF - path.peak_bearing, abs=1e-6)


@settings(deadline=None)
@given(starts, st.floats(0.0, 1.0))
def test_camera_offset_raises_the_tangent(start, z):
    path, offset = VisiblePath(start, STANDOFF), 0.2
    rho, phi, _ = path.polar(z)
    x, y = rho * math.cos(phi), rho * math.sin(phi)
    assume(x > offset + 0.01)
    m = math.tan(phi)
    expected = m / (1.0 - offset * math.sqrt(1.0 + m * m) / rho)
    assert math.tan(AHEAD.bearing((x, y))) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(starts)
def test_sampled_path_is_the_path(start):
    """Arc lengths against dense chords; poses rebuilt from curvature alone, to second order."""
    path = VisiblePath(start, STANDOFF)
    sampled = path.sampled()
    points = np.array([path.pose(z)[:2] for z in np.linspace(0.0, 1.0, 2001)])
    chords = np.sum(np.hypot(*np.diff(points, axis=0).T))
    assert sampled.length == pytest.approx(chords, rel=1e-5)
    assert sampled.pose(sampled.length) == pytest.approx(path.pose(1.0), abs=1e-12)

    def miss(samples):
        exact = path.sampled(samples)
        rebuilt = type(exact).from_curvature(exact.s, exact.curvature)
        # Both headings are unwrapped, from starts that are a whole number of turns apart.
        turned = (rebuilt.poses - exact.poses)[-1] - (rebuilt.poses - exact.poses)[0]
        return np.max(np.abs(turned))

    assert miss(801) <= 0.3 * miss(401) + 1e-9
    assert miss(401) <= 0.3 * miss(201) + 1e-9


@settings(deadline=None)
@given(starts)
def test_feedback_curvature_is_the_path_s_first(start):
    assert visible_curvature(start, STANDOFF) == pytest.approx(
        VisiblePath(start, STANDOFF).curvature(0.0), rel=1e-12, abs=1e-12
    )


@settings(max_examples=20, deadline=None)
@given(starts)
def test_feedback_arrives_on_the_axis(start):
    """Solved afresh at each state, the law still converges: stop just short of the standoff.

    The log range runs down as the independent variable, so the speed does not matter.
    """
    assume(start.rho > 1.0)

    def slope(tau, state):
        q = Polar(start.rho * math.exp(-tau), *state)
        rate = polar(q).rate(Twist(1.0, visible_curvature(q, STANDOFF)))
        per_tau = -q.rho / rate[0]
        return rate[1] * per_tau, rate[2] * per_tau

    end = math.log(start.rho / (1.02 * STANDOFF))
    out = solve_ivp(slope, (0.0, end), start[1:], rtol=1e-9, atol=1e-11)
    assert out.status == 0
    phi, delta = np.abs(out.y[:, -1])
    assert delta < 0.02
    assert phi < 0.2


@settings(deadline=None)
@given(starts)
def test_mirror_image(start):
    path = VisiblePath(start, STANDOFF)
    mirrored = VisiblePath(Polar(start.rho, -start.phi, -start.delta), STANDOFF)
    for z in (0.1, 0.5, 0.9):
        x, y, theta = path.pose(z)
        assert mirrored.pose(z) == pytest.approx((x, -y, -theta), abs=1e-12)
        assert mirrored.curvature(z) == pytest.approx(-path.curvature(z), abs=1e-12)


def test_paper_region_is_visible():
    """All starts by a centred camera; nearly all by one 0.2 m ahead, all after a turn."""
    rng = np.random.default_rng(7)
    region = [paper_start(rng) for _ in range(300)]
    paths = [VisiblePath(start, STANDOFF) for start in region]
    assert all(path.margin(CENTRED) >= 0.0 for path in paths)
    assert sum(path.margin(AHEAD) >= 0.0 for path in paths) >= 290
    assert all(visible_after_turn(start, STANDOFF, AHEAD) is not None for start in region)
    assert max(path.sampled().length for path in paths) < 2.8
    # Turn rate limit at full speed, at the sharpest bend of any of them but a few.
    sharp = [np.max(np.abs(path.sampled().curvature)) for path in paths]
    assert np.quantile(sharp, 0.99) < LIMITS.omega_max / LIMITS.v_max


def test_paper_region_reaches_the_axis_forward_by_half_a_radian():
    slack = [
        forward_limit(rho, STANDOFF, CENTRED)[1] - abs(delta)
        for rho, delta in (
            (math.hypot(STANDOFF - x, y), math.atan2(y, STANDOFF - x))
            for x in np.linspace(-2.5, -1.5, 41)
            for y in np.linspace(-1.0, 1.0, 41)
        )
    ]
    assert min(slack) == pytest.approx(0.50, abs=0.01)


@settings(max_examples=15, deadline=None)
@given(starts)
def test_visible_path_can_be_timed(start):
    timed = time_path(VisiblePath(start, STANDOFF).sampled(), LIMITS)
    assert max(timed.utilisation(LIMITS)) <= 1.0 + 1e-9
    goal = start.pose().compose(Pose2(-STANDOFF, 0.0, 0.0))
    assert timed.at(timed.duration) == (pytest.approx(goal, abs=1e-9), Twist(0.0, 0.0))


# --- what the view allows -------------------------------------------------------------------


@settings(deadline=None)
@given(st.floats(0.5, 4.0), cameras)
def test_edge_bearings_are_on_the_edges(rho, camera):
    right, left = edge_bearings(rho, camera)
    for phi, side in ((right, -1.0), (left, 1.0)):
        seen = camera.bearing((rho * math.cos(phi), rho * math.sin(phi)))
        assert seen == pytest.approx(side * camera.half_angle, abs=1e-12)
    assert right < left


@settings(deadline=None)
@given(st.floats(0.61, 4.0), cameras)
def test_forward_limit_against_quadrature(rho, camera):
    def integral(edge):
        return quad(lambda r: math.tan(edge_bearings(r, camera)[edge]) / r, STANDOFF, rho)[0]

    lowest, highest = forward_limit(rho, STANDOFF, camera)
    assert lowest == pytest.approx(-integral(1), abs=1e-8)
    assert highest == pytest.approx(-integral(0), abs=1e-8)


@pytest.mark.parametrize(
    ("rho", "camera", "expected"),
    [(1.0, AHEAD, 0.254), (2.0, AHEAD, 0.658), (1.0, CENTRED, 0.358), (2.0, CENTRED, 0.843)],
)
def test_forward_limit_published_values(rho, camera, expected):
    lowest, highest = forward_limit(rho, STANDOFF, camera)
    assert (round(-lowest, 3), round(highest, 3)) == (expected, expected)


@settings(deadline=None)
@given(st.floats(0.8, 3.0), st.sampled_from([CENTRED, AHEAD]))
def test_forward_limit_is_necessary_for_a_visible_path(rho, camera):
    _, highest = forward_limit(rho, STANDOFF, camera)
    assert visible_after_turn(Polar(rho, 0.0, highest + 1e-6), STANDOFF, camera) is None


@settings(max_examples=15, deadline=None)
@given(st.floats(0.8, 3.0), st.sampled_from([CENTRED, AHEAD]))
def test_forward_limit_is_sharp(rho, camera):
    """Ride the edge in from the limit: the line of sight is home exactly at the standoff."""
    _, highest = forward_limit(rho, STANDOFF, camera)

    def slope(log_rho, _):
        return [-math.tan(edge_bearings(math.exp(log_rho), camera)[0])]

    span = (math.log(rho), math.log(STANDOFF))
    out = solve_ivp(slope, span, [highest], rtol=1e-10, atol=1e-12)
    assert out.y[0, -1] == pytest.approx(0.0, abs=1e-8)


@settings(max_examples=30, deadline=None)
@given(starts)
def test_smallest_turn_keeps_a_bearing_that_does(start):
    path = visible_after_turn(start, STANDOFF, AHEAD)
    if VisiblePath(start, STANDOFF).margin(AHEAD) >= 0.0:
        assert path is not None
        assert path.start == start
    elif path is not None:
        assert path.margin(AHEAD) >= 0.0
        assert (path.start.rho, path.start.delta) == (start.rho, start.delta)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.5, 1.2), st.floats(0.2, 0.6), st.sampled_from([1, -1]), st.floats(0.0, 0.1))
def test_reverse_leg_brings_the_path_into_view(rho, delta, side, margin):
    state = Polar(rho, 0.1, side * delta)
    leg = ReverseLeg.shortest(state, STANDOFF, AHEAD, margin, 6.0)
    assert leg.margin(AHEAD) >= margin - 1e-9
    assert abs(leg.end.delta) < abs(state.delta)
    assert leg.end.delta * side >= -1e-12
    assert visible_after_turn(leg.end, STANDOFF, AHEAD, margin) is not None


@settings(max_examples=30, deadline=None)
@given(starts, st.floats(0.05, 1.5))
def test_reverse_leg_against_the_dynamics(start, further):
    """Reverse at unit speed with omega = (v/rho) sin(phi): bearing held, samples passed."""
    leg = ReverseLeg(start, start.rho + further)

    def slope(_, state):
        q = Polar(*state)
        return polar(q).rate(Twist(-1.0, -math.sin(q.phi) / q.rho))

    out = solve_ivp(slope, (0.0, leg.length), start, rtol=1e-10, atol=1e-12)
    assert out.y[:, -1] == pytest.approx(leg.end, abs=1e-7)
    sampled = leg.sampled()
    assert sampled.length == pytest.approx(leg.length, rel=1e-12)
    end = sampled.pose(sampled.length)
    assert end == pytest.approx(start.pose().compose(leg.end.pose().inverse()), abs=1e-9)
    rebuilt = type(sampled).from_curvature(sampled.s, sampled.curvature, gear=-1)
    assert rebuilt.poses[-1] == pytest.approx(sampled.poses[-1] - sampled.poses[0], abs=1e-3)


def test_reverse_leg_too_far_says_so():
    with pytest.raises(PlanningError, match=re.escape("1.000 m")) as caught:
        ReverseLeg.shortest(Polar(0.8, 0.0, 0.8), STANDOFF, AHEAD, 0.0, 1.0)
    assert caught.value.reasons["field of view"] > 0


@pytest.mark.parametrize(
    ("start", "standoff", "match"),
    [
        (Polar(0.5, 0.0, 0.1), 0.6, "back off"),
        (Polar(1.0, 0.0, 0.1), 0.0, "standoff"),
        (Polar(1.0, 1.6, 0.1), 0.6, "turn"),
        (Polar(math.nan, 0.0, 0.1), 0.6, "finite"),
        (Polar(1.0, 0.0, math.inf), 0.6, "finite"),
    ],
)
def test_degenerate_starts(start, standoff, match):
    with pytest.raises(GeometryError, match=match):
        VisiblePath(start, standoff)
    with pytest.raises(GeometryError, match=match):
        visible_curvature(start, standoff)


def test_degenerate_legs_and_limits():
    with pytest.raises(GeometryError, match="farther"):
        ReverseLeg(Polar(1.0, 0.0, 0.1), 0.9)
    with pytest.raises(GeometryError, match="ahead"):
        ReverseLeg(Polar(1.0, 1.6, 0.1), 1.2)
    with pytest.raises(GeometryError, match="margin"):
        ReverseLeg.shortest(Polar(0.8, 0.0, 0.3), STANDOFF, AHEAD, 1.0, 2.0)
    with pytest.raises(GeometryError, match="beyond the camera"):
        edge_bearings(0.1, AHEAD)
    with pytest.raises(GeometryError, match="exceed"):
        forward_limit(0.5, STANDOFF, AHEAD)
