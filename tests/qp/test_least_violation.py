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


def shared_corner(turns):
    """Rows of these directions, their lines through the corner (-0.1, -0.2) of the box."""
    return [(a, c, -0.1 * a - 0.2 * c) for a, c in turns]


@pytest.mark.parametrize("distance", [1e4, 1e6, 1e8])
@pytest.mark.parametrize("other", [(-3.0, 4.0), (4.0, -3.0), (-5.0, 12.0)])
def test_rows_that_fail_by_much_and_by_the_same(reference, distance, other):
    """Which of them fails by more is lost in the digits of the values; where they meet is not."""
    (a, c, b), (d, e, f) = shared_corner([(3.0, 4.0), other])
    for steps in (-3, -1, 0, 1, 2):
        far = f - math.hypot(d, e) * distance
        level = [(a, c, b - 5.0 * distance), (d, e, far + steps * math.ulp(far))]
        check(reference, (0.2, 0.1), BOX, [level])


@pytest.mark.parametrize("past", [-0.7, -0.3, 0.3, 0.7])
@pytest.mark.parametrize("tilt", [1e-3, 1e-2, -2e-3, -1e-2])
@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("others", [[], [(-3.0, -4.0, 1.0)]])
def test_a_row_that_cuts_a_corner_off_by_next_to_nothing(reference, past, tilt, side, others):
    """Or spares it; at a small angle to a side of the box, that is a long piece of that side."""
    a, c = ((-tilt, -1.0), (-1.0, -tilt))[side]
    b = a * BOX[0] + c * BOX[2] - past * 2.0**-40 * 0.9
    lowest = ((3.0, 4.0, -9.0), (4.0, 3.0, -9.0))[side]
    answer = check(reference, (0.2, 0.1), BOX, [[(a, c, b)], [*others, lowest]])
    assert a * answer.v + c * answer.omega <= b + 1e-16


def test_corners_of_boxes_without_width_need_no_fractions():
    """The row may say nothing of the input that has one value."""
    for box, row, corner in (
        ((0.1, 0.1, -0.2, 0.3), (0.0, 1.0, -1.0), (0.1, -0.2)),
        ((0.1, 0.1, -0.2, 0.3), (0.0, -2.0, -2.0), (0.1, 0.3)),
        ((-0.1, 0.3, 0.2, 0.2), (1.0, 0.0, -1.0), (-0.1, 0.2)),
        ((-0.1, 0.3, 0.2, 0.2), (-3.0, 0.0, -3.0), (0.3, 0.2)),
    ):
        v, w, slacks = relax_to_corner(box, [[row]], 0)
        assert (v, w) == corner
        size = math.hypot(row[0], row[1])
        assert slacks == pytest.approx(((row[0] * v + row[1] * w - row[2]) / size,), rel=1e-15)


def test_of_copies_of_a_row_the_tightest_decides_without_fractions():
    row = (3.0, 4.0, -2.0)
    for factor in (1.0, 3.0, 0.1):
        for looser in (0.0, 0.5):
            copy = (factor * row[0], factor * row[1], factor * (row[2] + looser))
            for level in ([row, copy], [copy, row]):
                v, w, slacks = relax_to_corner(BOX, [level], 0)
                assert (v, w) == (-0.1, -0.2)
                assert slacks == pytest.approx((0.18,), rel=1e-14)


@pytest.mark.parametrize(
    "levels",
    [
        [[(3.0, 4.0, -1.6), (-3.0, 4.0, -1.0)]],  # both rows fail by as much
        [[(3.0, 4.0, -1.1 - 2.0**-41)]],  # it may hold at the corner
        [[(3.0, 4.0, -1.1 + 2.0**-41)]],
    ],
)
def test_what_rounding_could_turn_is_left_to_fractions(reference, levels):
    with pytest.raises(Delicate):
        relax_to_corner(BOX, levels, 0)
    check(reference, (0.2, 0.1), BOX, levels)


@pytest.mark.parametrize("direction", [(3.0, 4.0), (-4.0, 3.0), (5.0, -12.0)])
def test_whether_a_less_important_level_gives_way_is_exact(reference, direction):
    """Its row passes the corner at which a more important one leaves it."""
    a, c = direction
    b = -0.1 * a - 0.2 * c
    for steps in range(-3, 4):
        levels = [[(3.0, 4.0, -9.0)], [(a, c, b + steps * math.ulp(b))]]
        answer = check(reference, (0.2, 0.1), BOX, levels)
        _, slacks = reference.lexicographic(WEIGHT, (0.2, 0.1), BOX, levels)
        assert [slack > 0.0 for slack in answer.slacks] == [slack > 0 for slack in slacks]


@pytest.mark.parametrize("row", [(3.0, 4.0), (-3.0, 4.0), (4.0, -3.0), (-5.0, -12.0)])
@pytest.mark.parametrize("taken", [[], [(4.0, 3.0, 0.2)], [(-12.0, 5.0, 0.3), (0.0, -1.0, 0.05)]])
def test_corners_of_boxes_symmetric_about_rest(reference, row, taken):
    for box in ((-0.2, 0.2, -0.3, 0.3), (-0.2, 0.2, -0.1, 0.3), (-0.1, 0.2, -0.3, 0.3)):
        check(reference, (0.2, 0.1), box, [taken, [(*row, -9.0)]])
        relax_to_corner(box, [taken, [(*row, -9.0)]], 1)
