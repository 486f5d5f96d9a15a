"""Terminal curves, tangent candidates, paths and the planner, each against its definition."""

import contextlib
import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.errors import ConfigurationError, GeometryError, LimitsError, PlanningError
from clfcbf.guard import Guard
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.simulation.scenarios import REGIONS, World, draw_start, facing
from clfcbf.trajectories.build import approach_path, arc_path
from clfcbf.trajectories.following import FollowingGains
from clfcbf.trajectories.legs import Path, Trajectory, Turn
from clfcbf.trajectories.planner import Planner, plan_approach
from clfcbf.trajectories.rollout import roll_out
from clfcbf.trajectories.tangent import tangent_candidates
from clfcbf.trajectories.terminal import nominal_offsets, terminal_curves

PERIOD = 1 / 30
WORLD = World()
CAMERA = WORLD.camera
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
STANDOFF = WORLD.standoff
FEATURE = (STANDOFF, 0.0)


def make_planner(limits=LIMITS, camera=CAMERA, lag=0.12):
    guard = Guard(limits, (FieldOfViewBarrier(camera, 1.5, defaults.VIEW_MARGIN),), PERIOD, 0.25)
    return Planner(guard, camera, STANDOFF, lag)


PLANNER = make_planner()


def starts(region="R1"):
    return st.integers(0, 2**32 - 1).map(
        lambda seed: draw_start(REGIONS[region], WORLD, np.random.default_rng(seed))
    )


some_limits = st.builds(
    Limits,
    v_max=st.floats(0.1, 0.5),
    omega_max=st.floats(0.2, 0.8),
    a_max=st.floats(0.2, 1.0),
    alpha_max=st.floats(0.5, 3.0),
)


@settings(max_examples=25)
@given(some_limits, st.floats(0.35, 1.0), st.floats(0.0, 0.3))
def test_terminal_curves_keep_all_four_limits_and_the_edge(limits, half_angle, cx):
    camera = FieldOfView(half_angle, Pose2(cx, 0.0, 0.0))
    offsets = nominal_offsets(limits, camera, STANDOFF, 7)
    curves = terminal_curves(limits, camera, STANDOFF, offsets, 2.0)
    assert curves.speed.max() <= limits.v_max + 1e-12
    assert np.abs(curves.turn_rate).max() <= limits.omega_max + 1e-12
    dt = 0.025
    assert np.abs(np.diff(curves.speed, axis=1)).max() <= limits.a_max * dt + 1e-12
    bearing = bearings(curves.x, curves.y, curves.heading, camera)
    assert np.abs(bearing).max() <= half_angle + math.radians(0.05)
    # Driven forward, each step is the exact arc of its mean twist, down to the stop at the goal.
    ahead_x = curves.x[:, :-1] - curves.x[:, 1:]
    ahead_y = curves.y[:, :-1] - curves.y[:, 1:]
    step = curves.to_go[:, 1:] - curves.to_go[:, :-1]
    np.testing.assert_allclose(np.hypot(ahead_x, ahead_y), step, atol=1e-12)
    middle = 0.5 * (curves.heading[:, :-1] + curves.heading[:, 1:])
    sideways = ahead_y * np.cos(middle) - ahead_x * np.sin(middle)
    np.testing.assert_allclose(sideways, 0.0, atol=1e-9)
    assert np.all(curves.x[:, 0] == 0.0)
    assert np.all(curves.y[:, 0] == 0.0)


def bearings(x, y, heading, camera):
    cx, cy, yaw = camera.camera
    eye_x = x + cx * np.cos(heading) - cy * np.sin(heading)
    eye_y = y + cx * np.sin(heading) + cy * np.cos(heading)
    bearing = np.arctan2(-eye_y, STANDOFF - eye_x) - heading - yaw
    return np.remainder(bearing + np.pi, 2 * np.pi) - np.pi


def test_the_turn_on_the_spot_uses_what_the_view_allows():
    offsets = nominal_offsets(PLANNER.limits, PLANNER.edge, STANDOFF, 10)
    curves = terminal_curves(PLANNER.limits, PLANNER.edge, STANDOFF, offsets, 1.0)
    at_goal = np.abs(bearings(0.0, 0.0, curves.heading[:, 0], PLANNER.edge))
    assert at_goal.max() <= PLANNER.edge.half_angle
    assert at_goal.max() > 0.85 * PLANNER.edge.half_angle


