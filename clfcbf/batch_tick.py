"""One tick of the safety filter on arrays, one column a robot: see :mod:`clfcbf.batch`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clfcbf.batch_guard import BRAKED, REPLACED, ArrayGuard, Brakes, clipped
from clfcbf.constraints.cbf import Edge
from clfcbf.decision import Status
from clfcbf.limits import Limits
from clfcbf.qp.batch import BatchStatus, solve_chunk
from clfcbf.qp.batch_chunks import Chunk
from clfcbf.qp.batch_geometry import Array, Flags, Mask, excess
from clfcbf.qp.batch_objective import Objectives
from clfcbf.qp.lexicographic import Weight
from clfcbf.tick import TOLERANCE

__all__ = ["STATUSES", "BatchConfig", "Ticked", "tick"]

STATUSES = tuple(Status)
"""What the codes of a batch stand for: ``STATUSES[code]``."""

_CODE = {status: np.uint8(code) for code, status in enumerate(STATUSES)}


class BatchConfig(NamedTuple):
    """What is common to all robots."""

    guard: ArrayGuard
    edges: tuple[Edge, ...]
    gain: float
    weight: Weight


class Ticked(NamedTuple):
    """Columns of a :class:`BatchDecision`."""

    twist: Array
    brakes: Brakes
    status: Flags
    certified: Mask
    clearance: Array
    slack: Array


@np.errstate(all="ignore")  # columns with a fault are computed in vain and replaced at the end
def tick(
    config: BatchConfig,
    nominal: Array,
    feature: Array,
    applied: Array,
    sent: Array,
    brakes: Brakes,
) -> Ticked:
    """One tick of robots, a column each.

    Parameters
    ----------
    nominal, applied, sent : commands wanted, in force, and last sent, shape (2, n)
    feature : (x, y) or (x, y, theta) of the viewed features, shape (2, n) or (3, n)
    brakes : as the last tick left them
    """
    guard = config.guard
    unknown = ~_finite(applied)
    body = np.where(unknown, sent, applied)
    fault = unknown | ~_finite(nominal) | ~_finite(feature)
    box = _input_boxes(guard.limits, body, guard.period)
    points = _points(feature, guard.camera.width)
    rows = _rows(config, points)
    program = Chunk.of(
        slice(0, len(sent[0])), Objectives(config.weight, nominal), box, rows, len(rows)
    )
    answer = solve_chunk(program)
    wanted = clipped(box, np.stack((answer.v, answer.w)))
    outcome = guard.filter(wanted, points, body, box, brakes)
    slack = answer.slacks[0]
    codes = (Status.OPTIMAL, Status.BARRIER_RELAXED, Status.GUARDED, Status.BRAKING)
    code = np.where(slack > TOLERANCE, 1, 0)
    code[outcome.verdict == REPLACED] = 2
    code[outcome.verdict == BRAKED] = 3
    status = np.array([_CODE[each] for each in codes]).take(code)
    status[outcome.clearance < 0.0] = _CODE[Status.OUT_OF_VIEW]
    ticked = Ticked(
        outcome.twist, outcome.brakes, status, outcome.certified, outcome.clearance, slack
    )
    failed = (answer.status == BatchStatus.INVALID) | ~_verified(rows, wanted, slack)
    stopped = fault | failed
    if stopped.any():
        _stop(guard, box, brakes, stopped, ticked)
        status[failed] = _CODE[Status.SOLVER_FAILED]
        status[fault] = _CODE[Status.INVALID_INPUT]
    return ticked


def _stop(guard: ArrayGuard, box: Array, brakes: Brakes, stopped: Mask, ticked: Ticked) -> None:
    """Put the certified brake, inside the input box, in the columns ``stopped``."""
    at = np.flatnonzero(stopped)
    last = Brakes(brakes.twist[:, at], brakes.ticks[at], brakes.verified[at]).next()
    twist = clipped(box[:, at], last.twist)
    kept = guard.kept(box[:, at], last, twist)
    ticked.twist[:, at], ticked.certified[at] = twist, kept.verified
    ticked.brakes.twist[:, at], ticked.brakes.ticks[at] = kept.twist, kept.ticks
    ticked.brakes.verified[at] = kept.verified
    ticked.clearance[at], ticked.slack[at] = np.nan, 0.0


def _finite(columns: Array) -> Mask:
    """Which columns are finite: only then their sum less itself is 0."""
    total = np.add.reduce(columns, axis=0)
    finite: Mask = total - total == 0.0
    return finite


def _input_boxes(limits: Limits, applied: Array, period: float) -> Array:
    """As :meth:`clfcbf.limits.Limits.input_box`."""
    v, w = applied
    dv, dw = limits.a_max * period, limits.alpha_max * period
    return np.stack(
        (
            np.minimum(np.maximum(v - dv, limits.reverse_speed), v + dv),
            np.maximum(np.minimum(v + dv, limits.v_max), v - dv),
            np.minimum(np.maximum(w - dw, -limits.omega_max), w + dw),
            np.maximum(np.minimum(w + dw, limits.omega_max), w - dw),
        )
    )


def _points(feature: Array, width: float) -> Array:
    """Points to be kept in view: centres, or left and right ends, shape (p, 2, n)."""
    centre = feature[None, :2]
    if not width > 0.0:
        return centre
    theta = feature[2]
    half = 0.5 * width * np.stack((-np.sin(theta), np.cos(theta)))
    return np.concatenate((centre + half, centre - half))


def _rows(config: BatchConfig, points: Array) -> Array:
    """As :func:`clfcbf.constraints.cbf.half_plane_rows`, shape (2p, 3, n)."""
    rows = np.empty((2 * len(points), 3, points.shape[2]))
    for index, (x, y) in enumerate(points):
        for side, (n_x, n_y, offset) in enumerate(config.edges):
            row = rows[2 * index + side]
            row[0] = n_x
            row[1] = n_y * x - n_x * y
            row[2] = config.gain * (n_x * x + n_y * y - offset)
    return rows


def _verified(rows: Array, twist: Array, slack: Array) -> Mask:
    """Whether commands keep each row up to the slack, by our own arithmetic."""
    fine = np.ones(slack.shape, dtype=np.bool_)
    for row in rows:
        over = excess(row, *twist)
        at = np.flatnonzero(over > TOLERANCE)
        a, c, b = row[:, at]
        room = slack[at] * np.hypot(a, c) + TOLERANCE * (1.0 + np.abs(b))
        fine[at] &= (over[at] <= room) | ((a == 0.0) & (c == 0.0))
    return fine
