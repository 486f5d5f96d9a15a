r"""The one-shot program with a quadratic slack, of many robots at once, in NumPy.

As :func:`clfcbf.qp.exact.paper_program`, with arrays and chunks as in :mod:`clfcbf.qp.batch`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clfcbf.errors import ConfigurationError
from clfcbf.qp.batch_chunks import CHUNK, Chunk, Programs
from clfcbf.qp.batch_geometry import DELICATE, EMPTY, FINE, Array, Flags, Mask, excess
from clfcbf.qp.batch_objective import Objectives
from clfcbf.qp.batch_projection import least_violation, project
from clfcbf.qp.one_shot import paper_program

__all__ = ["PaperBatchSolution", "solve_batch_paper"]


class PaperBatchSolution(NamedTuple):
    r"""Answers of :func:`solve_batch_paper`, one row a program.

    Attributes
    ----------
    twist : commands (v, omega) [m/s], [rad/s], shape (B, 2); the least violation where the hard
        rows cannot hold, NaN where the data is not finite
    delta : the slack :math:`\max(0, a^\top u - b)`, shape (B,)
    feasible : whether box and hard rows hold, shape (B,)
    delicate : solved on its own by the exact path, shape (B,)
    """

    twist: Array
    delta: Array
    feasible: Mask
    delicate: Mask


def solve_batch_paper(
    weight: ArrayLike,
    reference: ArrayLike,
    box: ArrayLike,
    hard: ArrayLike,
    soft: ArrayLike,
    penalty: float,
    *,
    chunk: int = CHUNK,
) -> PaperBatchSolution:
    r"""Solve the one-shot program of [Xie2024]_ for each robot, exactly.

    .. math:: \min_{u,\delta}\ (u-u_{ref})^\top Q (u-u_{ref}) + c\,\delta^2
              \quad\text{s.t.}\quad u \in \text{box},\quad A u \le b_h,\quad
              a^\top u - b \le \delta,\quad \delta \ge 0

    Equal to :func:`clfcbf.qp.exact.paper_program`, program by program, to 1e-12.

    Parameters
    ----------
    weight, reference, box, hard, chunk : as in :func:`solve_batch`
    soft : the row that :math:`\delta` relaxes, shape (3,) for all programs or (B, 3)
    penalty : :math:`c > 0`, finite, for all programs

    Raises
    ------
    ConfigurationError : as :func:`solve_batch`, or the penalty is not finite and positive
    """
    if not 0.0 < penalty < np.inf:
        raise ConfigurationError(f"penalty must be finite and positive, got {penalty!r}")
    row = np.asarray(soft, dtype=np.float64)[..., None, :]
    programs = Programs.read(weight, reference, box, hard, row)
    count = programs.sizes[0]
    answer = PaperBatchSolution(
        np.empty((count, 2)),
        np.empty(count),
        np.ones(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
    )
    for part in programs.chunks(chunk):
        here = part.place
        blank = part.clear_blank_rows(part.hard)
        v, w, delta, feasible, verdict = _solve(part, penalty)
        verdict[part.invalid] = DELICATE  # NaN, or a number that overflows floats only
        for at in np.flatnonzero(verdict == DELICATE).tolist():
            weight, nominal, box, (hard, (soft_row,)) = part.one(at)
            exact = paper_program(weight, nominal, box, hard, soft_row, float(penalty))
            v[at], w[at], delta[at], feasible[at] = exact
            answer.delicate[here][at] = True
        if blank is not None:
            feasible &= ~blank.any(axis=0)
        answer.twist[here, 0], answer.twist[here, 1] = v, w
        answer.delta[here], answer.feasible[here] = delta, feasible
    return answer


@np.errstate(all="ignore")  # columns whose result is not used may divide by zero
def _solve(part: Chunk, penalty: float) -> tuple[Array, Array, Array, Mask, Flags]:
    """Without the soft row, then with it where it is not met: v, omega, delta and verdicts."""
    hard, soft = part.rows[: part.hard], part.rows[part.hard]
    v, w, verdict, _ = project(part.objective, part.box, hard)
    feasible = verdict != EMPTY
    at = np.flatnonzero(~feasible)
    if at.size:
        v[at], w[at], _, verdict[at] = least_violation(
            part.box.take(at, axis=1), hard.take(at, axis=2), hard[:0].take(at, axis=2)
        )
    delta = excess(soft, v, w)
    at = np.flatnonzero((delta > 0.0) & (verdict == FINE) & feasible)
    if at.size:
        plain = part.objective.take(at)
        row = soft.take(at, axis=1)
        stern = Objectives(plain.weight, plain.nominal, penalty, row)
        x, y, again, _ = project(stern, part.box.take(at, axis=1), hard.take(at, axis=2))
        v[at], w[at], delta[at] = x, y, excess(row, x, y)
        # That the hard rows can hold was found above; another verdict is rounding.
        verdict[at] = np.where(again == FINE, FINE, DELICATE)
    return v, w, np.maximum(delta, 0.0, out=delta), feasible, verdict
