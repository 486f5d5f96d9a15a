"""The kinematic plant: a unicycle that follows its commands with lag, slip and gyro bias."""

from __future__ import annotations

import numpy as np

from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.drive import Drive
from clfcbf.simulation.plant import Body, check_start, sub_steps

__all__ = ["KinematicPlant"]

_REST = Twist(0.0, 0.0)


class KinematicPlant:
    r"""A unicycle moved along exact arcs, sub-step by sub-step.

    .. math::
        \dot x = v\cos\theta,\quad \dot y = v\sin\theta,\quad \dot\theta = \omega,\qquad
        \dot v = \mathrm{sat}_{a}\frac{(1+s_v)v_c - v}{\tau},\quad
        \dot\omega = \mathrm{sat}_{\alpha}\frac{(1+s_\omega)\omega_c + b - \omega}{\tau}

    The velocities are exact in closed form; each sub-step moves the pose along the arc of the
    mean twist, so that heading and path length are exact and the position errs by
    :math:`O(h^2)`, under a micrometre over a manoeuvre at 240 Hz. With ``Body.ideal()`` each
    sub-step is exactly the arc of the command, however small it is: no dead band.

    Parameters
    ----------
    start : pose in the goal's frame
    limits : bounds of the body's accelerations; with a lag of 0 the body steps with the
        command, whose steps are then the only bound
    body : lag, and the spread of slip and gyro bias
    rng : draws this run's slip and bias
    initial_command : command applied before the start, to which the body has settled (the
        hand-over from a faster stage)

    Raises
    ------
    GeometryError : the start or a command is not finite

    Notes
    -----
    The bias :math:`b` acts only while the command is to move, see
    :class:`~clfcbf.simulation.drive.Drive`.
    """

    def __init__(
        self,
        start: Pose2,
        limits: Limits,
        body: Body,
        rng: np.random.Generator,
        initial_command: Twist = _REST,
    ) -> None:
        self._pose = check_start(start)
        self._rate = body.rate
        self._drive = Drive(initial_command, limits, body.lag, body.draw(rng))
        self._time = 0.0

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return self._time

    def pose(self) -> Pose2:
        """True pose of the rotation centre in the goal's frame."""
        return self._pose

    def twist(self) -> Twist:
        """True body twist [m/s, rad/s]."""
        return self._drive.twist

    def send(self, twist: Twist) -> None:
        """Take ``twist`` as the command from now on."""
        self._drive.send(twist)

    def applied(self) -> Twist:
        """The command last sent."""
        return self._drive.command

    def stop(self) -> None:
        """Command zero; the body comes to rest as its lag and its acceleration allow."""
        self._drive.send(_REST)

    def advance(self, duration: float) -> tuple[Pose2, ...]:
        """Let ``duration`` [s] pass; returns the true pose at the end of every sub-step."""
        count, step = sub_steps(duration, self._rate)
        pose, drive = self._pose, self._drive
        poses = []
        for _ in range(count):
            pose = pose.moved(drive.step(step), step)
            poses.append(pose)
        self._pose = pose
        self._time += duration
        return tuple(poses)

    def move_target(self, shift: Pose2) -> None:
        """Move the target by ``shift``, given in the goal's frame."""
        self._pose = check_start(shift).relative(self._pose)

    def close(self) -> None:
        """Nothing is held."""
