"""Rows and clearance of the field of view against exact motion and against plain geometry."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import HERE, Barrier, Sweep
from clfcbf.constraints.bearing import bearing_rows, paper_row
from clfcbf.constraints.cbf import (
    Edge,
    FieldOfViewBarrier,
    camera_edges,
    edge_rows,
    half_plane_rows,
)
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.scene import Scene
from clfcbf.se2 import Point, Pose2, Twist, arc

PHI = math.radians(35.0)
AHEAD = FieldOfView(PHI, Pose2(0.2, 0.0, 0.0))
SKEWED = FieldOfView(0.7, Pose2(0.2, -0.1, 0.4))
GAIN = 1.7

coordinate = st.floats(-3.0, 3.0)
points = st.tuples(coordinate, coordinate)
twists = st.builds(Twist, st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))
velocities = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
cameras = st.builds(
    FieldOfView,
    st.floats(0.1, 1.5),
    st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0)),
)
headings = st.floats(-math.pi, math.pi)


def ray(origin: Point, angle: float, distance: float) -> Point:
    return origin[0] + distance * math.cos(angle), origin[1] + distance * math.sin(angle)


def derivative(function: Callable[[float], float], step: float = 1e-3) -> float:
    """Central difference of order six."""
    weights = ((1, 45.0), (2, -9.0), (3, 1.0))
    return sum(w * (function(k * step) - function(-k * step)) for k, w in weights) / (60.0 * step)


def seen(point: Point, velocity: Point, twist: Twist, time: float) -> Point:
    """The point after the robot moved along its arc and the point along its own line."""
    x, y = point[0] + velocity[0] * time, point[1] + velocity[1] * time
    return arc(twist, time).seen((x, y))


def assert_rates(
    rows: Rows,
    values: Callable[[Point], tuple[float, ...]],
    point: Point,
    velocity: Point,
    twist: Twist,
    gain: float,
) -> None:
    """Every row reads -h' <= gain h, with h and h' computed from the motion itself."""
    assert rows.priority == Priority.SAFETY
    assert rows.values == pytest.approx(values(point), rel=1e-11, abs=1e-12)
    for index, (a_v, a_w, b) in enumerate(rows.coefficients):
        rate = derivative(lambda t, i=index: values(seen(point, velocity, twist, t))[i])
        excess = a_v * twist.v + a_w * twist.omega - b
        assert excess == pytest.approx(-rate - gain * rows.values[index], rel=1e-7, abs=1e-8)


@given(camera=cameras, point=points, velocity=velocities, twist=twists, share=st.floats(0.0, 0.9))
def test_edge_rows_are_rates_of_the_distance_to_an_edge(
    camera: FieldOfView, point: Point, velocity: Point, twist: Twist, share: float
) -> None:
    margin = share * camera.half_angle

    def distances(p: Point) -> tuple[float, float]:
        """Distance at the camera times the sine of the angle to each edge."""
        x, y = camera.camera.seen(p)
        rho, phi, half = math.hypot(x, y), math.atan2(y, x), camera.half_angle - margin
        return rho * math.sin(half - phi), rho * math.sin(half + phi)

    rows = edge_rows(point, camera, GAIN, margin, velocity)
    assert rows.names == ("fov.left", "fov.right")
    assert_rates(rows, distances, point, velocity, twist, GAIN)


@given(
    camera=cameras,
    distance=st.floats(0.3, 3.0),
    phi=st.floats(-2.5, 2.5),
    velocity=velocities,
    twist=twists,
    share=st.floats(0.0, 0.9),
)
def test_bearing_rows_are_rates_of_the_bearing(
    camera: FieldOfView,
    distance: float,
    phi: float,
    velocity: Point,
    twist: Twist,
    share: float,
) -> None:
    margin = share * camera.half_angle
    point = camera.camera.transform(ray((0.0, 0.0), phi, distance))

    def angles(p: Point) -> tuple[float, float]:
        x, y = camera.camera.seen(p)
        half = camera.half_angle - margin
        return half - math.atan2(y, x), half + math.atan2(y, x)

    rows = bearing_rows(point, camera, GAIN, margin, velocity)
    assert_rates(rows, angles, point, velocity, twist, GAIN)


@given(rho=st.floats(0.3, 3.0), phi=st.floats(-2.5, 2.5), velocity=velocities, twist=twists)
def test_paper_row_is_the_rate_of_its_function(
    rho: float, phi: float, velocity: Point, twist: Twist
) -> None:
    point = ray((0.0, 0.0), phi, rho)

    def squares(p: Point) -> tuple[float]:
        return (0.5 * (PHI**2 - math.atan2(p[1], p[0]) ** 2),)

    assert_rates(paper_row(point, PHI, GAIN, velocity), squares, point, velocity, twist, GAIN)


@given(point=points, twist=twists)
def test_paper_row_as_printed(point: Point, twist: Twist) -> None:
    x, y = point
    assume(math.hypot(x, y) > 0.1)
    phi, square = math.atan2(y, x), x * x + y * y
    printed = phi / square * ((y * y * twist.omega - y * twist.v) + x * x * twist.omega)
    ((a_v, a_w, b),) = paper_row(point, PHI, GAIN).coefficients
    assert b - a_v * twist.v - a_w * twist.omega == pytest.approx(
        printed + GAIN * 0.5 * (PHI**2 - phi**2), rel=1e-10, abs=1e-12
    )


@given(
    rho=st.floats(0.3, 3.0),
    phi=st.floats(-2.5, 2.5),
    heading=headings,
    speed=st.floats(-0.3, 0.3),
    twist=twists,
)
def test_target_that_drives(
    rho: float, phi: float, heading: float, speed: float, twist: Twist
) -> None:
    """phi' gains (v_T / rho) sin(theta_T - phi) from a target that drives along its heading."""
    point = ray((0.0, 0.0), phi, rho)
    velocity = (speed * math.cos(heading), speed * math.sin(heading))
    rate = twist.v / rho * math.sin(phi) - twist.omega + speed / rho * math.sin(heading - phi)
    camera = FieldOfView(PHI)
    (left, right) = bearing_rows(point, camera, GAIN, 0.0, velocity).coefficients
    ((a_v, a_w, b),) = paper_row(point, PHI, GAIN, velocity).coefficients
    for (c_v, c_w, d), expected in (
        (left, rate - GAIN * (PHI - phi)),
        (right, -rate - GAIN * (PHI + phi)),
        ((a_v, a_w, b), phi * rate - GAIN * 0.5 * (PHI**2 - phi**2)),
    ):
        assert c_v * twist.v + c_w * twist.omega - d == pytest.approx(
            expected, rel=1e-10, abs=1e-12
        )


