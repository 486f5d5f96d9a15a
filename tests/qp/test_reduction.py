"""The reduced form is the same program to the last bit, and the polish finds the exact answer."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp import QuadraticProgram
from clfcbf.qp.certificates import proves_unbounded
from clfcbf.qp.conformance import cases
from clfcbf.qp.polish import polish
from clfcbf.qp.reduction import reduce
from clfcbf.qp.verify import Duals, verify

SOLVABLE = (
    "feasible", "degenerate", "duplicate rows", "huge and tiny rows", "1e8 scaling",
    "sizes and equalities", "infinite bounds",
)  # fmt: skip
seeds = st.integers(0, 10**6)


def solvable(seed):
    names = (SOLVABLE[seed % len(SOLVABLE)],)
    return next(c for c in cases(seed, 8, names) if c.x is not None and c.problem.n <= 5)


def exactly(matrix):
    return [[Fraction(v) for v in row] for row in np.atleast_2d(matrix).tolist()]


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_form_is_the_program_to_the_last_bit(seed):
    """Cost differences and row excesses of random points, in rational arithmetic."""
    problem = solvable(seed).problem
    reduction = reduce(problem)
    form = reduction.form
    rng = np.random.default_rng(seed)
    scale = [Fraction(s) for s in reduction.variables.tolist()]
    P, q, C = exactly(form.P), exactly(form.q)[0], exactly(form.C)
    P_, q_ = exactly(problem.P), exactly(problem.q)[0]

    def cost(P, q, z):
        n = len(z)
        return sum(z[i] * P[i][j] * z[j] / 2 for i in range(n) for j in range(n)) + sum(
            a * b for a, b in zip(q, z, strict=True)
        )

    ratios = set()
    for _ in range(3):
        y = [Fraction(v) for v in rng.normal(size=problem.n).tolist()]
        z = [a * b for a, b in zip(y, scale, strict=True)]
        if cost(P, q, y):
            ratios.add(cost(P_, q_, z) / cost(P, q, y))
    assert len(ratios) == 1
    (ratio,) = ratios
    assert ratio > 0
    # Each row of the form is a row of the program, divided by a power of two.
    stack = exactly(np.concatenate((problem.A, problem.G, np.eye(problem.n))))
    lower = [*problem.b, *np.full(problem.m, -np.inf), *problem.lb]
    upper = [*problem.b, *problem.h, *problem.ub]
    for k, original in enumerate(reduction.kept.tolist()):
        row = [a * s for a, s in zip(stack[original], scale, strict=True)]
        factor = next(a / c for a, c in zip(row, C[k], strict=True) if c)
        assert row == [factor * c for c in C[k]]
        assert factor.numerator & (factor.numerator - 1) == 0
        assert factor.denominator & (factor.denominator - 1) == 0
        for mine, theirs in ((form.lower[k], lower[original]), (form.upper[k], upper[original])):
            if np.isfinite(theirs):
                assert Fraction(float(mine)) * factor == Fraction(float(theirs))
            else:
                assert mine == theirs
        assert 0.5 <= np.abs(form.C[k]).max() < 1.0


def test_form_leaves_out_what_says_nothing():
    problem = QuadraticProgram(
        np.diag([1e8, 1e-2]),
        [1.0, 1.0],
        [[0, 0], [1e-9, 2e-9], [1, 1]],
        [3, 1e-9, np.inf],
        [-np.inf, 0.5],
        [np.inf, 0.5],
        [[1e6, 0]],
        [2e6],
    )
    form = reduce(problem).form
    assert form.equal == 2  # the equality row, and the variable that has one value
    assert form.C.shape == (3, 2)
    assert (form.lower[:2] == form.upper[:2]).all()
    assert 0.25 <= form.P.diagonal().min() <= form.P.diagonal().max() <= 2.0


@pytest.mark.parametrize(
    "rows",
    [
        {"G": [[0, 0]], "h": [-1e-300]},
        {"A": [[0, 0]], "b": [1e-300]},
        {"lb": [1, 0], "ub": [0, 1]},
    ],
)
def test_form_of_what_admits_no_point(rows):
    assert reduce(QuadraticProgram(np.eye(2), [0, 0], **rows)) is None


@settings(max_examples=80, deadline=None)
@given(seeds, st.booleans())
def test_polish_removes_a_solvers_error(seed, with_dual):
    case = solvable(seed)
    reduction = reduce(case.problem)
    form = reduction.form
    rng = np.random.default_rng(seed)
    exact = case.x / reduction.variables
    dual = None
    if with_dual:
        solved = polish(form, exact, None)
        assert solved is not None
        dual = solved[1] + 1e-7 * rng.normal(size=form.lower.size)
    # As far from the answer as an operator-splitting method stops.
    found = polish(form, exact + 1e-7 * rng.uniform(-1, 1, exact.size), dual)
    assert found is not None
    x, duals = reduction.restore(*found)
    assert np.abs(x - case.x).max() <= 1e-9 * case.size
    assert verify(case.problem, x, duals).worst <= 1e-9


@settings(max_examples=80, deadline=None)
@given(seeds, st.floats(-4.0, 1.0))
def test_polish_returns_the_answer_or_nothing(seed, exponent):
    """From a point far off the active rows may not be found; then nothing is made up."""
    case = solvable(seed)
    reduction = reduce(case.problem)
    rng = np.random.default_rng(seed)
    start = case.x / reduction.variables + 10.0**exponent * rng.normal(size=case.x.size)
    found = polish(reduction.form, start, rng.normal(size=reduction.form.lower.size))
    if found is not None:
        x, duals = reduction.restore(*found)
        assert verify(case.problem, x, duals).worst <= 1e-8
        assert np.abs(x - case.x).max() <= 1e-6 * case.size


def test_polish_refuses_what_is_not_finite():
    form = reduce(QuadraticProgram(np.eye(2), [1, 1], [[1, 1]], [1])).form
    assert polish(form, np.array([np.nan, 0.0]), None) is None


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_residuals_ignore_scales(seed):
    """Cost and rows times powers of two: the same verdict, to the bit."""
    case = solvable(seed)
    p = case.problem
    rng = np.random.default_rng(seed)
    moved = case.x + case.size * 1e-4 * rng.normal(size=p.n)
    for x in (case.x, moved):
        dual = np.abs(rng.normal(size=p.m))
        before = verify(p, x, Duals(dual, np.zeros(p.n), np.zeros(p.p)))
        scaled = QuadraticProgram(
            p.P * 2.0**20, p.q * 2.0**20, p.G * 2.0**7, p.h * 2.0**7, p.lb, p.ub, p.A, p.b
        )
        after = verify(scaled, x, Duals(dual * 2.0**13, np.zeros(p.n), np.zeros(p.p)))
        assert after == before


def test_a_large_force_in_one_entry_excuses_nothing_in_another():
    problem = QuadraticProgram(np.eye(2), [-1e9, -0.5], ub=[1, 9])
    assert verify(problem, np.array([1.0, 0.5])).worst <= 1e-12
    assert verify(problem, np.array([1.0, 0.4])).worst >= 0.05


def test_a_tiny_cost_is_judged_like_any():
    problem = QuadraticProgram(1e-12 * np.eye(2), [-1e-12, 0.0])
    assert verify(problem, np.array([1.0, 0.0])).worst == 0.0
    assert verify(problem, np.array([0.9, 0.0])).worst >= 0.04


@settings(max_examples=60, deadline=None)
@given(seeds, st.integers(2, 5))
def test_unbounded_directions_are_found_and_only_they(seed, n):
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(n, n)))[0]
    P = (frame[:, 1:] * rng.uniform(0.5, 2, n - 1)) @ frame[:, 1:].T
    P, flat, q = (P + P.T) / 2, frame[:, 0], rng.normal(size=n)
    if abs(q @ flat) < 1e-3:
        return
    open_rows = rng.normal(size=(2, n))
    open_rows -= np.outer(open_rows @ flat, flat)
    assert proves_unbounded(QuadraticProgram(P, q, open_rows, [1, 1]))
    fall = -np.sign(q @ flat) * flat
    assert not proves_unbounded(QuadraticProgram(P, q, [fall], [5.0]))
    assert proves_unbounded(QuadraticProgram(P, q, [-fall], [5.0]))
    assert not proves_unbounded(QuadraticProgram(P + 0.1 * np.eye(n), q, open_rows, [1, 1]))
    assert not proves_unbounded(QuadraticProgram(P, q, None, None, None, None, [flat], [0.0]))
    assert not proves_unbounded(QuadraticProgram(P, 0 * q))
