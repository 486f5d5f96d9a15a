"""The depth camera and the sensor on it: geometry, statistics, timing and paired seeds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.controller import DockingController
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.estimation import is_covariance
from clfcbf.hardware.protocols import TargetSensor
from clfcbf.limits import Limits
from clfcbf.perception import DepthNoise, DepthSpan, column_tangents
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.simulation.depth import DepthCamera, DepthModel, cast
from clfcbf.simulation.depth_sensor import DepthSensor
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensor import PoseSensor
from clfcbf.simulation.sensor_model import SensorModel, Spread
from clfcbf.simulation.sensor_noise import SensorNoise

CAMERA = FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
STANDOFF, WIDTH, TICK = 0.6, 0.5, 1.0 / 30.0
START = Pose2(-1.0, 0.3, -0.1)
TANGENTS = column_tangents(CAMERA.half_angle, 240)
FINE = DepthModel(
    frames=SensorModel.ideal(), noise=DepthNoise.none(), columns=4000, outliers=0.0, behind=None
)
"""No error but what a test puts in, and columns of a third of a millimetre at 1 m."""


def still(pose=START):
    return KinematicPlant(pose, LIMITS, Body.ideal(), np.random.default_rng(0))


def sensor(plant, model, seed=0, camera=CAMERA):
    return DepthSensor(plant, camera, STANDOFF, model, np.random.default_rng(seed), WIDTH)


def frames(robot, watcher, count):
    """Observations of ``count`` ticks at rest, each with the time it was handed out."""
    found = []
    for _ in range(count):
        watcher.capture()
        observation = watcher.observe()
        if observation is not None:
            found.append((robot.time, observation))
        robot.advance(TICK)
    return found


def errors(found, pose=START):
    """Errors (N, 3) of the board's pose in the robot frame."""
    board = pose.relative(Pose2(STANDOFF, 0.0, 0.0))
    rows = np.array([np.array(seen.feature) - board for _, seen in found])
    rows[:, 2] = [wrap_angle(e) for e in rows[:, 2]]
    return rows


# --- rays ---------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.floats(0.3, 3.0), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(0.1, 2.0))
def test_rays_meet_the_board_where_the_segments_cross(x, y, theta, width):
    tangents = TANGENTS[::8]
    t = np.array([-math.sin(theta), math.cos(theta)])
    for tangent, depth in zip(tangents, cast(Pose2(x, y, theta), width, tangents), strict=True):
        matrix = np.column_stack(([1.0, tangent], -t))
        if abs(np.linalg.det(matrix)) < 1e-6:
            continue
        z, along = np.linalg.solve(matrix, (x, y))
        if abs(abs(along) - 0.5 * width) < 1e-9 or abs(z) < 1e-9:
            continue
        if z > 0.0 and abs(along) < 0.5 * width:
            assert depth == pytest.approx(z, rel=1e-6)
        else:
            assert math.isnan(depth)


def test_board_along_a_ray_or_behind_is_not_seen():
    assert np.isnan(cast(Pose2(1.0, 0.0, math.pi / 2), WIDTH, np.array([-0.1, 0.1]))).all()
    assert np.isnan(cast(Pose2(-1.0, 0.0, 0.0), WIDTH, TANGENTS)).all()


@given(st.floats(0.1, 1.4), st.integers(2, 500))
def test_columns_part_the_image_evenly(half_angle, count):
    tangents = column_tangents(half_angle, count)
    edges = np.concatenate(([-math.tan(half_angle)], tangents, [math.tan(half_angle)]))
    gaps = np.diff(edges)
    assert gaps[1:-1] == pytest.approx(np.full(count - 1, 2 * math.tan(half_angle) / count))
    assert gaps[[0, -1]] == pytest.approx(math.tan(half_angle) / count)


def test_view_clips_the_board_and_the_wall_is_behind_it():
    camera = DepthCamera(replace(FINE, columns=240, behind=0.7), CAMERA.half_angle, WIDTH)
    draw = camera.draw(np.random.default_rng(0))
    depths = camera.columns(Pose2(1.0, 0.6, 0.0), draw).depths(DepthSpan())
    own = TANGENTS >= 0.35
    assert depths[own] == pytest.approx(1.0)
    assert depths[~own] == pytest.approx(1.7)
    far = camera.columns(Pose2(2.9, 0.0, 0.0), draw)
    assert np.array_equal(np.isfinite(far.ranges), np.abs(TANGENTS) <= 0.25 / 2.9)
    near = camera.columns(Pose2(0.2, 0.0, 0.0), draw)  # hides the wall and is too near itself
    assert np.isnan(near.ranges[np.abs(TANGENTS) < 0.6]).all()


