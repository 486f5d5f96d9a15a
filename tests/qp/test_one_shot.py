"""The paper's program against rational enumeration of the same definition."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.qp.exact import paper_program

BOX = (-0.1, 0.3, -0.2, 0.3)
WEIGHT = (1.0, 0.0, 0.3)


def unit(lo, hi, steps=997):
    return st.integers(0, steps).map(lambda k: lo + (hi - lo) * k / steps)


@st.composite
def programs(draw):
    weight = (draw(unit(0.2, 2)), draw(unit(-0.3, 0.3)), draw(unit(0.5, 2)))
    row = st.tuples(unit(-1, 1), unit(-1, 1), unit(-0.1, 0.5))
    # A zero row makes the reference divide by its length.
    hard = draw(st.lists(row.filter(lambda r: abs(r[0]) + abs(r[1]) > 0.01), max_size=3))
    soft = (draw(unit(-1, 1)), draw(unit(-1, 1)), draw(unit(-0.6, 0.2)))
    penalty = 10.0 ** draw(st.integers(-2, 9))
    return weight, (draw(unit(-0.5, 0.5)), draw(unit(-0.5, 0.5))), BOX, hard, soft, penalty


@settings(max_examples=300, deadline=None)
@given(programs())
def test_against_enumeration(reference, program):
    answer = paper_program(*program)
    point = reference.paper(*program)
    assert answer.feasible == (point is not None)
    assert BOX[0] <= answer.v <= BOX[1]
    assert BOX[2] <= answer.omega <= BOX[3]
    a, c, b = program[4]
    assert answer.delta == pytest.approx(max(0.0, a * answer.v + c * answer.omega - b), abs=1e-15)
    if point is not None:
        assert abs(Fraction(answer.v) - point[0]) <= 1e-12
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


@settings(max_examples=60, deadline=None)
@given(programs())
def test_stationary_in_the_slack(program):
    """Finite differences of the one-variable cost along any way into the set do not fall."""
    weight, reference_command, box, _, soft, penalty = program
    answer = paper_program(weight, reference_command, box, [], soft, penalty)

    def value(v, w):
        q11, q12, q22 = weight
        x, y = v - reference_command[0], w - reference_command[1]
        delta = max(0.0, soft[0] * v + soft[1] * w - soft[2])
        return q11 * x * x + 2 * q12 * x * y + q22 * y * y + penalty * delta * delta

    best = value(answer.v, answer.omega)
    for k in range(16):
        for step in (1e-4, 1e-2):
            v = answer.v + step * math.cos(k * math.pi / 8)
            w = answer.omega + step * math.sin(k * math.pi / 8)
            v, w = min(max(v, box[0]), box[1]), min(max(w, box[2]), box[3])
            assert value(v, w) >= best * (1 - 1e-12) - 1e-15


def test_closed_form_without_limits():
    r"""u* = -c r Q^-1 a / (1 + c a'Q^-1 a), delta* = r / (1 + c a'Q^-1 a), r = -b."""
    a, c, b, penalty = 0.6, -0.4, -0.5, 7.0
    answer = paper_program(WEIGHT, (0.0, 0.0), (-9.0, 9.0, -9.0, 9.0), [], (a, c, b), penalty)
    gain = a * a / WEIGHT[0] + c * c / WEIGHT[2]
    factor = penalty * -b / (1.0 + penalty * gain)
    assert answer.v == pytest.approx(-factor * a / WEIGHT[0], rel=1e-14)
    assert answer.omega == pytest.approx(-factor * c / WEIGHT[2], rel=1e-14)
    assert answer.delta == pytest.approx(-b / (1.0 + penalty * gain), rel=1e-13)


def test_soft_row_without_direction_only_costs():
    answer = paper_program(WEIGHT, (0.2, 0.1), BOX, [], (0.0, 0.0, -0.7), 10.0)
    assert answer == (0.2, 0.1, 0.7, True)


def test_infeasible_hard_rows_are_flagged_and_stay_in_the_box():
    hard = [(1.0, 0.0, -0.5)]
    answer = paper_program(WEIGHT, (0.2, 0.1), BOX, hard, (-1.0, 0.0, 0.0), 10.0)
    assert not answer.feasible
    assert (answer.v, answer.omega) == (-0.1, 0.1)
    assert answer.delta == pytest.approx(0.1, rel=1e-15)
    assert not paper_program(WEIGHT, (0.2, 0.1), BOX, [(0.0, 0.0, -1.0)], hard[0], 1.0).feasible


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(12))
def test_non_finite_data_is_flagged(value, place):
    numbers = [0.1, 0.1, *BOX, 1.0, 0.5, 0.3, 0.5, 1.0, 0.3]
    numbers[place] = value
    hard, soft = [tuple(numbers[6:9])], tuple(numbers[9:])
    answer = paper_program(WEIGHT, tuple(numbers[:2]), tuple(numbers[2:6]), hard, soft, 10.0)
    assert not answer.feasible
    assert math.isnan(answer.v)


@pytest.mark.parametrize("penalty", [0.0, -1.0, math.nan, math.inf])
def test_penalty_must_be_positive(penalty):
    with pytest.raises(ConfigurationError, match="penalty"):
        paper_program(WEIGHT, (0.0, 0.0), BOX, [], (1.0, 0.0, 0.0), penalty)


def test_a_zero_row_that_holds_with_nothing_to_spare_is_feasible():
    answer = paper_program(WEIGHT, (0.2, 0.1), BOX, [(0.0, 0.0, 0.0)], (1.0, 0.0, 1.0), 10.0)
    assert answer == (0.2, 0.1, 0.0, True)


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ((0.1, 0.1, -0.2, 0.3), (0.1, 0.1)),
        ((-0.1, 0.3, -0.15, -0.15), (0.2, -0.15)),
        ((-0.3, 0.1, -0.4, 0.05), (0.1, 0.05)),
        ((-0.3, -0.1, -0.4, -0.05), (-0.1, -0.05)),
        ((0.25, 0.3, 0.15, 0.3), (0.25, 0.15)),
    ],
)
def test_any_box_that_is_not_reversed_has_an_answer(box, expected):
    answer = paper_program(WEIGHT, (0.2, 0.1), box, [], (0.0, 0.0, 1.0), 10.0)
    assert answer == (*expected, 0.0, True)


@pytest.mark.parametrize("box", [(0.1, -0.1, -0.2, 0.3), (-0.1, 0.1, 0.3, -0.2)])
def test_a_reversed_box_has_none(box):
    answer = paper_program(WEIGHT, (0.0, 0.0), box, [], (1.0, 0.0, 1.0), 10.0)
    assert all(map(math.isnan, answer[:3]))
    assert answer.feasible is False
