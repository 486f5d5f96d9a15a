r"""Convex polygons of commands in exact arithmetic: clipping by half-planes.

On fractions nothing is rounded, so a polygon is what it says. Where floats could not decide, the
solvers in floats raise :class:`Delicate` and what is here answers.

A polygon is the list of its corners, counter-clockwise, without repetitions; a segment has two,
a point one, and the empty list is the empty set.
"""

from __future__ import annotations

from fractions import Fraction

__all__ = ["PARALLEL", "TRUSTED", "Corner", "Delicate", "ExactRow", "box_polygon", "clip"]

Corner = tuple[Fraction, Fraction]
ExactRow = tuple[Fraction, Fraction, Fraction]

PARALLEL = 2**50
"""Directions closer than ``1 / PARALLEL`` [rad] are one: rounding hides the difference."""

TRUSTED = 2**10
"""On floats, angles below ``1 / TRUSTED`` [rad] are left to fractions: 2**-52 * TRUSTED < 1e-12."""


class Delicate(ArithmeticError):  # noqa: N818 (a request for more digits, not an error)
    """Rounding could change this decision; ask again with fractions."""


def box_polygon(v_lo: Fraction, v_hi: Fraction, w_lo: Fraction, w_hi: Fraction) -> list[Corner]:
    """Corners of the box; two or one where it is degenerate."""
    corners = [(v_lo, w_lo), (v_hi, w_lo), (v_hi, w_hi), (v_lo, w_hi)]
    return corners if v_lo < v_hi and w_lo < w_hi else _distinct(corners)


def _distinct(corners: list[Corner]) -> list[Corner]:
    kept = [p for i, p in enumerate(corners) if p != corners[i - 1]]
    return kept or corners[:1]


def clip(polygon: list[Corner], row: ExactRow) -> list[Corner]:
    r"""The part of ``polygon`` in :math:`a^\top u \le b` (Sutherland-Hodgman).

    Parameters
    ----------
    polygon : corners, not empty
    row : ``(a_v, a_w, b)``, any length but zero

    Notes
    -----
    An edge parallel to ``row`` to rounding (:data:`PARALLEL`) that meets its line is kept as a
    whole: a row and its copy scaled by 3 are one row, though rounding tilts the copy.
    """
    a, c, b = row
    residuals = [a * x + c * y - b for x, y in polygon]
    if max(residuals) <= 0:
        return polygon
    size = abs(a) + abs(c)
    count = len(polygon)
    for i in range(count):
        ri, rj = residuals[i - 1], residuals[i]
        if ri <= 0 <= rj or rj <= 0 <= ri:
            (xi, yi), (xj, yj) = polygon[i - 1], polygon[i]
            across, length = abs(ri - rj), size * (abs(xi - xj) + abs(yi - yj))
            if across * PARALLEL <= length:
                residuals[i - 1] = residuals[i] = Fraction(0)  # both ends count as on the row
    if min(residuals) > 0:
        return []
    kept: list[Corner] = []
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


def _between(p: Corner, q: Corner, t: Fraction) -> Corner:
    return (p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]))
