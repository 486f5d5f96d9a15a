"""The guard's theorem: from an admissible command a certified brake keeps the view."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import body_after
from clfcbf.guard import Brake, Guard, Verdict, moved_scene
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc

PERIOD = 1 / 30
REST = Twist(0.0, 0.0)

cameras = st.builds(
    FieldOfView,
    half_angle=st.floats(0.3, 1.2),
    camera=st.builds(Pose2, st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(-0.25, 0.25)),
)
all_limits = st.builds(
    Limits,
    v_max=st.floats(0.1, 0.6),
    omega_max=st.floats(0.1, 1.0),
    a_max=st.floats(0.1, 1.0),
    alpha_max=st.floats(0.3, 2.0),
)


def guard_of(camera, limits, lag=0.0, margin=0.0):
    return Guard(limits, (FieldOfViewBarrier(camera, 1.0, margin),), PERIOD, lag)


def scene_at(camera, distance, bearing):
    x, y, yaw = camera.camera
    feature = Pose2(
        x + distance * math.cos(yaw + bearing), y + distance * math.sin(yaw + bearing), 0.0
    )
    return Scene(feature, feature, 0.0)


def lowest_on_arc(guard, scene, twist, duration, samples=200):
    return min(
        guard.clearance(moved_scene(scene, arc(twist, t)))
        for t in np.linspace(0.0, duration, samples)
    )


@given(cameras, st.floats(0.3, 3.0), st.floats(-1.0, 1.0), st.floats(-0.6, 0.6),
       st.floats(-1.0, 1.0), st.floats(0.01, 1.0))  # fmt: skip
def test_an_arc_with_both_ends_in_view_is_in_view(camera, distance, share, v, omega, duration):
    """Densely sampled, while the point is ahead of camera and rotation centre, and the robot's
    forward direction is in view.
    """
    assume(abs(camera.camera.theta) < camera.half_angle)
    scene = scene_at(camera, distance, share * camera.half_angle)
    guard = guard_of(camera, Limits(1, 1, 1, 1))
    ends = min(
        guard.clearance(scene), guard.clearance(moved_scene(scene, arc(Twist(v, omega), duration)))
    )
    assume(ends >= 0.0)
    samples = np.linspace(0.0, duration, 50)
    seen = [arc(Twist(v, omega), t).seen(scene.feature) for t in samples]
    assume(min(x for x, _ in seen) > 0.0)
    assert lowest_on_arc(guard, scene, Twist(v, omega), duration) >= -1e-9


@given(cameras, all_limits, st.floats(0.3, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.floats(-1.0, 1.0))  # fmt: skip
def test_an_admissible_command_has_an_admissible_brake(camera, limits, distance, share, v, w):
    twist = Twist(v * limits.v_max, w * limits.omega_max)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, distance, share * camera.half_angle)
    assume(guard.clearance(scene) >= 0.0)
    brake = guard.brake_from(twist)
    assume(guard.admissible(scene, guard.sweep(REST, brake)))
    while brake.ticks > 0:
        assert lowest_on_arc(guard, scene, brake.twist, PERIOD, 20) >= -1e-9
        scene = moved_scene(scene, arc(brake.twist, PERIOD))
        following = brake.next()
        box = limits.input_box(brake.twist, PERIOD)
        assert box.contains(following.twist, 1e-12)
        rest = arc(following.twist, 0.5 * PERIOD * (following.ticks + 1))
        assert guard.clearance(moved_scene(scene, rest)) >= -1e-9
        brake = following
    assert brake.twist == REST


def run(guard, camera, scene, commands, lag):
    """Adversarial commands through the guard, on a body that lags; smallest clearance seen."""
    limits = guard.limits
    body, applied, brake = REST, REST, Brake(REST, 0)
    lowest, braked = guard.clearance(scene), 0
    for wanted in commands:
        box = limits.input_box(applied, PERIOD)
        outcome = guard.filter(box.clip(wanted), scene, body, box, brake)
        assert outcome.certified
        assert box.contains(outcome.twist, 1e-12)
        braked += outcome.verdict is not Verdict.ADMITTED
        brake, applied = outcome.brake, outcome.twist
        for _ in range(4):
            body, mean = body_after(body, applied, PERIOD / 4, lag)
            scene = moved_scene(scene, arc(mean, PERIOD / 4))
            lowest = min(lowest, guard.clearance(scene))
    return lowest, braked


bang_bang = st.lists(
    st.tuples(
        st.sampled_from([-9.0, 0.0, 9.0]), st.sampled_from([-9.0, 0.0, 9.0]), st.integers(1, 25)
    ),
    min_size=2,
    max_size=10,
)


@settings(max_examples=60)
@given(all_limits, st.floats(0.5, 3.0), st.floats(-0.9, 0.9), bang_bang)
def test_an_adversary_never_loses_the_view_without_lag(limits, distance, share, switches):
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    lowest, _ = run(
        guard, camera, scene_at(camera, distance, share * camera.half_angle), commands, 0.0
    )
    assert lowest >= -1e-9


@settings(max_examples=60)
@given(st.sampled_from([0.05, 0.12, 0.25]), st.floats(0.6, 3.0), st.floats(-0.9, 0.9), bang_bang)
def test_an_adversary_stays_within_the_declared_margin_with_lag(lag, distance, share, switches):
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits, lag=0.25)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    start = scene_at(camera, distance, share * camera.half_angle)
    lowest, _ = run(guard, camera, start, commands, lag)
    assert lowest >= -math.radians(0.5)


@settings(max_examples=150)
@given(
    all_limits, st.floats(0.0, 0.3), st.floats(0.3, 3.0), st.floats(-0.9, 0.9), bang_bang,
    st.floats(0.0, 1.0),
)  # fmt: skip
def test_no_margin_is_needed_for_a_known_lag(limits, lag, distance, share, switches, cover):
    """The corners of (coast, brake) with the blur of their order are exact: no margin at all.

    The body lags by any ``lag``, its twist is known, and the guard covers a lag at least as long.
    """
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits, lag=lag + 0.1 * cover)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    start = scene_at(camera, distance, share * camera.half_angle)
    lowest, _ = run(guard, camera, start, commands, lag)
    assert lowest >= -1e-9


def test_the_adversary_wins_without_the_guard():
    """So the two tests above have teeth."""
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    open_guard = Guard(limits, (), PERIOD)
    judge = guard_of(camera, limits)
    scene, body, applied, brake = scene_at(camera, 1.5, 0.0), REST, REST, Brake(REST, 0)
    for _ in range(60):
        box = limits.input_box(applied, PERIOD)
        outcome = open_guard.filter(box.clip(Twist(0.22, 0.4)), scene, body, box, brake)
        brake, applied = outcome.brake, outcome.twist
        scene = moved_scene(scene, arc(applied, PERIOD))
    assert judge.clearance(scene) < -0.05


def test_the_brake_is_counted_down_exactly():
    for n in range(1, 200):
        brake = Brake(Twist(0.22, -0.4), n)
        seen = 0
        while brake.ticks:
            brake = brake.next()
            seen += 1
        assert seen == n
        assert brake.twist == REST


def test_outside_the_view_it_may_turn_back_but_not_further_out():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits, lag=0.25)
    scene = scene_at(camera, 1.5, math.radians(40))
    box = limits.input_box(REST, PERIOD)
    inward = guard.filter(Twist(0.0, 1 / 30), scene, REST, box, Brake(REST, 0))
    outward = guard.filter(Twist(0.0, -1 / 30), scene, REST, box, Brake(REST, 0))
    assert inward.verdict is Verdict.ADMITTED
    assert inward.clearance == pytest.approx(math.radians(-5))
    assert outward.verdict is not Verdict.ADMITTED
    assert outward.twist.omega >= 0.0


def test_behind_the_camera_it_brakes():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, 1.5, math.radians(120))
    applied = Twist(0.1, 0.1)
    brake = Brake(applied, limits.brake_ticks(applied, PERIOD), True)
    outcome = guard.filter(applied, scene, applied, limits.input_box(applied, PERIOD), brake)
    assert outcome.verdict is Verdict.BRAKED
    assert outcome.twist == brake.next().twist
    assert outcome.certified


def test_a_chassis_that_did_not_follow_voids_the_certificate():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, 1.5, math.radians(120))
    elsewhere = Twist(0.2, 0.0)
    box = limits.input_box(elsewhere, PERIOD)
    outcome = guard.filter(elsewhere, scene, elsewhere, box, Brake(REST, 0))
    assert not outcome.certified
    assert outcome.twist == Twist(box.v_lo, 0.0)


@pytest.mark.parametrize("lag", [-0.1, math.nan, math.inf])
def test_bad_lag(lag):
    with pytest.raises(ConfigurationError, match="lag"):
        Guard(Limits(1, 1, 1, 1), (), PERIOD, lag)


def test_recovery_from_outside_does_not_stall_with_lag():
    """A lagging body outside the view is turned back in, not started and stopped."""
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits, lag=0.28, margin=math.radians(3))
    scene = scene_at(camera, 1.5, math.radians(38))
    body, applied, brake = REST, REST, Brake(REST, 0)
    for _ in range(90):
        box = limits.input_box(applied, PERIOD)
        inward = box.clip(Twist(0.0, -1.5 * min(guard.clearance(scene), 0.0)))
        outcome = guard.filter(inward, scene, body, box, brake)
        brake, applied = outcome.brake, outcome.twist
        body, mean = body_after(body, applied, PERIOD, 0.12)
        scene = moved_scene(scene, arc(mean, PERIOD))
    assert guard.clearance(scene) > math.radians(-0.3)
