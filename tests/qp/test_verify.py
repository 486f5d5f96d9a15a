"""Problem data, residuals, certificates and the nonnegative least squares under them."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.qp import QuadraticProgram
from clfcbf.qp.certificates import proves_infeasible
from clfcbf.qp.nnls import nonnegative_least_squares
from clfcbf.qp.verify import Duals, is_convex, multipliers_at, verify

seeds = st.integers(0, 10**6)


def random_program(rng, n, m):
    """A program with a known optimum: the multipliers are drawn first, the data made to fit."""
    root = rng.normal(size=(n, n))
    P = root @ root.T + 0.1 * np.eye(n)
    x, G = rng.normal(size=n), rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-3, 3, size=(m, 1))
    dual = rng.uniform(0, 2, size=m) * (rng.random(m) < 0.5)
    h = G @ x + np.where(dual > 0, 0.0, rng.uniform(0.1, 1, size=m) * np.linalg.norm(G, axis=1))
    bounds = rng.uniform(-1, 1, size=n) * (rng.random(n) < 0.4)
    lb = np.where(bounds < 0, x, x - rng.uniform(0.1, 1, size=n))
    ub = np.where(bounds > 0, x, x + rng.uniform(0.1, 1, size=n))
    q = -(P @ x + G.T @ dual + bounds)
    return QuadraticProgram(P, q, G, h, lb, ub), x, dual, bounds


@settings(max_examples=100, deadline=None)
@given(seeds, st.integers(1, 6), st.integers(0, 8))
def test_residuals_vanish_only_at_the_optimum(seed, n, m):
    rng = np.random.default_rng(seed)
    problem, x, dual, bounds = random_program(rng, n, m)
    assert verify(problem, x, Duals(dual, bounds)).worst <= 1e-10
    assert verify(problem, x).worst <= 1e-10  # multipliers reconstructed
    step = rng.normal(size=n)
    moved = x + 1e-3 * step / np.abs(step).max()
    assert verify(problem, moved).worst >= 1e-8
    assert verify(problem, moved, Duals(dual, bounds)).worst >= 1e-8


@settings(max_examples=100, deadline=None)
@given(seeds, st.integers(1, 6), st.integers(0, 12))
def test_reconstructed_multipliers_are_stationary(seed, n, m):
    problem, x, *_ = random_program(np.random.default_rng(seed), n, m)
    rows, bounds, _ = multipliers_at(problem, x)
    left = problem.P @ x + problem.q + problem.G.T @ rows + bounds
    assert np.abs(left).max() <= 1e-9 * (1 + np.abs(problem.q).max())
    assert (rows >= 0).all()


@settings(max_examples=150, deadline=None)
@given(seeds, st.integers(1, 8), st.integers(1, 12))
def test_nonnegative_least_squares_as_scipy(seed, m, n):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(m, n)), rng.normal(size=m)
    if seed % 3 == 0:
        A = np.hstack((A, -A, A))  # dependent columns
    z = nonnegative_least_squares(A, b)
    _, least = scipy.optimize.nnls(A, b)
    assert (z >= 0).all()
    assert np.linalg.norm(A @ z - b) == pytest.approx(least, abs=1e-9)


def test_nonnegative_least_squares_of_nothing():
    assert nonnegative_least_squares(np.zeros((3, 0)), np.ones(3)).shape == (0,)
    assert nonnegative_least_squares(np.zeros((3, 2)), np.ones(3)).tolist() == [0.0, 0.0]


@settings(max_examples=100, deadline=None)
@given(seeds, st.integers(1, 4), st.integers(1, 8))
def test_certificates_of_infeasibility(seed, n, m):
    """Found where linear programming finds no point, never where it finds one."""
    rng = np.random.default_rng(seed)
    G, h = rng.normal(size=(m, n)), rng.normal(size=m) * 0.7
    lb, ub = -rng.uniform(0, 1, size=n), rng.uniform(0, 1, size=n)
    problem = QuadraticProgram(np.eye(n), np.zeros(n), G, h, lb, ub)
    # Largest common margin t: the verdict is only asked where it is not marginal.
    A = np.hstack((G / np.linalg.norm(G, axis=1)[:, None], np.ones((m, 1))))
    answer = scipy.optimize.linprog(
        [0.0] * n + [-1.0],
        A,
        h / np.linalg.norm(G, axis=1),
        bounds=[*zip(lb, ub, strict=True), (None, 1)],
    )
    margin = answer.x[-1]
    if abs(margin) > 1e-6:
        assert proves_infeasible(problem) == (margin < 0)


def test_certificates_in_plain_cases():
    def program(**rows):
        return QuadraticProgram(np.eye(2), np.zeros(2), **rows)

    assert proves_infeasible(program(lb=[1, 0], ub=[0, 1]))
    assert proves_infeasible(program(G=[[0, 0]], h=[-0.1]))
    assert not proves_infeasible(program(G=[[0, 0]], h=[0.1]))
    assert not proves_infeasible(program())
    assert proves_infeasible(program(G=[[1, 0], [-1, 0]], h=[0, -1]))
    assert not proves_infeasible(program(G=[[1, 0], [-1, 0]], h=[0, 0]))


def test_primal_residual_is_a_distance():
    """A row's length changes nothing."""
    for size in (1e-8, 1.0, 1e8):
        problem = QuadraticProgram(
            np.eye(2), np.zeros(2), [[3 * size, 4 * size]], [-5 * size], lb=[-9, -9]
        )
        assert verify(problem, np.array([0.0, 0.0])).primal == pytest.approx(1.0, rel=1e-12)


