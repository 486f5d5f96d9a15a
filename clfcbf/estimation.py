r"""Where the target is now: dead reckoning of the accepted commands and a filter of its pose.

Nothing here reads odometry. The body is taken to follow the commands the chassis accepted
with a first-order lag, :math:`\tau\dot b = u - b`, and to move along the exact arcs of its
mean twist. A measurement is placed at the pose of its own capture time, so latency costs
no accuracy beyond that of the commands in between.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Point, Pose2, Twist, arc, is_finite, wrap_angle

__all__ = [
    "DeadReckoning",
    "Innovation",
    "NoiseModel",
    "TargetEstimate",
    "Verdict",
    "advance",
    "body_after",
    "coast",
    "grown",
    "is_covariance",
    "is_from_behind",
    "measured",
    "mirrored",
    "motion_since",
    "reckoned",
    "spread",
]

_FLOOR = 1e-14
"""[m², rad²] Variance added to any measurement, so that an exact one can be inverted."""

_INDEFINITE = 1e-9
"""Share of the largest entry by which rounding may leave an eigenvalue below zero."""

SETTLED = 15
"""Measurements, half a second of them, after which flipped ones no longer outvote an estimate:
from one viewpoint they err alike, so more of them are no better evidence."""

_FLIP_GATE = 2.0
"""Gates around the mirrored heading within which a measurement counts as flipped: perspective
puts the second solution a few degrees off the exact mirror image."""

_new = tuple.__new__  # makes a named tuple in half the time of its own constructor


Instant = tuple[float, Pose2, Twist]
"""A time [s], the pose then, and the mean twist from then on."""

_BUNDLE = 8
"""Instants in a bundle: a quarter of a second at 30 Hz, most of the frames' ages."""


class DeadReckoning(NamedTuple):
    """Motion of the robot since it was switched on, from the commands it accepted.

    ``body`` is the modelled twist of the body at ``time``. Each instant before is remembered with
    its pose and the mean twist held from there on: the latest few in ``recent``, oldest first,
    and those before in ``past``, bundles of as many, so that a tick copies but a handful. Before
    the first instant the robot is taken to have stood still.
    """

    time: float
    pose: Pose2
    body: Twist
    past: tuple[tuple[Instant, ...], ...] = ()
    recent: tuple[Instant, ...] = ()

    @property
    def instants(self) -> tuple[Instant, ...]:
        """All that is remembered, oldest first."""
        return (*(instant for bundle in self.past for instant in bundle), *self.recent)


def body_after(body: Twist, command: Twist, duration: float, lag: float) -> tuple[Twist, Twist]:
    r"""Body twist after ``command`` was held for ``duration``, and its mean over that time.

    :math:`b(t) = u + (b_0 - u)e^{-t/\tau}`, mean
    :math:`u + (b_0 - u)\,\tau(1 - e^{-t/\tau})/t`. With ``lag`` 0 both are the command.
    """
    if lag <= 0.0 or duration <= 0.0:
        after = command if lag <= 0.0 else body
        return after, after
    decay = math.exp(-duration / lag)
    share = lag * (1.0 - decay) / duration
    dv, dw = body[0] - command[0], body[1] - command[1]
    return (
        _new(Twist, (command[0] + dv * decay, command[1] + dw * decay)),
        _new(Twist, (command[0] + dv * share, command[1] + dw * share)),
    )


def advance(
    reckoning: DeadReckoning, applied: Twist, now: float, lag: float, memory: float = math.inf
) -> DeadReckoning:
    """Bring the reckoning to ``now`` with ``applied`` in force since its last instant.

    A clock that stands still or runs backward leaves it as it is. Instants older than
    ``memory`` [s] are forgotten, a bundle at a time.
    """
    before, pose, body, past, recent = reckoning
    duration = now - before
    if not duration > 0.0:
        return reckoning
    body, mean = body_after(body, applied, duration, lag)
    if len(recent) < _BUNDLE:
        recent = (*recent, (before, pose, mean))
    else:
        past, recent = (*past, recent), ((before, pose, mean),)
        # The next bundle tells: what lies before its first instant may still be asked for.
        while len(past) > 1 and past[1][0][0] < now - memory:
            past = past[1:]
    return _new(DeadReckoning, (now, pose.moved(mean, duration), body, past, recent))


