"""The MuJoCo plant against its commands, and against the kinematic plant."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ClfcbfError, ConfigurationError, GeometryError, MissingExtraError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.mujoco_plant import SERVO_LAG, MujocoPlant
from clfcbf.simulation.plant import Body, Plant

pytest.importorskip("mujoco")

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
START = Pose2(-2.5, 0.3, 0.1)
REST = Twist(0.0, 0.0)
TICK = 1.0 / 30.0
LAGGED = Body(slip=0.0, gyro_bias=0.0)

poses = st.builds(Pose2, st.floats(-3.0, -0.5), st.floats(-2.0, 2.0), st.floats(-3.1, 3.1))


def plant(body=LAGGED, *, seed=0, start=START, initial=REST, **settings):
    return MujocoPlant(start, LIMITS, body, np.random.default_rng(seed), initial, **settings)


def drive(robot, target, seconds):
    """Ramp the command to ``target`` within the limits and hold it."""
    for _ in range(round(seconds / TICK)):
        robot.send(LIMITS.input_box(robot.applied(), TICK).clip(target))
        robot.advance(TICK)


@settings(max_examples=15, deadline=None)
@given(poses)
def test_starts_exactly_at_the_start(start):
    robot = plant(start=start)
    assert tuple(robot.pose()) == pytest.approx(tuple(start), abs=1e-12)
    assert robot.twist() == REST
    assert robot.time == 0.0


@pytest.mark.parametrize(
    "target", [Twist(0.2, 0.0), Twist(-0.2, 0.0), Twist(0.0, 0.4), Twist(0.2, -0.3)]
)
def test_follows_its_command_and_the_kinematic_plant(target):
    robot = plant()
    model = KinematicPlant(START, LIMITS, LAGGED, np.random.default_rng(0))
    for one in (robot, model):
        drive(one, target, 4.0)
    # tyres sink in by 0.1 mm of 80 and the body's weight drags a little in a bend
    assert tuple(robot.twist()) == pytest.approx(tuple(target), rel=5e-3, abs=1e-4)
    dx, dy, dtheta = model.pose().relative(robot.pose())
    assert math.hypot(dx, dy) < 3e-3
    assert abs(dtheta) < 5e-3


def ramp_lag(body, axis, sign):
    """Time by which the body's speed trails a steady ramp [s]."""
    rate = sign * 0.9 * (LIMITS.a_max, LIMITS.alpha_max)[axis]
    robot, step = plant(body), 1.0 / 240.0
    for k in range(240):
        command = [0.0, 0.0]
        command[axis] = rate * (k + 0.5) * step
        robot.send(Twist(*command))
        robot.advance(step)
    return 1.0 - robot.twist()[axis] / rate


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_lag_is_the_bodys_and_the_servos_share_is_as_stated(axis, sign):
    assert ramp_lag(LAGGED, axis, sign) == pytest.approx(LAGGED.lag, abs=3e-3)
    assert ramp_lag(Body.ideal(), axis, sign) == pytest.approx(SERVO_LAG, abs=2e-3)


@pytest.mark.parametrize("target", [Twist(0.2, 0.3), Twist(-0.2, 0.0), Twist(0.0, -0.4)])
def test_comes_to_rest_and_stays(target):
    robot = plant(Body(), seed=2)
    drive(robot, target, 3.0)
    while robot.applied() != REST:
        robot.send(LIMITS.input_box(robot.applied(), TICK).clip(REST))
        robot.advance(TICK)
    robot.advance(0.5)
    v, omega = robot.twist()
    assert abs(v) < 1e-3
    assert abs(omega) < 1e-3
    stood = robot.pose()
    path = robot.advance(2.0)
    assert max(math.hypot(p.x - stood.x, p.y - stood.y) for p in path) < 3e-4
    assert max(abs(p.theta - stood.theta) for p in path) < 3e-4


def test_untouched_robot_does_not_creep():
    robot = plant(Body(gyro_bias=0.1))
    robot.advance(5.0)
    assert tuple(robot.pose()) == pytest.approx(tuple(START), abs=1e-5)


