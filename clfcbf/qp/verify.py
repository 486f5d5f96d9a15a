r"""Our own arithmetic on a solver's answer: its word is never taken.

A point :math:`z` is optimal for a convex program if and only if multipliers
:math:`\lambda \ge 0` and :math:`\nu` exist with :math:`Pz + q + G^\top\lambda + A^\top\nu = 0`,
:math:`Gz \le h`, :math:`Az = b` and :math:`\lambda^\top(h - Gz) = 0` [BoydVandenberghe2004]_.
Bounds are rows here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.qp.nnls import nonnegative_least_squares
from clfcbf.qp.problem import Array, QuadraticProgram, Residuals

__all__ = ["Duals", "is_convex", "multipliers_at", "unit_rows", "verify"]

_TOUCHED = 1e-6
"""Scaled distance under which a row may carry a multiplier; loose, for the gap then judges it."""

_CONVEX = 1e-10
"""Curvature taken for rounding, relative to the largest eigenvalue."""


class Duals(NamedTuple):
    r"""Multipliers; None where there are none to be had.

    Attributes
    ----------
    rows : of :math:`Gz \le h`, nonnegative, shape (m,)
    bounds : of the bounds, shape (n,), negative at a lower bound
    equalities : of :math:`Az = b`, shape (p,)
    """

    rows: Array | None = None
    bounds: Array | None = None
    equalities: Array | None = None

    def fits(self, problem: QuadraticProgram) -> bool:
        """Whether all are there, of the right shape and finite; of no rows None will do."""
        for dual, size in zip(self, (problem.m, problem.n, problem.p), strict=True):
            if dual is None:
                if size:
                    return False
            elif np.shape(dual) != (size,) or not np.isfinite(dual).all():
                return False
        return True


def verify(problem: QuadraticProgram, x: Array, duals: Duals | None = None) -> Residuals:
    """Residuals of a point, with the multipliers given or, without any, reconstructed ones.

    Scaling a row changes nothing, nor does scaling the cost.

    Parameters
    ----------
    problem : the program, its data finite (bounds and h may be infinite)
    x : shape (n,)
    duals : multipliers that belong to it

    Returns
    -------
    Residuals, infinite where ``x`` or a multiplier is not finite
    """
    point = np.asarray(x, dtype=np.float64)
    if point.shape != (problem.n,) or not np.isfinite(point).all():
        return Residuals(np.inf, np.inf, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        primal = _primal(problem, point)
        if duals is None:
            duals = multipliers_at(problem, point)
        if not duals.fits(problem):
            return Residuals(primal, np.inf, np.inf)
        rows, bounds, equalities = (np.zeros(0) if dual is None else dual for dual in duals)
        return Residuals(primal, *_optimality(problem, point, rows, bounds, equalities))


def _lengths(rows: Array) -> Array:
    """Of the rows; 1 for a zero row, which has no distance, so that its whole violation counts."""
    lengths: Array = np.hypot.reduce(np.abs(rows), axis=1, initial=0.0)
    return np.where(lengths > 0.0, lengths, 1.0)


def _primal(problem: QuadraticProgram, x: Array) -> float:
    """Largest violation as a distance."""
    distances = (
        (problem.G @ x - problem.h) / _lengths(problem.G),
        np.abs(problem.A @ x - problem.b) / _lengths(problem.A),
        problem.lb - x,
        x - problem.ub,
    )
    worst = np.max(np.concatenate(distances), initial=0.0)
    return float(worst / (1.0 + np.abs(x).max()))


def _optimality(
    problem: QuadraticProgram, x: Array, rows: Array, bounds: Array, equalities: Array
) -> tuple[float, float]:
    """Stationarity with the multipliers' signs, and complementarity."""
    P, G, A = problem.P, problem.G, problem.A
    slope = P @ x
    left = slope + problem.q + G.T @ rows + A.T @ equalities + bounds
    # Each entry against its own terms: a large force in one entry excuses nothing in another.
    terms = (
        np.abs(slope),  # not |P||x|: far out along a flat direction that would excuse anything
        np.abs(problem.q),
        np.abs(G).T @ np.abs(rows),
        np.abs(A).T @ np.abs(equalities),
        np.abs(bounds),
    )
    curvature = P.diagonal()
    size = np.max(terms, axis=0) + np.where(
        curvature > 0.0, curvature, curvature.max() if curvature.any() else 1.0
    )
    push = np.max(np.abs(G) / size, axis=1, initial=0.0)  # of a row with multiplier one
    wrong = (
        np.abs(left) / size,
        -rows * push,
        np.where(np.isinf(problem.ub), bounds, 0.0) / size,
        np.where(np.isinf(problem.lb), -bounds, 0.0) / size,
    )
    slack = (problem.h - G @ x) / _lengths(G)
    slack_bounds = np.where(bounds > 0.0, problem.ub - x, x - problem.lb)
    gaps = (
        np.minimum(np.abs(slack) / (1.0 + np.abs(x).max()), np.abs(rows) * push),
        np.minimum(np.abs(slack_bounds) / (1.0 + np.abs(x).max()), np.abs(bounds) / size),
    )
    dual = float(np.max(np.concatenate(wrong), initial=0.0))
    return dual, float(np.max(np.concatenate(gaps), initial=0.0))


