r"""The exact two-input programs of many robots at once, in NumPy.

The programs of :func:`clfcbf.qp.exact.solve_lexicographic` side by side: the same geometry on
arrays, chunk by chunk, so that the time grows linearly and only arguments and answer grow in
memory. A program that floats cannot answer to 1e-12 is solved on its own by the exact path, so
an answer depends neither on its neighbours nor on the size of the chunks.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clfcbf.qp.batch_chunks import CHUNK, Chunk, Programs
from clfcbf.qp.batch_geometry import DELICATE, EMPTY, Array, Flags, Mask, excess
from clfcbf.qp.batch_projection import least_violation, project, unit_rows
from clfcbf.qp.batch_sift import unsettled
from clfcbf.qp.lexicographic import solve_lexicographic

__all__ = ["CHUNK", "BatchSolution", "BatchStatus", "ChunkSolution", "solve_batch", "solve_chunk"]


class BatchStatus(IntEnum):
    """How a program of a batch ended."""

    SOLVED = 0
    """Every row holds."""
    RELAXED = 1
    """Some row does not hold as it was given: a slack, or a row ``(0, 0, b)`` with ``b < 0``."""
    INVALID = 2
    """A number is not finite (or overflows) or the box is reversed; the command is NaN."""


class BatchSolution(NamedTuple):
    """Answers of :func:`solve_batch`, one row a program.

    Attributes
    ----------
    twist : commands (v, omega) [m/s], [rad/s], shape (B, 2); inside the box to the last bit
    slacks : of the hard and of the soft rows, shape (B, 2) [units of the command], as
        ``LexicographicSolution.slacks``
    status : values of :class:`BatchStatus`, shape (B,)
    violated : rows ``(0, 0, b)`` with ``b < 0``, which no command meets, shape (B, m + k)
    delicate : solved on its own by the exact path, shape (B,)
    """

    twist: Array
    slacks: Array
    status: Flags
    violated: Mask
    delicate: Mask


def solve_batch(
    weight: ArrayLike,
    nominal: ArrayLike,
    box: ArrayLike,
    hard: ArrayLike,
    soft: ArrayLike | None = None,
    *,
    chunk: int = CHUNK,
) -> BatchSolution:
    r"""For each program the command nearest to the nominal one that gives up as little as it must.

    .. math:: \min_u\ \tfrac12 (u-\bar u)^\top Q (u-\bar u)
              \quad\text{s.t.}\quad u \in \text{box},\quad a_i^\top u \le b_i + s_{\ell(i)}|a_i|

    with the slack of the hard rows as small as the box allows, and that of the soft rows as
    small as box and hard rows allow [Kerrigan2002]_. Equal to
    :func:`clfcbf.qp.exact.solve_lexicographic`, program by program, to 1e-12.

    Parameters
    ----------
    weight : ``(q11, q12, q22)``, shape (3,) for all programs or (B, 3), positive definite
    nominal : ``(v, omega)`` [m/s], [rad/s], shape (B, 2)
    box : ``(v_lo, v_hi, w_lo, w_hi)``, shape (4,) for all programs or (B, 4)
    hard : rows ``(a_v, a_w, b)`` that say ``a_v v + a_w omega <= b``, shape (m, 3) for all
        programs or (B, m, 3)
    soft : rows that give way to the hard ones, shape (k, 3) or (B, k, 3)
    chunk : programs worked on at a time; changes the speed only

    Raises
    ------
    ConfigurationError : an argument has another shape, a weight is not positive definite, or
        ``chunk`` is not positive

    Notes
    -----
    Fast where the least violation is at one corner. Where a whole side of the box would do, for
    a row along it that cannot hold, the program takes the exact path: 20 microseconds.
    """
    programs = Programs.read(weight, nominal, box, hard, soft)
    count, _, rows = programs.sizes
    answer = BatchSolution(
        np.empty((count, 2)),
        np.zeros((count, 2)),
        np.zeros(count, dtype=np.uint8),
        np.zeros((count, rows), dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
    )
    # Columns one by one: NumPy scatters whole rows five times more slowly.
    v, w, slack_hard, slack_soft = *answer.twist.T, *answer.slacks.T
    for part in unsettled(programs, chunk, answer.twist):
        here, solved = part.place, solve_chunk(part)
        v[here], w[here], answer.status[here] = solved.v, solved.w, solved.status
        slack_hard[here], slack_soft[here] = solved.slacks
        answer.delicate[here] = solved.delicate
        if solved.violated is not None:
            answer.violated[here] = solved.violated.T
    return answer


class ChunkSolution(NamedTuple):
    """Answers of :func:`solve_chunk`, a column each, as :class:`BatchSolution` has them.

    ``violated`` is None where no row is.
    """

    v: Array
    w: Array
    slacks: Array
    status: Flags
    violated: Mask | None
    delicate: Mask


def solve_chunk(part: Chunk) -> ChunkSolution:
    """Solve the programs of a chunk; its rows ``(0, 0, b)`` are overwritten."""
    violated = part.clear_blank_rows()
    v, w, slacks, verdict = _solve(part)
    relaxed = (slacks[0] > 0.0) | (slacks[1] > 0.0)
    delicate: Mask = verdict == DELICATE
    if part.invalid is not None:
        delicate &= ~part.invalid
    for at in np.flatnonzero(delicate).tolist():
        exact = solve_lexicographic(*part.one(at))
        assert exact is not None  # its data is finite and its box is not reversed
        v[at], w[at], slacks[:, at] = exact.v, exact.omega, exact.slacks
        relaxed[at] = exact.relaxed
    if violated is not None:
        relaxed |= violated.any(axis=0)
    status = np.where(relaxed, np.uint8(BatchStatus.RELAXED), np.uint8(BatchStatus.SOLVED))
    if part.invalid is not None:
        v[part.invalid] = w[part.invalid] = slacks[:, part.invalid] = np.nan
        status[part.invalid] = BatchStatus.INVALID
    return ChunkSolution(v, w, slacks, status, violated, delicate)


@np.errstate(all="ignore")  # columns whose result is not used may divide by zero
def _solve(part: Chunk) -> tuple[Array, Array, Array, Flags]:
    """v, omega, slacks of shape (2, n), verdict."""
    v, w, verdict, failed = project(part.objective, part.box, part.rows)
    slacks = np.zeros((2, v.size))
    if not (empty := verdict == EMPTY).any():
        return v, w, slacks, verdict
    hard_failed = failed < part.hard
    if (at := np.flatnonzero(empty & ~hard_failed)).size:
        box, rows = part.box.take(at, axis=1), part.rows.take(at, axis=2)
        v[at], w[at], slacks[1, at], some = least_violation(
            box, rows[part.hard :], rows[: part.hard]
        )
        verdict[at] = some
    if (at := np.flatnonzero(empty & hard_failed)).size:
        box, rows = part.box.take(at, axis=1), part.rows.take(at, axis=2)
        x, y, slacks[0, at], some = least_violation(box, rows[: part.hard], rows[:0])
        if rows.shape[0] > part.hard:
            # The hard rows leave one point, so the soft slack is what they lack there.
            units, lengths = unit_rows(rows[part.hard :])
            over = np.stack([excess(row, x, y) for row in units])
            slacks[1, at] = np.maximum(over.max(axis=0), 0.0)
            some = np.maximum(some, lengths)
        v[at], w[at], verdict[at] = x, y, some
    return v, w, slacks, verdict
