r"""The command of least violation of a level, in floats, where it is one corner.

.. math:: \min_{u \in C} \max_i\ (a_i^\top u - b_i)/|a_i|

over box and more important rows :math:`C`. Incremental: the corner for the rows so far satisfies
the next one, or the new one lies on its line [Seidel1991]_. Where a whole side would do, or
rounding could change the answer, the caller has to look at the set of commands itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from clfcbf.qp.chord import NOISE, box_scale, chord
from clfcbf.qp.polygon import TRUSTED, Delicate
from clfcbf.qp.relaxation import tightest
from clfcbf.qp.segment import interval

__all__ = ["relax_to_corner"]

Row = tuple[float, float, float]


def relax_to_corner(
    box: Sequence[float], levels: Sequence[Sequence[Row]], first: int
) -> tuple[float, float, tuple[float, ...]]:
    """The command at which the levels from ``first`` on give way by as little as they must.

    Parameters
    ----------
    box : ``(v_lo, v_hi, w_lo, w_hi)``, not empty
    levels : rows ``(a_v, a_w, b)``, the most important level first; zero rows are passed over
    first : the level that together with those before leaves no command

    Returns
    -------
    v, omega and one slack a level

    Raises
    ------
    Delicate : the least violation is not at one corner, or rounding could change the answer
    """
    v_lo, v_hi, w_lo, w_hi = box
    noise = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    taken = [row for rows in levels[:first] for row in rows] if first else []
    v, w, value = _least(box, _units(levels[first]), taken, noise)
    slacks = [0.0] * first + [value]
    for rows in levels[first + 1 :]:
        largest = max((a * v + c * w - b for a, c, b in _units(rows)), default=-math.inf)
        if abs(largest) <= noise:
            raise Delicate
        slacks.append(max(0.0, largest))
    return v, w, tuple(slacks)


def _units(rows: Sequence[Row]) -> list[Row]:
    """The rows brought to unit length, without zero rows."""
    units = []
    for a, c, b in rows:
        if a or c:
            length = math.hypot(a, c)
            units.append((a / length, c / length, b / length))
    return units


def _least(
    box: Sequence[float], units: list[Row], taken: list[Row], noise: float
) -> tuple[float, float, float]:
    """Corner and value of the least of the largest residual of ``units``."""
    if len(units) > 1:
        units = tightest(units)
    a, c, b = units[0]
    v, w = _lowest(box, units[0], taken, noise)
    value = a * v + c * w - b
    for count, (a, c, b) in enumerate(units[1:], 1):
        over = a * v + c * w - b - value
        if abs(over) <= noise + NOISE * abs(value):
            raise Delicate
        if over > 0.0:
            below = [(d - a, e - c, f - b) for d, e, f in units[:count]]
            if any((abs(d) + abs(e)) * TRUSTED < 1.0 for d, e, _ in below):
                raise Delicate  # the difference has lost digits that it needs
            v, w = _lowest(box, (a, c, b), taken + below, noise)
            value = a * v + c * w - b
    if not value > noise:
        raise Delicate
    return v, w, value


def _lowest(box: Sequence[float], row: Row, taken: list[Row], noise: float) -> tuple[float, float]:
    """The corner of box and ``taken`` where ``row``, of unit length, is lowest."""
    v_lo, v_hi, w_lo, w_hi = box
    a, c, _ = row
    if (abs(a) <= NOISE and v_lo < v_hi) or (abs(c) <= NOISE and w_lo < w_hi):
        raise Delicate
    if v_lo == v_hi or w_lo == w_hi:
        left = interval(box, [taken])
        if isinstance(left, int):
            raise Delicate
        first, last = left
        if v_lo == v_hi:
            return v_lo, first if c > 0.0 else last
        return first if a > 0.0 else last, w_lo
    v, w = v_lo if a > 0.0 else v_hi, w_lo if c > 0.0 else w_hi
    for count, (d, e, f) in enumerate(taken):
        size = abs(d) + abs(e)
        over = d * v + e * w - f
        if over < -noise * size or not size:
            continue
        slope = c * d - a * e
        if over <= noise * size or abs(slope) <= NOISE * size:
            raise Delicate
        ends = chord(box, (d, e, f), v, w, taken[:count])
        if ends is None:
            raise Delicate
        x, y, lo, hi = ends
        t = lo if slope > 0.0 else hi
        v, w = x - e * t, y + d * t
        v = v_lo if v < v_lo else v_hi if v > v_hi else v
        w = w_lo if w < w_lo else w_hi if w > w_hi else w
    return v, w
