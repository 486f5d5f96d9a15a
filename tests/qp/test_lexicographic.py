"""The exact core against rational enumeration, and the invariances that define it."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.qp.exact import check_weight, solve_lexicographic

BOX = (-0.1, 0.3, -0.2, 0.3)
WEIGHT = (1.0, 0.0, 0.3)


def unit(lo, hi, steps=997):
    """Numbers from lo to hi, without the special values that floats() is fond of."""
    return st.integers(0, steps).map(lambda k: lo + (hi - lo) * k / steps)


@st.composite
def boxes(draw):
    v, w = draw(unit(-1, 0.5)), draw(unit(-1, 0.5))
    width = st.sampled_from([0.0, 0.02, 0.5, 1.0])
    return (v, v + draw(width), w, w + draw(width))


@st.composite
def weights(draw, exponent=0):
    q11 = draw(unit(0.2, 2)) * 10.0 ** draw(st.integers(-exponent, exponent))
    q22 = draw(unit(0.2, 2)) * 10.0 ** draw(st.integers(-exponent, exponent))
    return (q11, draw(unit(-0.9, 0.9)) * math.sqrt(q11 * q22), q22)


@st.composite
def rows(draw, box, size, shift=0):
    """A row through or near the box; its length is a whole number times a power of two."""
    p, q = draw(st.integers(-size, size)), draw(st.integers(1, size))
    sign, scale = draw(st.sampled_from([1.0, -1.0])), 2.0 ** draw(st.integers(-shift, shift))
    a, c = sign * float(p * p - q * q), sign * float(2 * p * q)
    v = draw(unit(box[0] - 0.3, box[1] + 0.3))
    w = draw(unit(box[2] - 0.3, box[3] + 0.3))
    return (a * scale, c * scale, (a * v + c * w) * scale)


@st.composite
def twins(draw, box):
    """Two rows at an angle of 2e-2 to 6e-8, in the same or opposite directions."""
    size = 2 ** draw(st.integers(6, 25))
    p, q = draw(st.integers(-size, size)), draw(st.integers(size // 2, size))
    sign = draw(st.sampled_from([1.0, -1.0]))
    first = (float(p * p - q * q), float(2 * p * q))
    second = (sign * float((p + 1) ** 2 - q * q), sign * float(2 * (p + 1) * q))
    made = []
    for a, c in (first, second):
        v, w = draw(unit(box[0], box[1])), draw(unit(box[2], box[3]))
        made.append((a, c, a * v + c * w))
    return made


@st.composite
def programs(draw, kind):
    box = draw(boxes())
    weight = draw(weights(8 if kind == "scaled" else 0))
    far = draw(st.sampled_from([1.0, 1.0, 100.0]))
    nominal = (draw(unit(-1.5, 1.5)) * far, draw(unit(-1.5, 1.5)))
    row = rows(box, 12, 26 if kind == "scaled" else 0)
    levels = draw(st.lists(st.lists(row, max_size=3), min_size=1, max_size=3))
    if kind == "twins":
        pair = draw(twins(box))
        levels[0] = [*levels[0][:1], pair[0]]
        levels[-1] = [*levels[-1][:2], pair[1]]
    if draw(st.booleans()) and levels[0]:
        levels[-1] = [*levels[-1], tuple(3.0 * entry for entry in levels[0][0])]
    return weight, nominal, box, levels


def check_against(reference, program):
    answer = solve_lexicographic(*program)
    point, slacks = reference.lexicographic(*program)
    assert answer is not None
    assert abs(Fraction(answer.v) - point[0]) <= 1e-12
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-12
    for ours, exact in zip(answer.slacks, slacks, strict=True):
        assert abs(Fraction(ours) - exact) <= Fraction(1, 10**12) * (1 + exact)
        # Verdicts agree but where a row misses the box by less than its residual's rounding.
        assert (ours > 0.0) == (exact > 0) or max(ours, exact) < 1e-15
    v_lo, v_hi, w_lo, w_hi = program[2]
    assert v_lo <= answer.v <= v_hi
    assert w_lo <= answer.omega <= w_hi
    for level, slack in zip(program[3], answer.slacks, strict=True):
        for a, c, b in level:
            room = b + slack * math.hypot(a, c)
            size = abs(a * answer.v) + abs(c * answer.omega) + abs(b) + math.hypot(a, c)
            assert a * answer.v + c * answer.omega - room <= 4e-15 * size


@settings(max_examples=90, deadline=None)
@given(programs("plain"))
def test_exact_against_enumeration(reference, program):
    check_against(reference, program)


@settings(max_examples=90, deadline=None)
@given(programs("scaled"))
def test_exact_when_badly_scaled(reference, program):
    check_against(reference, program)


@settings(max_examples=90, deadline=None)
@given(programs("twins"))
def test_exact_when_nearly_parallel(reference, program):
    check_against(reference, program)


@settings(max_examples=60, deadline=None)
@given(st.integers(24, 48), unit(0.5, 2), unit(0.5, 2), unit(0, 0.2), st.booleans(), st.data())
def test_exact_when_the_weight_is_nearly_singular(reference, digits, p, q, v, relaxed, data):
    """A row along the weight's flat direction, where its curvature is all cancellation."""
    weight = (p, (1.0 - 2.0**-digits) * math.sqrt(p * q), q)
    nominal = (v, data.draw(unit(-0.1, 0.2)))
    size, row = 2**20, (math.sqrt(p), math.sqrt(q))
    a, c = round(size * row[0]) / size, round(size * row[1]) / size
    # Next to the line; from further away the minimum lies at the line's end.
    b = a * nominal[0] + c * nominal[1] - 10.0 ** data.draw(st.integers(-8, -4))
    levels = [[(a, c, b)], [(-a, -c, -b - 1.0)] if relaxed else []]
    answer = solve_lexicographic(weight, nominal, BOX, levels)
    point, _ = reference.lexicographic(weight, nominal, BOX, levels)
    assert abs(Fraction(answer.v) - point[0]) <= 1e-12
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


