"""Columns parted into surfaces: lone outliers are dropped, and a step of depth ends a run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clfcbf.perception.columns import Array, DepthNoise

__all__ = ["Indices", "drop_outliers", "runs"]

Indices = NDArray[np.intp]
"""Indices of columns."""

WINDOW = 2
"""Columns to either side in the median: two outliers of five columns cannot move it far."""
STEP = 0.1
"""[m] Least step of depth that parts two surfaces: a board stands freely before what is behind."""
SIGMAS = 5.0
"""Steps and outliers are told from noise at this many sigma: 240 columns hold no false one."""
GAP = 3
"""Columns in a row that a surface may lack: neighbouring outliers and missing returns."""


def drop_outliers(depths: Array, noise: DepthNoise) -> Array:
    """Depths with NaN where a column is alone or far from the median of its neighbourhood.

    A step survives: at the last column before it, three of the five are on its own side. So
    does the tilt of a board: depth is monotone along it, and the median is the middle column.

    Parameters
    ----------
    depths : (N,) [m], NaN where nothing is seen
    noise : how far apart columns of one surface can be
    """
    padded = np.full(len(depths) + 2 * WINDOW, np.nan)
    padded[WINDOW : len(padded) - WINDOW] = depths
    count = np.convolve(np.isfinite(padded), np.ones(2 * WINDOW + 1, dtype=np.intp), "valid")
    neighbours = np.lib.stride_tricks.sliding_window_view(padded, 2 * WINDOW + 1)
    middle = _median_of_seen(neighbours, count)
    with np.errstate(invalid="ignore"):
        lone = np.abs(depths - middle) > _tolerance(middle, noise)
    lone |= count <= WINDOW
    clean: Array = np.where(lone, np.nan, depths)
    return clean


def runs(depths: Array, noise: DepthNoise) -> list[Indices]:
    """Indices of the columns of each surface, in order; columns with NaN are in none.

    Two columns that follow each other are of one surface if at most :data:`GAP` columns are
    missing between them and their depths differ by less than a step.

    Parameters
    ----------
    depths : (N,) [m], after :func:`drop_outliers`
    noise : as there
    """
    seen = np.flatnonzero(np.isfinite(depths))
    if not seen.size:
        return []
    z = depths[seen]
    apart = np.diff(seen) > GAP + 1
    step = np.abs(np.diff(z)) > _tolerance(np.maximum(z[1:], z[:-1]), noise)
    return list(np.split(seen, np.flatnonzero(apart | step) + 1))


def _tolerance(depths: Array, noise: DepthNoise) -> Array:
    tolerance: Array = np.maximum(STEP, SIGMAS * math.sqrt(2.0) * noise.sigma(depths))
    return tolerance


def _median_of_seen(rows: Array, count: Indices) -> Array:
    """Median of the ``count`` values of each row that are no NaN.

    NaN where there is none, of which np.nanmedian would warn.
    """
    ordered = np.sort(rows, axis=1)  # NaN last
    each = np.arange(len(rows))
    low, high = ordered[each, np.maximum(count - 1, 0) // 2], ordered[each, count // 2]
    return np.where(count > 0, 0.5 * (low + np.where(count % 2, low, high)), np.nan)
