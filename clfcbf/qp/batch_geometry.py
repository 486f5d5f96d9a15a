r"""Rows and boxes of many two-input programs at once, one column a program.

Boxes are arrays of shape (4, n), a row is one of shape (3, n), rows are of shape (r, 3, n).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.chord import NOISE, SMALL_ANGLE

__all__ = [
    "DELICATE",
    "EMPTY",
    "FINE",
    "NOISE",
    "SMALL_ANGLE",
    "Array",
    "Flags",
    "Index",
    "Mask",
    "excess",
    "extreme",
    "inside",
    "lowest_corner",
    "reach_of",
    "scale_of",
    "size_of",
]

Array: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.uint8]
Index: TypeAlias = NDArray[np.intp]
Mask: TypeAlias = NDArray[np.bool_]

FINE, EMPTY, DELICATE = np.uint8(0), np.uint8(1), np.uint8(2)
"""Verdict on a column: floats answer; nothing is left; left to the exact path. Of two verdicts
the larger one stands."""

_SHORTEST, _LONGEST = 1e-300, 1e300  # squared lengths between which rounding stays relative


def reach_of(array: Array) -> float:
    """A number that no modulus of the array exceeds; NaN where one is NaN."""
    highest, lowest = float(array.max(initial=0.0)), float(array.min(initial=0.0))
    return highest - lowest


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


def extreme(length2: Array) -> Mask:
    """Where a squared length is so large or small that floats lose digits of it, or is NaN."""
    usual: Mask = (length2 > _SHORTEST) & (length2 < _LONGEST)
    return np.logical_not(usual, out=usual)


def lowest_corner(box: Array, row: Array) -> tuple[Array, Array]:
    r"""The corner of the box where :math:`a^\top u` is least; one of them where that is a side."""
    return np.where(row[0] > 0.0, box[0], box[1]), np.where(row[1] > 0.0, box[2], box[3])