def reckoned(reckoning: DeadReckoning, stamp: float) -> Pose2:
    """Pose at the time ``stamp``; the nearest one known outside the memory."""
    if stamp >= reckoning.time:
        return reckoning.pose
    past, pose = reckoning.past, reckoning.pose
    bundle = reckoning.recent
    earlier = len(past)
    while True:
        for start, pose, mean in reversed(bundle):
            if stamp >= start:
                return pose.moved(mean, stamp - start) if stamp > start else pose
        if not earlier:
            return pose
        earlier -= 1
        bundle = past[earlier]


def motion_since(reckoning: DeadReckoning, stamp: float) -> Pose2:
    """The robot now as seen from where it was at ``stamp``."""
    return reckoned(reckoning, stamp).relative(reckoning.pose)


def coast(body: Twist, lag: float) -> Pose2:
    r"""How far the body runs on, :math:`\mathrm{Exp}(\tau b)`.

    The position coasted to has the command itself as its derivative (exactly so on a
    straight line), so a plan followed from there loses nothing to the lag.
    """
    return arc(body, lag)


class NoiseModel(NamedTuple):
    """How much is believed of a measurement without a covariance, and of the reckoning.

    Standard deviations; the reckoning's grow with the distance travelled and the angle turned.
    """

    sigma_xy: float
    sigma_theta: float
    along: float
    across: float
    turn: float
    drift: float
    gate: float
    rejections: int
    settled: int = SETTLED


class Innovation(Enum):
    """What a measurement was, next to the estimate there is."""

    FIRST = "first"
    """There was none: the estimate starts from it."""
    EXPECTED = "expected"
    """Inside the gate, and fused."""
    OUTLIER = "outlier"
    """Outside the gate: left out and remembered."""
    FLIPPED = "flipped"
    """Outside the gate and where the mirror image of the estimate is: left out."""
    MOVED = "moved"
    """The last of several outside the gate that agree: the estimate starts anew from it."""


class Verdict(NamedTuple):
    """What became of a measurement: accepted, how far off it was (Mahalanobis), what it was."""

    accepted: bool
    distance: float
    innovation: Innovation = Innovation.EXPECTED


class TargetEstimate(NamedTuple):
    """Goal pose in the reckoning's frame with its covariance, and the rejected in a row.

    ``candidate`` is the latest rejected measurement (frame of the reckoning): enough of them
    that agree with one another replace the estimate, so a target that was moved is found again.
    ``flipped`` counts the mirrored ones since the estimate began, which are no candidates. With
    ``accepted`` 0 the pose is a guess, and the next measurement replaces it. ``blind`` is the
    time [s], the way [m] and the turning [rad] since the last accepted measurement.
    """

    goal: Pose2
    covariance: Covariance
    stamp: float
    accepted: int
    rejected: int = 0
    candidate: Pose2 | None = None
    flipped: int = 0
    blind: tuple[float, float, float] = (0.0, 0.0, 0.0)


def grown(
    estimate: TargetEstimate, body: Twist, duration: float, model: NoiseModel, at: Pose2
) -> TargetEstimate:
    r"""The estimate after the robot moved for ``duration``: slip makes it less certain.

    The uncertainty enters at the robot (``at``), so a wrong turn moves a far goal sideways. What
    errs is a wheel's radius or a gyro's bias, the same from tick to tick: since the last look at
    the target a standard deviation grows in proportion to the way :math:`s`, whatever the
    period, by :math:`\sigma^2((s + \Delta s)^2 - s^2)` in variance.
    """
    travelled, turned = abs(body[0]) * duration, abs(body[1]) * duration
    if not duration > 0.0:
        return estimate
    time, way, angle = estimate.blind
    c, s = math.cos(at[2]), math.sin(at[2])
    farther = travelled * (travelled + 2.0 * way)
    along, across = model.along**2 * farther, model.across**2 * farther
    turn = model.turn**2 * turned * (turned + 2.0 * angle)
    turn += model.drift**2 * duration * (duration + 2.0 * time)
    lever_x, lever_y = -(estimate.goal[1] - at[1]), estimate.goal[0] - at[0]
    p = estimate.covariance
    xx = p[0][0] + c * c * along + s * s * across + lever_x * lever_x * turn
    xy = p[0][1] + c * s * (along - across) + lever_x * lever_y * turn
    yy = p[1][1] + s * s * along + c * c * across + lever_y * lever_y * turn
    xt, yt = p[0][2] + lever_x * turn, p[1][2] + lever_y * turn
    covariance = ((xx, xy, xt), (xy, yy, yt), (xt, yt, p[2][2] + turn))
    blind = (time + duration, way + travelled, angle + turned)
    return estimate._replace(covariance=covariance, blind=blind)


