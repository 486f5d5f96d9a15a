"""Multipliers satisfy the conditions of optimality, and predict the cost's change."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp.exact import multipliers, solve_lexicographic

BOX = (-0.1, 0.3, -0.2, 0.3)
WEIGHT = (1.0, 0.2, 0.5)


def unit(lo, hi, steps=997):
    return st.integers(0, steps).map(lambda k: lo + (hi - lo) * k / steps)


angle = st.sampled_from([0.1, 0.7, 1.3, 2.0, 2.9, 3.6, 4.4, 5.5])


@st.composite
def level(draw):
    made = []
    for theta in draw(st.lists(angle, max_size=3)):
        size = 10.0 ** draw(st.integers(-3, 3))
        b = draw(unit(-0.3, 0.4))
        made.append((size * math.cos(theta), size * math.sin(theta), size * b))
    return made


@settings(max_examples=300, deadline=None)
@given(st.lists(level(), min_size=1, max_size=3), unit(-0.6, 0.6), unit(-0.6, 0.6))
def test_conditions_of_optimality(levels, v, w):
    answer = solve_lexicographic(WEIGHT, (v, w), BOX, levels)
    found = multipliers(WEIGHT, (v, w), BOX, levels, answer)
    rows = [row for one in levels for row in one]
    assert len(found.rows) == len(rows)
    x, y = v - answer.v, w - answer.omega
    g_v = WEIGHT[0] * x + WEIGHT[1] * y
    g_w = WEIGHT[1] * x + WEIGHT[2] * y
    for value, (a, c, _) in zip(found.rows, rows, strict=True):
        g_v, g_w = g_v - value * a, g_w - value * c
    g_v -= found.box[1] - found.box[0]
    g_w -= found.box[3] - found.box[2]
    assert math.hypot(g_v, g_w) <= 1e-11
    assert min(*found.rows, *found.box) >= 0.0
    slack = [s for s, one in zip(answer.slacks, levels, strict=True) for _ in one]
    for index in found.active:
        if index < len(rows):
            a, c, b = rows[index]
            excess = (a * answer.v + c * answer.omega - b) / math.hypot(a, c)
            assert excess == pytest.approx(slack[index], abs=1e-9)
        else:
            k = index - len(rows)
            assert (answer.v, answer.omega)[k // 2] == pytest.approx(BOX[k], abs=1e-9)


def test_multiplier_is_the_price_of_the_row():
    """d(cost)/db = -lambda, by finite differences."""
    row, nominal = (0.8, 0.6, 0.05), (0.2, 0.2)

    def least_cost(b):
        answer = solve_lexicographic(WEIGHT, nominal, BOX, [[(*row[:2], b)]])
        x, y = answer.v - nominal[0], answer.omega - nominal[1]
        return 0.5 * (WEIGHT[0] * x * x + 2 * WEIGHT[1] * x * y + WEIGHT[2] * y * y)

    answer = solve_lexicographic(WEIGHT, nominal, BOX, [[row]])
    found = multipliers(WEIGHT, nominal, BOX, [[row]], answer)
    price = (least_cost(row[2] - 1e-5) - least_cost(row[2] + 1e-5)) / 2e-5
    assert found.rows[0] == pytest.approx(price, rel=1e-8)
    assert found.active == (0,)
    assert found.box == (0.0, 0.0, 0.0, 0.0)


def test_nothing_holds_a_nominal_command_inside():
    levels = [[(1.0, 0.0, 0.2), (0.0, 0.0, 1.0)]]
    answer = solve_lexicographic(WEIGHT, (0.1, 0.1), BOX, levels)
    found = multipliers(WEIGHT, (0.1, 0.1), BOX, levels, answer)
    assert found == ((0.0, 0.0), (0.0, 0.0, 0.0, 0.0), ())
