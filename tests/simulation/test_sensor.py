"""The pose sensor: what it sees, when it says so, and how large its errors are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.hardware.protocols import TargetSensor
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.sensor import PoseSensor, SensorModel, goal_covariance, measured_board
from clfcbf.simulation.sensor_model import BiasBounds, Sigma, Spread
from clfcbf.simulation.sensor_noise import SensorNoise, ViewError

CAMERA = FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
STANDOFF = 0.6
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
TICK = 1.0 / 30.0
START = Pose2(-1.4, 0.4, -0.1)
CLEAN = replace(SensorModel(), jitter=0.0, dropout=0.0, outlier=0.0)

poses = st.builds(Pose2, st.floats(-3.0, 0.3), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0))


def still(pose=START):
    return KinematicPlant(pose, LIMITS, Body.ideal(), np.random.default_rng(0))


def sensor(plant, model, seed=0, camera=CAMERA):
    return PoseSensor(plant, camera, STANDOFF, model, np.random.default_rng(seed))


def seen_from(pose):
    """Distance and bearing of the board's centre at the camera, out of the law of cosines."""
    eye = (pose.x + 0.2 * math.cos(pose.theta), pose.y + 0.2 * math.sin(pose.theta))
    ray = complex(STANDOFF - eye[0], -eye[1]) / complex(math.cos(pose.theta), math.sin(pose.theta))
    return abs(ray), math.atan2(ray.imag, ray.real)


def frames(robot, watcher, count, tick=TICK, between=None):
    """Observations of ``count`` ticks."""
    found = []
    for k in range(count):
        watcher.capture()
        observation = watcher.observe()
        if observation is not None:
            found.append(observation)
        if between is not None:
            robot.send(between(k))
        robot.advance(tick)
    return found


def errors_in_view(observations, pose):
    """Errors of the measured board along and across the line of sight, and in yaw."""
    board = pose.relative(Pose2(STANDOFF, 0.0, 0.0))
    _, bearing = seen_from(pose)
    rows = []
    for observation in observations:
        dx, dy = observation.feature.x - board.x, observation.feature.y - board.y
        rows.append(
            (
                math.cos(bearing) * dx + math.sin(bearing) * dy,
                math.cos(bearing) * dy - math.sin(bearing) * dx,
                wrap_angle(observation.feature.theta - board.theta),
            )
        )
    return np.array(rows)


@given(poses)
def test_ideal_sensor_is_exact_at_once_and_only_in_view(pose):
    distance, bearing = seen_from(pose)
    assume(abs(abs(bearing) - CAMERA.half_angle) > 1e-9)
    assume(distance > 1e-6)
    robot = still(pose)
    watcher = sensor(robot, SensorModel.ideal())
    watcher.capture()
    observation = watcher.observe()
    assert (observation is not None) == (abs(bearing) < CAMERA.half_angle)
    if observation is not None:
        goal = pose.compose(observation.goal)
        feature = pose.transform((observation.feature.x, observation.feature.y))
        assert tuple(goal) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        assert feature == pytest.approx((STANDOFF, 0.0), abs=1e-12)
        assert observation.stamp == 0.0
        assert np.linalg.eigvalsh(np.array(observation.covariance)).min() > 0.0
    assert watcher.observe() is None


@given(poses, st.sampled_from("ABC"), st.integers(0, 1000))
def test_no_frame_when_the_centre_is_out_of_view(pose, level, seed):
    assume(abs(seen_from(pose)[1]) > CAMERA.half_angle)
    robot = still(pose)
    assert frames(robot, sensor(robot, SensorModel.named(level), seed), 10) == []


def test_view_is_the_cameras_own():
    robot = still(Pose2(-1.0, 0.0, 0.0))
    turned = FieldOfView(math.radians(10.0), Pose2(0.2, 0.0, math.radians(15.0)))
    assert frames(robot, sensor(robot, SensorModel.ideal(), camera=turned), 3) == []
    turned = replace(turned, half_angle=math.radians(16.0))
    assert len(frames(still(), sensor(robot, SensorModel.ideal(), camera=turned), 1)) == 1