@settings(max_examples=5, deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(-0.4, 0.4), st.integers(0, 1000))
def test_mirror_symmetry(v, omega, seed):
    ends = []
    for sign in (1.0, -1.0):
        start = Pose2(-2.0, sign * 0.3, sign * 0.2)
        robot = plant(Body(gyro_bias=0.0), seed=seed, start=start)
        drive(robot, Twist(v, sign * omega), 2.0)
        x, y, theta = robot.pose()
        ends.append((x, sign * y, sign * theta))
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_slip_and_bias_scale_the_motion_as_in_the_kinematic_plant():
    body = Body(slip=0.05, gyro_bias=0.02)
    errors = body.draw(np.random.default_rng(8))
    robot = plant(body, seed=8)
    drive(robot, Twist(0.15, 0.0), 3.0)
    assert robot.twist().v == pytest.approx(0.15 * errors.scale_v, rel=2e-3)
    turning = plant(body, seed=8)
    drive(turning, Twist(0.0, 0.3), 3.0)
    expected = errors.scale_omega * (0.3 + errors.gyro_bias)
    assert turning.twist().omega == pytest.approx(expected, rel=2e-3)


def test_hand_over_starts_at_the_speed_of_the_initial_command():
    body = Body(slip=0.1, gyro_bias=0.0)
    errors = body.draw(np.random.default_rng(4))
    robot = plant(body, seed=4, initial=Twist(0.2, 0.2))
    expected = (0.2 * errors.scale_v, 0.2 * errors.scale_omega)
    assert tuple(robot.twist()) == pytest.approx(expected, abs=1e-6)
    assert tuple(robot.pose()) == pytest.approx(tuple(START), abs=1e-12)
    for _ in range(240):
        robot.advance(1.0 / 240.0)
        assert robot.twist().v == pytest.approx(expected[0], abs=1e-3)
        assert robot.twist().omega == pytest.approx(expected[1], abs=5e-3)


@pytest.mark.parametrize("standoff", [0.6, 0.8])
def test_touches_the_board_where_it_stands(standoff):
    robot = plant(start=Pose2(0.0, 0.0, 0.0), standoff=standoff)
    drive(robot, Twist(0.1, 0.0), (standoff - 0.2) / 0.1 - 0.5)
    assert not robot.contact()
    drive(robot, Twist(0.1, 0.0), 1.5)
    assert robot.contact()
    # the chassis' front face is 0.2 m ahead of the rotation centre
    assert robot.pose().x == pytest.approx(standoff - 0.2, abs=3e-3)
    drive(robot, Twist(-0.1, 0.0), 1.0)
    assert robot.contact()


def test_passes_beside_the_board_but_not_through_its_edge():
    for y, touched in ((0.52, False), (0.48, True)):
        robot = plant(start=Pose2(0.2, y, 0.0), initial=Twist(0.22, 0.0), board_width=0.5)
        drive(robot, Twist(0.22, 0.0), 3.0)
        assert robot.contact() is touched


def test_wider_board_is_touched_farther_out():
    robot = plant(start=Pose2(0.2, 0.6, 0.0), initial=Twist(0.22, 0.0), board_width=0.8)
    drive(robot, Twist(0.22, 0.0), 2.0)
    assert robot.contact()


@pytest.mark.parametrize("duration", [TICK, 0.1, 0.02, 0.0137])
def test_time_is_exact_at_any_duration(duration):
    robot = plant(initial=Twist(0.2, 0.0), start=Pose2(-2.0, 0.0, 0.0))
    poses_of_three = [robot.advance(duration) for _ in range(3)]
    assert robot.time == pytest.approx(3 * duration, rel=1e-12)
    assert robot.pose().x == pytest.approx(-2.0 + 0.2 * 3 * duration, abs=3e-4)
    assert all(len(path) >= duration * 200 for path in poses_of_three)
    assert poses_of_three[-1][-1] == robot.pose()


