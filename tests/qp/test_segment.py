"""Boxes without width, as a hand-over from faster limits leaves them: floats answer, and right."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp.exact import paper_program, solve_lexicographic
from clfcbf.qp.polygon import Delicate
from clfcbf.qp.segment import project_on_segment

WEIGHT = (1.0, 0.2, 0.3)
TRIPLES = ((3, 4), (5, 12), (8, 15), (20, 21), (0, 1), (1, 0), (4, 3), (15, 8))


def unit(lo, hi, steps=997):
    return st.integers(0, steps).map(lambda k: lo + (hi - lo) * k / steps)


@st.composite
def flat_boxes(draw):
    v, w = draw(unit(-0.5, 0.5)), draw(unit(-0.5, 0.5))
    wide = draw(st.sampled_from([0.02, 0.1, 0.5]))
    kind = draw(st.sampled_from(["v", "w", "both"]))
    return (v, v if kind != "w" else v + wide, w, w + wide if kind == "v" else w)


@st.composite
def rows_near(draw, box):
    """A row of rational length whose line passes the box at up to 0.3."""
    p, q = draw(st.sampled_from(TRIPLES))
    a, c = p * draw(st.sampled_from([1.0, -1.0])), q * draw(st.sampled_from([1.0, -1.0]))
    v, w = draw(unit(box[0] - 0.3, box[1] + 0.3)), draw(unit(box[2] - 0.3, box[3] + 0.3))
    return (a, c, a * v + c * w)


@st.composite
def programs(draw):
    box = draw(flat_boxes())
    nominal = (draw(unit(-1.5, 1.5)), draw(unit(-1.5, 1.5)))
    levels = draw(st.lists(st.lists(rows_near(box), max_size=3), min_size=1, max_size=3))
    return WEIGHT, nominal, box, levels


@settings(max_examples=150, deadline=None)
@given(programs())
def test_against_enumeration(reference, program):
    answer = solve_lexicographic(*program)
    point, slacks = reference.lexicographic(*program)
    assert abs(Fraction(answer.v) - point[0]) <= 1e-12
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-12
    for ours, exact in zip(answer.slacks, slacks, strict=True):
        assert abs(Fraction(ours) - exact) <= Fraction(1, 10**12)
        assert (ours > 0.0) == (exact > 0) or max(ours, exact) < 1e-15


@settings(max_examples=100, deadline=None)
@given(flat_boxes(), unit(-1, 1), unit(-1, 1), st.integers(0, 6), st.data())
def test_one_shot_against_enumeration(reference, box, v, w, exponent, data):
    hard, soft = [data.draw(rows_near(box))], data.draw(rows_near(box))
    penalty = 10.0**exponent
    answer = paper_program(WEIGHT, (v, w), box, hard, soft, penalty)
    point = reference.paper(WEIGHT, (v, w), box, hard, soft, penalty)
    assert answer.feasible == (point is not None)
    if point is not None:
        assert abs(Fraction(answer.v) - point[0]) <= 1e-12
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


def test_a_hand_over_needs_no_fractions():
    """The two barrier rows of a view and a Lyapunov row, the speed coming down from 0.55."""
    rng = np.random.default_rng(0)
    rational = active = 0
    for _ in range(400):
        v = float(rng.uniform(0.25, 0.54))
        w = float(rng.uniform(-0.3, 0.3))
        box = (v, v, w - 0.033, w + 0.033)
        y, x = rng.uniform(-0.6, 0.6), rng.uniform(0.6, 2.5)
        nx, ny = math.sin(0.61), math.cos(0.61)
        hard = [(nx, side * (ny * x) - nx * y, nx * x + side * ny * y) for side in (-1.0, 1.0)]
        a, c = rng.normal(size=2).tolist()
        soft = [(a, c, a * v + c * float(rng.uniform(*box[2:])))]
        answer = solve_lexicographic(WEIGHT, (0.2, float(rng.normal())), box, [hard, soft])
        rational += answer.rational
        active += w - 0.033 < answer.omega < w + 0.033
    assert active > 40
    assert rational == 0


@pytest.mark.parametrize(
    ("row", "box"),
    [
        ((1.0, 1e-9, 0.1 - 1e-14), (0.1, 0.1, -0.2, 0.2)),  # holds or fails along all of it
        ((3.0, 4.0, 0.3 - 0.8), (0.1, 0.1, -0.2, 0.2)),  # touches at one end
    ],
)
def test_what_rounding_could_turn_is_left_to_fractions(row, box, reference):
    objective = (1.0, 0.0, 0.3, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(Delicate):
        project_on_segment(objective, box, [[row]])
    answer = solve_lexicographic((1.0, 0.0, 0.3), (0.5, 0.5), box, [[row]])
    point, _ = reference.lexicographic((1.0, 0.0, 0.3), (0.5, 0.5), box, [[row]])
    assert answer.rational
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


def test_the_level_that_leaves_nothing_is_named():
    objective = (1.0, 0.0, 0.3, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)
    box = (0.1, 0.1, -0.2, 0.2)
    up, down, slow = (0.0, -1.0, -0.1), (0.0, 1.0, 0.0), (1.0, 0.0, 0.05)
    assert project_on_segment(objective, box, [[up], [down]]) == 1
    assert project_on_segment(objective, box, [[slow], [up]]) == 0
    assert project_on_segment(objective, box, [[up], [(0.0, 0.0, 1.0)]]) == (0.1, 0.2)


def free(upright, held, other):
    """Command, coefficients or such, where the first input (or the second) has one value."""
    return (held, other) if upright else (other, held)


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("across", [1.0, -1.0, 0.125])
@pytest.mark.parametrize("along", [0.002, -0.002, 1.0, -1.0, 1e-9, -1e-9])
@pytest.mark.parametrize("past", [-0.7, 0.0, 0.3, 0.7])
def test_a_row_that_cuts_an_end_off_by_next_to_nothing(reference, upright, across, along, past):
    """By less than its residual is rounded; at a small angle that is a piece worth 1e-12."""
    box = (0.1, 0.1, -0.2, 0.2) if upright else (-0.2, 0.2, 0.1, 0.1)
    end = math.copysign(0.2, along)
    b = across * 0.1 + along * end - past * 0.6 * 2.0**-40 * (abs(across) + abs(along))
    row, nominal = (*free(upright, across, along), b), free(upright, 0.1, 3.0 * end)
    answer = solve_lexicographic(WEIGHT, nominal, box, [[row]])
    point, _ = reference.lexicographic(WEIGHT, nominal, box, [[row]])
    assert abs(Fraction(answer.v) - point[0]) <= 1e-12
    assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("across", [3.0, -3.0])
@pytest.mark.parametrize("along", [3e-7, -3e-7])
def test_a_soft_row_that_hardly_depends_on_the_free_input(reference, upright, across, along):
    """Under a large penalty the digits it has lost would move the command."""
    box = (0.1, 0.1, -0.2, 0.2) if upright else (-0.2, 0.2, 0.1, 0.1)
    for shift in (1e-8, -2e-8, 5e-8):
        soft = (*free(upright, across, along), across * 0.1 + shift)
        nominal = free(upright, 0.1, 0.07)
        answer = paper_program(WEIGHT, nominal, box, [], soft, 1e13)
        point = reference.paper(WEIGHT, nominal, box, [], soft, 1e13)
        assert abs(Fraction(answer.v) - point[0]) <= 1e-12
        assert abs(Fraction(answer.omega) - point[1]) <= 1e-12


def test_of_a_box_that_is_one_point_no_minimum_is_asked():
    for nominal in ((0.5, 0.5), (1e9, -1e9)):
        objective = (1.0, 1.0 - 1e-15, 1.0, *nominal, 0.0, 0.0, 0.0, 0.0)
        box = (0.1, 0.1, -0.2, -0.2)
        assert project_on_segment(objective, box, [[(1.0, 1.0, 5.0)]]) == (0.1, -0.2)
