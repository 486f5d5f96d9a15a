r"""A program in the one form that every solver gets, its numbers brought to order one.

.. math:: \min_y\ \tfrac12 y^\top P y + q^\top y \quad\text{s.t.}\quad l \le C y \le u

with equalities first, bounds as rows, rows that say nothing left out. Every scale is a power of
two, so nothing is rounded: the form is the same program to the last bit, and solvers whose
tolerances are absolute treat large and small, row and copy, alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.problem import Array, QuadraticProgram
from clfcbf.qp.verify import Duals

__all__ = ["Form", "Reduction", "reduce"]

_STRETCH = 20
"""Largest exponent by which a variable is stretched: a flat cost is not made a steep one."""


class Form(NamedTuple):
    """The reduced program.

    Attributes
    ----------
    P, q : cost, shapes (n, n) and (n,); diagonal of P within a factor of four of one
    C : rows, shape (k, n), each of length one to two
    lower, upper : shape (k,), infinite entries for none
    equal : number of rows at the start that are equalities, ``lower == upper``
    """

    P: Array
    q: Array
    C: Array
    lower: Array
    upper: Array
    equal: int

    @property
    def shape(self) -> tuple[int, int, int, bytes, bytes]:
        """What two programs must share for one workspace: sizes, and which sides are infinite."""
        return (
            self.q.size,
            self.lower.size,
            self.equal,
            np.isfinite(self.lower).tobytes(),
            np.isfinite(self.upper).tobytes(),
        )

    def one_sided(self) -> tuple[Array, Array]:
        """The inequalities as ``G y <= h``, the upper sides before the lower ones."""
        C, lower, upper = (part[self.equal :] for part in (self.C, self.lower, self.upper))
        above, below = np.isfinite(upper), np.isfinite(lower)
        return (
            np.concatenate((C[above], -C[below])),
            np.concatenate((upper[above], -lower[below])),
        )

    def two_sided_dual(self, equalities: Array, one_sided: Array) -> Array:
        """Multipliers of the rows from those of equalities and of :meth:`one_sided`."""
        above = np.isfinite(self.upper[self.equal :])
        below = np.isfinite(self.lower[self.equal :])
        split = int(above.sum())
        dual = np.zeros(above.size)
        dual[above] += one_sided[:split]
        dual[below] -= one_sided[split:]
        return np.concatenate((equalities, dual))


class Reduction(NamedTuple):
    """A form and the way back from it.

    Attributes
    ----------
    form : the reduced program
    kept : positions of its rows in the stack of A, G and the bounds
    sizes : (p, m, n) of the program
    variables : what ``y`` is multiplied by to give ``z``, shape (n,)
    forces : what a multiplier is multiplied by to give the program's, shape (k,)
    """

    form: Form
    kept: NDArray[np.intp]
    sizes: tuple[int, int, int]
    variables: Array
    forces: Array

    def restore(self, y: Array, dual: Array | None) -> tuple[Array, Duals]:
        """The point and the multipliers in the program's own units."""
        if dual is None:
            return y * self.variables, Duals()
        p, m, n = self.sizes
        values = np.zeros(p + m + n)
        values[self.kept] = dual * self.forces
        return y * self.variables, Duals(values[p : p + m], values[p + m :], values[:p])


def _exponents(values: Array) -> NDArray[np.intc]:
    """Those that bring each value to [1/2, 1) when subtracted."""
    return np.frexp(values)[1]


def reduce(problem: QuadraticProgram) -> Reduction | None:
    """The reduced form, or None where a zero row or a reversed bound admits no point at all.

    Parameters
    ----------
    problem : well-posed
    """
    n, m, p = problem.n, problem.m, problem.p
    rows = np.concatenate((problem.A, problem.G, np.eye(n)))
    lower = np.concatenate((problem.b, np.full(m, -np.inf), problem.lb))
    upper = np.concatenate((problem.b, problem.h, problem.ub))
    # Variables: the diagonal of the cost to order one, and the cost with it.
    diagonal = problem.P.diagonal()
    positive = diagonal > 0.0
    steepest = _exponents(diagonal.max(keepdims=True)) if positive.any() else np.zeros(1, np.intc)
    stretch = np.where(positive, (steepest - _exponents(diagonal)) // 2, 0)
    stretch = np.minimum(stretch, _STRETCH)
    rows = np.ldexp(rows, stretch)
    # Rows: length to order one.
    largest = np.max(np.abs(rows), axis=1)
    blank = largest == 0.0
    if (lower > upper).any() or (lower[blank] > 0.0).any() or (upper[blank] < 0.0).any():
        return None
    kept = np.flatnonzero(~blank & (np.isfinite(lower) | np.isfinite(upper)))
    equalities = lower[kept] == upper[kept]
    kept = np.concatenate((kept[equalities], kept[~equalities]))
    shorten = -_exponents(largest[kept])
    C = np.ldexp(rows[kept], shorten[:, None])
    lower, upper = np.ldexp(lower[kept], shorten), np.ldexp(upper[kept], shorten)
    # Unit of length: how far the minimum without rows is, or the farthest row that excludes zero.
    q = np.ldexp(problem.q, stretch - steepest)
    far = np.max(np.concatenate((np.abs(q), lower, -upper)), initial=0.0)
    unit = int(_exponents(np.array([far]))[0]) if far > 0.0 else 0
    form = Form(
        np.ldexp(problem.P, stretch + stretch[:, None] - steepest),
        np.ldexp(q, -unit),
        C,
        np.ldexp(lower, -unit),
        np.ldexp(upper, -unit),
        int(equalities.sum()),
    )
    variables = np.ldexp(1.0, stretch + unit)
    return Reduction(form, kept, (p, m, n), variables, np.ldexp(1.0, shorten + steepest + unit))
