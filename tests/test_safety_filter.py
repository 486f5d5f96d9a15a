"""The command contract: whatever goes in, what comes out is finite, reachable and explained."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import (
    FieldOfView,
    Limits,
    Observation,
    Pose2,
    Reference,
    SafetyFilter,
    Scene,
    Status,
    TrackingController,
    Twist,
)
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.controller import DockingController
from clfcbf.errors import BackendError, ConfigurationError
from clfcbf.estimation import body_after
from clfcbf.guard import moved_scene
from clfcbf.laws.kanayama import Kanayama
from clfcbf.safety_filter import FilterInputs, filter_tick
from clfcbf.se2 import arc, is_finite
from clfcbf.tick import FilterState
from tests.strategies import any_float

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
REST = Twist(0.0, 0.0)

any_twist = st.builds(Twist, any_float, any_float)
any_pose = st.builds(Pose2, any_float, any_float, any_float)
any_scene = st.builds(Scene, any_pose, any_pose, any_float)
speeds = st.builds(Twist, st.floats(-0.7, 0.7), st.floats(-1.2, 1.2))


def make_filter(**options):
    return SafetyFilter(LIMITS, [CAMERA], PERIOD, **options)


def scene_at(distance=1.8, bearing=0.0, stamp=0.0):
    x = 0.2 + distance * math.cos(bearing)
    y = distance * math.sin(bearing)
    feature = Pose2(x, y, 0.0)
    return Scene(feature.compose(Pose2(-0.6, 0.0, 0.0)), feature, stamp)


def in_contract(decision, applied):
    return (
        math.isfinite(decision.twist.v)
        and math.isfinite(decision.twist.omega)
        and LIMITS.input_box(applied, PERIOD).contains(decision.twist, 1e-9)
    )


@settings(max_examples=300)
@given(any_twist, any_scene, speeds, any_float)
def test_whatever_goes_in_the_command_is_in_the_contract(nominal, scene, applied, now):
    assert in_contract(make_filter().filter(nominal, scene, applied, now), applied)


@settings(max_examples=150)
@given(st.lists(st.tuples(any_twist, any_scene, any_twist, any_float), min_size=1, max_size=6))
def test_a_run_of_anything_at_all_stays_in_the_contract(ticks):
    """A non-finite applied command is replaced by the one last sent."""
    safe, sent = make_filter(), REST
    for nominal, scene, applied, now in ticks:
        finite = all(map(math.isfinite, applied))
        if finite and max(map(abs, applied)) > 1e3:
            applied = REST
        decision = safe.filter(nominal, scene, applied, now)
        assert in_contract(decision, applied if finite else sent)
        sent = decision.twist


@settings(max_examples=150)
@given(any_pose, any_pose, speeds, any_float, any_float, st.booleans())
def test_the_docking_controller_too(goal, feature, applied, now, stamp, twice):
    controller = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    for _ in range(1 + twice):
        decision = controller.step(Observation(goal, feature, stamp), applied, now)
        assert in_contract(decision, applied)


@given(any_pose, any_twist, any_scene, speeds, any_float)
def test_and_the_tracking_controller(pose, twist, scene, applied, now):
    controller = TrackingController(LIMITS, [CAMERA], PERIOD)
    assert in_contract(controller.step(Reference(pose, twist), scene, applied, now), applied)


GOOD = scene_at()
NAN = float("nan")


@pytest.mark.parametrize(
    ("nominal", "scene", "applied", "now", "status"),
    [
        (Twist(NAN, 0.0), GOOD, REST, 0.0, Status.INVALID_INPUT),
        (Twist(0.1, 0.0), GOOD._replace(goal=Pose2(NAN, 0, 0)), REST, 0.0, Status.INVALID_INPUT),
        (Twist(0.1, 0.0), GOOD._replace(feature=Pose2(1, NAN, 0)), REST, 0.0, Status.INVALID_INPUT),
        (Twist(0.1, 0.0), GOOD._replace(stamp=NAN), REST, 0.0, Status.INVALID_INPUT),
        (Twist(0.1, 0.0), GOOD, Twist(NAN, 0.0), 0.0, Status.INVALID_INPUT),
        (Twist(0.1, 0.0), GOOD, REST, NAN, Status.CLOCK_ERROR),
        (Twist(0.1, 0.0), GOOD._replace(stamp=9.0), REST, 0.0, Status.CLOCK_ERROR),
        (Twist(0.1, 0.0), GOOD, REST, 9.0, Status.STALE),
        (Twist(0.1, 0.0), scene_at(1.0, math.radians(120)), REST, 0.0, Status.OUT_OF_VIEW),
        (Twist(0.0, 0.0), scene_at(1.0, math.radians(50)), REST, 0.0, Status.OUT_OF_VIEW),
    ],
)
def test_each_bad_input_has_its_status(nominal, scene, applied, now, status):
    decision = make_filter().filter(nominal, scene, applied, now)
    assert decision.status is status
    box = LIMITS.input_box(applied if math.isfinite(applied.v) else REST, PERIOD)
    assert box.contains(decision.twist, 1e-9)


def test_a_fault_brakes_along_the_certified_arc():
    safe, applied = make_filter(), REST
    for k in range(25):
        applied = safe.filter(
            Twist(0.22, 0.1), scene_at(stamp=k * PERIOD), applied, k * PERIOD
        ).twist
    assert applied.v > 0.15
    curvature = applied.omega / applied.v
    for k in range(25, 60):
        decision = safe.filter(Twist(NAN, NAN), scene_at(stamp=k * PERIOD), applied, k * PERIOD)
        assert decision.status is Status.INVALID_INPUT
        assert decision.certified
        assert decision.twist.omega == pytest.approx(curvature * decision.twist.v, abs=1e-12)
        assert abs(decision.twist.v) < abs(applied.v) or applied == REST
        applied = decision.twist
    assert applied == REST


def test_the_clock_may_stand_still_or_jump_and_the_filter_recovers():
    safe = make_filter()
    safe.filter(Twist(0.1, 0.0), scene_at(stamp=5.0), REST, 5.0)
    assert safe.filter(Twist(0.1, 0.0), scene_at(stamp=5.0), REST, 5.0).status is Status.CLOCK_ERROR
    assert safe.filter(Twist(0.1, 0.0), scene_at(stamp=1.0), REST, 1.0).status is Status.CLOCK_ERROR
    later = 1.0 + PERIOD
    decision = safe.filter(Twist(0.1, 0.0), scene_at(stamp=later), REST, later)
    assert not decision.status.is_fault


class Broken:
    """A user's barrier with a bug."""

    name = "broken"

    def rows(self, scene, motion=None):
        raise KeyError("no such obstacle")

    def clearance(self, scene, motion=None):
        return math.inf

    def clearance_along(self, scene, sweep):
        return math.inf

    def clearance_around(self, scene, sweep):
        return math.inf, math.inf


