"""How far a board is seen along its line, and what ends it there."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np

from clfcbf.perception.columns import Array, DepthNoise, DepthSpan
from clfcbf.perception.line import SIGMAS, Line
from clfcbf.perception.segmentation import GAP, Indices

__all__ = ["Edge", "End", "Extent", "find_extent"]

CONFIRM = 2
"""Columns that have to look past an end to call it free: one alone may be an outlier."""

NEXT = 5
"""Columns seen next beyond an end, most of which have to be farther for it to be free."""


class End(enum.Enum):
    """What ends the visible part of a board."""

    FREE = "free"
    """The board's own edge: what is beside it is farther away, or nothing."""
    CLIPPED = "clipped"
    """The edge of the view, or of the depths that the camera measures."""
    OCCLUDED = "occluded"
    """Something nearer, if only beyond columns that see nothing: it may be too near to see."""


class Edge(NamedTuple):
    """One end of the visible part.

    ``tangent`` of the ray half a column beyond the last column that sees the board, ``spacing``
    of the two columns it lies between, in tangents too, and what ``end`` it is.
    """

    tangent: float
    spacing: float
    end: End


class Extent(NamedTuple):
    """The two edges of the visible part, in the order of rising bearing."""

    right: Edge
    left: Edge

    def length(self, line: Line) -> float:
        """Length of the visible part along its line [m]."""
        return math.dist(line.at(self.right.tangent), line.at(self.left.tangent))

    def free(self) -> int:
        """How many of the edges are the board's own."""
        return (self.right.end is End.FREE) + (self.left.end is End.FREE)


def find_extent(
    line: Line,
    core: int,
    tangents: Array,
    depths: Array,
    clean: Array,
    noise: DepthNoise,
    span: DepthSpan,
) -> Extent | None:
    """Visible part of a line around one of its columns.

    It reaches to the last column on the line with no more than ``GAP`` columns between that are
    not; a lone column counts only if it is next but one to another, for an outlier that happens
    to be on the line would move the edge by several columns. The edge is drawn half-way to the
    next column: the board ends somewhere between one that sees it and one that does not, and
    taking the last point itself would be short by half a column on average. If the next column
    is an outlier, the one after it is taken, for the outlier may lie on either side of the edge.

    Parameters
    ----------
    line : of the board, in the camera's frame
    core : index of a column that is on it
    tangents, depths : of all columns of the camera, (N,), NaN depth where nothing is seen
    clean : the same without lone outliers; an outlier hides nothing, but where one lies beside
        the board's end the end itself is missing here
    noise : how far from the line its columns may be
    span : of the depths that the camera measures

    Returns
    -------
    The extent; None if fewer than two columns are on the line there, or if it is seen so nearly
    edge-on that the next column's ray passes it.
    """
    expected = line.depths(tangents)
    spread = SIGMAS * noise.sigma(expected)
    with np.errstate(invalid="ignore"):
        on = np.flatnonzero(np.abs(depths - expected) <= spread)
    own = _without_lone_ends(_group_of(core, on))
    if len(own) < 2:
        return None
    view = _View(tangents, depths, clean, expected, spread, span)
    right, left = _edge(int(own[0]), -1, view), _edge(int(own[-1]), 1, view)
    outer = (right.tangent - 0.5 * right.spacing, left.tangent + 0.5 * left.spacing)
    if min(line.a + line.b * tangent for tangent in outer) <= 0.0:
        return None
    return Extent(right, left)


def _group_of(core: int, on: Indices) -> Indices:
    """Those of the columns ``on`` the line that are joined to ``core``; none if that is not."""
    at = int(np.searchsorted(on, core))
    if at == len(on) or on[at] != core:
        return on[:0]
    starts = np.flatnonzero(on[1:] - on[:-1] > GAP + 1) + 1
    k = int(np.searchsorted(starts, at, side="right"))
    first = int(starts[k - 1]) if k else 0
    return on[first : int(starts[k]) if k < len(starts) else len(on)]


def _without_lone_ends(group: Indices) -> Indices:
    close = np.flatnonzero(group[1:] - group[:-1] <= CONFIRM)
    return group[close[0] : close[-1] + 2] if close.size else group[:0]


class _View(NamedTuple):
    """All columns: tangents and depths, these without lone outliers, and where the line is."""

    tangents: Array
    depths: Array
    clean: Array
    expected: Array
    spread: Array
    span: DepthSpan

    def measures(self, k: int) -> bool:
        """Whether the camera measures the line's depth in column ``k``, noise included."""
        near, far = self.span
        z, noise = float(self.expected[k]), float(self.spread[k])
        return near <= z - noise and z + noise <= far

    def is_lone(self, k: int) -> bool:
        """Whether column ``k`` is a lone outlier."""
        return math.isfinite(self.depths[k]) and math.isnan(self.clean[k])


def _edge(last: int, side: int, view: _View) -> Edge:
    """The edge beyond column ``last`` towards ``side``, +1 to the left."""
    n = len(view.tangents)
    beyond = [k for k in (last + side, last + 2 * side) if 0 <= k < n]
    if not beyond:  # the view ends half a column on
        spacing = abs(float(view.tangents[last] - view.tangents[last - side]))
        return Edge(float(view.tangents[last]) + side * 0.5 * spacing, spacing, End.CLIPPED)
    off = beyond[-1] if view.is_lone(beyond[0]) else beyond[0]
    here, there = float(view.tangents[last]), float(view.tangents[off])
    if len(beyond) < CONFIRM or not all(map(view.measures, beyond)):
        end = End.CLIPPED
    elif _hidden(last, side, view):
        end = End.OCCLUDED
    else:
        end = End.FREE
    return Edge(0.5 * (here + there), abs(there - here), end)


def _hidden(last: int, side: int, view: _View) -> bool:
    """Whether most of what is seen next beyond column ``last`` is not farther than the line."""
    beyond = slice(last + 1, None) if side > 0 else slice(None, last)
    clean = view.clean[beyond]
    seen = np.flatnonzero(np.isfinite(clean))
    following = seen[:NEXT] if side > 0 else seen[-NEXT:]
    line = view.expected[beyond] + view.spread[beyond]
    hiding = len(following) - int(np.count_nonzero(clean[following] > line[following]))
    return hiding >= CONFIRM and 2 * hiding > len(following)
