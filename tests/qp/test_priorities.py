"""What gives way to what, the return from outside a safe set, and the one-shot program."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import BackendError, ConfigurationError
from clfcbf.qp import (
    Capability,
    Ladder,
    QpSolution,
    QpStatus,
    available_backends,
    one_shot_problem,
    paper_program,
    solve_lexicographic,
    solve_one_shot,
    solve_qp,
)

NAMES = available_backends()
WEIGHT = (1.0, 0.0, 0.3)
BOX = (-0.1, 0.3, -0.2, 0.3)
SAFETY, STABILITY, COMFORT = 10, 20, 30
STOP, GO, TURN = (1.0, 0.0, 0.0), (-1.0, 0.0, -0.2), (0.0, -1.0, -0.1)
unit = st.integers(0, 997)
rows = st.lists(
    st.builds(lambda t, k: (math.cos(t / 50), math.sin(t / 50), -0.3 + 0.7 * k / 997), unit, unit),
    max_size=3,
)


def test_ascending_priorities_are_the_order():
    for given_rows in ({SAFETY: [STOP], STABILITY: [GO]}, {STABILITY: [GO], SAFETY: [STOP]}):
        answer = Ladder().solve(WEIGHT, (0.3, 0.0), BOX, given_rows)
        assert answer.v == 0.0
        assert answer.slacks == {SAFETY: 0.0, STABILITY: pytest.approx(0.2)}
        assert answer.admissible


def test_another_order_gives_another_answer():
    ladder = Ladder(order=(STABILITY, SAFETY))
    answer = ladder.solve(WEIGHT, (0.3, 0.0), BOX, {SAFETY: [STOP], STABILITY: [GO]})
    assert answer.v == pytest.approx(0.2)
    assert answer.slacks == {STABILITY: 0.0, SAFETY: pytest.approx(0.2)}


def test_the_least_important_still_counts():
    """A level that gave way takes nothing from those after it that can hold."""
    answer = Ladder().solve(
        WEIGHT, (0.3, 0.0), BOX, {SAFETY: [STOP], STABILITY: [GO], COMFORT: [TURN]}
    )
    assert (answer.v, answer.omega) == pytest.approx((0.0, 0.1))
    assert answer.slacks[COMFORT] == 0.0


def test_a_rigid_level_that_cannot_hold_is_told():
    ladder = Ladder(rigid=frozenset({SAFETY}))
    fine = ladder.solve(WEIGHT, (0.3, 0.0), BOX, {SAFETY: [STOP], STABILITY: [GO]})
    assert fine.admissible
    beyond = (1.0, 0.0, -0.5)
    answer = ladder.solve(WEIGHT, (0.3, 0.0), BOX, {SAFETY: [beyond], STABILITY: [GO]})
    assert answer.unmet == (SAFETY,)
    assert not answer.admissible
    assert answer.v == BOX[0]  # the least violation
    assert answer.slacks[SAFETY] == pytest.approx(0.4)
    blank = ladder.solve(WEIGHT, (0.3, 0.0), BOX, {SAFETY: [STOP, (0.0, 0.0, -1.0)]})
    assert blank.unmet == (SAFETY,)
    relaxed = ladder.solve(WEIGHT, (0.3, 0.0), BOX, {STABILITY: [(0.0, 0.0, -1.0)]})
    assert relaxed.admissible


def test_data_that_is_not_finite():
    assert Ladder().solve(WEIGHT, (math.nan, 0.0), BOX, {SAFETY: [STOP]}) is None


def test_the_order_is_checked():
    with pytest.raises(ConfigurationError, match="repeat"):
        Ladder(order=(1, 1))
    with pytest.raises(ConfigurationError, match=r"\[3\] are not in order"):
        Ladder(order=(1, 2), rigid=frozenset({3}))
    with pytest.raises(ConfigurationError, match="must come first"):
        Ladder(order=(1, 2), rigid=frozenset({2}))
    with pytest.raises(ConfigurationError, match="must come first"):
        Ladder(rigid=frozenset({2})).solve(WEIGHT, (0, 0), BOX, {1: [STOP], 2: [GO]})
    with pytest.raises(ConfigurationError, match=r"\[7\] are not in order"):
        Ladder(order=(1,)).solve(WEIGHT, (0, 0), BOX, {7: [STOP]})
    with pytest.raises(BackendError, match="oracle"):
        Ladder(backend="oracle").solve(WEIGHT, (0, 0), BOX, {7: [STOP]})


@settings(max_examples=40, deadline=None)
@given(rows, rows, unit, unit, st.sampled_from(["exact", "daqp"]))
def test_levels_are_those_of_the_exact_program(first, second, v, omega, backend):
    nominal = (v / 997 - 0.5, omega / 997 - 0.5)
    answer = Ladder(backend=backend).solve(WEIGHT, nominal, BOX, {5: second, 2: first})
    exact = solve_lexicographic(WEIGHT, nominal, BOX, [first, second])
    assert (answer.v, answer.omega) == pytest.approx((exact.v, exact.omega), abs=1e-6)
    assert tuple(answer.slacks.values()) == exact.slacks
    assert list(answer.slacks) == [2, 5]


@settings(max_examples=60, deadline=None)
@given(st.floats(-2.0, -1e-3), st.floats(0.2, 5.0), st.floats(-math.pi, math.pi), unit, unit)
def test_outside_the_safe_set_the_command_returns(h, gain, angle, v, omega):
    """Where h < 0 the row asks for dh/dt >= gain |h|; the box gives it, or as much as it can."""
    gradient = (0.8 * math.cos(angle), 0.8 * math.sin(angle))  # of h along (v, omega)
    row = (-gradient[0], -gradient[1], gain * h)
    nominal = (v / 997 - 0.5, omega / 997 - 0.5)
    answer = Ladder().solve(WEIGHT, nominal, BOX, {SAFETY: [row]})
    rate = gradient[0] * answer.v + gradient[1] * answer.omega
    fastest = max(gradient[0] * x + gradient[1] * y for x in BOX[:2] for y in BOX[2:])
    assert rate == pytest.approx(fastest, abs=1e-12) or rate >= -gain * h - 1e-12
    assert answer.slacks[SAFETY] == pytest.approx(max(0.0, -gain * h - fastest) / 0.8, abs=1e-9)
    assert rate > 0.0  # every direction of return is in this box: it returns


def one_shot(seed):
    rng = np.random.default_rng(seed)
    box = (*np.sort(rng.uniform(-0.5, 0.5, 2)), *np.sort(rng.uniform(-0.5, 0.5, 2)))
    hard = [tuple(row) for row in rng.normal(size=(int(rng.integers(0, 3)), 3)).tolist()]
    soft = tuple(rng.normal(size=3).tolist())
    reference = tuple(rng.uniform(-0.5, 0.5, 2).tolist())
    weight = (1.0, float(rng.uniform(-0.3, 0.3)), 0.5)
    return weight, reference, tuple(map(float, box)), hard, soft, float(10.0 ** rng.uniform(0, 5))


@pytest.mark.parametrize("name", NAMES)
def test_one_shot_through_any_backend(name):
    limit = NAMES and 3
    feasible = 0
    for seed in range(12):
        program = one_shot(seed)
        exact = paper_program(*program)
        answer = solve_one_shot(*program, name)
        assert (answer.v, answer.omega) == pytest.approx((exact.v, exact.omega), abs=1e-6)
        assert answer.delta == pytest.approx(exact.delta, abs=1e-5)
        assert answer.feasible == exact.feasible
        if exact.feasible:
            feasible += 1
            if name != "exact":
                assert answer.health.used, answer.health
                assert answer.health.distance <= 1e-6
            v_lo, v_hi, w_lo, w_hi = program[2]
            assert v_lo <= answer.v <= v_hi
            assert w_lo <= answer.omega <= w_hi
            for a, c, b in program[3]:
                assert a * answer.v + c * answer.omega <= b + 1e-13
        else:
            assert answer.health is None
    assert feasible >= limit


def test_one_shot_in_three_variables_is_the_one_in_two():
    for seed in range(40):
        program = one_shot(seed)
        exact = paper_program(*program)
        solved = solve_qp(one_shot_problem(*program), "daqp")
        assert solved.found == exact.feasible
        if solved.found:
            expected = (exact.v, exact.omega, exact.delta)
            assert solved.x == pytest.approx(expected, abs=1e-6)
        else:
            assert solved.status is QpStatus.INFEASIBLE


class Wrong:
    name = "wrong"
    capability = Capability()

    def solve(self, problem):
        return QpSolution(np.array([0.0, 0.0, 7.0]), QpStatus.OPTIMAL, self.name)


def test_one_shot_falls_back_and_says_so():
    program = next(p for p in map(one_shot, range(9)) if paper_program(*p).feasible)
    answer = solve_one_shot(*program, Wrong())
    exact = paper_program(*program)
    assert answer[:4] == exact
    assert not answer.health.used
    assert answer.health.refused
    with pytest.raises(ConfigurationError, match="penalty"):
        solve_one_shot(*program[:-1], -1.0, Wrong())
