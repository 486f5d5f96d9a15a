"""The conformance suite: every installed backend passes, and a bad one does not."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction

import numpy as np
import pytest

from clfcbf.errors import BackendError
from clfcbf.qp import Capability, QpSolution, QpStatus, available_backends, get_backend, solve_qp
from clfcbf.qp.certificates import proves_infeasible
from clfcbf.qp.conformance import TOLERANCE, cases, check_backend, check_case
from clfcbf.qp.conformance_families import FAMILIES, enumerate_active_sets
from clfcbf.qp.verify import is_convex, verify

NAMES = available_backends()

LIMITS = {
    # What each backend announces that it cannot take; everything else it must answer.
    "exact": Capability(max_variables=2, semidefinite=False, time_limit=True),
    "quadprog": Capability(semidefinite=False),
    "casadi-daqp": Capability(semidefinite=False),
    "qpsolvers:quadprog": Capability(semidefinite=False),
    "clarabel": Capability(time_limit=True),
    "daqp": Capability(time_limit=True),
    "osqp": Capability(time_limit=True, warm_start=True),
    "proxqp": Capability(warm_start=True),
    "casadi-ipopt": Capability(time_limit=True),
}

COUNTS = {name: 4 if name.startswith(("casadi-ipopt", "qpsolvers")) else 8 for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_every_backend_passes(name):
    report = check_backend(name, seed=1, count=COUNTS[name])
    assert report.passed, str(report)
    assert report.worst_error <= 1e-9  # the polish leaves rounding only
    assert all(r.agreed + r.declined == r.programs == COUNTS[name] for r in report.families)


@pytest.mark.parametrize("name", NAMES)
def test_limits_are_those_of_the_table(name):
    capability, expected = get_backend(name).capability, LIMITS.get(name, Capability())
    for limit in ("max_variables", "semidefinite", "equalities", "time_limit", "warm_start"):
        assert getattr(capability, limit) == getattr(expected, limit), limit
    report = check_backend(name, seed=2, count=4)
    declined = {r.family for r in report.families if r.declined}
    if expected.max_variables is None and expected.semidefinite:
        assert not declined
    elif expected.max_variables is None:
        assert declined == {"singular"}
    else:
        assert "feasible" not in declined
        assert "sizes and equalities" in declined


GIVES_UP = {
    # Programs that these solvers were seen to give up on, one in a thousand of the suite's.
    "casadi-qrqp": [("singular", 11, 99), ("singular", 12, 116)],
    "qpsolvers:osqp": [("singular", 11, 111)],
    "qpsolvers:proxqp": [("enumerated", 11, 40)],
}


@pytest.mark.parametrize("name", GIVES_UP)
def test_who_gives_up_is_not_wrong_and_not_alone(name):
    """No answer rather than a bad one; and the usual fallbacks have it."""
    if name not in NAMES:
        pytest.skip(f"{name} is not installed")
    for family, seed, number in GIVES_UP[name]:
        case = cases(seed, number + 1, (family,))[number]
        alone = solve_qp(case.problem, name, fallback=())
        assert not any(attempt.refused for attempt in alone.attempts)
        assert alone.x is None or np.abs(alone.x - case.x).max() <= 1e-6
        answer = solve_qp(case.problem, name)
        assert answer.x == pytest.approx(case.x, abs=1e-6)
        assert (answer.backend == name) == alone.found


@pytest.mark.parametrize("case", cases(seed=3, count=2), ids=str)
def test_one_case_at_a_time(case):
    """How a user's own backend is tested in pytest."""
    check_case("daqp", case)


def test_the_same_seed_gives_the_same_cases():
    first, second, other = (cases(seed, 3) for seed in (5, 5, 6))
    assert len(first) == 3 * len(FAMILIES)
    for one, two in zip(first, second, strict=True):
        assert str(one) == str(two)
        for name in ("P", "q", "G", "h", "lb", "ub", "A", "b"):
            values = getattr(one.problem, name), getattr(two.problem, name)
            assert np.array_equal(*values, equal_nan=True)
    assert any(
        not np.array_equal(a.problem.q, b.problem.q) for a, b in zip(first, other, strict=True)
    )


def test_reference_answers_are_optimal():
    """By the conditions of optimality, which no generator looks at."""
    seen = 0
    for case in cases(seed=4, count=12):
        problem = case.problem
        if case.x is not None:
            seen += 1
            assert verify(problem, case.x).worst <= 1e-8, str(case)
            assert is_convex(problem, strictly=case.family != "singular")
        elif case.expected == {QpStatus.INFEASIBLE}:
            assert proves_infeasible(problem), str(case)
        elif case.expected == {QpStatus.UNBOUNDED}:
            _, vectors = np.linalg.eigh(problem.P)
            fall = vectors[:, 0] * -np.sign(vectors[:, 0] @ problem.q)
            assert np.abs(problem.G @ fall).max() <= 1e-9
            assert problem.q @ fall < -0.5
        else:
            assert not problem.well_posed or not is_convex(problem)
    assert seen > 80


