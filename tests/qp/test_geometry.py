"""The parts of the exact core, each equation against arithmetic that does not share it."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp.objective import cost, ill_conditioned, line_minimum, minimiser, nearest_on_edge
from clfcbf.qp.polygon import Delicate, box_polygon, clip
from clfcbf.qp.projection import project
from clfcbf.qp.rational import solve_rational
from clfcbf.qp.relaxation import relax

small = st.integers(-400, 400).map(lambda k: k / 256)
positive = st.integers(1, 400).map(lambda k: k / 256)


@st.composite
def objectives(draw):
    q11, q22, ratio = draw(positive), draw(positive), draw(st.integers(-9, 9)) / 10
    soft = (draw(positive), draw(small), draw(small), draw(small))
    return (q11, ratio * math.sqrt(q11 * q22), q22, draw(small), draw(small), *soft)


def exact(objective):
    return tuple(Fraction(number) for number in objective)


def quadratic(objective):
    """Hessian / 2, linear term and constant of the cost, from numpy."""
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    Q, n, a = np.array([[q11, q12], [q12, q22]]), np.array([n_v, n_w]), np.array([s_v, s_w])
    return Q + c * np.outer(a, a), -2 * (Q @ n + c * s_b * a), n @ Q @ n + c * s_b**2


@given(objectives(), small, small)
def test_cost_is_the_quadratic(objective, v, w):
    H, g, k = quadratic(objective)
    u = np.array([v, w])
    assert cost(objective, v, w) == pytest.approx(u @ H @ u + g @ u + k, abs=1e-9)


@given(objectives())
def test_minimiser_solves_the_normal_equations(objective):
    H, g, _ = quadratic(objective)
    assert minimiser(objective) == pytest.approx(np.linalg.solve(2 * H, -g), abs=1e-8, rel=1e-8)
    # Exactly, on fractions: the gradient of the definition vanishes.
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = exact(objective)
    v, w = minimiser(exact(objective))
    soft = c * (s_v * v + s_w * w - s_b)
    assert q11 * (v - n_v) + q12 * (w - n_w) + soft * s_v == 0
    assert q12 * (v - n_v) + q22 * (w - n_w) + soft * s_w == 0


@given(objectives(), small, small, small, positive)
def test_line_minimum_has_no_slope(objective, x, y, d_v, d_w):
    """On fractions the cost is symmetric about the minimum, exactly."""
    objective = exact(objective)
    x, y, d_v, d_w = map(Fraction, (x, y, d_v, d_w))
    t = line_minimum(objective, x, y, d_v, d_w)
    left = cost(objective, x + (t - 1) * d_v, y + (t - 1) * d_w)
    right = cost(objective, x + (t + 1) * d_v, y + (t + 1) * d_w)
    assert left == right
    assert left > cost(objective, x + t * d_v, y + t * d_w)
    plain = (*objective[:5], Fraction(0), *objective[6:])
    t = line_minimum(plain, x, y, d_v, d_w)
    assert cost(plain, x + (t - 1) * d_v, y + (t - 1) * d_w) == cost(
        plain, x + (t + 1) * d_v, y + (t + 1) * d_w
    )


@given(objectives(), small, small, small, small)
def test_nearest_on_edge_is_cheapest(objective, x, y, p, q):
    best = cost(objective, *nearest_on_edge(objective, (x, y), (p, q)))
    for t in np.linspace(0.0, 1.0, 101).tolist():
        assert cost(objective, x + t * (p - x), y + t * (q - y)) >= best - 1e-12 * (1 + best)


@given(positive, positive, st.integers(-999_999, 999_999))
def test_conditioning_bounds_the_eigenvalue_ratio(q11, q22, ratio):
    q12 = ratio / 1_000_000 * math.sqrt(q11 * q22)
    condition = np.linalg.cond(np.array([[q11, q12], [q12, q22]]))
    if condition > 2**20:
        assert ill_conditioned((q11, q12, q22))
    if condition < 2**18 - 8:  # (1 + k)^2 / k of the bound is at most 4 k
        assert not ill_conditioned((q11, q12, q22))


@st.composite
def cuts(draw):
    a, c = draw(small), draw(small)
    if a == 0 and c == 0:
        a = 1.0
    return (a, c, draw(small))


@settings(max_examples=60, deadline=None)
@given(st.lists(cuts(), min_size=1, max_size=5))
def test_clipping_keeps_the_points_that_hold(rows):
    """Membership of a grid in the clipped polygon, by its corners' orientation, and by the rows."""
    zero = Fraction(0)
    exact_rows = [tuple(map(Fraction, row)) for row in rows]
    polygon = box_polygon(Fraction(-1), Fraction(1), Fraction(-1), Fraction(1))
    for row in exact_rows:
        polygon = clip(polygon, row, zero) if polygon else []
    for a, c, b in exact_rows:
        assert all(a * x + c * y <= b for x, y in polygon)
    assert len(set(polygon)) == len(polygon)
    for i in range(-3, 4):
        for j in range(-3, 4):
            x, y = Fraction(i, 3), Fraction(j, 3)
            holds = all(a * x + c * y <= b for a, c, b in exact_rows)
            if holds:
                assert polygon
                edges = zip(polygon, polygon[1:] + polygon[:1], strict=True)
                assert all(
                    (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) >= 0 for p, q in edges
                )


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(small, small), min_size=1, max_size=3))
def test_relaxed_sets_are_thin(offsets):
    """What a relaxed level leaves is a segment or a point, at the slack found."""
    unit_rows = [(Fraction(3, 5), Fraction(4, 5)), (Fraction(-5, 13), Fraction(12, 13))]
    unit_rows.append((Fraction(-1), Fraction(0)))
    level = [(a, c, Fraction(b) - 3) for (a, c), (b, _) in zip(unit_rows, offsets, strict=False)]
    corners = box_polygon(Fraction(-1), Fraction(1), Fraction(-1), Fraction(1))
    polygon, (slack,) = relax(corners, [level], lambda row: row, Fraction(0))
    violations = [max(a * x + c * y - b for a, c, b in level) for x, y in polygon]
    if slack:
        assert len(polygon) <= 2
        assert violations == [slack] * len(polygon)
    else:
        assert max(violations) <= 0


