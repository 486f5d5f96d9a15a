"""Unequal and cut views against plain bearings, finite differences and dense motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import HERE, Barrier, Sweep
from clfcbf.constraints.cbf import Edge, FieldOfViewBarrier
from clfcbf.constraints.swept import ROUNDING
from clfcbf.constraints.view import ViewBarrier
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc
from tests.constraints.sweeps import any_order, motions, rectangle, scene_of, sweeps, twists
from tests.constraints.test_obstacles import derivative

GAIN = 1.3
CAMERA = Pose2(0.2, -0.05, 0.1)
ARM = Edge.through((0.5, 0.3), 0.4, inward=-1.0)
"""A part of the robot to the left: the view ends at a ray from its tip."""

views = st.builds(
    ViewBarrier,
    st.builds(Pose2, st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-1.2, 1.2)),
    st.floats(-0.2, 1.2),
    st.floats(0.4, 1.2),
    st.just(GAIN),
    cuts=st.sampled_from([(), (ARM,)]),
    width=st.sampled_from([0.0, 0.4]),
    bearing_error=st.sampled_from([0.0, 0.05]),
    range_error=st.sampled_from([0.0, 0.1]),
    margin=st.just(0.0),
    setback=st.sampled_from([0.0, 0.02]),
    name=st.just("view"),
)
coordinate = st.floats(-2.0, 3.0)


def seen_from(camera, robot, feature):
    x, y = camera.seen(robot.seen(feature))
    return math.hypot(x, y), math.atan2(y, x)


@given(
    st.floats(-0.3, 1.2), st.floats(0.35, 1.2), coordinate, coordinate, motions,
)  # fmt: skip
def test_in_view_is_a_bearing_between_the_two_angles(left, right, x, y, motion):
    view = ViewBarrier(CAMERA, left, right, GAIN)
    scene = scene_of(x, y)
    reach, bearing = seen_from(CAMERA, motion, (x, y))
    clearance = view.clearance(scene, motion)
    assume(reach > 1e-3)
    slack = min(left - bearing, right + bearing)
    assume(abs(slack) > 1e-6)
    assume(abs(abs(bearing) - math.pi / 2) > 1e-9)
    assert (clearance >= 0.0) == (slack > 0.0)
    if abs(bearing) > math.pi / 2:
        assert clearance == -math.inf
    else:
        nearest = reach * min(math.sin(left - bearing), math.sin(right + bearing))
        assert clearance == pytest.approx(nearest, abs=1e-9)


@given(views, coordinate, coordinate, st.floats(-3.0, 3.0), motions, twists)
def test_rows_are_rates_of_distances_to_the_edges(view, x, y, heading, motion, twist):
    scene = scene_of(x, y, heading)
    rows = view.rows(scene, motion)
    edges = {name.removeprefix("view."): edge for name, edge in zip(
        ("left", "right", "cut0"), view.edges, strict=False)}  # fmt: skip
    points = view._points(scene.feature)
    for name, (a_v, a_omega, b), value in zip(
        rows.names, rows.coefficients, rows.values, strict=True
    ):
        _, edge, *number = name.split(".")
        n_x, n_y, offset = edges[edge]
        point = points[int(number[0]) if number else 0]

        def h(t, point=point, n_x=n_x, n_y=n_y, offset=offset):
            at_x, at_y = motion.moved(twist, t).seen(point)
            return n_x * at_x + n_y * at_y - offset

        assert value == pytest.approx(h(0.0), abs=1e-12)
        excess = a_v * twist.v + a_omega * twist.omega - b
        assert excess == pytest.approx(-derivative(h) - GAIN * value, rel=1e-6, abs=1e-7)


@given(views, coordinate, coordinate, st.floats(-3.0, 3.0), twists)
def test_rows_left_out_ask_for_less(view, x, y, heading, twist):
    """A command that keeps the rows keeps those of every point that is kept in view."""
    scene = scene_of(x, y, heading)
    rows = view.rows(scene)
    slack = min(b - a_v * twist.v - a_omega * twist.omega for a_v, a_omega, b in rows.coefficients)
    each = math.inf
    for p_x, p_y in view._points(scene.feature):
        for n_x, n_y, offset in view.edges:
            h = n_x * p_x + n_y * p_y - offset
            rate = -n_x * twist.v + (n_x * p_y - n_y * p_x) * twist.omega
            each = min(each, rate + GAIN * h)
    assert slack == pytest.approx(each, abs=1e-9)


@settings(max_examples=150)
@given(views, coordinate, coordinate, st.floats(-3.0, 3.0), sweeps, st.integers(0, 10**6))
def test_along_is_below_every_pose_in_every_order(view, x, y, heading, sweep, seed):
    scene = scene_of(x, y, heading)
    bound = view.clearance_along(scene, sweep)
    lowest = min(view.clearance(scene, pose) for pose in any_order(sweep, seed))
    assert bound <= lowest + 2 * ROUNDING
    here, crude = view.clearance_around(scene, sweep)
    assert here == view.clearance(scene, sweep.motion)
    assert crude <= bound + ROUNDING


def test_along_is_tight():
    rng = np.random.default_rng(6)
    view = ViewBarrier(CAMERA, 0.3, 0.9, GAIN, cuts=(ARM,))
    gaps, refused = [], []
    while len(gaps) < 30 or len(refused) < 30:
        sweep = Sweep.of(
            HERE, Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.28,
            Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.45,
        )._replace(blur=0.0)  # fmt: skip
        scene = scene_of(*rng.uniform((0.8, -1.5), (2.5, 1.0)))
        bound = view.clearance_along(scene, sweep)
        if -0.2 < bound < 0.0:
            least = min(view.clearance(scene, pose) for pose in rectangle(sweep, 12))
            inside = view.clearance(scene) >= 0.0
            (refused if inside else gaps).append(least - (0.0 if inside else bound))
    assert min(gaps) >= -2 * ROUNDING
    assert max(gaps) < 3e-3
    assert max(refused) < 3e-3


@given(st.floats(0.05, 0.5), st.floats(0.0, 0.5))
def test_along_is_exact_on_the_way_back(omega, turning):
    """Beyond the left edge, turning left: the clearance to be kept is the one now."""
    view = ViewBarrier(Pose2(0.2, 0.0, 0.0), 0.3, 0.9, GAIN)
    scene = scene_of(1.5, 0.6)
    here = view.clearance(scene)
    assert here < 0.0
    sweep = Sweep.of(HERE, Twist(0.0, turning), 0.12, Twist(0.0, omega), 0.3)
    assert 0.0 <= view.clearance_along(scene, sweep) - here <= 2 * ROUNDING


@given(st.floats(0.2, 1.2), coordinate, coordinate, sweeps)
def test_equal_edges_decide_like_the_field_of_view(half_angle, x, y, sweep):
    """Where the field of view answers, a view with the same edges says safe no more often."""
    camera = FieldOfView(half_angle, Pose2(0.2, 0.0, 0.0))
    equal = ViewBarrier(camera.camera, half_angle, half_angle, GAIN)
    scene = scene_of(x, y)
    angle = FieldOfViewBarrier(camera, GAIN)
    least = angle.clearance(scene)
    assume(abs(least) > 1e-9)
    assert (least >= 0.0) == (equal.clearance(scene) >= 0.0)
    np.testing.assert_allclose(equal.rows(scene).A, angle.rows(scene).A, atol=1e-12)
    if equal.clearance_along(scene, sweep) > 1e-9:
        assert min(angle.clearance(scene, pose) for pose in rectangle(sweep, 5)) >= 0.0


def test_a_camera_that_looks_aside_is_answered_for():
    """Yawed by 60°: both ends of the arc in view, the middle out, where corners are not enough."""
    twist, duration = Twist(0.35, 0.25), 1.2
    bearing = math.radians(25)
    rho = twist.v * math.sin(bearing) / twist.omega - 0.2 * math.cos(bearing)
    halfway = (0.2 + rho * math.cos(bearing), rho * math.sin(bearing))
    x, y = arc(twist, -0.5 * duration).seen(halfway)
    scene = scene_of(x, y)
    camera = Pose2(0.2, 0.0, math.radians(60))
    view = ViewBarrier(camera, 0.6, math.radians(35 - 0.4), GAIN)
    sweep = Sweep.of(HERE, Twist(0, 0), 0.0, twist, duration)
    assert min(view.clearance(scene, pose) for pose in sweep.corners()) > 0.0
    middle = view.clearance(scene, arc(twist, 0.5 * duration))
    assert middle < -1e-3
    assert view.clearance_along(scene, sweep) <= middle + 2 * ROUNDING
    # It is the middle that it looks at: a view that holds that is admitted.
    wider = ViewBarrier(camera, 0.6, math.radians(35 + 0.4), GAIN)
    assert wider.clearance_along(scene, sweep) >= 0.0


@given(st.floats(0.0, 1.2), st.floats(0.0, 1.2), st.floats(1.5, 3.0), st.floats(-1.0, 1.0), twists)
def test_edges_with_the_forward_direction_inside_have_their_extremes_at_the_ends(
    left, right, x, y, twist
):
    """The end-point theorem, edge by edge, for a feature that stays ahead."""
    assume(left + right > 0.1)
    view = ViewBarrier(Pose2(0.2, 0.0, 0.0), left, right, GAIN)
    seen = [arc(twist, t).seen((x, y)) for t in np.linspace(0.0, 0.9, 30)]
    assume(min(s[0] for s in seen) > 0.2)
    for n_x, n_y, offset in view.edges:
        depths = [n_x * s[0] + n_y * s[1] - offset for s in seen]
        if min(depths[0], depths[-1]) >= 0.0:
            assert min(depths) >= -1e-9


def test_a_cut_is_kept():
    view = ViewBarrier(Pose2(0.0, 0.0, 0.0), 0.9, 0.9, GAIN, cuts=(ARM,))
    behind_the_arm = scene_of(1.0, 0.9)
    assert ViewBarrier(Pose2(0.0, 0.0, 0.0), 0.9, 0.9, GAIN).clearance(behind_the_arm) > 0.0
    assert view.clearance(behind_the_arm) < 0.0
    assert view.rows(behind_the_arm).names == ("view.left", "view.right", "view.cut0")


def test_both_ends_of_a_feature():
    camera = FieldOfView(0.6, Pose2(0.2, 0.0, 0.0), width=0.5)
    view = ViewBarrier(camera.camera, 0.6, 0.6, GAIN, width=0.5)
    for heading in (-0.5, 0.0, 0.7):
        scene = scene_of(1.0, 0.2, heading)
        ends = FieldOfViewBarrier(camera, GAIN).clearance(scene)
        assert (view.clearance(scene) >= 0.0) == (ends >= 0.0)


def test_margin_and_setback_are_the_field_of_views():
    camera = FieldOfView(0.6, Pose2(0.2, 0.1, 0.3))
    angle = FieldOfViewBarrier(camera, GAIN, margin=0.05, setback=0.03)
    view = ViewBarrier(camera.camera, 0.6, 0.6, GAIN, margin=0.05, setback=0.03)
    assert np.array(view.edges) == pytest.approx(np.array(angle.edges))
    assert np.array(view.bare.edges) == pytest.approx(np.array(angle.bare.edges))
    assert isinstance(view, Barrier)


@pytest.mark.parametrize(
    "setting",
    [
        {"gain": -1.0}, {"camera": Pose2(math.nan, 0, 0)}, {"left": 1.6}, {"right": math.nan},
        {"width": -1.0}, {"bearing_error": 1.6}, {"range_error": math.inf}, {"setback": -0.1},
        {"margin": 0.4}, {"left": -0.5}, {"cuts": (Edge(2.0, 0.0, 0.0),)},
    ],
)  # fmt: skip
def test_bad_settings(setting):
    (name,) = setting
    with pytest.raises(ConfigurationError, match=name):
        ViewBarrier(**{"camera": HERE, "left": 0.3, "right": 0.5, "gain": 1.0, **setting})


def test_scenes_that_are_not_finite():
    view = ViewBarrier(HERE, 0.3, 0.5, GAIN)
    lost = Scene(HERE, Pose2(math.nan, 0.0, 0.0), 0.0)
    for ask in (view.rows, view.clearance):
        with pytest.raises(GeometryError, match="feature"):
            ask(lost)
        with pytest.raises(GeometryError, match="motion"):
            ask(scene_of(1.0, 0.0), Pose2(0.0, math.nan, 0.0))
    for ask in (view.clearance_along, view.clearance_around):
        with pytest.raises(GeometryError, match="motion"):
            ask(scene_of(1.0, 0.0), Sweep(Pose2(math.inf, 0.0, 0.0)))
    with pytest.raises(GeometryError, match="heading"):
        ViewBarrier(HERE, 0.3, 0.5, GAIN, width=0.4).clearance(scene_of(1.0, 0.0, math.nan))
