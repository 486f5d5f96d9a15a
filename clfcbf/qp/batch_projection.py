r"""Projection onto box and rows, and the least violation, for many two-input programs at once.

As :mod:`clfcbf.qp.projection` and :mod:`clfcbf.qp.relaxation` do for one; arrays as in
:mod:`clfcbf.qp.batch_geometry`.
"""

from __future__ import annotations

import numpy as np

from clfcbf.qp.batch_chord import chord, lowest
from clfcbf.qp.batch_geometry import (
    DELICATE,
    EMPTY,
    FINE,
    NOISE,
    Array,
    Flags,
    Index,
    excess,
    extreme,
    inside,
    lowest_corner,
    scale_of,
    size_of,
)
from clfcbf.qp.batch_objective import Objectives
from clfcbf.qp.polygon import TRUSTED

__all__ = ["least_violation", "project", "unit_rows"]


def project(objective: Objectives, box: Array, rows: Array) -> tuple[Array, Array, Flags, Index]:
    """The points of least cost in box and rows.

    Returns
    -------
    v, w, verdict, and where that is EMPTY the index of the first row that left nothing
    """
    v, w = objective.minimum_in(box)
    verdict = np.zeros(v.shape, dtype=np.uint8)
    failed = np.zeros(v.shape, dtype=np.intp)
    scale = scale_of(box)
    touch = NOISE * scale
    if not objective.diagonal:
        verdict[objective.untrusted(scale)] = DELICATE
    for count, row in enumerate(rows):
        over = excess(row, v, w)
        margin = size_of(row)
        margin *= touch
        violated = over > 0.0
        over += margin
        touched = over > 0.0
        touched ^= violated
        if touched.any():
            # On a line to rounding: whether another one meets it in a wedge, the exact path asks.
            verdict[touched] = DELICATE
        violated &= verdict == FINE
        if not (at := np.flatnonzero(violated)).size:
            continue
        part, line = box.take(at, axis=1), row.take(at, axis=1)
        hopeless = excess(line, *lowest_corner(part, line)) > margin.take(at)
        if hopeless.any():
            gone, left = np.flatnonzero(hopeless), np.flatnonzero(~hopeless)
            verdict[at[gone]], failed[at[gone]] = EMPTY, count
            at, part, line = at[left], part.take(left, axis=1), line.take(left, axis=1)
            if not left.size:
                continue
        some, taken, size = objective.take(at), rows[:count].take(at, axis=2), scale.take(at)
        ends = chord(part, line, taken, v.take(at), w.take(at), size)
        t, untrusted = some.minimum_on(line, ends)
        np.maximum(t, ends.lo, out=t)
        np.minimum(t, ends.hi, out=t)
        v[at], w[at] = inside(part, ends.x - line[1] * t, ends.y + line[0] * t)
        if untrusted is None:
            untrusted = some.untrusted(size)
        np.copyto(ends.verdict, DELICATE, where=untrusted)
        verdict[at], failed[at] = ends.verdict, count
    return v, w, verdict, failed


def unit_rows(rows: Array) -> tuple[Array, Flags]:
    """Rows of unit length, zero rows never violated; DELICATE where a length is extreme."""
    length2 = rows[:, 0] * rows[:, 0] + rows[:, 1] * rows[:, 1]
    units = rows / np.sqrt(length2)[:, None]
    delicate = extreme(length2)
    if delicate.any():
        zero = (rows[:, 0] == 0.0) & (rows[:, 1] == 0.0)
        units.transpose(0, 2, 1)[zero] = 0.0, 0.0, np.inf
        delicate &= ~zero
    return units, np.where(delicate.any(axis=0), DELICATE, FINE)


def least_violation(box: Array, rows: Array, taken: Array) -> tuple[Array, Array, Array, Flags]:
    r"""Where in box and ``taken`` the largest :math:`(a_i^\top u - b_i)/|a_i|` is least.

    Incremental: the point for the rows so far stands while the next row is not the largest
    there; otherwise the new point lies where that row is [Seidel1991]_. The point is one
    corner; where a whole side would do the verdict is DELICATE.

    Returns
    -------
    v, w, the violation, verdict
    """
    units, lengths = unit_rows(rows)
    v, w, verdict = lowest(box, units[0], taken)
    value = excess(units[0], v, w)
    noise = NOISE * scale_of(box)
    for count in range(1, rows.shape[0]):
        over = excess(units[count], v, w) - value
        verdict[np.abs(over) <= noise + NOISE * np.abs(value)] = DELICATE
        at = np.flatnonzero((over > 0.0) & (verdict == FINE))
        if not at.size:
            continue
        part = units[: count + 1].take(at, axis=2)
        below = part[:count] - part[count]
        within = np.concatenate((taken.take(at, axis=2), below))
        v[at], w[at], verdict[at] = lowest(box.take(at, axis=1), part[count], within)
        # Of nearly parallel rows the difference has lost digits that it needs.
        alike = np.abs(below[:, :2]).sum(axis=1).min(axis=0) * TRUSTED < 1.0
        verdict[at[alike]] = DELICATE
        value[at] = excess(part[count], v[at], w[at])
    verdict[~(value > noise)] = DELICATE
    return v, w, value, np.maximum(verdict, lengths)