@given(camera=cameras, point=points)
def test_both_edges_together_are_the_view(camera: FieldOfView, point: Point) -> None:
    margin = camera.margin(point)
    assume(abs(margin) > 1e-9 and math.dist(point, camera.camera[:2]) > 1e-6)
    assert (min(edge_rows(point, camera, GAIN).values) > 0.0) == (margin > 0.0)


@given(
    camera=cameras,
    share=st.floats(-1.0, 1.0),
    distance=st.floats(0.0, 3.0),
    gain=st.floats(0.1, 10.0),
)
def test_standing_still_is_admissible_inside(
    camera: FieldOfView, share: float, distance: float, gain: float
) -> None:
    point = camera.camera.transform(ray((0.0, 0.0), share * camera.half_angle, distance))
    assert min(edge_rows(point, camera, gain).b) >= -1e-12 * gain * (1.0 + distance)
    if distance > 1e-6:
        assert min(bearing_rows(point, camera, gain).b) >= -1e-9 * gain


@given(
    offset=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    half_angle=st.floats(0.1, 1.5),
    point=points,
    twist=twists,
)
def test_two_edges_bound_the_speed(
    offset: Point, half_angle: float, point: Point, twist: Twist
) -> None:
    """The mean of the two rows over sin(Phi) is v <= gain (x - c_x) + omega y."""
    camera = FieldOfView(half_angle, Pose2(*offset, 0.0))
    (left, right) = edge_rows(point, camera, GAIN).coefficients
    total = [(p + q) / (2.0 * math.sin(half_angle)) for p, q in zip(left, right, strict=True)]
    x, y = point
    assert total == pytest.approx((1.0, -y, GAIN * (x - offset[0])), rel=1e-9, abs=1e-9)
    if all(row[0] * twist.v + row[1] * twist.omega <= row[2] for row in (left, right)):
        assert twist.v <= GAIN * (x - offset[0]) + twist.omega * y + 1e-9


@given(point=points, twist=twists, velocity=velocities)
def test_mirror_image(point: Point, twist: Twist, velocity: Point) -> None:
    x, y = point
    assume(math.hypot(x, y) > 0.1)
    assume(abs(y) > 1e-9 or x > 0.0)  # straight behind, the tie is broken to one side
    mirrored, drifting = (x, -y), (velocity[0], -velocity[1])
    for build in (edge_rows, bearing_rows):
        camera = FieldOfView(PHI)
        (left, right) = build(point, camera, GAIN, 0.1, velocity).coefficients
        (m_left, m_right) = build(mirrored, camera, GAIN, 0.1, drifting).coefficients
        assume(y != 0.0 or x > 0.0)  # atan2 breaks the tie straight behind to one side
        assert m_right == pytest.approx((left[0], -left[1], left[2]), rel=1e-12, abs=1e-14)
        assert m_left == pytest.approx((right[0], -right[1], right[2]), rel=1e-12, abs=1e-14)