def _as_covariance(matrix: NDArray[np.float64]) -> Covariance:
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = matrix.tolist()
    return ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))


def is_covariance(values: Covariance) -> bool:
    """Whether ``values`` are a 3 by 3 covariance: finite, symmetric, no negative variance.

    All zeros, which some drivers send for "unknown", are not.
    """
    try:
        (xx, xy, xt), (yx, yy, yt), (tx, ty, tt) = [[float(x) for x in row] for row in values]
    except (TypeError, ValueError):
        return False
    entries = (xx, xy, xt, yx, yy, yt, tx, ty, tt)
    largest = max(map(abs, entries))
    if not (is_finite(entries) and largest > 0.0):
        return False
    a, b, c = xx / largest, yy / largest, tt / largest
    for upper, lower in ((xy, yx), (xt, tx), (yt, ty)):
        if not abs(upper - lower) <= 1e-6 * abs(lower) + _INDEFINITE * largest:
            return False
    d, e, f = (0.5 * (u / largest + v / largest) for u, v in ((xy, yx), (xt, tx), (yt, ty)))
    # The pivots of the elimination are positive where the eigenvalues are.
    first = a + _INDEFINITE
    if not first > 0.0:
        return False
    second = b + _INDEFINITE - d * d / first
    if not second > 0.0:
        return False
    beside = f - d * e / first
    return c + _INDEFINITE - e * e / first - beside * beside / second >= 0.0


def spread(covariance: Covariance, theta: float) -> tuple[float, float, float]:
    """Standard deviations along and across the direction ``theta`` [m], and of the heading."""
    c, s = math.cos(theta), math.sin(theta)
    (xx, xy, _), (_, yy, _), (_, _, tt) = covariance
    along = c * c * xx + 2.0 * c * s * xy + s * s * yy
    across = s * s * xx - 2.0 * c * s * xy + c * c * yy
    return math.sqrt(max(along, 0.0)), math.sqrt(max(across, 0.0)), math.sqrt(max(tt, 0.0))


def mirrored(goal: Pose2, ahead: Point, eye: Point) -> Pose2:
    r"""The other pose that a nearly planar target seen from ``eye`` is easily taken for.

    Without much perspective the image of a plane does not tell on which side of the line of
    sight its normal lies [Schweighofer2006]_: with :math:`\alpha` the direction of that line,
    heading :math:`\theta` looks like :math:`2\alpha - \theta`. The target's centre stays where
    it is, the goal ahead of it swings around.

    Parameters
    ----------
    goal : goal pose; its heading is the target's normal
    ahead : the target's centre in the goal's frame [m]
    eye : the camera's centre, in the frame of ``goal`` [m]
    """
    x, y = goal.transform(ahead)
    heading = wrap_angle(2.0 * math.atan2(y - eye[1], x - eye[0]) - goal[2])
    back = Pose2(0.0, 0.0, heading).transform(ahead)
    return Pose2(x - back[0], y - back[1], heading)


def is_from_behind(observation: Observation, eye: Point) -> bool:
    """Whether the target shows its back to a camera at ``eye`` in the robot frame.

    No target is measured from there, so its normal is wrong by half a turn.
    """
    goal = observation.goal
    return goal.seen(eye)[0] >= goal.seen(observation.feature)[0]


def _difference(a: Pose2, b: Pose2) -> NDArray[np.float64]:
    return np.array([a[0] - b[0], a[1] - b[1], wrap_angle(a[2] - b[2])])


