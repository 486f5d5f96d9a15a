r"""Convex polygons of commands: clipping by half-planes.

Everything here runs on floats and on :class:`fractions.Fraction` alike: one text, two
arithmetics. On floats a decision that rounding could turn raises :class:`Delicate`, and the
caller repeats the computation on fractions, where nothing is rounded.

A polygon is the list of its corners, counter-clockwise, without repetitions; a segment has two,
a point one, and the empty list is the empty set.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TypeVar

__all__ = ["PARALLEL", "TRUSTED", "Delicate", "box_polygon", "clip"]

N = TypeVar("N", float, Fraction)

PARALLEL = 2**50
"""Directions closer than ``1 / PARALLEL`` [rad] are one: rounding hides the difference."""

TRUSTED = 2**10
"""On floats, angles below ``1 / TRUSTED`` [rad] are left to fractions: 2**-52 * TRUSTED < 1e-12."""


class Delicate(ArithmeticError):  # noqa: N818 (a request for more digits, not an error)
    """Rounding could change this decision; ask again with fractions."""


def box_polygon(v_lo: N, v_hi: N, w_lo: N, w_hi: N) -> list[tuple[N, N]]:
    """Corners of the box; two or one where it is degenerate."""
    corners = [(v_lo, w_lo), (v_hi, w_lo), (v_hi, w_hi), (v_lo, w_hi)]
    return corners if v_lo < v_hi and w_lo < w_hi else _distinct(corners)


def _distinct(corners: list[tuple[N, N]]) -> list[tuple[N, N]]:
    kept = [p for i, p in enumerate(corners) if p != corners[i - 1]]
    return kept or corners[:1]


def clip(polygon: list[tuple[N, N]], row: tuple[N, N, N], noise: N) -> list[tuple[N, N]]:
    r"""The part of ``polygon`` in :math:`a^\top u \le b` (Sutherland-Hodgman).

    Parameters
    ----------
    polygon : corners, not empty
    row : ``(a_v, a_w, b)``, any length but zero
    noise : bound on the rounding of a corner's coordinates; 0 says the arithmetic is exact

    Raises
    ------
    Delicate : only with ``noise > 0``: the result is empty or thin to rounding, or ``row`` cuts
        an edge at a small angle

    Notes
    -----
    An edge parallel to ``row`` to rounding (:data:`PARALLEL`) is kept or dropped as a whole: a
    row and its copy scaled by 3 are one row, though rounding tilts the copy.
    """
    a, c, b = row
    residuals = [a * x + c * y - b for x, y in polygon]
    lowest = min(residuals)
    size = abs(a) + abs(c)
    if noise and -noise * size <= lowest <= noise * size:
        raise Delicate
    if max(residuals) <= 0:
        return polygon
    if noise and lowest > 0:
        return []
    count = len(polygon)
    for i in range(count):
        ri, rj = residuals[i - 1], residuals[i]
        if ri < 0 < rj or rj < 0 < ri:
            (xi, yi), (xj, yj) = polygon[i - 1], polygon[i]
            across, length = abs(ri - rj), size * (abs(xi - xj) + abs(yi - yj))
            if across * PARALLEL <= length:
                residuals[i - 1] = residuals[i] = a - a  # both ends count as on the row
            elif noise and across * TRUSTED < length:
                raise Delicate
    if min(residuals) > 0:
        return []
    kept: list[tuple[N, N]] = []
    for i in range(count):
        ri, rj = residuals[i - 1], residuals[i]
        # From the end inside to the end outside, so that both passes over a segment agree.
        if ri < 0 < rj:
            kept.append(_between(polygon[i - 1], polygon[i], ri / (ri - rj)))
        elif rj < 0 < ri:
            kept.append(_between(polygon[i], polygon[i - 1], rj / (rj - ri)))
        if rj <= 0:
            kept.append(polygon[i])
    return _distinct(kept)


def _between(p: tuple[N, N], q: tuple[N, N], t: N) -> tuple[N, N]:
    return (p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]))
