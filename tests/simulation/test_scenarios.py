"""Start regions as data: the table, the starts drawn from it, and what happens on the way."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.campaign import EpisodeSpec, simulate
from clfcbf.simulation.events import Nudges
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.regions import Markers, Nudge, Region, parse_regions
from clfcbf.simulation.scenarios import (
    LIMITS,
    REGIONS,
    World,
    draw_start,
    facing,
    must_reverse,
    region_named,
    visible_share,
    world_of,
)

WORLD = World()
REST = Twist(0.0, 0.0)
poses = st.builds(Pose2, st.floats(-3.0, 0.3), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))


def bearing_of(point, pose, camera):
    """Bearing of a point of the goal's frame in the camera, by complex numbers."""
    eye = complex(pose.x, pose.y) + np.exp(1j * pose.theta) * complex(camera.x, camera.y)
    return float(np.angle((complex(*point) - eye) * np.exp(-1j * (pose.theta + camera.theta))))


def sampled_share(pose, world, count=20_001):
    """Share of points of the board within the view, one by one."""
    half = 0.5 * world.board_width
    ends = np.linspace(-half, half, count)
    inside = [
        abs(bearing_of((world.standoff, y), pose, world.camera.camera)) <= world.camera.half_angle
        for y in ends
    ]
    return float(np.mean(inside))


def starts(name, count=200):
    region = region_named(name)
    world = world_of(region)
    rngs = (np.random.default_rng([9, i]) for i in range(count))
    return world, [draw_start(region, WORLD, rng) for rng in rngs]


# --- the table ----------------------------------------------------------------------------------


def test_table_has_the_protocols_regions():
    assert list(REGIONS) == [f"R{k}" for k in range(1, 9)]
    assert (REGIONS["R1"].e_lon, REGIONS["R1"].e_lat) == ((-2.5, -1.5), (-1.0, 1.0))
    assert REGIONS["R2"].visible == (0.2, 0.6)
    assert REGIONS["R6"].limits == "docking"
    assert REGIONS["R6"].markers == Markers(0.4, 0.003, 10.0)
    assert REGIONS["R6"].camera(WORLD.camera) == FieldOfView(WORLD.camera.half_angle)
    assert REGIONS["R7"].camera(WORLD.camera).half_angle == pytest.approx(math.radians(25.0))
    assert REGIONS["R8"].nudges == (Nudge(0.05, math.radians(3.0), e_lon=-1.0),)
    assert all(region.about for region in REGIONS.values())


def test_a_region_is_added_by_a_table():
    (region,) = parse_regions(
        '[shed]\nabout = "x"\ne_lon = [-1, -0.5]\ne_lat = [0, 1]\nbearing = 0.5\n'
        "nudge = [{ time = 2.0, distance = 0.1 }]"
    ).values()
    assert region == Region(
        (-1.0, -0.5), (0.0, 1.0), False, 0.5, "x", nudges=(Nudge(0.1, time=2.0),)
    )


BOX = 'about = "x"\ne_lon = [-1, -0.5]\ne_lat = [0, 1]\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[R", "no TOML"),
        (f"[a]\n{BOX}bearing = 0.5\ncolour = 1", "unknown key 'colour'; choose from about"),
        ('[a]\nabout = "x"\ne_lon = [0, 1]\nbearing = 1', "e_lat is missing"),
        (f"[a]\n{BOX}", "bearing or visible"),
        (f"[a]\n{BOX}bearing = 0.5\nvisible = [0, 1]", "bearing or visible"),
        (f"[a]\n{BOX}bearing = 1.5", "share"),
        (f"[a]\n{BOX}visible = [0.9, 0.1]", "finite range"),
        (f"[a]\n{BOX}bearing = 0.5\ncamera = {{ z = 1 }}", "choose from x, half_angle_deg"),
        (f"[a]\n{BOX}bearing = 0.5\nmarkers = {{ sigma = 1 }}", "distance is missing"),
        (f"[a]\n{BOX}bearing = 0.5\nnudge = [{{ distance = 1 }}]", "one of the two"),
        (f"[a]\n{BOX}bearing = 0.5\nnudge = [{{ distance = -1, time = 1 }}]", "at least 0"),
        ('[a]\nabout = "x"\ne_lon = 3\ne_lat = [0, 1]\nbearing = 1', "region a"),
    ],
)
def test_what_is_wrong_with_a_table_is_named(text, told):
    with pytest.raises(ConfigurationError, match=told.replace("(", r"\(")):
        parse_regions(text)


