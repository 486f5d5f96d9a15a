"""The board's pose out of depth columns: exact without noise, honest with it, never a raise."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import least_squares
from scipy.stats import chi2

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.estimation import is_covariance
from clfcbf.perception import (
    BoardDetector,
    BoardPose,
    DepthColumns,
    DepthNoise,
    DepthSpan,
    Edge,
    End,
    Extent,
    Line,
    LineFit,
    NotSeen,
    Reason,
    column_tangents,
    fit_line,
    observation_of,
)
from clfcbf.perception.centre import centre_of
from clfcbf.perception.observation import covariance_of_goal
from clfcbf.perception.segmentation import drop_outliers, runs
from clfcbf.se2 import Pose2, wrap_angle
from clfcbf.simulation.depth import DepthCamera, DepthModel

HALF_ANGLE = math.radians(35.0)
WIDTH = 0.5
TANGENTS = column_tangents(HALF_ANGLE, 240)
LEVEL_A = DepthModel.named("A")
NOISE = LEVEL_A.noise
DETECTOR = BoardDetector(WIDTH)
EXACT = BoardDetector(WIDTH, noise=DepthNoise.none())

yaws = st.floats(-0.9, 0.9)


@st.composite
def boards(draw, near=0.55, far=2.2, beyond=1.15):
    """A board in the camera's frame, its centre up to a little outside the view."""
    distance = draw(st.floats(near, far))
    bearing = draw(st.floats(-beyond, beyond)) * HALF_ANGLE
    return Pose2(distance * math.cos(bearing), distance * math.sin(bearing), draw(yaws))


def ends_of(board, width=WIDTH):
    """Right and left end, (2, 2)."""
    t = np.array([-math.sin(board.theta), math.cos(board.theta)])
    return np.array([board[:2] - 0.5 * width * t, board[:2] + 0.5 * width * t])


def look(board, model=LEVEL_A, seed=0, width=WIDTH):
    camera = DepthCamera(model, HALF_ANGLE, width)
    return camera.columns(board, camera.draw(np.random.default_rng(seed)))


IDEAL = replace(DepthModel.named("ideal"), span=DepthSpan(0.05, 20.0))
WIDE = BoardDetector(WIDTH, noise=DepthNoise.none(), span=IDEAL.span)


def from_depths(depths):
    return DepthColumns(np.arctan(TANGENTS), depths * np.sqrt(1.0 + TANGENTS**2))


# --- the line -----------------------------------------------------------------------------------


@given(boards(), st.floats(-1.0, 1.0))
def test_inverse_depth_of_a_line_is_linear_in_the_image(board, along):
    n = np.array([math.cos(board.theta), math.sin(board.theta)])
    c = float(n @ board[:2])
    assume(c > 0.05)
    line = Line(n[0] / c, n[1] / c)
    x = board.x - along * math.sin(board.theta)
    y = board.y + along * math.cos(board.theta)
    assume(x > 0.05)
    assert 1.0 / x == pytest.approx(line.a + line.b * y / x, rel=1e-9)
    assert tuple(line.at(y / x)) == pytest.approx((x, y), rel=1e-9, abs=1e-9)
    assert line.theta == pytest.approx(board.theta, abs=1e-12)
    assert line.distance == pytest.approx(c, rel=1e-12)


def noisy_line(rng, theta=0.4, distance=1.2, noise=NOISE, tangents=TANGENTS[90:160]):
    line = Line(math.cos(theta) / distance, math.sin(theta) / distance)
    depths = line.depths(tangents)
    common = noise.common * rng.standard_normal()
    return line, tangents, depths + noise.white(depths) * rng.standard_normal(len(depths)) + common


@pytest.mark.parametrize("seed", range(5))
def test_fit_is_the_maximum_of_the_likelihood_of_depths(seed):
    line, tangents, depths = noisy_line(np.random.default_rng(seed))
    fit = fit_line(tangents, depths, NOISE)
    kept = fit.inliers
    sigma = NOISE.sigma(fit.line.depths(tangents))[kept]

    def residuals(p):
        theta, c = p
        z = c / (math.cos(theta) + tangents[kept] * math.sin(theta))
        return (depths[kept] - z) / sigma

    best = least_squares(residuals, (line.theta, line.distance), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert (fit.line.theta, fit.line.distance) == pytest.approx(tuple(best.x), abs=2e-6)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(residuals(best.x) ** 2)), rel=1e-4)