def test_the_infeasible_ones_are_so_by_1e_4():
    """Moving the contradicting rows apart by the gap, not less, makes room."""
    for case in cases(seed=0, count=6, families=("infeasible by 1e-4",)):
        p = case.problem
        rows = 3 if case.number % 2 else 2
        for widened, feasible in ((0.9e-4, False), (1.1e-4, True)):
            h = p.h.copy()
            h[-1] += widened
            assert proves_infeasible(dataclass_with(p, h)) is not feasible
        assert np.linalg.matrix_rank(p.G[-rows:]) == rows - 1


def dataclass_with(problem, h):
    return type(problem)(problem.P, problem.q, problem.G, h, problem.lb, problem.ub)


def test_enumeration_against_rational_arithmetic(reference):
    for case in cases(seed=7, count=10, families=("feasible",)):
        p = case.problem
        (q11, q12), (_, q22) = p.P.tolist()
        c, d = map(Fraction, p.q.tolist())
        f11, f12, f22 = map(Fraction, (q11, q12, q22))
        det = f11 * f22 - f12 * f12
        centre = ((f12 * d - f22 * c) / det, (f12 * c - f11 * d) / det)
        sides = reference.sides((p.lb[0], p.ub[0], p.lb[1], p.ub[1]))
        rows = [
            tuple(map(Fraction, (*g, h))) for g, h in zip(p.G.tolist(), p.h.tolist(), strict=True)
        ]
        expected = reference.project((q11, q12, q22), centre, sides + rows)
        assert enumerate_active_sets(p) == pytest.approx([float(x) for x in expected], abs=1e-12)


class Spoilt:
    """DAQP with a flaw."""

    name = "spoilt"

    def __init__(self, flaw, capability=None):
        self.flaw = flaw
        self.capability = capability or Capability()

    def solve(self, problem):
        return self.flaw(problem, get_backend("daqp"))


def off(problem, honest):
    answer = honest.solve(problem)
    return answer if answer.x is None else dataclasses.replace(answer, x=answer.x + 1e-5)


def blind_to_equalities(problem, honest):
    rows = problem.P, problem.q, problem.G, problem.h, problem.lb, problem.ub
    return honest.solve(type(problem)(*rows))


def soft(problem, honest):
    """Rows given up at a price, and no word of it."""
    answer = honest.solve(problem)
    if answer.x is not None:
        return answer
    return QpSolution(np.zeros(problem.n), QpStatus.OPTIMAL, "spoilt")


def gives_up(problem, honest):
    return QpSolution(None, QpStatus.ITERATION_LIMIT, "spoilt")


def declines(problem, honest):
    raise BackendError("not today")


def breaks_on_zero_rows(problem, honest):
    if not problem.G.any(axis=1).all():
        raise ZeroDivisionError
    return honest.solve(problem)


@pytest.mark.parametrize(
    ("flaw", "family"),
    [
        (off, "feasible"),
        (blind_to_equalities, "sizes and equalities"),
        (gives_up, "feasible"),
        (declines, "feasible"),
        (breaks_on_zero_rows, "zero rows"),
    ],
)
def test_bad_backends_fail_and_the_program_is_at_hand(flaw, family):
    report = check_backend(Spoilt(flaw), count=4)
    assert not report.passed
    assert report.family(family).failed > 0
    first = report.first_failure
    assert set(first.data) == {"P", "q", "G", "h", "lb", "ub", "A", "b"}
    assert "FAILED" in str(report)
    assert str(first.case) in str(report)
    with pytest.raises(AssertionError, match=str(first.case)):
        check_case(Spoilt(flaw), first.case)


def test_answers_refused_are_counted():
    report = check_backend(Spoilt(soft), count=4)
    assert report.family("infeasible by 1e-4").refused == 4
    assert report.family("feasible").refused == 0


def test_declining_everything_is_not_passing():
    limited = Spoilt(declines, Capability(max_variables=1))
    report = check_backend(limited, count=2, families=("feasible", "metamorphic"))
    assert report.first_failure is None
    assert not report.passed


def test_report_reads():
    report = check_backend("exact", count=3)
    lines = str(report).splitlines()
    assert lines[0] == "exact: passed"
    assert len(lines) == 2 + len(FAMILIES)
    assert math.isfinite(report.worst_error)
    assert TOLERANCE == 1e-6
