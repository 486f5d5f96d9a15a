r"""What a docking run does when it no longer knows well enough where the target is.

Three questions, each a function without state: whether dead reckoning is still good enough to go
on near the goal, whether the leg in progress can still be used after the target has moved, and
which legs a search for a lost target has. A search turns to where the target should be, waits,
goes back along the way it came to where the target was last seen and a little further, turns to
it again and waits. It drives no way that it has not just come, and every command of it passes
the guard as any other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.estimation import TargetEstimate, spread
from clfcbf.limits import Limits
from clfcbf.scene import Covariance
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.trajectories.legs import Leg, Path, Place, Turn

__all__ = ["Search", "end_error", "is_uncertain", "next_leg", "retrace"]

_SHORTEST = 0.02  # [m] a way back that is worth a leg


class Search(NamedTuple):
    """How far a search has come.

    ``way`` is the leg in progress when the target was lost, with the arc lengths reached on it
    and at which the target was last seen; ``step`` the number of legs and looks begun, ``ticks``
    those spent on the present look.
    """

    way: Path | None = None
    reached: float = 0.0
    seen_at: float = 0.0
    step: int = 0
    ticks: int = 0


def is_uncertain(target: TargetEstimate, seen: Covariance, pose: Pose2, lateral: float) -> bool:
    r"""Whether dead reckoning is too uncertain to go on near the goal.

    True within 0.5 m of it where, in one of the goal's axes, :math:`2\sigma` is beyond the
    tolerance and :math:`\sigma^2` has more than doubled since the last look.

    Parameters
    ----------
    target : estimate now, in the frame of the reckoning
    seen : its covariance right after the last accepted measurement
    pose : of the robot in the goal's frame
    lateral : tolerance across the goal's axis [m]
    """
    if math.hypot(pose[0], pose[1]) > defaults.RECOVERY_NEAR:
        return False
    now = spread(target.covariance, target.goal[2])
    then = spread(seen, target.goal[2])
    tolerances = (defaults.RECOVERY_ALONG, lateral, defaults.RECOVERY_TURNED)
    return any(
        defaults.RECOVERY_SIGMAS * sigma > tolerance
        and sigma * sigma > defaults.RECOVERY_GROWN * before * before
        for sigma, before, tolerance in zip(now, then, tolerances, strict=True)
    )


def end_error(lateral: float, heading: float, rest: float, k2: float) -> float:
    r"""Bound of the lateral error that is left after ``rest`` metres of following a path.

    Critically damped, :math:`e'' + 2ke' + k^2e = 0` with :math:`k^2 = k_2` per metre travelled:

    .. math:: |e(r)| \le \left(|e_0| + (k|e_0| + |\tan\theta_0|)\,r\right)e^{-kr}

    Parameters
    ----------
    lateral, heading : errors now [m, rad], the heading's within a right angle
    rest : way to go [m], not negative
    k2 : gain on the lateral error [1/m²]
    """
    k = math.sqrt(k2)
    slope = k * abs(lateral) + abs(math.tan(heading))
    return (abs(lateral) + slope * rest) * math.exp(-k * rest)


def retrace(way: Path, reached: float, seen_at: float, limits: Limits) -> Path | None:
    """The last part of ``way`` up to ``reached``, driven back in the other gear.

    Back to ``seen_at`` and a little further, at most ``defaults.RETRACE``. None where that gear
    is not allowed, or nothing of the way is left. The curvature is that of the way, and the speed
    keeps within all four limits.

    Parameters
    ----------
    way : the leg in progress
    reached, seen_at : arc lengths on it where the robot stands, and where it last saw the target
    limits : of the motion back
    """
    gear = -way.gear
    top = limits.v_max if gear > 0 else -limits.reverse_speed
    start = min(max(reached, way.s[0]), way.s[-1])
    stop = max(min(seen_at - defaults.RECOVERY_BEYOND, start), start - defaults.RETRACE, way.s[0])
    if top == 0.0 or start - stop < _SHORTEST:
        return None
    marks = [start, *[s for s in reversed(way.s) if stop + 1e-6 < s < start - 1e-6], stop]
    places = [way.at(s) for s in marks]
    top = min(top, defaults.RETRACE_SPEED)
    curvatures = _curvatures(places)
    speeds = [0.0]
    for i in range(len(marks) - 2, -1, -1):  # from the stop, so that it can brake for each bend
        ratio = max(abs(curvatures[i]), abs(curvatures[i + 1]), 1e-9)
        slope = min(limits.a_max, limits.alpha_max / ratio)
        reachable = math.sqrt(speeds[-1] ** 2 + 2.0 * slope * (marks[i] - marks[i + 1]))
        speeds.append(min(top, limits.omega_max / ratio, reachable))
    speeds.reverse()
    rates = [-curvature * speed for curvature, speed in zip(curvatures, speeds, strict=True)]
    return Path(
        tuple([start - mark for mark in marks]), tuple([place.pose for place in places]),
        tuple(speeds), tuple(rates), places[-1].pose, gear,
    )  # fmt: skip


def _curvatures(places: list[Place]) -> list[float]:
    """Curvature at each place; where the way stands still, that of the place before or after."""
    found = [place.turn_rate / place.speed if place.speed > 0.0 else None for place in places]
    for indices in (range(1, len(found)), range(len(found) - 2, -1, -1)):
        for i in indices:
            near = found[i - 1] if indices.step > 0 else found[i + 1]
            found[i] = near if found[i] is None else found[i]
    return [curvature or 0.0 for curvature in found]


def next_leg(
    search: Search, pose: Pose2, feature: Pose2, camera: FieldOfView, limits: Limits, period: float
) -> tuple[Search, Leg | None]:
    """The search one tick on at rest, and the leg that begins now; None for looking.

    Parameters
    ----------
    pose : of the robot in the goal's frame
    feature : in the goal's frame
    """
    way, reached, seen_at, step, ticks = search
    seen = pose.seen(feature)
    if step in (0, 3):  # turn to where the target should be
        search = Search(way, reached, seen_at, step + 1, 0)
        bearing = camera.bearing(seen)
        if abs(bearing) > defaults.RECOVERY_FACING:
            direction = math.atan2(seen[1], seen[0]) - camera.camera.theta
            return search, Turn(wrap_angle(pose.theta + direction))
        return search, None
    if step == 1 and ticks * period >= defaults.RECOVERY_LOOK:
        search = Search(way, reached, seen_at, 2, 0)
    if search.step == 2:
        back = None
        if way is not None:
            back = retrace(way, way.nearest(pose, reached).s, seen_at, limits)
        return Search(way, reached, seen_at, 3, 0), back
    return search._replace(ticks=ticks + 1), None
