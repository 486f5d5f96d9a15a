r"""Where the target is now: dead reckoning of the accepted commands and a filter of its pose.

Nothing here reads odometry. The body is taken to follow the commands the chassis accepted
with a first-order lag, :math:`\tau\dot b = u - b`, and to move along the exact arcs of its
mean twist. A measurement is placed at the pose of its own capture time, so latency costs
no accuracy beyond that of the commands in between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.scene import Covariance, Observation
from clfcbf.se2 import Pose2, Twist, arc, wrap_angle

__all__ = [
    "DeadReckoning",
    "NoiseModel",
    "TargetEstimate",
    "Verdict",
    "advance",
    "body_after",
    "coast",
    "grown",
    "is_covariance",
    "measured",
    "motion_since",
    "reckoned",
]

_FLOOR = 1e-14
"""[m², rad²] Variance added to any measurement, so that an exact one can be inverted."""

_new = tuple.__new__  # makes a named tuple in half the time of its own constructor


class DeadReckoning(NamedTuple):
    """Motion of the robot since it was switched on, from the commands it accepted.

    ``body`` is the modelled twist of the body at ``time``; ``past`` holds the instants
    before, oldest first, each with its pose and the mean twist held from there on. Before the
    first instant the robot is taken to have stood still.
    """

    time: float
    pose: Pose2
    body: Twist
    past: tuple[tuple[float, Pose2, Twist], ...] = ()


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
    ``memory`` [s] are forgotten, at most two at a time.
    """
    duration = now - reckoning.time
    if not duration > 0.0:
        return reckoning
    body, mean = body_after(reckoning.body, applied, duration, lag)
    step = (reckoning.time, reckoning.pose, mean)
    past = reckoning.past
    # The second oldest tells: what lies between it and the oldest may still be asked for.
    forget = 0
    while forget < 2 and len(past) > forget + 1 and past[forget + 1][0] < now - memory:
        forget += 1
    past = (*past[forget:], step)
    return _new(DeadReckoning, (now, reckoning.pose.moved(mean, duration), body, past))


def reckoned(reckoning: DeadReckoning, stamp: float) -> Pose2:
    """Pose at the time ``stamp``; the nearest one known outside the memory."""
    if stamp >= reckoning.time:
        return reckoning.pose
    for start, pose, mean in reversed(reckoning.past):
        if stamp >= start:
            return pose.moved(mean, stamp - start) if stamp > start else pose
    return reckoning.past[0][1] if reckoning.past else reckoning.pose


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


class Verdict(NamedTuple):
    """What became of a measurement: accepted, and how far off it was (Mahalanobis)."""

    accepted: bool
    distance: float


class TargetEstimate(NamedTuple):
    """Goal pose in the reckoning's frame with its covariance, and the rejected in a row.

    ``candidate`` is the latest rejected measurement (frame of the reckoning): enough of them
    that agree with one another replace the estimate, so a target that was moved is found again.
    """

    goal: Pose2
    covariance: Covariance
    stamp: float
    accepted: int
    rejected: int = 0
    candidate: Pose2 | None = None


def grown(
    estimate: TargetEstimate, body: Twist, duration: float, model: NoiseModel, at: Pose2
) -> TargetEstimate:
    """The estimate after the robot moved for ``duration``: slip makes it less certain.

    The uncertainty enters at the robot (``at``), so a wrong turn moves a far goal sideways.
    """
    travelled, turned = abs(body[0]) * duration, abs(body[1]) * duration
    if not duration > 0.0:
        return estimate
    c, s = math.cos(at[2]), math.sin(at[2])
    along = (model.along * travelled) ** 2
    across = (model.across * travelled) ** 2
    turn = (model.turn * turned) ** 2 + (model.drift * duration) ** 2
    lever_x, lever_y = -(estimate.goal[1] - at[1]), estimate.goal[0] - at[0]
    p = estimate.covariance
    xx = p[0][0] + c * c * along + s * s * across + lever_x * lever_x * turn
    xy = p[0][1] + c * s * (along - across) + lever_x * lever_y * turn
    yy = p[1][1] + s * s * along + c * c * across + lever_y * lever_y * turn
    xt, yt = p[0][2] + lever_x * turn, p[1][2] + lever_y * turn
    covariance = ((xx, xy, xt), (xy, yy, yt), (xt, yt, p[2][2] + turn))
    return estimate._replace(covariance=covariance)


def _as_covariance(matrix: NDArray[np.float64]) -> Covariance:
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = matrix.tolist()
    return ((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))


def is_covariance(values: Covariance) -> bool:
    """Whether ``values`` are a 3 by 3 covariance: finite, symmetric, no negative variance.

    All zeros, which some drivers send for "unknown", are not.
    """
    try:
        matrix = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        return False
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return False
    largest = float(np.abs(matrix).max())
    symmetric = bool(np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-9 * largest))
    least = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
    return largest > 0.0 and symmetric and least >= -1e-9 * largest


def _difference(a: Pose2, b: Pose2) -> NDArray[np.float64]:
    return np.array([a[0] - b[0], a[1] - b[1], wrap_angle(a[2] - b[2])])


def measured(
    estimate: TargetEstimate | None,
    observation: Observation,
    captured_from: Pose2,
    model: NoiseModel,
) -> tuple[TargetEstimate, Verdict]:
    """Kalman update with a measurement taken from the reckoned pose ``captured_from``.

    A measurement outside the gate is left out and remembered; when ``model.rejections`` of
    them in a row agree with one another (gated in the same way), the estimate starts anew
    from the last.
    """
    z = captured_from.compose(observation.goal)
    c, s = math.cos(captured_from[2]), math.sin(captured_from[2])
    if observation.covariance is None:
        noise = np.diag([model.sigma_xy**2, model.sigma_xy**2, model.sigma_theta**2])
    else:
        noise = np.array(observation.covariance) + _FLOOR * np.eye(3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    noise = turn @ noise @ turn.T
    if estimate is None:
        fresh = TargetEstimate(z, _as_covariance(noise), observation.stamp, 1)
        return fresh, Verdict(True, 0.0)
    prior = np.array(estimate.covariance)
    innovation = _difference(z, estimate.goal)
    total = prior + noise
    distance = math.sqrt(max(float(innovation @ np.linalg.solve(total, innovation)), 0.0))
    if not distance <= model.gate:
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
    return (
        TargetEstimate(goal, _as_covariance(posterior), observation.stamp, estimate.accepted + 1),
        Verdict(True, distance),
    )


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
        return TargetEstimate(z, _as_covariance(noise), stamp, 1), Verdict(True, distance)
    return estimate._replace(rejected=agrees, candidate=z), Verdict(False, distance)