def test_smooth_through_the_apex_where_the_bearing_is_not() -> None:
    apex = (AHEAD.camera.x, AHEAD.camera.y)
    assert edge_rows(apex, AHEAD, GAIN).values == pytest.approx((0.0, 0.0), abs=1e-16)
    rates = np.array(edge_rows(apex, AHEAD, GAIN).coefficients)
    for angle in np.linspace(-3.0, 3.0, 13):
        near = edge_rows(ray(apex, float(angle), 1e-9), AHEAD, GAIN).coefficients
        assert np.abs(np.array(near) - rates).max() < 5e-9
    with pytest.raises(GeometryError, match="bearing"):
        bearing_rows(apex, AHEAD, GAIN)
    with pytest.raises(GeometryError, match="bearing"):
        paper_row((0.0, 0.0), PHI, GAIN)


@given(
    camera=cameras,
    left=st.floats(0.1, 1.4),
    right=st.floats(0.1, 1.4),
    angle=headings,
    distance=st.floats(0.1, 3.0),
)
def test_unequal_edges(
    camera: FieldOfView, left: float, right: float, angle: float, distance: float
) -> None:
    x, y, yaw = camera.camera
    edges = (
        Edge.through((x, y), yaw + left, inward=-1.0),
        Edge.through((x, y), yaw - right, inward=+1.0),
    )
    assume(min(abs(angle - left), abs(angle + right)) > 1e-6)
    assume(math.pi - abs(angle) > 1e-6)
    point = ray((x, y), yaw + angle, distance)
    values = half_plane_rows(("l", "r"), edges, (point,), GAIN).values
    assert (min(values) > 0.0) == (-right < angle < left)


@given(point=points, margin=st.floats(0.01, 0.5))
def test_margin_is_a_narrower_camera(point: Point, margin: float) -> None:
    narrower = FieldOfView(AHEAD.half_angle - margin, AHEAD.camera)
    assert edge_rows(point, AHEAD, GAIN, margin) == edge_rows(point, narrower, GAIN)
    scene = scene_of(Pose2(*point, 0.0))
    free, kept = FieldOfViewBarrier(AHEAD, GAIN), FieldOfViewBarrier(AHEAD, GAIN, margin)
    assert kept.clearance(scene) == pytest.approx(free.clearance(scene) - margin, abs=1e-15)
    ahead = point[0] > AHEAD.camera.x
    if ahead:
        assert min(kept.rows(scene).values) < min(free.rows(scene).values)


def scene_of(feature: Pose2) -> Scene:
    return Scene(Pose2(1.0, 0.0, 0.0), feature, 0.0)


@given(camera=cameras, point=points, margin=st.floats(0.0, 0.05))
def test_barrier_of_a_point_is_edge_rows(camera: FieldOfView, point: Point, margin: float) -> None:
    barrier = FieldOfViewBarrier(camera, GAIN, margin)
    assert isinstance(barrier, Barrier)
    scene = scene_of(Pose2(*point, math.nan))
    assert barrier.rows(scene) == edge_rows(point, camera, GAIN, margin)
    behind = abs(camera.bearing(point)) >= 0.5 * math.pi
    expected = -math.inf if behind else camera.margin(point) - margin
    assert barrier.clearance(scene) == pytest.approx(expected, abs=1e-15)


@given(
    x=st.floats(0.7, 3.0),
    y=st.floats(-2.0, 2.0),
    heading=headings,
    width=st.floats(0.01, 0.9),
    margin=st.floats(0.0, 0.1),
)
def test_both_ends_of_a_board_stand_for_all_of_it(
    x: float, y: float, heading: float, width: float, margin: float
) -> None:
    camera = FieldOfView(PHI, AHEAD.camera, width)
    barrier = FieldOfViewBarrier(camera, GAIN, margin)
    scene = scene_of(Pose2(x, y, heading))
    board = [
        (x - k * width * math.sin(heading), y + k * width * math.cos(heading))
        for k in np.linspace(-0.5, 0.5, 41).tolist()
    ]
    bearings = [abs(math.atan2(p[1], p[0] - AHEAD.camera.x)) for p in board]
    clearance = barrier.clearance(scene)
    assert clearance == pytest.approx(PHI - margin - max(bearings), abs=1e-12)
    rows = barrier.rows(scene)
    assert rows.names == (
        "fov.left.left_end",
        "fov.right.left_end",
        "fov.left.right_end",
        "fov.right.right_end",
    )
    if abs(clearance) > 1e-9:
        assert (min(rows.values) > 0.0) == (clearance > 0.0)
    left_end, right_end = board[-1], board[0]
    expected = [
        *edge_rows(left_end, camera, GAIN, margin).coefficients,
        *edge_rows(right_end, camera, GAIN, margin).coefficients,
    ]
    for got, wanted in zip(rows.coefficients, expected, strict=True):
        assert got == pytest.approx(wanted, rel=1e-12, abs=1e-13)


