"""Every trap that a solver has set so far, one test each."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import types

import numpy as np
import pytest

from clfcbf.qp import (
    QpStatus,
    QuadraticProgram,
    available_backends,
    get_backend,
    one_shot_problem,
    solve_qp,
)
from clfcbf.qp.one_shot import paper_program
from clfcbf.qp.reduction import reduce

NAMES = available_backends()
every_backend = pytest.mark.parametrize("name", NAMES)


def needs(name):
    return pytest.mark.skipif(name not in NAMES, reason=f"{name} is not installed")


def one_shot_stream(count, seed=0):
    """The paper's program in (v, omega, delta), penalty 1e3, rows of a narrow box."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        v, omega = rng.uniform(-0.2, 0.2), rng.uniform(-0.4, 0.4)
        box = (v - 0.05, v + 0.05, omega - 0.15, omega + 0.15)
        edge = rng.normal(size=2)
        hard = [(*edge.tolist(), float(edge @ (v, omega) + rng.uniform(0.0, 0.1)))]
        clf = rng.normal(size=2)
        soft = (*clf.tolist(), float(clf @ (v, omega) - rng.uniform(-0.2, 0.2)))
        yield (1.0, 0.0, 0.2), (0.0, 0.0), box, hard, soft, 1e3


@needs("casadi-qrqp")
def test_qrqp_claims_wrong_answers_and_they_are_put_right():
    """One in twenty of its own answers is off by up to 0.3, reported as success."""
    solver = get_backend("casadi-qrqp")
    for program in one_shot_stream(60):
        problem, exact = one_shot_problem(*program), paper_program(*program)
        answer = solve_qp(problem, solver, fallback=())
        assert answer.x == pytest.approx((exact.v, exact.omega, exact.delta), abs=1e-6)
        reduction = reduce(problem)
        own = solver._ask(reduction.form, None).y
        right = answer.x / reduction.variables
        off = np.abs(own - right).max() / (1 + np.abs(right).max())
        assert answer.moved == pytest.approx(off, abs=1e-12)  # what was wrong is told


@needs("proxqp")
def test_proxqp_is_held_to_complementarity():
    """Without the check of the gap it is off by 0.1 with residuals of 1e-10."""
    solver = get_backend("proxqp")
    for program in one_shot_stream(60):
        form = reduce(one_shot_problem(*program)).form
        claim = solver._ask(form, None)
        settings = solver._make(form)._solver.settings
        assert settings.check_duality_gap
        assert settings.eps_duality_gap_abs <= 1e-8
        if claim.status is QpStatus.OPTIMAL:
            slack = np.minimum(form.upper - form.C @ claim.y, form.C @ claim.y - form.lower)
            assert np.minimum(np.abs(slack), np.abs(claim.dual)).max() <= 1e-3
            exact = paper_program(*program)
            assert claim.y * reduce(one_shot_problem(*program)).variables == pytest.approx(
                (exact.v, exact.omega, exact.delta), abs=1e-4
            )


@every_backend
def test_solving_again_gives_the_same(name):
    """ProxQP rescales its box, pyqpmad overwrites the cost: the second answer tells."""
    solver = get_backend(name)
    problem = QuadraticProgram(
        [[2.0, 0.3], [0.3, 1.0]], [-3, 1], [[1, 0.2]], [0.4], [-0.5, -0.2], [0.5, 0.2]
    )
    data = [getattr(problem, field).tobytes() for field in ("P", "q", "G", "h", "lb", "ub")]
    answers = {solver.solve(problem).x.tobytes() for _ in range(5)}
    assert len(answers) == 1
    assert data == [getattr(problem, field).tobytes() for field in ("P", "q", "G", "h", "lb", "ub")]


@every_backend
def test_a_solver_does_not_go_on_with_old_data(name):
    """OSQP's update of l > u prints and returns; 'solved' is then said of the old bounds."""
    box = {"P": np.eye(2), "q": [-1, -1], "G": [[1, 1]]}
    good = QuadraticProgram(**box, h=[1], lb=[0, 0], ub=[1, 1])
    crossed = QuadraticProgram(**box, h=[1], lb=[0, 0.5], ub=[1, 0.2])
    apart = QuadraticProgram(**box, h=[-1], lb=[0, 0], ub=[1, 1])
    expected = pytest.approx([0.5, 0.5], abs=1e-9)
    for bad in (crossed, apart, crossed):
        assert solve_qp(good, name, fallback=()).x == expected
        assert solve_qp(bad, name, fallback=()).status is QpStatus.INFEASIBLE
        assert get_backend(name).solve(bad).x is None
    assert solve_qp(good, name, fallback=()).x == expected


