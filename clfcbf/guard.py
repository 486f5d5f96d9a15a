r"""The guard: an arc look-ahead with a certified brake around any nominal command.

Commands change by at most :math:`a_{max}T` and :math:`\alpha_{max}T` a tick and are held. From
the command :math:`u` a brake along the same circle takes
:math:`N(u) = \lceil\max(|v|/(a_{max}T), |\omega|/(\alpha_{max}T))\rceil` ticks and covers as
much of it as :math:`u` does in

.. math:: T_{eff}(u) = T (N + 1) / 2 .

A command is *admissible* when the constant-twist arc of that duration stays in the safe set.
If :math:`u` is, so is the brake :math:`u(1 - 1/N)` a tick later, whose own arc is the rest of
the same one: a stop is always at hand. A body that lags behind the commands also coasts by
:math:`\tau b`; how the two motions mix is bounded in :meth:`Guard.admissible`.

The ticks left of a certified brake are counted down, never computed again: in floating point
a recomputed :math:`N` fails to drop by one in some brakes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from clfcbf.constraints.barrier import HERE, Barrier
from clfcbf.errors import ConfigurationError
from clfcbf.limits import InputBox, Limits, check_period
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist

__all__ = ["Brake", "Guard", "Guarded", "Verdict", "moved_scene"]

_REST = Twist(0.0, 0.0)
_ORIGIN = HERE[0]
_new = tuple.__new__  # makes a named tuple in half the time of its own constructor

ROUNDING = 1e-12
"""[m/s, rad/s] What a brake may stick out of the input box by arithmetic alone."""

FALLBACKS = (0.75, 0.5, 0.25)
"""Shares of the way from the brake to the wanted command that are tried in between."""


class Brake(NamedTuple):
    """The brake at hand: the command it starts from and the ticks it needs to rest.

    ``verified`` says that it was found to keep every barrier; to stand still needs no proof.
    """

    twist: Twist
    ticks: int
    verified: bool = False

    def next(self) -> Brake:
        """One tick on: the same curvature, slower by one part in ``ticks``."""
        if self.ticks <= 1:
            return Brake(_REST, 0, self.ticks == 0 or self.verified)
        return Brake(self.twist.scaled(1.0 - 1.0 / self.ticks), self.ticks - 1, self.verified)


class Verdict(Enum):
    """What the guard did with a command."""

    ADMITTED = "admitted"
    REPLACED = "replaced"
    BRAKED = "braked"


class Guarded(NamedTuple):
    """What the guard lets through.

    ``certified`` says that the command sent has a brake that was verified or is the countdown
    of one that was; ``clearance`` is the smallest one now.
    """

    twist: Twist
    brake: Brake
    verdict: Verdict
    certified: bool
    clearance: float


def moved_scene(scene: Scene, motion: Pose2) -> Scene:
    """The scene as seen after the robot moved by ``motion``."""
    return Scene(motion.relative(scene.goal), motion.relative(scene.feature), scene.stamp)


@dataclass(frozen=True, slots=True)
class Guard:
    """Admits a command only while a stop from it stays safe.

    Attributes
    ----------
    limits, period : as of the chassis; the brake is made of them
    barriers : what has to stay at or above zero clearance
    lag : longest first-order lag of the body that is covered [s]
    grace : the smallest ``margin`` of the barriers, 0 for one that declares none
    """

    limits: Limits
    barriers: tuple[Barrier, ...]
    period: float
    lag: float = 0.0
    grace: float = field(init=False)

    def __post_init__(self) -> None:
        check_period(self.period)
        if not 0.0 <= self.lag < 10.0:
            raise ConfigurationError(f"lag must be in [0, 10) s, got {self.lag!r}")
        grace = min((getattr(barrier, "margin", 0.0) for barrier in self.barriers), default=0.0)
        object.__setattr__(self, "grace", grace)

    def clearance(
        self, scene: Scene, motions: tuple[Pose2, ...] = HERE, blur: float = 0.0
    ) -> float:
        """Smallest clearance of any barrier at any of the poses; +inf without barriers.

        Each in its own unit; see :meth:`Barrier.clearance`.
        """
        smallest = math.inf
        for barrier in self.barriers:
            clearance = barrier.clearance(scene, motions, blur)
            if clearance < smallest:
                smallest = clearance
        return smallest

    def brake_from(self, twist: Twist) -> Brake:
        """The same-curvature brake from ``twist``."""
        ticks = self.limits.brake_ticks(twist, self.period)
        return _new(Brake, (twist, ticks, ticks == 0))

    def admissible(
        self,
        scene: Scene,
        body: Twist,
        brake: Brake,
        floor: float = 0.0,
        motion: Pose2 = _ORIGIN,
    ) -> bool:
        r"""Whether a brake is safe from here to rest, whatever the lag up to ``lag``.

        Parameters
        ----------
        scene : goal and feature as seen before ``motion``
        body : twist of the body now
        brake : candidate command and the ticks its brake takes
        floor : clearance to be kept
        motion : how the robot moved since the scene was seen

        Notes
        -----
        Let the body coast by :math:`E \in [0, \tau]` seconds' worth of :math:`b` and follow
        :math:`S \in [0, T_{eff}]` seconds' worth of :math:`u`; both grow while it brakes. Its
        heading is :math:`\omega_b E + \omega S` in whatever order they grow, and its position
        is that of coasting first to within

        .. math:: |v_b\,\omega - v\,\omega_b|\,S E

        (the area between the two orders, Green). On each side of the rectangle of (S, E) a
        body-fixed point moves on a constant-twist arc, where its largest bearing off the forward
        direction is at an end, while it is ahead of the camera and of the rotation centre. So
        four corners, each with that blur, answer for all of it, for a camera whose view
        contains the forward direction even when turned by the arc.
        """
        twist, ticks, _ = brake
        duration = 0.5 * self.period * (ticks + 1)
        braked = motion.moved(twist, duration)
        if not self.lag:
            return self.clearance(scene, (motion, braked)) >= floor
        blur = abs(body[0] * twist[1] - twist[0] * body[1]) * duration * self.lag
        coasted = motion.moved(body, self.lag)
        unavoidable = (motion, coasted)
        if floor < 0.0:  # outside, what no command can change is no reason to refuse the way back
            floor, blur = min(floor, self.clearance(scene, unavoidable)), 0.0
        corners = (*unavoidable, braked, coasted.moved(twist, duration))
        return self.clearance(scene, corners, blur) >= floor

    def _certifies(
        self, scene: Scene, body: Twist, twist: Twist, floor: float, motion: Pose2
    ) -> bool:
        """Whether an admitted command has a brake that keeps every barrier, margins included."""
        if floor < 0.0:
            coasted = motion.moved(body, self.lag)
            floor = min(floor, self.clearance(scene, (motion, coasted)))
        return floor >= -self.grace and self.limits.contains(twist, ROUNDING)

    def _around(
        self, scene: Scene, body: Twist, brake: Brake, motion: Pose2
    ) -> tuple[float, float]:
        """Clearance now, and a lower bound of it until the brake has come to rest."""
        (v, omega), (v_body, omega_body) = brake.twist, body
        duration, lag = 0.5 * self.period * (brake.ticks + 1), self.lag
        turn = abs(omega) * duration + abs(omega_body) * lag
        travel = abs(v) * duration + abs(v_body) * lag
        blur = abs(v_body * omega - v * omega_body) * duration * lag
        clearance = least = math.inf
        for barrier in self.barriers:
            here, bound = barrier.clearance_around(scene, motion, turn, travel, blur)
            clearance = here if here < clearance else clearance
            least = bound if bound < least else least
        return clearance, least

    def filter(
        self,
        wanted: Twist,
        scene: Scene,
        body: Twist,
        box: InputBox,
        brake: Brake,
        motion: Pose2 = _ORIGIN,
    ) -> Guarded:
        """The admissible command nearest to ``wanted`` among a few, else the certified brake.

        Parameters
        ----------
        wanted : command to be checked, inside ``box``
        scene : goal and feature as seen before ``motion``
        body : modelled twist of the body now
        box : commands reachable this tick
        brake : the brake certified at the last tick
        motion : how the robot moved since the scene was seen

        Notes
        -----
        Outside the safe set (found there, or put there by a nudge) the clearance to be kept is
        the one there is: what does not make things worse is admissible, so the robot can turn
        back. Where no barrier says which way back is (minus infinity) it brakes. What is admitted
        there is certified as long as it stays inside the barriers' own margins, which are
        declared for estimates that err; nothing is outside the speed limits, where the next
        command is a forced one.
        """
        new = self.brake_from(wanted)
        clearance, least = self._around(scene, body, new, motion)
        floor = min(0.0, clearance)
        if least >= 0.0 or (
            clearance > -math.inf and self.admissible(scene, body, new, floor, motion)
        ):
            sure = self._certifies(scene, body, wanted, floor, motion)
            brake = _new(Brake, (wanted, new[1], sure))
            return _new(Guarded, (wanted, brake, Verdict.ADMITTED, sure, clearance))
        last = brake.next()
        safe = box.clip(last.twist)
        coasted = motion.moved(body, self.lag)
        hopeless = floor == 0.0 and self.clearance(scene, (coasted,)) < 0.0
        if clearance > -math.inf and not hopeless:
            for other in _between(safe, wanted, box):
                new = self.brake_from(other)
                if self.admissible(scene, body, new, floor, motion):
                    sure = self._certifies(scene, body, other, floor, motion)
                    kept = Brake(other, new.ticks, sure)
                    return Guarded(other, kept, Verdict.REPLACED, sure, clearance)
        # Outside the box the chassis did not follow the brake: its certificate is void.
        kept = last if box.contains(last.twist, ROUNDING) else self.brake_from(safe)
        return Guarded(safe, kept, Verdict.BRAKED, kept.verified, clearance)


def _between(safe: Twist, wanted: Twist, box: InputBox) -> Iterator[Twist]:
    """Commands ever closer from the wanted one to the brake, all inside the box."""
    v, omega = safe
    dv, dw = wanted[0] - v, wanted[1] - omega
    if not dv and not dw:  # the brake itself was wanted, and refused
        return
    for share in FALLBACKS:
        yield box.clip(Twist(v + share * dv, omega + share * dw))
    yield box.clip(Twist(v, wanted[1]))
    yield box.clip(Twist(wanted[0], omega))