@given(margin=st.floats(1e-6, 0.5))
def test_board_fits_from_half_its_width_over_the_tangent(margin: float) -> None:
    width = 0.5
    barrier = FieldOfViewBarrier(FieldOfView(PHI, width=width), GAIN)
    nearest = 0.5 * width / math.tan(PHI)
    assert barrier.clearance(scene_of(Pose2(nearest + margin, 0.0, 0.0))) > 0.0
    assert barrier.clearance(scene_of(Pose2(nearest - min(margin, 0.3), 0.0, 0.0))) < 0.0


BOX = (((1.0, 0.0), 0.22), ((-1.0, 0.0), 0.22), ((0.0, 1.0), 0.4), ((0.0, -1.0), 0.4))


def worst_admissible(rows: Rows | None, point: Point, side: float) -> Twist:
    """The admissible command that drives the point out fastest, a corner of the admitted set."""
    A = np.array([a for a, _ in BOX])
    b = np.array([limit for _, limit in BOX])
    if rows is not None:
        A, b = np.vstack((A, rows.A)), np.concatenate((b, rows.b))
    i, j = np.triu_indices(len(b), 1)
    determinant = A[i, 0] * A[j, 1] - A[i, 1] * A[j, 0]
    i, j, determinant = (k[np.abs(determinant) > 1e-12] for k in (i, j, determinant))
    corners = (
        np.vstack((b[i] * A[j, 1] - b[j] * A[i, 1], A[i, 0] * b[j] - A[j, 0] * b[i])) / determinant
    )
    corners = corners[:, (A @ corners <= b[:, None] + 1e-12).all(axis=0)]
    # Bearing rate times the squared range, positive to the left.
    outward = side * (corners[0] * point[1] - corners[1] * (point[0] ** 2 + point[1] ** 2))
    v, omega = corners[:, int(np.argmax(outward))]
    return Twist(float(v), float(omega))


@pytest.mark.parametrize("width", [0.0, 0.4])
@pytest.mark.parametrize("camera", [AHEAD, SKEWED])
def test_no_admissible_command_leaves_the_view(camera: FieldOfView, width: float) -> None:
    r"""Forward invariance against an adversary that takes the worst command the rows admit.

    A command held for T loses at most T² M / 2 against the rate at its start, with
    M = omega² rho + omega v the largest second derivative, so h >= -T M / (2 gain).
    """
    period, gain, rng = 5e-3, 4.0, np.random.default_rng(7)
    barrier = FieldOfViewBarrier(FieldOfView(camera.half_angle, camera.camera, width), gain)
    for side in (1.0, -1.0):
        angle, distance = float(rng.uniform(-0.2, 0.2)), float(rng.uniform(1.0, 2.0))
        start = camera.camera.compose(Pose2(*ray((0.0, 0.0), angle, distance), 0.3))
        lowest = {}
        for keep in (True, False):
            feature, values = start, []
            for _ in range(600):
                rows = barrier.rows(scene_of(feature)) if keep else None
                twist = worst_admissible(rows, (feature.x, feature.y), side)
                feature = arc(twist, period).relative(feature)
                values.append(min(barrier.rows(scene_of(feature)).values))
            lowest[keep] = min(values)
        bound = period * (0.4**2 * 3.5 + 0.4 * 0.22) / (2.0 * gain)
        assert lowest[True] >= -bound
        assert lowest[True] <= 1e-3, "the adversary never came near the edge"
        assert lowest[False] < -0.1, "the adversary cannot leave the view even without rows"


