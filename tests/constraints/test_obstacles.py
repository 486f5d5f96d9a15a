"""The obstacle barrier against plain geometry, finite differences and dense motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.constraints.barrier import HERE, Barrier, Sweep
from clfcbf.constraints.capsule import Capsule
from clfcbf.constraints.obstacle_set import Disc, Obstacles, Wall
from clfcbf.constraints.obstacles import Frame, ObstacleBarrier, stopping_time
from clfcbf.constraints.rows import Priority
from clfcbf.constraints.swept import ROUNDING
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc
from tests.constraints.sweeps import any_order, motions, rectangle, scene_of, sweeps, twists
from tests.constraints.test_capsule import axis_of, segments_apart

GAIN = 1.3
LOADED = Capsule.with_trolley()
SCENE = scene_of(2.0, 0.3, 0.4)

coordinate = st.floats(-3.0, 3.0)
discs = st.builds(Disc, coordinate, coordinate, st.floats(0.0, 0.4), st.just(0.0), st.just(0.0))
moving = st.builds(
    Disc, coordinate, coordinate, st.floats(0.0, 0.4), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)
)
walls = st.builds(Wall, coordinate, coordinate, coordinate, coordinate, st.floats(0.0, 0.2))
capsules = st.sampled_from([Capsule(0.55), LOADED, Capsule(0.2, 1.0, 0.6)])


def gap(footprint, robot, disc):
    """Distance of a disc from the footprint of a robot at a pose, in plain floats."""
    x, y = robot.seen((disc.x, disc.y))
    beyond = max(-footprint.back - x, 0.0, x - footprint.front)
    return math.hypot(beyond, y) - footprint.radius - disc.radius


def wall_gap(footprint, robot, wall):
    ends = robot.seen((wall.x0, wall.y0)), robot.seen((wall.x1, wall.y1))
    return segments_apart(*axis_of(footprint), *ends) - footprint.radius - wall.radius


def derivative(function, step=1e-3):
    """Central difference of order six."""
    weights = ((1, 45.0), (2, -9.0), (3, 1.0))
    return sum(w * (function(k * step) - function(-k * step)) for k, w in weights) / (60.0 * step)


def test_it_is_a_barrier():
    barrier = ObstacleBarrier(LOADED, GAIN)
    assert isinstance(barrier, Barrier)
    assert barrier.clearance(SCENE) == math.inf
    assert barrier.rows(SCENE).names == ()
    assert barrier.clearance_around(SCENE, Sweep()) == (math.inf, math.inf)
    assert barrier.clearance_along(SCENE, Sweep()) == math.inf


@given(capsules, moving, motions, twists, st.floats(0.0, 0.2), st.floats(0.0, 0.3))
def test_rows_are_rates_of_the_distance_to_a_moving_disc(
    footprint, disc, motion, twist, margin, spread
):
    assume(gap(footprint, motion, disc) > 0.05 - footprint.radius)
    barrier = ObstacleBarrier(footprint, GAIN, Obstacles([disc]), margin=margin, spread=spread)
    rows = barrier.rows(SCENE, motion)
    assert rows.names == ("obstacle.disc0",)
    assert rows.priority == Priority.SAFETY

    def h(t):
        there = disc._replace(x=disc.x + disc.v_x * t, y=disc.y + disc.v_y * t)
        return gap(footprint, motion.moved(twist, t), there) - margin

    assert rows.values[0] == pytest.approx(h(0.0), abs=1e-12)
    # Twice differentiable except where the foot reaches an end of the axis.
    x, _ = motion.seen((disc.x, disc.y))
    assume(min(abs(x - footprint.front), abs(x + footprint.back)) > 0.02)
    ((a_v, a_omega, b),) = rows.coefficients
    excess = a_v * twist.v + a_omega * twist.omega - b
    rate = derivative(h)
    assert excess == pytest.approx(-rate + spread - GAIN * h(0.0), rel=1e-5, abs=1e-6)


@given(capsules, walls, motions, twists)
def test_rows_of_a_wall_are_rates_of_its_distance(footprint, wall, motion, twist):
    """Where the distance is smooth, the row of the nearest pair is the rate of the distance."""
    assume(math.hypot(wall.x1 - wall.x0, wall.y1 - wall.y0) > 0.1)
    distance = wall_gap(footprint, motion, wall)
    assume(distance > 0.1 - footprint.radius)
    rows = ObstacleBarrier(footprint, GAIN, Obstacles(walls=[wall])).rows(SCENE, motion)
    assert min(rows.values) == pytest.approx(distance, abs=1e-7)
    order = np.argsort(rows.values)
    nearest = int(order[0])
    ends = {"start": (wall.x0, wall.y0), "end": (wall.x1, wall.y1)}
    # Each row by itself is the rate of one point before one segment.
    for name, (a_v, a_omega, b), value in zip(
        rows.names, rows.coefficients, rows.values, strict=True
    ):
        part = name.split(".")[-1]

        def h(t, part=part):
            robot = motion.moved(twist, t)
            if part in ends:
                x, y = ends[part]
                return gap(footprint, robot, Disc(x, y, wall.radius))
            at = robot.transform((footprint.front if part == "front" else -footprint.back, 0.0))
            seen = segments_apart(at, at, (wall.x0, wall.y0), (wall.x1, wall.y1))
            return seen - footprint.radius - wall.radius

        assert value == pytest.approx(h(0.0), abs=1e-7)
        slopes = [(h(step) - h(-step)) / (2 * step) for step in (1e-3, 2e-3)]
        if abs(slopes[0] - slopes[1]) > 1e-5:  # the foot passes an end within the difference
            continue
        excess = a_v * twist.v + a_omega * twist.omega - b
        assert excess == pytest.approx(-slopes[0] - GAIN * value, abs=2e-4)
    assert rows.values[nearest] == min(rows.values)


@given(capsules, st.lists(discs, max_size=4), st.lists(walls, max_size=3), motions)
def test_clearance_is_the_smallest_distance(footprint, round_ones, straight_ones, motion):
    assume(all(math.hypot(w.x1 - w.x0, w.y1 - w.y0) > 1e-2 for w in straight_ones))
    barrier = ObstacleBarrier(footprint, GAIN, Obstacles(round_ones, straight_ones))
    gaps = [gap(footprint, motion, disc) for disc in round_ones]
    gaps += [wall_gap(footprint, motion, wall) for wall in straight_ones]
    least = min(gaps, default=math.inf)
    assume(abs(least + footprint.radius) > 1e-6)
    # What reaches the axis is as deep as it gets.
    expected = least if least > -footprint.radius else -math.inf
    assert barrier.clearance(SCENE, motion) == pytest.approx(expected, abs=1e-6)


@settings(max_examples=150)
@given(
    capsules, st.lists(discs, max_size=3), st.lists(walls, max_size=2), sweeps,
    st.integers(0, 10**6),
)  # fmt: skip
def test_along_is_below_every_pose_in_every_order(
    footprint, round_ones, straight_ones, sweep, seed
):
    barrier = ObstacleBarrier(footprint, GAIN, Obstacles(round_ones, straight_ones), margin=0.05)
    bound = barrier.clearance_along(SCENE, sweep)
    lowest = min(barrier.clearance(SCENE, pose) for pose in any_order(sweep, seed))
    assert bound <= lowest + 2 * ROUNDING
    here, crude = barrier.clearance_around(SCENE, sweep)
    assert here == barrier.clearance(SCENE, sweep.motion)
    assert crude <= bound + ROUNDING


def test_along_is_tight():
    """Within 3 mm of the smallest clearance of a dense rectangle, or of its sign."""
    rng = np.random.default_rng(4)
    gaps, refused = [], []
    while len(gaps) < 40 or len(refused) < 40:
        sweep = Sweep.of(
            Pose2(*rng.uniform(-0.3, 0.3, 3)), Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.28,
            Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.45,
        )._replace(blur=0.0)  # fmt: skip
        disc = Disc(*rng.uniform(-2.0, 2.0, 2), 0.2)
        bound = ObstacleBarrier(LOADED, GAIN, Obstacles([disc])).clearance_along(SCENE, sweep)
        if -0.3 < bound < 0.0:
            least = min(gap(LOADED, pose, disc) for pose in rectangle(sweep, 20))
            inside = gap(LOADED, sweep.motion, disc) < 0.0
            (gaps if inside else refused).append(least - (bound if inside else 0.0))
    assert min(gaps) >= -2 * ROUNDING
    assert max(gaps) < 3e-3
    assert np.median(gaps) < 1e-3
    assert max(refused) < 3e-3


@given(st.floats(0.05, 0.3), st.floats(0.0, 0.2), st.floats(0.0, 0.25), st.floats(-3.0, 3.0))
def test_along_is_exact_on_the_way_out(v, body, lag, heading):
    """Inside the margin, driving straight away: the smallest clearance is the one now.

    Never less, not by a bit: the guard would refuse the way out.
    """
    motion = Pose2(0.3, -0.2, heading)
    wall = motion.transform((1.4, 0.1))
    barrier = ObstacleBarrier(LOADED, GAIN, Obstacles([Disc(*wall, 0.0)]), margin=0.3)
    sweep = Sweep.of(motion, Twist(-body, 0.0), lag, Twist(-v, 0.0), 0.4)
    here = barrier.clearance(SCENE, motion)
    assert here < 0.0
    assert 0.0 <= barrier.clearance_along(SCENE, sweep) - here <= 2 * ROUNDING
    inward = Sweep.of(motion, Twist(body, 0.0), lag, Twist(0.0, 0.0), 0.4)
    coasted = barrier.clearance(SCENE, motion.moved(Twist(body, 0.0), lag))
    assert 0.0 <= barrier.clearance_along(SCENE, inward) - coasted <= 2 * ROUNDING


@settings(max_examples=100)
@given(capsules, moving, sweeps, st.floats(0.0, 0.5), st.integers(0, 10**6))
def test_along_covers_a_moving_disc_until_the_robot_stands(footprint, disc, sweep, spread, seed):
    barrier = ObstacleBarrier(footprint, GAIN, Obstacles([disc]), spread=spread)
    bound = barrier.clearance_along(SCENE, sweep)
    rng = np.random.default_rng(seed)
    worst = math.inf
    for pose in any_order(sweep, seed, paths=3, steps=4):
        for t in (0.0, 1.0, float(rng.uniform())):
            time = t * stopping_time(sweep)
            error = time * spread * float(rng.uniform())
            angle = float(rng.uniform(-3.0, 3.0))
            there = disc._replace(
                x=disc.x + disc.v_x * time + error * math.cos(angle),
                y=disc.y + disc.v_y * time + error * math.sin(angle),
            )
            worst = min(worst, gap(footprint, pose, there))
    assert bound <= worst + 2 * ROUNDING
    assert barrier.clearance_around(SCENE, sweep)[1] <= bound + 1e-12


def test_the_time_to_stand_is_longer_than_the_brake():
    limits, period = Limits(0.4, 0.6, 0.3, 1.0), 1 / 30
    for twist in (Twist(0.4, 0.0), Twist(0.1, 0.6), Twist(0.0, 0.0)):
        ticks = limits.brake_ticks(twist, period)
        sweep = Sweep.of(HERE, twist, 0.2, twist, 0.5 * period * (ticks + 1))
        after = stopping_time(sweep) - ticks * period
        assert math.exp(-after / 0.2) <= 0.05


@given(st.lists(moving, min_size=1, max_size=3), st.lists(walls, max_size=2), motions, motions)
def test_the_frame_of_the_goal(round_ones, straight_ones, goal, motion):
    obstacles = Obstacles(round_ones, straight_ones)
    scene = Scene(goal, goal, 0.0)
    there = ObstacleBarrier(LOADED, GAIN, obstacles, Frame.GOAL)
    here = ObstacleBarrier(LOADED, GAIN, obstacles.seen_in(goal))
    assert there.clearance(scene, motion) == pytest.approx(here.clearance(scene, motion), abs=1e-9)
    rows, same = there.rows(scene, motion), here.rows(scene, motion)
    assert rows.names == same.names
    np.testing.assert_allclose(rows.A, same.A, atol=1e-9)
    np.testing.assert_allclose(rows.b, same.b, atol=1e-9)
    # A disc in the frame of the goal is where the goal's pose puts it.
    x, y = goal.transform(round_ones[0][:2])
    assert obstacles.seen_in(goal).columns.points[:2, 0] == pytest.approx([x, y])


def test_a_provider_is_asked_with_the_scene():
    asked = []

    def given_for(scene):
        asked.append(scene)
        return Obstacles([Disc(1.0 + scene.stamp, 0.0, 0.1)])

    barrier = ObstacleBarrier(Capsule(0.5), GAIN, given_for)
    assert barrier.clearance(SCENE._replace(stamp=1.0)) == pytest.approx(1.4)
    assert barrier.clearance(SCENE) == pytest.approx(0.4)
    assert [scene.stamp for scene in asked] == [1.0, 0.0]
    fixed = barrier.with_obstacles(Obstacles([Disc(3.0, 0.0, 0.0)]))
    assert fixed.clearance(SCENE) == pytest.approx(2.5)
    assert fixed.name == barrier.name


@given(st.lists(moving, max_size=12), twists)
def test_rows_left_out_hold_for_every_command_within_the_limits(round_ones, twist):
    limits = Limits(0.5, 0.8, 0.3, 1.0, v_min=-0.2)
    obstacles = Obstacles(round_ones)
    every = ObstacleBarrier(LOADED, GAIN, obstacles, most_rows=100).rows(SCENE)
    assert len(every.names) == len(round_ones)
    kept = ObstacleBarrier(LOADED, GAIN, obstacles, limits=limits, most_rows=100).rows(SCENE)
    command = (min(max(twist.v, -0.2), 0.5), twist.omega)
    for name, (a_v, a_omega, b) in zip(every.names, every.coefficients, strict=True):
        if name not in kept.names:
            assert a_v * command[0] + a_omega * command[1] <= b
    corners = [(v, w) for v in (-0.2, 0.5) for w in (-0.8, 0.8)]
    for a_v, a_omega, b in kept.coefficients:
        assert max(a_v * v + a_omega * w for v, w in corners) > b


def test_the_rows_kept_are_the_nearest():
    rng = np.random.default_rng(0)
    points = rng.uniform(-8.0, 8.0, (500, 2))
    points = points[np.hypot(*points.T) > 2.5]
    barrier = ObstacleBarrier(Capsule(0.5), GAIN, Obstacles.from_points(points, 0.05), most_rows=5)
    rows = barrier.rows(SCENE)
    ranges = np.sort(np.hypot(*points.T))[:5] - 0.55
    assert sorted(rows.values) == pytest.approx(ranges)
    assert len(set(rows.names)) == 5


def test_bare_has_no_margin():
    barrier = ObstacleBarrier(Capsule(0.5), GAIN, Obstacles([Disc(1.0, 0.0, 0.1)]), margin=0.3)
    assert barrier.clearance(SCENE) == pytest.approx(0.1)
    assert barrier.bare.clearance(SCENE) == pytest.approx(0.4)


def test_an_obstacle_on_the_axis_gives_no_guidance():
    barrier = ObstacleBarrier(LOADED, GAIN, Obstacles([Disc(0.5, 0.0, 0.1)]))
    assert barrier.clearance(SCENE) == -math.inf
    assert barrier.rows(SCENE).coefficients[0][:2] == (0.0, 0.0)
    crossed = ObstacleBarrier(LOADED, GAIN, Obstacles(walls=[Wall(0.4, -2.0, 0.4, 2.0)]))
    assert crossed.clearance(SCENE) == -math.inf
    assert crossed.clearance_along(SCENE, Sweep()) == -math.inf


@given(st.lists(moving, max_size=3), st.floats(0.0, 2.0), st.floats(0.0, 1.0))
def test_carrying_a_measurement_forward(round_ones, duration, spread):
    after = Obstacles(round_ones, [Wall(0, 1, 2, 3)]).after(duration, spread)
    for column, disc in zip(after.columns.points.T, round_ones, strict=False):
        expected = disc.x + duration * disc.v_x, disc.y + duration * disc.v_y
        assert column == pytest.approx([*expected, disc.radius + spread * duration])
    assert after.columns.edges[:, 0] == pytest.approx([0, 1, 2, 3, 0])
    merged = after.merged([Obstacles([Disc(9, 9, 0)])])
    assert len(merged) == len(round_ones) + 2
    assert merged.columns.points[:2, len(round_ones)] == pytest.approx([9, 9])


def test_a_snapshot_does_not_change():
    table = np.array([[1.0, 0.0, 0.1, 0.0, 0.0]])
    obstacles = Obstacles(table)
    table[0, 0] = 5.0
    assert obstacles.columns.points[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        obstacles.columns.points[0, 0] = 2.0


@pytest.mark.parametrize(
    "rows",
    [
        [(1, 2, math.nan, 0, 0)],
        [(1, 2, 1e200, 0, 0)],
        [(1, 2, -0.1, 0, 0)],
        [(1, 2, 3)],
        [("a", 0, 0, 0, 0)],
    ],
)
def test_bad_obstacles(rows):
    with pytest.raises(GeometryError, match="discs"):
        Obstacles(rows)
    with pytest.raises(GeometryError, match="walls"):
        Obstacles(walls=[(*row[:2], 0, 0, row[2]) if len(row) == 5 else row for row in rows])


@pytest.mark.parametrize(
    "setting",
    [
        {"gain": 0.0}, {"margin": -1.0}, {"spread": math.nan}, {"most_rows": 0},
        {"frame": "map"}, {"obstacles": [Disc(1, 1, 1)]},
    ],
)  # fmt: skip
def test_bad_settings(setting):
    with pytest.raises(ConfigurationError, match=next(iter(setting))):
        ObstacleBarrier(**{"footprint": LOADED, "gain": 1.0, **setting})


def test_motions_that_are_not_finite():
    barrier = ObstacleBarrier(LOADED, GAIN, Obstacles([Disc(3, 0, 0.1)]), Frame.GOAL)
    lost = Pose2(math.nan, 0.0, 0.0)
    for ask in (barrier.rows, barrier.clearance):
        with pytest.raises(GeometryError, match="motion"):
            ask(SCENE, lost)
        with pytest.raises(GeometryError, match="goal"):
            ask(SCENE._replace(goal=lost))
    for ask in (barrier.clearance_along, barrier.clearance_around):
        with pytest.raises(GeometryError, match="motion"):
            ask(SCENE, Sweep(lost))


def test_the_turn_moves_a_far_point_of_the_footprint():
    """A disc beside the trolley is hit by turning, which the disc-shaped robot never does."""
    beside = Obstacles([Disc(0.7, 0.7, 0.05)])
    sweep = Sweep.of(HERE, Twist(0, 0), 0.0, Twist(0.0, 0.8), 0.5)
    assert ObstacleBarrier(LOADED, GAIN, beside).clearance_along(SCENE, sweep) < 0.0
    assert ObstacleBarrier(Capsule(0.55), GAIN, beside).clearance_along(SCENE, sweep) > 0.0
    assert gap(LOADED, arc(Twist(0.0, 0.8), 0.5), Disc(0.7, 0.7, 0.05)) < 0.0