@settings(max_examples=50)
@given(boards(0.7, 2.0, 0.5))
def test_fit_without_noise_is_the_total_least_squares_line(board):
    columns = look(board, replace(IDEAL, behind=None))
    depths = columns.depths(IDEAL.span)
    seen = np.isfinite(depths)
    points = np.column_stack((depths[seen], depths[seen] * TANGENTS[seen]))
    normal = np.linalg.svd(points - points.mean(axis=0))[2][1]
    normal *= np.sign(normal @ points[0])
    fit = fit_line(TANGENTS[seen], depths[seen], DepthNoise.none())
    expected = (math.atan2(normal[1], normal[0]), float(normal @ points.mean(axis=0)))
    assert (fit.line.theta, fit.line.distance) == pytest.approx(expected, abs=1e-8)
    assert fit.inliers.all()


def test_covariance_of_the_line_is_that_of_many_fits():
    rng = np.random.default_rng(1)
    count = 1500
    found = np.empty((count, 2))
    for k in range(count):
        line, tangents, depths = noisy_line(rng)
        found[k] = fit_line(tangents, depths, NOISE).line
    expected = fit_line(TANGENTS[90:160], line.depths(TANGENTS[90:160]), NOISE).covariance
    sample = np.cov(found.T)
    whitened = np.linalg.solve(np.linalg.cholesky(expected), (found - line).T)
    assert np.cov(whitened) == pytest.approx(np.eye(2), abs=0.1)
    assert np.diag(sample) == pytest.approx(np.diag(expected), rel=0.1)
    assert np.abs(found.mean(axis=0) - line) == pytest.approx(
        0.0, abs=5.0 * math.sqrt(expected.max() / count)
    )


@settings(max_examples=50)
@given(st.sets(st.integers(0, 69), max_size=20), st.integers(0, 5), st.booleans())
def test_gross_outliers_do_not_change_the_fit(wrong, seed, side):
    # No true column near the limit of 3.5 sigma, where one outlier more or less decides.
    line, tangents, depths = noisy_line(np.random.default_rng(seed), noise=DepthNoise(common=0.0))
    exact = line.depths(tangents)
    depths = exact + np.clip(depths - exact, -2.5 * NOISE.white(exact), 2.5 * NOISE.white(exact))
    wrong = sorted(wrong)
    spoilt = depths.copy()
    spoilt[wrong] += 0.6 if side else -0.6
    spoilt[wrong] += np.linspace(0.0, 0.3, len(wrong))
    others = np.setdiff1d(np.arange(70), wrong)
    clean = fit_line(tangents[others], depths[others], NOISE)
    fit = fit_line(tangents, spoilt, NOISE)
    assert not fit.inliers[wrong].any()
    assert tuple(fit.line) == pytest.approx(tuple(clean.line), abs=1e-7)


# --- segmentation -------------------------------------------------------------------------------


@settings(max_examples=50)
@given(boards(0.6, 1.9, 0.6), st.integers(0, 1000))
def test_board_and_wall_are_parted_at_the_board_s_ends(board, seed):
    assume(abs(board.theta) < 0.6)
    model = replace(LEVEL_A, outliers=0.0, behind=0.6, span=DepthSpan(0.05, 6.0))
    depths = look(board, model, seed).depths(model.span)
    right, left = ends_of(board)
    own = (right[1] / right[0] < TANGENTS) & (left[1] / left[0] > TANGENTS)
    assume(own.sum() > 6)
    assert np.isfinite(drop_outliers(depths, NOISE)).sum() >= 238
    for run in runs(drop_outliers(depths, NOISE), NOISE):
        assert own[run].all() or not own[run].any()


