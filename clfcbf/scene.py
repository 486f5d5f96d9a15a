"""What the robot sees and follows: observation, scene and reference, all in the robot frame.

The goal pose G is where the robot is to stand; the viewed feature F is what the camera has
to keep in sight (the centre of a board, a standoff ahead of G). They are two things: the
barrier acts on F, whose distance never vanishes, and the control acts on G.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from clfcbf.se2 import Pose2, Twist

__all__ = ["Covariance", "Observation", "Reference", "Scene"]

Covariance = tuple[
    tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
]
"""Covariance of (x, y, theta) of the goal, in the robot frame [m², m rad, rad²], row by row."""


class Scene(NamedTuple):
    """Goal and feature as seen from the robot at the time ``stamp``.

    ``goal`` is a pose; ``feature`` a pose or a bare point (its heading, if any, is the
    direction of the standoff, out of which the board's edges follow); ``stamp`` [s].
    """

    goal: Pose2
    feature: Pose2
    stamp: float


class Reference(NamedTuple):
    """The virtual target: its pose seen from the robot and its own twist (feedforward)."""

    pose: Pose2
    twist: Twist


@dataclass(frozen=True, slots=True)
class Observation:
    """One measurement of the target, as a sensor gives it.

    Attributes
    ----------
    goal, feature : as in :class:`Scene`, in the robot frame at the time of capture
    stamp : time of capture [s], on the controller's clock
    covariance : of the goal pose; None takes the controller's noise model
    """

    goal: Pose2
    feature: Pose2
    stamp: float
    covariance: Covariance | None = None