# --- starts -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REGIONS)
def test_starts_are_in_their_box_and_see_what_they_should(name):
    region = region_named(name)
    world, found = starts(name)
    for pose in found:
        assert region.e_lon[0] <= pose.x <= region.e_lon[1]
        across = abs(pose.y) if region.two_sided else pose.y
        assert region.e_lat[0] <= across <= region.e_lat[1]
        bearing = bearing_of((world.standoff, 0.0), pose, world.camera.camera)
        if region.visible is None:
            assert abs(bearing) <= region.bearing * world.camera.half_angle + 1e-9
        else:
            share = sampled_share(pose, world, 2001)
            assert region.visible[0] - 1e-3 <= share <= region.visible[1] + 1e-3
    sides = [pose.y > 0.0 for pose in found]
    assert 0.3 < np.mean(sides) < 0.7
    headings = [bearing_of((world.standoff, 0.0), p, world.camera.camera) > 0.0 for p in found]
    assert 0.3 < np.mean(headings) < 0.7


def test_both_markers_are_in_view_of_every_start():
    world, found = starts("R6", 500)
    half = 0.5 * REGIONS["R6"].markers.distance
    for pose in found:
        for y in (-half, half):
            bearing = bearing_of((world.standoff, y), pose, world.camera.camera)
            assert abs(bearing) < world.camera.half_angle


def test_starts_are_the_same_for_one_seed_and_spread_over_the_box():
    region = REGIONS["R1"]
    draw = [draw_start(region, WORLD, np.random.default_rng([1, i])) for i in range(300)]
    again = [draw_start(region, WORLD, np.random.default_rng([1, i])) for i in range(300)]
    assert draw == again
    x, y, _ = np.array(draw).T
    assert (x.mean(), x.std()) == pytest.approx((-2.0, 1.0 / math.sqrt(12.0)), abs=0.05)
    assert (y.mean(), y.std()) == pytest.approx((0.0, 2.0 / math.sqrt(12.0)), abs=0.1)


@given(poses)
def test_visible_share_is_that_of_the_points_one_by_one(pose):
    assert visible_share(pose, WORLD) == pytest.approx(sampled_share(pose, WORLD, 1001), abs=2e-3)


@given(st.floats(-2.5, 0.0), st.floats(-1.0, 1.0), st.floats(-0.6, 0.6), st.floats(-0.25, 0.25))
def test_facing_puts_a_point_under_its_bearing(x, y, bearing, end):
    pose = facing(x, y, bearing, WORLD, (WORLD.standoff, end))
    seen = bearing_of((WORLD.standoff, end), pose, WORLD.camera.camera)
    assert seen == pytest.approx(bearing, abs=1e-9)


def turned_at_the_edge(rho, world):
    """Most that the line of sight turns on the way in, by quadrature along the view's edge."""
    cx, half = world.camera.camera.x, world.camera.half_angle

    def bearing(r):
        def over(phi):  # where the camera sees the point at its edge
            return math.atan2(r * math.sin(phi), r * math.cos(phi) - cx) - half

        return brentq(over, 0.0, half)

    return quad(lambda r: math.tan(bearing(r)) / r, world.standoff, rho)[0]


@pytest.mark.parametrize("half_angle", [25.0, 35.0])
@pytest.mark.parametrize(("x", "y"), [(-0.4, 0.3), (-0.9, 0.5), (-0.3, 0.21), (-2.0, 1.0)])
def test_reversing_is_needed_where_the_edge_of_the_view_turns_too_little(x, y, half_angle):
    world = World(camera=FieldOfView(math.radians(half_angle), Pose2(0.2, 0.0, 0.0)))
    rho = math.hypot(world.standoff - x, y)
    delta = math.atan2(y, world.standoff - x)
    needed = delta > turned_at_the_edge(rho, world)
    for side in (-1.0, 1.0):
        assert must_reverse(Pose2(x, side * y, 0.3), world) == needed


def test_reversing_is_needed_from_closer_than_the_goal_and_in_r5_alone():
    assert must_reverse(Pose2(0.1, 0.0, 0.0), WORLD)
    assert all(must_reverse(pose, starts("R5", 1)[0]) for pose in starts("R5")[1])
    assert not any(must_reverse(pose, WORLD) for pose in starts("R1")[1])