@settings(max_examples=50)
@given(st.sets(st.integers(2, 77), max_size=16), st.integers(0, 1000))
def test_outliers_apart_are_dropped_and_nothing_else(places, seed):
    odd = np.array(sorted(3 * place for place in places), dtype=int)
    rng = np.random.default_rng(seed)
    line = Line(0.6, 0.2)
    depths = line.depths(TANGENTS)
    depths += np.clip(rng.standard_normal(240), -3.0, 3.0) * NOISE.white(depths)
    spoilt = depths.copy()
    spoilt[odd] += rng.choice((-0.5, 0.7), len(odd))
    clean = drop_outliers(spoilt, NOISE)
    assert np.array_equal(np.flatnonzero(np.isnan(clean)), odd)
    assert len(runs(clean, NOISE)) == 1


def test_columns_alone_are_dropped_and_gaps_end_a_run():
    depths = np.full(240, np.nan)
    depths[[10, 50, 51]] = 1.0
    assert np.isnan(drop_outliers(depths, NOISE)).all()
    depths[100:110] = depths[113:120] = depths[124:130] = 1.0
    found = runs(drop_outliers(depths, NOISE), NOISE)
    assert [(run[0], run[-1]) for run in found] == [(100, 119), (124, 129)]
    assert runs(np.full(240, np.nan), NOISE) == []


# --- ends ---------------------------------------------------------------------------------------


@given(boards())
def test_exact_depths_give_the_pose_to_within_a_column(board):
    right, left = ends_of(board)
    assume(min(right[0], left[0]) > 0.1)
    tan_right, tan_left = right[1] / right[0], left[1] / left[0]
    edge = math.tan(HALF_ANGLE)
    assume(tan_right < tan_left)
    share = (min(tan_left, edge) - max(tan_right, -edge)) / (tan_left - tan_right)
    found = WIDE.detect(look(board, IDEAL))
    if share < 0.3:
        return
    n = np.array([math.cos(board.theta), math.sin(board.theta)])
    if (tan_left - tan_right) / (TANGENTS[1] - TANGENTS[0]) < 40.0:
        return
    assert isinstance(found, BoardPose)
    assert found.pose.theta == pytest.approx(board.theta, abs=1e-6)
    error = np.array([found.pose.x - board.x, found.pose.y - board.y])
    assert n @ error == pytest.approx(0.0, abs=1e-6)
    # Half a column at the farther free end, as long as it is on the tilted board.
    for free, place in ((found.extent.right, right), (found.extent.left, left)):
        if free.end is End.FREE:
            assert free.tangent == pytest.approx(place[1] / place[0], abs=0.5 * free.spacing + 1e-9)
    reach = [
        0.55 * free.spacing * p[0] ** 2 / float(n @ board[:2])
        for free, p in ((found.extent.right, right), (found.extent.left, left))
        if free.end is End.FREE
    ]
    if reach:
        assert np.linalg.norm(error) <= max(reach)


@pytest.mark.parametrize(
    ("lateral", "right", "left"),
    [(0.0, End.FREE, End.FREE), (0.65, End.FREE, End.CLIPPED), (-0.65, End.CLIPPED, End.FREE)],
)
@pytest.mark.parametrize("behind", [None, 1.0])
def test_end_at_the_view_s_edge_is_clipped(lateral, right, left, behind):
    found = DETECTOR.detect(look(Pose2(1.1, lateral, 0.1), replace(LEVEL_A, behind=behind)))
    assert (found.extent.right.end, found.extent.left.end) == (right, left)


def test_end_beside_something_nearer_is_occluded_and_not_used():
    board = Pose2(1.2, 0.0, 0.2)
    depths = look(board, replace(LEVEL_A, outliers=0.0)).depths(LEVEL_A.span)
    depths[(TANGENTS > 0.05) & (TANGENTS < 0.3)] = 0.8
    found = DETECTOR.detect(from_depths(depths))
    assert (found.extent.right.end, found.extent.left.end) == (End.FREE, End.OCCLUDED)
    assert found.pose == pytest.approx(board, abs=0.02)
    depths[TANGENTS < -0.1] = np.nan
    depths[(TANGENTS < -0.3) & (TANGENTS > -0.5)] = 0.7  # behind columns that see nothing
    found = DETECTOR.detect(from_depths(depths))
    assert found == NotSeen(Reason.HIDDEN, found.columns)


