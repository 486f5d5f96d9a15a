"""The footprint's distances against a convex search and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.constraints.capsule import Capsule
from clfcbf.errors import ConfigurationError, GeometryError

coordinate = st.floats(-3.0, 3.0)
points = st.tuples(coordinate, coordinate)
capsules = st.builds(Capsule, st.floats(0.1, 1.0), st.floats(0.0, 1.5), st.floats(0.0, 1.0))


def segments_apart(a, b, c, d):
    """Distance of the segments ab and cd, a convex function of where on cd: golden section."""

    def nearest(share):
        x, y = c[0] + share * (d[0] - c[0]), c[1] + share * (d[1] - c[1])
        along, across = b[0] - a[0], b[1] - a[1]
        square = along * along + across * across
        foot = ((x - a[0]) * along + (y - a[1]) * across) / square if square else 0.0
        foot = min(max(foot, 0.0), 1.0)
        return math.hypot(x - a[0] - foot * along, y - a[1] - foot * across)

    low, high, golden = 0.0, 1.0, 0.5 * (math.sqrt(5.0) - 1.0)
    for _ in range(60):
        left, right = high - golden * (high - low), low + golden * (high - low)
        if nearest(left) < nearest(right):
            high = right
        else:
            low = left
    return min(nearest(0.5 * (low + high)), nearest(0.0), nearest(1.0))


def axis_of(capsule):
    return (-capsule.back, 0.0), (capsule.front, 0.0)


@given(capsules, points, st.floats(0.0, 0.5))
def test_clearance_is_the_distance_to_the_axis_less_the_radii(capsule, point, radius):
    (left, _), (right, _) = axis_of(capsule)
    x, y = point
    beyond = max(left - x, 0.0, x - right)
    expected = math.hypot(beyond, y) - capsule.radius - radius
    assert capsule.clearance(point, radius) == pytest.approx(expected, abs=1e-12)


@given(capsules, points)
def test_clearance_is_the_signed_distance_to_the_outline(capsule, point):
    """Against the outline itself, sampled: outside and inside."""
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 400)
    right = np.stack([capsule.front + capsule.radius * np.cos(turn), capsule.radius * np.sin(turn)])
    left = np.stack([-capsule.back - capsule.radius * np.cos(turn), capsule.radius * np.sin(turn)])
    along = np.linspace(-capsule.back, capsule.front, 400)
    top = np.stack([along, np.full(400, capsule.radius)])
    outline = np.concatenate([right, left, top, top * [[1.0], [-1.0]]], axis=1)
    nearest = float(np.hypot(*(outline - np.array(point)[:, None])).min())
    assert abs(capsule.clearance(point)) == pytest.approx(nearest, abs=5e-3)


@given(capsules, points)
def test_gradient(capsule, point):
    assume(capsule.clearance(point) > -capsule.radius + 1e-2)
    x, y = point
    step = 1e-5
    slope = (
        (capsule.clearance((x + step, y)) - capsule.clearance((x - step, y))) / (2 * step),
        (capsule.clearance((x, y + step)) - capsule.clearance((x, y - step))) / (2 * step),
    )
    assert capsule.gradient(point) == pytest.approx(slope, abs=1e-5 / 1e-2)
    assert math.hypot(*capsule.gradient(point)) == pytest.approx(1.0)


@given(capsules, points, points, st.floats(0.0, 0.3))
def test_wall_clearance_is_the_distance_of_two_segments(capsule, start, end, radius):
    assume(math.dist(start, end) > 1e-3)
    apart = segments_apart(*axis_of(capsule), start, end)
    expected = apart - capsule.radius - radius
    assert capsule.wall_clearance(start, end, radius) == pytest.approx(expected, abs=1e-7)


def test_walls_that_cross_touch_or_cover_the_axis():
    capsule = Capsule(0.5, 1.0, 0.2)
    for wall in (
        ((0.5, -2.0), (0.6, 3.0)),
        ((1.0, 0.0), (2.0, 1.0)),
        ((-3.0, 0.0), (3.0, 0.0)),
        ((0.3, 0.0), (0.3, 0.0)),
    ):
        assert capsule.wall_clearance(*wall) == -0.5
    assert capsule.wall_clearance((1.1, 0.0), (2.0, 0.0)) == pytest.approx(-0.4)
    assert capsule.wall_clearance((1.2, -1.0), (1.2, 1.0)) == pytest.approx(-0.3)


def test_on_the_axis_there_is_no_direction_away():
    assert Capsule(0.5, 1.0).gradient((0.4, 0.0)) == (0.0, 0.0)


def test_the_papers_footprints():
    """0.55 m around it alone; with a trolley 1.3 m ahead, 0.55 m behind."""
    alone, loaded = Capsule.without_trolley(), Capsule.with_trolley()
    for angle in np.linspace(-3.0, 3.0, 7):
        edge = (0.55 * math.cos(angle), 0.55 * math.sin(angle))
        assert alone.clearance(edge) == pytest.approx(0.0, abs=1e-12)
    assert loaded.clearance((1.3, 0.0)) == pytest.approx(0.0, abs=1e-12)
    assert loaded.clearance((-0.55, 0.0)) == pytest.approx(0.0, abs=1e-12)
    assert loaded.clearance((0.3, 0.55)) == pytest.approx(0.0, abs=1e-12)
    assert loaded.lever == pytest.approx(0.75)


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, math.inf])
def test_bad_radius(radius):
    with pytest.raises(ConfigurationError, match="radius"):
        Capsule(radius)


@pytest.mark.parametrize(("front", "back"), [(-0.1, 0.0), (math.nan, 0.0), (0.0, math.inf)])
def test_bad_axis(front, back):
    with pytest.raises(ConfigurationError, match="axis"):
        Capsule(0.5, front, back)


def test_numbers_that_are_not_finite():
    capsule = Capsule(0.5)
    with pytest.raises(GeometryError, match="disc"):
        capsule.clearance((math.nan, 0.0))
    with pytest.raises(GeometryError, match="point"):
        capsule.gradient((math.inf, 0.0))
    with pytest.raises(GeometryError, match="wall"):
        capsule.wall_clearance((0.0, 0.0), (math.nan, 1.0))