@every_backend
def test_zeros_are_part_of_the_pattern(name):
    """A workspace set up where an entry is zero must take the program where it is not."""
    sparse = QuadraticProgram(np.eye(2), [-1, -1], [[1, 0], [0, 1]], [0.3, 0.4], [-9, -9], [9, 9])
    dense = QuadraticProgram(
        [[1, 0.5], [0.5, 1]], [-1, -1], [[1, 0.7], [-0.6, 1]], [0.3, 0.4], [-9, -9], [9, 9]
    )
    for problem in (sparse, dense, sparse, dense):
        expected = solve_qp(problem).x
        assert solve_qp(problem, name, fallback=()).x == pytest.approx(expected, abs=1e-9)


@every_backend
def test_a_zero_row_that_cannot_hold(name):
    """CasADi's DAQP plugin calls 0 u <= -0.1 solved; native solvers divide by its length."""
    problem = QuadraticProgram(np.eye(2), [-1, -1], [[0, 0], [1, 1]], [-0.1, 1])
    assert get_backend(name).solve(problem).x is None
    assert solve_qp(problem, name, fallback=()).status is QpStatus.INFEASIBLE


@every_backend
@pytest.mark.parametrize("h", [-1e20, 1e20])
def test_a_huge_right_hand_side(name, h):
    """ProxQP hangs on it, others return numbers."""
    problem = QuadraticProgram(np.eye(2), [-1, -1], [[1, 1]], [h], [-1, -1], [1, 1])
    answer = solve_qp(problem, name, fallback=())
    if h < 0:
        assert answer.status is QpStatus.INFEASIBLE
    else:
        assert answer.x == pytest.approx([1.0, 1.0], abs=1e-9)


def test_plugins_that_crash_print_or_need_structure_are_left_out():
    for plugin in ("highs", "qpoases", "hpipm", "fatrop", "clp", "superscs"):
        assert f"casadi-{plugin}" not in NAMES


def test_solvers_of_half_a_second_are_not_listed():
    assert not {"qpsolvers:qpax", "qpsolvers:jaxopt_osqp"} & set(NAMES)


@pytest.mark.parametrize("x", [[2e9, -2e9], [np.nan, 0.0], None])
def test_a_point_that_was_not_found_is_not_an_answer(x, monkeypatch):
    """qpsolvers fills ``x`` though ``found`` is false."""
    qpsolvers = pytest.importorskip("qpsolvers")
    answer = types.SimpleNamespace(
        found=False, x=None if x is None else np.array(x), y=None, z=None
    )
    monkeypatch.setattr(qpsolvers, "solve_problem", lambda *args, **options: answer)
    problem = QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [1], [-1, -1], [1, 1])
    solved = get_backend("qpsolvers:daqp").solve(problem)
    if solved.x is not None:  # named the right rows by chance, and was polished: then it is right
        assert solved.x == pytest.approx([0.6, 0.2], abs=1e-12)
    assert solve_qp(problem, "qpsolvers:daqp").x == pytest.approx([0.6, 0.2], abs=1e-12)


@every_backend
def test_infeasible_by_little_is_infeasible(name):
    """OSQP finds a gap of 1e-4 to be none."""
    problem = QuadraticProgram(np.eye(2), [-1, 0], [[1, 0], [-1, 0]], [0.1, -0.1001])
    assert solve_qp(problem, name, fallback=()).status is QpStatus.INFEASIBLE


@needs("casadi-ipqp")
def test_ipqp_with_a_single_side():
    """It divides by the number of sides less one."""
    problem = QuadraticProgram([[2.0, 1.0], [1.0, 2.0]], [0.1, -1.0], [[1, 0]], [0.0])
    assert solve_qp(problem, "casadi-ipqp", fallback=()).found


QUIET = """
import os, sys, warnings
warnings.simplefilter("error")
import numpy as np
before = dict(os.environ)
from clfcbf.qp import available_backends, solve_qp
from clfcbf.qp.conformance import cases
filters = list(warnings.filters)
for name in available_backends():
    for case in cases(0, 2):
        try:
            solve_qp(case.problem, name, fallback=())
        except Exception as error:
            if type(error).__name__ != "BackendError":
                raise
    assert dict(os.environ) == before, name
    assert warnings.filters == filters, name
"""


def test_no_solver_prints_warns_or_touches_the_environment():
    environment = {k: v for k, v in os.environ.items() if k != "KMP_DUPLICATE_LIB_OK"}
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", QUIET],
        capture_output=True,
        text=True,
        env=environment,
        timeout=120,
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


COPYLEFT = {"quadprog", "qpsolvers:quadprog", "qpsolvers:cvxopt", "qpsolvers:ecos"}


@every_backend
def test_licences_and_versions_are_told(name):
    capability = get_backend(name).capability
    words = capability.licence.replace("LGPL", "lesser")
    assert ("GPL" in words) == (name in COPYLEFT)
    if name != "exact":
        assert importlib.metadata.version(capability.package)
