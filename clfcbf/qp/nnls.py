r"""Nonnegative least squares, :math:`\min_{z\ge0} |Az - b|` [LawsonHanson1974]_."""

from __future__ import annotations

import numpy as np

from clfcbf.qp.problem import Array

__all__ = ["nonnegative_least_squares"]

_ROUNDING = 1e-14
"""Gradient entries below this, relative to the data, count as zero: they are rounding."""


def nonnegative_least_squares(A: Array, b: Array) -> Array:
    r"""The :math:`z \ge 0` that minimises :math:`|Az - b|_2`.

    Parameters
    ----------
    A : shape (m, n)
    b : shape (m,)

    Returns
    -------
    z of shape (n,); where the program is degenerate, one of the minimisers

    Notes
    -----
    Ends after finitely many exchanges; their number is bounded by :math:`3n + 10`, past which
    the best point so far is returned (a caller that verifies then sees a residual).
    """
    n = A.shape[1]
    z = np.zeros(n)
    free = np.zeros(n, dtype=bool)
    small = _ROUNDING * (float(np.abs(A).max(initial=0.0)) * float(np.abs(b).max(initial=0.0)))
    barred = np.zeros(n, dtype=bool)
    for _ in range(3 * n + 10):
        gradient = A.T @ (b - A @ z)
        gradient[free | barred] = -np.inf
        entering = int(np.argmax(gradient)) if n else 0
        if not n or gradient[entering] <= small:
            break
        free[entering] = True
        started = z
        while True:
            trial = np.zeros(n)
            trial[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
            blocking = free & (trial <= 0.0)
            if not blocking.any():
                z = trial
                barred[:] = False
                break
            if z is started and trial[entering] <= 0.0:
                free[entering] = False  # depends on the free columns: rounding let it in
                barred[entering] = True
                break
            step = float(np.min(z[blocking] / (z[blocking] - trial[blocking])))
            z = z + step * (trial - z)
            free &= z > 1e-15 * float(np.abs(z).max())
            z[~free] = 0.0
    return z
