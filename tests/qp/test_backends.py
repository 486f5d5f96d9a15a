"""Every backend that is installed against the exact answer, and what becomes of liars."""

from __future__ import annotations

import importlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import BackendError, MissingExtraError
from clfcbf.qp import (
    Backend,
    QpSolution,
    QpStatus,
    QuadraticProgram,
    available_backends,
    get_backend,
    solve_ladder,
    solve_lexicographic,
    solve_qp,
)
from clfcbf.qp.backends import Capability, _solver
from clfcbf.qp.backends import qpsolvers as qpsolvers_door
from clfcbf.qp.solve import ACCEPTED

NAMES = available_backends()
BOX = (-0.1, 0.3, -0.2, 0.3)
WEIGHT = (1.0, 0.0, 0.3)
every_backend = pytest.mark.parametrize("name", NAMES)


def two_variables(seed):
    """Feasible or not, bounded or not, rows of any length; P well conditioned."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 2))
    m = int(rng.integers(0, 5))
    G, h = rng.normal(size=(m, 2)), rng.normal(size=m)
    lb, ub = -rng.uniform(0, 1, size=2), rng.uniform(0, 1, size=2)
    lb[rng.random(2) < 0.2] = -np.inf
    ub[rng.random(2) < 0.2] = np.inf
    return QuadraticProgram(root @ root.T + 0.2 * np.eye(2), rng.normal(size=2) * 2, G, h, lb, ub)


def test_exact_is_first_and_daqp_is_there():
    assert NAMES[0] == "exact"
    assert "daqp" in NAMES


@every_backend
def test_protocol(name):
    backend = get_backend(name)
    assert isinstance(backend, Backend)
    assert backend.name == name
    assert isinstance(backend.capability, Capability)


@every_backend
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_agrees_with_exact(name, seed):
    problem = two_variables(seed)
    exact, other = solve_qp(problem), solve_qp(problem, name, fallback=())
    assert exact.status in (QpStatus.OPTIMAL, QpStatus.INFEASIBLE)
    assert other.status is exact.status
    assert other.backend == name
    if exact.x is not None:
        assert other.x == pytest.approx(exact.x, abs=1e-6)
        assert exact.residuals.worst <= 1e-12
        assert other.residuals.worst <= ACCEPTED
        assert (other.dual >= -1e-9).all()


@every_backend
def test_general_sizes(name):
    """Known optimum in five variables: a backend solves it or says it does not take it."""
    rng = np.random.default_rng(7)
    x, G, dual = rng.normal(size=5), rng.normal(size=(4, 5)), np.array([0.7, 0.0, 1.2, 0.0])
    h = G @ x + np.where(dual > 0, 0.0, 0.5)
    P = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    problem = QuadraticProgram(P, -(P @ x + G.T @ dual), G, h)
    limit = get_backend(name).capability.max_variables
    if limit is not None and limit < 5:
        with pytest.raises(BackendError, match="takes at most 2 variables, got 5"):
            solve_qp(problem, name)
    else:
        answer = solve_qp(problem, name, fallback=())
        assert answer.x == pytest.approx(x, abs=1e-6)
        assert answer.dual == pytest.approx(dual, abs=1e-5)


GOOD = {"P": np.eye(2), "q": [-1, -1], "G": [[1, 2]], "h": [1], "lb": [-1, -1], "ub": [1, 1]}


@every_backend
@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"q": [np.nan, 0]}, QpStatus.INVALID_INPUT),
        ({"q": [np.inf, 0]}, QpStatus.INVALID_INPUT),
        ({"P": [[np.nan, 0], [0, 1]]}, QpStatus.INVALID_INPUT),
        ({"G": [[np.nan, 1]]}, QpStatus.INVALID_INPUT),
        ({"G": [[np.inf, 1]]}, QpStatus.INVALID_INPUT),
        ({"h": [np.nan]}, QpStatus.INVALID_INPUT),
        ({"h": [-np.inf]}, QpStatus.INVALID_INPUT),
        ({"lb": [np.nan, 0]}, QpStatus.INVALID_INPUT),
        ({"lb": [np.inf, 0]}, QpStatus.INVALID_INPUT),
        ({"ub": [-np.inf, 0]}, QpStatus.INVALID_INPUT),
        ({"P": np.diag([1.0, -1.0])}, QpStatus.INVALID_INPUT),
        ({"lb": [2, 0]}, QpStatus.INFEASIBLE),
        ({"h": [-4]}, QpStatus.INFEASIBLE),
        ({"G": [[0, 0]], "h": [-0.1]}, QpStatus.INFEASIBLE),
        ({"h": [-1e20]}, QpStatus.INFEASIBLE),
        ({"h": [np.inf]}, QpStatus.OPTIMAL),
        ({"G": [[0, 0]], "h": [0.1]}, QpStatus.OPTIMAL),
        ({"lb": [-np.inf, -np.inf], "ub": [np.inf, np.inf]}, QpStatus.OPTIMAL),
        ({"lb": [0.25, -1], "ub": [0.25, 1]}, QpStatus.OPTIMAL),
    ],
)
def test_never_garbage(name, change, status):
    answer = solve_qp(QuadraticProgram(**{**GOOD, **change}), name, fallback=())
    assert answer.status is status
    assert (answer.x is not None) == answer.found == (status is QpStatus.OPTIMAL)
    again = solve_qp(QuadraticProgram(**GOOD), name, fallback=())  # and no state is left behind
    assert again.x == pytest.approx([0.6, 0.2], abs=1e-6)


@every_backend
@pytest.mark.parametrize("inert", [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (1.0, 1.0, 9.0)])
def test_inert_rows_change_nothing(name, inert):
    """A barrier without influence, or with ample margin, must not switch the others off."""
    row = (1.0, 0.0, 0.1)
    for levels in ([[row, inert]], [[inert, row]], [[inert], [row]]):
        answer = solve_ladder(WEIGHT, (3.0, 0.0), BOX, levels, name)
        assert (answer.v, answer.omega) == pytest.approx((0.1, 0.0), abs=1e-9)


class Liar:
    """A solver that says what it is told to."""

    name = "liar"
    capability = Capability()

    def __init__(self, x=None, status=QpStatus.OPTIMAL, duals=(None, None), error=None):
        self.answer = x if x is None else np.array(x, dtype=float)
        self.status, self.duals, self.error = status, duals, error

    def solve(self, problem):
        if self.error is not None:
            raise self.error
        return QpSolution(self.answer, self.status, self.name, *self.duals)


@pytest.mark.parametrize(
    "liar",
    [
        Liar([0.6, 0.201]),  # suboptimal within the rows: none, it is outside
        Liar([0.5, 0.2]),  # feasible, not optimal
        Liar([2e9, 0.0]),
        Liar([np.nan, 0.0]),
        Liar([0.6, 0.2, 0.0]),
        Liar(None),
        Liar(None, QpStatus.INFEASIBLE),
        Liar(error=RuntimeError("singular")),
        Liar(error=ZeroDivisionError()),
    ],
)
def test_wrong_claims_are_not_passed_on(liar):
    answer = solve_qp(QuadraticProgram(**GOOD), liar, fallback=())
    assert answer.status is QpStatus.NUMERICAL_ERROR
    assert answer.x is None
    assert not answer.found
    # With the usual fallbacks someone else answers, and who failed is told.
    answer = solve_qp(QuadraticProgram(**GOOD), liar)
    assert answer.x == pytest.approx([0.6, 0.2], abs=1e-12)
    assert answer.backend == "exact"
    assert [a.backend for a in answer.attempts] == ["liar", "exact"]
    assert [a.status.found for a in answer.attempts] == [False, True]


def test_good_points_survive_bad_or_missing_multipliers():
    problem = QuadraticProgram(**GOOD)
    for duals in ((None, None), (np.array([7.0]), np.zeros(2)), (np.array([np.nan]), np.zeros(2))):
        answer = solve_qp(problem, Liar([0.6, 0.2], duals=duals))
        assert answer.status is QpStatus.OPTIMAL
        assert answer.dual == pytest.approx([0.4], abs=1e-12)
        assert answer.residuals.worst <= 1e-12


def test_unproven_claims_of_infeasibility():
    feasible = QuadraticProgram(np.eye(3), np.zeros(3), [[1, 1, 1]], [1])
    answer = solve_qp(feasible, Liar(None, QpStatus.INFEASIBLE), fallback=())
    assert answer.status is QpStatus.UNPROVEN
    assert solve_qp(feasible, Liar(None, QpStatus.INFEASIBLE)).x is not None
    narrow = QuadraticProgram(np.eye(2), [0, 0], [[1, 0], [-1, 0]], [0.5, -0.5 - 1e-15])
    assert solve_qp(narrow).status is QpStatus.INFEASIBLE


@pytest.mark.parametrize("status", [QpStatus.ITERATION_LIMIT, QpStatus.TIME_LIMIT])
def test_honest_failures_keep_their_status(status):
    answer = solve_qp(QuadraticProgram(**GOOD), Liar([0.6, 0.2], status), fallback=())
    assert answer.status is status
    assert answer.x is None


def test_unbounded_is_said():
    line = QuadraticProgram(np.diag([1.0, 0.0]), [0.0, -1.0], lb=[-1, -1])
    assert solve_qp(line, "daqp").status is QpStatus.UNBOUNDED
    closed = QuadraticProgram(np.diag([1.0, 0.0]), [0.0, -1.0], lb=[-1, -1], ub=[9, 2])
    assert solve_qp(closed, "daqp").x == pytest.approx([0.0, 2.0], abs=1e-9)
    empty = QuadraticProgram(np.diag([1.0, 0.0]), [0.0, -1.0], [[1, 0], [-1, 0]], [0, -1])
    assert solve_qp(empty, "daqp").status is QpStatus.INFEASIBLE
    # A strictly convex cost has a minimum: who calls it unbounded is wrong.
    claim = solve_qp(QuadraticProgram(**GOOD), Liar(None, QpStatus.UNBOUNDED), fallback=())
    assert claim.status is QpStatus.NUMERICAL_ERROR


def test_semidefinite_cost():
    problem = QuadraticProgram(
        np.diag([1.0, 0.0]), [-0.5, -1.0], [[1, 1]], [1], lb=[-1, -1], ub=[1, 1]
    )
    answer = solve_qp(problem, "daqp")
    # On the line z1 + z2 = 1: minimise z1^2 / 2 - z1 / 2 - (1 - z1), so z1 = -1/2, cut at 0.
    assert answer.x == pytest.approx([0.0, 1.0], abs=1e-6)
    with pytest.raises(BackendError, match="positive definite"):
        solve_qp(problem, "exact")


def test_unknown_names_list_the_known():
    with pytest.raises(BackendError, match=r"'oracle'.*exact.*daqp"):
        get_backend("oracle")
    with pytest.raises(BackendError, match="'oracle'"):
        solve_ladder(WEIGHT, (0.0, 0.0), BOX, [], "oracle")


ABSENT = {
    "daqp": "solvers", "osqp": "solvers", "clarabel": "solvers", "proxqp": "solvers",
    "piqp": "solvers", "casadi-ipopt": "solvers", "casadi-qrqp": "solvers", "quadprog": "gpl",
    "elastiqp": "bench", "qpsolvers:osqp": "solvers", "qpsolvers:quadprog": "gpl",
}  # fmt: skip


@pytest.mark.parametrize(("name", "extra"), ABSENT.items())
def test_missing_package_names_the_extra(name, extra, monkeypatch):
    monkeypatch.setattr(_solver, "is_installed", lambda module: False)
    monkeypatch.setattr(qpsolvers_door, "is_installed", lambda module: module == "qpsolvers")
    if name.startswith("qpsolvers"):
        monkeypatch.setattr(qpsolvers_door, "require", lambda *arguments: None)
    module = importlib.import_module(
        "clfcbf.qp.backends." + name.partition(":")[0].partition("-")[0]
    )
    with pytest.raises(MissingExtraError, match=rf"clfcbf\[{extra}\]"):
        module.create(name)


def test_a_solver_that_no_extra_brings_says_so(monkeypatch):
    monkeypatch.setattr(qpsolvers_door, "is_installed", lambda module: module == "qpsolvers")
    with pytest.raises(BackendError, match="'ecos', which no extra brings"):
        qpsolvers_door.create("qpsolvers:ecos")


def test_import_brings_no_solver():
    code = (
        "import sys, clfcbf.qp as q; q.available_backends(); "
        "print([m for m in ('daqp', 'qpsolvers', 'scipy', 'casadi', 'osqp', 'clarabel', 'piqp', "
        "'proxsuite', 'quadprog', 'elastiqp', 'jax') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
    assert run.stderr == ""


@st.composite
def ladders(draw):
    unit = st.integers(0, 997)
    angles = st.sampled_from([0.1, 0.7, 1.3, 2.0, 2.9, 3.6, 4.4, 5.5])
    level = st.lists(st.tuples(angles, unit), max_size=3)
    levels = [
        [(np.cos(t).item(), np.sin(t).item(), -0.3 + 0.7 * k / 997) for t, k in rows]
        for rows in draw(st.lists(level, min_size=1, max_size=3))
    ]
    return (draw(unit) / 997 - 0.5, draw(unit) / 997 - 0.5), levels


@every_backend
@settings(max_examples=25, deadline=None)
@given(ladders())
def test_ladder_gives_the_exact_answer(name, program):
    nominal, levels = program
    exact = solve_lexicographic(WEIGHT, nominal, BOX, levels)
    answer = solve_ladder(WEIGHT, nominal, BOX, levels, name)
    assert (answer.v, answer.omega) == pytest.approx((exact.v, exact.omega), abs=1e-6)
    assert answer.slacks == exact.slacks
    assert (answer.health is None) == (name == "exact")
    assert BOX[0] <= answer.v <= BOX[1]
    assert BOX[2] <= answer.omega <= BOX[3]
    for level, slack in zip(levels, answer.slacks, strict=True):
        for a, c, b in level:
            assert a * answer.v + c * answer.omega <= b + slack + 1e-14


class Offset:
    """The exact answer, moved."""

    name = "offset"
    capability = Capability(max_variables=2)

    def __init__(self, amount):
        self.amount = amount

    def solve(self, problem):
        claim = get_backend("exact").solve(problem)
        return QpSolution(claim.x + self.amount, QpStatus.OPTIMAL, self.name)


def test_ladder_uses_a_backend_that_is_right():
    levels = [[(1.0, 0.0, 0.1)], [(-1.0, 0.0, -0.2)]]
    answer = solve_ladder(WEIGHT, (0.2, 0.1), BOX, levels, "daqp")
    assert answer.health.used
    assert answer.health.backend == "daqp"
    assert answer.health.distance <= 1e-9


def test_ladder_moves_small_errors_onto_the_rows():
    levels = [[(1.0, 0.0, 0.1)]]
    answer = solve_ladder(WEIGHT, (0.2, 0.1), BOX, levels, Offset(5e-7))
    assert answer.health.used
    assert answer.v <= 0.1
    assert answer.omega == pytest.approx(0.1 + 5e-7, abs=1e-12)


@pytest.mark.parametrize(
    "liar",
    [
        Offset(1e-5),
        Offset(np.nan),
        Liar([0.1, np.nan]),
        Liar([np.inf, 0.1]),
        Liar(None),
        Liar([0.1, 0.1], QpStatus.ITERATION_LIMIT),
        Liar(error=RuntimeError("broken")),
        Liar([0.1]),
    ],
)
def test_ladder_falls_back_and_says_so(liar):
    levels = [[(1.0, 0.0, 0.1)]]
    answer = solve_ladder(WEIGHT, (0.2, 0.1), BOX, levels, liar)
    assert (answer.v, answer.omega) == (0.1, 0.1)
    assert not answer.health.used
    assert answer.health.distance > 1e-6


def test_ladder_without_finite_data():
    assert solve_ladder(WEIGHT, (np.nan, 0.0), BOX, [], "daqp") is None
