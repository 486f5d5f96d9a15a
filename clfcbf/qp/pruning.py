r"""Programs of many rows: those that cannot bind in the tick's box have no say, and cost nothing.

A row holds in the whole box if it holds at the corner where it is largest,

.. math:: \max_{u \in \text{box}} a^\top u
          = \max(a_v v_{lo}, a_v v_{hi}) + \max(a_w \omega_{lo}, a_w \omega_{hi}) \le b.

Limits on acceleration make that box small, and most obstacles' rows hold in all of it. Of what is
left at most a few rows decide: they are found by adding the one that is violated most at the
answer without it, until none is [Kelley1960]_. An answer to some of the rows at which the others
hold too is the answer to all of them, so nothing is approximate here.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.chord import NOISE, box_scale
from clfcbf.qp.lexicographic import (
    Box,
    Level,
    LexicographicSolution,
    Row,
    Weight,
    solve_lexicographic,
)

__all__ = ["MANY", "prune", "solve_many"]

MANY = 60
"""Rows up to which the plain loop over all of them is as fast as a pass in NumPy (measured)."""

_FEW = 100
"""Rows up to which the loop is as fast as looking for those that decide (measured)."""

_STEPS = 40
"""Rows added before the loop over all of them is taken after all: ten times what is usual."""

_TAME = 1e100
"""Numbers up to this have residuals that cannot overflow."""

_ROUNDING = 2.0**-49
"""Share of the terms of a residual that is rounding."""

Array = NDArray[np.float64]


def prune(box: Box, rows: Sequence[Row] | Array) -> list[Row]:
    """The rows that do not hold in the whole box with room for rounding, in their order.

    Parameters
    ----------
    box : ``(v_lo, v_hi, w_lo, w_hi)``, finite
    rows : rows ``(a_v, a_w, b)`` that say ``a_v v + a_w omega <= b``, or an array of them, shape
        (m, 3), which is faster, best with contiguous columns; a row that is not finite is kept
    """
    v_lo, v_hi, w_lo, w_hi = box
    noise = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    if isinstance(rows, np.ndarray) or len(rows) > MANY:
        columns = _columns(rows)
        return _tuples(columns.compress(_may_bind(box, columns), axis=1))
    kept = []
    for row in rows:
        a, c, b = row
        most = a * (v_hi if a > 0.0 else v_lo) + c * (w_hi if c > 0.0 else w_lo)
        if not most < b - noise * (abs(a) + abs(c)) < math.inf:
            kept.append(row)
    return kept


def solve_many(
    weight: Weight, nominal: tuple[float, float], box: Box, levels: Sequence[Level | Array]
) -> LexicographicSolution | None:
    """As :func:`clfcbf.qp.exact.solve_lexicographic`, in less time where the rows are many.

    Parameters
    ----------
    weight, nominal, box : see there
    levels : see there; a level may also be an array, shape (m, 3)
    """
    blocks = [_columns(rows) for rows in levels]
    numbers = [abs(number) for number in (*nominal, *box)]
    numbers += [float(np.abs(block).max(initial=0.0)) for block in blocks]
    if not all(number <= _TAME for number in numbers) or box[0] > box[1] or box[2] > box[3]:
        return solve_lexicographic(weight, nominal, box, [_tuples(block) for block in blocks])
    kept, violated, index = [], [], 0
    for block in blocks:
        binding = _may_bind(box, block)
        blank = block[0] == 0.0
        if blank.any():
            blank &= block[1] == 0.0
            binding &= ~blank
            violated += [index + i for i in np.flatnonzero(blank & (block[2] < 0.0)).tolist()]
        kept.append(block.compress(binding, axis=1))
        index += block.shape[1]
    answer = None
    if sum(block.shape[1] for block in kept) > _FEW:
        answer = _by_the_most_violated(weight, nominal, box, kept)
    if answer is None:
        answer = solve_lexicographic(weight, nominal, box, [_tuples(block) for block in kept])
    if answer is None or not violated:
        return answer
    return answer._replace(violated=tuple(violated))


def _by_the_most_violated(
    weight: Weight, nominal: tuple[float, float], box: Box, blocks: Sequence[Array]
) -> LexicographicSolution | None:
    """The answer from the rows that decide; None where there are too many of them."""
    columns = np.concatenate(blocks, axis=1)
    ends = list(itertools.accumulate(block.shape[1] for block in blocks))
    a, c, b = columns / np.hypot(columns[0], columns[1])
    chosen: list[list[Row]] = [[] for _ in blocks]
    for _ in range(_STEPS):
        answer = solve_lexicographic(weight, nominal, box, chosen)
        if answer is None:
            return None
        v, w, slacks = answer.v, answer.omega, answer.slacks
        over = a * v
        over += c * w
        over -= b
        if any(slacks):
            for start, end, slack in zip((0, *ends), ends, slacks, strict=False):
                over[start:end] -= slack
        worst = int(over.argmax())
        if over[worst] <= _ROUNDING * (abs(v) + abs(w) + abs(float(b[worst])) + max(slacks)):
            return answer
        level = bisect.bisect_right(ends, worst)
        row = _tuples(columns[:, worst : worst + 1])
        if row[0] in chosen[level]:
            return None  # rounding holds it up; where all rows are looked at, none is left over
        chosen[level] += row
    return None


def _may_bind(box: Box, columns: Array) -> NDArray[np.bool_]:
    """Which rows, a column each, do not hold in the whole box with room for rounding."""
    v_lo, v_hi, w_lo, w_hi = box
    noise = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    with np.errstate(over="ignore", invalid="ignore"):
        # The largest of a.u is at the middle of the box, and half a side to either side.
        most = np.dot((0.5 * (v_lo + v_hi), 0.5 * (w_lo + w_hi)), columns[:2])
        wide = 0.5 * (v_hi - v_lo) + 2.0 * noise, 0.5 * (w_hi - w_lo) + 2.0 * noise
        most += np.dot(wide, np.abs(columns[:2]))
        held: NDArray[np.bool_] = most < columns[2]
        held &= columns[2] < np.inf
    return np.logical_not(held, out=held)


def _columns(rows: Sequence[Row] | Array) -> Array:
    """Rows as an array, a column each."""
    if isinstance(rows, np.ndarray):
        return np.ascontiguousarray(rows.T, dtype=np.float64)
    # Through an iterator, which takes a third of the time.
    flat = np.fromiter(itertools.chain.from_iterable(rows), np.float64, 3 * len(rows))
    return np.ascontiguousarray(flat.reshape(-1, 3).T)


def _tuples(columns: Array) -> list[Row]:
    return [(a, c, b) for a, c, b in columns.T.tolist()]