@given(rho=st.floats(0.5, 3.0), phi=st.floats(0.05, PHI))
def test_effective_gain_of_the_papers_function(rho: float, phi: float) -> None:
    """Its bound on the outward bearing rate falls with slope gain (PHI² + phi²) / (2 phi²)."""

    def bound(angle: float) -> float:
        ((_, a_w, b),) = paper_row(ray((0.0, 0.0), angle, rho), PHI, GAIN).coefficients
        return b / -a_w  # at v = 0 the outward rate is -omega

    slope = derivative(lambda t: bound(phi + t))
    assert -slope == pytest.approx(GAIN * (PHI**2 + phi**2) / (2.0 * phi**2), rel=1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_points_that_are_not_finite(bad: float) -> None:
    for point in ((bad, 0.1), (1.0, bad)):
        for build in (edge_rows, bearing_rows):
            with pytest.raises(GeometryError, match="finite"):
                build(point, AHEAD, GAIN)
        with pytest.raises(GeometryError, match="finite"):
            paper_row(point, PHI, GAIN)
        barrier = FieldOfViewBarrier(AHEAD, GAIN)
        for method in (barrier.rows, barrier.clearance):
            with pytest.raises(GeometryError, match="finite"):
                method(scene_of(Pose2(*point, 0.0)))
    with pytest.raises(GeometryError, match="velocity"):
        edge_rows((1.0, 0.0), AHEAD, GAIN, 0.0, (bad, 0.0))
    board = FieldOfViewBarrier(FieldOfView(PHI, width=0.5), GAIN)
    with pytest.raises(GeometryError, match="heading"):
        board.rows(scene_of(Pose2(1.0, 0.0, bad)))
    with pytest.raises(GeometryError, match="heading"):
        board.clearance(Scene(Pose2(1.0, 0.0, 0.0), (1.0, 0.0), 0.0))  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_gain_out_of_range(bad: float) -> None:
    for build in (edge_rows, bearing_rows):
        with pytest.raises(ConfigurationError, match="gain"):
            build((1.0, 0.0), AHEAD, bad)
    with pytest.raises(ConfigurationError, match="gain"):
        paper_row((1.0, 0.0), PHI, bad)
    with pytest.raises(ConfigurationError, match="gain"):
        FieldOfViewBarrier(AHEAD, bad)


@pytest.mark.parametrize("bad", [-0.01, PHI, 2.0, math.nan])
def test_margin_out_of_range(bad: float) -> None:
    for build in (edge_rows, bearing_rows):
        with pytest.raises(ConfigurationError, match=r"margin must be in \[0, half_angle\)"):
            build((1.0, 0.0), AHEAD, GAIN, bad)
    with pytest.raises(ConfigurationError, match="margin"):
        FieldOfViewBarrier(AHEAD, GAIN, bad)
    with pytest.raises(ConfigurationError, match="margin"):
        AHEAD.eroded(bad)


@pytest.mark.parametrize("bad", [0.0, -0.1, math.pi, 4.0, math.nan])
def test_half_angle_out_of_range(bad: float) -> None:
    with pytest.raises(ConfigurationError, match="half_angle"):
        paper_row((1.0, 0.0), bad, GAIN)


def test_cameras_have_names_of_their_own() -> None:
    rear = FieldOfViewBarrier(FieldOfView(PHI, Pose2(-0.2, 0.0, math.pi)), GAIN, name="rear")
    assert rear.rows(scene_of(Pose2(-2.0, 0.1, math.pi))).names == ("rear.left", "rear.right")
    assert rear.clearance(scene_of(Pose2(-2.0, 0.0, math.pi))) == pytest.approx(PHI)


@given(
    camera=cameras,
    point=points,
    motion=st.builds(Pose2, st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)),
    turn=st.floats(0.0, 0.6),
    travel=st.floats(0.0, 0.4),
    blur=st.floats(0.0, 0.05),
    width=st.sampled_from([0.0, 0.4]),
    data=st.data(),
)
def test_clearance_around_bounds_every_motion_near(
    camera, point, motion, turn, travel, blur, width, data
) -> None:
    """The lower bound holds at poses drawn from all that is near, blurred or not."""
    seeing = FieldOfView(camera.half_angle, camera.camera, width)
    barrier = FieldOfViewBarrier(seeing, GAIN, 0.02)
    scene = scene_of(Pose2(*point, 0.3))
    clearance, least = barrier.clearance_around(
        scene, Sweep(motion, turn=turn, travel=travel, blur=blur)
    )
    assert clearance == pytest.approx(barrier.clearance(scene, motion), abs=1e-12)
    assert least <= clearance + 1e-12
    shares = st.floats(-1.0, 1.0)
    for _ in range(5):
        direction = math.pi * data.draw(shares)
        way = travel * abs(data.draw(shares))
        near = motion.compose(
            Pose2(way * math.cos(direction), way * math.sin(direction), turn * data.draw(shares))
        )
        blurred = FieldOfViewBarrier(seeing, GAIN, 0.02, setback=blur * abs(data.draw(shares)))
        assert blurred.clearance(scene, near) >= least - 1e-9


