"""Fallbacks, counters, limits, workspaces: what stands between a solver and a tick."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clfcbf.errors import BackendError, ConfigurationError
from clfcbf.qp import (
    Capability,
    QpSolution,
    QpStatus,
    QuadraticProgram,
    SolverHealth,
    available_backends,
    get_backend,
    solve_ladder,
    solve_qp,
)
from clfcbf.qp.backends._solver import Claim, SolverBackend
from clfcbf.qp.backends._workspace import Loader
from clfcbf.qp.conformance import cases
from clfcbf.qp.lexicographic import BackendHealth
from clfcbf.qp.verify import Duals, verify

NAMES = available_backends()
GOOD = QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [1], [-1, -1], [1, 1])
ANSWER = [0.6, 0.2]


class Fixed:
    """Says one thing."""

    def __init__(self, claim, name="fixed", **capability):
        self.claim, self.name = claim, name
        self.capability = Capability(**capability)
        self.asked = []

    def solve(self, problem, time_limit=None):
        self.asked.append(time_limit)
        return self.claim


WRONG = QpSolution(np.array([0.5, 0.2]), QpStatus.OPTIMAL, "fixed")


def test_fallbacks_in_order_and_counted():
    health = SolverHealth()
    solver = Fixed(WRONG)
    answer = solve_qp(GOOD, solver, health=health)
    assert answer.x == pytest.approx(ANSWER, abs=1e-12)
    assert [(a.backend, a.refused) for a in answer.attempts] == [("fixed", True), ("exact", False)]
    answer = solve_qp(GOOD, solver, fallback=("daqp",), health=health)
    assert answer.backend == "daqp"
    answer = solve_qp(GOOD, solver, fallback=(), health=health)
    assert answer.x is None
    assert "refused" in answer.message
    counts = health.backends["fixed"]
    assert (counts.asked, counts.used, counts.refused, counts.failed) == (3, 0, 3, 0)
    assert (health.fallbacks, health.unsettled) == (2, 1)
    assert counts.slowest > 0.0
    assert "fixed: 3 asked, 0 used, 0 corrected, 3 refused, 0 failed" in str(health)


def test_a_proof_of_infeasibility_needs_no_second_opinion():
    health = SolverHealth()
    nothing = QuadraticProgram(np.eye(3), np.zeros(3), [[1, 0, 0], [-1, 0, 0]], [0, -1])
    claim = QpSolution(None, QpStatus.ITERATION_LIMIT, "fixed")
    answer = solve_qp(nothing, Fixed(claim), health=health)
    assert answer.status is QpStatus.INFEASIBLE
    assert len(answer.attempts) == 1
    assert health.backends["fixed"].used == 1


def test_where_all_fail_the_first_ones_status_is_told():
    limited = Fixed(QpSolution(None, QpStatus.TIME_LIMIT, "fixed"))
    answer = solve_qp(GOOD, limited, fallback=("nobody",))
    assert answer.status is QpStatus.TIME_LIMIT
    assert [a.backend for a in answer.attempts] == ["fixed"]


def test_fallbacks_that_cannot_take_the_program_are_passed_over():
    """'exact' takes two variables; the next in the chain takes three."""
    problem = QuadraticProgram(np.eye(3), [-1, -1, -1], [[1, 1, 1]], [1])
    answer = solve_qp(problem, Fixed(WRONG))
    assert answer.backend == "daqp"
    assert answer.x == pytest.approx([1 / 3] * 3, abs=1e-9)


def test_a_backend_is_not_asked_twice():
    solver = Fixed(WRONG, name="exact")
    assert [a.backend for a in solve_qp(GOOD, solver).attempts] == ["exact", "daqp"]


def test_ticks_are_counted_too():
    health = SolverHealth()
    health.record_tick(None)
    health.record_tick(BackendHealth("osqp", True, "optimal", 0.0, ""))
    health.record_tick(BackendHealth("osqp", False, "optimal", 1.0, "far", True))
    health.record_tick(BackendHealth("osqp", False, "time limit", math.inf, ""))
    counts = health.backends["osqp"]
    assert (counts.asked, counts.used, counts.refused, counts.failed) == (3, 1, 1, 1)
    assert health.fallbacks == 2


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, math.inf])
def test_time_limits_are_checked(limit):
    with pytest.raises(ConfigurationError, match="time_limit"):
        solve_qp(GOOD, "exact", time_limit=limit)


@pytest.mark.parametrize("name", NAMES)
def test_time_limit_is_kept_or_declined(name):
    if get_backend(name).capability.time_limit:
        answer = solve_qp(GOOD, name, fallback=(), time_limit=10.0)
        assert answer.x == pytest.approx(ANSWER, abs=1e-6)
    else:
        with pytest.raises(BackendError, match=f"'{name}' cannot be given a time limit"):
            solve_qp(GOOD, name, time_limit=10.0)


@pytest.mark.parametrize("name", ["clarabel", "osqp", "casadi-ipopt"])
def test_time_limit_reaches_the_solver(name):
    """A nanosecond is too short for anybody who looks at the clock."""
    if name not in NAMES:
        pytest.skip(f"{name} is not installed")
    case = next(c for c in cases(0, 20, ("sizes and equalities",)) if c.problem.n == 30)
    solver = get_backend(name)
    short = solver._ask(_form(case.problem), 1e-9)
    assert short.status is not QpStatus.OPTIMAL
    full = solver._ask(_form(case.problem), None)
    assert full.status is QpStatus.OPTIMAL


def _form(problem):
    from clfcbf.qp.reduction import reduce

    return reduce(problem).form


def test_fallbacks_get_the_time_limit_they_can_keep():
    keeps = Fixed(WRONG, time_limit=True)
    assert solve_qp(GOOD, keeps, fallback=("quadprog", "exact"), time_limit=1.0).found
    assert keeps.asked == [1.0]


class Recorder:
    """A workspace that remembers what it was through."""

    made = 0

    def __init__(self, form):
        type(self).made += 1
        self.solved = 0

    def solve(self, form, time_limit):
        self.solved += 1
        Recorder.last = self
        behaviour = Recorder.behaviour
        if isinstance(behaviour, Exception):
            raise behaviour
        return behaviour


def test_a_workspace_that_failed_is_thrown_away():
    """A failed solve is nobody's warm start."""
    Recorder.made = 0
    solver = SolverBackend("recorder", Capability(), Recorder)
    fine = Claim(QpStatus.OPTIMAL, np.zeros(2))
    Recorder.behaviour = fine
    solver.solve(GOOD)
    solver.solve(GOOD)
    assert (Recorder.made, Recorder.last.solved) == (1, 2)
    for bad in (
        Claim(QpStatus.INFEASIBLE),
        Claim(QpStatus.ITERATION_LIMIT, np.zeros(2)),
        Claim(QpStatus.NUMERICAL_ERROR, np.full(2, np.nan)),
    ):
        Recorder.behaviour = bad
        solver.solve(GOOD)
        made = Recorder.made
        Recorder.behaviour = fine
        solver.solve(GOOD)
        assert (Recorder.made, Recorder.last.solved) == (made + 1, 1)
    Recorder.behaviour = RuntimeError("broken")
    with pytest.raises(RuntimeError):
        solver.solve(GOOD)
    Recorder.behaviour = fine
    solver.solve(GOOD)
    assert Recorder.last.solved == 1


