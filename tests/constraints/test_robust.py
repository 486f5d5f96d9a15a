"""Rows for a set of points against that set, sampled densely; quantiles against samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier, camera_edges
from clfcbf.constraints.robust import (
    binding,
    ellipse_polygon,
    margin_of,
    reckoned_covariance,
    sector_polygon,
    vertex_rows,
)
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.estimation import TargetEstimate, grown
from clfcbf.se2 import Pose2, Twist
from tests.constraints.sweeps import scene_of, twists

GAIN = 1.3
CAMERA = FieldOfView(0.6, Pose2(0.2, -0.05, 0.1))
EDGES = camera_edges(CAMERA)
CENTRE = CAMERA.camera[:2]
NAMES = ("left", "right")
STILL = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))

points = st.tuples(st.floats(0.5, 3.0), st.floats(-2.0, 2.0))
bearing_errors = st.floats(0.0, 1.0)
range_errors = st.floats(0.0, 1.0)


def sector(point, bearing_error, range_error, count=15):
    """Points of the annular sector itself."""
    x, y = point[0] - CENTRE[0], point[1] - CENTRE[1]
    rho, phi = math.hypot(x, y), math.atan2(y, x)
    for distance in np.linspace(max(rho - range_error, 0.0), rho + range_error, count):
        for bearing in np.linspace(phi - bearing_error, phi + bearing_error, count):
            yield (
                CENTRE[0] + distance * math.cos(bearing),
                CENTRE[1] + distance * math.sin(bearing),
            )


def row_at(edge, point, twist):
    """Rate of the depth plus the gain times it, at one point."""
    n_x, n_y, offset = edge
    x, y = point
    rate = -n_x * twist.v + (n_x * y - n_y * x) * twist.omega
    return rate + GAIN * (n_x * x + n_y * y - offset)


def inside(polygon, point):
    """How far a point is inside a polygon that runs counter-clockwise."""
    least = math.inf
    for (a, b), (c, d) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        length = math.hypot(c - a, d - b)
        if length > 1e-9:
            across = (c - a) * (point[1] - b) - (d - b) * (point[0] - a)
            least = min(least, across / length)
    return least


@given(points, bearing_errors, range_errors)
def test_the_polygon_contains_the_sector(point, bearing_error, range_error):
    polygon = sector_polygon(point, CENTRE, bearing_error, range_error)
    for sample in sector(point, bearing_error, range_error):
        assert inside(polygon, sample) >= -1e-9


def test_the_hull_of_the_corners_does_not_contain_it():
    """What the outer side's tangent is for."""
    point, errors = (1.5, 0.2), (0.5, 0.1)
    x, y = point[0] - CENTRE[0], point[1] - CENTRE[1]
    rho, phi = math.hypot(x, y), math.atan2(y, x)
    corners = [
        (CENTRE[0] + r * math.cos(b), CENTRE[1] + r * math.sin(b))
        for r, b in ((rho - 0.1, phi - 0.5), (rho + 0.1, phi - 0.5),
                     (rho + 0.1, phi + 0.5), (rho - 0.1, phi + 0.5))
    ]  # fmt: skip
    assert min(inside(corners, sample) for sample in sector(point, *errors)) < -0.1


@given(points, bearing_errors, range_errors, twists)
def test_rows_at_the_vertices_hold_on_all_of_the_set(point, bearing_error, range_error, twist):
    polygon = sector_polygon(point, CENTRE, bearing_error, range_error)
    rows = vertex_rows(NAMES, EDGES, polygon, GAIN)
    for side, edge in zip(NAMES, EDGES, strict=True):
        spare = min(
            b - a_v * twist.v - a_omega * twist.omega
            for name, (a_v, a_omega, b) in zip(rows.names, rows.coefficients, strict=True)
            if name.startswith(side)
        )
        on_the_set = min(row_at(edge, p, twist) for p in sector(point, bearing_error, range_error))
        assert on_the_set >= spare - 1e-9
        at_a_vertex = min(row_at(edge, p, twist) for p in polygon)
        assert spare == pytest.approx(at_a_vertex, abs=1e-9)