def test_a_part_that_raises_is_named_and_braked_for():
    safe = SafetyFilter(LIMITS, [CAMERA, Broken()], PERIOD)
    decision = safe.filter(Twist(0.2, 0.0), scene_at(), Twist(0.1, 0.0), 0.0)
    assert decision.status is Status.INTERNAL_ERROR
    assert "no such obstacle" in decision.reason
    assert decision.twist == pytest.approx((0.09, 0.0))


huge = st.sampled_from([1e9, -1e12, 1e154, -1e160, 1e300, -1e308, 1e-300, 5e-324, 0.0])
huge_twist = st.builds(Twist, huge, huge)
huge_pose = st.builds(Pose2, huge, huge, huge)


@settings(max_examples=300)
@given(huge_twist, st.builds(Scene, huge_pose, huge_pose, st.just(0.0)), huge_twist, huge_pose)
def test_absurd_but_finite_values_raise_nothing(nominal, scene, applied, pose):
    controllers = (make_filter(lag=0.12), TrackingController(LIMITS, [CAMERA], PERIOD, lag=0.12))
    sent = [REST, REST]
    for now in (0.0, PERIOD):
        decisions = (
            controllers[0].filter(nominal, scene, applied, now),
            controllers[1].step(Reference(pose, nominal), scene, applied, now),
        )
        for k, decision in enumerate(decisions):
            in_force = applied if is_finite(applied) else sent[k]
            assert LIMITS.input_box(in_force, PERIOD).contains(decision.twist)
            assert all(map(math.isfinite, decision.twist))
            sent[k] = decision.twist


def test_hand_over_from_a_faster_stage():
    safe, applied = make_filter(), Twist(0.55, 0.0)
    for k in range(40):
        decision = safe.filter(
            Twist(0.22, 0.0), scene_at(3.0, stamp=k * PERIOD), applied, k * PERIOD
        )
        assert in_contract(decision, applied)
        assert decision.twist.v == pytest.approx(max(0.22, applied.v - 0.01), abs=1e-9)
        applied = decision.twist


def test_a_harmless_command_goes_through_untouched():
    decision = make_filter().filter(Twist(0.01, 0.0), scene_at(), REST, 0.0)
    assert decision.twist == Twist(0.01, 0.0)
    assert decision.status is Status.OPTIMAL
    assert decision.certified
    assert decision.margins["fov.left"] > 0.0
    assert set(decision.margins) == {"fov.left", "fov.right"} == set(decision.values)
    assert decision.clearance == pytest.approx(math.radians(32.0))


