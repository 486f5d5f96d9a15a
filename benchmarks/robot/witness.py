"""The witness: a plant that watches itself in every physics step, and knows the truth."""

from __future__ import annotations

import math
from collections import deque

from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.judge import REST_OMEGA, REST_V
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.scenarios import World

__all__ = ["Witness"]

WINDOW = 0.4
"""[s] Over which the set-points' acceleration is taken: commands are steps, drives ramps."""

ROUNDING = 1e-3
"""[m/s, rad/s] Of target velocities in drive units, and of ramps that are sampled at 120 Hz."""


class Witness:
    """A plant under observation; stands where a ``Plant`` does.

    Parameters
    ----------
    plant : the body; its sub-steps should be its physics steps
    world, limits : what it is judged against
    period : of the commands [s]
    steps : commands that may fall into any stretch of time beyond those that fit: one, and where
        time is the machine's another one, which the simulation took over a moment too late

    Attributes
    ----------
    margin : smallest angle from the feature to the edge of the true view [rad]
    excess_v, excess_omega : by how much the set-points changed faster than the limits let them,
        a command's own step allowed for, or were faster than the limits [m/s, rad/s]
    stood_at : when the body last came to rest [s], NaN while it moves
    stopped, halted : first rest since :meth:`mark` [s], and the first time that it did not roll;
        NaN if there was none
    """

    def __init__(
        self, plant: Plant, world: World, limits: Limits, period: float, steps: int = 1
    ) -> None:
        self._plant, self._world, self._limits = plant, world, limits
        self._slack = steps * period
        self._feature = (world.standoff, 0.0)
        self._sent: deque[tuple[float, Twist]] = deque([(0.0, plant.applied())])
        self.margin = math.inf
        self.excess_v = self.excess_omega = -math.inf
        self.stood_at, self.stopped, self.halted = 0.0, math.nan, math.nan
        self._look(plant.pose())

    @property
    def time(self) -> float:
        return self._plant.time

    def pose(self) -> Pose2:
        return self._plant.pose()

    def twist(self) -> Twist:
        return self._plant.twist()

    def applied(self) -> Twist:
        return self._plant.applied()

    def contact(self) -> bool:
        touched = getattr(self._plant, "contact", None)
        return touched is not None and bool(touched())

    def send(self, twist: Twist) -> None:
        self._plant.send(twist)
        self._judge(twist)

    def stop(self) -> None:
        self._plant.stop()
        self._judge(Twist(0.0, 0.0))

    def advance(self, duration: float) -> tuple[Pose2, ...]:
        poses = self._plant.advance(duration)
        for pose in poses:
            self._look(pose)
        v, omega = self._plant.twist()
        if abs(v) < REST_V and math.isnan(self.halted):
            self.halted = self.time
        if abs(v) >= REST_V or abs(omega) >= REST_OMEGA:
            self.stood_at = math.nan
        elif math.isnan(self.stood_at):
            self.stood_at = self.time
            if math.isnan(self.stopped):
                self.stopped = self.time
        return poses

    def move_target(self, shift: Pose2) -> None:
        self._plant.move_target(shift)

    def close(self) -> None:
        self._plant.close()

    def mark(self) -> None:
        """From now on the first rest counts."""
        self.halted = self.stopped = math.nan

    @property
    def within_limits(self) -> bool:
        """Whether the set-points never left the limits."""
        return max(self.excess_v, self.excess_omega) <= ROUNDING

    def _look(self, pose: Pose2) -> None:
        margin = self._world.camera.margin(pose.seen(self._feature))
        self.margin = min(self.margin, margin)

    def _judge(self, twist: Twist) -> None:
        now, limits, sent = self.time, self._limits, self._sent
        while len(sent) > 1 and sent[1][0] <= now - WINDOW:
            sent.popleft()
        for then, before in (sent[0], sent[-1]):
            allowed = now - then + self._slack
            self.excess_v = max(
                self.excess_v, abs(twist[0] - before[0]) - limits.a_max * allowed,
                twist[0] - limits.v_max, limits.reverse_speed - twist[0],
            )  # fmt: skip
            self.excess_omega = max(
                self.excess_omega, abs(twist[1] - before[1]) - limits.alpha_max * allowed,
                abs(twist[1]) - limits.omega_max,
            )  # fmt: skip
        sent.append((now, twist))