@pytest.mark.parametrize("start", [START, Pose2(-0.2, 0.05, 0.1), Pose2(-2.4, -0.8, 0.3)])
def test_white_noise_has_the_declared_sigma(start):
    robot = still(start)
    observations = frames(robot, sensor(robot, CLEAN, seed=11), 4000)
    errors = errors_in_view(observations, start)
    z, _ = seen_from(start)
    declared = (0.002 + 0.001 * z**2, 0.004 * z, math.radians(0.3) * z)
    assert len(errors) > 3900
    assert errors.std(axis=0) == pytest.approx(declared, rel=0.05)
    assert errors.mean(axis=0) / declared == pytest.approx((0.0, 0.0, 0.0), abs=0.06)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.06
    assert abs(np.corrcoef(errors[1:, 1], errors[:-1, 1])[0, 1]) < 0.06


def test_covariance_is_that_of_the_measured_goal():
    robot = still()
    observations = frames(robot, sensor(robot, CLEAN, seed=12), 6000)
    truth = START.inverse()
    errors = np.array(
        [
            (o.goal.x - truth.x, o.goal.y - truth.y, wrap_angle(o.goal.theta - truth.theta))
            for o in observations
        ]
    )
    sample = np.cov(errors.T)
    declared = np.mean([o.covariance for o in observations], axis=0)
    scale = np.sqrt(np.diag(declared))
    assert (sample - declared) / np.outer(scale, scale) == pytest.approx(np.zeros((3, 3)), abs=0.06)
    # the yaw error moves the goal: without it the two would be independent
    assert abs(declared[1, 2]) / (scale[1] * scale[2]) > 0.2


@given(
    poses,
    st.floats(0.0, 1.0),
    *3 * [st.floats(1e-4, 0.1)],
)
def test_covariance_is_the_propagated_one(pose, standoff, along, across, yaw):
    board = pose.relative(Pose2(STANDOFF, 0.0, 0.0))
    camera = CAMERA.camera
    assume(math.hypot(board.x - camera.x, board.y - camera.y) > 0.01)

    def goal(*error):
        measured = measured_board(board, camera, ViewError(*error))
        return np.array(measured.compose(Pose2(-standoff, 0.0, 0.0)))

    step = 1e-5
    columns = []
    for axis in np.eye(3):
        difference = goal(*(step * axis)) - goal(*(-step * axis))
        difference[2] = wrap_angle(difference[2])
        columns.append(difference / (2 * step))
    jacobian = np.array(columns).T
    declared = np.array(goal_covariance(board, camera, standoff, Sigma(along, across, yaw)))
    expected = jacobian @ np.diag((along**2, across**2, yaw**2)) @ jacobian.T
    # central differences err by step²/6, the resolution adds 1e-12 in each axis
    assert declared == pytest.approx(expected, abs=1e-11)
    assert (declared == declared.T).all()
    assert np.linalg.eigvalsh(declared).min() > 0.0


@given(st.integers(0, 2**32 - 1))
def test_latency_of_a_run_is_in_its_range(seed):
    noise = SensorNoise(SensorModel(), np.random.default_rng(seed))
    assert 0.06 <= noise.latency <= 0.12


def test_delay_is_latency_and_jitter():
    noise = SensorNoise(SensorModel(), np.random.default_rng(2))
    delays = np.array([noise.draw(k * TICK).delay for k in range(4000)])
    assert delays.mean() == pytest.approx(noise.latency, abs=5e-4)
    assert delays.std() == pytest.approx(0.01, rel=0.05)
    spread = [
        SensorNoise(SensorModel(), np.random.default_rng(seed)).latency for seed in range(2000)
    ]
    assert np.quantile(spread, (0.0, 0.25, 0.5, 1.0)) == pytest.approx(
        (0.06, 0.075, 0.09, 0.12), abs=2.5e-3
    )


def test_delay_is_positive_when_the_jitter_exceeds_the_latency():
    model = replace(SensorModel(), latency=(0.001, 0.001), jitter=0.05)
    noise = SensorNoise(model, np.random.default_rng(3))
    delays = [noise.draw(k * TICK).delay for k in range(2000)]
    assert min(delays) > 0.0
    assert np.mean(np.array(delays) > 0.05) > 0.2


def test_a_frame_comes_when_its_latency_has_passed():
    model = replace(CLEAN, latency=(0.09, 0.09))
    robot = still()
    watcher = sensor(robot, model)
    arrivals = {}
    for k in range(500):
        if k % 100 == 0:
            watcher.capture()
        observation = watcher.observe()
        if observation is not None:
            arrivals[observation.stamp] = robot.time
        robot.advance(0.001)
    assert len(arrivals) == 5
    for stamp, arrival in arrivals.items():
        assert arrival - stamp == pytest.approx(0.09, abs=1.001e-3)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2))
