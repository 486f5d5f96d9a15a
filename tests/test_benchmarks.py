"""The latency and backend benchmarks keep the shape others read, and their judges are right."""

import importlib.util
import json
import math

import numpy as np
import pytest

from benchmarks import backends, latency, latency_report, reference, step_latency
from benchmarks.routes import PENALTY
from benchmarks.stream import Program, record_stream, stress_programs
from benchmarks.timing import Contestant, interleave, quiet, row
from clfcbf import Twist, available_backends
from clfcbf.qp.exact import paper_program
from clfcbf.simulation.scenarios import LIMITS

ROW = {"name", "what", "median_us", "p99_us", "p999_us", "worst_error", "wrong", "failed"}
RATIOS = {"ipopt_over_tick", "ipopt_over_exact", "cbfpy_over_tick"}
PROGRAMS = 12


def installed(*names):
    return all(importlib.util.find_spec(name) for name in names)


@pytest.fixture(scope="module")
def stream():
    return record_stream(300)


@pytest.fixture(scope="module")
def result():
    measured = latency.measure(PROGRAMS, 2, sizes=(50,), counts=(0, 200), stress=4)
    return json.loads(json.dumps(measured, allow_nan=False))


def test_rows_have_the_declared_fields_and_are_numbers(result):
    names = [r["name"] for r in result["rows"]]
    assert len(names) == len(set(names))
    assert {"exact", "TrackingController.step"} <= set(names)
    assert set(available_backends()) <= set(names)
    for r in result["rows"]:
        assert set(r) >= ROW
        assert r["what"] in {"tick", "solve"}
        assert 0.0 < r["median_us"] <= r["p99_us"] <= r["p999_us"]
        assert math.isfinite(r["worst_error"])


def test_ours_is_exact_never_wrong_and_never_fails(result):
    for name in ("exact", "exact-lexicographic", "TrackingController.step"):
        (r,) = [r for r in result["rows"] if r["name"] == name]
        assert (r["wrong"], r["failed"]) == (0, 0)
        assert r["worst_error"] < 1e-12
    for rows in result["stress"].values():
        (r,) = [r for r in rows if r["name"] == "exact"]
        assert (r["wrong"], r["failed"]) == (0, 0)
        assert r["worst_error"] < 1e-12


def test_ratios_are_the_middle_of_their_spread(result):
    assert set(result["ratios"]) == RATIOS
    for name, ratio in result["ratios"].items():
        spread = result["ratio_spread"][name]
        assert spread["min"] <= ratio == spread["median"] <= spread["max"]
    if installed("casadi"):
        assert result["ratios"]["ipopt_over_exact"] > result["ratios"]["ipopt_over_tick"] > 0.0


def test_batches_agree_with_one_by_one(result):
    for r in result["batch"]:
        assert set(r) >= {"name", "B", "per_second"}
        assert r["per_second"] > 0.0
        if r["name"].startswith(("exact", "c-loop")):
            assert r["worst_error"] < 1e-12
    assert {r["B"] for r in result["batch"] if r["name"] == "exact"} == {50}


def test_dropping_far_obstacles_changes_no_answer(result):
    """DAQP gets all the rows and is judged by ours, which leaves out those that cannot matter."""
    judged = [r for r in result["scaling"] if r["name"] == "daqp"]
    assert {r["obstacles"] for r in judged} == {0, 200}
    for r in judged:
        assert (r["wrong"], r["failed"]) == (0, 0)
        assert r["worst_error"] < 1e-9


@pytest.mark.skipif(not installed("cbfpy", "elastiqp"), reason="cbfpy is not installed")
def test_cbfpy_solves_our_problem(result):
    assert result["cbfpy_rows_difference"] < 1e-14
    (r,) = [r for r in result["rows"] if r["name"] == latency.CBFPY]
    assert (r["wrong"], r["failed"]) == (0, 0)


def test_table_and_figure_show_every_route(result, tmp_path):
    text = latency_report.table(result)
    assert all(r["name"] in text for r in result["rows"])
    if installed("matplotlib"):
        from benchmarks import latency_figure

        left, *_ = latency_figure.draw(result).axes
        shown = {label.get_text() for label in left.get_yticklabels()}
        assert shown == {r["name"] for r in result["rows"]}


