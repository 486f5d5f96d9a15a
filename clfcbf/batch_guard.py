r"""The guard of many robots at once: the rule of :class:`clfcbf.guard.Guard` on arrays.

One column a robot: twists are arrays of shape (2, n), points (p, 2, n), poses (3, n), boxes
``(v_lo, v_hi, w_lo, w_hi)`` (4, n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import camera_edges
from clfcbf.guard import FALLBACKS, ROUNDING
from clfcbf.limits import Limits
from clfcbf.qp.batch_geometry import Array, Flags, Mask

__all__ = ["ADMITTED", "BRAKED", "REPLACED", "ArrayGuard", "ArrayGuarded", "Brakes", "clipped"]

ADMITTED, REPLACED, BRAKED = np.uint8(0), np.uint8(1), np.uint8(2)
"""What the guard did with a command, as :class:`clfcbf.guard.Verdict`."""


class Brakes(NamedTuple):
    """Brakes at hand, see :class:`clfcbf.guard.Brake`: twists (2, n), ticks left, verified (n,)."""

    twist: Array
    ticks: Array
    verified: Mask

    def next(self) -> Brakes:
        """One tick on: the same curvature, slower by one part in ``ticks``."""
        moving = self.ticks > 1.0
        factor = 1.0 - 1.0 / np.where(moving, self.ticks, 1.0)  # 0 at the last tick
        verified = self.verified | (self.ticks == 0.0)
        return Brakes(self.twist * factor, np.where(moving, self.ticks - 1.0, 0.0), verified)


class ArrayGuarded(NamedTuple):
    """What the guard lets through, see :class:`clfcbf.guard.Guarded`."""

    twist: Array
    brakes: Brakes
    verdict: Flags
    certified: Mask
    clearance: Array


def clipped(box: Array, twist: Array) -> Array:
    """The point of the box nearest to the twist, coordinate by coordinate."""
    return np.minimum(np.maximum(twist, box[0::2]), box[1::2])


def within(box: Array, twist: Array) -> Mask:
    """Whether twists are in the box to rounding."""
    fine = (box[0::2] - ROUNDING <= twist) & (twist <= box[1::2] + ROUNDING)
    both: Mask = fine[0] & fine[1]
    return both


def arcs(twist: Array, duration: Array | float) -> Array:
    """Exact motions of constant twists, see :func:`clfcbf.se2.arc`; the angle is not wrapped."""
    v, omega = twist
    half = 0.5 * omega * duration
    sine = np.sin(half)
    straight = half == 0.0
    chord = v * duration * np.where(straight, 1.0, sine / np.where(straight, 1.0, half))
    return np.stack((chord * np.cos(half), chord * sine, 2.0 * half))


def moved(points: Array, motion: Array) -> Array:
    """Points as seen after motions, see :meth:`clfcbf.se2.Pose2.seen`."""
    x, y, turn = motion
    c, s = np.cos(turn), np.sin(turn)
    d_x, d_y = points[:, 0] - x, points[:, 1] - y
    return np.stack((c * d_x + s * d_y, c * d_y - s * d_x), axis=1)


def composed(first: Array, then: Array) -> Array:
    """``first * then``, see :meth:`clfcbf.se2.Pose2.compose`; the angle is not wrapped."""
    x, y, theta = first
    c, s = np.cos(theta), np.sin(theta)
    return np.stack((x + c * then[0] - s * then[1], y + s * then[0] + c * then[1], theta + then[2]))


@dataclass(frozen=True, slots=True)
class ArrayGuard:
    """Admits commands only while a stop from them keeps every point in view.

    Attributes
    ----------
    limits, period : as of the chassis
    camera : the view that is kept
    bare : the view itself, which that leaves a reserve of
    lag : longest first-order lag of the body that is covered [s]
    """

    limits: Limits
    period: float
    camera: FieldOfView
    bare: FieldOfView
    lag: float

    def brakes_from(self, twist: Array) -> Brakes:
        """The same-curvature brakes from ``twist``."""
        v, omega = np.abs(twist)
        v, omega = (
            v / (self.limits.a_max * self.period),
            omega / (self.limits.alpha_max * self.period),
        )
        ticks = np.ceil(np.maximum(v, omega))
        return Brakes(twist, ticks, ticks == 0.0)

    def clearance(
        self, points: Array, poses: tuple[Array, ...] = (), blur: Array | float = 0.0
    ) -> Array:
        """Smallest angle to the edge, here and after each motion [rad].

        As :meth:`clfcbf.constraints.cbf.FieldOfViewBarrier.clearance`; minus infinity behind the
        camera.
        """
        half_angle = self.camera.half_angle
        shift = blur * (1.0 / math.sin(half_angle))
        widest = np.zeros(points.shape[-1])
        for x, y in points:
            np.maximum(widest, self._bearing(x, y, shift), out=widest)
        for a, b, turn in poses:
            c, s = np.cos(turn), np.sin(turn)
            widest[np.abs(turn) > half_angle - abs(self.camera.camera.theta)] = np.inf
            for x, y in points:
                d_x, d_y = x - a, y - b
                seen = c * d_x + s * d_y, c * d_y - s * d_x
                np.maximum(widest, self._bearing(*seen, shift), out=widest)
                widest[~(seen[0] > 0.0) | ~(x > 0.0)] = np.inf
        return np.where(widest < 0.5 * math.pi, half_angle - widest, -np.inf)

    def _bearing(self, x: Array, y: Array, shift: Array | float) -> Array:
        """Modulus of the bearing seen by the camera, moved ahead along its axis by ``shift``."""
        eye_x, eye_y, yaw = self.camera.camera
        cos, sin = math.cos(yaw), math.sin(yaw)
        d_x, d_y = x - eye_x, y - eye_y
        return np.abs(np.arctan2(cos * d_y - sin * d_x, cos * d_x + sin * d_y - shift))

    def admissible(self, points: Array, body: Array, brakes: Brakes, floor: Array) -> Mask:
        """Whether brakes are safe from here to rest, see :meth:`clfcbf.guard.Guard.admissible`."""
        twist, ticks, _ = brakes
        duration = 0.5 * self.period * (ticks + 1.0)
        braked = arcs(twist, duration)
        if not self.lag:
            return self.clearance(points, (braked,)) >= np.where(
                floor < 0.0, floor - ROUNDING, floor
            )
        blur = np.abs(body[0] * twist[1] - twist[0] * body[1]) * duration * self.lag
        coasted = arcs(body, self.lag)
        poses = coasted, braked, composed(coasted, braked)
        unavoidable = np.minimum(floor, self.clearance(points, (coasted,)))
        outside = floor < 0.0
        blur = np.where(outside, 0.0, blur)
        return self.clearance(points, poses, blur) >= np.where(
            outside, unavoidable - ROUNDING, floor
        )

    def filter(
        self, wanted: Array, points: Array, body: Array, box: Array, last: Brakes
    ) -> ArrayGuarded:
        """The admissible commands nearest to ``wanted`` among a few, else the certified brakes.

        Parameters and rule as :meth:`clfcbf.guard.Guard.filter`.
        """
        clearance = self.clearance(points)
        floor = np.minimum(clearance, 0.0)
        ahead = clearance > -np.inf
        asked, wanted = wanted, wanted.copy()
        at = np.flatnonzero((clearance < 0.0) & ahead)
        if at.size:
            safe = clipped(box[:, at], last.next().twist[:, at])
            wanted[:, at] = self._inward(wanted[:, at], safe, points[:, :, at])
        sent = self.brakes_from(wanted)
        good = self.admissible(points, body, sent, floor) & ahead
        sure = good & self._certifies(points, body, sent.twist, floor)
        kept = np.where((asked == wanted).all(axis=0), ADMITTED, REPLACED)
        answer = ArrayGuarded(
            wanted.copy(),
            Brakes(wanted.copy(), sent.ticks, sure),
            np.where(good, kept, BRAKED),
            sure.copy(),
            clearance,
        )
        at = np.flatnonzero(~good)
        if at.size:
            refused = self._instead(
                wanted[:, at],
                points[:, :, at],
                body[:, at],
                box[:, at],
                Brakes(last.twist[:, at], last.ticks[at], last.verified[at]),
                np.where(ahead[at], floor[at], np.nan),
            )
            answer.twist[:, at], answer.brakes.twist[:, at] = refused.twist, refused.brakes.twist
            answer.brakes.ticks[at] = refused.brakes.ticks
            answer.brakes.verified[at] = refused.brakes.verified
            answer.verdict[at], answer.certified[at] = refused.verdict, refused.certified
        return answer

    def _instead(
        self, wanted: Array, points: Array, body: Array, box: Array, last: Brakes, floor: Array
    ) -> ArrayGuarded:
        """What goes out where the wanted command is refused; a floor of NaN admits nothing."""
        last = last.next()
        safe = clipped(box, last.twist)
        # Outside the box the chassis did not follow the brake: its certificate is void.
        brakes = self.kept(box, last, safe)
        answer = ArrayGuarded(
            safe.copy(), brakes, np.full(len(floor), BRAKED), brakes.verified.copy(), floor
        )
        sought = np.flatnonzero(floor == floor)
        way = wanted - safe
        less, half, more = FALLBACKS

        def admit(at: NDArray[np.intp], other: Array) -> Mask:
            """Send ``other`` where it is admissible, of the robots ``at``."""
            new = self.brakes_from(clipped(box[:, at], other[:, at]))
            good = self.admissible(points[:, :, at], body[:, at], new, floor[at])
            here = at[good]
            answer.twist[:, here] = answer.brakes.twist[:, here] = new.twist[:, good]
            answer.brakes.ticks[here] = new.ticks[good]
            sure = self._certifies(
                points[:, :, here], body[:, here], new.twist[:, good], floor[here]
            )
            answer.brakes.verified[here] = answer.certified[here] = sure
            answer.verdict[here] = REPLACED
            return good

        found = admit(sought, safe + half * way)
        admit(sought[found], safe + more * way)
        sought = sought[~found]
        for other in (safe + less * way, np.stack((safe[0], wanted[1]))):
            if sought.size:
                sought = sought[~admit(sought, other)]
        return answer

    def _inward(self, wanted: Array, safe: Array, points: Array) -> Array:
        """Commands without what drives out more than the brake does, as the guard has it."""
        v, omega = wanted.copy()
        for n_x, n_y, offset in camera_edges(self.camera):
            for x, y in points:
                violated = n_x * x + n_y * y - offset < 0.0
                lever = n_y * x - n_x * y
                v = np.where(violated & (n_x * v > n_x * safe[0]), safe[0], v)
                omega = np.where(violated & (lever * omega > lever * safe[1]), safe[1], omega)
        return np.stack((v, omega))

    def _certifies(self, points: Array, body: Array, twist: Array, floor: Array) -> Mask:
        """Whether admitted commands have brakes that keep the view but for its reserve."""
        limits = self.limits
        bare = replace(self, camera=self.bare)
        motions = np.zeros((3, len(floor))), arcs(body, self.lag)
        kept = np.minimum(*[bare.clearance(moved(points, motion)) for motion in motions])
        least, most = limits.reverse_speed - ROUNDING, limits.v_max + ROUNDING
        inside = (least <= twist[0]) & (twist[0] <= most)
        inside &= np.abs(twist[1]) <= limits.omega_max + ROUNDING
        sure: Mask = inside & ((kept >= 0.0) | (floor == 0.0))
        return sure

    def kept(self, box: Array, last: Brakes, safe: Array) -> Brakes:
        """The countdowns where the chassis can follow them, else fresh and unverified brakes."""
        follows = within(box, last.twist)
        fresh = self.brakes_from(safe)
        return Brakes(
            np.where(follows, last.twist, safe),
            np.where(follows, last.ticks, fresh.ticks),
            np.where(follows, last.verified, fresh.verified),
        )