@settings(max_examples=40)
@given(starts())
def test_candidates_are_tangent(start):
    found = tangent_candidates(np.array([start]), PLANNER.radii, PLANNER.curves)
    assume(len(found) > 0)
    curves = PLANNER.curves
    for row in range(0, len(found), 7):
        radius, swept = found.radius[row], found.swept[row]
        assert radius * swept >= 0.0
        end = start.theta + swept
        x = start.x - radius * (math.sin(start.theta) - math.sin(end))
        y = start.y + radius * (math.cos(start.theta) - math.cos(end))
        x += found.straight[row] * math.cos(end)
        y += found.straight[row] * math.sin(end)
        j, i, part = found.curve[row], found.sample[row], found.part[row]
        entry = [
            c[j, i] + part * (c[j, i + 1] - c[j, i]) for c in (curves.x, curves.y, curves.heading)
        ]
        # The sign change was interpolated over a sample, 5 mm long.
        assert math.hypot(x - entry[0], y - entry[1]) < 1e-3
        assert abs(wrap_angle(end - entry[2])) < 1e-6


@settings(max_examples=30)
@given(starts(), st.data())
def test_a_path_is_what_the_robot_would_drive(start, data):
    found = tangent_candidates(np.array([start]), PLANNER.radii, PLANNER.curves)
    assume(len(found) > 0)
    row = data.draw(st.integers(0, len(found) - 1))
    path = approach_path(start, found, row, PLANNER.curves, PLANNER.limits)
    limits = PLANNER.limits
    s, v, w = (np.array(c) for c in (path.s, path.speed, path.turn_rate))
    assert np.all(np.diff(s) > 0.0)
    assert v.max() <= limits.v_max + 1e-9
    assert np.abs(w).max() <= limits.omega_max + 1e-9
    assert v[-1] == 0.0
    braking = (v[:-1] ** 2 - v[1:] ** 2) / (2.0 * np.diff(s))
    assert braking.max() <= limits.a_max * (1 + 1e-6)
    assert path.end == Pose2(0.0, 0.0, 0.0)
    assert math.hypot(path.poses[-1].x, path.poses[-1].y) < 1e-12
    assert path.poses[0] == start


@given(st.floats(0.05, 2.0), st.floats(-1.5, 1.5), st.sampled_from([1, -1]), some_limits)
def test_arc_legs_keep_the_limits_and_end_where_the_arc_does(length, swept, gear, limits):
    start = Pose2(0.3, -0.2, 0.7)
    path = arc_path(start, length, swept, limits, gear)
    seen = start.relative(path.end)
    chord = length * np.sinc(0.5 * swept / math.pi)
    assert math.hypot(seen.x, seen.y) == pytest.approx(chord, rel=1e-9)
    assert seen.x * gear >= -1e-12 or abs(swept) > math.pi
    v = np.array(path.speed)
    top = limits.v_max if gear > 0 else -limits.reverse_speed
    assert v.max() <= top + 1e-12
    assert np.abs(path.turn_rate).max() <= limits.omega_max + 1e-12
    slope = np.abs(np.diff(v**2) / (2 * np.diff(path.s)))
    assert slope.max() <= limits.a_max + 1e-9
    assert slope.max() * abs(swept / length) <= limits.alpha_max + 1e-9


@pytest.mark.parametrize("length", [1e3, 1e9, 1e300])
def test_no_length_of_an_arc_takes_the_memory_away(length):
    path = arc_path(Pose2(0.0, 0.0, 0.0), length, 0.5, LIMITS, -1)
    assert len(path.s) <= 20_001
    assert path.length == pytest.approx(length)


@given(st.floats(0.0, 1.0), st.floats(-0.02, 0.02))
def test_the_place_abreast_is_found_again(share, offset):
    path = arc_path(Pose2(0.0, 0.0, 0.0), 1.0, 1.0, LIMITS, 1)
    place = path.at(share * path.length)
    beside = place.pose.compose(Pose2(0.0, offset, 0.1))
    found = path.nearest(beside)
    assert found.s == pytest.approx(place.s, abs=2e-3)
    assert found.rest == pytest.approx(path.length - found.s)
    assert path.nearest(beside, since=0.9).s >= 0.9 - 1e-12


