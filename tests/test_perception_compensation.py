"""View compensation in closed form: the right one is exact, the printed one is not."""

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from benchmarks import compensation
from clfcbf.perception import (
    compensated_centre,
    printed_centre,
    printed_length,
    visible_length,
)
from clfcbf.se2 import Pose2
from clfcbf.simulation.depth import cast

WIDTH = 0.5


@st.composite
def cut_boards(draw):
    """A board cut by one edge of the view, with that edge: half angle, board, side, share."""
    half_angle = draw(st.floats(0.3, 0.9))
    theta, distance = draw(st.floats(-0.9, 0.9)), draw(st.floats(0.6, 3.0))
    side, share = draw(st.sampled_from((-1, 1))), draw(st.floats(0.15, 0.95))
    # The point of the board at the edge's ray, then the centre so that ``share`` is inside.
    cut = distance * np.array([math.cos(half_angle), side * math.sin(half_angle)])
    tangent = np.array([-math.sin(theta), math.cos(theta)])
    free = cut - side * share * WIDTH * tangent
    centre = cut + side * (0.5 - share) * WIDTH * tangent
    assume(abs(math.atan2(free[1], free[0])) < half_angle - 0.02)
    assume(free[0] > 0.1)
    return half_angle, Pose2(*centre.tolist(), theta), side, share, 0.5 * (cut + free)


@given(cut_boards())
def test_compensation_is_exact(case):
    half_angle, board, side, share, middle = case
    length = visible_length(tuple(middle), board.theta, half_angle, side)
    assert length == pytest.approx(share * WIDTH, rel=1e-9, abs=1e-9)
    centre = compensated_centre(tuple(middle), board.theta, half_angle, WIDTH, side)
    assert centre == pytest.approx(board[:2], abs=1e-9)


@given(cut_boards())
def test_compensation_is_the_same_in_a_mirror(case):
    half_angle, board, side, _, (x, y) = case
    one = compensated_centre((x, y), board.theta, half_angle, WIDTH, side)
    other = compensated_centre((x, -y), -board.theta, half_angle, WIDTH, -side)
    assert other == pytest.approx((one[0], -one[1]), abs=1e-12)


@given(cut_boards())
def test_printed_formulas_satisfy_the_printed_equations(case):
    half_angle, board, _, _, (x, y) = case
    phi, rho = math.atan2(y, x), math.hypot(x, y)
    denominator = math.cos(board.theta + 2.0 * phi - half_angle)
    assume(abs(denominator) > 1e-3)
    length = printed_length((x, y), board.theta, half_angle)
    assert rho / -denominator == pytest.approx(length / (2.0 * math.sin(half_angle - phi)))
    moved = np.array(printed_centre((x, y), board.theta, half_angle, WIDTH)) - (x, y)
    direction = np.array([math.cos(board.theta), -math.sin(board.theta)])
    assert moved == pytest.approx(0.5 * (length - WIDTH) * direction)


@pytest.mark.parametrize("degrees", [5.0, 17.5, 30.0])
def test_printed_length_is_wrong_for_a_board_that_faces_the_camera(degrees):
    half_angle, phi = math.radians(35.0), math.radians(degrees)
    middle = (math.cos(phi), math.sin(phi))
    right = visible_length(middle, 0.0, half_angle, 1)
    assert printed_length(middle, 0.0, half_angle) < 0.0 < right
    turned = printed_length(middle, math.pi, half_angle)
    # Both are 2 rho sin(Phi - phi) over a cosine: of Phi, and of 2 phi - Phi.
    assert turned / right == pytest.approx(math.cos(half_angle) / math.cos(2 * phi - half_angle))
    assert 0.10 < right / turned - 1.0 < 0.23


def test_printed_length_meets_the_right_one_at_the_edge():
    half_angle = math.radians(35.0)
    for theta in (-0.3, 0.2):
        for gap in (1e-3, 1e-4):
            phi = half_angle - gap
            middle = (math.cos(phi), math.sin(phi))
            ratio = printed_length(middle, math.pi - theta, half_angle) / visible_length(
                middle, theta, half_angle, 1
            )
            assert ratio == pytest.approx(1.0, abs=3.0 * gap)


