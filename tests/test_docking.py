"""Docking runs: arrival, backing off, undocking, loss and recovery, replay."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import DockingController, FieldOfView, Limits, Observation, Phase, Pose2, Status, Twist
from clfcbf.docking import DockingInputs, DockingState, docking_tick
from clfcbf.errors import ConfigurationError
from clfcbf.simulation.campaign import EpisodeSpec, run_specs, simulate, summarise
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World, facing
from clfcbf.simulation.sensor import PoseSensor, SensorModel

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
WORLD = World()
CAMERA = WORLD.camera
REST = Twist(0.0, 0.0)


class Blindfold:
    """A sensor that can be covered, and whose measurements can be replaced."""

    def __init__(self, sensor, covered=lambda now: False, change=lambda seen, now: seen):
        self.sensor, self.covered, self.change = sensor, covered, change
        self.now = 0.0

    def capture(self):
        self.sensor.capture()

    def observe(self):
        self.now += PERIOD
        seen = self.sensor.observe()
        if seen is None or self.covered(self.now):
            return None
        return self.change(seen, self.now)


def make_run(start, *, ideal=True, seed=0, wrap=None, world=WORLD, **options):
    body = Body.ideal() if ideal else Body()
    plant = KinematicPlant(start, LIMITS, body, np.random.default_rng([seed, 1]))
    model = SensorModel.named("ideal" if ideal else "A")
    sensor = PoseSensor(plant, CAMERA, WORLD.standoff, model, np.random.default_rng([seed, 2]))
    controller = DockingController(LIMITS, CAMERA, WORLD.standoff, PERIOD, lag=body.lag, **options)
    return plant, (wrap(sensor) if wrap else sensor), controller, world


def run(start, **options):
    plant, sensor, controller, world = make_run(start, **options)
    result, trace = run_episode(plant, sensor, controller, world, LIMITS)
    return result, trace, controller


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ideal_runs_end_within_millimetres_and_never_lose_the_view(seed):
    result, _ = simulate(EpisodeSpec(region="R1", seed=seed, ideal=True))
    assert result.outcome == "ok"
    assert result.strict
    assert math.hypot(result.e_lon_mm, result.e_lat_mm) < 6.0
    assert result.min_fov_margin_deg >= 0.0
    assert result.limit_violations == result.unguarded_ticks == 0


@pytest.mark.parametrize("region", ["R1", "R3", "R4"])
def test_runs_with_lag_noise_and_latency(region):
    specs = [EpisodeSpec(region=region, seed=77, index=i) for i in range(6)]
    summary = summarise(list(run_specs(specs)))
    assert summary["success"] == summary["strict"] == 6
    assert summary["fov_lost"] == 0
    assert summary["limit_violations"] == 0
    assert summary["unguarded_ticks"] == 0


def test_workers_change_nothing():
    specs = [EpisodeSpec(region="R3", seed=5, index=i) for i in range(3)]
    untimed = [
        {k: v for k, v in record.items() if not k.startswith("step_us")}
        for workers in (1, 2)
        for record in run_specs(specs, workers)
    ]
    assert untimed[:3] == untimed[3:]


def test_a_run_replays_to_the_last_bit():
    plant, sensor, controller, _ = make_run(facing(-1.4, 0.4, 0.2, WORLD), ideal=False)
    log, state = [], DockingState()
    for _ in range(200):
        sensor.capture()
        inputs = DockingInputs(sensor.observe(), plant.applied())
        decision, after = docking_tick(controller.config, state, inputs, plant.time)
        log.append((state, inputs, plant.time, decision, after))
        state = after
        plant.send(decision.twist)
        plant.advance(PERIOD)
    assert plant.pose().x > -1.0
    state = DockingState()
    for _, inputs, now, decision, _ in log:
        again, state = docking_tick(controller.config, state, inputs, now)
        assert again.twist == decision.twist
        assert again.status is decision.status
    assert state == log[-1][4]


@pytest.mark.parametrize(("x", "y", "bearing"), [(-0.5, 0.5, -0.3), (-0.6, -0.6, -0.2)])
def test_too_close_and_to_the_side_it_backs_off_first(x, y, bearing):
    result, trace, _ = run(facing(x, y, bearing, WORLD), ideal=False)
    phases = [d.phase for d in trace.decisions]
    assert Phase.BACKING_OFF in phases or Phase.TURNING in phases
    assert result.strict
    assert result.min_fov_margin_deg >= 0.0


def test_off_to_the_side_at_the_end_it_tries_again():
    """The target is shifted sideways just before arrival: there is no way but back."""
    plant, sensor, controller, world = make_run(facing(-1.2, 0.2, 0.1, WORLD), ideal=False)
    shifted = []

    def nudge(plant):
        if not shifted and plant.pose().x > -0.06:
            plant.move_target(Pose2(0.0, 0.035, 0.0))
            shifted.append(plant.time)

    result, trace = run_episode(plant, sensor, controller, world, LIMITS, nudge)
    assert shifted
    assert controller.state.attempts >= 2
    assert any(d.phase is Phase.BACKING_OFF for d in trace.decisions)
    assert result.strict


def test_a_nudged_target_is_followed():
    plant, sensor, controller, world = make_run(facing(-1.8, 0.3, 0.1, WORLD), ideal=False)
    done = []

    def nudge(plant):
        if not done and plant.pose().x > -1.0:
            plant.move_target(Pose2(0.03, 0.04, math.radians(3)))
            done.append(True)

    result, _ = run_episode(plant, sensor, controller, world, LIMITS, nudge)
    assert done
    assert result.strict


def test_undocking_reverses_straight_out_and_is_done():
    result, _, controller = run(facing(-1.2, 0.1, 0.0, WORLD))
    assert result.strict
    plant, sensor, controller, _ = make_run(Pose2(0.0, 0.0, 0.0), ideal=False)
    controller.undock(0.7)
    decision = None
    for _ in range(300):
        sensor.capture()
        decision = controller.step(sensor.observe(), plant.applied(), plant.time)
        plant.send(decision.twist)
        plant.advance(PERIOD)
        if decision.done:
            break
    assert decision.done
    assert decision.phase is Phase.DONE
    assert plant.pose().x == pytest.approx(-0.7, abs=0.02)
    assert abs(plant.pose().y) < 0.01
    controller.dock()
    for _ in range(400):
        sensor.capture()
        decision = controller.step(sensor.observe(), plant.applied(), plant.time)
        plant.send(decision.twist)
        plant.advance(PERIOD)
    assert decision.done
    assert math.hypot(*plant.pose()[:2]) < 0.01


@pytest.mark.parametrize("distance", [0.0, -1.0, math.nan])
def test_bad_undock_distance(distance):
    with pytest.raises(ConfigurationError, match="distance"):
        DockingController(LIMITS, CAMERA, 0.6, PERIOD).undock(distance)


def test_a_short_loss_is_bridged_by_dead_reckoning():
    covered = lambda now: 3.0 < now < 4.5  # noqa: E731
    result, trace, _ = run(
        facing(-1.8, 0.4, 0.1, WORLD), ideal=False, wrap=lambda s: Blindfold(s, covered)
    )
    assert result.strict
    assert not any(d.status is Status.STALE for d in trace.decisions)


def test_a_longer_loss_stops_the_robot_and_it_goes_on_when_it_sees_again():
    covered = lambda now: 3.0 < now < 7.0  # noqa: E731
    result, trace, _ = run(
        facing(-1.8, 0.4, 0.1, WORLD), ideal=False, wrap=lambda s: Blindfold(s, covered)
    )
    stale = [k for k, d in enumerate(trace.decisions) if d.status is Status.STALE]
    assert stale
    assert trace.decisions[stale[-1]].twist == REST
    assert result.strict


def test_a_lost_target_ends_the_run_with_the_reason():
    result, trace, _ = run(
        facing(-1.8, 0.4, 0.1, WORLD), wrap=lambda s: Blindfold(s, lambda now: now > 3.0)
    )
    last = trace.decisions[-1]
    assert result.outcome == "lost"
    assert last.phase is Phase.FAILED
    assert "lost" in last.reason
    assert last.twist == REST


def test_a_target_never_seen_is_waited_for_at_rest():
    world = World(patience=3.0)
    result, trace, _ = run(
        facing(-1.8, 0.4, 0.1, WORLD), wrap=lambda s: Blindfold(s, lambda now: True), world=world
    )
    assert result.outcome == "timeout"
    assert all(d.status is Status.NO_TARGET and d.twist == REST for d in trace.decisions)


def test_broken_measurements_brake_for_a_tick_and_are_not_believed():
    def change(seen, now):
        if 2.0 < now < 2.1:
            return Observation(Pose2(math.nan, 0.0, 0.0), seen.feature, seen.stamp)
        if 2.5 < now < 2.6:
            return Observation(seen.goal, seen.feature, now + 60.0)
        if 3.0 < now < 3.1:
            return Observation(Pose2(-1.0, 0.0, 0.0), Pose2(-0.5, 0.0, 0.0), seen.stamp)
        return seen

    result, trace, _ = run(
        facing(-1.8, 0.4, 0.1, WORLD), ideal=False, wrap=lambda s: Blindfold(s, change=change)
    )
    seen = {d.status for d in trace.decisions}
    assert {Status.INVALID_INPUT, Status.CLOCK_ERROR, Status.OUT_OF_VIEW} <= seen
    assert result.strict


def test_an_outlier_as_first_look_does_not_start_a_plan():
    def change(seen, now):
        if now < 0.05:
            return Observation(Pose2(1.0, 0.5, 0.4), Pose2(1.55, 0.7, 0.4), seen.stamp)
        return seen

    result, _, controller = run(
        facing(-1.6, 0.3, 0.1, WORLD), wrap=lambda s: Blindfold(s, change=change)
    )
    assert result.strict
    assert controller.state.attempts == 1


def test_a_start_it_cannot_leave_fails_with_the_reason():
    camera = FieldOfView(math.radians(5.0), Pose2(0.2, 0.0, 0.0))
    controller = DockingController(LIMITS, camera, 0.6, PERIOD)
    start = facing(-0.5, 0.5, 0.0, World(camera=camera))
    goal = start.relative(Pose2(0.0, 0.0, 0.0))
    feature = start.relative(Pose2(0.6, 0.0, 0.0))
    for k in range(4):
        now = k * PERIOD
        decision = controller.step(Observation(goal, feature, now), REST, now)
    assert decision.phase is Phase.FAILED
    assert "no approach" in decision.reason
    assert decision.twist == REST
    assert not decision.done


def test_a_failed_episode_is_recorded_whole():
    plant, sensor, controller, _ = make_run(facing(-1.8, 0.4, 0.1, WORLD))
    result, _ = run_episode(plant, sensor, controller, World(patience=0.5), LIMITS)
    assert result.outcome == "timeout"
    assert not result.success
    assert not result.strict
    numbers = [getattr(result, n) for n in result.__slots__ if n not in ("outcome", "reason")]
    assert all(math.isfinite(float(n)) for n in numbers)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("region", "R99"),
        ("plant", "gazebo"),
        ("controller", "mpc"),
        ("sensor", "Z"),
        ("limits", "x"),
    ],
)
def test_unknown_names_list_the_choices(field, value):
    with pytest.raises(ConfigurationError, match=r"choose|one of|valid"):
        EpisodeSpec(**{field: value})


def drive(controller, plant, sensor, ticks, shift=0.0, cover=lambda k: False):
    """Run some ticks by hand; the clock may be shifted, the camera covered."""
    decisions = []
    for k in range(ticks):
        sensor.capture()
        seen = sensor.observe()
        if seen is not None and cover(k):
            seen = None
        if seen is not None and shift:
            seen = Observation(seen.goal, seen.feature, seen.stamp + shift, seen.covariance)
        decision = controller.step(seen, plant.applied(), plant.time + shift)
        plant.send(decision.twist)
        plant.advance(PERIOD)
        decisions.append(decision)
    return decisions


def test_a_clock_that_jumps_back_does_not_hide_a_lost_target():
    plant, sensor, controller, _ = make_run(facing(-1.8, 0.4, 0.1, WORLD))
    drive(controller, plant, sensor, 60, shift=1000.0)
    after = drive(controller, plant, sensor, 400, cover=lambda k: True)
    assert after[0].status is Status.CLOCK_ERROR
    assert after[-1].phase is Phase.FAILED
    assert "lost" in after[-1].reason


def test_a_clock_that_jumps_back_is_survived():
    plant, sensor, controller, _ = make_run(facing(-1.5, 0.2, 0.1, WORLD))
    drive(controller, plant, sensor, 60, shift=1000.0)
    assert drive(controller, plant, sensor, 500)[-1].done
    assert math.hypot(*plant.pose()[:2]) < 0.01


def test_undocking_after_a_long_wait_needs_no_fresh_sight():
    plant, sensor, controller, _ = make_run(facing(-1.2, 0.1, 0.0, WORLD))
    assert drive(controller, plant, sensor, 400)[-1].done
    assert drive(controller, plant, sensor, 900, cover=lambda k: True)[-1].done
    controller.undock(0.5)
    decisions = drive(controller, plant, sensor, 250, cover=lambda k: k > 10)
    assert decisions[-1].done
    assert plant.pose().x == pytest.approx(-0.5, abs=0.02)


def test_undocking_without_reverse_is_refused():
    limits = Limits(0.22, 0.4, 0.3, 1.0, v_min=0.0)
    with pytest.raises(ConfigurationError, match="reverse"):
        DockingController(limits, CAMERA, 0.6, PERIOD).undock(0.5)


def test_one_measurement_twice_counts_once():
    controller = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    once = Observation(Pose2(1.5, 0.1, 0.0), Pose2(2.1, 0.1, 0.0), 0.0)
    for k in range(6):
        decision = controller.step(once, REST, k * PERIOD)
    assert decision.status is Status.NO_TARGET
    assert controller.state.target.accepted == 1


@pytest.mark.parametrize(
    "covariance",
    [
        np.diag([1.0, 1.0, -1.0]),
        np.eye(6),
        np.zeros((3, 3)),
        ((math.nan,) * 3,) * 3,
        ((1.0, 0.5, 0.0), (-0.5, 1.0, 0.0), (0.0, 0.0, 1.0)),
        "none",
    ],
)
def test_a_covariance_that_is_none_is_an_invalid_input(covariance):
    controller = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    bad = Observation(Pose2(1.5, 0.1, 0.0), Pose2(2.1, 0.1, 0.0), 0.0, covariance)
    assert controller.step(bad, REST, 0.0).status is Status.INVALID_INPUT
    assert controller.state.target is None


def test_a_covariance_may_be_an_array_or_singular():
    controller = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    for k in range(3):
        now, goal = k * PERIOD, Pose2(1.5, 0.1, 0.0)
        flat = np.diag([1e-4, 0.0, 0.0])
        decision = controller.step(Observation(goal, Pose2(2.1, 0.1, 0.0), now, flat), REST, now)
    assert not decision.status.is_fault


@pytest.mark.parametrize("standoff", [0.3, 1.0])
def test_a_feature_that_is_not_where_it_was_configured_is_refused(standoff):
    controller = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    seen = Observation(Pose2(1.5, 0.0, 0.0), Pose2(1.5 + standoff, 0.0, 0.0), 0.0)
    assert controller.step(seen, REST, 0.0).status is Status.INVALID_INPUT


def test_at_the_goal_there_is_nothing_to_do():
    for x in (-0.002, 0.0, 0.002):
        plant, sensor, controller, _ = make_run(Pose2(x, 0.0, 0.0))
        decisions = drive(controller, plant, sensor, 10)
        assert decisions[-1].done
        assert all(d.twist == REST for d in decisions)


def test_no_progress_ends_in_failure_and_says_so():
    """The chassis takes commands and does not move."""
    _, sensor, controller, _ = make_run(facing(-1.5, 0.2, 0.1, WORLD))
    goal = sensor.observe()
    start = facing(-1.5, 0.2, 0.1, WORLD)
    goal, feature = start.relative(Pose2(0, 0, 0)), start.relative(Pose2(0.6, 0, 0))
    reasons = set()
    for k in range(30 * 90):
        now = k * PERIOD
        decision = controller.step(Observation(goal, feature, now), REST, now)
        reasons.add(decision.reason)
        if decision.phase is Phase.FAILED:
            break
    assert decision.phase is Phase.FAILED
    assert "stuck" in decision.reason