@pytest.mark.parametrize("apart", [0.0, 1e-170, 1e-162, 1e-10])
@pytest.mark.parametrize("at", [0, 1])
def test_samples_that_coincide_are_passed(at, apart):
    """No direction can be read off them; the place is the later one's."""
    x = [0.0, 1.0]
    x.insert(at + 1, x[at] + apart)
    poses = tuple(Pose2(x, 0.0, 0.0) for x in x)
    s = (0.0, 1e-9, 1.0) if at == 0 else (0.0, 1.0, 1.0 + 1e-9)
    path = Path(s, poses, (0.1, 0.1, 0.0), (0.0, 0.0, 0.0), poses[-1])
    for ahead in (-0.1, 0.0, 0.5, 1.0, 1.1):
        place = path.nearest(Pose2(ahead, 0.05, 0.0))
        assert min(place.s, 1.0) == pytest.approx(min(max(ahead, 0.0), 1.0), abs=2e-9)
        assert place.pose.x == pytest.approx(min(max(ahead, 0.0), 1.0), abs=2e-9)


@pytest.mark.parametrize("s", [(0.0, 0.0), (1.0, 0.0), (0.0, math.nan)])
def test_the_arc_lengths_of_a_path_increase(s):
    with pytest.raises(GeometryError, match="increase"):
        Path(s, (Pose2(0.0, 0.0, 0.0),) * 2, (0.0, 0.0), (0.0, 0.0), Pose2(0.0, 0.0, 0.0))


def test_a_path_needs_equal_columns():
    with pytest.raises(GeometryError, match="columns"):
        Path((0.0,), (Pose2(0, 0, 0),), (0.0,), (0.0,), Pose2(0, 0, 0))


def check_plan(plan, start, planner, camera):
    rollout = plan.rollout
    limits = planner.guard.limits
    assert rollout.arrived
    assert math.hypot(rollout.error.x, rollout.error.y) < defaults.PLAN_ERROR
    assert abs(rollout.error.theta) < defaults.PLAN_ERROR_THETA
    for before, after in zip(rollout.twists, rollout.twists[1:], strict=False):
        assert limits.input_box(before, PERIOD).contains(after, 1e-9)
    for pose in rollout.poses:
        assert camera.margin(pose.seen(FEATURE)) >= 0.0
    assert rollout.poses[0] == start


@settings(max_examples=8, deadline=None)
@given(starts("R1"))
def test_the_papers_region_is_reached_in_view(start):
    check_plan(PLANNER.plan(start), start, PLANNER, CAMERA)


@settings(max_examples=5, deadline=None)
@given(starts("R4"))
def test_close_and_lateral_starts_are_reached_in_view(start):
    check_plan(PLANNER.plan(start), start, PLANNER, CAMERA)


@pytest.mark.parametrize(
    ("x", "y", "bearing"), [(-0.5, 0.5, -0.3), (-0.4, -0.4, 0.1), (-0.6, 0.6, 0.3)]
)
def test_where_the_view_forbids_going_forward_it_backs_off(x, y, bearing):
    start = facing(x, y, bearing, WORLD)
    plan = PLANNER.plan(start)
    check_plan(plan, start, PLANNER, CAMERA)
    assert len(plan.legs) == 2
    first = plan.legs[0]
    assert isinstance(first, Turn | Trajectory)


def test_beside_the_goal_and_turned_far_aside_it_reverses_far():
    start = Pose2(-0.338, -0.569, 0.9826)
    check_plan(PLANNER.plan(start), start, PLANNER, CAMERA)


def test_without_reverse_it_never_plans_to_reverse():
    planner = make_planner(Limits(0.22, 0.4, 0.3, 1.0, v_min=0.0))
    start = facing(-0.4, -0.4, 0.1, WORLD)
    with contextlib.suppress(PlanningError):
        legs = planner.plan(start).legs
        assert all(isinstance(leg, Turn) or leg.gear == 1 for leg in legs)
        assert min(twist.v for twist in planner.plan(start).rollout.twists) >= 0.0
    straight = planner.plan(facing(-1.5, 0.1, 0.0, WORLD)).legs
    assert all(isinstance(leg, Turn) or leg.gear == 1 for leg in straight)


@settings(max_examples=8, deadline=None)
@given(starts("R5"))
def test_starts_that_need_reversing_go_on_through_the_change_of_gear(start):
    plan = PLANNER.plan(start)
    check_plan(plan, start, PLANNER, CAMERA)
    assert isinstance(plan.legs[0], Trajectory)
    v = np.array([twist.v for twist in plan.rollout.twists])
    assert v.min() < -0.05
    (change,) = np.flatnonzero((v[:-1] < 0.0) & (v[1:] >= 0.0))[:1]
    assert abs(plan.rollout.twists[change].omega) > 0.1


def test_docking_limits_are_planned_for():
    planner = make_planner(Limits(0.35, 0.25, 0.3, 1.0))
    start = facing(-1.8, 0.4, 0.1, WORLD)
    check_plan(planner.plan(start), start, planner, CAMERA)


