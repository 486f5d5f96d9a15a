"""What a barrier is to the safety filter: rows for the program, a clearance for the judge."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from clfcbf.constraints.rows import Rows
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist

__all__ = ["HERE", "Barrier", "Sweep"]

HERE = Pose2(0.0, 0.0, 0.0)
"""No motion: the robot is where the scene was seen from."""

_REST = Twist(0.0, 0.0)


class Sweep(NamedTuple):
    r"""All that a braking robot may pass through, from where it is to where it stands.

    The body runs on along its present twist for up to ``lag`` seconds' worth, and along the
    command for up to ``duration`` seconds' worth, in an order that is not known. Its poses are
    :math:`g\,\mathrm{Exp}(Eb)\,\mathrm{Exp}(Su)`, :math:`0 \le E \le \tau`,
    :math:`0 \le S \le T_{eff}`, to within ``blur`` in position.

    Attributes
    ----------
    motion : :math:`g`, where the robot is, seen from where the scene was seen from
    body, lag : twist of the body :math:`b` and its lag :math:`\tau` [s]
    twist, duration : command :math:`u` and how far it is followed, :math:`T_{eff}` [s]
    turn, travel : the most the robot turns [rad] and travels [m]
    blur : :math:`|v_b\omega - v\omega_b|\,T_{eff}\,\tau`, how far the order can matter [m]
    """

    motion: Pose2 = HERE
    body: Twist = _REST
    lag: float = 0.0
    twist: Twist = _REST
    duration: float = 0.0
    turn: float = 0.0
    travel: float = 0.0
    blur: float = 0.0

    @classmethod
    def of(cls, motion: Pose2, body: Twist, lag: float, twist: Twist, duration: float) -> Sweep:
        """The sweep of a brake; turn, travel and blur follow from the rest."""
        (v, omega), (v_body, omega_body) = twist, body
        turn = abs(omega) * duration + abs(omega_body) * lag
        travel = abs(v) * duration + abs(v_body) * lag
        blur = abs(v_body * omega - v * omega_body) * duration * lag
        return tuple.__new__(cls, (motion, body, lag, twist, duration, turn, travel, blur))

    def corners(self) -> tuple[Pose2, ...]:
        """Its poses at the corners of (E, S); two where nothing lags."""
        motion, body, lag, twist, duration = self[:5]
        braked = motion.moved(twist, duration)
        if not lag:
            return motion, braked
        coasted = motion.moved(body, lag)
        return motion, coasted, braked, coasted.moved(twist, duration)


@runtime_checkable
class Barrier(Protocol):
    r"""A safe set :math:`\{h_i \ge 0\}` of scenes and the commands that keep it.

    The methods are views of one set. ``rows`` speaks to the quadratic program: the half-planes
    :math:`\dot h_i(u) \ge -\lambda h_i` [Ames2019]_. The clearances speak to the guard, which
    asks for them along predicted motions, where no derivative is needed.

    An implementation holds its own configuration (and whatever it must know beside the scene,
    such as obstacles) and no state: the same scene gives the same rows. One that keeps a reserve
    for estimates that err names itself without it in an attribute ``bare``, a barrier too.
    All methods raise ``GeometryError`` where the scene is not finite or the barrier is undefined.
    """

    @property
    def name(self) -> str:
        """Prefix of the names of its rows, unique among the barriers of one filter."""

    def rows(self, scene: Scene, motion: Pose2 | None = None) -> Rows:
        """The half-planes of admissible commands, priority ``SAFETY``.

        At ``scene``, or where the robot is after it moved by ``motion`` since.
        """

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Distance to the edge of the safe set after ``motion``, in the barrier's natural unit.

        At least 0 exactly where the scene is safe; [rad] for an angle, [m] for a distance.
        Minus infinity where the rows give no guidance back into the safe set.
        """

    def clearance_along(self, scene: Scene, sweep: Sweep) -> float:
        """The smallest clearance at any pose of the sweep, or a lower bound of it."""

    def clearance_around(self, scene: Scene, sweep: Sweep) -> tuple[float, float]:
        """Clearance at the sweep's start, and a cheap lower bound of ``clearance_along``.

        The bound may be as low as minus infinity; a good one saves the guard its exact test.
        """
