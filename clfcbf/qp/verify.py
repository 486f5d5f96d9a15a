r"""Our own arithmetic on a solver's answer: its word is never taken.

A point :math:`z` is optimal for a convex program if and only if multipliers
:math:`\lambda \ge 0` exist with :math:`Pz + q + A^\top\lambda = 0`, :math:`Az \le b` and
:math:`\lambda^\top(b - Az) = 0`; no point is feasible if and only if some :math:`y \ge 0` has
:math:`A^\top y = 0`, :math:`b^\top y < 0` (Farkas; [BoydVandenberghe2004]_). Bounds are rows here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.nnls import nonnegative_least_squares
from clfcbf.qp.problem import Array, QuadraticProgram, Residuals

__all__ = ["is_convex", "multipliers_at", "proves_infeasible", "verify"]

_TOUCHED = 1e-6
"""Scaled distance under which a row may carry a multiplier; loose, for the gap then judges it."""

_CERTIFICATE = 1e-9
"""Largest error of a certificate of infeasibility, relative to rows of unit length."""

_CONVEX = 1e-10
"""Negative curvature taken for rounding, relative to the largest eigenvalue."""

_Duals = tuple[Array | None, Array | None]


def verify(problem: QuadraticProgram, x: Array, duals: _Duals = (None, None)) -> Residuals:
    r"""Residuals of a point, with the multipliers given or, without any, reconstructed ones.

    Parameters
    ----------
    problem : the program, its data finite (bounds and h may be infinite)
    x : shape (n,)
    duals : multipliers of the rows, shape (m,), and of the bounds, shape (n,), negative at a
        lower bound; None where the backend gave none

    Returns
    -------
    Residuals, infinite where ``x`` or a multiplier is not finite
    """
    point = np.asarray(x, dtype=np.float64)
    if point.shape != (problem.n,) or not np.isfinite(point).all():
        return Residuals(np.inf, np.inf, np.inf)
    rows, bounds = duals
    if rows is None or bounds is None:
        rows, bounds = multipliers_at(problem, point)
    if rows.shape != (problem.m,) or bounds.shape != (problem.n,):
        return Residuals(_primal(problem, point), np.inf, np.inf)
    if not (np.isfinite(rows).all() and np.isfinite(bounds).all()):
        return Residuals(_primal(problem, point), np.inf, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        return Residuals(
            _primal(problem, point),
            _dual(problem, point, rows, bounds),
            _gap(problem, point, rows, bounds),
        )


def _primal(problem: QuadraticProgram, x: Array) -> float:
    """Largest violation as a distance, so that scaling a row changes nothing."""
    lengths = np.linalg.norm(problem.G, axis=1)
    excess = problem.G @ x - problem.h
    # A zero row has no distance; its whole violation counts.
    distances = excess / np.where(lengths > 0.0, lengths, 1.0)
    worst = np.max(np.concatenate((distances, problem.lb - x, x - problem.ub)), initial=0.0)
    return float(worst / (1.0 + np.abs(x).max()))


def _dual(problem: QuadraticProgram, x: Array, rows: Array, bounds: Array) -> float:
    terms = (problem.P @ x, problem.q, problem.G.T @ rows, bounds)
    size = 1.0 + max(float(np.abs(term).max()) for term in terms)
    stationarity = np.abs(sum(terms[1:], terms[0])).max()
    lengths = np.linalg.norm(problem.G, axis=1)
    wrong = np.concatenate(
        (
            -rows * lengths,
            np.where(np.isinf(problem.ub), bounds, 0.0),
            np.where(np.isinf(problem.lb), -bounds, 0.0),
        )
    )
    return float(max(stationarity, np.max(wrong, initial=0.0)) / size)


def _gap(problem: QuadraticProgram, x: Array, rows: Array, bounds: Array) -> float:
    """Sum of complementarity terms, every one nonnegative at a feasible point."""
    slack = np.where(rows != 0.0, problem.h - problem.G @ x, 0.0)
    slack_ub = np.where(bounds > 0.0, problem.ub - x, 0.0)
    slack_lb = np.where(bounds < 0.0, x - problem.lb, 0.0)
    products = np.concatenate((rows * slack, bounds * slack_ub, -bounds * slack_lb))
    products = products[np.isfinite(products)]  # an infinite bound: counted as a wrong sign
    size = 1.0 + abs(float(x @ problem.P @ x)) + abs(float(problem.q @ x))
    return float(np.abs(products).sum() / size)


def _unit_rows(problem: QuadraticProgram) -> tuple[Array, Array, NDArray[np.intp]]:
    """Rows and finite bounds as unit rows: normals, offsets, and positions in (rows, lb, ub)."""
    eye = np.eye(problem.n)
    normals = np.concatenate((problem.G, -eye, eye))
    offsets = np.concatenate((problem.h, -problem.lb, problem.ub))
    lengths = np.linalg.norm(normals, axis=1)
    kept = np.flatnonzero(np.isfinite(offsets) & (lengths > 0.0))
    scale = lengths[kept]
    return normals[kept] / scale[:, None], offsets[kept] / scale, kept


def multipliers_at(problem: QuadraticProgram, x: Array) -> tuple[Array, Array]:
    r"""The multipliers that come nearest to stationarity at ``x``.

    :math:`\min_{\lambda\ge0} |Px + q + A^\top\lambda|` over the rows and bounds that ``x`` touches.

    Returns
    -------
    Multipliers of the rows, shape (m,), and of the bounds, shape (n,)
    """
    normals, offsets, kept = _unit_rows(problem)
    near = np.abs(normals @ x - offsets) <= _TOUCHED * (1.0 + float(np.abs(x).max()))
    values = np.zeros(problem.m + 2 * problem.n)
    if near.any():
        solved = nonnegative_least_squares(normals[near].T, -(problem.P @ x + problem.q))
        values[kept[near]] = solved
    rows = values[: problem.m]
    lengths = np.linalg.norm(problem.G, axis=1)
    rows = rows / np.where(lengths > 0.0, lengths, 1.0)
    lower, upper = values[problem.m : problem.m + problem.n], values[problem.m + problem.n :]
    return rows, upper - lower


def proves_infeasible(problem: QuadraticProgram) -> bool:
    r"""Whether a certificate was found that no point satisfies rows and bounds.

    Looks for :math:`y \ge 0` with :math:`A^\top y = 0`, :math:`b^\top y = -1` by nonnegative least
    squares. False means that none was found, not that the program is feasible.
    """
    if (problem.lb > problem.ub).any():
        return True
    zero = ~problem.G.any(axis=1)
    if (problem.h[zero] < 0.0).any():
        return True
    normals, offsets, _ = _unit_rows(problem)
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


def is_convex(problem: QuadraticProgram) -> bool:
    """Whether P is positive semidefinite, to rounding."""
    eigenvalues = np.linalg.eigvalsh(problem.P)
    return bool(eigenvalues[0] >= -_CONVEX * max(abs(eigenvalues[0]), abs(eigenvalues[-1])))