@given(
    camera=cameras,
    point=points,
    motion=st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1, 1)),
    body=twists,
    twist=twists,
    lag=st.floats(0.0, 0.3),
    duration=st.floats(0.0, 0.6),
    width=st.sampled_from([0.0, 0.4]),
)
def test_clearance_along_is_the_smallest_at_the_corners(
    camera, point, motion, body, twist, lag, duration, width
) -> None:
    """Unless it refuses, which it does where the corners need not stand for all of the sweep."""
    barrier = FieldOfViewBarrier(FieldOfView(camera.half_angle, camera.camera, width), GAIN, 0.02)
    scene = scene_of(Pose2(*point, 0.3))
    sharp = Sweep.of(motion, body, lag, twist, duration)._replace(blur=0.0)
    along = barrier.clearance_along(scene, sharp)
    corners = [barrier.clearance(scene, corner) for corner in sharp.corners()]
    assert along == -math.inf or along == pytest.approx(min(corners), abs=1e-12)
    blurred = barrier.clearance_along(scene, sharp._replace(blur=0.03))
    inward = FieldOfViewBarrier(barrier.camera, GAIN, 0.02, setback=0.03)
    assert blurred == pytest.approx(inward.clearance_along(scene, sharp), abs=1e-12)


@given(
    camera=cameras,
    point=points,
    motion=st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1, 1)),
    body=twists,
    twist=twists,
    lag=st.sampled_from([0.0, 0.12, 0.3]),
    duration=st.floats(0.0, 0.9),
    blur=st.sampled_from([0.0, 0.03]),
    width=st.sampled_from([0.0, 0.4]),
    forward=st.booleans(),
)
def test_clearance_along_refuses_only_what_its_corners_need_not_tell(
    camera, point, motion, body, twist, lag, duration, blur, width, forward
) -> None:
    """Ahead of rotation centre and camera at every corner, and turned by less than the view."""
    if forward:  # most cameras look ahead
        camera = FieldOfView(
            camera.half_angle, Pose2(camera.camera.x, camera.camera.y, 0.1 * camera.camera.theta)
        )
        point = (abs(point[0]), 0.4 * point[1])
    seeing = FieldOfView(camera.half_angle, camera.camera, width)
    barrier = FieldOfViewBarrier(seeing, GAIN, 0.02)
    eroded = FieldOfViewBarrier(seeing, GAIN, 0.02, setback=blur)
    scene = scene_of(Pose2(*point, 0.3))
    sweep = Sweep.of(motion, body, lag, twist, duration)._replace(blur=blur)
    turns = (body.omega * lag, twist.omega * duration, body.omega * lag + twist.omega * duration)
    room = camera.half_angle - 0.02 - abs(camera.camera.theta)
    ends = [point]
    if width:
        dx, dy = -0.5 * width * math.sin(0.3), 0.5 * width * math.cos(0.3)
        ends = [(point[0] + s * dx, point[1] + s * dy) for s in (1.0, -1.0)]
    coasted = motion.compose(arc(body, lag))
    corners = [motion, coasted, *(pose.compose(arc(twist, duration)) for pose in (motion, coasted))]
    margin = min(
        room - max(map(abs, turns)),
        *(pose.seen(end)[0] for pose in corners for end in ends),
        *(eroded.kept.camera.seen(pose.seen(end))[0] for pose in corners for end in ends),
    )
    assume(abs(margin) > 1e-9)
    along = barrier.clearance_along(scene, sweep)
    assert (along == -math.inf) == (margin < 0.0)
    if margin > 0.0:
        expected = min(eroded.clearance(scene, pose) for pose in corners)
        assert along == pytest.approx(expected, abs=1e-9)