@settings(max_examples=60, deadline=None)
@given(unit(-0.1, 0.3), unit(-0.2, 0.3), st.integers(-52, -10), st.booleans(), st.integers(0, 5))
def test_verdict_on_nearly_empty_sets(reference, v, w, exponent, empty, kind):
    """Two opposite rows with a gap from 2**-10 down to one rounding unit."""
    a, c = [(1.0, 0.0), (3.0, 4.0), (0.0, -1.0), (-5.0, 12.0), (8.0, 15.0), (1.0, 1.0)][kind]
    b = a * v + c * w
    gap = 2.0**exponent * (abs(b) + 1.0)
    levels = [[(a, c, b), (-a, -c, -b - gap if empty else -b + gap)]]
    answer = solve_lexicographic(WEIGHT, (0.9, -0.8), BOX, levels)
    point, slacks = reference.lexicographic(WEIGHT, (0.9, -0.8), BOX, levels)
    assert (answer.slacks[0] > 0.0) == (slacks[0] > 0)
    if kind < 5:  # rational length: the reference's point is exact
        assert abs(Fraction(answer.v) - point[0]) <= 1e-12
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


@st.composite
def generic_levels(draw):
    """Directions far from parallel, or exactly parallel or opposite up to rounding."""
    angles = [0.0, 0.3, 0.7, 1.1, 1.9, 2.6]
    levels, seen = [], []
    for _ in range(draw(st.integers(1, 3))):
        level = []
        for _ in range(draw(st.integers(1, 3))):
            if seen and draw(st.booleans()):
                a, c, b = draw(st.sampled_from(seen))
                factor = draw(st.sampled_from([1.0, -1.0])) * draw(unit(0.1, 3.0))
                shift = draw(st.sampled_from([0.0, 0.0, -0.05, 0.05, -0.3]))
                row = (a * factor, c * factor, b * factor + shift)
            else:
                angle = draw(st.sampled_from(angles)) + draw(st.sampled_from([0.0, math.pi]))
                a, c = math.cos(angle), math.sin(angle)
                row = (a, c, a * draw(unit(-0.2, 0.4)) + c * draw(unit(-0.3, 0.4)))
            level.append(row)
            seen.append(row)
        levels.append(level)
    return levels


@settings(max_examples=200, deadline=None)
@given(generic_levels(), unit(-0.5, 0.5), unit(-0.5, 0.5), st.sampled_from([0.0, 0.2]), st.data())
def test_rows_are_half_planes(levels, v, w, dense, data):
    """Scaling, reordering, repeating rows and adding inactive ones moves nothing."""
    factors = unit(-8, 8).map(lambda e: 10.0**e)
    changed = []
    for level in levels:
        twins = [
            tuple(entry * factor for entry in row)
            for row in level
            for factor in data.draw(st.lists(factors, min_size=1, max_size=2))
        ]
        twins += data.draw(st.lists(st.sampled_from([(0.0, 0.0, 1.0), (1.0, 2.0, 5.0)])))
        changed.append(data.draw(st.permutations(twins)))
    weight = (1.0, dense, 0.5)
    one = solve_lexicographic(weight, (v, w), BOX, levels)
    other = solve_lexicographic(weight, (v, w), BOX, changed)
    assert other.v == pytest.approx(one.v, abs=1e-12)
    assert other.omega == pytest.approx(one.omega, abs=1e-12)
    assert other.slacks == pytest.approx(one.slacks, abs=1e-12)


