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

__all__ = ["DELICATE", "EMPTY", "FINE", "NOISE", "SMALL_ANGLE", "Array", "Chord", "Flags"]
__all__ += ["Index", "chord", "excess", "inside", "lowest", "lowest_corner", "scale_of", "size_of"]

Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.uint8]
Index: TypeAlias = NDArray[np.intp]

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
        drift = _reach(box, at) * np.sqrt(np.minimum(aa, cc)[at] / length2[at]) + undecided[at]
        place = np.where(flat, x[at], y[at])
        low, high = np.where(flat, box[:2, at], box[2:, at])
        verdict[at] = np.maximum(verdict[at], _between(place, low, high, drift))
        lo[at[flat]], hi[at[flat]] = -np.inf, np.inf
        near[at[~flat]], far[at[~flat]] = -np.inf, np.inf
    lo, hi = np.minimum(lo, hi), np.maximum(lo, hi)
    np.maximum(lo, np.minimum(near, far), out=lo)
    np.minimum(hi, np.maximum(near, far), out=hi)
    for row in taken:
        d, g, _ = row
        rate = a * g - c * d
        gap = excess(row, x, y)
        other2 = d * d + g * g
        parallel = rate * rate <= small * other2
        t = -gap / rate
        if parallel.any():
            at = np.flatnonzero(parallel)
            lengths = np.sqrt(length2[at]), np.sqrt(other2[at])
            verdict[at] = np.maximum(
                verdict[at],
                _beside(
                    gap[at],
                    rate[at] / lengths[0],
                    lengths[1],
                    (_reach(box, at), undecided[at]),
                    (a[at] * d[at] + c[at] * g[at] > 0.0)
                    & (rate[at] * rate[at] <= _SAME_ANGLE * length2[at] * other2[at]),
                ),
            )
            rate[at], t[at] = 1.0, np.inf  # cuts off no end
        np.minimum(hi, np.where(rate > 0.0, t, np.inf), out=hi)
        np.maximum(lo, np.where(rate > 0.0, -np.inf, t), out=lo)
    width = hi - lo
    empty = width < 0.0
    np.maximum(verdict, empty, out=verdict)
    width *= width
    width *= length2
    np.copyto(verdict, DELICATE, where=~(width > undecided * undecided))
    return Chord(x, y, lo, hi, verdict)


def _reach(box: Array, at: Index) -> Array:
    """Twice the half perimeter: no chord of the box extends farther from a foot on it."""
    reach: Array = 2.0 * (box[1, at] - box[0, at] + box[3, at] - box[2, at])
    return reach


def _between(place: Array, low: Array, high: Array, drift: Array) -> Flags:
    """Verdict on a line along a side of the box, which it leaves by ``drift`` at most."""
    fine = (low + drift < place) & (place < high - drift)
    out = (place < low - drift) | (place > high + drift)
    return np.where(fine, FINE, np.where(out, EMPTY, DELICATE))


def _beside(
    gap: Array, rate: Array, other: Array, reach: tuple[Array, Array], same: NDArray[np.bool_]
) -> Flags:
    """Verdict on a row nearly parallel to the line: it holds, or fails, along all of it.

    ``gap`` is its excess at the foot, ``rate`` that per length; ``same`` marks a copy.
    """
    drift = np.abs(reach[0] * rate) + reach[1] * other
    held = (gap < -drift) | ((gap <= drift) & same) | (other == 0.0)
    return np.where(held, FINE, np.where(gap > drift, EMPTY, DELICATE))


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
