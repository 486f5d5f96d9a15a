"""What a barrier is to the safety filter: rows for the program, a clearance for the judge."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from clfcbf.constraints.rows import Rows
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2

__all__ = ["HERE", "Barrier"]

HERE = (Pose2(0.0, 0.0, 0.0),)
"""No motion: the robot is where the scene was seen from."""


@runtime_checkable
class Barrier(Protocol):
    r"""A safe set :math:`\{h_i \ge 0\}` of scenes and the commands that keep it.

    The two methods are two views of one set. ``rows`` speaks to the quadratic program: the
    half-planes :math:`\dot h_i(u) \ge -\lambda h_i` [Ames2019]_. ``clearance`` speaks to the
    guard, which asks for it along predicted arcs, where no derivative is needed.

    An implementation holds its own configuration (and whatever it must know beside the scene,
    such as obstacles) and no state: the same scene gives the same rows. Both methods raise
    ``GeometryError`` where the scene is not finite or the barrier is undefined.
    """

    @property
    def name(self) -> str:
        """Prefix of the names of its rows, unique among the barriers of one filter."""

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """The half-planes of admissible commands, priority ``SAFETY``.

        At ``scene``, or where the robot is after it moved by ``motion`` since.
        """

    def clearance(
        self, scene: Scene, motions: tuple[Pose2, ...] = HERE, blur: float = 0.0
    ) -> float:
        """Smallest distance to the edge of the safe set, in the barrier's natural unit.

        The smallest over several poses of the robot, each seen from where it was at ``scene``
        and its position known to ``blur`` [m].

        At least 0 exactly where the scene is safe; [rad] for an angle, [m] for a distance.
        Minus infinity where the rows give no guidance back into the safe set.
        """

    def clearance_around(
        self, scene: Scene, motion: Pose2, turn: float, travel: float, blur: float
    ) -> tuple[float, float]:
        """Clearance after ``motion``, and a lower bound of it over all that is near.

        Near are the poses reached from there by turning at most ``turn`` [rad] and travelling
        at most ``travel`` [m], each with the ``blur`` of :meth:`clearance`. The bound may be as
        low as minus infinity; a good one saves the guard its exact test.
        """