# --- errors of columns --------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.6, 1.5, 2.5])
def test_noise_of_columns_is_the_stated_one(distance):
    model = replace(DepthModel.named("A"), outliers=0.0, behind=None)
    camera = DepthCamera(model, CAMERA.half_angle, 10.0)
    rng = np.random.default_rng(2)
    board = Pose2(distance, 0.0, 0.0)
    depths = np.array(
        [camera.columns(board, camera.draw(rng)).depths(DepthSpan(0.0, 9.0)) for _ in range(2000)]
    )
    error = depths - distance
    common = error.mean(axis=1)
    sigma = math.sqrt(3.0) * (0.0025 + 0.0015 * distance**2)
    assert (error - common[:, None]).std() == pytest.approx(sigma, rel=0.01)
    assert common.std() == pytest.approx(math.hypot(0.002, sigma / math.sqrt(240)), rel=0.06)
    assert abs(error.mean()) < 5.0 * common.std() / math.sqrt(2000)


def test_outliers_are_the_stated_share_and_anywhere_in_the_span():
    model = replace(FINE, outliers=0.1)
    camera = DepthCamera(model, CAMERA.half_angle, 10.0)
    depths = camera.columns(Pose2(1.0, 0.0, 0.0), camera.draw(np.random.default_rng(3))).depths(
        DepthSpan()
    )
    odd = depths[np.abs(depths - 1.0) > 1e-9]
    assert len(odd) / 4000 == pytest.approx(0.1, abs=0.02)
    assert (odd.min(), odd.max()) == pytest.approx((0.25, 3.2), abs=0.05)
    assert odd.mean() == pytest.approx(0.5 * (0.25 + 3.2), abs=0.15)


def test_every_frame_draws_the_same_number_of_variates():
    camera = DepthCamera(DepthModel.named("A"), CAMERA.half_angle, WIDTH)
    one, other = np.random.default_rng(4), np.random.default_rng(4)
    for board in (Pose2(1.0, 0.0, 0.0), Pose2(-1.0, 0.0, 0.0), Pose2(9.0, 0.0, 0.0)):
        camera.columns(board, camera.draw(one))
        camera.draw(other)
    assert one.random() == other.random()


# --- the sensor ---------------------------------------------------------------------------------


def test_sensor_takes_the_place_of_the_pose_sensor():
    robot = still()
    watcher = sensor(robot, DepthModel.named("A"))
    assert isinstance(watcher, PoseSensor)
    assert isinstance(watcher, TargetSensor)
    assert watcher.observe() is None


@given(st.floats(-1.6, 0.0), st.floats(-0.6, 0.6), st.floats(-0.3, 0.3))
def test_ideal_sensor_is_exact_to_a_column_and_at_once(x, y, theta):
    pose = Pose2(x, y, theta)
    robot = still(pose)
    watcher = sensor(robot, replace(DepthModel.named("ideal"), behind=None))
    watcher.capture()
    seen = watcher.observe()
    board = pose.relative(Pose2(STANDOFF, 0.0, 0.0))
    assume(CAMERA.margin(board[:2]) > math.radians(2.0))
    distance = math.hypot(board.x - 0.2, board.y)
    assume(distance < 2.2)
    if seen is None:
        return
    assert seen.stamp == 0.0
    assert wrap_angle(seen.feature.theta - board.theta) == pytest.approx(0.0, abs=1e-5)
    if math.atan(0.25 / distance) < CAMERA.margin(board[:2]) - 0.1:
        column = (TANGENTS[1] - TANGENTS[0]) * (distance + 0.25) * 2.0
        assert math.dist(seen.feature[:2], board[:2]) < column
        assert seen.goal.compose(Pose2(STANDOFF, 0.0, 0.0)) == pytest.approx(seen.feature)
        assert is_covariance(seen.covariance)


def test_frames_come_when_those_of_the_pose_sensor_come():
    for level in ("A", "B", "C"):
        model = replace(DepthModel.named(level), outliers=0.0)
        model = replace(model, frames=replace(model.frames, dropout=0.2, outlier=0.0))
        one, other = still(), still()
        mine = frames(one, sensor(one, model, 5), 120)
        plain = PoseSensor(other, CAMERA, STANDOFF, model.frames, np.random.default_rng(5))
        theirs = frames(other, plain, 120)
        assert [(t, seen.stamp) for t, seen in mine] == [(t, seen.stamp) for t, seen in theirs]
        assert 60 < len(mine) < 110


def test_board_is_measured_while_its_centre_is_out_of_view():
    pose = Pose2(-0.6, 0.0, math.radians(33.0))
    board = pose.relative(Pose2(STANDOFF, 0.0, 0.0))
    assert CAMERA.margin(board[:2]) < 0.0
    robot = still(pose)
    watcher = sensor(robot, DepthModel.named("ideal"))
    watcher.capture()
    assert watcher.observe().feature == pytest.approx(board, abs=0.01)
    away = still(Pose2(-0.6, 0.0, 2.0))
    watcher = sensor(away, DepthModel.named("ideal"))
    watcher.capture()
    assert watcher.observe() is None


def test_noise_of_the_pose_comes_out_of_the_fit_and_is_the_reported_one():
    model = replace(DepthModel.named("A"), frames=SensorModel.ideal())
    robot = still()
    found = frames(robot, sensor(robot, model, 6), 400)
    e = errors(found)
    reported = np.mean([np.array(seen.covariance) for _, seen in found], axis=0)
    assert e[:, 2].std() == pytest.approx(math.sqrt(reported[2, 2]), rel=0.12)
    assert 0.1 < math.degrees(e[:, 2].std()) < 1.0
    # At rest the board's ends stay between the same columns: an offset and no scatter.
    assert np.abs(e.mean(axis=0)[:2]).max() < 0.006


