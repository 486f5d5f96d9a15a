"""A lost target is looked for within bounds; near the goal it is not gone on blindly."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import DockingController, FieldOfView, Pose2, Status, Twist, defaults
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.decision import Event, Failure, Phase
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import TargetEstimate, grown
from clfcbf.recovery import Search, end_error, is_uncertain, next_leg, retrace
from clfcbf.scene import Scene
from clfcbf.se2 import arc
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import facing
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from clfcbf.tick import FilterConfig, FilterState, begin, finish
from clfcbf.trajectories.build import arc_path
from clfcbf.trajectories.following import FollowingGains, follow
from clfcbf.trajectories.legs import Path, Turn
from tests.test_docking import CAMERA, LIMITS, PERIOD, WORLD, Blindfold, make_run, run

ORIGIN = Pose2(0.0, 0.0, 0.0)
REST = Twist(0.0, 0.0)
EXACT = ((1e-8, 0.0, 0.0), (0.0, 1e-8, 0.0), (0.0, 0.0, 1e-8))
MODEL = defaults.NOISE


# Growth of uncertainty ---------------------------------------------------------------------------


@given(st.integers(1, 60), st.floats(0.05, 0.5), st.floats(0.1, 3.0))
def test_uncertainty_after_a_way_does_not_depend_on_the_period(count, v, duration):
    """A scale error e of the speed shifts the goal by e times the way, in however many ticks."""
    estimate = TargetEstimate(Pose2(4.0, 0.0, 0.0), EXACT, 0.0, 5)
    step = duration / count
    for k in range(count):
        at = arc(Twist(v, 0.0), k * step)
        estimate = grown(estimate, Twist(v, 0.0), step, MODEL, at)
    added = estimate.covariance[0][0] - EXACT[0][0]
    assert math.sqrt(added) == pytest.approx(MODEL.along * v * duration, rel=1e-6)
    turn = math.sqrt(estimate.covariance[2][2] - EXACT[2][2])
    assert turn == pytest.approx(MODEL.drift * duration, rel=1e-6)
    time, way, angle = estimate.blind
    assert (time, way, angle) == pytest.approx((duration, v * duration, 0.0))


@given(st.floats(0.3, 3.0), st.floats(0.05, 0.3))
def test_a_gyro_bias_moves_the_goal_sideways_as_predicted(duration, v):
    """Runge-Kutta of a robot that turns unknowingly, for a bias of one standard deviation."""
    estimate = TargetEstimate(Pose2(2.0, 0.0, 0.0), EXACT, 0.0, 5)
    count = 60
    h = duration / count
    for k in range(count):
        estimate = grown(estimate, Twist(v, 0.0), h, MODEL, arc(Twist(v, 0.0), k * h))
    x = y = theta = 0.0
    for _ in range(count):
        middle = theta + 0.5 * h * MODEL.drift
        x, y = x + h * v * math.cos(middle), y + h * v * math.sin(middle)
        theta += h * MODEL.drift
    seen = Pose2(x, y, theta).relative(Pose2(2.0, 0.0, 0.0))
    believed = 0.0  # straight ahead
    sideways = abs(seen.y - believed)
    across = math.sqrt(estimate.covariance[1][1] - EXACT[1][1])
    slip = MODEL.across * v * duration
    assert math.sqrt(max(across**2 - slip**2, 0.0)) == pytest.approx(sideways, rel=0.1)


def blind_after(way, sigma=1e-4):
    start = ((sigma**2, 0.0, 0.0), (0.0, sigma**2, 0.0), (0.0, 0.0, sigma**2))
    estimate = TargetEstimate(Pose2(0.4, 0.0, 0.0), start, 0.0, 30)
    for _ in range(20):
        estimate = grown(estimate, Twist(way, 0.0), 0.05, MODEL, ORIGIN)
    return estimate, start


def test_uncertain_is_near_and_worse_than_the_last_look():
    near, far = Pose2(-0.3, 0.0, 0.0), Pose2(-0.6, 0.0, 0.0)
    estimate, seen = blind_after(0.5)  # 1.5 % of 0.5 m: 2 sigma are 15 mm
    assert is_uncertain(estimate, seen, near, 0.007)
    assert not is_uncertain(estimate, seen, far, 0.007)
    estimate, seen = blind_after(0.2)
    assert not is_uncertain(estimate, seen, near, 0.007)
    estimate, seen = blind_after(0.5, sigma=0.02)  # the sensor is no better than that
    assert not is_uncertain(estimate, seen, near, 0.007)


# What the law can still remove -------------------------------------------------------------------


@given(st.floats(-0.1, 0.1), st.floats(-0.3, 0.3), st.floats(0.0, 1.5))
def test_end_error_bounds_the_law(lateral, heading, rest):
    """Against the equation of the law per metre, by the matrix exponential's own series."""
    k2 = 25.0
    k = math.sqrt(k2)
    step = np.array([[0.0, 1.0], [-k2, -2.0 * k]]) * rest / 4096.0
    power = np.eye(2) + step + step @ step / 2.0 + step @ step @ step / 6.0
    for _ in range(12):
        power = power @ power
    left = (power @ [lateral, math.tan(heading)])[0]
    assert abs(left) <= end_error(lateral, heading, rest, k2) + 1e-9
    pushing = end_error(lateral, math.copysign(heading, lateral), rest, k2)
    outward = (power @ [lateral, math.copysign(math.tan(heading), lateral)])[0]
    assert abs(outward) == pytest.approx(pushing, abs=1e-8)


