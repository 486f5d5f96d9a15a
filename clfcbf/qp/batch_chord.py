r"""The lines of rows inside boxes and rows, of many two-input programs at once.

The same incremental method as for one program [Seidel1991]_, and the same bounds under which
floats are trusted. A column for which they could not be is marked DELICATE and left to the exact
path; one without an admissible command is marked EMPTY. Arrays as in
:mod:`clfcbf.qp.batch_geometry`; columns whose result is not used may divide by zero: call under
``np.errstate``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from clfcbf.qp.batch_geometry import (
    DELICATE,
    EMPTY,
    FINE,
    NOISE,
    SMALL_ANGLE,
    Array,
    Flags,
    Mask,
    excess,
    extreme,
    inside,
    lowest_corner,
    scale_of,
    size_of,
)
from clfcbf.qp.polygon import PARALLEL

__all__ = ["Chord", "chord", "lowest"]

_SAME_ANGLE = 1.0 / PARALLEL**2


class Chord(NamedTuple):
    """The part ``lo <= t <= hi`` of the line ``(x - c t, y + a t)``, and a verdict."""

    x: Array
    y: Array
    lo: Array
    hi: Array
    verdict: Flags


def chord(box: Array, line: Array, taken: Iterable[Array], v: Array, w: Array) -> Chord:
    """Where the line of a row runs inside the box and the rows ``taken``.

    ``(v, w)`` is a point of the box; t = 0 at its foot on the line.
    """
    a, c, _ = line
    length2 = a * a + c * c
    k = excess(line, v, w)
    k /= length2
    x, y = v - k * a, w - k * c
    verdict = np.where(extreme(length2), DELICATE, FINE)
    lo, hi, point = _box_ends(box, line, length2, x, y, verdict)
    small = SMALL_ANGLE * length2
    for row in taken:
        rate = a * row[1] - c * row[0]
        t = excess(row, x, y)
        t /= -rate
        parallel = rate * rate <= small * (row[0] * row[0] + row[1] * row[1])
        if parallel.any():
            at = np.flatnonzero(parallel)
            near_by = box.take(at, axis=1), line.take(at, axis=1), row.take(at, axis=1)
            verdict[at] = np.maximum(verdict[at], _beside(*near_by, x[at], y[at]))
            rate[at], t[at] = 1.0, np.inf  # cuts off no end
        np.minimum(hi, np.where(rate > 0.0, t, np.inf), out=hi)
        np.maximum(lo, np.where(rate > 0.0, -np.inf, t), out=lo)
    undecided = NOISE * scale_of(box)
    width = hi - lo
    np.maximum(verdict, width < 0.0, out=verdict)
    width *= width
    width *= length2
    np.copyto(verdict, DELICATE, where=~(width > undecided * undecided))
    if point is not None:
        # A box without width leaves one point of the line, if that is inside of all the rest.
        at = np.flatnonzero(point == point)
        only = point[at]
        room = np.minimum(only - lo[at], hi[at] - only) * np.sqrt(length2[at])
        margin = undecided[at]
        some = np.where(room > margin, FINE, np.where(room < -margin, EMPTY, DELICATE))
        verdict[at] = np.maximum(verdict[at], some)
        lo[at] = hi[at] = only
    return Chord(x, y, lo, hi, verdict)


def _box_ends(
    box: Array, line: Array, length2: Array, x: Array, y: Array, verdict: Flags
) -> tuple[Array, Array, Array | None]:
    """Ends of the line in the box, updating ``verdict``.

    Where a box is a segment the ends are those of its long sides, and the third array says
    where the line crosses it, NaN elsewhere; None where no box is one.
    """
    a, c, _ = line
    lo, hi = (x - box[1]) / c, (x - box[0]) / c
    near, far = (box[2] - y) / a, (box[3] - y) / a
    point: Array | None = None
    flat_v, flat_w = box[0] == box[1], box[2] == box[3]
    flat = flat_v | flat_w
    if flat.any():
        point = np.where(flat, np.where(flat_v, lo, near), np.nan)
        lo[flat_v], hi[flat_v] = -np.inf, np.inf
        near[flat_w], far[flat_w] = -np.inf, np.inf
        verdict[flat_v & flat_w] = DELICATE
    along = np.minimum(np.abs(a), np.abs(c))
    along *= along
    level = along <= SMALL_ANGLE * length2
    if level.any():
        at = np.flatnonzero(level)
        upright = np.abs(c[at]) < np.abs(a[at])
        some = _along_side(box.take(at, axis=1), line.take(at, axis=1), x[at], y[at], upright)
        verdict[at] = np.maximum(verdict[at], some)
        lo[at[upright]], hi[at[upright]] = -np.inf, np.inf
        near[at[~upright]], far[at[~upright]] = -np.inf, np.inf
    lo, hi = np.minimum(lo, hi), np.maximum(lo, hi)
    np.maximum(lo, np.minimum(near, far), out=lo)
    np.minimum(hi, np.maximum(near, far), out=hi)
    return lo, hi, point


def _drift(box: Array, sine: Array) -> Array:
    """How far the line leaves its direction by ``sine`` anywhere in the box, and rounding."""
    reach: Array = 2.0 * (box[1] - box[0] + box[3] - box[2])
    return reach * np.abs(sine) + NOISE * scale_of(box)


def _along_side(box: Array, line: Array, x: Array, y: Array, upright: Mask) -> Flags:
    """Verdict on a line along the w-axis (``upright``) or the v-axis, to a small angle."""
    least = np.minimum(np.abs(line[0]), np.abs(line[1]))
    drift = _drift(box, least / np.hypot(line[0], line[1]))
    place = np.where(upright, x, y)
    low, high = np.where(upright, box[:2], box[2:])
    fine = (low + drift < place) & (place < high - drift)
    out = (place < low - drift) | (place > high + drift)
    return np.where(fine, FINE, np.where(out, EMPTY, DELICATE))


def _beside(box: Array, line: Array, row: Array, x: Array, y: Array) -> Flags:
    """Verdict on a row nearly parallel to the line: it holds, or fails, along all of it."""
    a, c, _ = line
    d, g, _ = row
    other2 = d * d + g * g
    other = np.sqrt(other2)
    sine = (a * g - c * d) / np.sqrt(a * a + c * c) / other  # its square would underflow
    drift = _drift(box, sine) * other
    same = (sine * sine <= _SAME_ANGLE) & (a * d + c * g > 0.0)
    gap = excess(row, x, y)
    held = (gap < -drift) | ((gap <= drift) & same)
    verdict = np.where(held, FINE, np.where(gap > drift, EMPTY, DELICATE))
    verdict[extreme(other2)] = DELICATE
    verdict[(d == 0.0) & (g == 0.0)] = FINE
    return verdict


def lowest(box: Array, row: Array, rows: Array) -> tuple[Array, Array, Flags]:
    r"""The corner of box and ``rows`` where :math:`a^\top u` is least, ``(a, ...) = row``.

    DELICATE where a whole side could be lowest, and where box and rows leave nothing.

    Returns
    -------
    v, w, verdict
    """
    a, c, _ = row
    v, w = lowest_corner(box, row)
    flat = NOISE * size_of(row)
    verdict = np.where(np.minimum(np.abs(a), np.abs(c)) > flat, FINE, DELICATE)
    noise = NOISE * scale_of(box)
    for count, other in enumerate(rows):
        over = excess(other, v, w)
        size = size_of(other)
        verdict[(np.abs(over) <= noise * size) & (size > 0.0)] = DELICATE
        at = np.flatnonzero((over > 0.0) & (verdict == FINE))
        if not at.size:
            continue
        part, before = box.take(at, axis=1), rows[: count + 1].take(at, axis=2)
        line = before[count]
        ends = chord(part, line, before[:count], v[at], w[at])
        slope = c[at] * line[0] - a[at] * line[1]
        level = np.abs(slope) <= flat[at] * size[at]
        t = np.where(slope > 0.0, ends.lo, ends.hi)
        v[at], w[at] = inside(part, ends.x - line[1] * t, ends.y + line[0] * t)
        verdict[at] = np.where(level | (ends.verdict != FINE), DELICATE, FINE)
    return v, w, verdict