def test_end_where_depths_are_out_of_range_is_clipped():
    board = Pose2(0.36, 0.0, 0.9)  # the right end is 0.16 m from the camera
    found = DETECTOR.detect(look(board))
    assert {found.extent.right.end, found.extent.left.end} == {End.CLIPPED, End.FREE}
    assert found.pose == pytest.approx(board, abs=0.02)


def test_both_ends_clipped_gives_range_and_yaw_and_says_so():
    board = Pose2(0.3, 0.01, 0.05)
    found = DETECTOR.detect(look(board))
    assert found.extent.free() == 0
    t = np.array([-math.sin(board.theta), math.cos(board.theta)])
    n = np.array([math.cos(board.theta), math.sin(board.theta)])
    across = math.sqrt(t @ found.covariance[:2, :2] @ t)
    hidden = WIDTH - found.visible
    assert across == pytest.approx(hidden / math.sqrt(12.0), rel=0.05)
    error = np.array(found.pose[:2]) - board[:2]
    assert abs(t @ error) <= 0.5 * hidden + 0.005
    assert abs(n @ error) < 0.01
    assert found.pose.theta == pytest.approx(board.theta, abs=0.02)


@pytest.mark.parametrize("beyond", [3, 4])
def test_outlier_on_the_line_past_the_end_does_not_move_it(beyond):
    board = Pose2(1.2, 0.1, 0.3)
    depths = look(board, replace(LEVEL_A, outliers=0.0)).depths(LEVEL_A.span)
    plain = DETECTOR.detect(from_depths(depths))
    last = int(plain.columns[-1])
    depths[last + beyond] = plain.fit.line.depths(TANGENTS)[last + beyond]
    moved = DETECTOR.detect(from_depths(depths)).extent
    assert moved.right == plain.extent.right
    assert moved.left.tangent == pytest.approx(plain.extent.left.tangent, abs=0.003)
    end = ends_of(board)[1]
    assert abs(end[1] / end[0] - moved.left.tangent) <= 0.5 * moved.left.spacing


def test_outlier_beside_the_end_widens_the_edge():
    board = Pose2(1.2, 0.1, 0.3)
    depths = look(board, replace(LEVEL_A, outliers=0.0)).depths(LEVEL_A.span)
    plain = DETECTOR.detect(from_depths(depths)).extent.left
    last = int(np.searchsorted(TANGENTS, plain.tangent)) - 1
    depths[last] = 0.5
    wide = DETECTOR.detect(from_depths(depths)).extent.left
    assert wide.spacing == pytest.approx(2.0 * plain.spacing)
    assert abs(wide.tangent - TANGENTS[last]) < 1e-12


# --- pose and covariance ------------------------------------------------------------------------


def geometric_centre(theta, c, tangents, sides, width):
    """Mean over the ends of the point on the ray, moved along the board; angles only."""
    centres = []
    for tangent, side in zip(tangents, sides, strict=True):
        beta = math.atan(tangent)
        r = c / math.cos(beta - theta)
        x, y = r * math.cos(beta), r * math.sin(beta)
        turn = theta + math.pi / 2.0
        centres.append(
            (x - side * width / 2 * math.cos(turn), y - side * width / 2 * math.sin(turn))
        )
    return np.mean(centres, axis=0)