# The way back ------------------------------------------------------------------------------------


ways = st.tuples(
    st.floats(0.1, 1.5), st.floats(-0.8, 0.8), st.sampled_from([-1, 1]), st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)  # fmt: skip


@given(ways)
def test_the_way_back_is_the_way_it_came_and_short(drawn):
    length, swept, gear, reached, seen = drawn
    start = Pose2(-2.0, 0.3, 0.2)
    way = arc_path(start, length, swept, LIMITS, gear)
    reached, seen = reached * length, seen * reached * length
    back = retrace(way, reached, seen, LIMITS)
    wanted = min(reached - max(seen - defaults.RECOVERY_BEYOND, 0.0), defaults.RETRACE, reached)
    if back is None:
        assert wanted < 0.02 + 1e-9
        return
    assert back.gear == -gear
    assert back.length == pytest.approx(wanted, abs=1e-9)
    for s, pose in zip(back.s, back.poses, strict=True):
        there = start.compose(arc(Twist(float(gear), swept / length), reached - s))
        assert pose[:2] == pytest.approx(there[:2], abs=1e-4)
        assert pose.theta == pytest.approx(there.theta, abs=1e-3)
    assert max(back.speed) <= defaults.RETRACE_SPEED
    assert max(map(abs, back.turn_rate)) <= LIMITS.omega_max + 1e-9
    speed, rate = np.array(back.speed), np.array(back.turn_rate)
    turned = np.diff(np.unwrap([pose.theta for pose in back.poses]))
    step = np.diff(back.s)
    moving = (speed[1:] > 1e-3) & (speed[:-1] > 1e-3) & (step > 1e-3)
    curvature = rate[1:] / np.maximum(speed[1:], 1e-9)
    np.testing.assert_allclose(curvature[moving], (turned / step)[moving], atol=0.02)
    slowing = np.diff(speed**2) / (2.0 * np.maximum(step, 1e-9))
    assert slowing.min(initial=0.0) >= -LIMITS.a_max - 1e-6


@settings(max_examples=25)
@given(st.floats(0.4, 1.2), st.floats(-0.6, 0.6), st.sampled_from([-1, 1]))
def test_the_way_back_can_be_driven(length, swept, gear):
    way = arc_path(ORIGIN, length, swept, LIMITS, gear)
    back = retrace(way, length, 0.5 * length, LIMITS)
    plant = KinematicPlant(back.poses[0], LIMITS, Body.ideal(), np.random.default_rng(0))
    s = path = 0.0
    for _ in range(400):
        box = LIMITS.input_box(plant.applied(), PERIOD)
        following = follow(back, False, plant.pose(), s, box, LIMITS, PERIOD, FollowingGains())
        if following.arrived and plant.applied() == REST:
            break
        s = following.s
        before = plant.pose()
        plant.send(following.twist if not following.arrived else box.clip(REST))
        plant.advance(PERIOD)
        path += math.hypot(plant.pose().x - before.x, plant.pose().y - before.y)
    assert plant.applied() == REST
    off = plant.pose().relative(back.end)
    assert math.hypot(off.x, off.y) < 0.02
    assert path <= back.length + 0.02


def test_there_is_no_way_back_without_reverse_or_room():
    way = arc_path(ORIGIN, 1.0, 0.2, LIMITS, 1)
    forward_only = type(LIMITS)(0.22, 0.4, 0.3, 1.0, v_min=0.0)
    assert retrace(way, 0.8, 0.4, forward_only) is None
    assert retrace(way, 0.01, 0.0, LIMITS) is None


