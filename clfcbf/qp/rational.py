r"""The lexicographic program in rational arithmetic: slow, and right to the last bit.

Called where floats cannot decide: nearly parallel rows, sets that are empty or thin to
rounding, badly scaled weights. Every float is a rational, so nothing is rounded on the way in;
only the lengths of rows, which scale the slacks, are square roots, taken to 100 bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from clfcbf.qp.chord import NOISE, box_scale
from clfcbf.qp.objective import Objective, cost, minimiser, nearest_on_edge
from clfcbf.qp.polygon import ExactRow, box_polygon
from clfcbf.qp.relaxation import relax

__all__ = ["RationalSolution", "solve_rational"]

_ROOT_BITS = 200  # length of a row to 2**-100 relative


class RationalSolution(NamedTuple):
    """The command and one slack a level, rounded once at the end."""

    v: float
    omega: float
    slacks: tuple[float, ...]


def _unit(row: ExactRow) -> ExactRow:
    a, c, b = row
    square = a * a + c * c
    shift = _ROOT_BITS - square.numerator.bit_length() + square.denominator.bit_length()
    shift += shift % 2
    scaled = square * 2**shift if shift >= 0 else square / 2**-shift
    length = Fraction(math.isqrt(scaled.numerator // scaled.denominator))
    length = length / 2 ** (shift // 2) if shift >= 0 else length * 2 ** (-shift // 2)
    return a / length, c / length, b / length


def _to_float(number: Fraction) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def solve_rational(
    objective: Objective[float],
    box: Sequence[float],
    levels: Sequence[Sequence[tuple[float, float, float]]],
) -> RationalSolution:
    """As :func:`clfcbf.qp.exact.solve_lexicographic`, with every comparison decided exactly.

    Parameters
    ----------
    objective : cost of the last step
    box : ``(v_lo, v_hi, w_lo, w_hi)``, finite and not empty
    levels : rows ``(a_v, a_w, b)``, the most important level first; zero rows are passed over
    """
    v_lo, v_hi, w_lo, w_hi = box
    margin = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    exact_levels = [
        [
            (Fraction(a), Fraction(c), Fraction(b))
            for a, c, b in rows
            if (a or c)
            # Rows that hold throughout the box with room for rounding say nothing.
            and not (
                a * (v_hi if a > 0 else v_lo) + c * (w_hi if c > 0 else w_lo)
                < b - margin * (abs(a) + abs(c))
            )
        ]
        for rows in levels
    ]
    corners = box_polygon(Fraction(v_lo), Fraction(v_hi), Fraction(w_lo), Fraction(w_hi))
    polygon, slacks = relax(corners, exact_levels, _unit)
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = map(Fraction, objective)
    exact = (q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b)
    best = minimiser(exact)
    if any(slacks) or not _holds(best, corners, exact_levels):
        edges = zip(polygon, polygon[1:] + polygon[:1], strict=True)
        best = min((nearest_on_edge(exact, p, q) for p, q in edges), key=lambda u: cost(exact, *u))
    return RationalSolution(float(best[0]), float(best[1]), tuple(map(_to_float, slacks)))


def _holds(
    point: tuple[Fraction, Fraction],
    corners: Sequence[tuple[Fraction, Fraction]],
    levels: Sequence[Sequence[ExactRow]],
) -> bool:
    v, w = point
    return (
        min(p[0] for p in corners) <= v <= max(p[0] for p in corners)
        and min(p[1] for p in corners) <= w <= max(p[1] for p in corners)
        and all(a * v + c * w <= b for rows in levels for a, c, b in rows)
    )