def test_mirrored_starts_take_the_same_time():
    for x, y, bearing in [(-2.0, 0.6, 0.2), (-1.2, -0.5, 0.3)]:
        left = PLANNER.plan(facing(x, y, bearing, WORLD)).rollout
        right = PLANNER.plan(facing(x, -y, -bearing, WORLD)).rollout
        assert left.duration == pytest.approx(right.duration, abs=1e-9)
        assert left.error.y == pytest.approx(-right.error.y, abs=1e-6)


def test_the_facade_moves_with_its_frame():
    goal = Pose2(3.0, -1.0, 2.0)
    start = facing(-1.5, 0.3, 0.2, WORLD)
    here = plan_approach(start, Pose2(0, 0, 0), LIMITS, CAMERA, STANDOFF, PERIOD)
    there = plan_approach(goal.compose(start), goal, LIMITS, CAMERA, STANDOFF, PERIOD)
    assert there.rollout.duration == here.rollout.duration


def test_the_facade_plans_from_a_moving_start():
    start = facing(-1.8, 0.3, 0.1, WORLD)
    rest = plan_approach(start, Pose2(0, 0, 0), LIMITS, CAMERA, STANDOFF, PERIOD)
    moving = plan_approach(
        start, Pose2(0, 0, 0), LIMITS, CAMERA, STANDOFF, PERIOD, applied=Twist(0.2, 0.0)
    )
    assert moving.rollout.duration < rest.rollout.duration


def test_bad_requests_say_what_is_wrong():
    start = facing(-1.5, 0.3, 0.2, WORLD)
    origin = Pose2(0.0, 0.0, 0.0)
    with pytest.raises(GeometryError, match="finite"):
        plan_approach(Pose2(math.nan, 0, 0), origin, LIMITS, CAMERA, STANDOFF, PERIOD)
    with pytest.raises(GeometryError, match="behind"):
        plan_approach(Pose2(-1.5, 0, 3.0), origin, LIMITS, CAMERA, STANDOFF, PERIOD)
    with pytest.raises(LimitsError, match="beyond a limit"):
        plan_approach(start, origin, LIMITS, CAMERA, STANDOFF, PERIOD, applied=Twist(0.5, 0.0))
    with pytest.raises(ConfigurationError, match="standoff"):
        plan_approach(start, origin, LIMITS, CAMERA, 0.1, PERIOD)
    with pytest.raises(ConfigurationError, match="period"):
        plan_approach(start, origin, LIMITS, CAMERA, STANDOFF, 0.0)
    with pytest.raises(ConfigurationError, match="k2"):
        FollowingGains(k2=-1.0)


def test_an_impossible_start_says_which_constraint_forbids_it():
    blind = FieldOfView(math.radians(6.0), Pose2(0.2, 0.0, 0.0))
    start = facing(-0.5, 0.5, 0.0, World(camera=blind))
    with pytest.raises(PlanningError) as caught:
        plan_approach(start, Pose2(0, 0, 0), LIMITS, blind, STANDOFF, PERIOD)
    assert sum(caught.value.reasons.values()) > 0
    assert "field of view" in str(caught.value)


def test_the_view_keeps_a_rollout_honest():
    """A plan for a wide camera, driven under a narrow one, is braked by the guard."""
    narrow = FieldOfView(math.radians(15.0), CAMERA.camera)
    start = facing(-1.3, 0.6, 0.0, WORLD)
    legs = PLANNER.plan(start).legs
    guard = Guard(LIMITS, (FieldOfViewBarrier(narrow, 1.5, 0.0),), PERIOD, 0.0)
    rollout = roll_out(legs, start, Pose2(*FEATURE, 0.0), guard, 0.0, FollowingGains())
    assert rollout.guarded > 0
    assert rollout.clearance >= 0.0


@settings(max_examples=15, deadline=None)
@example(0.0, 0.0, 0.08)
@example(-1e-9, 0.0, 0.03)
@example(0.0, 1e-9, 0.0)
@given(st.floats(-0.06, 0.025), st.floats(-0.03, 0.03), st.floats(-0.08, 0.08))
def test_small_errors_at_the_goal_are_corrected_without_running_past_it(x, y, theta):
    """Behind the goal stands what is docked to; from past it the way is back first."""
    start = Pose2(x, y, theta)
    plan = PLANNER.plan(start)
    check_plan(plan, start, PLANNER, CAMERA)
    assert max(pose.x for pose in plan.rollout.poses) <= max(x, defaults.PLAN_PAST)
