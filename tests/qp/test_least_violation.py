"""Rows that give way: the corner of least violation, and when floats do not decide it."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp.batch import solve_batch
from clfcbf.qp.exact import solve_lexicographic
from clfcbf.qp.least_violation import relax_to_corner
from clfcbf.qp.polygon import Delicate

BOX = (-0.1, 0.3, -0.2, 0.3)
WEIGHT = (1.0, 0.0, 0.3)
MILLION = 10**6


def check(reference, nominal, box, levels):
    answer = solve_lexicographic(WEIGHT, nominal, box, levels)
    point, slacks = reference.lexicographic(WEIGHT, nominal, box, levels)
    # Lengths are square roots: the reference's slack has 80 digits, its point is to that.
    exact = [float(x) for x in point] if point is not None else None
    assert answer.slacks == pytest.approx([float(s) for s in slacks], rel=1e-12, abs=1e-12)
    if exact is not None:
        assert (answer.v, answer.omega) == pytest.approx(exact, rel=0, abs=1e-12)
    return answer


@st.composite
def cuts(draw):
    """A row of rational length, its line within 0.6 of the box."""
    p, q = draw(st.integers(-12, 12)), draw(st.integers(1, 12))
    sign = draw(st.sampled_from([1.0, -1.0]))
    a, c = sign * float(p * p - q * q), sign * float(2 * p * q)
    v, w = (draw(st.integers(-500, 700)) / 1000.0 for _ in range(2))
    return (a, c, a * v + c * w)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.lists(cuts(), min_size=1, max_size=3), min_size=1, max_size=3))
def test_corners_against_enumeration(reference, levels):
    """Wherever a corner is named, it and its slacks are the lexicographic minimum."""
    _, slacks = reference.lexicographic(WEIGHT, (0.0, 0.0), BOX, levels)
    first = next((k for k, slack in enumerate(slacks) if slack > 0), None)
    if first is None:
        return
    try:
        v, w, ours = relax_to_corner(BOX, levels, first)
    except Delicate:
        return
    point, _ = reference.lexicographic(WEIGHT, (0.0, 0.0), BOX, levels)
    assert abs(Fraction(v) - point[0]) <= 1e-12
    assert abs(Fraction(w) - point[1]) <= 1e-12
    for mine, exact in zip(ours, slacks, strict=True):
        assert abs(Fraction(mine) - exact) <= Fraction(1, 10**12)


def test_most_relaxed_programs_end_at_a_corner():
    rng = np.random.default_rng(0)
    relaxed = cornered = 0
    for _ in range(400):
        angle = rng.uniform(-math.pi, math.pi, 4)
        rows = np.stack((np.cos(angle), np.sin(angle), rng.uniform(-0.35, 0.3, 4)), axis=1)
        levels = [[tuple(row) for row in half.tolist()] for half in (rows[:2], rows[2:])]
        answer = solve_lexicographic(WEIGHT, (0.3, -0.1), BOX, levels)
        if answer.relaxed:
            relaxed += 1
            first = 0 if answer.slacks[0] > 0.0 else 1
            try:
                corner = relax_to_corner(BOX, levels, first)
            except Delicate:
                continue
            cornered += 1
            assert (answer.v, answer.omega) == corner[:2]
    assert relaxed > 200
    assert cornered > 0.9 * relaxed


def straddling(turn, share, offset):
    """Two rows ``turn`` apart with an axis between them, both violated in the whole box."""
    rows = []
    for angle in (-turn * share, turn * (1.0 - share)):
        a, c = math.cos(angle), math.sin(angle)
        rows.append((a, c, a * 0.1 + c * offset - 0.6))
    return rows


@settings(max_examples=80, deadline=None)
@given(st.floats(-9.0, -2.0).map(lambda e: 10.0**e), st.integers(1, 9), st.integers(-190, 290))
def test_nearly_parallel_rows_of_one_level(reference, turn, share, offset):
    """Where they are equal decides, and their difference has lost its digits in floats."""
    level = straddling(turn, share / 10.0, offset / 1000.0)
    answer = check(reference, (0.2, 0.1), BOX, [level])
    batch = solve_batch(WEIGHT, [(0.2, 0.1)], BOX, [level])
    assert batch.twist[0] == pytest.approx((answer.v, answer.omega), rel=0, abs=1e-12)


@pytest.mark.parametrize("exponent", [-150, -158, -161, -170, -200, -290])
def test_a_short_row_that_holds_is_not_forgotten(reference, exponent):
    """Its squared length is zero in floats; the next row would push the command across it."""
    scale = 2.0 ** round(exponent * math.log2(10.0))
    short = (3.0 * scale, 4.0 * scale, 0.5 * scale)
    push = (5.0, -12.0, -3.0)
    nominal = (0.0, 0.0)
    assert short[0] * 0.0 <= short[2]
    check(reference, nominal, BOX, [[short], [push]])
    check(reference, nominal, BOX, [[short, push]])
    alone = solve_lexicographic(WEIGHT, nominal, BOX, [[push]])
    assert 3.0 * alone.v + 4.0 * alone.omega > 0.5  # without the short row it would be crossed
