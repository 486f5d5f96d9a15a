"""The parts of the exact core, each equation against arithmetic that does not share it."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.qp.chord import box_scale, chord
from clfcbf.qp.lexicographic import minimise
from clfcbf.qp.objective import cost, ill_conditioned, line_minimum, minimiser, nearest_on_edge
from clfcbf.qp.polygon import Delicate, box_polygon, clip
from clfcbf.qp.projection import _aslant, _in_a_wedge, check_trusted, project
from clfcbf.qp.rational import _unit, solve_rational
from clfcbf.qp.relaxation import relax, tightest

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


@pytest.mark.parametrize(("gap", "ill"), [(2.0**-30, True), (2.0**-12, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_equal_inputs_that_are_nearly_one_are_ill_conditioned(gap, ill, sign):
    assert ill_conditioned((1.0, sign * (1.0 - gap), 1.0)) is ill
    assert ill_conditioned((1.0, 0.0, 1.0)) is False
    assert ill_conditioned((1.0, 0.0, 2.0**-30)) is True


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
    exact_rows = [tuple(map(Fraction, row)) for row in rows]
    polygon = box_polygon(Fraction(-1), Fraction(1), Fraction(-1), Fraction(1))
    for row in exact_rows:
        polygon = clip(polygon, row) if polygon else []
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


directions = pytest.mark.parametrize("along", [(1, 0), (0, -1), (1, 1), (1, -1), (3, 4), (-4, 3)])
places = pytest.mark.parametrize(
    "centre", [(0, 0), (1000, 0), (0, 1000), (1000, -1000), (-1000, 1000), (-1000, -1000)]
)


def crossed(along, centre, tilt, number):
    """A segment, and a row whose line crosses it in the middle at a small angle."""
    dx, dy = number(along[0]), number(along[1])
    x, y = number(centre[0]), number(centre[1])
    a, c = number(tilt) * dx - dy, number(tilt) * dy + dx
    return [(x - dx, y - dy), (x + dx, y + dy)], (a, c, a * x + c * y), (x, y)


@directions
@places
def test_an_edge_along_a_row_is_kept_or_dropped_as_a_whole(along, centre):
    """At angles that rounding hides; others are cut, wherever the edge lies and however it runs."""
    for sign in (1, -1):
        segment, row, _ = crossed(along, centre, Fraction(sign, 2**60), Fraction)
        assert clip(segment, row) == segment
        segment, row, middle = crossed(along, centre, Fraction(sign, 2**44), Fraction)
        kept = clip(segment, row)
        assert set(kept) == {middle, segment[0] if sign > 0 else segment[1]}


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("top", [[(1, 2), (-1, 2)], [(0, 2)], [(2, 1), (1, 2), (-1, 2)]])
@pytest.mark.parametrize("tilt", [Fraction(1, 2**60), Fraction(-1, 2**60)])
def test_an_edge_along_a_row_is_found_wherever_it_is_listed(first, top, tilt):
    bottom = [(-1, -1), (1, -1)]
    corners = [(Fraction(x), Fraction(y)) for x, y in bottom + top]
    first %= len(corners)
    polygon = corners[first:] + corners[:first]
    one = Fraction(1)
    assert clip(polygon, (tilt, -one, one)) == polygon
    assert set(clip(polygon, (tilt, one, -one))) == set(corners[:2])


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("on", [0, 1])
@pytest.mark.parametrize("tilt", [Fraction(1, 2**60), Fraction(-1, 2**60)])
def test_an_edge_along_a_row_is_whole_also_where_one_end_is_on_it(side, inward, on, tilt):
    """Exactly on the row with one end, and off it with the other by what rounding makes of it."""
    square = [(Fraction(x), Fraction(y)) for x, y in ((-1, -1), (2, -1), (2, 1), (-1, 1))]
    edge = [square[side], square[side - 3]]
    (x, y), (p, q) = edge
    normal = (x - p, y - q) if inward else (p - x, q - y)
    a, c = normal[1] + tilt * (p - x), -normal[0] + tilt * (q - y)
    row = (a, c, a * edge[on][0] + c * edge[on][1])
    assert set(clip(square, row)) == set(edge if inward else square)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(small, small), min_size=1, max_size=3))
def test_relaxed_sets_are_thin(offsets):
    """What a relaxed level leaves is a segment or a point, at the slack found."""
    unit_rows = [(Fraction(3, 5), Fraction(4, 5)), (Fraction(-5, 13), Fraction(12, 13))]
    unit_rows.append((Fraction(-1), Fraction(0)))
    level = [(a, c, Fraction(b) - 3) for (a, c), (b, _) in zip(unit_rows, offsets, strict=False)]
    corners = box_polygon(Fraction(-1), Fraction(1), Fraction(-1), Fraction(1))
    polygon, (slack,) = relax(corners, [level], lambda row: row)
    violations = [max(a * x + c * y - b for a, c, b in level) for x, y in polygon]
    if slack:
        assert len(polygon) <= 2
        assert len(set(polygon)) == len(polygon)
        assert violations == [slack] * len(polygon)
    else:
        assert max(violations) <= 0


UNEVEN = (-1.0, 0.5, -0.75, 1.0)


def relaxed_exactly(levels):
    rows = [[tuple(map(Fraction, row)) for row in level] for level in levels]
    return relax(box_polygon(*map(Fraction, UNEVEN)), rows, _unit)


@pytest.mark.parametrize("side", range(4))
def test_what_is_left_along_a_side_of_the_box_is_all_of_it(side):
    corners = box_polygon(*map(Fraction, UNEVEN))
    edge = [corners[side], corners[side - 3]]
    a, c = ((0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0))[side]
    b = a * float(edge[0][0]) + c * float(edge[0][1]) - 4.0
    for factor in (1.0, 3.0, 0.1):
        rows = [[(factor * a, factor * c, factor * b), (factor * a, factor * c, factor * b + 1.0)]]
        polygon, slacks = relaxed_exactly(rows)
        assert set(polygon) == set(edge)
        assert [float(slack) for slack in slacks] == pytest.approx([4.0], rel=1e-14)
    first, last = (tuple(map(Fraction, corner)) for corner in edge)
    along = (last[0] - first[0], last[1] - first[1])
    for power, kept in ((60, {first, last}), (44, {first})):
        for sign, ends in ((1, kept), (-1, kept if power == 60 else {last})):
            tilt = Fraction(sign, 2**power)
            row = (Fraction(a) + tilt * along[0], Fraction(c) + tilt * along[1], Fraction(b))
            exact_corners = box_polygon(*map(Fraction, UNEVEN))
            polygon, _ = relax(exact_corners, [[row]], _unit)
            assert set(polygon) == ends


@pytest.mark.parametrize("corner", range(4))
@pytest.mark.parametrize("row", [(3.0, 4.0), (4.0, 3.0)])
def test_what_is_left_at_a_corner_of_the_box_is_that_corner(corner, row):
    v, w = box_polygon(*UNEVEN)[corner]
    a, c = math.copysign(row[0], -v), math.copysign(row[1], -w)
    polygon, slacks = relaxed_exactly([[(a, c, a * v + c * w - 10.0)]])
    assert polygon == [(v, w)]
    assert slacks == [2]


@pytest.mark.parametrize("row", [(1.0, 0.0), (-2.0, 0.0), (0.0, 3.0), (0.0, -1.0)])
def test_what_is_left_of_a_level_that_cannot_hold_is_chosen_from_to_the_last_digits(reference, row):
    """A side of the box: the nearest point on it, by enumeration."""
    levels = [[(*row, -9.0)], [(0.3, 0.4, 0.9)]]
    for nominal in (
        (0.2, 0.1), (-0.4, 0.6), (2.0, -3.0), (-2.0, 3.0), (1e5, 1e5), (1e5, -1e5),
        (-1e5, 1e5), (0.0, -1e5), (-1e5, 0.0),
    ):  # fmt: skip
        for mixed in (0.0, 0.3, -0.3):
            objective = (1.0, mixed, 0.5, *nominal, 0.0, 0.0, 0.0, 0.0)
            answer = minimise(objective, UNEVEN, levels)
            point, slacks = reference.lexicographic((1.0, mixed, 0.5), nominal, UNEVEN, levels)
            assert answer[:2] == pytest.approx([float(x) for x in point], abs=1e-12)
            assert answer.slacks == pytest.approx([float(x) for x in slacks], abs=1e-12)


def test_of_rows_in_one_direction_the_tightest_counts():
    unit_rows = [(0.6, 0.8, -2.0), (0.6, 0.8, -3.0), (0.6, 0.8, -2.5)]
    assert tightest(unit_rows) == [(0.6, 0.8, -3.0)]
    tilted = (0.6 + 0.8 * 2.0**-52, 0.8 - 0.6 * 2.0**-52, -4.0)
    assert tightest([*unit_rows, tilted]) == [tilted]
    opposite, across = (-0.6, -0.8, -5.0), (-0.8, 0.6, -6.0)
    assert tightest([unit_rows[0], opposite, across]) == [unit_rows[0], opposite, across]
    nearly = (0.6 + 0.8 * 2.0**-40, 0.8 - 0.6 * 2.0**-40, -4.0)
    assert tightest([unit_rows[0], nearly]) == [unit_rows[0], nearly]


def test_floats_ask_for_fractions_when_rounding_decides():
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


@pytest.mark.parametrize("penalty", [0.0, 10.0])
@pytest.mark.parametrize("mixed", [0.0, 0.3])
@pytest.mark.parametrize("box", [(-0.1, 0.3, -0.2, 0.3), (0.1, 0.1, -0.2, 0.3)])
def test_ordinary_programs_need_no_fractions(box, mixed, penalty):
    """Nor do those whose rows cannot all hold: fractions are for what rounding could turn."""
    rng = np.random.default_rng(11)
    relaxed = 0
    for _ in range(150):
        levels = []
        for _ in range(rng.integers(1, 3)):
            angles = rng.uniform(-math.pi, math.pi, rng.integers(0, 4)).tolist()
            scales = rng.uniform(0.1, 5.0, len(angles)).tolist()
            through = rng.uniform((-0.2, -0.3), 0.4, (len(angles), 2)).tolist()
            levels.append(
                [
                    (k * math.cos(t), k * math.sin(t), k * (math.cos(t) * v + math.sin(t) * w))
                    for t, k, (v, w) in zip(angles, scales, through, strict=True)
                ]
            )
        nominal, soft = rng.uniform(-0.5, 0.5, 2).tolist(), rng.uniform(-1.0, 1.0, 3).tolist()
        answer = minimise((1.0, mixed, 0.5, *nominal, penalty, *soft), box, levels)
        assert answer.rational is False
        relaxed += answer.relaxed
    assert relaxed > 20


headings = pytest.mark.parametrize(
    "heading", [0.0, 0.4, 1.2, math.pi / 2, 2.0, 3.0, -0.7, -1.9, -2.6]
)


def direction(heading, length=1.0):
    return length * math.cos(heading), length * math.sin(heading)


@headings
@pytest.mark.parametrize("scale", [1e-3, 1.0, 50.0])
@pytest.mark.parametrize("back", [0.0, math.pi])
def test_a_soft_row_at_a_small_angle_is_seen(heading, scale, back):
    """Either way along: what floats leave to fractions starts at 2**-10."""
    soft = direction(heading, 3.0 * scale)
    for angle, small in ((2.0**-9, False), (2.0**-11, True), (0.0, True), (0.7, False)):
        for sign in (1.0, -1.0):
            row = (*direction(heading + back + sign * angle, 1.0 / scale), 0.3)
            assert _aslant(row, *soft) is small


TOUCH = 2.0**-40


@headings
@pytest.mark.parametrize("scale", [0.01, 1.0, 20.0])
def test_a_wedge_is_two_lines_at_a_small_angle_through_the_point(heading, scale):
    point = (0.125, -0.25)
    box = (-8.0, 9.0, -10.0, 11.0)

    def line(angle, length, past=0.0):
        a, c = direction(angle, length)
        size = abs(a) + abs(c)
        return a, c, a * point[0] + c * point[1] + past * TOUCH * size

    row = line(heading, scale)
    for angle, small in ((2.0**-9, False), (2.0**-11, True), (2.0**-45, True), (2.0**-53, False)):
        for sign in (1.0, -1.0):
            near = line(heading + sign * angle, 2.0)
            if small or angle > 1e-3:
                assert _in_a_wedge(row, point, box, [near], TOUCH) is small
            opposite = line(heading + math.pi + sign * angle, 3.0)
            assert _in_a_wedge(row, point, box, [opposite], TOUCH) is (angle < 1e-3)
    same = tuple(2.0 * entry for entry in row)
    assert _in_a_wedge(row, point, box, [same], TOUCH) is False
    slanted = heading + 2.0**-12
    for past, near in ((1.5, True), (-1.5, True), (2.6, False), (-2.6, False), (1e6, False)):
        assert _in_a_wedge(row, point, box, [line(slanted, 2.0, past)], TOUCH) is near
    crossing = line(heading + 1.0, 1.0)
    assert _in_a_wedge(row, point, box, [crossing, line(slanted, 2.0)], TOUCH) is True


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wedge_with_a_side_of_the_box(side, sign):
    box = (-0.5, 0.75, -0.25, 1.0)
    outward = (0.0, math.pi, math.pi / 2, -math.pi / 2)[side]
    point = [(0.75, 0.25), (-0.5, 0.25), (0.125, 1.0), (0.125, -0.25)][side]
    for turned in (outward, outward + math.pi):
        a, c = direction(turned + sign * 2.0**-12)
        row = (a, c, a * point[0] + c * point[1])
        assert _in_a_wedge(row, point, box, [], TOUCH) is True
        inside = tuple(x - 0.01 * d for x, d in zip(point, direction(outward), strict=True))
        assert _in_a_wedge(row, inside, box, [], TOUCH) is False
    a, c = direction(outward + sign * 2.0**-8)
    assert _in_a_wedge((a, c, a * point[0] + c * point[1]), point, box, [], TOUCH) is False
    a, c = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))[side]
    assert _in_a_wedge((a, c, a * point[0] + c * point[1]), point, box, [], TOUCH) is False
    opposite = (-a, -c, -a * point[0] - c * point[1])
    assert _in_a_wedge(opposite, point, box, [], TOUCH) is True


@pytest.mark.parametrize(
    ("objective", "trusted"),
    [
        ((1.0, 0.0, 1.0, 0.2, -0.3, 0.0, 0.0, 0.0, 0.0), True),
        ((1.0, 0.0, 1.0, 600.0, 600.0, 0.0, 0.0, 0.0, 0.0), True),
        ((1.0, 0.0, 1.0, 3000.0, 3000.0, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 0.0, 1.0, -3000.0, 3000.0, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 0.0, 1.0, 3000.0, -3000.0, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 0.0, 1.0, -5000.0, 0.0, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 0.0, 1.0, 0.0, -5000.0, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 1.0 - 2.0**-30, 1.0, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0), False),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, 0.0, 0.0, 0.5), False),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, 1e-160, -1e-160, 0.5), False),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, -1e160, 1e160, 0.5), False),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 0.0, 1e160, 0.0, 0.5), True),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, -1e-100, 0.0, 0.5), True),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, 0.0, -1e100, 0.5), True),
        ((1.0, 0.0, 1.0, 0.2, 0.1, 1.0, 0.5, -0.5, 0.5), True),
    ],
)
def test_costs_that_floats_are_trusted_with(objective, trusted):
    """Nominal commands within 2**10 sizes of the box, weights of one order, soft rows of any."""
    box = (-1.0, 0.5, -0.5, 1.0)
    if trusted:
        check_trusted(objective, box)
    else:
        with pytest.raises(Delicate):
            check_trusted(objective, box)


@pytest.mark.parametrize("v", [-3.0, -1.0, -0.75, 0.25, 0.5, 0.75, 2.0])
@pytest.mark.parametrize("w", [-2.0, -0.75, -0.5, 0.25, 0.75, 1.0, 3.0])
@pytest.mark.parametrize("box", [(-1.0, 0.5, -0.5, 1.0), (-0.5, 1.0, -1.0, 0.5)])
def test_a_nominal_command_on_a_side_of_the_box_stays_on_it(v, w, box):
    """Each coordinate inside, on a side or outside, in every combination."""
    for mixed in (0.0, 0.4):
        objective = (1.0, mixed, 0.5, v, w, 0.0, 0.0, 0.0, 0.0)
        exactly = solve_rational(objective, box, [])
        assert project(objective, box, []) == pytest.approx(exactly[:2], abs=1e-15)
        if not mixed:
            assert exactly[:2] == (min(max(v, box[0]), box[1]), min(max(w, box[2]), box[3]))


@pytest.mark.parametrize("heading", [0.4, 1.2, 2.0, -0.7, -2.6])
@pytest.mark.parametrize("angle", [2.0**-12, -(2.0**-12)])
def test_a_soft_row_next_to_a_hard_one_is_left_to_fractions(heading, angle):
    soft = (*direction(heading), 0.6)  # pulls to the far side of the row
    objective, box = (1.0, 0.0, 0.5, 0.4, 0.3, 10.0, *soft), (-1.0, 1.0, -1.0, 1.0)

    def cut(turned):
        a, c = direction(turned)
        return (a, c, a * 0.05 + c * 0.02 - 0.1)

    with pytest.raises(Delicate):
        project(objective, box, [[cut(heading + angle)]])
    for other in (math.pi - heading, -heading):  # in a mirror it is at a large angle
        point = project(objective, box, [[cut(other)]])
        exactly = solve_rational(objective, box, [[cut(other)]])
        assert point == pytest.approx(exactly[:2], abs=1e-12)


@pytest.mark.parametrize("cost_of", [(1.0, 0.0, 1.0, 1e5, 1e5), (1.0, 0.0, 2.0**-40, 2.0, 2.0)])
def test_costs_that_floats_are_not_trusted_with_are_not_taken_along_a_row(cost_of):
    """A corner of the box needs no trust, with weights of no cross term."""
    objective, box = (*cost_of, 0.0, 0.0, 0.0, 0.0), (-1.0, 0.5, -0.5, 1.0)
    with pytest.raises(Delicate):
        project(objective, box, [[(1.0, 1.0, 0.7)]])
    assert project(objective, box, [[(1.0, 1.0, 1.7)]]) == (0.5, 1.0)


@pytest.mark.parametrize("row", [(1.0, 1.0), (1.0, 3.0), (3.0, 1.0), (-1.0, 0.5), (0.5, -1.0)])
@pytest.mark.parametrize("cut", [1e-12, 1e-13, 1e-14])
def test_fractions_keep_a_row_that_cuts_off_next_to_nothing(row, cut):
    """Less than floats can tell; the nominal command is the corner that is cut off."""
    a, c = row
    corner = (1.0 if a > 0 else -1.0, 1.0 if c > 0 else -1.0)
    b = a * corner[0] + c * corner[1] - cut
    objective = (1.0, 0.0, 1.0, *corner, 0.0, 0.0, 0.0, 0.0)
    v, w, slacks = solve_rational(objective, (-1.0, 1.0, -1.0, 1.0), [[(a, c, b)]])
    assert slacks == (0.0,)
    gap = Fraction(a) * Fraction(v) + Fraction(c) * Fraction(w) - Fraction(b)
    assert abs(gap) <= 4e-16 * (abs(a) + abs(c))


@pytest.mark.parametrize("exponent", [-300, -240, -150, -101, -100, 0, 99, 100, 101, 150, 240, 300])
def test_fractions_scale_rows_of_any_length(exponent):
    """The slack is a distance, whatever the length of the row; to more digits than a float has."""
    k = 2.0**exponent
    objective = (1.0, 0.0, 1.0, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0)
    box, rows = (-1.0, 1.0, -1.0, 1.0), [(k, 2.0 * k, -6.0 * k), (-3.0, -1.0, -9.0)]
    v, w, slacks = solve_rational(objective, box, [rows])
    plain = solve_rational(objective, box, [[(1.0, 2.0, -6.0), (-3.0, -1.0, -9.0)]])
    assert (v, w) == pytest.approx((plain.v, plain.omega), abs=1e-15)
    distances = ((v + 2.0 * w + 6.0) / math.sqrt(5.0), (9.0 - 3.0 * v - w) / math.sqrt(10.0))
    assert slacks == pytest.approx((max(distances),), rel=1e-14)


@pytest.mark.parametrize("exponent", [-500, -300, -101, -100, -99, 0, 99, 100, 101, 300, 500])
@pytest.mark.parametrize("row", [(3, 4, 1), (1, 0, -2), (0, -7, 5), (1, 1, 1), (2, -3, 0)])
def test_unit_rows_are_of_length_one_to_a_hundred_bits(row, exponent):
    k = Fraction(2) ** exponent
    a, c, b = _unit(tuple(k * entry for entry in row))
    assert all(isinstance(entry, Fraction) for entry in (a, c, b))
    assert abs(a * a + c * c - 1) < Fraction(1, 2**97)
    assert a * row[1] == c * row[0]
    assert a * row[2] == b * row[0]
    assert c * row[2] == b * row[1]
    assert a * row[0] + c * row[1] > 0


def test_a_slack_beyond_all_floats_is_infinite():
    objective = (1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    answer = solve_rational(objective, (-1.0, 1.0, -1.0, 1.0), [[(1e-300, 0.0, -1e100)]])
    assert answer == (-1.0, 0.0, (math.inf,))


@pytest.mark.parametrize(
    "point", [(0.25, 0.1), (-0.05, 0.25), (0.3, -0.2), (-0.1, 0.3), (0.0, 0.0)]
)
def test_fractions_leave_a_minimum_inside_where_it_is(point):
    box = (-0.1, 0.3, -0.2, 0.3)
    for mixed, penalty in ((0.0, 0.0), (0.4, 0.0), (0.4, 3.0)):
        soft = (1.0, -2.0, point[0] - 2.0 * point[1])  # met by the point
        objective = (1.0, mixed, 0.5, *point, penalty, *soft)
        for levels in ([], [[(1.0, 1.0, 0.9)]], [[(1.0, 1.0, 0.4), (-1.0, 2.0, 0.75)]]):
            answer = solve_rational(objective, box, levels)
            assert answer[:2] == pytest.approx(point, abs=1e-15)
            assert not any(answer.slacks)


def test_degenerate_boxes():
    assert box_polygon(1.0, 1.0, 2.0, 2.0) == [(1.0, 2.0)]
    assert sorted(box_polygon(1.0, 1.0, 2.0, 3.0)) == [(1.0, 2.0), (1.0, 3.0)]
    assert sorted(box_polygon(0.0, 1.0, 2.0, 2.0)) == [(0.0, 2.0), (1.0, 2.0)]
    assert box_polygon(-1.0, -1.0, -2.0, -2.0) == [(-1.0, -2.0)]
    assert sorted(box_polygon(-1.0, -1.0, -2.0, 3.0)) == [(-1.0, -2.0), (-1.0, 3.0)]
    assert sorted(box_polygon(-3.0, 1.0, -2.0, -2.0)) == [(-3.0, -2.0), (1.0, -2.0)]
    assert box_polygon(-3.0, 1.0, -2.0, 4.0) == [(-3.0, -2.0), (1.0, -2.0), (1.0, 4.0), (-3.0, 4.0)]


BOXES = [
    (-0.1, 0.3, -0.2, 0.3),
    (5.0, 5.25, -0.125, 0.125),
    (-5.25, -5.0, -0.125, 0.125),
    (-0.125, 0.125, 5.0, 5.25),
    (-0.125, 0.125, -5.25, -5.0),
]


def chord_exactly(box, row, taken):
    """Both ends of a line in a box and half-planes, in fractions; None where it misses them."""
    a, c, b = map(Fraction, row)
    x, y = (side * b / (a * a + c * c) for side in (a, c))
    v_lo, v_hi, w_lo, w_hi = map(Fraction, box)
    sides = [(1, 0, v_hi), (-1, 0, -v_lo), (0, 1, w_hi), (0, -1, -w_lo)]
    lows, highs = [], []
    for d, e, f in (*sides, *(map(Fraction, other) for other in taken)):
        rate, gap = a * e - c * d, f - d * x - e * y
        if rate:
            (highs if rate > 0 else lows).append(gap / rate)
        elif gap < 0:
            return None
    if max(lows) > min(highs):
        return None
    return [(x - c * t, y + a * t) for t in (max(lows), min(highs))]


def answered(box, row, point, taken):
    """Whether floats answer; when they do, it is what fractions say."""
    try:
        found = chord(box, row, *point, taken)
    except Delicate:
        return False
    ends = chord_exactly(box, row, taken)
    assert (found is None) == (ends is None)
    if found is not None:
        x, y, *limits = found
        for t, (v, w) in zip(limits, ends, strict=True):
            tolerance = 1e-12 * box_scale(*box)
            assert abs(x - row[1] * t - float(v)) <= tolerance
            assert abs(y + row[0] * t - float(w)) <= tolerance
    return True


def drift(box, angle):
    """How far two lines at an angle may part within a box, and what rounding adds."""
    return 2.0 * (box[1] - box[0] + box[3] - box[2]) * abs(angle) + 2.0**-40 * box_scale(*box)


SMALL_ANGLES = [0.0, 1e-9, -1e-9, 1e-5, -1e-5, 2.0**-11, -(2.0**-11)]
SHARES = [-3.0, -1.2, -0.8, -0.4, -0.1, 0.1, 0.4, 0.8, 1.2, 3.0]


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("side", range(4))
def test_a_line_along_a_side_of_the_box_is_in_or_out_or_left_to_fractions(box, side):
    outward = (0.0, math.pi, math.pi / 2, -math.pi / 2)[side]
    end = box[(1, 0, 3, 2)[side]]
    middle = 0.5 * (box[2] + box[3]) if side < 2 else 0.5 * (box[0] + box[1])
    for angle in SMALL_ANGLES:
        for share in SHARES:
            past = end + share * drift(box, angle) * (1.0, -1.0, 1.0, -1.0)[side]
            through = (past, middle) if side < 2 else (middle, past)
            for length in (1.0, -7.0):
                a, c = direction(outward + angle, length)
                if not angle:
                    a, c = round(a), round(c)
                row = (a, c, a * through[0] + c * through[1])
                for point in box_polygon(*box):
                    assert answered(box, row, point, []) or abs(share) < 2.0


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("heading", [0.3, 2.5, -1.1, math.pi / 4, -math.pi / 4, 3 * math.pi / 4])
def test_a_line_along_a_row_keeps_or_breaks_it_or_is_left_to_fractions(box, heading):
    """Whatever the length of that row; at a large angle the row cuts off one end."""
    middle = (0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]))
    row = (*direction(heading, 2.0),)
    row = (*row, row[0] * middle[0] + row[1] * middle[1])
    normal = direction(heading)
    for angle in (*SMALL_ANGLES[1:], 2.0**-9, -0.7, 1.2):
        for share in SHARES:
            past = share * drift(box, angle if abs(angle) < 1e-3 else 1e-3)
            place = (middle[0] + past * normal[0], middle[1] + past * normal[1])
            for turned in (angle, angle + math.pi):
                for length in (1.0, 2.0**-530, 2.0**40):
                    a, c = direction(heading + turned, length)
                    other = (a, c, a * place[0] + c * place[1])
                    for point in (middle, (box[0], box[3])):
                        told = answered(box, row, point, [(0.0, 0.0, 1.0), other])
                        assert told or (abs(share) < 2.0 and abs(angle) < 1e-3)


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("corner", range(4))
def test_a_line_that_cuts_off_next_to_nothing_is_left_to_fractions(box, corner):
    v, w = box_polygon(*box)[corner]
    middle = (0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]))
    a, c = math.copysign(1.0, v - middle[0]), math.copysign(1.0, w - middle[1])
    for length, told in ((0.5, False), (2.0, True)):
        inside = length * 2.0**-40 * box_scale(*box) / 2.0
        row = (a, c, a * v + c * w - inside * math.sqrt(2.0))
        assert answered(box, row, middle, []) is told
        assert answered(box, tuple(3.0 * entry for entry in row), middle, []) is told


@pytest.mark.parametrize("box", BOXES)
def test_the_scale_of_a_box_exceeds_its_coordinates(box):
    assert box_scale(*box) >= max(map(abs, box))
    assert box_scale(*box) <= 4.0 * max(map(abs, box))


@pytest.mark.parametrize("scale", [2.0**-530, 2.0**-1000])
@pytest.mark.parametrize(
    "cut", [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 2), (-2, 1), (2, -1), (-1, -1)]
)
def test_a_short_row_cuts_as_a_long_one_does(cut, scale):
    """Its squared length is zero in floats."""
    box, row, point = (-0.1, 0.3, -0.2, 0.3), (3.0, 1.0, 0.25), (0.05, 0.1)
    long = (*map(float, cut), cut[0] * point[0] + cut[1] * point[1])
    assert answered(box, row, point, [long])
    short = tuple(scale * entry for entry in long)
    assert chord(box, row, *point, [short]) == chord(box, row, *point, [long])


@pytest.mark.parametrize("factor", [1.0, 3.0, 0.1])
def test_a_line_keeps_its_own_row_and_copies_of_it_without_fractions(factor):
    box, row, point = (-0.1, 0.3, -0.2, 0.3), (3.0, 1.0, 0.25), (0.05, 0.1)
    copy = tuple(factor * entry for entry in row)
    assert chord(box, row, *point, [copy]) == chord(box, row, *point, [])
