r"""Projection onto box and rows, and the least violation, for many two-input programs at once.

As :mod:`clfcbf.qp.projection` and :mod:`clfcbf.qp.relaxation` do for one; arrays as in
:mod:`clfcbf.qp.batch_geometry`.
"""

from __future__ import annotations

import numpy as np

from clfcbf.qp.batch_geometry import (
    DELICATE,
    EMPTY,
    FINE,
    NOISE,
    Array,
    Flags,
    Index,
    chord,
    excess,
    inside,
    lowest,
    scale_of,
)
from clfcbf.qp.batch_objective import Objectives

__all__ = ["least_violation", "project", "unit_rows"]


def project(
    objective: Objectives, box: Array, rows: Array
) -> tuple[Array, Array, Flags, Index]:
    """The points of least cost in box and rows.

    Returns
    -------
    v, w, verdict, and where that is EMPTY the index of the first row that left nothing
    """
    v, w = objective.minimum_in(box)
    verdict = np.zeros(v.shape, dtype=np.uint8)
    if not objective.diagonal:
        verdict[objective.untrusted(box)] = DELICATE
    failed = np.zeros(v.shape, dtype=np.intp)
    for count in range(rows.shape[0]):
        violated = excess(rows[count], v, w) > 0.0
        if count or not objective.diagonal:
            violated &= verdict == FINE
        at = np.flatnonzero(violated)
        if not at.size:
            continue
        some, part = objective.take(at), box.take(at, axis=1)
        before = rows[: count + 1].take(at, axis=2)
        line = before[count]
        ends = chord(part, line, before[:count], v.take(at), w.take(at))
        t, untrusted = some.minimum_on(line, ends)
        np.maximum(t, ends.lo, out=t)
        np.minimum(t, ends.hi, out=t)
        v[at], w[at] = inside(part, ends.x - line[1] * t, ends.y + line[0] * t)
        if untrusted is None:
            untrusted = some.untrusted(part)
        np.copyto(ends.verdict, DELICATE, where=untrusted)
        verdict[at] = ends.verdict
        if count:
            failed[at] = count
    return v, w, verdict, failed


def unit_rows(rows: Array) -> tuple[Array, Flags]:
    """Rows of unit length, zero rows never violated; DELICATE where a length is extreme."""
    length2 = rows[:, 0] * rows[:, 0] + rows[:, 1] * rows[:, 1]
    units = rows / np.sqrt(length2)[:, None]
    zero = (rows[:, 0] == 0.0) & (rows[:, 1] == 0.0)
    if zero.any():
        units[:, :2][np.repeat(zero[:, None], 2, axis=1)] = 0.0
        units[:, 2][zero] = np.inf
    extreme = ~zero & ~((length2 > 1e-300) & (length2 < 1e300))
    return units, np.where(extreme.any(axis=0), DELICATE, FINE)


def least_violation(
    box: Array, rows: Array, taken: Array
) -> tuple[Array, Array, Array, Flags]:
    r"""Where in box and ``taken`` the largest :math:`(a_i^\top u - b_i)/|a_i|` is least.

    Incremental: the point for the rows so far stands while the next row is not the largest
    there; otherwise the new point lies where that row is [Seidel1991]_. The point is one
    corner; where a whole side would do the verdict is DELICATE.

    Returns
    -------
    v, w, the violation, verdict
    """
    units, extreme = unit_rows(rows)
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
        within = np.concatenate((taken.take(at, axis=2), part[:count] - part[count]))
        v[at], w[at], verdict[at] = lowest(box.take(at, axis=1), part[count], within)
        value[at] = excess(part[count], v[at], w[at])
    verdict[~(value > noise)] = DELICATE
    return v, w, value, np.maximum(verdict, extreme)
