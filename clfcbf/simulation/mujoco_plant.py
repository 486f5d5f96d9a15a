"""The MuJoCo plant: wheels, torque, friction and contact between the command and the pose."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from clfcbf.errors import ClfcbfError, ConfigurationError, MissingExtraError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, is_finite
from clfcbf.simulation.drive import Drive
from clfcbf.simulation.mujoco_model import Chassis3D, scene_xml
from clfcbf.simulation.plant import Body, BodyErrors, check_start, sub_steps

__all__ = ["SERVO_LAG", "MujocoPlant"]

SERVO_LAG = 0.013
"""[s] that speed and turn rate lag behind the wheels' set-points, measured on ramps."""
STEP = 1.0 / 480.0
"""[s] longest physics step: a fifth of the contacts' time constant, two in a sub-step."""
SETTLING = 1.0
"""[s] that the robot stands before the start, until its weight is on its wheels to 1e-6 m/s."""

_REST = Twist(0.0, 0.0)


class MujocoPlant:
    r"""A differential-drive robot in front of a board and a trolley, simulated by [Todorov2012]_.

    The commanded twist goes through the velocity lag and the acceleration bounds of
    :class:`~clfcbf.simulation.drive.Drive` to become the wheels' set-points
    :math:`(v \mp \tfrac12 b\,\omega)/r`, which velocity servos of bounded torque follow; tyres
    with friction move the body. The drive's lag is shortened by ``SERVO_LAG``, so that the body
    follows ramps with ``body.lag`` in all. Slip is what the drive does not know about its
    wheels: this run's radius is :math:`r(1+s_v)` and its track :math:`b(1+s_v)/(1+s_\omega)`,
    which scale the speed by :math:`1+s_v` and the turn rate by :math:`1+s_\omega`, exactly as in
    :class:`~clfcbf.simulation.kinematic.KinematicPlant` with the same seed.

    Parameters
    ----------
    start : pose of the rotation centre in the goal's frame
    limits : bounds of the accelerations of the wheels' set-points
    body : lag, and the spread of slip and gyro bias; ``Body.ideal()`` leaves the servos' own lag
    rng : draws this run's errors
    initial_command : command applied before the start, at whose speed the robot starts
    standoff, board_width : distance of the board ahead of the goal, and its width [m]
    robot : dimensions as the drive believes them

    Raises
    ------
    MissingExtraError : MuJoCo is not installed
    ConfigurationError : standoff or board width is not finite and positive
    GeometryError : the start or a command is not finite
    """

    def __init__(
        self,
        start: Pose2,
        limits: Limits,
        body: Body,
        rng: np.random.Generator,
        initial_command: Twist = _REST,
        *,
        standoff: float = 0.6,
        board_width: float = 0.5,
        robot: Chassis3D | None = None,
    ) -> None:
        check_start(start)
        for name, value in (("standoff", standoff), ("board_width", board_width)):
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigurationError(f"{name} must be finite and positive [m], got {value!r}")
        self._nominal = robot if robot is not None else Chassis3D()
        self._rate = body.rate
        scale_v, scale_omega, bias = body.draw(rng)
        true = replace(
            self._nominal,
            wheel_radius=self._nominal.wheel_radius * scale_v,
            track=self._nominal.track * scale_v / scale_omega,
        )
        lag = max(0.0, body.lag - SERVO_LAG)
        self._drive = Drive(initial_command, limits, lag, BodyErrors(1.0, 1.0, bias))
        self._time = 0.0
        self._touched = False
        self._mujoco, self._model, self._data = _build(scene_xml(true, standoff, board_width))
        self._floor = self._model.geom("floor").id
        self._start_at(Pose2(*start), true)

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return self._time

    def pose(self) -> Pose2:
        """True pose of the middle of the driven axle in the goal's frame."""
        qpos = self._data.qpos
        return Pose2(float(qpos[0]), float(qpos[1]), _yaw(*qpos[3:7].tolist()))

    def twist(self) -> Twist:
        """True body twist [m/s, rad/s]: speed along the heading, and turn rate."""
        vx, vy, _, _, _, omega = self._data.qvel[:6].tolist()
        theta = self.pose().theta
        return Twist(vx * math.cos(theta) + vy * math.sin(theta), omega)

    def send(self, twist: Twist) -> None:
        """Take ``twist`` as the command from now on."""
        self._drive.send(twist)

    def applied(self) -> Twist:
        """The command last sent."""
        return self._drive.command

    def stop(self) -> None:
        """Command zero; the body comes to rest as its drive allows."""
        self._drive.send(_REST)

    def contact(self) -> bool:
        """Whether the robot has touched the board or the trolley since the start."""
        return self._touched

    def advance(self, duration: float) -> tuple[Pose2, ...]:
        """Let ``duration`` [s] pass; returns the true pose at the end of every sub-step.

        The physics step is the largest up to ``STEP`` that divides the sub-step, so that time
        is exact for every duration. Raises ``ClfcbfError`` if the physics diverges.
        """
        count, step = sub_steps(duration, self._rate)
        physics = max(1, math.ceil(step / STEP - 1e-9))
        self._model.opt.timestep = step / physics
        poses = []
        for _ in range(count):
            self._data.ctrl[:] = self._wheel_speeds(self._drive.step(step), self._nominal)
            self._mujoco.mj_step(self._model, self._data, nstep=physics)
            self._touched = self._touched or self._touches()
            poses.append(self.pose())
        self._time += duration
        if not is_finite(tuple(poses[-1])):
            raise ClfcbfError(f"the physics diverged before {self._time:.3f} s")
        return tuple(poses)

    def move_target(self, shift: Pose2) -> None:
        """Move the target by ``shift``, given in the goal's frame."""
        moved = check_start(shift).relative(self.pose())
        vx, vy = self._data.qvel[:2].tolist()
        self._data.qvel[:2] = Pose2(0.0, 0.0, shift.theta).seen((vx, vy))
        self._place(moved)
        self._mujoco.mj_forward(self._model, self._data)
        self._touched = self._touched or self._touches()

    def close(self) -> None:
        """Nothing is held that the interpreter does not free."""

    def _wheel_speeds(self, twist: Twist, robot: Chassis3D) -> tuple[float, float]:
        """Left and right wheel speed [rad/s] that roll at ``twist``."""
        v, omega = twist
        lead = 0.5 * robot.track * omega
        return (v - lead) / robot.wheel_radius, (v + lead) / robot.wheel_radius

    def _start_at(self, start: Pose2, true: Chassis3D) -> None:
        """Let the robot's weight settle far from the board, then set it moving at ``start``."""
        self._model.opt.timestep = STEP
        self._data.qpos[0] = -10.0
        self._mujoco.mj_step(self._model, self._data, nstep=round(SETTLING / STEP))
        self._place(start)
        v, omega = self._drive.twist
        scale = true.wheel_radius / self._nominal.wheel_radius
        v, omega = v * scale, omega * scale * self._nominal.track / true.track
        self._data.qvel[:] = 0.0
        self._data.qvel[:2] = v * math.cos(start.theta), v * math.sin(start.theta)
        self._data.qvel[5] = omega
        self._data.qvel[6:8] = self._wheel_speeds(Twist(v, omega), true)
        self._mujoco.mj_forward(self._model, self._data)
        self._touched = self._touches()

    def _place(self, pose: Pose2) -> None:
        """Put the robot at ``pose``; height, roll and pitch stay as they are."""
        qpos = self._data.qpos
        half = 0.5 * (pose.theta - self.pose().theta)
        c, s = math.cos(half), math.sin(half)
        w, x, y, z = qpos[3:7].tolist()
        qpos[0], qpos[1] = pose.x, pose.y
        qpos[3:7] = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w

    def _touches(self) -> bool:
        """Whether a contact other than with the floor exists now."""
        return bool((self._data.contact.geom != self._floor).all(axis=1).any())


def _build(xml: str) -> tuple[Any, Any, Any]:
    """MuJoCo itself, the model, and its data."""
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError("mujoco-core", "sim") from error
    model = mujoco.MjModel.from_xml_string(xml)
    return mujoco, model, mujoco.MjData(model)


def _yaw(w: float, x: float, y: float, z: float) -> float:
    """Heading of a unit quaternion: direction of its x axis seen from above [rad]."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
