"""What a rival's law is told and answers, and when its run ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from clfcbf.decision import Failure
from clfcbf.errors import ConfigurationError
from clfcbf.limits import InputBox, Limits
from clfcbf.se2 import Point, Pose2, Twist, wrap_angle

__all__ = ["DEADLINE", "Answer", "Law", "StopRule", "View", "arrival_speed", "near", "within"]

REACHED = 0.005
"""[m] Half of the strict tolerance: what a law that converges passes on its way to zero."""

REACHED_THETA = math.radians(1.0)
"""[rad] Half of the strict tolerance."""

ACCEPTED = 0.030
"""[m] The comparison's criterion of success: farther off it had better say that it failed."""

ACCEPTED_THETA = math.radians(5.0)
"""[rad] As above."""

SETTLE = 1.0
"""[s] Commands of rest for so long are an end, not a turning point, which takes a few ticks."""

DEADLINE = 55.0
"""[s] Gives up before the run itself ends at 60 s; docking takes 10 to 30 s."""


class View(NamedTuple):
    """What a law is told at a tick, all of it estimated.

    ``pose`` is that of the robot in the goal's frame, where its body coasts to: the commands act
    from there on. ``goal`` and ``feature`` are seen from it. ``stopping`` is the pose in the
    goal's frame at which a brake along the same circle would end. ``applied`` is the command in
    force, ``box`` what can be reached from it, ``unseen`` the age of the last measurement.
    """

    pose: Pose2
    goal: Pose2
    feature: Point
    stopping: Pose2
    applied: Twist
    box: InputBox
    unseen: float
    time: float


class Answer(NamedTuple):
    """What a law says: a command, not yet clipped, and whether it is finished.

    ``arrived`` brakes and is done; ``failure`` brakes and gives up, for that reason, which is of
    that ``kind``; ``solved`` is False where a solver failed and ``twist`` is a substitute.
    """

    twist: Twist
    arrived: bool = False
    failure: str = ""
    solved: bool = True
    kind: Failure = Failure.GAVE_UP


class Law(Protocol):
    """A rival's law; one that remembers serves one run."""

    def command(self, view: View) -> Answer:
        """The command of this tick; one that raises is braked for."""


@dataclass(frozen=True, slots=True)
class StopRule:
    """When a run ends that the law itself does not end.

    Attributes
    ----------
    reached, reached_theta : it is done once a brake would end so near the goal, in x and in y
        [m], and in heading [rad]; a distance of 0 leaves its end to the law
    accepted, accepted_theta : commands of rest mean done within these [m, rad], failure outside
    settle : for how long the commands have to be those of rest [s]
    deadline : it gives up so long after its first tick [s]
    """

    reached: float = REACHED
    reached_theta: float = REACHED_THETA
    accepted: float = ACCEPTED
    accepted_theta: float = ACCEPTED_THETA
    settle: float = SETTLE
    deadline: float = DEADLINE

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0.0 or (name == "reached" and value == 0.0))):
                raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")


def within(twist: Twist, limits: Limits) -> Twist:
    """``twist`` slowed down along its own curvature until both speed limits hold."""
    v, omega = twist
    top = limits.v_max if v > 0.0 else -limits.reverse_speed
    factor = 1.0
    if abs(v) > top:
        factor = top / abs(v)
    if factor * abs(omega) > limits.omega_max:
        factor = limits.omega_max / abs(omega)
    return twist.scaled(factor)


def arrival_speed(rest: float, gain: float, brake: float, limits: Limits) -> float:
    r"""Speed with so much of the way left, :math:`\min(v_{max}, kr, \sqrt{2\beta a_{max}r})`.

    0 at and beyond the end.
    """
    if not rest > 0.0:
        return 0.0
    return min(limits.v_max, gain * rest, math.sqrt(2.0 * brake * limits.a_max * rest))


def near(pose: Pose2, distance: float, angle: float) -> bool:
    """Whether a pose in the goal's frame is that near, in x, in y and in heading."""
    x, y, theta = pose
    return abs(x) < distance and abs(y) < distance and abs(wrap_angle(theta)) < angle
