r"""The safety filter of many robots at once, in NumPy.

One tick for each robot, as :class:`clfcbf.safety_filter.SafetyFilter` with one camera takes it:
input box, half-plane rows of the view, exact program, guard with the certified brake. For
simulation, training and sweeps; what a robot remembers goes in and comes out as arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf import defaults
from clfcbf.batch_guard import ArrayGuard, Brakes
from clfcbf.batch_tick import STATUSES, BatchConfig, tick
from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits, check_period
from clfcbf.qp.batch_chunks import CHUNK, slices
from clfcbf.qp.batch_geometry import Array, Flags, Mask
from clfcbf.qp.lexicographic import check_weight

__all__ = ["STATUSES", "BatchDecision", "BatchState", "filter_batch"]


class BatchState(NamedTuple):
    """What a tick leaves to the next, one row a robot.

    Attributes
    ----------
    brake : last certified command, shape (B, 2)
    ticks : ticks that its brake needs to rest, shape (B,)
    sent : command last sent, shape (B, 2)
    verified : whether that brake was found to keep the view, shape (B,)
    """

    brake: Array
    ticks: NDArray[np.int64]
    sent: Array
    verified: NDArray[np.bool_]

    @classmethod
    def at_rest(cls, count: int) -> BatchState:
        """The state of robots that have not moved yet."""
        return cls(
            np.zeros((count, 2)),
            np.zeros(count, dtype=np.int64),
            np.zeros((count, 2)),
            np.ones(count, dtype=np.bool_),
        )


class BatchDecision(NamedTuple):
    """The outcome of a tick, one row a robot; see :class:`clfcbf.decision.Decision`.

    Attributes
    ----------
    twist : commands (v, omega) [m/s], [rad/s], shape (B, 2)
    status : positions in :data:`STATUSES`, shape (B,)
    certified : a brake that keeps the view is at hand, shape (B,)
    clearance : angle to the nearer edge less the margin [rad], NaN after a fault, shape (B,)
    slack : by how much the rows of the view gave way, shape (B,)
    state : for the next tick
    """

    twist: Array
    status: Flags
    certified: Mask
    clearance: Array
    slack: Array
    state: BatchState


def filter_batch(
    limits: Limits,
    camera: FieldOfView,
    gain: float,
    margin: float,
    nominal: ArrayLike,
    features: ArrayLike,
    applied: ArrayLike,
    period: float,
    weight: tuple[float, float, float] = defaults.QP_WEIGHT,
    *,
    state: BatchState | None = None,
    setback: float = 0.0,
    guard_lag: float = defaults.GUARD_LAG,
    chunk: int = CHUNK,
) -> BatchDecision:
    r"""The safe commands closest to the nominal ones, one tick of many robots.

    Equal to :class:`clfcbf.safety_filter.SafetyFilter` with the barrier
    ``FieldOfViewBarrier(camera, gain, margin, setback=setback)``, ``lag=0`` and scenes as fresh
    as the tick, robot by robot, to 1e-12.

    Parameters
    ----------
    limits : of every chassis
    camera : of every robot
    gain : class-K gain of the rows :math:`\lambda` [1/s]
    margin : taken off the half angle [rad]
    nominal : what the controllers want (v, omega) [m/s], [rad/s], shape (B, 2)
    features : viewed features in the robots' frames now, (x, y) [m], shape (B, 2), or
        (x, y, theta), shape (B, 3), which a camera with a ``width`` needs
    applied : commands the chassis last accepted, shape (B, 2)
    period : of the control loop [s]
    weight : ``(q11, q12, q22)`` of the distance to the nominal command
    state : what the tick before left; None at rest
    setback : by which the edges are moved inward [m]
    guard_lag : longest lag of the body that the guard covers [s]
    chunk : robots worked on at a time; changes the speed only

    Returns
    -------
    BatchDecision. A robot with a number that is not finite brakes on what was known before,
    its status INVALID_INPUT.

    Raises
    ------
    ConfigurationError : a parameter is out of range, or an array has another shape
    """
    barrier = FieldOfViewBarrier(camera, gain, margin, setback=setback)  # checks all of them
    if not 0.0 <= guard_lag < 10.0:
        raise ConfigurationError(f"guard_lag must be in [0, 10) s, got {guard_lag!r}")
    guard = ArrayGuard(limits, check_period(period), barrier.kept, camera, guard_lag)
    wants = _shaped("nominal", nominal, None, (2,))
    count = len(wants)
    seen = _shaped("features", features, count, (3,) if camera.width > 0.0 else (2, 3))
    moves = _shaped("applied", applied, count, (2,))
    before = BatchState.at_rest(count) if state is None else state
    for name, array, shape in zip(
        before._fields, before, ((count, 2), (count,), (count, 2), (count,)), strict=True
    ):
        if np.shape(array) != shape:
            raise ConfigurationError(f"state.{name} must have shape {shape}, got {array.shape}")
    after = BatchDecision(
        np.empty((count, 2)),
        np.empty(count, dtype=np.uint8),
        np.empty(count, dtype=np.bool_),
        np.empty(count),
        np.empty(count),
        BatchState.at_rest(count),
    )
    config = BatchConfig(guard, barrier.edges, gain, check_weight(weight))
    for here in slices(count, chunk):
        nominal_t, feature_t, applied_t, sent_t, brake_t = (
            np.ascontiguousarray(rows[here].T)
            for rows in (wants, seen, moves, before.sent, before.brake)
        )
        ticks = before.ticks[here].astype(np.float64)
        brakes = Brakes(brake_t, ticks, before.verified[here].copy())
        ticked = tick(config, nominal_t, feature_t, applied_t, sent_t, brakes)
        after.twist[here] = after.state.sent[here] = ticked.twist.T
        after.status[here], after.certified[here] = ticked.status, ticked.certified
        after.clearance[here], after.slack[here] = ticked.clearance, ticked.slack
        after.state.brake[here] = ticked.brakes.twist.T
        after.state.ticks[here] = ticked.brakes.ticks
        after.state.verified[here] = ticked.brakes.verified
    return after


def _shaped(name: str, value: ArrayLike, count: int | None, widths: tuple[int, ...]) -> Array:
    """``value`` as an array of shape (count, one of the widths)."""
    array = np.asarray(value, dtype=np.float64)
    rows = "B" if count is None else str(count)
    if array.ndim != 2 or array.shape[1] not in widths or count not in (None, len(array)):
        wanted = " or ".join(f"({rows}, {width})" for width in widths)
        raise ConfigurationError(f"{name} must have shape {wanted}, got {array.shape}")
    return array