@given(
    st.floats(-0.7, 0.7),
    st.floats(0.5, 2.0),
    st.sampled_from([(End.FREE, End.FREE), (End.FREE, End.CLIPPED), (End.OCCLUDED, End.FREE)]),
)
def test_covariance_of_the_centre_is_that_of_a_linear_map(theta, c, ends):
    line = Line(math.cos(theta) / c, math.sin(theta) / c)
    edges = (Edge(-0.25, 0.006, ends[0]), Edge(0.2, 0.009, ends[1]))
    root = np.array([[0.004, 0.0], [0.002, 0.01]])
    fit = LineFit(line, root @ root.T, np.ones(3, bool), 1.0)
    pose, covariance = centre_of(fit, Extent(*edges), WIDTH)
    used = [(e, s) for e, s in zip(edges, (-1, 1), strict=True) if e.end is End.FREE]
    sides = [s for _, s in used]

    def pose_of(p):
        theta, c = math.atan2(p[1], p[0]), 1.0 / math.hypot(p[0], p[1])
        return np.append(geometric_centre(theta, c, p[2:], sides, WIDTH), theta)

    nominal = np.array([*line, *(e.tangent for e, _ in used)])
    assert tuple(pose) == pytest.approx(tuple(pose_of(nominal)), abs=1e-12)
    h = 1e-6
    steps = h * np.eye(len(nominal))
    slope = np.column_stack(
        [(pose_of(nominal + s) - pose_of(nominal - s)) / (2.0 * h) for s in steps]
    )
    inner = np.zeros((len(nominal),) * 2)
    inner[:2, :2] = fit.covariance
    inner[2:, 2:] = np.diag([e.spacing**2 / 12.0 for e, _ in used])
    assert covariance == pytest.approx(slope @ inner @ slope.T, rel=1e-5, abs=1e-10)
    assert np.array_equal(covariance, covariance.T)


@pytest.mark.parametrize(("outliers", "behind"), [(0.0, None), (LEVEL_A.outliers, 0.4)])
def test_covariance_is_honest(outliers, behind):
    """Normalised estimation error squared over random poses, by its chi-squared distribution."""
    model = replace(LEVEL_A, outliers=outliers, behind=behind)
    camera = DepthCamera(model, HALF_ANGLE, WIDTH)
    rng = np.random.default_rng(7)
    whole, parts, lost = [], [], 0
    for _ in range(500):
        distance, bearing = rng.uniform(0.5, 2.3), rng.uniform(-1.0, 1.0) * HALF_ANGLE
        board = Pose2(
            distance * math.cos(bearing), distance * math.sin(bearing), rng.uniform(-0.7, 0.7)
        )
        found = DETECTOR.detect(camera.columns(board, camera.draw(rng)))
        if isinstance(found, NotSeen):
            lost += 1
            continue
        error = np.array(found.pose) - board
        whole.append(error @ np.linalg.solve(found.covariance, error))
        parts.append(error**2 / np.diag(found.covariance))
    n = len(whole)
    assert lost <= 10
    low, high = chi2.ppf((1e-3, 1.0 - 1e-3), 3 * n) / n
    assert low < np.mean(whole) < high
    # Each axis alone; the columns' spacing is uniform, whose fourth moment is below the normal's.
    low, high = chi2.ppf((1e-3, 1.0 - 1e-3), n) / n
    assert np.all((low < np.mean(parts, axis=0)) & (np.mean(parts, axis=0) < high))


@settings(max_examples=50)
@given(boards(), st.builds(Pose2, st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3)))
def test_mount_moves_the_pose_and_turns_its_covariance(board, mount):
    columns = look(board)
    plain = DETECTOR.detect(columns)
    moved = replace(DETECTOR, camera=mount).detect(columns)
    if isinstance(plain, NotSeen):
        assert moved == plain
        return
    assert moved.pose == pytest.approx(mount.compose(plain.pose), abs=1e-12)
    c, s = math.cos(mount.theta), math.sin(mount.theta)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert moved.covariance == pytest.approx(turn @ plain.covariance @ turn.T, abs=1e-12)


@settings(max_examples=50)
@given(boards(), st.integers(0, 1000))
def test_mirrored_view_gives_the_mirrored_pose(board, seed):
    """Within its own standard deviation: of two sets of columns that agree about equally well
    rounding decides, and it is not mirrored."""
    columns = look(board, seed=seed)
    plain = DETECTOR.detect(columns)
    mirrored = DETECTOR.detect(DepthColumns(columns.bearings, columns.ranges[::-1].copy()))
    if isinstance(plain, NotSeen):
        assert mirrored == plain
        return
    x, y, theta = plain.pose
    off = np.abs(np.subtract(mirrored.pose, (x, -y, -theta)))
    assert np.all(off <= np.sqrt(np.diag(plain.covariance)))


