"""Interval branch and bound: a property of a box, proved, or refuted by a point of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tests.certificates.intervals import Interval


class Verdict(NamedTuple):
    """``proved`` with the number of boxes it took, or a ``counterexample``, or neither."""

    proved: bool
    boxes: int
    counterexample: tuple[float, ...] | None


def branch_and_bound(holds, fails, box, most_boxes=400_000):
    """Halve boxes until the property is proved on each, or a point is found where it fails.

    Parameters
    ----------
    holds : takes one Interval a coordinate (arrays of boxes), gives a mask: surely true
        throughout the box
    fails : the same for points, mask: surely false there
    box : pairs (low, high), one a coordinate
    """
    low = np.array([[pair[0] for pair in box]], dtype=float)
    high = np.array([[pair[1] for pair in box]], dtype=float)
    extent = high[0] - low[0]
    count = 0
    while low.size:
        count += len(low)
        if count > most_boxes:
            return Verdict(False, count, None)
        middle = 0.5 * (low + high)
        failed = fails(*(Interval(column) for column in middle.T))
        if failed.any():
            return Verdict(False, count, tuple(middle[failed][0].tolist()))
        proved = holds(*(Interval(a, b) for a, b in zip(low.T, high.T, strict=True)))
        low, high, middle = low[~proved], high[~proved], middle[~proved]
        rows = np.arange(len(low))
        widest = ((high - low) / extent).argmax(axis=1)
        upper, lower = low.copy(), high.copy()
        upper[rows, widest] = lower[rows, widest] = middle[rows, widest]
        low, high = np.concatenate([low, upper]), np.concatenate([lower, high])
    return Verdict(True, count, None)