@settings(max_examples=100, deadline=None)
@given(generic_levels(), unit(-0.5, 0.5), unit(-0.5, 0.5))
def test_no_sampled_command_does_better(levels, v, w):
    """Lexicographic comparison with a dense grid: no command gives up less, or comes closer."""
    answer = solve_lexicographic(WEIGHT, (v, w), BOX, levels)
    grid_v, grid_w = np.meshgrid(np.linspace(*BOX[:2], 81), np.linspace(*BOX[2:], 81))
    allowed = np.ones_like(grid_v, dtype=bool)
    for level, slack in zip(levels, answer.slacks, strict=True):
        excess = np.max(
            [(a * grid_v + c * grid_w - b) / math.hypot(a, c) for a, c, b in level], axis=0
        )
        assert excess[allowed].min(initial=np.inf) >= slack - 1e-12 or slack == 0.0
        allowed &= excess <= slack
    cost = (grid_v - v) ** 2 + 0.3 * (grid_w - w) ** 2
    ours = (answer.v - v) ** 2 + 0.3 * (answer.omega - w) ** 2
    assert cost[allowed].min(initial=np.inf) >= ours - 1e-12


@given(generic_levels(), unit(-0.5, 0.5), unit(-0.5, 0.5))
def test_answer_is_a_fixed_point(levels, v, w):
    """Asked for its own answer, the program returns it; a nominal inside is returned as it is."""
    answer = solve_lexicographic(WEIGHT, (v, w), BOX, levels)
    again = solve_lexicographic(WEIGHT, (answer.v, answer.omega), BOX, levels)
    assert (again.v, again.omega) == pytest.approx((answer.v, answer.omega), abs=1e-12)
    holds = all(a * v + c * w <= b for level in levels for a, c, b in level)
    if holds and BOX[0] <= v <= BOX[1] and BOX[2] <= w <= BOX[3]:
        assert (answer.v, answer.omega) == (v, w)


@given(generic_levels(), unit(-0.5, 0.5), unit(-0.5, 0.5), unit(-0.5, 0.5), unit(-0.5, 0.5))
def test_projection_does_not_expand(levels, v, w, x, y):
    """In the weight's norm two answers are no further apart than their nominal commands."""
    one = solve_lexicographic(WEIGHT, (v, w), BOX, levels)
    two = solve_lexicographic(WEIGHT, (x, y), BOX, levels)
    apart = math.hypot(one.v - two.v, math.sqrt(0.3) * (one.omega - two.omega))
    assert apart <= math.hypot(v - x, math.sqrt(0.3) * (w - y)) + 1e-12
    assert one.slacks == pytest.approx(two.slacks, abs=1e-12)


def test_many_rows(reference):
    """Thirty rows round a circle: the polygon's nearest point, by enumeration."""
    level = []
    for p in range(-7, 8):
        for sign in (1.0, -1.0):
            a, c, n = sign * (p * p - 49), sign * 14 * p, p * p + 49
            level.append((a, c, 0.1 * n + 0.05 * a))
    for nominal in ((0.3, 0.3), (-0.1, -0.2), (0.05, 0.29)):
        answer = solve_lexicographic(WEIGHT, nominal, BOX, [level])
        taken = reference.sides(BOX) + [tuple(map(Fraction, row)) for row in level]
        point = reference.project(WEIGHT, nominal, taken)
        assert abs(Fraction(answer.v) - point[0]) <= 1e-13
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-13
        assert answer.slacks == (0.0,)


def test_most_important_level_first():
    first, second = [(1.0, 0.0, 0.0)], [(-1.0, 0.0, -0.2)]
    answer = solve_lexicographic(WEIGHT, (0.1, 0.1), BOX, [first, second])
    assert (answer.v, answer.omega) == pytest.approx((0.0, 0.1), abs=1e-15)
    assert answer.slacks == pytest.approx((0.0, 0.2), abs=1e-15)
    swapped = solve_lexicographic(WEIGHT, (0.1, 0.1), BOX, [second, first])
    assert (swapped.v, swapped.omega) == pytest.approx((0.2, 0.1), abs=1e-15)
    together = solve_lexicographic(WEIGHT, (0.3, 0.1), BOX, [first + second])
    assert (together.v, together.omega) == pytest.approx((0.1, 0.1), abs=1e-15)
    assert together.slacks == pytest.approx((0.1,), abs=1e-15)
    assert together.relaxed


