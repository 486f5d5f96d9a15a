r"""Proofs that a program has no answer: of infeasibility, and of a cost without a lower bound.

No point satisfies :math:`Az \le b` if and only if some :math:`y \ge 0` has :math:`A^\top y = 0`
and :math:`b^\top y < 0` (Farkas); the cost of a feasible program falls without end if and only
if a direction :math:`d` has :math:`Pd = 0`, :math:`Ad \le 0` and :math:`q^\top d < 0`
[BoydVandenberghe2004]_. Equalities and bounds are rows here.
"""

from __future__ import annotations

import numpy as np

from clfcbf.qp.nnls import nonnegative_least_squares
from clfcbf.qp.problem import QuadraticProgram
from clfcbf.qp.verify import unit_rows

__all__ = ["proves_infeasible", "proves_unbounded"]

_CERTIFICATE = 1e-9
"""Largest error of a certificate, relative to rows of unit length."""


def proves_infeasible(problem: QuadraticProgram) -> bool:
    r"""Whether a certificate was found that no point satisfies rows and bounds.

    Looks for :math:`y \ge 0` with :math:`A^\top y = 0`, :math:`b^\top y = -1` by nonnegative least
    squares. False means that none was found, not that the program is feasible.
    """
    if (problem.lb > problem.ub).any():
        return True
    if (problem.h[~problem.G.any(axis=1)] < 0.0).any():
        return True
    if problem.b[~problem.A.any(axis=1)].any():
        return True
    normals, offsets, _, _ = unit_rows(problem)
    if not offsets.size:
        return False
    # Offsets to order one: the certificate then weighs its two parts alike.
    scale = max(1.0, float(np.abs(offsets).max()))
    system = np.vstack((normals.T, offsets[None, :] / scale))
    target = np.zeros(problem.n + 1)
    target[-1] = -1.0
    y = nonnegative_least_squares(system, target)
    left = normals.T @ y
    total = float(offsets @ y) / scale
    return total < 0.0 and float(np.abs(left).max()) <= _CERTIFICATE * -total


def proves_unbounded(problem: QuadraticProgram) -> bool:
    r"""Whether a direction was found along which the cost of a feasible point falls without end.

    Looks for :math:`d = d^+ - d^-` and slacks :math:`s \ge 0` with :math:`Pd = 0`,
    :math:`Ad + s = 0` and :math:`q^\top d = -1` by nonnegative least squares. False means that
    none was found.
    """
    n = problem.n
    if not problem.q.any():
        return False
    normals, _, _, _ = unit_rows(problem)
    k = normals.shape[0]
    size = float(np.abs(problem.P).max())
    P = problem.P / size if size > 0.0 else problem.P
    q = problem.q / float(np.abs(problem.q).max())
    system = np.block(
        [
            [P, -P, np.zeros((n, k))],
            [normals, -normals, np.eye(k)],
            [q[None, :], -q[None, :], np.zeros((1, k))],
        ]
    )
    target = np.zeros(n + k + 1)
    target[-1] = -1.0
    y = nonnegative_least_squares(system, target)
    d = y[:n] - y[n : 2 * n]
    drop = -float(q @ d)
    error = max(
        float(np.abs(P @ d).max()), float(np.max(normals @ d, initial=0.0)), abs(drop - 1.0)
    )
    return drop > 0.0 and error <= _CERTIFICATE * (1.0 + float(np.abs(d).max()))