def measured(
    estimate: TargetEstimate | None,
    observation: Observation,
    captured_from: Pose2,
    model: NoiseModel,
    eye: Point = (0.0, 0.0),
) -> tuple[TargetEstimate, Verdict]:
    """Kalman update with a measurement taken from the reckoned pose ``captured_from``.

    A measurement outside the gate is left out and remembered; when ``model.rejections`` of
    them in a row agree with one another (gated in the same way), the estimate starts anew
    from the last. One near the estimate's mirror image is left out and counted: while the
    estimate rests on fewer than ``model.settled`` measurements, the majority decides which of
    the two it is. A target that was truly turned into its own mirror image is not believed.

    Parameters
    ----------
    eye : the camera's centre in the robot frame [m]
    """
    z = captured_from.compose(observation.goal)
    c, s = math.cos(captured_from[2]), math.sin(captured_from[2])
    if observation.covariance is None:
        noise = np.diag([model.sigma_xy**2, model.sigma_xy**2, model.sigma_theta**2])
    else:
        noise = np.array(observation.covariance) + _FLOOR * np.eye(3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    noise = turn @ noise @ turn.T
    if estimate is None or not estimate.accepted:
        fresh = TargetEstimate(z, _as_covariance(noise), observation.stamp, 1)
        return fresh, Verdict(True, 0.0, Innovation.FIRST)
    prior = np.array(estimate.covariance)
    innovation = _difference(z, estimate.goal)
    total = prior + noise
    distance = _distance(innovation, total)
    if not distance <= model.gate:
        ahead = observation.goal.seen(observation.feature)
        if _is_flipped(z, estimate.goal, ahead, captured_from.transform(eye), total, model.gate):
            return _flipped(estimate, z, noise, observation.stamp, distance, model)
        return _rejected(estimate, z, noise, observation.stamp, distance, model)
    gain = np.linalg.solve(total, prior).T
    correction = gain @ innovation
    goal = Pose2(
        estimate.goal[0] + float(correction[0]),
        estimate.goal[1] + float(correction[1]),
        wrap_angle(estimate.goal[2] + float(correction[2])),
    )
    keep = np.eye(3) - gain
    posterior = keep @ prior @ keep.T + gain @ noise @ gain.T  # Joseph form: stays symmetric
    fused = TargetEstimate(
        goal, _as_covariance(posterior), observation.stamp, estimate.accepted + 1,
        flipped=estimate.flipped,
    )  # fmt: skip
    return fused, Verdict(True, distance)


def _distance(difference: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Mahalanobis distance."""
    squared = float(difference @ np.linalg.solve(covariance, difference))
    return math.sqrt(max(squared, 0.0))


def _is_flipped(
    z: Pose2, goal: Pose2, ahead: Point, eye: Point, total: NDArray[np.float64], gate: float
) -> bool:
    """Whether the centre is where it should be, and the heading near the mirrored one."""
    turned = abs(wrap_angle(z[2] - mirrored(goal, ahead, eye)[2]))
    if turned > min(_FLIP_GATE * gate * math.sqrt(total[2, 2]), abs(wrap_angle(z[2] - goal[2]))):
        return False
    expected, seen = goal.transform(ahead), z.transform(ahead)
    lever = expected[0] - goal[0], expected[1] - goal[1]
    at_centre = np.array([[1.0, 0.0, -lever[1]], [0.0, 1.0, lever[0]]])
    apart = np.array([seen[0] - expected[0], seen[1] - expected[1]])
    return _distance(apart, at_centre @ total @ at_centre.T) <= gate


def _flipped(
    estimate: TargetEstimate,
    z: Pose2,
    noise: NDArray[np.float64],
    stamp: float,
    distance: float,
    model: NoiseModel,
) -> tuple[TargetEstimate, Verdict]:
    """A mirrored measurement: left out, unless it is the estimate that is the mirror image."""
    flipped = estimate.flipped + 1
    if flipped > estimate.accepted and estimate.accepted < model.settled:
        other = TargetEstimate(z, _as_covariance(noise), stamp, flipped, flipped=estimate.accepted)
        return other, Verdict(True, distance, Innovation.MOVED)
    return estimate._replace(flipped=flipped), Verdict(False, distance, Innovation.FLIPPED)


def _rejected(
    estimate: TargetEstimate,
    z: Pose2,
    noise: NDArray[np.float64],
    stamp: float,
    distance: float,
    model: NoiseModel,
) -> tuple[TargetEstimate, Verdict]:
    agrees = 1
    if estimate.candidate is not None:
        apart = _difference(z, estimate.candidate)
        squared = float(apart @ np.linalg.solve(2.0 * noise, apart))
        agrees = estimate.rejected + 1 if squared <= model.gate**2 else 1
    if agrees >= model.rejections:
        fresh = TargetEstimate(z, _as_covariance(noise), stamp, 1)
        return fresh, Verdict(True, distance, Innovation.MOVED)
    left_out = estimate._replace(rejected=agrees, candidate=z)
    return left_out, Verdict(False, distance, Innovation.OUTLIER)
