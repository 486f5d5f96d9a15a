r"""Levels of rows on a polygon: clip where a level fits, else relax it by the least amount.

In exact arithmetic, as :mod:`clfcbf.qp.polygon`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TypeVar

from clfcbf.qp.polygon import PARALLEL, Corner, ExactRow, clip

__all__ = ["relax", "tightest"]

N = TypeVar("N", float, Fraction)


def _lowest_face(polygon: list[Corner], row: ExactRow) -> tuple[list[Corner], Fraction]:
    """Corner or edge of ``polygon`` where ``a.u - b`` is least, and that value."""
    a, c, b = row
    count = len(polygon)
    values = [a * x + c * y for x, y in polygon]
    least = min(values)
    first = last = values.index(least)
    # To either side as long as the row rises no more than one parallel to the edge, to rounding.
    for step in (1, -1):
        at = first
        for _ in range(count - 1):
            nxt = (at + step) % count
            dx, dy = polygon[nxt][0] - polygon[at][0], polygon[nxt][1] - polygon[at][1]
            if nxt == last or (a * dx + c * dy) * PARALLEL > abs(dx) + abs(dy):
                break
            at = nxt
        if step > 0:
            last = at
        else:
            first = at
    if first == last:
        return [polygon[first]], least - b
    return [polygon[first], polygon[last]], least - b


def _least_violation(
    polygon: list[Corner], rows: Sequence[ExactRow]
) -> tuple[list[Corner], Fraction]:
    r"""Where :math:`\max_i (a_i^\top u - b_i)` is least over ``polygon``, and that value.

    ``rows`` have unit length. Incremental: the minimum over the rows so far either satisfies
    the next row, or the new minimum lies where the next row is the largest [Seidel1991]_.
    With rows of unit length the minimum is attained on a corner or an edge, never on an area.
    """
    rows = tightest(rows)
    taken = [rows[0]]
    face, value = _lowest_face(polygon, rows[0])
    for row in rows[1:]:
        a, c, b = row
        within = clip(face, (a, c, b + value))
        if within:
            face = within
        else:
            region = polygon
            for i, j, k in taken:  # no two of one direction, so no difference is zero
                region = clip(region, (i - a, j - c, k - b)) if region else region
            # Empty only where the rows are one to rounding (PARALLEL): the face stands.
            if region:
                face, value = _lowest_face(region, row)
        taken.append(row)
    return face, value


def tightest(rows: Sequence[tuple[N, N, N]]) -> list[tuple[N, N, N]]:
    """Of unit rows in one direction, to rounding, the one with the least right-hand side.

    On floats and fractions alike.
    """
    kept: list[tuple[N, N, N]] = []
    for a, c, b in rows:
        for index, (d, e, f) in enumerate(kept):
            if abs(a * e - c * d) * PARALLEL <= 1 and a * d + c * e > 0:
                if b < f:
                    kept[index] = (a, c, b)
                break
        else:
            kept.append((a, c, b))
    return kept


def relax(
    polygon: list[Corner],
    levels: Sequence[Sequence[ExactRow]],
    unit: Callable[[ExactRow], ExactRow],
) -> tuple[list[Corner], list[Fraction]]:
    r"""Clip by level after level; where one does not fit, relax it as little as possible.

    Level :math:`\ell` leaves :math:`\{u \in C_{\ell-1} : a_i^\top u \le b_i + s_\ell |a_i|\}` with
    :math:`s_\ell = \min_{u \in C_{\ell-1}} \max_i\,(a_i^\top u - b_i)^+ / |a_i|`.

    Parameters
    ----------
    polygon : corners of :math:`C_0`, not empty
    levels : rows ``(a_v, a_w, b)`` without zero rows, the most important level first
    unit : scales a row to unit length

    Returns
    -------
    The corners of the last :math:`C_\ell` and one slack a level
    """
    slacks: list[Fraction] = []
    for rows in levels:
        kept = polygon
        for row in rows:
            kept = clip(kept, row)
            if not kept:
                break
        if kept:
            polygon = kept
            slacks.append(Fraction(0))
        else:
            polygon, slack = _least_violation(polygon, [unit(row) for row in rows])
            slacks.append(slack)
    return polygon, slacks