def test_the_deepest_vertex_decides_the_clearance_but_not_the_row():
    """Turning right carries far points out faster, though a near one is deeper."""
    polygon = sector_polygon((1.5, 0.3), CENTRE, 0.1, 0.5)
    left = EDGES[0]
    depths = [left[0] * x + left[1] * y - left[2] for x, y in polygon]
    deepest = int(np.argmin(depths))
    samples = list(sector((1.5, 0.3), 0.1, 0.5))
    assert min(depths) <= min(left[0] * x + left[1] * y - left[2] for x, y in samples) + 1e-12
    twist = Twist(0.0, -0.5)
    asked = [row_at(left, vertex, twist) for vertex in polygon]
    assert int(np.argmin(asked)) != deepest
    assert min(asked) < asked[deepest] - 0.04
    names = vertex_rows(NAMES[:1], EDGES[:1], polygon, GAIN).names
    assert f"left.{deepest}" in names
    assert f"left.{int(np.argmin(asked))}" in names


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=1, max_size=8),
    st.sampled_from([0.5, 2.0, 50.0, math.inf]),
)
def test_binding_lines_are_the_lower_envelope(lines, bound):
    kept = binding(lines, bound)
    reach = min(bound, 100.0)
    samples = np.linspace(-reach, reach, 401)
    values = np.array([a + b * samples for a, b in lines])
    assert values[kept].min(axis=0) == pytest.approx(values.min(axis=0))
    # None is left that another one makes idle.
    if bound == math.inf:
        for index in kept:
            others = np.array([lines[i] for i in kept if i != index]).reshape(-1, 2)
            meets = [(lines[index][0] - a) / (b - lines[index][1]) for a, b in others]
            at = np.array([*meets, *(np.array(meets) + 1e-3), *(np.array(meets) - 1e-3), 0.0])
            below = (lines[index][0] + lines[index][1] * at)[:, None]
            assert (below < others[:, 0] + others[:, 1] * at[:, None] + 1e-9).all(axis=1).any()


@given(
    points, st.floats(0.01, 0.3), st.floats(0.01, 0.3), st.floats(-0.9, 0.9), st.floats(0.1, 0.99)
)
def test_the_polygon_contains_the_ellipse(point, s_x, s_y, correlation, confidence):
    cross = correlation * s_x * s_y
    covariance = ((s_x**2, cross, 0.0), (cross, s_y**2, 0.0), (0.0, 0.0, 1.0))
    polygon = ellipse_polygon(point, covariance, confidence)
    assert len(polygon) == 8
    factor = np.linalg.cholesky(np.array([[s_x**2, cross], [cross, s_y**2]]))
    radius = math.sqrt(-2.0 * math.log(1.0 - confidence))
    turned = polygon if inside(polygon, point) > 0 else polygon[::-1]
    for angle in np.linspace(0.0, 2.0 * math.pi, 60):
        sample = np.array(point) + radius * factor @ (math.cos(angle), math.sin(angle))
        assert inside(turned, sample) >= -1e-9


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.99])
def test_margin_and_setback_hold_as_often_as_they_say(confidence):
    """40,000 errors of a correlated normal distribution; the two bounds of Bonferroni."""
    rng = np.random.default_rng(3)
    factor = rng.normal(0.0, 0.05, (3, 3))
    covariance = tuple(map(tuple, (factor @ factor.T).tolist()))
    margin, setback = margin_of(covariance, confidence)
    errors = rng.normal(size=(40_000, 3)) @ factor.T
    held = (np.hypot(errors[:, 0], errors[:, 1]) <= setback) & (np.abs(errors[:, 2]) <= margin)
    assert held.mean() >= confidence - 3.0 * math.sqrt(confidence * (1.0 - confidence) / 40_000)
    # Each alone as often as (1 + c)/2, the heading exactly so.
    each = 0.5 * (1.0 + confidence)
    alone = (np.abs(errors[:, 2]) <= margin).mean()
    assert alone == pytest.approx(each, abs=4.0 * math.sqrt(each * (1.0 - each) / 40_000))


def test_a_round_error_is_inside_the_setback_as_often_as_chi_square_says():
    rng = np.random.default_rng(8)
    _, setback = margin_of(((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.0)), 0.9)
    share = (np.hypot(*rng.normal(0.0, 0.1, (2, 40_000))) <= setback).mean()
    assert share == pytest.approx(0.95, abs=0.005)