def test_huge_right_hand_side():
    """A row that asks for the impossible by 1e20 still gets the best there is."""
    answer = solve_lexicographic(WEIGHT, (0.1, 0.1), BOX, [[(-1.0, -0.5, -1e20)]])
    assert (answer.v, answer.omega) == (0.3, 0.3)
    assert answer.slacks[0] == pytest.approx(1e20 / math.hypot(1.0, 0.5), rel=1e-15)


@pytest.mark.parametrize("tiny", [1e-300, 1e-200, 1e200])
def test_extreme_row_lengths(tiny):
    answer = solve_lexicographic(WEIGHT, (0.2, 0.1), BOX, [[(tiny, 0.0, 0.0)]])
    assert (answer.v, answer.omega, answer.slacks) == (0.0, 0.1, (0.0,))


def test_zero_rows_say_nothing_and_are_reported():
    good, bad = (0.0, 0.0, 0.5), (0.0, 0.0, -0.5)
    cut = (1.0, 0.0, 0.1)
    plain = solve_lexicographic(WEIGHT, (0.2, 0.1), BOX, [[cut]])
    answer = solve_lexicographic(WEIGHT, (0.2, 0.1), BOX, [[good, cut], [bad]])
    assert (answer.v, answer.omega) == (plain.v, plain.omega)
    assert answer.violated == (2,)
    assert answer.relaxed
    inside = solve_lexicographic(WEIGHT, (0.0, 0.1), BOX, [[bad, good], [cut]])
    assert (inside.v, inside.omega, inside.violated) == (0.0, 0.1, (0,))


def test_degenerate_box_is_a_point():
    answer = solve_lexicographic(WEIGHT, (1.0, 1.0), (0.1, 0.1, -0.2, -0.2), [[(1.0, 1.0, -0.5)]])
    assert (answer.v, answer.omega) == (0.1, -0.2)
    assert answer.slacks == pytest.approx((0.4 / math.sqrt(2.0),), rel=1e-14)


@pytest.mark.parametrize(
    "box",
    [(0.1, 0.3, 0.15, 0.4), (-0.3, -0.1, -0.4, -0.15), (-0.2, 0.2, -0.3, 0.3),
     (-0.1, 0.3, -0.3, 0.3), (-0.2, 0.2, 0.1, 0.4), (-0.4, 0.1, -0.1, 0.5)],
)  # fmt: skip
def test_boxes_on_either_side_of_rest(reference, box):
    """Without zero in them, or symmetric about it: clipped, and cut by a row, as by enumeration."""
    places = [-0.5, -0.35, -0.25, -0.12, -0.05, 0.0, 0.05, 0.12, 0.25, 0.35, 0.5]
    for v in places:
        for w in places:
            answer = solve_lexicographic(WEIGHT, (v, w), box, [])
            clipped = (min(max(v, box[0]), box[1]), min(max(w, box[2]), box[3]))
            assert (answer.v, answer.omega) == clipped
    middle = (0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]))
    row = (3.0, -4.0, 3.0 * middle[0] - 4.0 * middle[1])
    for nominal in ((0.5, -0.5), (0.1, -0.2), (0.0, -0.6), (0.6, 0.0)):
        answer = solve_lexicographic(WEIGHT, nominal, box, [[row]])
        point, slacks = reference.lexicographic(WEIGHT, nominal, box, [[row]])
        assert abs(Fraction(answer.v) - point[0]) <= 1e-13
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-13
        assert not any(answer.slacks)
        assert not any(slacks)


def test_a_zero_row_with_nothing_to_spare_holds():
    for nominal in ((0.1, 0.1), (0.9, 0.9)):
        answer = solve_lexicographic(WEIGHT, nominal, BOX, [[(0.0, 0.0, 0.0)]])
        assert answer.violated == ()
        assert not answer.relaxed


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(9))
def test_non_finite_data_gives_no_answer(value, place):
    numbers = [0.1, 0.1, *BOX, 1.0, 0.5, 0.0]
    numbers[place] = value
    nominal, box, row = tuple(numbers[:2]), tuple(numbers[2:6]), tuple(numbers[6:])
    assert solve_lexicographic(WEIGHT, nominal, box, [[(1.0, 0.0, 1.0)], [row]]) is None


