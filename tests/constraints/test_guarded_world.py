"""The guard with these barriers: an adversary at the stick, a body that lags, the world judged.

The judge is plain geometry in the world's own frame, at four instants a tick.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import FieldOfView, SafetyFilter
from clfcbf.constraints.barrier import HERE
from clfcbf.constraints.capsule import Capsule
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.obstacle_set import Disc, Obstacles, Wall
from clfcbf.constraints.obstacles import Frame, ObstacleBarrier
from clfcbf.constraints.range_band import RangeBarrier
from clfcbf.constraints.view import ViewBarrier
from clfcbf.decision import Status
from clfcbf.estimation import body_after
from clfcbf.guard import Brake, Guard
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist
from tests.constraints.test_capsule import axis_of, segments_apart

PERIOD = 1 / 30
REST = Twist(0.0, 0.0)
LIMITS = Limits(0.4, 0.8, 0.5, 1.5)
LOADED = Capsule(0.3, front=0.5)
FEATURE = Pose2(2.2, 0.1, 0.0)
GOAL = Pose2(1.6, 0.1, 0.0)

DISCS = [Disc(1.0, 1.1, 0.2), Disc(-0.7, -0.6, 0.1), Disc(0.3, -1.0, 0.25), Disc(-0.9, 0.8, 0.2)]
WALLS = [Wall(-1.2, 1.4, 1.5, 1.5, 0.05), Wall(1.6, -1.5, 1.8, 1.5)]

bang_bang = st.lists(
    st.tuples(
        st.sampled_from([-9.0, 0.0, 9.0]), st.sampled_from([-9.0, 0.0, 9.0]), st.integers(3, 30)
    ),
    min_size=3,
    max_size=8,
)


def clear(footprint, robot, discs, walls=()):
    """Smallest distance of the footprint from anything."""
    least = math.inf
    for x, y, radius, *_ in discs:
        at_x, at_y = robot.seen((x, y))
        beyond = max(-footprint.back - at_x, 0.0, at_x - footprint.front)
        least = min(least, math.hypot(beyond, at_y) - footprint.radius - radius)
    for wall in walls:
        ends = robot.seen(wall[:2]), robot.seen(wall[2:4])
        apart = segments_apart(*axis_of(footprint), *ends)
        least = min(least, apart - footprint.radius - wall.radius)
    return least


def scene_from(robot, stamp=0.0):
    return Scene(robot.relative(GOAL), robot.relative(FEATURE), stamp)


def drive(guard, commands, lag, judge):
    """Commands through the guard on a body that lags; what the judge found, and the refusals."""
    robot, body, applied, brake = HERE, REST, REST, Brake(REST, 0)
    lowest, refused = judge(robot, 0.0, body), 0
    time = 0.0
    for wanted in commands:
        box = guard.limits.input_box(applied, PERIOD)
        asked = box.clip(wanted)
        outcome = guard.filter(asked, scene_from(robot, time), body, box, brake)
        assert box.contains(outcome.twist, 1e-12)
        refused += outcome.twist != asked
        brake, applied = outcome.brake, outcome.twist
        for _ in range(4):
            body, mean = body_after(body, applied, PERIOD / 4, lag)
            robot = robot.moved(mean, PERIOD / 4)
            time += PERIOD / 4
            lowest = min(lowest, judge(robot, time, body))
    return lowest, refused


def commands_of(switches):
    return [Twist(v, w) for v, w, n in switches for _ in range(n)]


def static_barrier(frame, footprint=LOADED):
    """The world in the goal's frame, or as the robot's sensors see it, scene by scene."""
    world = Obstacles(DISCS, WALLS)
    if frame is Frame.GOAL:
        return ObstacleBarrier(footprint, 1.5, world.seen_in(GOAL.inverse()), frame)

    def seen(scene):
        return world.seen_in(scene.goal.compose(GOAL.inverse()))

    return ObstacleBarrier(footprint, 1.5, seen, frame)


@settings(max_examples=40)
@given(st.sampled_from(Frame), st.sampled_from([0.0, 0.12]), st.floats(0.0, 0.1), bang_bang)
def test_an_adversary_never_touches_what_stands(frame, lag, cover, switches):
    guard = Guard(LIMITS, (static_barrier(frame),), PERIOD, lag + cover)

    def judge(robot, _time, _body):
        return clear(LOADED, robot, DISCS)

    lowest, _ = drive(guard, commands_of(switches), lag, judge)
    assert lowest >= -1e-9


def test_nor_a_wall():
    """Straight at the walls, and swinging the load into them."""
    guard = Guard(LIMITS, (static_barrier(Frame.ROBOT),), PERIOD, 0.15)

    def judge(robot, _time, _body):
        return clear(LOADED, robot, DISCS, WALLS)

    refusals = 0
    for v, w in ((9.0, 0.0), (9.0, 9.0), (9.0, 1.0), (-9.0, -0.3), (0.0, 9.0)):
        commands = [Twist(v, w)] * 120 + [Twist(9.0, 0.2)] * 60
        lowest, refused = drive(guard, commands, 0.12, judge)
        assert lowest >= -1e-9
        refusals += refused
    assert refusals > 100


def test_the_adversary_wins_without_the_guard():
    """So the tests above have teeth: obstacles, walls, the band and the view."""
    guard = Guard(LIMITS, (), PERIOD, 0.15)
    ahead, aside = [Twist(9.0, 0.0)] * 150, [Twist(9.0, 0.6)] * 90
    wrong = {
        "discs": (aside, lambda robot, _t, _b: clear(LOADED, robot, DISCS)),
        "walls": (ahead, lambda robot, _t, _b: clear(LOADED, robot, [], WALLS)),
        "near": (ahead, lambda robot, _t, _b: math.dist(robot[:2], FEATURE[:2]) - 1.0),
        "view": (aside, lambda robot, _t, _b: 0.6 - abs(math.atan2(*robot.seen(FEATURE)[::-1]))),
    }
    for name, (commands, judge) in wrong.items():
        lowest, refused = drive(guard, commands, 0.12, judge)
        assert lowest < -0.05, name
        assert refused == 0


@settings(max_examples=30)
@given(st.sampled_from([0.0, 0.12]), bang_bang, st.floats(-0.6, 0.6), st.floats(0.3, 0.6))
def test_a_moving_disc_touches_the_robot_only_when_it_stands(lag, switches, side, speed):
    """Passive safety: at contact the robot has at most 5 % of its speed left."""
    heading = math.atan2(-side, 1.0)
    disc = Disc(2.5, side, 0.2, -speed * math.cos(heading), -speed * math.sin(heading))

    def there(time):
        return disc._replace(x=disc.x + disc.v_x * time, y=disc.y + disc.v_y * time)

    def seen(scene):
        return Obstacles([there(scene.stamp)]).seen_in(scene.goal.compose(GOAL.inverse()))

    guard = Guard(LIMITS, (ObstacleBarrier(LOADED, 1.5, seen),), PERIOD, lag + 0.02)
    # What is left of the fastest motion when the robot counts as standing.
    slow = 0.05 * (LIMITS.v_max + LIMITS.omega_max * LOADED.lever)
    touched = []

    def judge(robot, time, body):
        gap = clear(LOADED, robot, [there(time)])
        if gap < -1e-9 and not touched:
            touched.append(abs(body.v) + abs(body.omega) * LOADED.lever)
        return gap

    drive(guard, commands_of(switches), lag, judge)
    assert all(speed <= slow for speed in touched)


def test_a_moving_disc_hits_a_moving_robot_without_the_guard():
    disc = Disc(2.5, 0.0, 0.2, -0.5, 0.0)
    touched = []

    def judge(robot, time, body):
        gap = clear(LOADED, robot, [disc._replace(x=disc.x + disc.v_x * time)])
        if gap < 0.0:
            touched.append(abs(body.v))
        return gap

    drive(Guard(LIMITS, (), PERIOD, 0.12), [Twist(9.0, 0.0)] * 90, 0.12, judge)
    assert max(touched) > 0.3


@settings(max_examples=40)
@given(st.sampled_from([0.0, 0.12]), st.floats(0.0, 0.1), bang_bang)
def test_an_adversary_stays_in_the_band(lag, cover, switches):
    band = RangeBarrier(1.2, 2.6, 1.5, origin=(0.2, 0.0))
    guard = Guard(LIMITS, (band,), PERIOD, lag + cover)

    def judge(robot, _time, _body):
        rho = math.dist(robot.transform((0.2, 0.0)), FEATURE[:2])
        return min(rho - 1.2, 2.6 - rho)

    lowest, _ = drive(guard, commands_of(switches), lag, judge)
    assert lowest >= -1e-9


@settings(max_examples=40)
@given(st.sampled_from([0.0, 0.12]), st.sampled_from([0.0, 1.0]), bang_bang)
def test_an_adversary_stays_in_an_unequal_view(lag, yaw, switches):
    """One that looks ahead, and one that looks aside, where corners are not enough."""
    camera = Pose2(0.2, 0.0, yaw)
    left, right = (0.2, 0.7) if not yaw else (-0.7, 1.2)
    guard = Guard(LIMITS, (ViewBarrier(camera, left, right, 1.5),), PERIOD, lag + 0.05)

    def judge(robot, _time, _body):
        x, y = camera.seen(robot.seen(FEATURE))
        bearing = math.atan2(y, x)
        return min(left - bearing, right + bearing)

    lowest, _ = drive(guard, commands_of(switches), lag, judge)
    assert lowest >= -1e-9


def test_several_barriers_through_the_whole_filter():
    """View, band and obstacles at once, through program and guard; every command certified.

    With gains that ask for more than the acceleration limits can give, so that the guard has to
    refuse what the program takes for safe.
    """
    camera = FieldOfView(0.7, Pose2(0.2, 0.0, 0.0))
    barriers = [
        FieldOfViewBarrier(camera, 6.0),
        RangeBarrier(0.9, 3.0, 6.0, origin=(0.2, 0.0)),
        replace(static_barrier(Frame.GOAL), gain=6.0),
    ]
    rng = np.random.default_rng(2)
    seen = set()
    for _ in range(6):
        safe = SafetyFilter(LIMITS, barriers, PERIOD, lag=0.12, guard_lag=0.15)
        robot, body, applied, wanted = HERE, REST, REST, REST
        for tick in range(150):
            if tick % 20 == 0:
                wanted = Twist(*rng.choice([-9.0, 0.0, 9.0], 2))
            now = tick * PERIOD
            decision = safe.filter(wanted, scene_from(robot, now), applied, now)
            assert decision.certified
            seen.add(decision.status)
            applied = decision.twist
            for _ in range(4):
                body, mean = body_after(body, applied, PERIOD / 4, 0.12)
                robot = robot.moved(mean, PERIOD / 4)
                assert clear(LOADED, robot, DISCS, WALLS) >= -1e-9
                assert 0.9 - 1e-9 <= math.dist(robot.transform((0.2, 0)), FEATURE[:2]) <= 3.0 + 1e-9
                assert camera.margin(robot.seen(FEATURE)) >= -1e-9
    assert Status.OPTIMAL in seen
    assert seen & {Status.GUARDED, Status.BRAKING}


def test_inside_the_margin_it_finds_its_way_out():
    """Put 0.1 m into a margin it drives out, and every tick is certified."""
    wall = Obstacles(walls=[Wall(1.0, -2.0, 1.0, 2.0)]).seen_in(GOAL.inverse())
    barrier = ObstacleBarrier(LOADED, 1.5, wall, Frame.GOAL, margin=0.3)
    safe = SafetyFilter(LIMITS, [barrier], PERIOD, lag=0.12, guard_lag=0.15)
    robot, body, applied = HERE, REST, REST
    assert barrier.clearance(scene_from(robot)) == pytest.approx(-0.1)
    for tick in range(60):
        now = tick * PERIOD
        decision = safe.filter(Twist(-0.3, 0.0), scene_from(robot, now), applied, now)
        assert decision.certified
        applied = decision.twist
        body, mean = body_after(body, applied, PERIOD, 0.12)
        robot = robot.moved(mean, PERIOD)
    assert barrier.clearance(scene_from(robot)) > 0.1


def test_far_obstacles_leave_the_command_alone():
    """Bit for bit the same with a thousand obstacles that cannot matter as with none."""
    rng = np.random.default_rng(1)
    far = rng.uniform(-30.0, 30.0, (1200, 2))
    far = far[np.hypot(*far.T) > 6.0][:1000]
    barrier = ObstacleBarrier(LOADED, 1.5, Obstacles.from_points(far, 0.1), limits=LIMITS)
    camera = FieldOfViewBarrier(FieldOfView(0.7), 1.2)
    answers = []
    for barriers in ([camera], [camera, barrier]):
        safe = SafetyFilter(LIMITS, barriers, PERIOD)
        answers.append([
            safe.filter(Twist(0.4, 0.3), scene_from(HERE, i * PERIOD), Twist(0.2, 0.1), i * PERIOD)
            for i in range(3)
        ])  # fmt: skip
    for alone, among in zip(*answers, strict=True):
        assert among.twist == alone.twist
        assert among.status == alone.status
        assert among.rows[-1].names == ()
