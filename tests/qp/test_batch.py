"""Batches against the exact path program by program, a C loop, dense sampling, and themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.c_loop import CLoop, CompilerMissingError, find_compiler
from clfcbf.errors import ConfigurationError
from clfcbf.qp.batch import BatchStatus, solve_batch
from clfcbf.qp.batch_chunks import Programs
from clfcbf.qp.batch_one_shot import solve_batch_paper
from clfcbf.qp.batch_sift import unsettled
from clfcbf.qp.exact import paper_program, solve_lexicographic

WEIGHT = (1.0, 0.0, 0.3)
DENSE = (1.0, -0.35, 0.3)
KINDS = ("plain", "axes", "copies", "twins", "thin", "lengths", "points", "far", "blank", "broken")


def some_rows(rng, count, rows, centre, spread):
    """Rows of random direction and length through points scattered about ``centre``."""
    angle = rng.uniform(-math.pi, math.pi, (count, rows))
    normal = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    through = centre[:, None] + spread * rng.normal(size=(count, rows, 2))
    row = np.concatenate((normal, (normal * through).sum(axis=-1, keepdims=True)), axis=-1)
    return row * 10.0 ** rng.uniform(-1.0, 1.0, (count, rows, 1))


def programs(rng, count, hard, soft, kind="plain"):
    """Nominal commands, boxes and rows; ``kind`` names what is degenerate about them."""
    centre = rng.uniform(-0.2, 0.2, (count, 2))
    half = rng.uniform(0.01, 0.2, (count, 2))
    box = np.stack((centre - half, centre + half), axis=-1).reshape(count, 4)
    nominal = centre + rng.normal(size=(count, 2)) * 2.0 * half
    rows = some_rows(rng, count, hard + soft, centre, 0.15)
    total = hard + soft
    if kind == "axes":
        rows[np.arange(count), rng.integers(0, total, count), rng.integers(0, 2, count)] = 0.0
        tilt = 10.0 ** rng.uniform(-20.0, -2.0, (count, total))
        rows[:, :, 0] = np.where(rng.random((count, total)) < 0.2, tilt, rows[:, :, 0])
    elif kind == "copies":
        factor = rng.choice([-2.0, 3.0, 1.0, -1.0], (count, 1))
        shift = rng.choice([0.0, 0.0, 0.02, -0.02, 1e-13, -1e-16], count)
        rows[:, -1] = factor * rows[:, 0]
        rows[:, -1, 2] += shift
    elif kind == "twins":
        turn = 10.0 ** rng.uniform(-9.0, -2.0, count) * rng.choice([-1.0, 1.0], count)
        sign = rng.choice([1.0, -1.0], count)
        a, c = rows[:, 0, 0], rows[:, 0, 1]
        b = rows[:, 0, 2] + np.hypot(a, c) * rng.choice([0.0, 1e-9, 1e-4, 0.05], count)
        rows[:, -1] = (sign * np.stack((a - turn * c, c + turn * a, b))).T
    elif kind == "thin":
        # Through a corner, or through the nominal command, to the last bits.
        corner = np.where(rng.random((count, 2)) < 0.5, box[:, 0::2], box[:, 1::2])
        point = np.where(rng.random((count, 1)) < 0.6, corner, nominal)
        at = rng.integers(0, total, count)
        row = rows[np.arange(count), at]
        nudge = rng.choice([0.0, 1e-17, -1e-16, 1e-14, -1e-13], count)
        rows[np.arange(count), at, 2] = (row[:, :2] * point).sum(axis=1) + nudge
    elif kind == "lengths":
        rows *= 10.0 ** rng.choice([-150, -100, -20, 0, 0, 0, 20, 120, 155], (count, total, 1))
    elif kind == "points":
        flat = rng.choice((1, 2, 1, 2, 3), count)
        box[:, 1] = np.where(flat & 1, box[:, 0], box[:, 1])
        box[:, 3] = np.where(flat & 2, box[:, 2], box[:, 3])
    elif kind == "far":
        nominal *= 10.0 ** rng.uniform(0.0, 8.0, (count, 1))
    elif kind == "blank":
        blank = rng.random((count, total)) < 0.4
        rows[blank, :2] = 0.0
    elif kind == "broken":
        whole = np.concatenate((nominal, box, rows.reshape(count, -1)), axis=1)
        bad = rng.random(whole.shape) < 0.1
        whole[bad] = rng.choice([math.nan, math.inf, -math.inf, 1e200], bad.sum())
        nominal, box = whole[:, :2], whole[:, 2:6]
        rows = whole[:, 6:].reshape(count, total, 3)
        swap = rng.random(count) < 0.2
        box[swap, :2] = box[swap, 1::-1]
    return nominal, box, rows[:, :hard], rows[:, hard:]


def one(arrays, at):
    nominal, box, *rows = arrays
    return (
        tuple(nominal[at].tolist()),
        tuple(box[at].tolist()),
        [[tuple(row) for row in block[at].tolist()] for block in rows],
    )


def check_lexicographic(weight, arrays, **options):
    answer = solve_batch(weight, *arrays, **options)
    hard = arrays[2].shape[1]
    weights = np.broadcast_to(np.asarray(weight, dtype=float), (len(arrays[0]), 3))
    for at in range(len(arrays[0])):
        nominal, box, levels = one(arrays, at)
        exact = solve_lexicographic(tuple(weights[at].tolist()), nominal, box, levels)
        if exact is None:
            assert answer.status[at] == BatchStatus.INVALID
            assert np.isnan(answer.twist[at]).all()
            assert np.isnan(answer.slacks[at]).all()
            continue
        assert answer.status[at] == (BatchStatus.RELAXED if exact.relaxed else BatchStatus.SOLVED)
        assert answer.twist[at] == pytest.approx((exact.v, exact.omega), rel=0, abs=1e-12)
        assert answer.slacks[at] == pytest.approx(exact.slacks, rel=1e-12, abs=1e-12)
        assert tuple(np.flatnonzero(answer.violated[at])) == exact.violated
        assert box[0] <= answer.twist[at, 0] <= box[1]
        assert box[2] <= answer.twist[at, 1] <= box[3]
    assert answer.violated.shape == (len(arrays[0]), hard + arrays[3].shape[1])
    return answer


def check_paper(weight, arrays, penalty):
    soft = arrays[3][:, 0]
    answer = solve_batch_paper(weight, *arrays[:3], soft, penalty)
    for at in range(len(soft)):
        nominal, box, (hard, ((a, c, b), *_)) = one(arrays, at)
        exact = paper_program(weight, nominal, box, hard, (a, c, b), penalty)
        assert answer.feasible[at] == exact.feasible
        expected = pytest.approx((exact.v, exact.omega), rel=0, abs=1e-12, nan_ok=True)
        assert answer.twist[at] == expected
        # The slack is a residual of the command: the row's length scales its rounding.
        size = 1.0 + abs(a) + abs(c) + abs(b)
        assert answer.delta[at] == pytest.approx(exact.delta, rel=1e-12, abs=1e-12 * size, nan_ok=1)
    return answer


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sizes", [(1, 1), (2, 0), (0, 2), (2, 1), (3, 3)])
def test_equal_to_one_by_one(kind, sizes):
    count = 40 if kind in ("twins", "thin", "far", "lengths") else 150
    arrays = programs(np.random.default_rng([*sizes, len(kind)]), count, *sizes, kind)
    check_lexicographic(WEIGHT, arrays)


@pytest.mark.parametrize("kind", ["plain", "axes", "copies", "thin"])
def test_any_weight_common_or_one_a_program(kind):
    rng = np.random.default_rng(5)
    arrays = programs(rng, 60, 2, 1, kind)
    check_lexicographic(DENSE, arrays)
    q11, q22 = rng.uniform(0.2, 2.0, (2, 60))
    weights = np.stack((q11, rng.uniform(-0.9, 0.9, 60) * np.sqrt(q11 * q22), q22), axis=1)
    check_lexicographic(weights, arrays)


def test_weights_out_of_scale():
    rng = np.random.default_rng(6)
    arrays = programs(rng, 60, 1, 1)
    check_lexicographic(10.0 ** rng.uniform(-8, 8, (60, 3)) * (1.0, 0.0, 1.0), arrays)
    check_lexicographic((1.0, 1.0 - 1e-9, 1.0), arrays)


@pytest.mark.parametrize("kind", ["plain", "axes", "copies", "twins", "thin", "blank", "broken"])
@pytest.mark.parametrize("penalty", [0.1, 1e3, 1e7])
def test_paper_program_equal_to_one_by_one(kind, penalty):
    arrays = programs(np.random.default_rng(len(kind)), 60, 2, 1, kind)
    check_paper(WEIGHT, arrays, penalty)
    check_paper(DENSE, tuple(array[:20] for array in arrays), penalty)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(KINDS), st.integers(0, 3), st.integers(0, 3))
def test_any_program_at_all(seed, kind, hard, soft):
    if hard + soft:
        arrays = programs(np.random.default_rng(seed), 6, hard, soft, kind)
        check_lexicographic(WEIGHT, arrays)
        check_lexicographic(DENSE, arrays)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_sampled_command_does_better(seed):
    """Lexicographic comparison with a grid of commands, independent of every other path."""
    nominal, box, hard, soft = programs(np.random.default_rng(seed), 20, 2, 2)
    answer = solve_batch(WEIGHT, nominal, box, hard, soft)
    grid = np.linspace(0.0, 1.0, 41)
    v = box[:, 0, None, None] + (box[:, 1] - box[:, 0])[:, None, None] * grid[:, None]
    w = box[:, 2, None, None] + (box[:, 3] - box[:, 2])[:, None, None] * grid
    allowed = np.ones(np.broadcast_shapes(v.shape, w.shape), dtype=bool)
    for rows, slack in ((hard, answer.slacks[:, 0]), (soft, answer.slacks[:, 1])):
        a, c, b = rows.transpose(2, 1, 0)[..., None, None]
        excess = ((a * v + c * w - b) / np.hypot(a, c)).max(axis=0)
        least = np.where(allowed, excess, np.inf).min(axis=(1, 2))
        assert (np.maximum(least, 0.0) >= slack - 1e-12).all()
        allowed &= excess <= slack[:, None, None] + 1e-15
    x, y = v - nominal[:, 0, None, None], w - nominal[:, 1, None, None]
    cost = np.where(allowed, x * x + 0.3 * y * y, np.inf).min(axis=(1, 2))
    x, y = (answer.twist - nominal).T
    assert (cost >= x * x + 0.3 * y * y - 1e-12).all()


@pytest.mark.parametrize("chunk", [1, 7, 300])
def test_chunks_change_nothing(chunk):
    for kind in ("plain", "broken"):
        arrays = programs(np.random.default_rng(1), 300, 2, 1, kind)
        whole = solve_batch(WEIGHT, *arrays)
        for ours, theirs in zip(solve_batch(WEIGHT, *arrays, chunk=chunk), whole, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        paper = (WEIGHT, *arrays[:3], arrays[3][:, 0], 1e3)
        for ours, theirs in zip(
            solve_batch_paper(*paper, chunk=chunk), solve_batch_paper(*paper), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)


def test_neighbours_change_nothing():
    """Any subset in any order: the same answers to the last bit."""
    arrays = programs(np.random.default_rng(2), 400, 2, 2, "axes")
    whole = solve_batch(DENSE, *arrays)
    picked = np.random.default_rng(3).permutation(400)[:123]
    part = solve_batch(DENSE, *(array[picked] for array in arrays))
    for ours, theirs in zip(part, whole, strict=True):
        np.testing.assert_array_equal(ours, theirs[picked])


def test_arguments_common_to_all():
    nominal, box, hard, soft = programs(np.random.default_rng(4), 50, 2, 1)
    spread = (np.broadcast_to(x[:1], x.shape) for x in (box, hard, soft))
    for ours, theirs in zip(
        solve_batch(WEIGHT, nominal, box[0], hard[0], soft[0]),
        solve_batch(np.tile(WEIGHT, (50, 1)), nominal, *spread),
        strict=True,
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-15)
    paper = solve_batch_paper(WEIGHT, nominal, box[0], hard[0], soft[0, 0], 10.0)
    assert paper.delta.shape == (50,)


def test_arguments_are_left_alone():
    arrays = programs(np.random.default_rng(8), 60, 2, 1, "blank")
    before = [array.copy() for array in arrays]
    solve_batch(WEIGHT, *arrays)
    solve_batch_paper(WEIGHT, *arrays[:3], arrays[3][:, 0], 10.0)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_few_programs_need_the_exact_path():
    arrays = programs(np.random.default_rng(9), 20_000, 2, 2)
    answer = solve_batch(WEIGHT, *arrays)
    assert (answer.slacks[:, 0] > 0.0).mean() > 0.1
    assert (answer.slacks[:, 1] > 0.0).mean() > 0.1
    assert answer.delicate.mean() < 1e-3
    arrays[1][:, 1] = arrays[1][:, 0]  # as where a robot comes from faster limits
    assert solve_batch(WEIGHT, *arrays).delicate.mean() < 2e-3


def test_no_rows_and_no_programs():
    nominal = np.array([[0.5, 0.0], [0.0, -0.7]])
    answer = solve_batch(WEIGHT, nominal, (-0.1, 0.3, -0.2, 0.2), np.empty((0, 3)))
    np.testing.assert_array_equal(answer.twist, [[0.3, 0.0], [0.0, -0.2]])
    empty = solve_batch(WEIGHT, np.empty((0, 2)), np.empty((0, 4)), np.empty((0, 1, 3)))
    assert empty.twist.shape == (0, 2)


BOX = np.array([[-0.1, 0.3, -0.2, 0.3]] * 3)
ROW = np.ones((3, 1, 3))
NOMINAL = np.zeros((3, 2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((WEIGHT, NOMINAL[0], BOX, ROW), "nominal must have shape"),
        ((WEIGHT, NOMINAL, BOX[:2], ROW), "box must have shape"),
        ((WEIGHT, NOMINAL, BOX, ROW[:, 0]), None),
        ((WEIGHT, NOMINAL, BOX, ROW[:2]), "hard must have shape"),
        ((WEIGHT, NOMINAL, BOX, ROW, ROW[..., :2]), "soft must have shape"),
        (((1.0, 2.0, 1.0), NOMINAL, BOX, ROW), "weight must be"),
        (([WEIGHT, (1.0, 1.0, 1.0), WEIGHT], NOMINAL, BOX, ROW), "weight must be"),
        (([WEIGHT, WEIGHT], NOMINAL, BOX, ROW), "weight must have shape"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    if message is None:  # three rows common to three programs: a valid reading of (3, 3)
        assert solve_batch(*arguments).violated.shape == (3, 3)
        return
    with pytest.raises(ConfigurationError, match=message):
        solve_batch(*arguments)


@pytest.mark.parametrize("penalty", [0.0, -1.0, math.nan, math.inf])
def test_penalty_must_be_positive(penalty):
    with pytest.raises(ConfigurationError, match="penalty"):
        solve_batch_paper(WEIGHT, NOMINAL, BOX, ROW, ROW[:, 0], penalty)


@pytest.mark.parametrize("chunk", [0, -5])
def test_chunk_must_be_positive(chunk):
    with pytest.raises(ConfigurationError, match="chunk"):
        solve_batch(WEIGHT, NOMINAL, BOX, ROW, chunk=chunk)


@pytest.fixture(scope="module")
def c_loop():
    try:
        return CLoop(find_compiler())
    except CompilerMissingError as error:
        pytest.skip(str(error))


def test_equal_to_the_c_loop(c_loop):
    nominal, box, hard, soft = programs(np.random.default_rng(11), 20_000, 1, 1)
    columns = (nominal, box, np.ascontiguousarray(hard[:, 0]), np.ascontiguousarray(soft[:, 0]))
    answer = solve_batch(WEIGHT, nominal, box, hard, soft)
    plain = ~answer.delicate
    theirs = c_loop.lexicographic(WEIGHT, *columns)
    np.testing.assert_allclose(answer.twist[plain], theirs[plain, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(answer.slacks[plain], theirs[plain, 2:], rtol=0, atol=1e-12)
    paper = solve_batch_paper(WEIGHT, *columns[:2], hard, columns[3], 1e3)
    plain = ~paper.delicate
    theirs = c_loop.one_shot(WEIGHT, *columns, 1e3)
    np.testing.assert_allclose(paper.twist[plain], theirs[plain, :2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(paper.delta[plain], theirs[plain, 2], rtol=0, atol=1e-11)
    np.testing.assert_array_equal(paper.feasible, theirs[:, 3] == 1.0)


def test_c_loop_takes_what_it_says_only(c_loop):
    nominal, box, hard, soft = programs(np.random.default_rng(12), 5, 1, 1)
    with pytest.raises(ValueError, match="contiguous"):
        c_loop.lexicographic(WEIGHT, nominal, box, hard, soft)
    with pytest.raises(ValueError, match="diagonal"):
        c_loop.lexicographic(DENSE, nominal, box, hard[:, 0], soft[:, 0])


def test_without_a_compiler_it_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(CompilerMissingError, match="cc, gcc, clang"):
        find_compiler()
    with pytest.raises(CompilerMissingError, match="cannot be run"):
        CLoop("/nowhere/cc")


def test_programs_that_hold_in_the_box_are_settled_on_sight():
    """And only those: the commands are the nominal ones moved into the boxes, to the last bit."""
    arrays = programs(np.random.default_rng(13), 5000, 1, 1)
    nominal, box, hard, soft = arrays
    twist = np.full((5000, 2), np.nan)
    read = Programs.read(WEIGHT, *arrays)
    left = np.concatenate([part.place.copy() for part in unsettled(read, 700, twist)])
    settled = np.setdiff1d(np.arange(5000), left)
    assert 500 < settled.size < 4500
    assert (np.diff(left) > 0).all()
    moved = np.clip(nominal, box[:, ::2], box[:, 1::2])
    np.testing.assert_array_equal(twist[settled], moved[settled])
    over = [(rows[:, 0, :2] * moved).sum(axis=1) - rows[:, 0, 2] for rows in (hard, soft)]
    assert (np.maximum(*over)[settled] < 0.0).all()
    assert (np.maximum(*over)[left] > -1e-9).all()


def test_a_broken_robot_changes_nothing_for_the_others():
    arrays = programs(np.random.default_rng(14), 500, 2, 1)
    whole = solve_batch(WEIGHT, *arrays)
    paper = solve_batch_paper(WEIGHT, *arrays[:3], arrays[3][:, 0], 100.0)
    for place, value in ((0, math.nan), (1, math.inf), (2, 1e200)):
        broken = [array.copy() for array in arrays]
        broken[place + 1].reshape(500, -1)[7, 0] = value
        others = np.arange(500) != 7
        again = solve_batch(WEIGHT, *broken)
        np.testing.assert_array_equal(again.twist[others], whole.twist[others])
        again = solve_batch_paper(WEIGHT, *broken[:3], broken[3][:, 0], 100.0)
        np.testing.assert_array_equal(again.twist[others], paper.twist[others])


@pytest.mark.parametrize("penalty", [1e-3, 1.0, 1e4, 1e8])
def test_one_shot_where_the_slack_is_next_to_nothing(penalty):
    """The soft row through the minimum without it, to 1e-16 ... 1e-6 on either side."""
    rng = np.random.default_rng(15)
    nominal, box, hard, soft = programs(rng, 300, 1, 1)
    plain = solve_batch(WEIGHT, nominal, box, hard).twist
    row = soft[:, 0]
    off = 10.0 ** rng.uniform(-16.0, -6.0, 300) * rng.choice([-1.0, 1.0], 300)
    row[:, 2] = (row[:, :2] * plain).sum(axis=1) + off
    answer = check_paper(WEIGHT, (nominal, box, hard, soft), penalty)
    assert 0.2 < (answer.delta > 0.0).mean() < 0.8


@pytest.mark.parametrize("kind", ["plain", "axes", "twins", "thin", "points", "broken"])
def test_a_large_batch_is_its_pieces(kind):
    """Large ones are looked through first and solved in another order: the bits are the same."""
    arrays = programs(np.random.default_rng(16), 9000, 1, 1, kind)
    whole = solve_batch(WEIGHT, *arrays)
    paper = solve_batch_paper(WEIGHT, *arrays[:3], arrays[3][:, 0], 300.0)
    for start in range(0, 9000, 3000):
        piece = [array[start : start + 3000] for array in arrays]
        for ours, theirs in zip(solve_batch(WEIGHT, *piece), whole, strict=True):
            np.testing.assert_array_equal(ours, theirs[start : start + 3000])
        alone = solve_batch_paper(WEIGHT, *piece[:3], piece[3][:, 0], 300.0)
        for ours, theirs in zip(alone, paper, strict=True):
            np.testing.assert_array_equal(ours, theirs[start : start + 3000])
