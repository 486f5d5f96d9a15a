r"""Lagrange multipliers of the lexicographic program: which rows hold the command, how hard.

At the answer :math:`Q(\bar u - u) = \sum_i \lambda_i a_i` with :math:`\lambda_i \ge 0`, and
:math:`\lambda_i > 0` only where row :math:`i` (with its level's slack) or a side of the box is
active. In two dimensions two of them always suffice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from clfcbf.qp.lexicographic import Box, Level, LexicographicSolution, Weight

__all__ = ["Multipliers", "multipliers"]

_ACTIVE = 1e-9
"""Distance under which a row counts as touched [units of the command]; rounding is 1e-12."""


class Multipliers(NamedTuple):
    """One multiplier a row and a side of the box.

    Attributes
    ----------
    rows : multipliers of the rows as they were given (not to unit length), levels in a row
    box : of the sides ``v_lo``, ``v_hi``, ``w_lo``, ``w_hi``
    active : indices of the positive ones, the sides of the box counted after the rows
    """

    rows: tuple[float, ...]
    box: tuple[float, float, float, float]
    active: tuple[int, ...]


def multipliers(
    weight: Weight,
    nominal: tuple[float, float],
    box: Box,
    levels: Sequence[Level],
    solution: LexicographicSolution,
) -> Multipliers:
    """The multipliers of ``solution``, which answered the same arguments.

    Where more than two rows meet the multipliers are not unique; one choice is returned, with
    a single row before a pair.
    """
    q11, q12, q22 = weight
    v, omega = solution.v, solution.omega
    x, y = nominal[0] - v, nominal[1] - omega
    g_v, g_w = q11 * x + q12 * y, q12 * x + q22 * y
    touched: list[tuple[int, float, float, float]] = []  # index, unit normal, length
    near = _ACTIVE * (1.0 + abs(v) + abs(omega))
    index = 0
    for rows, slack in zip(levels, solution.slacks, strict=True):
        for a_v, a_w, b in rows:
            length = math.hypot(a_v, a_w)
            # A subnormal length has no reliable direction, and b / length may overflow.
            if length > 1e-300 and abs((a_v * v + a_w * omega - b) / length - slack) <= near:
                touched.append((index, a_v / length, a_w / length, length))
            index += 1
    v_lo, v_hi, w_lo, w_hi = box
    sides = (
        (v - v_lo, -1.0, 0.0),
        (v_hi - v, 1.0, 0.0),
        (omega - w_lo, 0.0, -1.0),
        (w_hi - omega, 0.0, 1.0),
    )
    touched += [(index + k, c, d, 1.0) for k, (gap, c, d) in enumerate(sides) if gap <= near]
    best: tuple[tuple[int, float], ...] = ()
    error = math.hypot(g_v, g_w)
    noise = 1e-12 * (error + abs(q11 * nominal[0]) + abs(q22 * nominal[1]))
    for k, one in enumerate(touched):
        choices = [_single(g_v, g_w, one)]
        choices += [_pair(g_v, g_w, one, other) for other in touched[:k]]
        for left, choice in choices:
            if left < error - (noise if len(choice) >= max(1, len(best)) else 0.0):
                best, error = choice, left
    values = [0.0] * (index + 4)
    for i, value in best:
        values[i] = value
    low_v, high_v, low_w, high_w = values[index:]
    active = tuple(i for i, value in enumerate(values) if value > 0.0)
    return Multipliers(tuple(values[:index]), (low_v, high_v, low_w, high_w), active)


_Touched = tuple[int, float, float, float]
_Choice = tuple[float, tuple[tuple[int, float], ...]]


def _single(g_v: float, g_w: float, row: _Touched) -> _Choice:
    index, a, c, length = row
    value = max(0.0, a * g_v + c * g_w)
    return math.hypot(g_v - value * a, g_w - value * c), ((index, value / length),)


def _pair(g_v: float, g_w: float, first: _Touched, second: _Touched) -> _Choice:
    i, a, c, length_i = first
    j, d, e, length_j = second
    det = a * e - c * d
    if det == 0.0:
        return math.inf, ()
    p, q = (g_v * e - g_w * d) / det, (a * g_w - c * g_v) / det
    if p < 0.0 or q < 0.0:
        return math.inf, ()
    left = math.hypot(g_v - p * a - q * d, g_w - p * c - q * e)
    return left, ((i, p / length_i), (j, q / length_j))