def test_clearance_along_at_the_ends_of_what_it_answers() -> None:
    """Turned by all of the view, it answers; abreast of the camera or of the axle it refuses."""
    rest, half = Twist(0.0, 0.0), 0.5
    barrier = FieldOfViewBarrier(FieldOfView(half), GAIN)
    scene = scene_of(Pose2(4.0, 0.0, 0.0))
    for rate in (half, -half):
        turned = Sweep.of(HERE, rest, 0.0, Twist(0.0, rate), 1.0)
        assert barrier.clearance_along(scene, turned) == pytest.approx(0.0, abs=1e-15)
        coasted = Sweep.of(HERE, Twist(0.0, rate), 1.0, rest, 0.0)
        assert barrier.clearance_along(scene, coasted) == pytest.approx(0.0, abs=1e-15)
        both = Sweep.of(HERE, Twist(0.0, 0.5 * rate), 1.0, Twist(0.0, 0.5 * rate), 1.0)
        assert barrier.clearance_along(scene, both) == pytest.approx(0.0, abs=1e-15)
        there_and_back = Sweep.of(HERE, Twist(0.0, rate), 1.0, Twist(0.0, -rate), 1.0)
        assert barrier.clearance_along(scene, there_and_back) == pytest.approx(0.0, abs=1e-15)
        for coast, brake in ((0.6, -0.3), (-0.3, 0.6), (0.3, 0.3)):  # each too far by itself
            turns = Twist(0.0, 2.0 * rate * coast), Twist(0.0, 2.0 * rate * brake)
            beyond = Sweep.of(HERE, turns[0], 1.0, turns[1], 1.0)
            assert barrier.clearance_along(scene, beyond) == -math.inf
    still = Sweep.of(HERE, rest, 0.0, rest, 0.0)
    behind_axle = FieldOfViewBarrier(FieldOfView(half, Pose2(-0.5, 0.0, 0.0)), GAIN)
    before_axle = FieldOfViewBarrier(FieldOfView(half, Pose2(0.5, 0.0, 0.0)), GAIN)
    assert behind_axle.clearance_along(scene_of(Pose2(0.0, 0.0, 0.0)), still) == -math.inf
    assert before_axle.clearance_along(scene_of(Pose2(0.5, 0.0, 0.0)), still) == -math.inf
    away = Sweep.of(HERE, rest, 0.0, Twist(-1.0, 0.0), 0.5)
    assert behind_axle.clearance_along(scene_of(Pose2(0.0, 0.0, 0.0)), away) == -math.inf
    assert behind_axle.clearance_along(scene_of(Pose2(1e-9, 0.0, 0.0)), away) == half
    onto = Sweep.of(HERE, rest, 0.0, Twist(1.0, 0.0), 1.0)
    assert behind_axle.clearance_along(scene_of(Pose2(1.0, 0.0, 0.0)), onto) == -math.inf
    # Abreast of the camera at one end only, well ahead of the axle and on neither at the other.
    for v, x in ((-0.5, 0.5), (0.5, 1.0)):
        past = Sweep.of(HERE, rest, 0.0, Twist(v, 0.0), 1.0)
        assert before_axle.clearance_along(scene_of(Pose2(x, 0.25, 0.0)), past) == -math.inf


@given(
    camera=cameras,
    point=points,
    motion=st.builds(Pose2, st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)),
    turn=st.floats(0.0, 0.6),
    travel=st.floats(0.0, 0.4),
    blur=st.floats(0.0, 0.05),
    width=st.sampled_from([0.0, 0.4]),
)
def test_clearance_around_is_as_low_as_it_says_and_no_lower(
    camera, point, motion, turn, travel, blur, width
) -> None:
    """The bearing, what is turned, and pi/3 of the way over the distance, up to half of that."""
    barrier = FieldOfViewBarrier(FieldOfView(camera.half_angle, camera.camera, width), GAIN, 0.02)
    heading = 0.3
    scene = scene_of(Pose2(*point, heading))
    half_angle = camera.half_angle - 0.02
    moved = travel + math.dist(camera.camera[:2], (0.0, 0.0)) * turn + blur / math.sin(half_angle)
    ends = [
        (point[0] - s * width * math.sin(heading), point[1] + s * width * math.cos(heading))
        for s in (-0.5, 0.5)
    ]
    reached = 0.0
    for end in ends:
        x, y = camera.camera.seen(motion.seen(end))
        distance, bearing = math.hypot(x, y), abs(math.atan2(y, x))
        assume(abs(moved - 0.5 * distance) > 1e-9)
        shift = math.pi / 3 * moved / distance if moved < 0.5 * distance else math.inf
        reached = max(reached, bearing + turn + shift)
    assume(abs(reached - 0.5 * math.pi) > 1e-9)
    expected = half_angle - reached if reached < 0.5 * math.pi else -math.inf
    _, least = barrier.clearance_around(scene, Sweep(motion, turn=turn, travel=travel, blur=blur))
    assert least == pytest.approx(expected, abs=1e-9)


def test_clearance_around_at_its_ends() -> None:
    barrier = FieldOfViewBarrier(FieldOfView(0.7), GAIN)
    scene = scene_of(Pose2(2.0, 0.0, 0.0))
    half_the_way = barrier.clearance_around(scene, Sweep(travel=1.0))
    assert half_the_way == pytest.approx((0.7, 0.7 - math.pi / 6.0))
    abreast = barrier.clearance_around(scene_of(Pose2(0.0, 2.0, 0.0)), Sweep())
    assert abreast == (-math.inf, -math.inf)
    at_the_camera = scene_of(Pose2(0.0, 0.0, 0.0))
    assert barrier.clearance_around(at_the_camera, Sweep()) == (0.7, 0.7)
    assert barrier.clearance_around(at_the_camera, Sweep(travel=1e-9)) == (0.7, -math.inf)
    for bad in (math.nan, math.inf):
        assert barrier.clearance_around(scene, Sweep(travel=bad))[1] == -math.inf
    assert barrier.clearance_around(scene, Sweep(turn=0.5 * math.pi))[1] == -math.inf


