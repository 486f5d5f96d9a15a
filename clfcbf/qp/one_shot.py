r"""The one-shot program with a quadratic slack, its slack eliminated.

.. math:: \min_{u,\delta}\ (u-u_{ref})^\top Q (u-u_{ref}) + c\,\delta^2
          \quad\text{s.t.}\quad u \in \text{box},\quad A u \le b_h,\quad
          a^\top u - b \le \delta,\quad \delta \ge 0
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.qp.lexicographic import Box, Row, Weight, minimise

__all__ = ["PaperSolution", "paper_program"]


class PaperSolution(NamedTuple):
    r"""Answer of :func:`paper_program`.

    Attributes
    ----------
    v, omega : the command [m/s], [rad/s]; the least violation where the hard rows cannot hold,
        NaN where the data is not finite
    delta : the slack, :math:`\max(0, a^\top u - b)`
    feasible : whether box and hard rows hold
    """

    v: float
    omega: float
    delta: float
    feasible: bool


def paper_program(
    weight: Weight,
    reference: tuple[float, float],
    box: Box,
    hard: Sequence[Row],
    soft: Row,
    penalty: float,
) -> PaperSolution:
    r"""Solve the one-shot program of [Xie2024]_ exactly.

    At the optimum :math:`\delta = \max(0, a^\top u - b)`. If the minimum without the soft row
    meets it, that is the answer; else :math:`\delta > 0` and the cost is
    :math:`(u-u_{ref})^\top Q(u-u_{ref}) + c\,(a^\top u-b)^2`, again strictly convex.

    Parameters
    ----------
    weight : ``(q11, q12, q22)``, positive definite
    reference : :math:`u_{ref}` [m/s], [rad/s]; zero in the paper
    box : ``(v_lo, v_hi, w_lo, w_hi)``
    hard : rows ``(a_v, a_w, b)`` that say ``a_v v + a_w omega <= b``
    soft : the row that :math:`\delta` relaxes
    penalty : :math:`c > 0`, finite

    Raises
    ------
    ConfigurationError : the penalty is not finite and positive
    """
    if not (math.isfinite(penalty) and penalty > 0.0):
        raise ConfigurationError(f"penalty must be finite and positive, got {penalty!r}")
    n_v, n_w = reference
    v_lo, v_hi, w_lo, w_hi = box
    s_v, s_w, s_b = soft
    total = n_v + n_w + v_lo + v_hi + w_lo + w_hi + s_v + s_w + s_b
    for a_v, a_w, b in hard:
        total += a_v + a_w + b
    if total - total != 0.0 or v_lo > v_hi or w_lo > w_hi:
        return PaperSolution(math.nan, math.nan, math.nan, False)
    impossible = tuple(i for i, (a, c, b) in enumerate(hard) if not (a or c) and b < 0.0)
    q11, q12, q22 = weight
    levels = (hard,)
    plain = (q11, q12, q22, n_v, n_w, 0.0, 0.0, 0.0, 0.0)
    answer = minimise(plain, box, levels, impossible)
    delta = s_v * answer.v + s_w * answer.omega - s_b
    if delta > 0.0:
        stern = (q11, q12, q22, n_v, n_w, penalty, s_v, s_w, s_b)
        answer = minimise(stern, box, levels, impossible)
        delta = s_v * answer.v + s_w * answer.omega - s_b
    return PaperSolution(answer.v, answer.omega, max(0.0, delta), not answer.relaxed)
