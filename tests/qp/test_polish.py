"""An answer that is exact already is left alone, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from clfcbf.qp import QuadraticProgram, available_backends, get_backend, paper_program
from clfcbf.qp.backends import _solver
from clfcbf.qp.conformance import cases
from clfcbf.qp.polish import is_exact, polish
from clfcbf.qp.reduction import reduce

DIRECT = {
    "casadi-daqp", "casadi-qrqp", "elastiqp", "quadprog", "qpsolvers:daqp", "qpsolvers:pyqpmad",
    "qpsolvers:quadprog",
}  # fmt: skip
NAMES = sorted(DIRECT & set(available_backends()))
PROBLEM = QuadraticProgram(
    [[2.0, 0.3], [0.3, 1.0]], [-3, 1], [[1, 0.2], [1, 1]], [0.4, 3.0], [-0.5, -0.2], [0.5, 0.2],
    [[1.0, 3.0]], [0.1],
)  # fmt: skip


def solved():
    form = reduce(PROBLEM).form
    y, dual = polish(form, np.zeros(2), np.zeros(form.lower.size))
    return form, y, dual


def test_every_condition_counts():
    form, y, dual = solved()
    assert is_exact(form, y, dual)
    assert not is_exact(form, y, None)
    assert not is_exact(form, y * np.nan, dual)
    for k in range(y.size):
        assert not is_exact(form, y + 1e-10 * np.eye(y.size)[k], dual)
    for k in range(dual.size):
        for sign in (1.0, -1.0):
            assert not is_exact(form, y, dual + sign * 1e-10 * np.eye(dual.size)[k])


def test_a_multiplier_at_the_wrong_side_is_not_optimal():
    """min y^2/2 - y with 0 <= y <= 2: the pull of -1 at y = 0 is no reaction of that bound."""
    form = reduce(QuadraticProgram([[1.0]], [-1.0], lb=[0.0], ub=[2.0])).form
    assert is_exact(form, -form.q / form.P[0], np.zeros(1))
    pull = -form.q / form.C[0]
    assert np.abs(form.q + pull @ form.C).max() == 0.0
    assert not is_exact(form, np.zeros(1), pull)


@pytest.mark.parametrize("name", NAMES)
def test_active_set_solvers_need_no_second_solve(name, monkeypatch):
    polished = []

    def counted(form, y, dual):
        polished.append(name)
        return polish(form, y, dual)

    monkeypatch.setattr(_solver, "polish", counted)
    solver = get_backend(name)
    asked = 0
    for case in cases(seed=3, count=12, families=("feasible",)):
        if case.problem.n > 3:
            continue
        asked += 1
        answer = solver.solve(case.problem)
        assert answer.x == pytest.approx(case.x, abs=1e-9)
    assert asked >= 5
    assert len(polished) <= asked // 3


def test_the_reference_is_the_exact_program():
    """What is compared with above is right: the one-shot program through its form."""
    soft, hard = (1.0, 2.0, -0.4), [(1.0, -1.0, 0.1)]
    from clfcbf.qp import one_shot_problem

    program = ((1.0, 0.0, 0.5), (0.1, 0.1), (-0.3, 0.3, -0.3, 0.3), hard, soft, 100.0)
    exact = paper_program(*program)
    reduction = reduce(one_shot_problem(*program))
    y = np.array((exact.v, exact.omega, exact.delta)) / reduction.variables
    found = polish(reduction.form, y, None)
    assert found is not None
    assert found[0] == pytest.approx(y, abs=1e-12)
    assert is_exact(reduction.form, *found)
