r"""Lines, boxes and half-planes of many two-input programs at once, one column a program.

The same incremental method as for one program [Seidel1991]_, and the same bounds under which
floats are trusted. A column for which they could not be is marked :data:`DELICATE` and left to
the exact path; one without an admissible command is marked :data:`EMPTY`.

Boxes are arrays of shape (4, n), a row is one of shape (3, n), rows are of shape (r, 3, n).
Columns whose result is not used may divide by zero: call under ``np.errstate``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.polygon import PARALLEL, TRUSTED
from clfcbf.qp.projection import NOISE

__all__ = [
    "DELICATE",
    "EMPTY",
    "FINE",
    "NOISE",
    "SMALL_ANGLE",
    "Array",
    "Chord",
    "Flags",
    "Index",
    "Mask",
    "chord",
    "excess",
    "inside",
    "lowest",
    "lowest_corner",
    "scale_of",
    "size_of",
]

Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.uint8]
Index: TypeAlias = NDArray[np.intp]
Mask: TypeAlias = NDArray[np.bool_]

FINE, EMPTY, DELICATE = np.uint8(0), np.uint8(1), np.uint8(2)
"""Verdict on a column; of two the larger one stands."""

SMALL_ANGLE = 1.0 / TRUSTED**2
"""Squared sine of the angle under which the crossing of two lines is not left to floats."""

_SAME_ANGLE = 1.0 / PARALLEL**2
_SHORTEST, _LONGEST = 1e-300, 1e300  # squared lengths between which rounding stays relative


class Chord(NamedTuple):
    """The part ``lo <= t <= hi`` of the line ``(x - c t, y + a t)``, and a verdict."""

    x: Array
    y: Array
    lo: Array
    hi: Array
    verdict: Flags


def scale_of(box: Array) -> Array:
    """A length that no coordinate of the box exceeds."""
    scale: Array = np.add.reduce(np.abs(box), axis=0)
    return scale


def size_of(row: Array) -> Array:
    """The sum of moduli of a row's normal."""
    size: Array = np.abs(row[0])
    size += np.abs(row[1])
    return size


def excess(row: Array, v: Array, w: Array) -> Array:
    """``a v + c w - b``, positive where the row is violated."""
    value: Array = row[0] * v
    value += row[1] * w
    value -= row[2]
    return value


def inside(box: Array, v: Array, w: Array) -> tuple[Array, Array]:
    """The point of the box nearest to ``(v, w)``, coordinate by coordinate."""
    v = np.maximum(v, box[0])
    w = np.maximum(w, box[2])
    return np.minimum(v, box[1], out=v), np.minimum(w, box[3], out=w)


def chord(box: Array, line: Array, taken: Iterable[Array], v: Array, w: Array) -> Chord:
    """Where the line of a row runs inside the box and the rows ``taken``.

    ``(v, w)`` is a point of the box; t = 0 at its foot on the line.
    """
    a, c, _ = line
    aa, cc = a * a, c * c
    length2 = aa + cc
    small = SMALL_ANGLE * length2
    k = excess(line, v, w)
    k /= length2
    x, y = v - k * a, w - k * c
    undecided = NOISE * scale_of(box)
    lo, hi = (x - box[1]) / c, (x - box[0]) / c
    near, far = (box[2] - y) / a, (box[3] - y) / a
    verdict = np.where((length2 > _SHORTEST) & (length2 < _LONGEST), FINE, DELICATE)
    across = np.minimum(aa, cc) <= small
    if across.any():
        at = np.flatnonzero(across)
        flat = cc[at] <= small[at]
        some = _along_side(box.take(at, axis=1), line.take(at, axis=1), x[at], y[at], flat)
        verdict[at] = np.maximum(verdict[at], some)
        lo[at[flat]], hi[at[flat]] = -np.inf, np.inf
        near[at[~flat]], far[at[~flat]] = -np.inf, np.inf
    lo, hi = np.minimum(lo, hi), np.maximum(lo, hi)
    np.maximum(lo, np.minimum(near, far), out=lo)
    np.minimum(hi, np.maximum(near, far), out=hi)
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
    width = hi - lo
    np.maximum(verdict, width < 0.0, out=verdict)
    width *= width
    width *= length2
    np.copyto(verdict, DELICATE, where=~(width > undecided * undecided))
    return Chord(x, y, lo, hi, verdict)


def _drift(box: Array, sine: Array) -> Array:
    """How far the line leaves its direction by ``sine`` anywhere in the box, and rounding."""
    reach: Array = 2.0 * (box[1] - box[0] + box[3] - box[2])
    return reach * np.abs(sine) + NOISE * scale_of(box)


def _along_side(box: Array, line: Array, x: Array, y: Array, flat: Mask) -> Flags:
    """Verdict on a line along the v-sides (``flat``) or the w-sides, to a small angle."""
    least = np.minimum(np.abs(line[0]), np.abs(line[1]))
    drift = _drift(box, least / np.hypot(line[0], line[1]))
    place = np.where(flat, x, y)
    low, high = np.where(flat, box[:2], box[2:])
    fine = (low + drift < place) & (place < high - drift)
    out = (place < low - drift) | (place > high + drift)
    return np.where(fine, FINE, np.where(out, EMPTY, DELICATE))


def _beside(box: Array, line: Array, row: Array, x: Array, y: Array) -> Flags:
    """Verdict on a row nearly parallel to the line: it holds, or fails, along all of it."""
    a, c, _ = line
    d, g, _ = row
    length2, other2, rate = a * a + c * c, d * d + g * g, a * g - c * d
    other = np.sqrt(other2)
    drift = _drift(box, rate / (other * np.sqrt(length2))) * other
    same = (rate * rate <= _SAME_ANGLE * length2 * other2) & (a * d + c * g > 0.0)
    gap = excess(row, x, y)
    held = (gap < -drift) | ((gap <= drift) & same)
    verdict = np.where(held, FINE, np.where(gap > drift, EMPTY, DELICATE))
    verdict[~((other2 > _SHORTEST) & (other2 < _LONGEST))] = DELICATE
    verdict[(d == 0.0) & (g == 0.0)] = FINE
    return verdict


def lowest_corner(box: Array, row: Array) -> tuple[Array, Array]:
    r"""The corner of the box where :math:`a^\top u` is least; one of them where that is a side."""
    return np.where(row[0] > 0.0, box[0], box[1]), np.where(row[1] > 0.0, box[2], box[3])


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
