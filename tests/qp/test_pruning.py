"""Rows that cannot bind, and programs of hundreds of them: the same answers as without."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp import solve_ladder
from clfcbf.qp.exact import solve_lexicographic
from clfcbf.qp.pruning import MANY, prune, solve_many

BOX = (-0.1, 0.3, -0.2, 0.25)
WEIGHT = (1.0, 0.3, 0.5)


def some_rows(rng, count, near=-0.05, far=0.6):
    """Rows whose lines are ``near`` to ``far`` from the middle of the box, of any length."""
    angle = rng.uniform(-math.pi, math.pi, count)
    a, c = np.cos(angle), np.sin(angle)
    rows = np.stack((a, c, 0.1 * a + 0.025 * c + rng.uniform(near, far, count)), axis=1)
    return rows * 10.0 ** rng.uniform(-3.0, 3.0, (count, 1))


def tuples(rows):
    return [tuple(row) for row in rows.tolist()]


def same(one, other):
    if one is None or other is None:
        assert one is other
        return
    assert (one.v, one.omega) == pytest.approx((other.v, other.omega), rel=0, abs=1e-12)
    assert one.slacks == pytest.approx(other.slacks, rel=1e-12, abs=1e-12)
    assert one.violated == other.violated


@pytest.mark.parametrize("count", [3, MANY, 4 * MANY])
def test_what_is_dropped_holds_in_the_whole_box(count):
    """In exact arithmetic, at every corner; what may be violated at one is kept, in order."""
    rows = tuples(some_rows(np.random.default_rng(count), count))
    corners = [tuple(map(Fraction, u)) for u in itertools.product(BOX[:2], BOX[2:])]
    kept = prune(BOX, rows)
    assert kept == [row for row in rows if row in set(kept)]
    assert prune(BOX, np.array(rows)) == kept
    for row in rows:
        a, c, b = map(Fraction, row)
        worst = max(a * v + c * w - b for v, w in corners)
        if row in kept:
            assert worst >= -Fraction(1, 10**10) * (abs(a) + abs(c))
        else:
            assert worst < 0
    assert 0 < len(kept) < count


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize("place", range(3))
def test_rows_that_are_not_finite_are_kept(value, place):
    odd = [0.6, 0.8, 9.0]
    odd[place] = value
    rows = [tuple(odd), (0.6, 0.8, 9.0)]
    few, many = prune(BOX, rows), prune(BOX, [*rows, *[(0.6, 0.8, 9.0)] * MANY])
    assert repr(few) == repr(many)
    if not math.isfinite(value):
        assert repr(few) == repr(rows[:1])


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0, 5, 80, 400]),
    st.sampled_from([0, 5, 200]),
    st.sampled_from(["far", "cutting", "impossible"]),
)
def test_the_same_answer_as_without(seed, first, second, kind):
    rng = np.random.default_rng(seed)
    near, far = {"far": (0.0, 3.0), "cutting": (0.02, 0.15), "impossible": (-0.3, 0.2)}[kind]
    levels = [some_rows(rng, first, near, far), some_rows(rng, second, near, far)]
    if first and rng.random() < 0.3:
        levels[0][: first // 2, :2] = 0.0  # no command meets them, or all do
    nominal = tuple((rng.normal(size=2) * 10.0 ** rng.uniform(-1, 1)).tolist())
    plain = solve_lexicographic(WEIGHT, nominal, BOX, [tuples(rows) for rows in levels])
    same(solve_many(WEIGHT, nominal, BOX, levels), plain)
    same(solve_many(WEIGHT, nominal, BOX, [tuples(rows) for rows in levels]), plain)
    same(solve_ladder(WEIGHT, nominal, BOX, [tuples(rows) for rows in levels]), plain)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([math.nan, math.inf, -math.inf, 1e200, 1e308]))
def test_broken_data_is_answered_alike(seed, value):
    rng = np.random.default_rng(seed)
    numbers = [*rng.normal(size=2).tolist(), *BOX]
    rows = some_rows(rng, 2 * MANY)
    place = int(rng.integers(0, 12))
    if place < 6:
        numbers[place] = value
    else:
        rows[int(rng.integers(len(rows))), place % 3] = value
    nominal, box = tuple(numbers[:2]), tuple(numbers[2:])
    plain = solve_lexicographic(WEIGHT, nominal, box, [tuples(rows)])
    same(solve_many(WEIGHT, nominal, box, [rows]), plain)


def test_a_thousand_rows_around_the_answer():
    """A polygon of 1000 sides inside the box: its nearest point is the circle's, to its sagitta."""
    angle = np.linspace(-math.pi, math.pi, 1000, endpoint=False)
    rows = np.stack((np.cos(angle), np.sin(angle), np.full(1000, 0.08)), axis=1)
    box, nominal = (-0.1, 0.1, -0.1, 0.1), (0.3, 0.4)
    answer = solve_many((1.0, 0.0, 1.0), nominal, box, [rows])
    assert (answer.v, answer.omega) == pytest.approx((0.048, 0.064), abs=1e-3)
    same(answer, solve_lexicographic((1.0, 0.0, 1.0), nominal, box, [tuples(rows)]))
    assert not answer.relaxed


def test_copies_of_the_deciding_row_do_not_hold_it_up():
    """Rounding tilts copies; each is violated by another's rounding."""
    rng = np.random.default_rng(3)
    row = np.array((0.7, -0.31, 0.02))
    rows = row * 10.0 ** rng.uniform(-6.0, 6.0, (500, 1))
    answer = solve_many(WEIGHT, (0.5, -0.5), BOX, [rows])
    same(answer, solve_lexicographic(WEIGHT, (0.5, -0.5), BOX, [[tuple(row.tolist())]]))


def test_other_backends_get_what_is_left():
    pytest.importorskip("daqp")
    rng = np.random.default_rng(5)
    levels = [tuples(some_rows(rng, 150, -0.02, 3.0)), tuples(some_rows(rng, 3, -0.1, 0.1))]
    sizes = []

    class Counting:
        name = "counting"

        def __init__(self):
            from clfcbf.qp import get_backend

            self.inner = get_backend("daqp")
            self.capability = self.inner.capability

        def solve(self, problem, time_limit=None):
            sizes.append(problem.m)
            return self.inner.solve(problem)

    exact = solve_ladder(WEIGHT, (0.4, -0.3), BOX, levels)
    answer = solve_ladder(WEIGHT, (0.4, -0.3), BOX, levels, Counting())
    assert answer.health.used
    assert (answer.v, answer.omega) == pytest.approx((exact.v, exact.omega), rel=0, abs=1e-6)
    assert answer.slacks == exact.slacks
    assert sizes == [len(prune(BOX, levels[0])) + len(prune(BOX, levels[1]))]
    assert sizes[0] < 75