def test_region_without_a_start_that_has_to_reverse_is_refused():
    region = Region((-2.0, -1.9), (0.0, 0.01), False, 0.0, "", needs_reversing=True)
    with pytest.raises(ConfigurationError, match="has to reverse"):
        draw_start(region, WORLD, np.random.default_rng(0))


# --- limits, camera and events of a region --------------------------------------------------------


def test_limits_are_the_regions_unless_a_run_names_others():
    assert EpisodeSpec().limits == "approaching"
    assert EpisodeSpec(region="R6").limits == "docking"
    assert EpisodeSpec(region="R6", limits="approaching").limits == "approaching"


def test_runs_are_made_in_the_regions_world():
    told = []

    def make(world, limits, lag):
        told.append((world, limits, lag))
        raise RuntimeError

    for name in ("R1", "R6", "R7"):
        with pytest.raises(RuntimeError):
            simulate(EpisodeSpec(region=name), make=make)
    (w1, l1, lag), (w6, l6, _), (w7, _, _) = told
    assert (w1, l1, lag) == (WORLD, LIMITS["approaching"], Body().lag)
    assert (w6.camera.camera.x, l6) == (0.0, LIMITS["docking"])
    assert w7.camera.half_angle == pytest.approx(math.radians(25.0))


def plant_at(x, y=0.0, theta=0.0):
    return KinematicPlant(
        Pose2(x, y, theta), LIMITS["approaching"], Body.ideal(), np.random.default_rng(0)
    )


def test_nudge_moves_the_target_once_when_the_robot_is_there():
    nudges = Nudges([Nudge(0.05, math.radians(3.0), e_lon=-1.0)], np.random.default_rng(4))
    plant = plant_at(-1.02, 0.2, 0.1)
    plant.send(Twist(0.2, 0.0))
    crossed = None
    for k in range(30):
        before = plant.pose()
        nudges(plant)
        after = plant.pose()
        if after != before:
            assert crossed is None
            crossed = k
            assert before.x >= -1.0
            shift = before.compose(after.inverse())  # of the goal, in its old frame
            assert math.hypot(shift.x, shift.y) == pytest.approx(0.05)
            assert abs(shift.theta) == pytest.approx(math.radians(3.0))
        plant.advance(1.0 / 30.0)
    assert crossed is not None


def test_nudge_at_a_time_and_the_same_for_one_seed():
    def shifted(seed):
        plant = plant_at(-2.0)
        nudges = Nudges([Nudge(0.1, time=0.5)], np.random.default_rng(seed))
        while plant.time < 1.0:
            nudges(plant)
            assert (plant.pose() == Pose2(-2.0, 0.0, 0.0)) == (plant.time < 0.5)
            plant.advance(0.1)
        return plant.pose()

    assert shifted(1) == shifted(1)
    directions = [math.atan2(p.y, p.x + 2.0) for p in map(shifted, range(40))]
    assert min(directions) < -1.5
    assert max(directions) > 1.5


def test_target_of_r8_moves_on_the_way():
    _, trace = simulate(EpisodeSpec(region="R8", seed=5, ideal=True))
    at = [b[2] - a[2] for a, b in zip(trace.poses, trace.poses[1:], strict=False)]
    jumps = [k for k, turn in enumerate(at) if abs(turn) > math.radians(2.0)]  # 0.8° at most else
    assert len(jumps) == 1
    before, after = trace.poses[jumps[0]], trace.poses[jumps[0] + 1]
    driven = trace.decisions[jumps[0]].twist
    shift = before.moved(driven, 1.0 / 30.0).compose(after.inverse())
    assert math.hypot(shift.x, shift.y) == pytest.approx(0.05)
    assert abs(shift.theta) == pytest.approx(math.radians(3.0))
    assert before.x < -1.0 <= before.moved(driven, 1.0 / 30.0).x


@given(poses)
def test_share_is_symmetric_to_the_axis(pose):
    mirrored = Pose2(pose.x, -pose.y, -pose.theta)
    assume(math.isfinite(pose.theta))
    share = visible_share(pose, WORLD)
    assert visible_share(mirrored, WORLD) == pytest.approx(share, abs=1e-9)