def test_a_seed_decides_the_run():
    def run(seed):
        robot = plant(Body(), seed=seed)
        drive(robot, Twist(0.2, 0.2), 1.0)
        return robot.pose()

    assert run(4) == run(4)
    assert run(4) != run(5)


def test_moving_the_target_leaves_the_robot_and_its_motion():
    shift = Pose2(0.05, -0.02, 0.3)
    moved, straight = (plant(initial=Twist(0.2, 0.2)) for _ in range(2))
    moved.move_target(shift)
    assert tuple(shift.compose(moved.pose())) == pytest.approx(tuple(START), abs=1e-12)
    assert tuple(moved.twist()) == pytest.approx(tuple(straight.twist()), abs=1e-12)
    for robot in (moved, straight):
        robot.advance(1.0)
    assert tuple(shift.compose(moved.pose())) == pytest.approx(tuple(straight.pose()), abs=1e-4)


def test_is_a_chassis():
    robot = plant()
    assert isinstance(robot, Plant)
    robot.send(Twist(0.1, 0.2))
    assert robot.applied() == Twist(0.1, 0.2)
    robot.stop()
    robot.stop()
    assert robot.applied() == REST
    robot.close()
    robot.close()


def test_what_is_not_usable_is_refused():
    robot = plant()
    with pytest.raises(GeometryError, match="command"):
        robot.send(Twist(math.nan, 0.0))
    with pytest.raises(GeometryError, match="start"):
        plant(start=Pose2(math.inf, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match="standoff"):
        plant(standoff=-0.6)
    with pytest.raises(ConfigurationError, match="board_width"):
        plant(board_width=math.nan)
    with pytest.raises(ConfigurationError, match="duration"):
        robot.advance(0.0)


def test_divergence_is_an_error(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warning into a file there
    robot = plant()
    robot._data.qvel[0] = math.nan
    with pytest.raises(ClfcbfError, match="diverged"):
        robot.advance(TICK)


def test_missing_package_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"mujoco-core.*clfcbf\[sim\]"):
        plant()


def test_the_shortest_advance_is_one():
    """A clock's rounding: less than a picosecond."""
    robot = plant()
    before = robot.pose()
    assert len(robot.advance(1e-15)) == 1
    assert tuple(robot.pose()) == pytest.approx(tuple(before), abs=1e-12)
    assert robot.time == 1e-15


def test_a_robot_follows_its_drives_on_a_bus():
    """MuJoCo behind two CiA-402 drives: a curve driven, and whether anything was touched."""
    pytest.importorskip("canopen", reason="needs the extra can")
    from clfcbf.hardware.can_drives import CanDrives, CanTiming, WheelDrive, open_bus
    from clfcbf.simulation.can_drives import CanPlant, SimulatedDrives
    from clfcbf.wheels import WheelLimits

    left, right = WheelDrive(1, 1e4), WheelDrive(2, -1e4)
    wheels = WheelLimits(0.42, 0.08, 0.5, 2.0)
    base = plant(Body.ideal())
    drives = SimulatedDrives("mujoco-on-a-bus", now=lambda: base.time)
    chassis = CanDrives(
        open_bus("virtual", "mujoco-on-a-bus"), left, right, wheels,
        timing=CanTiming(timeout=5.0, silence=5.0), quick_stop=LIMITS,
    )  # fmt: skip
    robot = CanPlant(base, drives, left, right, wheels)
    try:
        for share in (0.25, 0.5, 0.75, 1.0):
            chassis.send(Twist(share * 0.15, share * 0.3))
            robot.advance(0.3)
        assert tuple(robot.twist()) == pytest.approx((0.15, 0.3), abs=0.01)
        assert not robot.contact()
        x, y, _ = robot.pose()
        robot.move_target(Pose2(x - 0.5, y, 0.0))  # the board is 0.1 m ahead of the axle
        robot.advance(0.1)
        assert robot.contact()
    finally:
        chassis.close()
        robot.close()