def test_reversed_box_gives_no_answer():
    assert solve_lexicographic(WEIGHT, (0.0, 0.0), (0.1, -0.1, -0.2, 0.3), []) is None
    assert solve_lexicographic(WEIGHT, (0.0, 0.9), (-0.1, 0.1, 0.3, -0.2), []) is None


@pytest.mark.parametrize(
    "weight",
    [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, -1.0), (1.0, 0.0), (math.nan, 0.0, 1.0),
     (1.0, 2.0, 1.0), (1.0, -2.0, 1.0), (math.inf, 0.0, 1.0)],
)  # fmt: skip
def test_weight_must_be_positive_definite(weight):
    with pytest.raises(ConfigurationError, match="weight must be"):
        check_weight(weight)


def test_good_weight_is_returned():
    assert check_weight([2, 1, 3]) == (2.0, 1.0, 3.0)


def test_opposite_rows_and_their_copies_leave_a_whole_segment():
    """Rounding tilts copies of a row by 1e-16; the midline between opposite rows must survive."""
    first = (-0.7648421872844884, -0.6442176872376911, -0.0403790957160679)
    second = (1.660101861170476, 1.3982845080490245, -0.2123565448336186)
    nominal = (-0.40923334257712907, -0.02940868123814866)
    copies = [
        tuple(factor * entry for entry in row)
        for row, factors in ((second, (7.09, 1.74e-5)), (first, (1.43e-4, 7.36e-5)))
        for factor in factors
    ]
    weight, box = (1.0, 0.3, 0.5), (-0.1, 0.3, -0.2, 0.3)
    one = solve_lexicographic(weight, nominal, box, [[first, second]])
    other = solve_lexicographic(weight, nominal, box, [copies])
    assert (other.v, other.omega) == pytest.approx((one.v, one.omega), abs=1e-12)


@pytest.mark.parametrize("ends", [(0.0, 1.0), (-1.0, 0.0), (-1.0, 1.0), (0.125, 1.0)])
@pytest.mark.parametrize("nominal", [(0.9, 0.9), (0.9, -0.9), (0.0, 0.4)])
def test_copies_of_a_row_are_that_row_also_where_they_meet_it_on_a_side_of_the_box(ends, nominal):
    """At zero nothing is rounded, so a copy that is tilted by rounding turns about that corner."""
    row = (1.0, 0.1, 0.5)
    assert 3.0 * 0.1 != 0.3

    def copy(factor, lower=0.0):
        return (factor * row[0], factor * row[1], factor * (row[2] - lower))

    box = (-1.0, 1.0, *ends)
    level = [copy(1.0), copy(-1.0)]
    for below in ([], [copy(1.0, 5.0)], [copy(-1.0, -5.0)]):
        expected = solve_lexicographic(WEIGHT, nominal, box, [level, below])
        for factors in ((1.0, -3.0), (3.0, -1.0), (3.0, 1.0, -1.0), (-3.0, -1.0, 1.0)):
            for scale in (1.0, 7.0):
                scaled = [tuple(scale * entry for entry in entries) for entries in below]
                copies = [[copy(factor) for factor in factors], scaled]
                answer = solve_lexicographic(WEIGHT, nominal, box, copies)
                assert answer[:2] == pytest.approx(expected[:2], abs=1e-12)
                assert answer.slacks == pytest.approx(expected.slacks, abs=1e-12)
                assert answer.v + 0.1 * answer.omega == pytest.approx(0.5, abs=1e-12)


def test_thin_wedge_next_to_a_corner(reference):
    """Two opposite rows 2e-6 apart in angle that meet within rounding of a corner of the box."""
    weight, nominal = (1.6299098513417103, 0.0, 0.23674417466611122), (0.33645, 0.53333)
    box = (-0.6060514585360274, -0.10605145853602738, -0.6836358926352384, 0.3163641073647616)
    level = [
        (-5.930535617870954e18, 1.721214048445399e19, 6.074245412376237e18),
        (10534.783556461334, -30574.852918624878, -10790.015212933718),
    ]
    answer = solve_lexicographic(weight, nominal, box, [level])
    point, _ = reference.lexicographic(weight, nominal, box, [level])
    assert abs(Fraction(answer.v) - point[0]) <= 1e-15
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-15