def test_workspaces_are_few():
    Recorder.behaviour = Claim(QpStatus.OPTIMAL, np.zeros(1))
    solver = SolverBackend("recorder", Capability(), Recorder)
    for n in range(1, 20):
        Recorder.behaviour = Claim(QpStatus.OPTIMAL, np.zeros(n))
        solver.solve(QuadraticProgram(np.eye(n), np.zeros(n)))
    assert len(solver._kept.__dict__) <= 8


def test_what_is_not_finite_never_reaches_a_solver():
    bad = QuadraticProgram(np.eye(2), [np.nan, 0])
    spy = Fixed(WRONG)
    assert solve_qp(bad, spy).status is QpStatus.INVALID_INPUT
    assert spy.asked == []
    Recorder.made = 0
    solver = SolverBackend("recorder", Capability(), Recorder)
    assert solver.solve(bad).status is QpStatus.INVALID_INPUT
    assert Recorder.made == 0


BAD = (
    QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [-4], [-1, -1], [1, 1]),
    QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [np.nan], [-1, -1], [1, 1]),
    QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [-1e20], [-1, -1], [1, 1]),
    QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [1], [-1, 2], [1, 1]),
)


@pytest.mark.parametrize("name", NAMES)
def test_an_answer_does_not_depend_on_what_went_before(name):
    """To the last bit, also after failures: a tick can be replayed from its log."""
    solver = get_backend(name)
    stream = [c.problem for c in cases(2, 6, ("feasible",))]
    first = [solver.solve(p).x.tobytes() for p in stream]
    for p, bad in zip(stream, BAD * 2, strict=False):
        assert not solve_qp(bad, name, fallback=()).found
        solver.solve(p)
    assert [solver.solve(p).x.tobytes() for p in reversed(stream)] == first[::-1]


