"""The sensor of two markers and the table of sensors by name."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.simulation.depth_sensor import DepthSensor
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.marker_sensor import MarkerSensor, pose_of_markers
from clfcbf.simulation.plant import Body
from clfcbf.simulation.regions import Markers
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor
from clfcbf.simulation.sensor_model import SensorModel
from clfcbf.simulation.sensors import SENSORS, make_sensor

WORLD = World(camera=FieldOfView(math.radians(35.0)))
MARKERS = Markers(0.4, 0.003, 10.0)
START = Pose2(-1.2, 0.3, -0.1)


def still(pose=START):
    return KinematicPlant(pose, LIMITS["docking"], Body.ideal(), np.random.default_rng(0))


def marker_sensor(plant, model, markers=MARKERS, seed=0):
    rng = np.random.default_rng(seed)
    return MarkerSensor(plant, WORLD.camera, WORLD.standoff, model, rng, markers)


def seen_by(watcher, plant, ticks=1, period=0.1):
    found = []
    for _ in range(ticks):
        watcher.capture()
        observation = watcher.observe()
        if observation is not None:
            found.append((plant.time, observation))
        plant.advance(period)
    return found


@given(st.floats(0.3, 3.0), st.floats(-2.0, 2.0), st.floats(-1.5, 1.5), st.floats(0.05, 1.0))
def test_pose_of_markers_is_exact(x, y, theta, distance):
    half = 0.5 * distance * np.exp(1j * (theta + math.pi / 2))
    right, left = complex(x, y) - half, complex(x, y) + half
    pose = pose_of_markers((right.real, right.imag), (left.real, left.imag))
    assert pose == pytest.approx((x, y, theta), abs=1e-9)


def test_without_noise_it_is_exact():
    plant = still()
    ((_, seen),) = seen_by(
        marker_sensor(plant, SensorModel.ideal(), Markers(0.4, 0.0, 10.0)), plant
    )
    truth = START.relative(Pose2(WORLD.standoff, 0.0, 0.0))
    assert seen.feature == pytest.approx(truth, abs=1e-12)
    assert seen.goal == pytest.approx(START.inverse(), abs=1e-12)


def test_noise_is_the_stated_one_and_the_reported_one():
    plant = still()
    found = seen_by(marker_sensor(plant, SensorModel.ideal()), plant, 3000)
    truth = START.relative(Pose2(WORLD.standoff, 0.0, 0.0))
    e = np.array([np.array(seen.feature) - truth for _, seen in found])
    assert e.mean(axis=0) == pytest.approx(np.zeros(3), abs=6e-4)
    expected = (0.003 / math.sqrt(2), 0.003 / math.sqrt(2), math.sqrt(2) * 0.003 / 0.4)
    assert e.std(axis=0) == pytest.approx(expected, rel=0.06)
    goals = np.array([np.array(seen.goal) - START.inverse() for _, seen in found])
    reported = np.array(found[0][1].covariance)
    assert np.cov(goals.T) == pytest.approx(reported, rel=0.12, abs=1e-7)


def test_a_marker_out_of_view_hides_both():
    edge = WORLD.camera.half_angle
    half = 0.5 * MARKERS.distance
    for shift, seen in ((-0.02, True), (0.02, False)):
        left = math.atan2(half - START.y, WORLD.standoff - START.x)
        plant = still(Pose2(START.x, START.y, wrap_angle(left - edge - shift)))
        watcher = marker_sensor(plant, SensorModel.ideal())
        assert bool(seen_by(watcher, plant)) == seen


def test_scans_come_at_their_own_rate_and_paired_whatever_the_noise():
    model = SensorModel.named("A")
    times = []
    for markers in (MARKERS, Markers(0.4, 0.0, 10.0)):
        plant = still()
        found = seen_by(marker_sensor(plant, model, markers, 7), plant, 120, 1.0 / 30.0)
        times.append([(time, seen.stamp) for time, seen in found])
    assert times[0] == times[1]
    assert 30 < len(times[0]) <= 40
    stamps = np.array([stamp for _, stamp in times[0]])
    assert np.round(stamps * 10.0) == pytest.approx(stamps * 10.0, abs=1e-6)


# --- sensors by name ----------------------------------------------------------------------------


def test_every_name_makes_its_sensor():
    kinds = {"depth": DepthSensor, "middle": DepthSensor}
    for name in SENSORS:
        plant = still()
        made = make_sensor(name, plant, WORLD, np.random.default_rng(0))
        assert type(made) is kinds.get(name.split("-")[0], PoseSensor)
        marked = make_sensor(name, plant, WORLD, np.random.default_rng(0), MARKERS)
        assert type(marked) is MarkerSensor
    assert len(SENSORS) == 12


def test_ideal_markers_have_no_noise():
    plant = still()
    watcher = make_sensor("ideal", plant, WORLD, np.random.default_rng(0), MARKERS)
    ((_, seen),) = seen_by(watcher, plant)
    assert seen.goal == pytest.approx(START.inverse(), abs=1e-12)


@pytest.mark.parametrize("name", ["Z", "depth", "depth-", "depth-Z", "", "-A"])
def test_unknown_sensors_are_refused(name):
    with pytest.raises(ConfigurationError, match="choose ideal, A, B or C"):
        make_sensor(name, still(), WORLD, np.random.default_rng(0))


def test_without_compensation_the_middle_of_what_is_visible_is_the_centre():
    """The view's left edge cuts the board; the middle is found by crossing edge and board."""
    pose = Pose2(-0.7, 0.0, math.radians(-28.0))
    cut = math.tan(pose.theta + WORLD.camera.half_angle) * (WORLD.standoff - pose.x)
    assert -0.1 < cut < 0.25
    middle = 0.5 * (cut - 0.5 * WORLD.board_width)
    found = {}
    for kind in ("depth", "middle"):
        plant = still(pose)
        watcher = make_sensor(f"{kind}-ideal", plant, WORLD, np.random.default_rng(0))
        ((_, seen),) = seen_by(watcher, plant)
        found[kind] = pose.compose(Pose2(*seen.feature))
    column = 2.0 * math.tan(WORLD.camera.half_angle) / 240 * 1.6
    assert found["depth"][:2] == pytest.approx((WORLD.standoff, 0.0), abs=column)
    assert found["middle"][:2] == pytest.approx((WORLD.standoff, middle), abs=column)
    assert found["middle"].theta == pytest.approx(0.0, abs=1e-4)
