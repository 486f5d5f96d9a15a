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
        far = 1.0 + float(np.abs(point).max())
        excess = problem.G @ point - problem.h
        if problem.m:
            excess /= _lengths(problem.G)
        primal = max(_largest(excess), _largest(problem.lb - point), _largest(point - problem.ub))
        if problem.p:
            missed = np.abs(problem.A @ point - problem.b) / _lengths(problem.A)
            primal = max(primal, _largest(missed))
        primal /= far
        if duals is None:
            duals = multipliers_at(problem, point)
        if not duals.fits(problem):
            return Residuals(primal, np.inf, np.inf)
        rows, bounds, equalities = (np.zeros(0) if dual is None else dual for dual in duals)
        slope = problem.P @ point
        push, size = _forces(problem, slope, rows, bounds, equalities)
        left = slope + problem.q + bounds
        if problem.m:
            left += problem.G.T @ rows
        if problem.p:
            left += problem.A.T @ equalities
        nobody = np.where(bounds > 0.0, np.isinf(problem.ub), np.isinf(problem.lb))
        dual = max(
            _largest(np.abs(left) / size),
            _largest(-rows * push),
            _largest(np.abs(bounds) * nobody / size),
        )
        room = np.where(bounds > 0.0, problem.ub - point, point - problem.lb)
        gap = max(
            _largest(np.minimum(np.abs(excess) / far, np.abs(rows) * push)),
            _largest(np.minimum(np.abs(room) / far, np.abs(bounds) / size)),
        )
    return Residuals(primal, dual, gap)


def _largest(values: Array) -> float:
    """The largest entry, at least zero; infinity where one is not a number."""
    largest = float(values.max(initial=0.0))
    return np.inf if np.isnan(largest) else largest


def _lengths(rows: Array) -> Array:
    """Of the rows; 1 for a zero row, which has no distance, so that its whole violation counts."""
    lengths: Array = np.hypot.reduce(np.abs(rows), axis=1, initial=0.0)
    lengths[lengths == 0.0] = 1.0
    return lengths


def _forces(
    problem: QuadraticProgram, slope: Array, rows: Array, bounds: Array, equalities: Array
) -> tuple[Array, Array]:
    """What each row pushes with a multiplier of one, and the size that an entry is judged by.

    Each entry against its own terms: a large force in one entry excuses nothing in another. Of
    the cost that is :math:`|Pz|`, not :math:`|P||z|`, which far out along a flat direction would
    excuse anything.
    """
    curvature = problem.P.diagonal()
    if not curvature.all():
        curvature = np.where(curvature > 0.0, curvature, curvature.max() or 1.0)
    size = np.maximum(np.maximum(np.abs(slope), np.abs(problem.q)), np.abs(bounds))
    if problem.p:
        size = np.maximum(size, np.abs(problem.A).T @ np.abs(equalities))
    if not problem.m:
        return np.zeros(0), size + curvature
    G = np.abs(problem.G)
    size = np.maximum(size, G.T @ np.abs(rows)) + curvature
    return (G / size).max(axis=1), size


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
    if diagonal.min() < 0.0:
        return False
    scale = np.sqrt(diagonal)
    scale[scale == 0.0] = 1.0
    eigenvalues = np.linalg.eigvalsh(P / scale / scale[:, None])
    noise = _CONVEX * float(np.abs(eigenvalues).max())
    return bool(eigenvalues[0] > noise if strictly else eigenvalues[0] >= -noise)
