r"""From a solver's approximate answer to the exact one: name the active rows, solve for them.

With the active rows :math:`W` known the answer is that of linear equations

.. math:: \begin{pmatrix} P & C_W^\top \\ C_W & 0 \end{pmatrix}
          \begin{pmatrix} y \\ \lambda_W \end{pmatrix} =
          \begin{pmatrix} -q \\ b_W \end{pmatrix},

exact to rounding whatever the solver's tolerance was. A guess that is wrong in a few rows is
put right by exchanging them one by one [NocedalWright2006]_; an answer is only returned if every
row and every sign holds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.nnls import nonnegative_least_squares
from clfcbf.qp.problem import Array
from clfcbf.qp.reduction import Form

__all__ = ["is_exact", "polish"]

_EXACT = 1e-11
"""Violation and wrong sign taken for rounding; numbers are of order one here."""

_SETTLED = 1e-13
"""Residual of an answer that a solve for the active rows would not improve: a hundred roundings."""

_NEAR = 1e-5
"""Distance under which a row may be active where the solver's multipliers do not tell."""

_DEPENDENT = 1e-9
"""A row this close to the span of others adds nothing to them but rounding."""

_EXCHANGES = 10
"""Rows exchanged, beside one a variable, before a guess is given up: solvers err in one or two."""

_Sides = NDArray[np.int8]


def is_exact(form: Form, y: Array, dual: Array | None) -> bool:
    """Whether every condition of optimality holds to rounding.

    Parameters
    ----------
    form, y, dual : as of :func:`polish`
    """
    if dual is None or not (np.isfinite(y).all() and np.isfinite(dual).all()):
        return False
    values = form.C @ y
    above, below = form.upper - values, values - form.lower
    near = _SETTLED * (1.0 + float(np.abs(y).max()))
    strong = _SETTLED * (1.0 + float(np.abs(dual).max(initial=0.0)))
    pull = form.P @ y + form.q + dual @ form.C
    if np.abs(pull).max() > strong or np.minimum(above, below).min(initial=0.0) < -near:
        return False
    # A multiplier acts at its own side only.
    idle = np.minimum(np.abs(dual), np.where(dual > 0.0, above, below))
    return bool(idle.max(initial=0.0) <= near)


def polish(form: Form, y: Array, dual: Array | None) -> tuple[Array, Array] | None:
    """The exact answer near an approximate one, or None where it was not found.


    Parameters
    ----------
    form : the program
    y : approximate answer, shape (n,)
    dual : approximate multipliers, positive at an upper side, shape (k,), or None

    Returns
    -------
    Answer and multipliers
    """
    if not np.isfinite(y).all():
        return None
    values = form.C @ y
    above, below = form.upper - values, values - form.lower
    if dual is not None and np.isfinite(dual).all():
        # At a row that matters the multiplier outweighs the distance, and elsewhere the reverse.
        found = _exchange(form, _sides(form, dual > above, -dual > below), np.abs(dual))
        if found is not None:
            return found
    near = _NEAR * (1.0 + float(np.abs(y).max()))
    at_upper, at_lower = above <= near, below <= near
    touched = np.concatenate((form.C[at_upper], -form.C[at_lower]))
    if not touched.size:
        return _exchange(form, _sides(form, at_upper, at_lower), above)
    push = nonnegative_least_squares(touched.T, -(form.P @ y + form.q))
    forces = np.zeros(above.size)
    forces[at_upper] = push[: int(at_upper.sum())]
    forces[at_lower] -= push[int(at_upper.sum()) :]
    return _exchange(form, _sides(form, forces > 0.0, forces < 0.0), np.abs(forces))


def _sides(form: Form, upper: NDArray[np.bool_], lower: NDArray[np.bool_]) -> _Sides:
    """1 where the upper side is active, -1 where the lower one is, 0 where none is."""
    sides: _Sides = upper.astype(np.int8) - lower.astype(np.int8)
    sides[: form.equal] = 1
    return sides


def _independent(form: Form, sides: _Sides, weight: Array) -> list[int]:
    """Active rows, equalities and large weights first, without those that depend on others."""
    active = np.flatnonzero(sides)
    if active.size <= 1:
        return list(active)
    order = sorted(active, key=lambda i: (i >= form.equal, -weight[i]))
    basis: list[Array] = []
    kept: list[int] = []
    for i in order:
        row = form.C[i]
        rest = row
        for _ in range(2):  # twice: once leaves rounding of the first subtraction behind
            for direction in basis:
                rest = rest - (direction @ rest) * direction
        length = float(np.sqrt(rest @ rest))
        if length > _DEPENDENT * float(np.sqrt(row @ row)):
            basis.append(rest / length)
            kept.append(int(i))
        if len(kept) == form.q.size:
            break
    return sorted(kept)


def _exchange(form: Form, sides: _Sides, weight: Array) -> tuple[Array, Array] | None:
    """Solve for the active rows; drop one that pulls, else add one that is violated; repeat."""
    P, q, C, lower, upper, equal = form
    n = q.size
    weight = np.array(weight)
    for _ in range(_EXCHANGES + n):
        active = _independent(form, sides, weight)
        count = len(active)
        system = np.zeros((n + count, n + count))
        system[:n, :n] = P
        system[:n, n:] = C[active].T
        system[n:, :n] = C[active]
        right = np.concatenate((-q, np.where(sides[active] > 0, upper[active], lower[active])))
        try:
            solved = np.linalg.solve(system, right)
        except np.linalg.LinAlgError:
            return None
        y, force = solved[:n], solved[n:]
        if not np.isfinite(solved).all():
            return None
        pulls = -force * sides[active]
        pulls[: sum(i < equal for i in active)] = 0.0
        values = C @ y
        violation = np.maximum(values - upper, lower - values)
        size = _EXACT * (1.0 + float(np.abs(y).max()))
        worst = int(np.argmax(pulls)) if count else 0
        if count and pulls[worst] > _EXACT * (1.0 + float(np.abs(force).max())):
            sides[active[worst]] = 0
        elif violation.size and violation.max() > size:
            added = int(np.argmax(violation))
            if added < equal:
                return None
            sides[added] = 1 if values[added] > upper[added] else -1
            weight[added] = np.inf  # stays, should the set become dependent
        else:
            dual = np.zeros(lower.size)
            dual[active] = force
            return y, dual
    return None
