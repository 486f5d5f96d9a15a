r"""The one-shot program with a quadratic slack, of many robots at once, in NumPy.

As :func:`clfcbf.qp.exact.paper_program`, with arrays and chunks as in :mod:`clfcbf.qp.batch`.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf.errors import ConfigurationError
from clfcbf.qp.batch_chunks import CHUNK, Chunk, Programs
from clfcbf.qp.batch_geometry import (
    DELICATE,
    EMPTY,
    FINE,
    NOISE,
    Array,
    Flags,
    Mask,
    excess,
    scale_of,
    size_of,
)
from clfcbf.qp.batch_objective import Objectives
from clfcbf.qp.batch_projection import least_violation, project
from clfcbf.qp.batch_sift import unsettled
from clfcbf.qp.one_shot import paper_program

__all__ = ["PaperBatchSolution", "solve_batch_paper"]

_LARGE = 4096
"""Programs of a chunk from which on it is worth solving those first whose soft row fails."""

_S = TypeVar("_S", bound=np.generic)

Answers: TypeAlias = tuple[Array, Array, Array, Mask, Flags]
"""v, omega, delta, whether feasible, verdict."""


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
        np.zeros(count),
        np.ones(count, dtype=np.bool_),
        np.zeros(count, dtype=np.bool_),
    )
    all_v, all_w = answer.twist.T
    for part in unsettled(programs, chunk, answer.twist):
        here = part.place
        blank = part.clear_blank_rows(part.hard)
        v, w, delta, feasible, verdict = _solve(part, penalty)
        if part.invalid is not None:
            verdict[part.invalid] = DELICATE  # NaN, or a number that overflows floats only
        delicate = verdict == DELICATE
        for at in np.flatnonzero(delicate).tolist():
            weight, nominal, box, (hard, (soft_row,)) = part.one(at)
            exact = paper_program(weight, nominal, box, hard, soft_row, float(penalty))
            v[at], w[at], delta[at], feasible[at] = exact
        if blank is not None:
            feasible &= ~blank.any(axis=0)
        all_v[here], all_w[here] = v, w
        answer.delta[here], answer.feasible[here] = delta, feasible
        answer.delicate[here] = delicate
    return answer


@np.errstate(all="ignore")  # columns whose result is not used may divide by zero
def _solve(part: Chunk, penalty: float) -> Answers:
    """Where the soft row fails in the box, at once with it: it most likely fails in the end too.

    If the minimum with its cost still has a slack, so has the one without, and it stands.
    """
    over = excess(part.rows[part.hard], *part.objective.minimum_in(part.box))
    fails = over > 0.0
    trying = np.flatnonzero(fails)
    if not trying.size or fails.size < _LARGE:
        return _in_order(part, penalty, fails)
    some = part.take(trying) if trying.size < over.size else part
    v, w, delta, verdict, stands = _with_soft(some, penalty)
    if some is part and stands.all():
        return v, w, delta, stands, verdict
    left = np.ones(over.shape, dtype=np.bool_)
    left[trying[stands]] = False
    rest = np.flatnonzero(left)
    x, y, slack, feasible, again = _in_order(part.take(rest), penalty, fails.take(rest))

    def joined(early: NDArray[_S], late: NDArray[_S]) -> NDArray[_S]:
        column = np.empty(over.shape, dtype=late.dtype)
        column[trying], column[rest] = early, late
        return column

    return (
        joined(v, x),
        joined(w, y),
        joined(delta, slack),
        joined(stands, feasible),
        joined(verdict, again),
    )


def _in_order(part: Chunk, penalty: float, fails: Mask) -> Answers:
    """Without the soft row, then with it where it is not met; ``fails``: where not in the box.

    Where floats cannot answer without it, but can with it, they do as :func:`_solve` does.
    """
    hard, soft = part.rows[: part.hard], part.rows[part.hard]
    v, w, verdict, _ = project(part.objective, part.box, hard)
    feasible = verdict != EMPTY
    doubtful = verdict == DELICATE
    at = np.flatnonzero(~feasible)
    if at.size:
        v[at], w[at], _, verdict[at] = least_violation(
            part.box.take(at, axis=1), hard.take(at, axis=2), hard[:0].take(at, axis=2)
        )
    delta = excess(soft, v, w)
    wanting = np.where(doubtful, fails, delta > 0.0)
    wanting &= feasible
    at = np.flatnonzero(wanting)
    if at.size:
        v[at], w[at], delta[at], again, stands = _with_soft(part.take(at), penalty)
        # That the hard rows can hold was found above; another verdict is rounding.
        fine = (again == FINE) & (stands | ~doubtful.take(at))
        verdict[at] = np.where(fine, FINE, DELICATE)
    return v, w, np.maximum(delta, 0.0, out=delta), feasible, verdict


def _with_soft(part: Chunk, penalty: float) -> tuple[Array, Array, Array, Flags, Mask]:
    """The minimum with the soft row's cost: v, omega, the row's residual, verdict.

    Last, where it answers the program whatever the minimum without that cost is: the row fails
    there with room for rounding.
    """
    row = part.rows[part.hard]
    stern = Objectives(part.objective.weight, part.objective.nominal, penalty, row)
    v, w, verdict, _ = project(stern, part.box, part.rows[: part.hard])
    delta = excess(row, v, w)
    stands: Mask = delta > NOISE * scale_of(part.box) * size_of(row)
    stands &= verdict == FINE
    return v, w, delta, verdict, stands