def drive(safe, commands, scene, lag=0.0, noise=None):
    """Drive a lagging body through the filter; returns the smallest true margin [rad]."""
    applied, body, lowest = REST, REST, math.inf
    for k, wanted in enumerate(commands):
        now = k * PERIOD
        shown = scene._replace(stamp=now)
        if noise is not None:
            x, y = noise.normal(0.0, 0.003, 2)
            shown = shown._replace(feature=Pose2(scene.feature.x + x, scene.feature.y + y, 0.0))
        decision = safe.filter(wanted, shown, applied, now)
        assert in_contract(decision, applied)
        applied = decision.twist
        for _ in range(4):
            body, mean = body_after(body, applied, PERIOD / 4, lag)
            scene = moved_scene(scene, arc(mean, PERIOD / 4))
            lowest = min(lowest, CAMERA.margin((scene.feature.x, scene.feature.y)))
    return lowest


bang_bang = st.lists(
    st.tuples(
        st.sampled_from([-0.22, 0.0, 0.22]), st.sampled_from([-0.4, 0.0, 0.4]), st.integers(1, 40)
    ),
    min_size=3,
    max_size=8,
)


@settings(max_examples=40, deadline=None)
@given(bang_bang, st.floats(0.5, 2.5), st.floats(-0.5, 0.5))
def test_no_nominal_command_loses_the_view(switches, distance, bearing):
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    assert drive(make_filter(guard_lag=0.0), commands, scene_at(distance, bearing)) >= 0.0


@settings(max_examples=25, deadline=None)
@given(bang_bang, st.floats(0.6, 2.5), st.floats(-0.5, 0.5), st.integers(0, 100))
def test_nor_with_lag_and_noise(switches, distance, bearing, seed):
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    rng = np.random.default_rng(seed)
    safe = make_filter(lag=0.12)
    assert drive(safe, commands, scene_at(distance, bearing), 0.12, rng) >= 0.0


def test_a_tick_is_a_pure_function():
    safe = make_filter(lag=0.12)
    state, log, applied = FilterState(), [], REST
    for k in range(60):
        inputs = FilterInputs(Twist(0.2, 0.3), scene_at(stamp=k * PERIOD), applied)
        before = state
        decision, state = filter_tick(safe.config, before, inputs, k * PERIOD)
        log.append((before, inputs, k * PERIOD, decision, state))
        applied = decision.twist
    for before, inputs, now, decision, after in log:
        assert filter_tick(safe.config, before, inputs, now) == (decision, after)


def test_prediction_makes_an_old_scene_as_good_as_a_new_one():
    """Two filters on one motion, one shown the scene 100 ms late, decide alike."""
    fresh, late = make_filter(), make_filter()
    scene, applied, past = scene_at(1.5, 0.3), REST, []
    for k in range(40):
        now = k * PERIOD
        past.append(scene._replace(stamp=now))
        wanted = Twist(0.15, 0.3 * math.sin(0.3 * k))
        a = fresh.filter(wanted, past[-1], applied, now)
        b = late.filter(wanted, past[max(0, k - 3)], applied, now)
        assert a.twist.v == pytest.approx(b.twist.v, abs=1e-9)
        assert a.twist.omega == pytest.approx(b.twist.omega, abs=1e-9)
        applied = a.twist
        scene = moved_scene(scene, arc(applied, PERIOD))


def test_the_daqp_backend_decides_alike():
    ours, theirs = make_filter(), make_filter(backend="daqp")
    rng = np.random.default_rng(1)
    for k in range(200):
        scene = scene_at(rng.uniform(0.5, 2.5), rng.uniform(-0.6, 0.6), k * PERIOD)
        wanted = Twist(*rng.uniform(-0.4, 0.4, 2))
        applied = Twist(*rng.uniform(-0.2, 0.2, 2))
        a = ours.filter(wanted, scene, applied, k * PERIOD)
        b = theirs.filter(wanted, scene, applied, k * PERIOD)
        assert np.allclose(a.twist, b.twist, atol=1e-6)


