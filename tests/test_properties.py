"""What holds of the whole: symmetries, witnesses, latency, margins, bounded effort.

The properties of single parts are tested beside the parts; docs/properties.md lists all of them.
"""

import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from clfcbf import (
    DockingController,
    FieldOfView,
    Limits,
    Observation,
    Pose2,
    Reference,
    SafetyFilter,
    Scene,
    TrackingController,
    Twist,
)
from clfcbf.constraints.bearing import paper_row
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.estimation import DeadReckoning, NoiseModel, advance, body_after, measured, reckoned
from clfcbf.guard import Brake, Guard, Verdict
from clfcbf.laws.barrier_lyapunov import BarrierLyapunov
from clfcbf.paper import PaperConfig, paper_command, steady_state_lag
from clfcbf.qp.one_shot import paper_program
from clfcbf.safety_filter import FilterInputs, filter_tick
from clfcbf.se2 import wrap_angle
from clfcbf.tick import FilterState
from clfcbf.unicycle import Polar

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
STANDOFF = 0.6
HERE = Pose2(0.0, 0.0, 0.0)
REST = Twist(0.0, 0.0)

commands = st.builds(Twist, st.floats(-0.4, 0.4), st.floats(-0.8, 0.8))
runs = st.lists(commands, min_size=1, max_size=12)
frames = st.builds(Pose2, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-math.pi, math.pi))
starts = st.builds(Pose2, st.floats(-2.5, -0.6), st.floats(-0.6, 0.6), st.floats(-0.3, 0.3))
"""Of the robot in the frame of the goal."""


def feature_of(goal):
    return goal.compose(Pose2(STANDOFF, 0.0, 0.0))


def scene_of(robot, goal, stamp):
    return Scene(robot.relative(goal), robot.relative(feature_of(goal)), stamp)


def mirrored(pose):
    return Pose2(pose.x, -pose.y, wrap_angle(-pose.theta))


def reflected(twist):
    return Twist(twist.v, -twist.omega)


def close(one, other, tolerance=1e-9):
    return max(abs(a - b) for a, b in zip(one, other, strict=True)) <= tolerance