@pytest.mark.parametrize(("theta", "shift"), [(0.2, 0.008), (0.6, 0.024)])
def test_mean_of_pixels_is_not_the_middle(theta, shift):
    tangents = np.linspace(-0.7, 0.7, 20001)
    depths = cast(Pose2(1.0, 0.0, theta), WIDTH, tangents)
    seen = np.isfinite(depths)
    mean = np.array([depths[seen].mean(), (depths * tangents)[seen].mean()])
    assert math.dist(mean, (1.0, 0.0)) == pytest.approx(shift, abs=0.0015)


# --- the benchmark ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result():
    return json.loads(json.dumps(compensation.measure(60, 3), allow_nan=False))


def test_experiment_has_every_pose_and_says_which_are_cut(result):
    assert [row["pose"] for row in result["poses"]] == list(range(60))
    half_angle = math.radians(result["settings"]["half_angle_deg"])
    for row in result["poses"]:
        t = math.radians(row["theta_deg"])
        ends = [(row["x_m"] - s * 0.25 * math.sin(t), row["y_m"] + s * 0.25 * math.cos(t))
                for s in (1, -1)]  # fmt: skip
        left, right = (math.atan2(y, x) for x, y in ends)
        cut = [name for name, out in (("left", left > half_angle), ("right", right < -half_angle))
               if out]  # fmt: skip
        assert row["cut"] == ("+".join(cut) or "none")
        assert (row["visible"] < 1.0 - 1e-3) <= bool(cut)
        assert row["visible"] >= compensation.VISIBLE
        assert set(row["errors"]) == set(compensation.METHODS if row["found"] else ())
    cut = sum(row["cut"] != "none" for row in result["poses"])
    assert result["summary"]["cut"]["poses"] == cut > 10


def test_free_end_is_right_where_the_others_are_not(result):
    cut = result["summary"]["cut"]
    medians = {name: cut[name]["centre_mm"]["median"] for name in compensation.METHODS}
    assert medians["free end"] < 5.0
    assert medians["law of sines"] < 5.0
    assert medians["free end"] < 0.5 * medians["printed, best"]
    assert medians["printed, best"] < medians["none"] < medians["printed"]


def test_nothing_is_compensated_where_nothing_is_cut(result):
    for row in result["poses"]:
        if row["cut"] == "none" and row["visible"] == 1.0 and abs(row["y_m"]) < 0.2 * row["x_m"]:
            assert row["errors"]["printed"] == row["errors"]["none"]
            assert row["errors"]["printed, best"] == row["errors"]["none"]


def test_same_seed_same_experiment_and_best_convention_is_the_best():
    assert compensation.measure(5, 1) == compensation.measure(5, 1)
    assert len(set(compensation.CONVENTIONS)) == 128
    assert compensation.LITERAL in compensation.CONVENTIONS


@given(cut_boards(), st.sampled_from(compensation.CONVENTIONS))
def test_a_convention_reads_the_same_formulas(case, convention):
    half_angle, board, side, _, middle = case
    yaw, y = board.theta, middle[1]
    if convention.mirrored and side < 0:
        yaw, y = -yaw, -y
    yaw = convention.yaw * yaw + math.pi * convention.turned
    y *= convention.bearing
    assume(abs(math.cos(yaw + 2.0 * math.atan2(y, middle[0]) - half_angle)) > 1e-3)
    centre = compensation.printed(convention, tuple(middle), board.theta, half_angle, WIDTH, side)
    shift = 0.5 * abs(printed_length((middle[0], y), yaw, half_angle) - WIDTH)
    assert math.dist(centre, middle) == pytest.approx(shift, abs=1e-9)


def test_command_writes_json_and_figure(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra viz")
    data, image = tmp_path / "c.json", tmp_path / "c.svg"
    assert compensation.main(["--poses", "4", "--json", str(data), "--plot", str(image)]) == 0
    assert "free end" in capsys.readouterr().out
    assert len(json.loads(data.read_text())["poses"]) == 4
    assert b"<svg" in image.read_bytes()
    with pytest.raises(SystemExit):
        compensation.main(["--plot", str(tmp_path / "c.bmp")])


def test_side_is_the_one_edge_that_cuts():
    rng = np.random.default_rng(0)
    half_angle = math.radians(35.0)
    sides = set()
    for _ in range(40):
        board = compensation.draw_board(rng, half_angle, WIDTH)
        share, cut = compensation.in_view(board, half_angle, WIDTH)
        sides.add(cut)
        assert share >= compensation.VISIBLE
    assert {"left", "right", "none"} <= sides
    assert compensation.View(board, share, cut, None, (0.0, 0.0)).side == 0