@pytest.mark.parametrize("name", ["osqp", "proxqp"])
def test_warm_starts_agree_with_cold_ones(name):
    if name not in NAMES:
        pytest.skip(f"{name} is not installed")
    from importlib import import_module

    warm = import_module(f"clfcbf.qp.backends.{name}").create(name, warm_start=True)
    q = np.array([-1.0, -1.0])
    for k in range(30):
        if k == 15:
            assert warm.solve(BAD[0]).x is None
        problem = QuadraticProgram(np.eye(2), q, [[1, 2]], [1], [-1, -1], [1, 1])
        expected = solve_qp(problem).x
        assert solve_qp(problem, warm, fallback=()).x == pytest.approx(expected, abs=1e-9)
        q = q + np.array([0.02, -0.05])


@pytest.mark.parametrize("name", NAMES)
def test_multipliers_belong_to_the_rows_as_they_were_given(name):
    """Not reconstructed, and of rows of any length."""
    solver, seen = get_backend(name), 0
    for case in cases(3, 6, ("huge and tiny rows", "sizes and equalities", "1e8 scaling")):
        if case.problem.n > (solver.capability.max_variables or 99):
            continue
        answer = solver.solve(case.problem)
        duals = Duals(answer.dual, answer.dual_bounds, answer.dual_equalities)
        assert verify(case.problem, answer.x, duals).worst <= 1e-9
        seen += 1
    assert seen >= 3


def test_statuses_are_mapped_word_by_word():
    """Words of the solvers' own enumerations; an unknown one is a failure."""
    from clfcbf.qp.backends import clarabel, osqp, piqp, proxqp
    from clfcbf.qp.backends._solver import statuses

    assert statuses(clarabel._MEANINGS, "Solved")[0] is QpStatus.OPTIMAL
    assert statuses(clarabel._MEANINGS, "AlmostSolved")[0] is QpStatus.ITERATION_LIMIT
    assert statuses(clarabel._MEANINGS, "MaxTime")[0] is QpStatus.TIME_LIMIT
    assert statuses(clarabel._MEANINGS, "Exhausted") == (QpStatus.NUMERICAL_ERROR, "Exhausted")
    assert statuses(proxqp._MEANINGS, "QPSolverOutput.PROXQP_SOLVED")[0] is QpStatus.OPTIMAL
    assert statuses(piqp._MEANINGS, "Status.PIQP_NUMERICS")[0] is QpStatus.NUMERICAL_ERROR
    assert statuses(osqp._MEANINGS, "primal infeasible")[0] is QpStatus.INFEASIBLE


def test_words_of_the_installed_solvers_are_known():
    clarabel = pytest.importorskip("clarabel")
    from clfcbf.qp.backends import clarabel as ours

    words = {name for name in dir(clarabel.SolverStatus) if name[0].isupper()}
    assert set(ours._MEANINGS) <= words
    assert words - set(ours._MEANINGS) == {"Unsolved", "NumericalError", "CallbackTerminated"}


def test_a_backend_is_a_name_or_an_object():
    class Own:
        name = "own"
        capability = Capability()

        def solve(self, problem, time_limit=None):
            return get_backend("exact").solve(problem)

    own = Own()
    assert get_backend(own) is own
    weight, box, rows = (1.0, 0.0, 0.3), (-0.1, 0.3, -0.2, 0.3), [(1.0, 1.0, 0.1)]
    answer = solve_ladder(weight, (0.3, 0.2), box, (rows,), own)
    assert answer.health.backend == "own"
    assert answer.health.used
    for junk in (None, 3, Own, object(), ["exact"]):
        with pytest.raises(BackendError, match="needs name, capability and solve"):
            get_backend(junk)


def test_each_licence_is_named_once():
    for name in NAMES:
        licences = get_backend(name).capability.licence.split(" AND ")
        assert len(set(licences)) == len(licences), name


def test_the_first_program_is_set_up_and_the_others_update_it():
    calls = []
    load = Loader(lambda *a, **k: calls.append(("setup", a, k)), lambda *a: calls.append(a))
    load(1, b=2)
    load(3)
    load(4)
    assert calls == [("setup", (1,), {"b": 2}), (3,), (4,)]