def test_floats_ask_for_fractions_when_rounding_decides():
    square = box_polygon(0.0, 1.0, 0.0, 1.0)
    noise = 2.0**-40
    with pytest.raises(Delicate):
        clip(square, (1.0, 1.0, 0.0), noise)  # touches a corner
    with pytest.raises(Delicate):
        clip(square, (1.0, 1e-5, 1e-6), noise)  # cuts at a small angle
    assert clip(square, (1.0, 1.0, -1.0), noise) == []
    assert clip(square, (1.0, 1.0, 3.0), noise) == square
    objective = (1.0, 0.0, 1.0, 5.0, 5.0, 0.0, 0.0, 0.0, 0.0)
    gap = 2.0**-52
    opposite = [(1.0, 1.0, 1.0), (-1.0, -1.0, -1.0 - gap)]
    with pytest.raises(Delicate):
        project(objective, (0.0, 1.0, 0.0, 1.0), [opposite])
    v, w, slacks = solve_rational(objective, (0.0, 1.0, 0.0, 1.0), [opposite])
    assert (v, w) == pytest.approx((0.5, 0.5), abs=1e-15)
    assert slacks == pytest.approx((gap / 2.0**1.5,), rel=1e-15)


@settings(deadline=None)
@given(st.lists(cuts(), max_size=4), objectives())
def test_floats_and_fractions_agree(rows, objective):
    """Where floats answer at all, they answer what fractions do."""
    box = (-1.0, 1.0, -0.5, 1.5)
    try:
        point = project(objective, box, [rows])
    except Delicate:
        return
    v, w, slacks = solve_rational(objective, box, [rows])
    assert isinstance(point, int) == (slacks[0] > 0.0)
    if not isinstance(point, int):
        assert point == pytest.approx((v, w), abs=1e-12)


def test_degenerate_boxes():
    assert box_polygon(1.0, 1.0, 2.0, 2.0) == [(1.0, 2.0)]
    assert sorted(box_polygon(1.0, 1.0, 2.0, 3.0)) == [(1.0, 2.0), (1.0, 3.0)]
    assert sorted(box_polygon(0.0, 1.0, 2.0, 2.0)) == [(0.0, 2.0), (1.0, 2.0)]