@settings(max_examples=50)
@given(boards(0.6, 2.0, 0.8), st.floats(0.0, 1.0), st.floats(0.0, 1e4))
def test_observation_is_goal_and_feature_with_the_covariance_carried_over(board, standoff, stamp):
    found = DETECTOR.detect(look(board))
    assume(isinstance(found, BoardPose))
    seen = observation_of(found, standoff, stamp)
    assert seen.stamp == stamp
    assert seen.feature == found.pose
    assert seen.goal.compose(Pose2(standoff, 0.0, 0.0)) == pytest.approx(found.pose, abs=1e-12)
    assert is_covariance(seen.covariance)

    def goal(p):
        return np.array(Pose2(*p).compose(Pose2(-standoff, 0.0, 0.0)))

    steps = 1e-6 * np.eye(3)
    slope = np.column_stack([(goal(found.pose + s) - goal(found.pose - s)) / 2e-6 for s in steps])
    expected = slope @ found.covariance @ slope.T
    assert np.array(seen.covariance) == pytest.approx(expected, rel=1e-6, abs=1e-10)
    same = covariance_of_goal(found.pose, found.covariance, 0.0)
    assert np.array(same) == pytest.approx(found.covariance, abs=1e-15)


# --- refusals -----------------------------------------------------------------------------------


def test_each_reason_has_its_scene():
    nothing = np.full(240, np.nan)
    assert DETECTOR.detect(from_depths(nothing)) == NotSeen(Reason.NO_COLUMNS, 0)
    wall = np.full(240, 2.0)
    assert DETECTOR.detect(from_depths(wall)) == NotSeen(Reason.WRONG_LENGTH, 240)
    chaos = np.where(np.arange(240) % 2, 1.0, 2.5)
    assert DETECTOR.detect(from_depths(chaos)).reason is Reason.NO_SURFACE
    other = look(Pose2(1.2, 0.0, 0.0), LEVEL_A, width=0.25)
    assert DETECTOR.detect(other).reason is Reason.WRONG_LENGTH
    sliver = look(Pose2(1.0, 0.9, 0.0), replace(LEVEL_A, behind=None, outliers=0.0))
    assert DETECTOR.detect(sliver).reason is Reason.TOO_SHORT


@settings(max_examples=200)
@given(
    hnp.arrays(float, 40, elements=st.one_of(st.floats(0.2, 3.0), st.floats(), st.just(math.nan)))
)
def test_any_columns_give_an_answer(ranges):
    bearings = np.linspace(-1.2, 1.2, 40)
    found = DETECTOR.detect(DepthColumns(bearings, ranges))
    if isinstance(found, BoardPose):
        assert np.isfinite(found.pose).all()
        assert np.linalg.eigvalsh(found.covariance).min() > -1e-12


def test_wrong_columns_and_settings_are_refused():
    rising = np.linspace(-0.5, 0.5, 10)
    for bearings, ranges in (
        (rising[::-1], rising), (rising, rising[:5]), (4.0 * rising, rising),
        (rising.reshape(2, 5), rising.reshape(2, 5)), (np.full(10, np.nan), rising),
    ):  # fmt: skip
        with pytest.raises(GeometryError):
            DETECTOR.detect(DepthColumns(bearings, ranges))
    for wrong in (
        {"width": 0.0}, {"width": math.nan}, {"camera": Pose2(math.nan, 0.0, 0.0)},
        {"least_columns": 2}, {"least_share": 0.0}, {"span": DepthSpan(2.0, 1.0)},
    ):  # fmt: skip
        with pytest.raises(ConfigurationError):
            BoardDetector(**({"width": WIDTH} | wrong))
    with pytest.raises(ConfigurationError):
        DepthNoise(constant=-1.0)
    with pytest.raises(ConfigurationError):
        column_tangents(0.5, 1)
    found = DETECTOR.detect(look(Pose2(1.0, 0.0, 0.0)))
    with pytest.raises(ConfigurationError):
        observation_of(found, -0.1, 0.0)


def test_yaw_beyond_a_right_angle_is_told_from_its_opposite():
    board = Pose2(1.0, 0.55, 1.65)  # turned past the camera's axis, its front still in view
    found = EXACT.detect(look(board, IDEAL))
    assert wrap_angle(found.pose.theta - board.theta) == pytest.approx(0.0, abs=1e-6)