def unit_rows(problem: QuadraticProgram) -> tuple[Array, Array, NDArray[np.intp], Array]:
    """All rows as inequalities of unit length, those at infinity and zero rows left out.

    Returns
    -------
    Normals, shape (k, n), offsets, shape (k,), positions in the stack of G, lower bounds, upper
    bounds, A, and -A, shape (k,), and the lengths that were divided by, shape (k,)
    """
    eye = np.eye(problem.n)
    normals = np.concatenate((problem.G, -eye, eye, problem.A, -problem.A))
    offsets = np.concatenate((problem.h, -problem.lb, problem.ub, problem.b, -problem.b))
    # First to order one by a power of two, lest the squares overflow.
    largest = np.max(np.abs(normals), axis=1, initial=0.0)
    kept = np.flatnonzero(np.isfinite(offsets) & (largest > 0.0))
    _, exponents = np.frexp(largest[kept])
    normals = np.ldexp(normals[kept], -exponents[:, None])
    lengths = np.linalg.norm(normals, axis=1)
    return (
        normals / lengths[:, None],
        np.ldexp(offsets[kept], -exponents) / lengths,
        kept,
        np.ldexp(lengths, exponents),
    )


def multipliers_at(problem: QuadraticProgram, x: Array) -> Duals:
    r"""The multipliers that come nearest to stationarity at ``x``.

    :math:`\min |Px + q + G^\top\lambda + A^\top\nu|` over :math:`\lambda \ge 0` of the rows and
    bounds that ``x`` touches.
    """
    normals, offsets, kept, lengths = unit_rows(problem)
    near = np.abs(normals @ x - offsets) <= _TOUCHED * (1.0 + float(np.abs(x).max()))
    n, m, p = problem.n, problem.m, problem.p
    values = np.zeros(m + 2 * n + 2 * p)
    if near.any():
        solved = nonnegative_least_squares(normals[near].T, -(problem.P @ x + problem.q))
        values[kept[near]] = solved / lengths[near]
    rows, lower, upper, plus, minus = np.split(values, np.cumsum((m, n, n, p)))
    return Duals(rows, upper - lower, plus - minus)


def is_convex(problem: QuadraticProgram, strictly: bool = False) -> bool:
    """Whether P is positive semidefinite, to rounding; with ``strictly``, positive definite."""
    P = problem.P
    # Diagonal to order one: badly scaled variables do not make a program less convex.
    diagonal = P.diagonal()
    if (diagonal < 0.0).any():
        return False
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    eigenvalues = np.linalg.eigvalsh(P / scale / scale[:, None])
    noise = _CONVEX * float(np.abs(eigenvalues).max())
    return bool(eigenvalues[0] > noise if strictly else eigenvalues[0] >= -noise)
