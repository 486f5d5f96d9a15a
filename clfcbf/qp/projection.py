r"""Projection of a command onto a box and half-planes, in floats, by two-dimensional geometry.

The minimum over :math:`k` constraints is the minimum over the first :math:`k-1` where that
satisfies the :math:`k`-th, and otherwise lies on the :math:`k`-th's line: one clipped
one-dimensional minimum replaces it [Seidel1991]_. No iterations, no step sizes, no tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence

from clfcbf.qp.chord import NOISE, SAME_ANGLE, SMALL_ANGLE, box_scale, chord
from clfcbf.qp.objective import Objective, ill_conditioned, line_minimum, minimiser
from clfcbf.qp.polygon import TRUSTED, Delicate

__all__ = ["NOISE", "box_scale", "check_trusted", "project"]

_LONGEST = 1e150  # soft rows whose squared length could overflow or underflow go to fractions
_SHORTEST = 1e-150


def project(
    objective: Objective[float],
    box: Sequence[float],
    levels: Sequence[Sequence[tuple[float, float, float]]],
) -> tuple[float, float] | int:
    """The point of least cost in the box and on the right side of every row.

    Parameters
    ----------
    objective : cost
    box : ``(v_lo, v_hi, w_lo, w_hi)``, not empty
    levels : rows ``(a_v, a_w, b)``, grouped in any way; zero rows are passed over

    Returns
    -------
    The command, or the index of the first level that together with those before leaves none

    Raises
    ------
    Delicate : floats cannot answer to 1e-12
    """
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    v_lo, v_hi, w_lo, w_hi = box
    trusted = False
    v, w = n_v, n_w
    if c or q12:
        check_trusted(objective, box)
        trusted = True
        v, w = minimiser(objective)
    # The box: first its v-sides, then its w-sides.
    if not v_lo <= v <= v_hi:
        v = v_lo if v < v_lo else v_hi
        w = n_w + (q12 * (n_v - v) - c * s_w * (s_v * v + s_w * n_w - s_b)) / (q22 + c * s_w * s_w)
    if not w_lo <= w <= w_hi:
        w = w_lo if w < w_lo else w_hi
        v = n_v + (q12 * (n_w - w) - c * s_v * (s_v * n_v + s_w * w - s_b)) / (q11 + c * s_v * s_v)
        v = v_lo if v < v_lo else v_hi if v > v_hi else v
    touch = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    taken: list[tuple[float, float, float]] = []
    for level, rows in enumerate(levels):
        for row in rows:
            a_v, a_w, b = row
            size = abs(a_v) + abs(a_w)
            r = a_v * v + a_w * w - b
            if r > -touch * size and size:
                if r > 0.0:
                    if not trusted:
                        check_trusted(objective, box)
                        trusted = True
                    ends = chord(box, row, v, w, taken)
                    if ends is None:
                        return level
                    x, y, lo, hi = ends
                    if c and _aslant(row, s_v, s_w):
                        raise Delicate
                    t = line_minimum(objective, x, y, -a_w, a_v)
                    t = lo if t < lo else hi if t > hi else t
                    v, w = x - a_w * t, y + a_v * t
                    v = v_lo if v < v_lo else v_hi if v > v_hi else v
                    w = w_lo if w < w_lo else w_hi if w > w_hi else w
                elif _in_a_wedge(row, (v, w), box, taken, touch):
                    raise Delicate
            taken.append(row)
    return v, w


def _in_a_wedge(
    row: tuple[float, float, float],
    point: tuple[float, float],
    box: Sequence[float],
    taken: Sequence[tuple[float, float, float]],
    touch: float,
) -> bool:
    """Whether ``point``, on the line of ``row`` to rounding, is on a nearly parallel one too."""
    a_v, a_w, _ = row
    v, w = point
    v_lo, v_hi, w_lo, w_hi = box
    sides = ((1.0, 0.0, v_hi), (-1.0, 0.0, -v_lo), (0.0, 1.0, w_hi), (0.0, -1.0, -w_lo))
    length2 = a_v * a_v + a_w * a_w
    for c_v, c_w, e in (*sides, *taken):
        rate = a_v * c_w - a_w * c_v
        rate2 = rate * rate  # a power would overflow with an exception
        both2 = length2 * (c_v * c_v + c_w * c_w)
        near = abs(c_v * v + c_w * w - e) <= 2.0 * touch * (abs(c_v) + abs(c_w))
        same = rate2 <= SAME_ANGLE * both2 and a_v * c_v + a_w * c_w > 0.0
        if near and not same and rate2 <= SMALL_ANGLE * both2:
            return True
    return False


def check_trusted(objective: Objective[float], box: Sequence[float]) -> None:
    """Raise Delicate for costs with which rounding could exceed 1e-12."""
    _, _, _, n_v, n_w, c, s_v, s_w, _ = objective
    v_lo, v_hi, w_lo, w_hi = box
    if abs(n_v) + abs(n_w) > TRUSTED * box_scale(v_lo, v_hi, w_lo, w_hi):
        raise Delicate
    if ill_conditioned(objective) or (c and not _SHORTEST < abs(s_v) + abs(s_w) < _LONGEST):
        raise Delicate


def _aslant(row: tuple[float, float, float], s_v: float, s_w: float) -> bool:
    """Whether a row is parallel to the soft one to a small angle."""
    a_v, a_w, _ = row
    cross = a_v * s_w - a_w * s_v
    return cross * cross <= SMALL_ANGLE * (a_v * a_v + a_w * a_w) * (s_v * s_v + s_w * s_w)