def test_stamps_rise_though_frames_overtake(seed, jitter):
    model = replace(SensorModel(), jitter=jitter)
    robot = still()
    observations = frames(robot, sensor(robot, model, seed), 60)
    stamps = [observation.stamp for observation in observations]
    assert stamps == sorted(set(stamps))
    assert len(stamps) > 10


def test_the_newest_frame_is_handed_out_and_older_ones_are_dropped():
    model = replace(CLEAN, latency=(0.0, 0.0))
    robot = still()
    watcher = sensor(robot, model)
    for _ in range(5):
        watcher.capture()
        robot.advance(TICK)
    observation = watcher.observe()
    assert observation is not None
    assert observation.stamp == pytest.approx(4 * TICK)
    assert watcher.observe() is None


@pytest.mark.parametrize(("ticks", "expected"), [(10, 10), (30, 30), (50, 30), (100, 30)])
def test_frames_come_at_the_cameras_rate_or_at_every_tick(ticks, expected):
    robot = still()
    observations = frames(robot, sensor(robot, SensorModel.ideal()), 20 * ticks, 1.0 / ticks)
    assert len(observations) == 20 * expected
    for observation in observations:
        assert observation.stamp * ticks == pytest.approx(round(observation.stamp * ticks))


def test_one_tick_gives_one_frame():
    robot = still()
    watcher = sensor(robot, SensorModel.ideal())
    watcher.capture()
    assert watcher.observe() is not None
    watcher.capture()
    assert watcher.observe() is None


def test_dropouts_and_outliers_come_as_often_as_declared():
    model = replace(SensorModel.ideal(), dropout=0.1, outlier=0.2)
    robot = still()
    observations = frames(robot, sensor(robot, model, seed=21), 6000)
    assert len(observations) / 6000 == pytest.approx(0.9, abs=0.015)
    errors = errors_in_view(observations, START)
    off = errors[np.abs(errors).max(axis=1) > 1e-9]
    assert len(off) / len(errors) == pytest.approx(0.2, abs=0.02)
    bound = np.array((0.5, 0.5, math.radians(30.0)))
    assert (np.abs(off) <= bound + 1e-9).all()
    assert off.std(axis=0) / bound == pytest.approx(1.0 / math.sqrt(3.0), rel=0.06)


def test_a_seed_decides_the_run():
    def run(seed):
        robot = still()
        return frames(robot, sensor(robot, SensorModel.named("B"), seed), 60)

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_one_seed_means_one_noise_whatever_the_robot_does():
    away = Pose2(-1.5, 0.0, math.radians(60.0))  # the board is out of view for a second
    runs = []
    for start, turn in ((Pose2(-1.5, 0.0, 0.0), 0.0), (away, -0.4)):
        robot = still(start)
        watcher = sensor(robot, replace(CLEAN, latency=(0.0, 0.0)), seed=5)
        runs.append(frames(robot, watcher, 90, between=lambda _, w=turn: Twist(0.0, w)))
    steady, turning = ({o.stamp: o for o in run} for run in runs)
    assert 10 < len(turning) < len(steady) == 90
    for stamp, observation in turning.items():
        pose = away.moved(Twist(0.0, -0.4), stamp)
        z = (seen_from(Pose2(-1.5, 0.0, 0.0))[0], seen_from(pose)[0])
        one, other = (
            errors_in_view([o], p)[0, 2]
            for o, p in ((steady[stamp], Pose2(-1.5, 0.0, 0.0)), (observation, pose))
        )
        assert one / z[0] == pytest.approx(other / z[1], abs=1e-9)


def test_level_b_has_a_calibration_error_and_a_gauss_markov_one():
    model = SensorModel.named("B")
    size = np.array((0.005, 0.005, math.radians(0.5)))
    first = np.array(
        [SensorNoise(model, np.random.default_rng(seed)).draw(0.0).slow for seed in range(3000)]
    )
    # two independent errors of one size
    assert first.std(axis=0) / size == pytest.approx(math.sqrt(2.0), rel=0.05)
    noise = SensorNoise(model, np.random.default_rng(6))
    slow = np.array([noise.draw(0.5 * k).slow for k in range(40000)])
    assert slow.std(axis=0) / size == pytest.approx(1.0, rel=0.05)
    slow -= slow.mean(axis=0)
    for lag in (1, 4):  # 0.5 s and 2 s
        kept = (slow[lag:] * slow[:-lag]).mean(axis=0) / slow.var(axis=0)
        assert kept == pytest.approx(math.exp(-0.25 * lag), abs=0.05)