@given(points, st.floats(0.0, 0.3), st.floats(0.0, 0.05))
def test_inside_the_inflated_view_is_in_view_with_any_such_error(point, target_speed, age):
    inflation = margin_of(STILL, 0.95, target_speed, age)
    barrier = FieldOfViewBarrier(CAMERA, GAIN, *_as_settings(inflation))
    assume(barrier.clearance(scene_of(*point)) >= 0.0)
    bare = barrier.bare
    x, y = point[0] - CENTRE[0], point[1] - CENTRE[1]
    for turn in (-inflation.margin, 0.0, inflation.margin):
        c, s = math.cos(turn), math.sin(turn)
        turned = CENTRE[0] + c * x - s * y, CENTRE[1] + s * x + c * y
        for angle in np.linspace(-3.0, 3.0, 9):
            seen = scene_of(
                turned[0] + inflation.setback * math.cos(angle),
                turned[1] + inflation.setback * math.sin(angle),
            )
            assert bare.clearance(seen) >= -1e-9


def _as_settings(inflation):
    return inflation.margin, "fov", inflation.setback


def test_a_target_that_may_move_adds_its_way():
    still = margin_of(STILL, 0.95)
    moving = margin_of(STILL, 0.95, target_speed=0.3, age=0.5)
    assert moving.margin == still.margin
    assert moving.setback == pytest.approx(still.setback + 0.15)


@given(points, st.floats(0.0, 0.3), st.floats(-0.5, 0.5), st.floats(0.01, 2.0), st.integers(1, 20))
def test_reckoned_covariance_bounds_the_estimators(point, v, omega, age, steps):
    """One step is the estimator's own; more steps, each with an error of its own, stay below."""
    estimate = TargetEstimate(Pose2(*point, 0.0), STILL, 0.0, 1)
    for _ in range(steps):
        estimate = grown(estimate, Twist(v, omega), age / steps, defaults.NOISE, Pose2(0, 0, 0))
    bound = reckoned_covariance(STILL, point, v * age, abs(omega) * age, age, defaults.NOISE)
    excess = np.array(bound) - np.array(estimate.covariance)
    if steps == 1:
        assert np.abs(excess).max() < 1e-12
    assert np.linalg.eigvalsh(excess)[0] >= -1e-12


def test_the_error_of_the_heading_moves_a_far_feature():
    age = 2.0
    near = reckoned_covariance(STILL, (0.5, 0.0), 0.0, 0.0, age, defaults.NOISE)
    far = reckoned_covariance(STILL, (3.0, 0.0), 0.0, 0.0, age, defaults.NOISE)
    sway = 3.0 * defaults.NOISE.drift * age
    assert far[1][1] == pytest.approx(STILL[1][1] + sway**2)
    assert margin_of(far, 0.95).setback > margin_of(near, 0.95).setback


def test_bad_arguments():
    with pytest.raises(ConfigurationError, match="bearing_error"):
        sector_polygon((1, 0), (0, 0), 1.6, 0.1)
    with pytest.raises(ConfigurationError, match="range_error"):
        sector_polygon((1, 0), (0, 0), 0.1, -0.1)
    with pytest.raises(GeometryError, match="point"):
        sector_polygon((math.nan, 0), (0, 0), 0.1, 0.1)
    with pytest.raises(ConfigurationError, match="sides"):
        ellipse_polygon((1, 0), STILL, 0.9, 2)
    for confidence in (0.0, 1.0, math.nan):
        with pytest.raises(ConfigurationError, match="confidence"):
            ellipse_polygon((1, 0), STILL, confidence)
        with pytest.raises(ConfigurationError, match="confidence"):
            margin_of(STILL, confidence)
    with pytest.raises(ConfigurationError, match="target_speed"):
        margin_of(STILL, 0.9, -1.0)
    with pytest.raises(ConfigurationError, match="age"):
        margin_of(STILL, 0.9, 0.0, math.inf)
    with pytest.raises(GeometryError, match="heading"):
        margin_of(((1, 0, 0), (0, 1, 0), (0, 0, -1)), 0.9)
    with pytest.raises(GeometryError, match="negative"):
        margin_of(((1, 0, 0), (0, -1, 0), (0, 0, 1)), 0.9)
    with pytest.raises(GeometryError, match="finite"):
        margin_of(((math.inf, 0, 0), (0, 1, 0), (0, 0, 1)), 0.9)
