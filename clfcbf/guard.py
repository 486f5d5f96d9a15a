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
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from clfcbf.constraints.barrier import HERE, Barrier, Sweep
from clfcbf.errors import ConfigurationError
from clfcbf.limits import InputBox, Limits, check_period
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist

__all__ = ["Brake", "Guard", "Guarded", "Verdict", "moved_scene"]

_REST = Twist(0.0, 0.0)
_new = tuple.__new__  # makes a named tuple in half the time of its own constructor

ROUNDING = 1e-12
"""[m/s, rad/s, and the barriers' units] By which two ways to compute one number may differ."""

FALLBACKS = (0.25, 0.5, 0.75)
"""Shares of the way from the brake to the wanted command that may be tried, by bisection."""


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
        (v, omega), ticks, verified = self
        factor = 1.0 - 1.0 / ticks
        return _new(Brake, (_new(Twist, (v * factor, omega * factor)), ticks - 1, verified))


class Verdict(Enum):
    """What the guard did with a command."""

    ADMITTED = "admitted"
    REPLACED = "replaced"
    BRAKED = "braked"


_ADMITTED, _REPLACED, _BRAKED = Verdict.ADMITTED, Verdict.REPLACED, Verdict.BRAKED


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
    """

    limits: Limits
    barriers: tuple[Barrier, ...]
    period: float
    lag: float = 0.0
    _bare: tuple[Barrier, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_period(self.period)
        if not 0.0 <= self.lag < 10.0:
            raise ConfigurationError(f"lag must be in [0, 10) s, got {self.lag!r}")
        bare = tuple([getattr(barrier, "bare", barrier) for barrier in self.barriers])
        object.__setattr__(self, "_bare", bare)

    def clearance(self, scene: Scene, motion: Pose2 = HERE) -> float:
        """Smallest clearance of any barrier, each in its own unit; +inf without barriers."""
        return min([b.clearance(scene, motion) for b in self.barriers], default=math.inf)

    def brake_from(self, twist: Twist) -> Brake:
        """The same-curvature brake from ``twist``."""
        ticks = self.limits.brake_ticks(twist, self.period)
        return _new(Brake, (twist, ticks, ticks == 0))

    def sweep(self, body: Twist, brake: Brake, motion: Pose2 = HERE) -> Sweep:
        """Where a body may pass on its way to rest, whatever its lag up to ``lag``."""
        duration = 0.5 * self.period * (brake[1] + 1)
        return Sweep.of(motion, body, self.lag, brake[0], duration)

    def admissible(self, scene: Scene, sweep: Sweep) -> bool:
        r"""Whether a brake is safe from here to rest.

        Parameters
        ----------
        scene : goal and feature as seen before the sweep's ``motion``
        sweep : of the brake, see :meth:`sweep`

        Notes
        -----
        Let the body coast by :math:`E \in [0, \tau]` seconds' worth of :math:`b` and follow
        :math:`S \in [0, T_{eff}]` seconds' worth of :math:`u`; both grow while it brakes. Its
        heading is :math:`\omega_b E + \omega S` in whatever order they grow, and its position
        is that of coasting first to within

        .. math:: |v_b\,\omega - v\,\omega_b|\,S E

        (the area between the two orders, Green). For the field of view, on each side of the
        rectangle of (S, E) a body-fixed point moves on a constant-twist arc, where its largest
        bearing off the forward direction is at an end, while it is ahead of the camera and of
        the rotation centre. So four corners, each with that blur, answer for all of it, for a
        camera whose view contains the forward direction even when turned by the arc.
        """
        for barrier in self.barriers:  # noqa: SIM110  # a generator costs more than a test
            if not barrier.clearance_along(scene, sweep) >= 0.0:
                return False
        return True

    def filter(
        self,
        wanted: Twist,
        scene: Scene,
        body: Twist,
        box: InputBox,
        brake: Brake,
        motion: Pose2 = HERE,
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
        """
        period, limits = self.period, self.limits
        ticks = limits.brake_ticks(wanted, period)
        sweep = Sweep.of(motion, body, self.lag, wanted, 0.5 * period * (ticks + 1))
        clearance = least = math.inf
        heres = []
        for barrier in self.barriers:
            here, bound = barrier.clearance_around(scene, sweep)
            heres.append(here)
            clearance = here if here < clearance else clearance
            least = bound if bound < least else least
        if clearance < 0.0:
            return self._outside(wanted, scene, sweep, box, brake, heres, clearance)
        if least >= 0.0 or self.admissible(scene, sweep):
            sure = limits.contains(wanted, ROUNDING)
            kept = _new(Brake, (wanted, ticks, sure))
            return _new(Guarded, (wanted, kept, _ADMITTED, sure, clearance))

        def admit(other: Twist) -> Guarded | None:
            ticks = limits.brake_ticks(other, period)
            around = Sweep.of(motion, body, self.lag, other, 0.5 * period * (ticks + 1))
            if not self.admissible(scene, around):
                return None
            sure = limits.contains(other, ROUNDING)
            kept = _new(Brake, (other, ticks, sure))
            return _new(Guarded, (other, kept, _REPLACED, sure, clearance))

        last = brake.next()
        found = _nearest(box.clip(last.twist), wanted, box, admit)
        return self._braked(last, box, clearance) if found is None else found

    def _outside(
        self,
        wanted: Twist,
        scene: Scene,
        sweep: Sweep,
        box: InputBox,
        brake: Brake,
        heres: list[float],
        clearance: float,
    ) -> Guarded:
        """The same where some barrier does not hold, found so or put there by a nudge.

        The clearance to be kept is the one there is, or what coasting leaves of it, which no
        command can change: what does not make things worse is admissible, so the robot can turn
        back. Where no barrier says which way back is (minus infinity) it brakes. Neither speed
        nor turn rate may drive out more than the brake does, not even where a model finds them
        in balance: what errs in the model would add up.

        What is admitted here is certified as long as it keeps the barriers without their
        reserve, which is declared for estimates that err; nothing is outside the speed limits,
        where the next command is a forced one.

        ``heres`` are the clearances of the barriers, and ``clearance`` the smallest of them.
        """
        last = brake.next()
        if clearance == -math.inf:
            return self._braked(last, box, clearance)
        motion, body = sweep.motion, sweep.body
        coasted = motion.moved(body, self.lag)
        floors = []
        reserved = True
        for barrier, bare, here in zip(self.barriers, self._bare, heres, strict=True):
            floor = 0.0
            if here < 0.0:
                floor = min(here, barrier.clearance(scene, coasted))
                reserved = reserved and bare.clearance(scene, motion) >= 0.0
                reserved = reserved and bare.clearance(scene, coasted) >= 0.0
            floors.append(floor)
        limits = self.limits

        def admit(other: Twist) -> Guarded | None:
            brake = self.brake_from(other)
            if not self._no_worse(scene, self.sweep(body, brake, motion), floors):
                return None
            sure = reserved and limits.contains(other, ROUNDING)
            verdict = _ADMITTED if other == wanted else _REPLACED
            kept = _new(Brake, (other, brake[1], sure))
            return _new(Guarded, (other, kept, verdict, sure, clearance))

        safe = box.clip(last.twist)
        inward = self._inward(wanted, safe, scene, motion)
        found = admit(inward)
        if found is None:
            found = _nearest(safe, inward, box, admit)
        return self._braked(last, box, clearance) if found is None else found

    def _inward(self, wanted: Twist, safe: Twist, scene: Scene, motion: Pose2) -> Twist:
        """``wanted`` with each part that drives out more than the brake's replaced by that."""
        v, omega = wanted
        for barrier in self.barriers:
            _, coefficients, _, values = barrier.rows(scene, motion)
            for (a_v, a_omega, _), value in zip(coefficients, values, strict=True):
                if value < 0.0:
                    v = safe[0] if a_v * v > a_v * safe[0] else v
                    omega = safe[1] if a_omega * omega > a_omega * safe[1] else omega
        return _new(Twist, (v, omega))

    def _no_worse(self, scene: Scene, sweep: Sweep, floors: list[float]) -> bool:
        """Whether a brake keeps the barriers that hold, and of the others their floor.

        Those without the blur: outside, a few millimetres are no reason to refuse the way back.
        """
        sharp = _new(Sweep, (*sweep[:7], 0.0))
        for barrier, floor in zip(self.barriers, floors, strict=True):
            around = sharp if floor < 0.0 else sweep
            if not barrier.clearance_along(scene, around) >= floor - ROUNDING:
                return False  # to rounding: the floor is the clearance at one of its ends
        return True

    def _braked(self, last: Brake, box: InputBox, clearance: float) -> Guarded:
        """The next command of the brake at hand, or what the input box leaves of it."""
        safe = box.clip(last.twist)
        # Outside the box the chassis did not follow the brake: its certificate is void.
        kept = last if box.contains(last.twist, ROUNDING) else self.brake_from(safe)
        return _new(Guarded, (safe, kept, _BRAKED, kept[2], clearance))


def _nearest(
    safe: Twist, wanted: Twist, box: InputBox, admit: Callable[[Twist], Guarded | None]
) -> Guarded | None:
    """The admitted command nearest to the wanted one on the way there from the brake.

    By bisection; where none is found, the wanted turn at the brake's speed.
    """
    v, omega = safe
    dv, dw = wanted[0] - v, wanted[1] - omega
    if not dv and not dw:  # the brake itself was wanted, and refused
        return None
    less, half, more = FALLBACKS
    found = admit(box.clip((v + half * dv, omega + half * dw)))
    share = less if found is None else more
    further = admit(box.clip((v + share * dv, omega + share * dw)))
    return further or found or admit(box.clip((v, wanted[1])))