def test_the_tracking_controller_converges_on_a_moving_target():
    controller = TrackingController(
        LIMITS, [FieldOfView(math.radians(60))], PERIOD, law=Kanayama(1.0, 8.0, 6.0)
    )
    target, robot, applied = Pose2(0.3, 0.15, 0.2), Pose2(0.0, 0.0, 0.0), REST
    twist = Twist(0.12, 0.0)
    feature = Pose2(6.0, 1.5, 0.0)
    errors = []
    for k in range(600):
        now = k * PERIOD
        seen = robot.relative(target)
        scene = Scene(robot.relative(feature), robot.relative(feature), now)
        decision = controller.step(Reference(seen, twist), scene, applied, now)
        applied = decision.twist
        robot, target = robot.moved(applied, PERIOD), target.moved(twist, PERIOD)
        errors.append(math.hypot(seen.x, seen.y))
        if errors[-1] < 1e-3:
            break
    assert errors[-1] < 0.02
    assert errors[-1] < 0.1 * errors[0]


def test_bad_settings_name_themselves():
    with pytest.raises(ConfigurationError, match="period"):
        SafetyFilter(LIMITS, [CAMERA], 0.0)
    with pytest.raises(BackendError, match="exact"):
        make_filter(backend="nonsense")
    with pytest.raises(ConfigurationError, match="weight"):
        make_filter(weight=(1.0, 2.0, 1.0))
    with pytest.raises(ConfigurationError, match="guard_lag"):
        make_filter(lag=0.3, guard_lag=0.1)
    with pytest.raises(ConfigurationError, match="patience"):
        make_filter(patience=-1.0)
    with pytest.raises(ConfigurationError, match="fraction"):
        TrackingController(LIMITS, [CAMERA], PERIOD, fraction=0.0)
    with pytest.raises(ConfigurationError, match="standoff"):
        DockingController(LIMITS, CAMERA, 0.1, PERIOD)
    with pytest.raises(ConfigurationError, match="attempts"):
        DockingController(LIMITS, CAMERA, 0.6, PERIOD, attempts=0)


def test_a_brake_that_was_never_verified_is_not_certified_later():
    safe = make_filter()
    applied = Twist(0.2, 0.3)
    for k in range(5):
        decision = safe.filter(Twist(NAN, NAN), scene_at(stamp=k * PERIOD), applied, k * PERIOD)
        assert not decision.certified
        applied = decision.twist


def test_a_loop_slower_than_its_period_certifies_nothing():
    safe, applied = make_filter(), REST
    for k in range(20):
        now = 3 * k * PERIOD
        decision = safe.filter(Twist(0.1, 0.0), scene_at(stamp=now), applied, now)
        assert decision.certified == (k == 0)
        applied = decision.twist


def test_outside_the_view_or_the_speed_limits_nothing_is_certified():
    outside = make_filter().filter(REST, scene_at(1.0, math.radians(40)), REST, 0.0)
    assert outside.status is Status.OUT_OF_VIEW
    assert not outside.certified
    fast = make_filter().filter(Twist(0.2, 0.0), scene_at(3.0), Twist(0.4, 0.0), 0.0)
    assert not fast.certified


def test_an_old_scene_is_predicted_over_all_of_the_patience():
    """At 100 Hz and 1.5 s of age the prediction still equals the exact motion."""
    period = 0.01
    barrier = FieldOfViewBarrier(CAMERA, 1.0, math.radians(3.0))
    safe = SafetyFilter(LIMITS, [barrier], period, guard_lag=0.0)
    scene, applied = scene_at(2.5, 0.0), REST
    first = scene._replace(stamp=0.0)
    for k in range(150):
        decision = safe.filter(Twist(0.15, 0.1), first, applied, k * period)
        true = CAMERA.margin((scene.feature.x, scene.feature.y)) - math.radians(3.0)
        assert decision.clearance == pytest.approx(true, abs=1e-9)
        applied = decision.twist
        scene = moved_scene(scene, arc(applied, period))


def test_commands_that_are_no_commands():
    for applied in (None, (1.0, 2.0, 3.0), "x", (None, 0.0)):
        decision = make_filter().filter(Twist(0.1, 0.0), scene_at(), applied, 0.0)
        assert decision.status is Status.INVALID_INPUT
    assert make_filter().filter(REST, scene_at(), REST, None).status is Status.CLOCK_ERROR


def test_two_cameras_have_two_names():
    other = FieldOfView(math.radians(60), Pose2(-0.2, 0.0, 0.0))
    safe = SafetyFilter(LIMITS, [CAMERA, other], PERIOD)
    decision = safe.filter(REST, scene_at(), REST, 0.0)
    assert set(decision.margins) == {"fov.left", "fov.right", "fov2.left", "fov2.right"}


def test_what_is_not_a_barrier_is_refused_at_construction():
    with pytest.raises(ConfigurationError, match="not a barrier"):
        SafetyFilter(LIMITS, ["camera"], PERIOD)
    with pytest.raises(ConfigurationError, match="name of its own"):
        SafetyFilter(LIMITS, [Broken(), Broken()], PERIOD)
