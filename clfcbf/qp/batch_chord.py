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
from clfcbf.qp.chord import SAME_ANGLE

__all__ = ["Chord", "chord", "lowest"]


class Chord(NamedTuple):
    """The part ``lo <= t <= hi`` of the line ``(x - c t, y + a t)``, and a verdict.

    ``length2`` is the squared length of the line's normal ``(a, c)``.
    """

    x: Array
    y: Array
    lo: Array
    hi: Array
    length2: Array
    verdict: Flags


def chord(
    box: Array, line: Array, taken: Iterable[Array], v: Array, w: Array, scale: Array
) -> Chord:
    """Where the line of a row runs inside the box and the rows ``taken``.

    ``(v, w)`` is a point of the box; t = 0 at its foot on the line. ``scale`` is that of the box.
    """
    a, c, _ = line
    squares = line[:2] * line[:2]
    length2 = squares[0] + squares[1]
    k = excess(line, v, w)
    k /= length2
    x, y = k * a, k * c
    np.subtract(v, x, out=x)
    np.subtract(w, y, out=y)
    verdict = np.zeros(x.shape, dtype=np.uint8)
    if (far := extreme(length2)).any():
        verdict[far] = DELICATE
    small = SMALL_ANGLE * length2
    level = np.minimum(*squares) <= small
    lo, hi, point = _box_ends(box, line, level, x, y, verdict)
    for row in taken:
        rate = a * row[1]
        rate -= c * row[0]
        t = excess(row, x, y)
        t /= -rate
        parallel = rate * rate <= small * (row[0] * row[0] + row[1] * row[1])
        if parallel.any():
            at = np.flatnonzero(parallel)
            near_by = box.take(at, axis=1), line.take(at, axis=1), row.take(at, axis=1)
            verdict[at] = np.maximum(verdict[at], _beside(*near_by, x[at], y[at]))
            rate[at], t[at] = 1.0, np.inf  # cuts off no end
        ahead = rate > 0.0
        np.minimum(hi, t, out=hi, where=ahead)
        np.maximum(lo, t, out=lo, where=~ahead)
    undecided = NOISE * scale
    width = hi - lo
    if (gone := width < 0.0).any():
        np.maximum(verdict, gone, out=verdict)
    width *= width
    width *= length2
    clear = width > undecided * undecided
    if not clear.all():
        verdict[~clear] = DELICATE
    if point is not None:
        # A box without width leaves one point of the line, if that is inside of all the rest.
        at = np.flatnonzero(point == point)
        only = point[at]
        room = np.minimum(only - lo[at], hi[at] - only) * np.sqrt(length2[at])
        margin = undecided[at]
        some = np.where(room > margin, FINE, np.where(room < -margin, EMPTY, DELICATE))
        verdict[at] = np.maximum(verdict[at], some)
        lo[at] = hi[at] = only
    return Chord(x, y, lo, hi, length2, verdict)


def _box_ends(
    box: Array, line: Array, level: Mask, x: Array, y: Array, verdict: Flags
) -> tuple[Array, Array, Array | None]:
    """Ends of the line in the box, updating ``verdict``; ``level`` lines run along a side of it.

    Where a box is a segment the ends are those of its long sides, and the third array says
    where the line crosses it, NaN elsewhere; None where no box is one.
    """
    a, c, _ = line
    ends = np.empty((2, 2, x.size))  # crossings of the v-sides, of the w-sides
    np.subtract(x, box[1::-1], out=ends[0])
    np.subtract(box[2:], y, out=ends[1])
    ends[0] /= c
    ends[1] /= a
    point: Array | None = None
    flat = box[0::2] == box[1::2]
    if flat.any():
        flat_v, flat_w = flat
        point = np.where(flat_v, ends[0, 0], np.where(flat_w, ends[1, 0], np.nan))
        for sides, narrow in zip(ends, flat, strict=True):
            sides[0, narrow], sides[1, narrow] = -np.inf, np.inf
        verdict[flat_v & flat_w] = DELICATE
    if level.any():
        at = np.flatnonzero(level)
        upright = np.abs(c[at]) < np.abs(a[at])
        some = _along_side(box.take(at, axis=1), line.take(at, axis=1), x[at], y[at], upright)
        verdict[at] = np.maximum(verdict[at], some)
        for sides, along in zip(ends, (at[upright], at[~upright]), strict=True):
            sides[0, along], sides[1, along] = -np.inf, np.inf
    lo = np.maximum.reduce(np.minimum.reduce(ends, axis=1), axis=0)
    hi = np.minimum.reduce(np.maximum.reduce(ends, axis=1), axis=0)
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
    same = (sine * sine <= SAME_ANGLE) & (a * d + c * g > 0.0)
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
    scale = scale_of(box)
    noise = NOISE * scale
    for count, other in enumerate(rows):
        over = excess(other, v, w)
        size = size_of(other)
        verdict[(np.abs(over) <= noise * size) & (size > 0.0)] = DELICATE
        at = np.flatnonzero((over > 0.0) & (verdict == FINE))
        if not at.size:
            continue
        part, before = box.take(at, axis=1), rows[: count + 1].take(at, axis=2)
        line = before[count]
        ends = chord(part, line, before[:count], v[at], w[at], scale[at])
        slope = c[at] * line[0] - a[at] * line[1]
        level = np.abs(slope) <= flat[at] * size[at]
        t = np.where(slope > 0.0, ends.lo, ends.hi)
        v[at], w[at] = inside(part, ends.x - line[1] * t, ends.y + line[0] * t)
        verdict[at] = np.where(level | (ends.verdict != FINE), DELICATE, FINE)
    return v, w, verdict