def test_calibration_error_reaches_the_measurement():
    model = replace(SensorModel.ideal(), calibration=Spread(0.005, 0.01))
    for seed in range(5):
        slow = SensorNoise(model, np.random.default_rng(seed)).draw(0.0).slow
        robot = still()
        errors = errors_in_view(frames(robot, sensor(robot, model, seed), 3), START)
        assert errors == pytest.approx(np.array(3 * [slow]), abs=1e-12)
        assert np.abs(errors).min() > 0.0


def test_gauss_markov_error_does_not_depend_on_the_frame_rate():
    model = replace(SensorModel.ideal(), drift=Spread(0.005, 0.01))
    ends = {}
    for spacing, count in ((0.1, 20), (1.0, 2)):
        pairs = []
        for seed in range(2000):
            noise = SensorNoise(model, np.random.default_rng(seed))
            path = [noise.draw(spacing * k).slow.yaw for k in range(count + 1)]
            pairs.append((path[0], path[-1]))
        ends[spacing] = np.array(pairs)
    for pairs in ends.values():
        assert pairs.std(axis=0) == pytest.approx((0.01, 0.01), rel=0.06)
        assert np.corrcoef(pairs.T)[0, 1] == pytest.approx(math.exp(-1.0), abs=0.06)


@pytest.mark.parametrize(
    ("distance", "position", "degrees"),
    [(0.2, 0.01, 0.5), (0.4, 0.01, 0.5), (0.95, 0.055, 2.75), (1.5, 0.1, 5.0), (3.0, 0.1, 5.0)],
)
def test_level_c_is_biased_within_its_bounds(distance, position, degrees):
    model = replace(
        SensorModel.named("C"), range_noise=(0, 0), lateral_noise=0, yaw_noise=0, outlier=0
    )
    shares = []
    for seed in range(1000):
        noise = SensorNoise(model, np.random.default_rng(seed))
        errors = {noise.error(noise.draw(k * TICK), distance) for k in range(3)}
        assert len(errors) == 1
        shares.append(errors.pop())
    shares = np.array(shares) / (position, position, math.radians(degrees))
    assert np.abs(shares).max() <= 1.0 + 1e-12
    assert shares.std(axis=0) == pytest.approx(1.0 / math.sqrt(3.0), rel=0.06)


@given(poses, st.integers(0, 10000))
def test_biased_goal_is_the_standoff_ahead_of_the_measured_board(pose, seed):
    robot = still(pose)
    for observation in frames(robot, sensor(robot, SensorModel.named("C"), seed), 6):
        x, y, theta = observation.feature
        expected = (x - STANDOFF * math.cos(theta), y - STANDOFF * math.sin(theta))
        assert observation.goal[:2] == pytest.approx(expected, abs=1e-12)
        assert observation.goal.theta == theta


def test_is_a_target_sensor():
    assert isinstance(sensor(still(), SensorModel()), TargetSensor)


def test_levels_by_name():
    assert SensorModel.named("A") == SensorModel()
    assert SensorModel.named("ideal") == SensorModel.ideal()
    with pytest.raises(ConfigurationError, match=r"'a'.*ideal, A, B or C"):
        SensorModel.named("a")


@pytest.mark.parametrize(
    "values",
    [
        {"rate": 0.0},
        {"latency": (0.1, 0.05)},
        {"latency": (-0.1, 0.05)},
        {"latency": (0.0, math.nan)},
        {"jitter": -0.01},
        {"dropout": 1.5},
        {"outlier": math.nan},
        {"range_noise": (0.002, math.inf)},
        {"lateral_noise": -1.0},
        {"yaw_noise": math.nan},
        {"calibration": Spread(-0.1, 0.0)},
        {"drift": Spread(0.0, math.nan)},
        {"bias": BiasBounds(1.5, Spread(0.1, 0.1), 0.4, Spread(0.1, 0.1))},
        {"bias": BiasBounds(0.4, Spread(-0.1, 0.1), 1.5, Spread(0.1, 0.1))},
    ],
)
def test_bad_model_is_refused(values):
    with pytest.raises(ConfigurationError, match=next(iter(values))):
        replace(SensorModel(), **values)


def test_bad_standoff_is_refused():
    with pytest.raises(ConfigurationError, match="standoff"):
        PoseSensor(still(), CAMERA, math.nan, SensorModel(), np.random.default_rng(0))
