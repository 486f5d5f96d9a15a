"""The floor of one start: every guess on a coarse mesh, the best refined until it is certain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from benchmarks.floor.certificate import Certificate, certify, least_time
from benchmarks.floor.guesses import guesses
from benchmarks.floor.program import Motion, floor_program
from clfcbf.errors import GeometryError, PlanningError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, is_finite
from clfcbf.simulation.scenarios import World

__all__ = ["Floor", "floor_time"]

COARSE = 40
"""Intervals of the search: 0.15 to 0.3 s each, half of a ramp of the speed; 0.1 % above the limit
of many."""

FINE = 160
"""Intervals of the answer: twice as many change it by 0.02 % or less."""

FINEST = 1280
"""Intervals at which a motion that still leaves the view between them is given up."""

VIEW_TOLERANCE = math.radians(0.05)
"""[rad] By how much the feature may leave the view between two nodes: a tenth of the noise."""

END_TOLERANCE = 1e-3
"""[m] A tenth of the strict criterion of docking."""

END_TOLERANCE_THETA = math.radians(0.1)
"""[rad] A twentieth of it."""

END_TOLERANCE_SPEED = 1e-6
"""[m/s, rad/s] A thousandth of what counts as standing."""

LIMIT_TOLERANCE = 1e-6
"""Share of a limit by which rounding may exceed it; IPOPT relaxes its bounds by 1e-8."""

SAME = 1e-2
"""[s] Local optima closer than this are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The least time found from a start to the goal.

    Attributes
    ----------
    time : from rest to rest [s]
    bound : proven, below every motion, :func:`benchmarks.floor.certificate.least_time` [s]
    trajectory : the motion that takes it, in the goal's frame
    guess : the guess that led there
    optima : different local optima that the guesses led to
    spread : from the fastest of them to the slowest, on the coarse mesh [s]
    failed : guesses that led to none
    violation : largest angle beyond the view's edge, between nodes too [rad]; negative inside
    certificate : what the motion comes to when it is integrated afresh
    """

    time: float
    bound: float
    trajectory: Motion
    guess: str
    optima: int
    spread: float
    failed: int
    violation: float
    certificate: Certificate


def floor_time(start: Pose2, world: World, limits: Limits, intervals: int = FINE) -> Floor:
    """The time-optimal docking from ``start`` with the feature in the true view all along.

    No margin, no lag, no noise, and the whole future known: what a controller takes longer is
    its own price. Reverse is allowed as far as the limits do.

    Parameters
    ----------
    start : pose at rest in the goal's frame
    world, limits : camera and feature, speeds and accelerations
    intervals : of the answer's mesh at least; doubled until the view holds between its nodes

    Raises
    ------
    GeometryError : the start is not finite, or sees nothing of the feature
    PlanningError : no guess led to a motion that is certified
    MissingExtraError : CasADi is not installed
    """
    if not is_finite(tuple(start)):
        raise GeometryError(f"start must be finite, got {start!r}")
    margin = world.camera.margin(start.seen(world.feature))
    if margin < 0.0:
        raise GeometryError(
            f"the feature is {math.degrees(-margin):.2f} degrees outside the view at {start!r}, "
            "so that no motion from there keeps it in view"
        )
    coarse = floor_program(world, limits, COARSE)
    tried = guesses(start, limits, COARSE)
    found = [
        (name, motion)
        for name, guess in tried.items()
        if (motion := coarse.solve(start, guess)) is not None
    ]
    # Of guesses that lead to one optimum the first is named, whatever the solver's last digits.
    found.sort(key=lambda optimum: round(optimum[1].duration / SAME))
    times = sorted(motion.duration for _, motion in found)
    reasons = {"no local optimum": len(tried) - len(found)}
    for name, motion in found:
        refined = _refined(motion, start, world, limits, intervals, reasons)
        if refined is None:
            continue
        motion, certificate = refined
        return Floor(
            time=motion.duration,
            bound=least_time(start, limits),
            trajectory=motion,
            guess=name,
            optima=1 + sum(b - a > SAME for a, b in pairwise(times)),
            spread=times[-1] - times[0],
            failed=len(tried) - len(found),
            violation=certificate.violation,
            certificate=certificate,
        )
    raise PlanningError(
        f"no certified motion from {start!r}: "
        + ", ".join(f"{name}: {count}" for name, count in reasons.items()),
        reasons,
    )


def _refined(
    motion: Motion, start: Pose2, world: World, limits: Limits, intervals: int,
    reasons: dict[str, int],
) -> tuple[Motion, Certificate] | None:  # fmt: skip
    """The motion on the mesh on which it passes; None, with the reason counted, if on none."""
    better: Motion | None = motion
    while intervals <= FINEST:
        better = floor_program(world, limits, intervals).solve(start, motion)
        if better is None:
            break
        certificate = certify(better, start, world, limits)
        failing = _failing(certificate)
        if failing is None:
            return better, certificate
        if failing != "field of view" or 2 * intervals > FINEST:
            reasons[failing] = reasons.get(failing, 0) + 1
            return None
        motion, intervals = better, 2 * intervals
    reasons["refinement"] = reasons.get("refinement", 0) + 1
    return None


def _failing(certificate: Certificate) -> str | None:
    """What a motion fails by."""
    if certificate.end_error >= END_TOLERANCE or certificate.end_turn >= END_TOLERANCE_THETA:
        return "does not arrive"
    if max(certificate.end_speed, certificate.end_rate) >= END_TOLERANCE_SPEED:
        return "does not rest"
    if certificate.excess >= LIMIT_TOLERANCE:
        return "limits"
    return "field of view" if certificate.violation >= VIEW_TOLERANCE else None