def test_the_steps_of_a_search():
    pose, way = Pose2(-1.0, 0.3, 0.5), arc_path(Pose2(-1.5, 0.1, 0.2), 0.6, 0.3, LIMITS, 1)
    search, kinds = Search(way, 0.5, 0.3), []
    for _ in range(200):
        search, leg = next_leg(search, pose, WORLD.feature, CAMERA, LIMITS, PERIOD)
        kinds.append(type(leg))
        if isinstance(leg, Turn):
            turned = Pose2(pose.x, pose.y, leg.heading)
            assert abs(CAMERA.bearing(turned.seen(WORLD.feature))) < 1e-9
    legs = [kind for kind in kinds if kind is not type(None)]
    assert legs == [Turn, Path, Turn]
    look = kinds.index(Path) - kinds.index(Turn)
    assert defaults.RECOVERY_LOOK <= look * PERIOD < defaults.RECOVERY_LOOK + 3 * PERIOD


# In runs -----------------------------------------------------------------------------------------


class Shadow(Blindfold):
    """A sensor that sees nothing while the robot is where ``hidden`` says."""

    def __init__(self, sensor, plant, hidden):
        super().__init__(sensor)
        self.plant, self.hidden = plant, hidden
        self.blind_since = []

    def observe(self):
        seen = super().observe()
        return None if self.hidden(self.plant) else seen


def shadowed(start, hidden, **options):
    plant, sensor, controller, world = make_run(start, ideal=False, **options)
    result, trace = run_episode(plant, Shadow(sensor, plant, hidden), controller, world, LIMITS)
    return result, trace, controller


def test_a_long_loss_is_searched_for_and_ends_within_its_bounds():
    cover = 3.0
    result, trace, controller = run(
        facing(-1.9, 0.6, 0.2, WORLD), ideal=False,
        wrap=lambda s: Blindfold(s, lambda now: now > cover),
    )  # fmt: skip
    last = trace.decisions[-1]
    assert last.phase is Phase.FAILED
    assert last.failure is Failure.LOST
    assert result.outcome == "lost"
    searching = [k for k, d in enumerate(trace.decisions) if d.phase is Phase.SEARCHING]
    assert searching
    failed = next(k for k, d in enumerate(trace.decisions) if d.phase is Phase.FAILED)
    assert trace.times[failed] - cover <= controller.config.give_up + 0.2
    # It reverses no further than it may, never forward in the search, and ends where it had been.
    lost = searching[0]
    reverse = sum(
        math.dist(a[:2], b[:2])
        for a, b, d in zip(
            trace.poses[lost:failed], trace.poses[lost + 1 :], trace.decisions[lost:failed],
            strict=False,
        )
        if d.twist.v < 0.0
    )  # fmt: skip
    assert 0.3 < reverse <= defaults.RETRACE + 0.05
    where = trace.poses[-1]
    came = min(math.dist(where[:2], pose[:2]) for pose in trace.poses[:lost])
    assert came < 0.02
    assert trace.twists[-1].v == pytest.approx(0.0, abs=1e-6)
    # The feature is in view all the while: the search does not turn away from it.
    assert result.min_fov_margin_deg > 0.0
    assert all(d.certified for d in trace.decisions)


def test_out_of_a_shadow_it_goes_back_and_docks():
    """Hidden from 1.3 m to 0.7 m, for once: it comes to rest in there and backs out of it."""
    state = {"found": False, "entered": False}

    def hidden(plant):
        inside = -1.3 < plant.pose().x < -0.7
        state["entered"] = state["entered"] or inside
        if state["entered"] and not inside:
            state["found"] = True  # whatever cast the shadow leaves once it is seen
        return inside and not state["found"]

    result, trace, controller = shadowed(facing(-2.0, 0.3, 0.1, WORLD), hidden)
    phases = [d.phase for d in trace.decisions]
    assert state["found"]
    assert Phase.SEARCHING in phases
    backed = min(
        pose.x for pose, p in zip(trace.poses, phases, strict=True) if p.value == "searching"
    )
    assert backed < -1.29
    assert controller.state.attempts == 2
    assert result.strict


def test_found_while_it_looks_it_plans_anew_at_once():
    result, trace, _ = run(
        facing(-1.9, 0.5, 0.1, WORLD), ideal=False,
        wrap=lambda s: Blindfold(s, lambda now: 3.0 < now < 6.3),
    )  # fmt: skip
    searching = [t for t, d in zip(trace.times, trace.decisions, strict=True)
                 if d.phase is Phase.SEARCHING]  # fmt: skip
    assert 4.8 < searching[0] < 5.3
    assert searching[-1] < 6.6
    assert result.strict