@given(
    camera=cameras,
    point=points,
    motion=st.builds(Pose2, *[st.floats(-1.0, 1.0)] * 3),
    width=st.sampled_from([0.0, 0.4]),
)
def test_rows_after_a_motion_are_those_of_the_scene_seen_from_there(
    camera: FieldOfView, point: Point, motion: Pose2, width: float
) -> None:
    barrier = FieldOfViewBarrier(FieldOfView(camera.half_angle, camera.camera, width), GAIN)
    feature = Pose2(*point, 0.3)
    moved = barrier.rows(scene_of(feature), motion)
    seen_there = barrier.rows(scene_of(motion.relative(feature)))
    assert moved.names == seen_there.names
    for got, wanted in zip(moved.coefficients, seen_there.coefficients, strict=True):
        assert got == pytest.approx(wanted, abs=1e-12)
    assert moved.values == pytest.approx(seen_there.values, abs=1e-12)


def test_the_view_itself_has_neither_margin_nor_setback() -> None:
    barrier = FieldOfViewBarrier(SKEWED, GAIN, 0.1, "side", 0.05)
    assert barrier.bare == FieldOfViewBarrier(SKEWED, GAIN, name="side")
    assert barrier.edges == camera_edges(SKEWED.eroded(0.1, 0.05))
    assert barrier.bare.edges == camera_edges(SKEWED)
    assert barrier.kept == SKEWED.eroded(0.1, 0.05)


@given(
    motion=st.builds(Pose2, *[st.floats(-1.0, 1.0)] * 3),
    body=twists,
    twist=twists,
    lag=st.sampled_from([0.0, 0.25]),
    duration=st.floats(0.0, 1.0),
)
def test_a_sweep_knows_how_far_it_reaches(
    motion: Pose2, body: Twist, twist: Twist, lag: float, duration: float
) -> None:
    """Turn, travel and blur are bounds of what is drawn from it; its corners are arcs."""
    sweep = Sweep.of(motion, body, lag, twist, duration)
    assert sweep[:5] == (motion, body, lag, twist, duration)
    assert sweep.turn == pytest.approx(abs(body.omega * lag) + abs(twist.omega * duration))
    assert sweep.travel == pytest.approx(abs(body.v * lag) + abs(twist.v * duration))
    area = abs(body.v * twist.omega - twist.v * body.omega) * lag * duration
    assert sweep.blur == pytest.approx(area, abs=1e-15)
    coasted, braked = motion.compose(arc(body, lag)), motion.compose(arc(twist, duration))
    expected = (motion, coasted, braked, coasted.compose(arc(twist, duration)))
    corners = sweep.corners()
    assert len(corners) == (4 if lag else 2)
    for got, wanted in zip(corners, expected if lag else (motion, braked), strict=True):
        assert got == pytest.approx(wanted, abs=1e-12)


def test_a_sweep_of_nothing() -> None:
    rest = Twist(0.0, 0.0)
    assert Sweep() == Sweep.of(Pose2(0.0, 0.0, 0.0), rest, 0.0, rest, 0.0)
    assert isinstance(Sweep.of(HERE, rest, 0.0, rest, 0.0), Sweep)


@pytest.mark.parametrize("tiny", [5e-324, 4.4e-323, -9.9e-324, 1e-310])
def test_the_smallest_turn_rates_there_are_bend_no_arc(tiny: float) -> None:
    """Numbers with few bits left: a product with one is nearly all rounding."""
    barrier, scene = FieldOfViewBarrier(FieldOfView(0.6), 1.0), scene_of(Pose2(1.5, 0.9, 0.0))
    for v in (0.1, 0.2, 0.3):
        bent, straight = (
            Sweep.of(HERE, Twist(v, omega), 0.2, Twist(0.9 * v, omega), 0.9)
            for omega in (tiny, 0.0)
        )
        assert barrier.clearance_along(scene, bent) == barrier.clearance_along(scene, straight)
        assert arc(bent.twist, 0.9) == pytest.approx(arc(straight.twist, 0.9), rel=1e-15)


def test_clearance_along_refuses_what_its_corners_do_not_tell() -> None:
    """Turning out of the view and back, or passing the feature, has good corners all the same."""
    barrier = FieldOfViewBarrier(FieldOfView(math.radians(35)), GAIN)
    scene = scene_of(Pose2(1.0, 0.0, 0.0))
    rest = Twist(0.0, 0.0)
    full_turn = Sweep.of(HERE, rest, 0.0, Twist(0.0, 1.0), 2.0 * math.pi)
    assert min(barrier.clearance(scene, corner) for corner in full_turn.corners()) > 0.6
    assert barrier.clearance_along(scene, full_turn) == -math.inf
    passing = Sweep.of(HERE, rest, 0.0, Twist(1.0, 0.0), 1.0 + 1e-9)
    assert barrier.clearance_along(scene, passing) == -math.inf