def filtered(robot, goal, wanted, hold=4):
    """The commands of a filter between any nominal ones and a robot that follows."""
    safe, applied, sent = SafetyFilter(LIMITS, [CAMERA], PERIOD), REST, []
    for tick in range(hold * len(wanted)):
        now = tick * PERIOD
        nominal = wanted[tick // hold]
        applied = safe.filter(nominal, scene_of(robot, goal, now), applied, now).twist
        robot = robot.moved(applied, PERIOD)
        sent.append(applied)
    return sent


def tracked(robot, goal, target, twist, ticks=25):
    """The commands of a controller that follows a virtual target, both moving on."""
    controller, applied, sent = TrackingController(LIMITS, [CAMERA], PERIOD), REST, []
    for tick in range(ticks):
        now = tick * PERIOD
        reference = Reference(robot.relative(target), twist)
        applied = controller.step(reference, scene_of(robot, goal, now), applied, now).twist
        robot, target = robot.moved(applied, PERIOD), target.moved(twist, PERIOD)
        sent.append(applied)
    return sent


def docked(robot, goal, ticks=20):
    """The first commands of a docking run."""
    controller, applied, sent = DockingController(LIMITS, CAMERA, STANDOFF, PERIOD), REST, []
    for tick in range(ticks):
        now = tick * PERIOD
        scene = scene_of(robot, goal, now)
        observation = Observation(scene.goal, scene.feature, now)
        applied = controller.step(observation, applied, now).twist
        robot = robot.moved(applied, PERIOD)
        sent.append(applied)
    return sent


# Where the world's frame lies says nothing; where a mirror puts the world, the command follows.


@settings(max_examples=40)
@given(starts, runs, frames)
def test_the_filter_does_not_know_the_frame_of_the_world(robot, wanted, frame):
    here = filtered(robot, HERE, wanted)
    there = filtered(frame.compose(robot), frame, wanted)
    assert all(map(close, here, there))


@settings(max_examples=40)
@given(starts, runs)
def test_the_filter_in_a_mirror(robot, wanted):
    assume(abs(feature_of(HERE).y - robot.y) > 1e-6)
    straight = filtered(robot, HERE, wanted)
    mirror = filtered(mirrored(robot), HERE, [reflected(each) for each in wanted])
    assert all(close(reflected(a), b) for a, b in zip(straight, mirror, strict=True))


targets = st.builds(Pose2, st.floats(-0.3, 0.5), st.floats(-0.3, 0.3), st.floats(-0.6, 0.6))


@settings(max_examples=25)
@given(starts, targets, commands, frames)
def test_the_tracking_controller_does_not_know_the_frame_of_the_world(robot, ahead, twist, frame):
    target = robot.compose(ahead)
    here = tracked(robot, HERE, target, twist)
    there = tracked(frame.compose(robot), frame, frame.compose(target), twist)
    assert all(map(close, here, there))


@settings(max_examples=25)
@given(starts, targets, commands)
def test_the_tracking_controller_in_a_mirror(robot, ahead, twist):
    target = robot.compose(ahead)
    straight = tracked(robot, HERE, target, twist)
    mirror = tracked(mirrored(robot), HERE, mirrored(target), reflected(twist))
    assert all(close(reflected(a), b) for a, b in zip(straight, mirror, strict=True))


@settings(max_examples=8)
@given(starts, frames)
def test_the_docking_controller_does_not_know_the_frame_of_the_world(robot, frame):
    assert all(map(close, docked(robot, HERE), docked(frame.compose(robot), frame)))


@settings(max_examples=8)
@given(starts)
def test_the_docking_controller_in_a_mirror(robot):
    assume(min(abs(robot.y), abs(robot.theta)) > 1e-3)  # a tie is broken to one side
    straight, mirror = docked(robot, HERE), docked(mirrored(robot), HERE)
    assert all(close(reflected(a), b) for a, b in zip(straight, mirror, strict=True))


# The law with a barrier in its Lyapunov function is a witness: its program needs no slack.

HALF_ANGLE = CAMERA.half_angle
polar_states = st.builds(
    Polar,
    st.floats(0.3, 3.0),
    st.floats(-0.99, 0.99).map(lambda share: share * HALF_ANGLE),
    st.floats(-2.5, 2.5),
)
barrier_laws = st.builds(
    BarrierLyapunov,
    st.just(HALF_ANGLE),
    st.floats(1.0, 30.0),
    st.floats(0.5, 12.0),
    st.floats(0.1, 2.0),
)


@given(polar_states, barrier_laws)
def test_the_barrier_law_meets_the_papers_row_and_the_speed_limits(state, law):
    r"""For a gain of :math:`k\kappa|\sin 2\varphi||\delta|/\Phi^2` and more."""
    rho, phi, delta = state
    twist, k = law.command(state, LIMITS), law.largest_rate(state, LIMITS)
    gain = k * law.stiffness * abs(math.sin(2.0 * phi) * delta) / HALF_ANGLE**2
    point = (rho * math.cos(phi), rho * math.sin(phi))
    assert LIMITS.contains(twist, 1e-12)
    ((a_v, a_w, b),) = paper_row(point, HALF_ANGLE, max(gain, 1e-9)).coefficients
    assert a_v * twist.v + a_w * twist.omega <= b + 1e-12 * (1.0 + abs(b))


def test_that_gain_is_nearly_the_least():
    """With little damping a tenth less is too little for the row."""
    law = BarrierLyapunov(HALF_ANGLE, 6.0, 1e-3, 0.1)
    state = Polar(1.0, 0.3, -1.0)
    twist, k = law.command(state, LIMITS), law.largest_rate(state, LIMITS)
    gain = 0.9 * k * law.stiffness * abs(math.sin(2.0 * state.phi)) / HALF_ANGLE**2
    point = (math.cos(state.phi), math.sin(state.phi))
    ((a_v, a_w, b),) = paper_row(point, HALF_ANGLE, gain).coefficients
    assert a_v * twist.v + a_w * twist.omega > b


@given(polar_states, barrier_laws)
def test_the_barrier_laws_function_decays_along_exact_motion(state, law):
    """Along the arc of its command, by a difference of order four."""
    rho, phi, delta = state
    assume(abs(phi) < 0.9 * HALF_ANGLE)
    twist, k = law.command(state, LIMITS), law.largest_rate(state, LIMITS)
    target = Pose2(rho * math.cos(phi), rho * math.sin(phi), wrap_angle(phi - delta))
    assume(abs(delta) < 3.0)

    def value(time):
        return law.lyapunov(Polar.of(HERE.moved(twist, time).relative(target)))

    step = 1e-3
    rate = (8 * (value(step) - value(-step)) - value(2 * step) + value(-2 * step)) / (12 * step)
    assert rate == pytest.approx(-law.decay(state, k), rel=1e-6, abs=1e-7)


# The soft row of the one-shot program gives way no further as its weight grows.

units = st.floats(-1.0, 1.0)


@given(
    st.tuples(units, units),
    st.tuples(units, units, units),
    st.lists(st.tuples(units, units, st.floats(0.0, 1.0)), max_size=3),
    st.floats(1e-2, 1e3),
    st.floats(1.0, 1e3),
)
def test_more_weight_on_the_slack_is_no_more_slack(reference, soft, hard, penalty, factor):
    box = (-1.0, 1.0, -1.0, 1.0)
    deltas = [
        paper_program((1.0, 0.2, 2.0), reference, box, hard, soft, weight).delta
        for weight in (penalty, factor * penalty)
    ]
    assert 0.0 <= deltas[1] <= deltas[0] + 1e-12


# The paper's cost on the input itself lags behind; one on the distance to the reference does not.

weights = st.floats(0.3, 3.0)
papers = st.builds(
    PaperConfig,
    H=st.tuples(weights, weights, weights),
    Q_u=st.tuples(weights, weights),
    c_delta=st.floats(1e2, 1e6),
    mu=weights,
    clf=st.sampled_from(("quartic", "quadratic")),
)
FREE = Limits(1e3, 1e3, 1e5, 1e5)
FAR_AHEAD = (50.0, 0.0)


def papers_command(config, error, reference):
    return paper_command(config, error, reference, FAR_AHEAD, REST, FREE, PERIOD).twist


@given(papers, st.sampled_from([-1.0, 1.0]), st.floats(0.05, 0.4))
def test_the_lag_of_the_papers_cost_is_where_its_command_keeps_up(config, sign, speed):
    """The error at which the printed program drives as fast as the reference, by bisection."""
    reference = Twist(sign * speed, 0.0)
    near, far = 0.0, 10.0
    for _ in range(60):
        middle = 0.5 * (near + far)
        if sign * papers_command(config, Pose2(sign * middle, 0.0, 0.0), reference).v < speed:
            near = middle
        else:
            far = middle
    assert steady_state_lag(config, reference.v) == pytest.approx(sign * near, rel=1e-6)


@given(papers, commands)
def test_with_feedforward_there_is_no_lag(config, reference):
    ahead = replace(config, feedforward=True)
    assert steady_state_lag(ahead, reference.v) == 0.0
    assert close(papers_command(ahead, HERE, reference), reference, 1e-12)


# Noise-free measurements are worth the same however late they come.

MODEL = NoiseModel(0.005, 0.005, 0.015, 0.003, 0.02, 0.003, 4.0, 5)


@given(
    st.lists(commands, min_size=8, max_size=30),
    st.builds(Pose2, st.floats(0.5, 3.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0)),
    st.integers(0, 7),
    st.floats(0.0, 0.9),
    st.sampled_from([0.0, 0.12]),
)
def test_a_late_measurement_places_the_target_where_it_is(log, goal, late, share, lag):
    """Taken any time back, between two ticks too, along a motion integrated on its own."""
    reckoning = DeadReckoning(0.0, HERE, REST)
    robot, body = HERE, REST
    shots = []  # the robot at the moment of each capture
    for tick, twist in enumerate(log):
        _, mean = body_after(body, twist, PERIOD, lag)
        shots.append((tick * PERIOD + share * PERIOD, robot.moved(mean, share * PERIOD)))
        body, mean = body_after(body, twist, PERIOD, lag)
        robot = robot.moved(mean, PERIOD)
        reckoning = advance(reckoning, twist, (tick + 1) * PERIOD, lag)
    stamp, camera_at = shots[-1 - late]
    seen = Observation(camera_at.relative(goal), camera_at.relative(feature_of(goal)), stamp)
    estimate, verdict = measured(None, seen, reckoned(reckoning, stamp), MODEL)
    assert verdict.accepted
    expected, found = robot.relative(goal), reckoning.pose.relative(estimate.goal)
    assert math.dist(found[:2], expected[:2]) < 1e-9
    assert abs(wrap_angle(found.theta - expected.theta)) < 1e-9
    again, verdict = measured(estimate, seen, reckoned(reckoning, stamp), MODEL)
    assert verdict.distance < 1e-6
    assert math.dist(again.goal[:2], estimate.goal[:2]) < 1e-9


# A larger margin refuses more, and leaves at least itself.

margins = st.floats(0.0, 0.3)
setbacks = st.floats(0.0, 0.1)


def guard_with(margin, setback, lag):
    barrier = FieldOfViewBarrier(CAMERA, 1.0, margin, setback=setback)
    return Guard(LIMITS, (barrier,), PERIOD, lag)


@given(starts, commands, commands, margins, margins, setbacks, setbacks, st.floats(0.0, 0.3))
def test_what_a_larger_margin_admits_a_smaller_one_admits(
    robot, twist, body, margin, more, setback, further, lag
):
    scene = scene_of(robot, HERE, 0.0)
    near, far = (
        guard_with(min(margin + m, 0.5), setback + s, lag) for m, s in ((0.0, 0.0), (more, further))
    )
    sweep = near.sweep(body, near.brake_from(twist))
    assert far.clearance(scene) <= near.clearance(scene) + 1e-12
    least, spare = (guard.barriers[0].clearance_along(scene, sweep) for guard in (far, near))
    assert least <= spare + 1e-12
    if far.admissible(scene, sweep):
        assert near.admissible(scene, sweep) or abs(spare) < 1e-12


_CRAWL = [Twist(v, w) for v, w in (
    (0.0, 0.5), (0.0, 0.0), (0.25, -0.5), (0.25, 0.0), (0.25, 0.5), (0.0, 0.5), (0.25, 5e-324)
)]  # fmt: skip


@settings(max_examples=40)
@example(Pose2(-1.5, 0.5, 0.25), _CRAWL, 0.0, 0.0)
@given(starts, runs, st.floats(0.0, 0.2), st.sampled_from([0.0, 0.12]))
def test_an_adversary_leaves_the_margin_that_was_asked_for(robot, wanted, margin, lag):
    """The same attack against any margin: the true clearance never falls below it."""
    goal, body, applied, brake = HERE, REST, REST, Brake(REST, 0)
    guard, judge = guard_with(margin, 0.0, lag), guard_with(0.0, 0.0, lag)
    assume(guard.clearance(scene_of(robot, goal, 0.0)) >= 0.0)
    lowest = math.inf
    for tick in range(8 * len(wanted)):
        box = LIMITS.input_box(applied, PERIOD)
        nominal = box.clip(wanted[tick // 8].scaled(9.0))
        outcome = guard.filter(nominal, scene_of(robot, goal, 0.0), body, box, brake)
        brake, applied = outcome.brake, outcome.twist
        for _ in range(2):
            body, mean = body_after(body, applied, PERIOD / 2, lag)
            robot = robot.moved(mean, PERIOD / 2)
            lowest = min(lowest, judge.clearance(scene_of(robot, goal, 0.0)))
    assert lowest >= margin - 1e-9


def test_that_attack_gets_through_to_a_margin():
    """Without a margin it comes closer than a large one allows, so the property can fail."""
    lowest = {}
    for margin in (0.0, 0.2):
        robot, applied, brake = Pose2(-1.5, 0.0, 0.0), REST, Brake(REST, 0)
        guard, judge = guard_with(margin, 0.0, 0.0), guard_with(0.0, 0.0, 0.0)
        found = math.inf
        for _ in range(90):
            box = LIMITS.input_box(applied, PERIOD)
            scene = scene_of(robot, HERE, 0.0)
            outcome = guard.filter(box.clip(Twist(0.3, 9.0)), scene, REST, box, brake)
            brake, applied = outcome.brake, outcome.twist
            robot = robot.moved(applied, PERIOD)
            found = min(found, judge.clearance(scene_of(robot, HERE, 0.0)))
        assert outcome.verdict is not Verdict.ADMITTED
        lowest[margin] = found
    assert 0.0 <= lowest[0.0] < 0.1 < 0.2 <= lowest[0.2] + 1e-9


# A tick's effort is bounded: counted in calls, which no busy machine changes.

MOST_CALLS = 4_000
"""Python calls of one tick: an ordinary one takes about a hundred, one on fractions 2,000."""


def calls_of(function):
    count = 0

    def profile(frame, event, argument):
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


finite = st.floats(-1e6, 1e6)
any_pose = st.builds(Pose2, finite, finite, finite)
any_twist = st.builds(Twist, finite, finite)


@settings(max_examples=150)
@given(any_twist, st.builds(Scene, any_pose, any_pose, st.just(0.0)), any_twist, commands)
def test_no_tick_takes_more_than_its_share_of_calls(nominal, scene, far, applied):
    safe = SafetyFilter(LIMITS, [CAMERA], PERIOD)
    for command in (far, applied):
        inputs = FilterInputs(nominal, scene, command)
        taken = calls_of(lambda it=inputs: filter_tick(safe.config, FilterState(), it, 0.0))
        assert 10 < taken < MOST_CALLS


ROOT = Path(__file__).parents[1]


def test_every_property_has_the_tests_that_its_page_names():
    page = (ROOT / "docs" / "properties.md").read_text()
    named = re.findall(r"`(tests/[\w/]+\.py)::(test_\w+)`", page)
    for path, name in named:
        assert f"\ndef {name}(" in (ROOT / path).read_text(), f"{path} has no {name}"
    numbers = [int(n) for n in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)]
    assert numbers == list(range(1, 17))
    assert len(named) > len(numbers)