def test_command_line_writes_what_measure_returns(monkeypatch, tmp_path, capsys, result):
    for name in step_latency.ONE_THREAD:
        monkeypatch.setenv(name, "1")
    asked = []
    monkeypatch.setattr(latency, "measure", lambda *a, **k: asked.append(a) or result)
    path = tmp_path / "latency.json"
    path.write_text("")
    assert step_latency.main(["--programs", "7", "--repeats", "3", "--json", str(path)]) == 0
    assert asked == [(7, 3, 0)]
    assert json.loads(path.read_text()) == result
    assert "TrackingController.step" in capsys.readouterr().out


def test_recorded_stream_is_a_closed_loop_within_its_limits(stream):
    again = record_stream(300)
    assert [t.decision[:2] for t in again.ticks] == [t.decision[:2] for t in stream.ticks]
    limits = LIMITS["approaching"]
    for before, after in zip(stream.ticks[:-1], stream.ticks[1:], strict=True):
        if after.now > before.now:  # else the next run
            assert after.inputs.applied == before.decision.twist
        assert limits.contains(after.decision.twist, 1e-9)
    ages = {round(t.now - t.inputs.scene.stamp, 6) for t in stream.ticks[:100]}
    assert max(ages) == pytest.approx(0.1)


def test_reference_agrees_with_a_dense_grid():
    """On a grid of commands none is feasible and cheaper than the exact answer."""
    rng = np.random.default_rng(3)
    checked = 0
    for _ in range(40):
        rows = rng.normal(size=(3, 3)).tolist()
        program = Program(
            (1.0, 0.1, 0.3), Twist(*rng.normal(size=2).tolist()), (-0.5, 0.6, -0.7, 0.4),
            tuple(map(tuple, rows[:2])), tuple(rows[2]),
        )  # fmt: skip
        answer = reference.one_shot(program, PENALTY)
        v, w = np.meshgrid(np.linspace(-0.5, 0.6, 301), np.linspace(-0.7, 0.4, 301))
        inside = np.all([a * v + c * w <= b for a, c, b in program.hard], axis=0)
        if answer is None:
            assert not inside.any()
            continue
        checked += 1
        cheapest = np.where(inside, cost(program, v, w), np.inf).min()
        assert cost(program, *answer) <= cheapest + 1e-12
        assert all(a * answer[0] + c * answer[1] <= b + 1e-12 for a, c, b in program.hard)
    assert checked > 10


def cost(program, v, w):
    q11, q12, q22 = program.weight
    x, y = v - program.nominal.v, w - program.nominal.omega
    a, c, b = program.soft
    delta = np.maximum(0.0, a * v + c * w - b)
    return q11 * x * x + 2.0 * q12 * x * y + q22 * y * y + PENALTY * delta**2


def test_stress_programs_are_feasible_and_hard(stream):
    for name, programs in stress_programs(stream.programs, 30).items():
        for p in programs:
            exact = reference.one_shot(p, PENALTY)
            answer = paper_program(p.weight, p.nominal, p.box, p.hard, p.soft, PENALTY)
            assert exact is not None, name
            assert answer.feasible, name
            assert max(abs(answer.v - exact[0]), abs(answer.omega - exact[1])) < 1e-12, name


def test_a_route_that_throws_has_failed_and_one_that_is_off_is_wrong():
    def call(job):
        if job == 0:
            raise RuntimeError("no answer")
        return job

    expected = [(0.0, 0.0), (1.0, 0.0), (5.0, 0.0), (0.0, 0.0)]
    jobs = [0, 1, 2, math.nan]
    route = Contestant("route", "solve", call, jobs, lambda x: (float(x), 0.0), expected)
    with quiet():
        (sample,) = interleave([route], 3, 2, np.random.default_rng(0))
    figures = row(route, sample)
    assert sample.times.shape == (3, 4)
    assert (figures["failed"], figures["wrong"]) == (1, 2)
    json.dumps(figures, allow_nan=False)


def test_backends_table_names_every_backend_and_its_licence(tmp_path, capsys):
    path, page = tmp_path / "backends.json", tmp_path / "backends.md"
    arguments = ["--programs", "8", "--json", str(path), "--docs", str(page)]
    assert backends.main(arguments) == 0
    found = json.loads(path.read_text())["backends"]
    assert [r["name"] for r in found] == list(available_backends())
    for r in found:
        assert r["licence"]
        assert (r["off"], r["failed"]) == (0, 0), r["name"]
        assert f"`{r['name']}`" in page.read_text()
    assert capsys.readouterr().out.strip() == page.read_text().strip()