def test_near_the_goal_it_waits_for_a_look_instead_of_going_on_blindly():
    """On a slippery floor; dead reckoning over the last half metre would end beside the goal."""
    noise = MODEL._replace(along=0.03)
    covered = []

    def hidden(plant):
        if plant.pose().x > -0.55 and not covered:
            covered.append(plant.time)
        return bool(covered) and plant.time < covered[0] + 1.7

    result, trace, _ = shadowed(facing(-1.7, 0.2, 0.1, WORLD), hidden, noise=noise)
    waits = [k for k, d in enumerate(trace.decisions) if Event.UNCERTAIN in d.events]
    assert waits
    assert all(trace.decisions[k].status is Status.STALE for k in waits)
    assert trace.poses[waits[-1]].x < -0.1
    assert Phase.SEARCHING not in [d.phase for d in trace.decisions]
    assert result.strict


def test_ordinary_runs_never_wait_nor_search():
    for seed in range(6):
        result, trace, _ = run(facing(-1.9, 0.5, 0.1, WORLD), ideal=False, seed=seed)
        events = {event for d in trace.decisions for event in d.events}
        assert events <= {Event.OUTLIER, Event.UNSEEN}
        assert Phase.SEARCHING not in [d.phase for d in trace.decisions]
        assert result.strict


def test_an_estimate_out_of_view_is_turned_back_to_through_the_guard():
    """The target is moved out of the controller's view, is seen there once by a wider camera,
    and no more: the robot turns to where it should be, and never further away from it."""
    wide = FieldOfView(math.radians(60.0), CAMERA.camera)
    body = Body()
    plant = KinematicPlant(
        facing(-1.6, 0.0, 0.0, WORLD), LIMITS, body, np.random.default_rng([0, 1])
    )
    sensor = PoseSensor(plant, wide, WORLD.standoff, SensorModel(), np.random.default_rng([0, 2]))
    controller = DockingController(LIMITS, CAMERA, WORLD.standoff, PERIOD, lag=body.lag)
    bearings, decisions, moved = [], [], None
    for _ in range(460):
        sensor.capture()
        if moved is None and plant.pose().x > -1.3:
            plant.move_target(Pose2(0.0, 1.6, 0.0))
            moved = plant.time
        seen = sensor.observe()
        if controller.state.events and Event.MOVED in controller.state.events:
            sensor.observe = lambda: None
        decision = controller.step(seen, plant.applied(), plant.time)
        plant.send(decision.twist)
        plant.advance(PERIOD)
        decisions.append(decision)
        if any(Event.MOVED in d.events for d in decisions):
            bearings.append(abs(CAMERA.bearing(plant.pose().seen(WORLD.feature))))
    assert bearings[0] > CAMERA.half_angle
    outside = [d for d in decisions if d.status is Status.OUT_OF_VIEW]
    assert outside
    assert bearings[-1] < math.radians(6.0)
    turning = [d for d in outside if d.phase is Phase.SEARCHING]
    assert turning
    assert all(d.twist.omega >= -1e-9 for d in turning)  # the target is to the left
    assert decisions[-1].failure is Failure.LOST


@settings(max_examples=40)
@given(st.floats(36.0, 85.0), st.sampled_from([-1.0, 1.0]), st.floats(0.5, 2.5))
def test_the_guard_admits_every_turn_back_into_view(bearing, side, distance):
    """From any bearing ahead of the camera, and no turn away from it."""
    angle = side * math.radians(bearing)
    eye = CAMERA.camera
    at = Pose2(eye.x + distance * math.cos(angle), eye.y + distance * math.sin(angle), 0.0)
    scene = Scene(at.compose(Pose2(-WORLD.standoff, 0.0, 0.0)), at, 0.0)
    barrier = FieldOfViewBarrier(CAMERA, 2.0, margin=defaults.VIEW_MARGIN)
    config = FilterConfig(LIMITS, (barrier,), PERIOD)
    begun = begin(config, FilterState(), REST, 0.0)
    for sign in (1.0, -1.0):
        wanted = begun.box.clip(Twist(0.0, sign * side * LIMITS.omega_max))
        decision, _ = finish(config, begun, wanted, scene, ORIGIN, ORIGIN)
        assert decision.status is Status.OUT_OF_VIEW
        if sign > 0.0:
            assert decision.twist.omega * side > 0.9 * LIMITS.alpha_max * PERIOD
        else:
            assert decision.twist.omega * side >= -1e-12


@pytest.mark.parametrize("watchdog", [0.0, -1.0, math.nan])
def test_bad_watchdog(watchdog):
    with pytest.raises(ConfigurationError, match="watchdog"):
        DockingController(LIMITS, CAMERA, 0.6, PERIOD, watchdog=watchdog)