def test_calibration_error_is_a_turned_mount_and_a_depth_error():
    spread = Spread(0.005, math.radians(0.5))
    model = replace(FINE, frames=replace(SensorModel.ideal(), calibration=spread))
    for seed in range(5):
        robot = still()
        ((_, seen),) = frames(robot, sensor(robot, model, seed), 1)
        rng = np.random.default_rng(seed)
        slow = SensorNoise(model.frames, rng).draw(0.0).slow
        nominal = CAMERA.camera
        actual = nominal.compose(Pose2(0.0, slow.across, slow.yaw))
        board = actual.relative(START.relative(Pose2(STANDOFF, 0.0, 0.0)))
        # Each point moves along its ray; a yaw error of the line follows from two of them.
        ends = [
            np.array([board.x - s * 0.25 * math.sin(board.theta),
                      board.y + s * 0.25 * math.cos(board.theta)]) for s in (-1.0, 1.0)
        ]  # fmt: skip
        right, left = (end * (1.0 + slow.along / end[0]) for end in ends)
        tangent = left - right
        expected = nominal.compose(
            Pose2(*(0.5 * (left + right)).tolist(), math.atan2(-tangent[0], tangent[1]))
        )
        assert seen.feature == pytest.approx(expected, abs=6e-4)
        assert np.abs(np.array(seen.feature) - START.relative(Pose2(0.6, 0.0, 0.0))).max() > 1e-3


def test_bias_of_level_c_is_within_its_bounds_and_constant_at_rest():
    model = replace(FINE, frames=replace(SensorModel.ideal(), bias=SensorModel.named("C").bias))
    distance = math.hypot(*CAMERA.camera.seen(START.relative(Pose2(STANDOFF, 0.0, 0.0))))
    bound = model.frames.bias.at(distance)
    largest = np.zeros(3)
    for seed in range(12):
        robot = still()
        e = errors(frames(robot, sensor(robot, model, seed), 3))
        assert np.ptp(e, axis=0) == pytest.approx(0.0, abs=1e-9)
        assert math.hypot(*e[0, :2]) <= math.sqrt(2.0) * bound.position + 1e-3
        assert abs(e[0, 2]) <= bound.yaw + 1e-3
        largest = np.maximum(largest, np.abs(e[0]))
    assert largest[:2].max() > 0.5 * bound.position
    assert largest[2] > 0.5 * bound.yaw


def test_outlier_frames_show_another_surface():
    model = replace(FINE, frames=replace(SensorModel.ideal(), outlier=1.0))
    robot = still()
    e = errors(frames(robot, sensor(robot, model, 7), 60))
    assert len(e) > 20
    assert np.abs(e[:, 0]).max() > 0.2
    assert np.degrees(np.abs(e[:, 2]).max()) > 10.0


def test_robot_docks_by_the_depth_sensor():
    world = World()
    rng = [np.random.default_rng([3, 0, k]) for k in range(2)]
    plant = KinematicPlant(Pose2(-1.0, 0.25, -0.2), LIMITS, Body(), rng[0])
    watcher = DepthSensor(
        plant, world.camera, world.standoff, DepthModel.named("A"), rng[1], world.board_width
    )
    controller = DockingController(LIMITS, world.camera, world.standoff, world.period, lag=0.12)
    result, _ = run_episode(plant, watcher, controller, world, LIMITS)
    assert result.outcome == "ok"
    assert result.success
    assert result.limit_violations == 0


def test_wrong_settings_are_refused():
    for wrong in (
        {"columns": 1}, {"outliers": 1.5}, {"outliers": math.nan}, {"behind": 0.0},
        {"behind": math.inf}, {"span": DepthSpan(1.0, 1.0)}, {"span": DepthSpan(-1.0, 1.0)},
    ):  # fmt: skip
        with pytest.raises(ConfigurationError):
            DepthModel(**wrong)
    with pytest.raises(ConfigurationError, match="ideal, A, B or C"):
        DepthModel.named("D")
    with pytest.raises(ConfigurationError):
        DepthCamera(FINE, CAMERA.half_angle, 0.0)
    camera = DepthCamera(FINE, CAMERA.half_angle, WIDTH)
    with pytest.raises(GeometryError):
        camera.columns(Pose2(math.nan, 0.0, 0.0), camera.draw(np.random.default_rng(0)))
    with pytest.raises(ConfigurationError):
        DepthSensor(still(), CAMERA, -1.0, FINE, np.random.default_rng(0), WIDTH)


def test_levels_are_those_of_the_pose_sensor():
    for level in ("ideal", "A", "B", "C"):
        assert DepthModel.named(level).frames == SensorModel.named(level)
    assert DepthModel.named("ideal").noise == DepthNoise.none()