def test_not_finite_answers_and_multipliers_are_refused():
    problem = QuadraticProgram(np.eye(2), np.zeros(2), [[1, 0]], [1])
    good, none = np.zeros(2), Duals(np.zeros(1), np.zeros(2))
    assert verify(problem, good, none).worst == 0.0
    assert verify(problem, np.array([np.nan, 0]), none).primal == np.inf
    assert verify(problem, np.zeros(3), none).primal == np.inf
    assert verify(problem, good, Duals(np.array([np.nan]), np.zeros(2))).worst == np.inf
    assert verify(problem, good, Duals(np.zeros(2), np.zeros(2))).worst == np.inf


def test_multipliers_of_the_wrong_sign_are_refused():
    problem = QuadraticProgram(np.eye(2), [1.0, 0.0], [[1, 0]], [0])
    # Stationary and complementary, but the row pulls instead of pushing.
    assert verify(problem, np.zeros(2), Duals(np.array([-1.0]), np.zeros(2))).dual >= 0.4
    # A multiplier on a bound that does not exist.
    problem = QuadraticProgram(np.eye(2), [1.0, 0.0], lb=[-9, -9])
    assert verify(problem, np.zeros(2), Duals(np.zeros(0), np.array([-1.0, 0.0]))).worst >= 0.4
    problem = QuadraticProgram(np.eye(2), [-1.0, 0.0], lb=[-9, -9])
    assert verify(problem, np.zeros(2), Duals(np.zeros(0), np.array([1.0, 0.0]))).dual >= 0.4


def test_convexity():
    assert is_convex(QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2)))
    assert not is_convex(QuadraticProgram(np.diag([1.0, -1e-6]), np.zeros(2)))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"P": np.eye(3), "q": [0, 0]}, r"P must have shape \(2, 2\), got \(3, 3\)"),
        ({"P": np.eye(2), "q": [[0], [0]]}, "q must have shape"),
        ({"P": np.eye(2), "q": []}, "at least one"),
        ({"P": [[1, 2], [0, 1]], "q": [0, 0]}, "symmetric, off by 2.0"),
        ({"P": np.eye(2), "q": [0, 0], "G": [[1, 0]]}, "together"),
        ({"P": np.eye(2), "q": [0, 0], "G": [1, 0], "h": [1]}, "G must have shape"),
        ({"P": np.eye(2), "q": [0, 0], "G": [[1, 0]], "h": [[1]]}, "h must have shape"),
        ({"P": np.eye(2), "q": [0, 0], "lb": [0]}, "lb must have shape"),
        ({"P": np.eye(2), "q": [0, 0], "ub": ["x", 0]}, "ub is not an array"),
    ],
)
def test_wrong_shapes_are_refused(data, message):
    with pytest.raises(ConfigurationError, match=message):
        QuadraticProgram(**data)


def test_program_is_read_only_and_filled_in():
    q = np.zeros(2)
    problem = QuadraticProgram(np.eye(2, dtype=np.float32), q)
    q[0] = 5.0
    assert problem.q[0] == 0.0
    assert problem.P.dtype == np.float64
    assert (problem.n, problem.m, problem.G.shape) == (2, 0, (0, 2))
    assert np.isneginf(problem.lb).all()
    assert np.isposinf(problem.ub).all()
    with pytest.raises(ValueError, match="read-only"):
        problem.P[0, 0] = 2.0


def test_nan_is_representable():
    assert not QuadraticProgram(np.eye(2), [np.nan, 0]).well_posed
    assert not QuadraticProgram([[np.nan, 0], [1, 1]], [0, 0]).well_posed
    assert QuadraticProgram(np.eye(2), [0, 0], [[1, 0]], [np.inf]).well_posed


def test_overflow_is_not_optimality():
    """1e300 times 1e300 is infinite, and infinity less infinity is no number: no answer either."""
    problem = QuadraticProgram(np.eye(2), [0, 0], [[1e300, 0]], [np.inf])
    assert verify(problem, np.array([1e300, 0.0])).worst > 0.1
    problem = QuadraticProgram(np.eye(2), [0, 0], [[1e300, -1e300]], [1.0])
    assert verify(problem, np.array([1e300, 1e300])).worst > 0.1
    assert verify(problem, np.zeros(2)).worst == 0.0


def test_equality_rows_are_verified():
    problem = QuadraticProgram(np.eye(2), [0, 0], A=[[3, 4]], b=[5])
    nearest, none = np.array([0.6, 0.8]), np.zeros(0)
    assert verify(problem, nearest).worst <= 1e-15
    assert multipliers_at(problem, nearest).equalities == pytest.approx([-0.2])
    right = Duals(none, np.zeros(2), np.array([-0.2]))
    assert verify(problem, nearest, right).worst <= 1e-15
    assert verify(problem, nearest, right._replace(equalities=np.array([0.2]))).dual > 0.1
    assert verify(problem, nearest, Duals(none, np.zeros(2))).worst == np.inf
    assert verify(problem, np.zeros(2)).primal == pytest.approx(1.0)
    for b in (5.0, -5.0):
        twice = QuadraticProgram(np.eye(2), [0, 0], A=[[3, 4], [6, 8]], b=[5, 2 * b])
        assert proves_infeasible(twice) == (b < 0)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"A": [[1, 0]]}, "A and b must be given together"),
        ({"b": [1]}, "A and b must be given together"),
        ({"A": [[1, 0, 0]], "b": [1]}, r"A must have shape \(1, 2\)"),
    ],
)
def test_equality_rows_have_shapes(data, message):
    with pytest.raises(ConfigurationError, match=message):
        QuadraticProgram(np.eye(2), [0, 0], **data)
