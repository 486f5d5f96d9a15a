r"""The cost :math:`(u-\bar u)^\top Q(u-\bar u) + c\,(a^\top u - b)^2` of the two-input programs.

Strictly convex with :math:`Q \succ 0` and :math:`c \ge 0`. On floats and fractions alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TypeAlias, TypeVar

__all__ = [
    "CONDITION",
    "Objective",
    "cost",
    "ill_conditioned",
    "line_minimum",
    "minimiser",
    "nearest_on_edge",
]

N = TypeVar("N", float, Fraction)

Objective: TypeAlias = tuple[N, N, N, N, N, N, N, N, N]
r"""``(q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b)``: weight :math:`Q`, nominal command
:math:`\bar u`, penalty :math:`c` and its row :math:`(a, b)`; ``c = 0`` where there is none."""

CONDITION = 2.0**20
"""Largest condition of Q left to floats: rounding grows with its root, 2**-52 * 2**10 < 1e-12."""


def cost(objective: Objective[N], v: N, omega: N) -> N:
    """The cost of the command ``(v, omega)``."""
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    x, y, soft = v - n_v, omega - n_w, s_v * v + s_w * omega - s_b
    return x * (q11 * x + q12 * y) + y * (q12 * x + q22 * y) + c * soft * soft


def minimiser(objective: Objective[N]) -> tuple[N, N]:
    r"""The command of least cost, :math:`\bar u - Q^{-1}a\,c\,r / (1 + c\,a^\top Q^{-1}a)`.

    Here :math:`r = a^\top\bar u - b`.
    """
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    if c == 0:
        return n_v, n_w
    g_v, g_w = q22 * s_v - q12 * s_w, q11 * s_w - q12 * s_v
    excess, det = s_v * n_v + s_w * n_w - s_b, q11 * q22 - q12 * q12
    k = c * excess / (det + c * (s_v * g_v + s_w * g_w))
    return n_v - k * g_v, n_w - k * g_w


def line_minimum(objective: Objective[N], x: N, y: N, d_v: N, d_w: N) -> N:
    r"""The t of least cost along :math:`p + t d`, :math:`p = (x, y)`.

    .. math:: t = \frac{d^\top Q(\bar u - p) - c\,(a^\top d)(a^\top p - b)}
                       {d^\top Q d + c\,(a^\top d)^2}
    """
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    e_v, e_w = n_v - x, n_w - y
    g_v, g_w = q11 * d_v + q12 * d_w, q12 * d_v + q22 * d_w
    if c == 0:
        return (g_v * e_v + g_w * e_w) / (g_v * d_v + g_w * d_w)
    slope = s_v * d_v + s_w * d_w
    return (g_v * e_v + g_w * e_w - c * slope * (s_v * x + s_w * y - s_b)) / (
        g_v * d_v + g_w * d_w + c * slope * slope
    )


def nearest_on_edge(objective: Objective[N], p: tuple[N, N], q: tuple[N, N]) -> tuple[N, N]:
    """The point of least cost on the segment from ``p`` to ``q``."""
    d_v, d_w = q[0] - p[0], q[1] - p[1]
    if d_v == 0 and d_w == 0:
        return p
    t = line_minimum(objective, p[0], p[1], d_v, d_w)
    if t <= 0:
        return p
    return q if t >= 1 else (p[0] + t * d_v, p[1] + t * d_w)


def ill_conditioned(objective: Sequence[float]) -> bool:
    r"""Whether Q stretches rounding errors by more than floats can spare.

    :math:`\operatorname{cond} Q \le (\operatorname{tr} Q)^2 / \det Q`.
    """
    q11, q12, q22 = objective[0], objective[1], objective[2]
    trace = q11 + q22
    return not trace * trace <= CONDITION * (q11 * q22 - q12 * q12)
