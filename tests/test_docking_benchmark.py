"""The docking benchmark: statistics against published values, paired runs, resuming, the report."""

import csv
import importlib.util
import json
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.baselines import METHODS, Setup
from benchmarks.docking import __main__ as command
from benchmarks.docking import campaign, engine
from benchmarks.docking.ablations import ABLATIONS, Unpredicted, sampled
from benchmarks.docking.campaign import Run, execute, planned
from benchmarks.docking.report import markdown, strict_caps
from benchmarks.docking.statistics import (
    bootstrap,
    demonstrated,
    holm,
    mcnemar,
    runs_needed,
    wilson,
)
from benchmarks.docking.store import Store
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.limits import Limits
from clfcbf.paper_docking import quintic_to_goal
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist, wrap_angle
from clfcbf.simulation.scenarios import World, draw_start, region_named
from clfcbf.simulation.sensor_model import SensorModel

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
SETUP = Setup.of(World(), LIMITS, 0.12)

# --- statistics ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wins", "runs", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),  # Newcombe (1998), the score method
    ],
)  # fmt: skip
def test_wilson_as_published(wins, runs, low, high):
    assert wilson(wins, runs) == pytest.approx((low, high), abs=6e-5)


@given(st.integers(1, 60), st.data())
def test_wilson_is_the_root_of_the_score_equation(runs, data):
    wins = data.draw(st.integers(0, runs))
    z = 1.959963984540054
    for bound in wilson(wins, runs):
        assert (wins / runs - bound) ** 2 == pytest.approx(
            z * z * bound * (1.0 - bound) / runs, abs=1e-9
        )


@pytest.mark.parametrize(
    ("reliability", "failures", "runs"),
    [(0.95, 0, 59), (0.99, 0, 299), (0.90, 0, 29), (0.95, 1, 93), (0.95, 2, 124), (0.95, 3, 153)],
)
def test_runs_that_demonstrate_a_reliability_at_95_percent(reliability, failures, runs):
    """The usual tables of acceptance by attributes."""
    assert runs_needed(reliability, failures) == runs
    assert demonstrated(runs - failures, runs) >= reliability
    assert demonstrated(runs - 1 - failures, runs - 1) < reliability


def test_thirty_of_thirty_demonstrate_905():
    assert demonstrated(30, 30) == pytest.approx(0.05 ** (1 / 30))
    assert demonstrated(30, 30) == pytest.approx(0.905, abs=5e-4)
    assert demonstrated(0, 30) == 0.0


@given(st.integers(1, 40), st.data())
def test_demonstrated_is_where_the_binomial_tail_is_five_percent(runs, data):
    wins = data.draw(st.integers(1, runs))
    r = Fraction(demonstrated(wins, runs))
    tail = sum(math.comb(runs, k) * r**k * (1 - r) ** (runs - k) for k in range(wins, runs + 1))
    assert float(tail) == pytest.approx(0.05, abs=1e-9)


def test_mcnemar_as_published():
    """Airway hyper-responsiveness before and after a transplant: Fagerland et al. (2013)."""
    before = [True] * 1 + [False] * 1 + [True] * 7 + [False] * 12
    after = [True] * 1 + [True] * 1 + [False] * 7 + [False] * 12
    result = mcnemar(before, after)
    assert result[:3] == (7, 1, 21)
    assert result.p == pytest.approx(0.0703, abs=5e-5)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=40))
def test_mcnemar_is_the_exact_binomial_and_symmetric(pairs):
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    b, c = (sum(a and not d for a, d in pairs), sum(d and not a for a, d in pairs))
    tail = sum(math.comb(b + c, k) for k in range(min(b, c) + 1))
    exact = min(Fraction(1), Fraction(2 * tail, 2 ** (b + c)))
    assert mcnemar(first, second) == pytest.approx((b, c, len(pairs), float(exact)))
    assert mcnemar(second, first).p == pytest.approx(float(exact))


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=12))
def test_holm_rejects_what_its_step_down_procedure_rejects(ps):
    for level in (0.01, 0.05, 0.3):
        rejected, left = set(), sorted(range(len(ps)), key=lambda i: ps[i])
        while left and ps[left[0]] * len(left) <= level:
            rejected.add(left.pop(0))
        assert {i for i, p in enumerate(holm(ps)) if p <= level} == rejected


def test_bootstrap_of_a_mean_is_the_normal_interval():
    sample = np.random.default_rng(0).normal(3.0, 2.0, 400)
    half = 1.96 * sample.std() / math.sqrt(400)
    low, high = bootstrap(sample, np.mean)
    assert (low, high) == pytest.approx((sample.mean() - half, sample.mean() + half), abs=0.03)
    assert bootstrap(sample) == bootstrap(sample)
    assert bootstrap([2.0, 2.0, 2.0]) == (2.0, 2.0)
    assert bootstrap([1.0]) == (1.0, 1.0)


def test_bootstrap_of_a_median_covers_it():
    """About 95 of 100 intervals; 87 or fewer has a probability of 1 in 600."""
    rng = np.random.default_rng(1)
    covered = [
        low <= math.log(2.0) <= high
        for low, high in (bootstrap(rng.exponential(size=60)) for _ in range(100))
    ]
    assert sum(covered) > 87


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: wilson(3, 2), lambda: wilson(0, 0), lambda: demonstrated(-1, 2),
        lambda: runs_needed(1.0), lambda: mcnemar([True], []), lambda: bootstrap([]),
    ],
)  # fmt: skip
def test_impossible_counts_are_refused(wrong):
    with pytest.raises(ConfigurationError):
        wrong()


# --- what is run --------------------------------------------------------------------------------


def test_runs_are_planned_index_by_index_and_slow_methods_less():
    runs = planned(("clf-cbf", "nmpc"), ("R1", "R3"), ("A",), 3, 5, {"nmpc": 2})
    assert [(r.region, r.index, r.method) for r in runs[:5]] == [
        ("R1", 0, "clf-cbf"), ("R1", 0, "nmpc"), ("R1", 1, "clf-cbf"), ("R1", 1, "nmpc"),
        ("R1", 2, "clf-cbf"),
    ]  # fmt: skip
    assert len(runs) == 10
    assert len({run.key for run in runs}) == 10


def test_ablation_of_the_compensation_needs_a_depth_camera():
    runs = planned(("clf-cbf", "no-compensation"), ("R1",), ("A", "depth-B"), 1, 0)
    assert [(r.method, r.sensor) for r in runs] == [
        ("clf-cbf", "A"), ("clf-cbf", "depth-B"), ("no-compensation", "depth-B"),
    ]  # fmt: skip
    assert runs[-1].spec.sensor == "middle-B"
    with pytest.raises(ConfigurationError, match="same as clf-cbf"):
        execute(Run("R1", "A", "no-compensation", 0, 0))


def test_groups_of_methods():
    assert campaign.methods_of("all") == tuple(METHODS)
    assert campaign.methods_of("paper,ablations") == ("paper", "clf-cbf", *ABLATIONS)
    assert campaign.subsample_of("nmpc=60, paper=5") == {"nmpc": 60, "paper": 5}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--methods", "nmpcc"], "choose from all, ablations, clf-cbf"),
        (["--methods", ","], "no name"),
        (["--regions", "R9"], "choose from R1"),
        (["--sensors", "Q"], "choose ideal, A, B or C"),
        (["--runs", "0"], "--runs must be at least 1"),
        (["--workers", "0"], "--workers"),
        (["--subsample", "nmpc"], "NAME=RUNS"),
        (["--resume"], "--json"),
        (["--json", "/no/such/place.json"], "cannot write"),
        (["report", "/no/such/file.json"], "cannot read"),
    ],
)
def test_refused_before_the_first_run(options, told, capsys, monkeypatch):
    monkeypatch.setattr(campaign, "execute", lambda run: pytest.fail("a run was made"))
    if "--methods" not in options and options[0] != "report":
        options = ["--methods", "pure-pursuit", *options]
    assert command.main(options) == 2
    error = capsys.readouterr().err
    assert error.startswith("docking: ")
    assert told in error


def test_methods_meet_the_same_start_body_and_sensor():
    records = [execute(Run("R3", "A", name, 5, 2)) for name in ("clf-cbf", "pure-pursuit")]
    start = draw_start(region_named("R3"), World(), np.random.default_rng([5, 2, 0]))
    for record in records:
        assert record["track"][0] == pytest.approx(start, abs=6e-4)
        assert (record["region"], record["seed"], record["index"]) == ("R3", 5, 2)
        assert all(
            math.isfinite(float(value))
            for name, value in record.items()
            if isinstance(value, (bool, int, float))
        )
    assert records[0]["controller"] == "clf-cbf"
    assert execute(Run("R3", "A", "pure-pursuit", 5, 2))["e_lat_mm"] == records[1]["e_lat_mm"]


# --- the command --------------------------------------------------------------------------------

QUICK = ["--regions", "R3", "--seed", "5", "--workers", "1"]


def fake(run):
    """A record that depends on the run alone, in no time."""
    rng = np.random.default_rng([run.seed, run.index, len(run.method)])
    success = bool(rng.random() < (0.9 if run.method == "clf-cbf" else 0.4))
    numbers = {
        name: float(rng.normal())
        for name in (
            "e_lon_mm", "e_lat_mm", "e_theta_deg", "time_s", "path_m", "min_fov_margin_deg",
            "fov_lost_s", "blind_s", "chatter_v", "chatter_omega", "step_us_p50", "step_us_p99",
        )
    }  # fmt: skip
    counts = dict.fromkeys(
        ("fov_lost", "view_lost", "limit_violations", "ticks", "infeasible_ticks",
         "guarded_ticks", "unguarded_ticks"), 0,
    )  # fmt: skip
    return {
        "region": run.region, "seed": run.seed, "index": run.index, "sensor": run.sensor,
        "controller": run.method, "outcome": "ok" if success else "miss", "success": success,
        "strict": False, **numbers, **counts, "reason": "" if success else "a | b",
        "track": [[-1.0, 0.1 * run.index, 0.0], [0.0, 0.0, 0.0]],
    }  # fmt: skip


needs_the_extras = pytest.mark.skipif(
    any(importlib.util.find_spec(package) is None for package in ("matplotlib", "tqdm")),
    reason="the campaign draws and counts with the extras viz and cli",
)


@pytest.fixture
def made(monkeypatch):
    """The runs that were made, in no time."""
    runs = []

    def work(run):
        runs.append(run)
        return fake(run)

    monkeypatch.setattr(campaign, "execute", work)
    return runs


@needs_the_extras
def test_a_campaign_of_real_runs(tmp_path, capsys):
    path = tmp_path / "d.json"
    options = [*QUICK, "--methods", "clf-cbf,pure-pursuit", "--runs", "2", "--json", str(path)]
    assert command.main(options) == 0
    assert "2/2" in capsys.readouterr().out
    document = json.loads(path.read_text())
    assert set(document) == {"config", "episodes", "summary", "tracks"}
    assert len(document["episodes"]) == 4
    contract = (
        "region", "controller", "seed", "outcome", "success", "e_lon_mm", "e_lat_mm",
        "e_theta_deg", "time_s", "path_m", "min_fov_margin_deg", "fov_lost", "limit_violations",
        "infeasible_ticks", "guarded_ticks", "step_us_p50", "step_us_p99",
    )  # fmt: skip
    assert all(name in record for record in document["episodes"] for name in contract)
    assert "track" not in document["episodes"][0]
    with path.with_suffix(".csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["controller"] for row in rows] == ["clf-cbf", "pure-pursuit"] * 2
    assert float(rows[0]["e_lat_mm"]) == document["episodes"][0]["e_lat_mm"]
    assert document["summary"]["R3/A/clf-cbf"]["episodes"] == 2


@needs_the_extras
def test_resuming_makes_only_what_is_missing(tmp_path, made):
    path = tmp_path / "d.json"
    base = [*QUICK, "--json", str(path), "--resume"]
    assert command.main([*base, "--methods", "clf-cbf,graceful", "--runs", "3"]) == 0
    assert len(made) == 6
    first = json.loads(path.read_text())
    assert command.main([*base, "--methods", "clf-cbf,graceful", "--runs", "5"]) == 0
    assert len(made) == 10
    assert {run.index for run in made[6:]} == {3, 4}
    assert command.main([*base, "--methods", "aicardi", "--runs", "1"]) == 0
    whole = json.loads(path.read_text())
    assert len(whole["episodes"]) == 11
    assert set(whole["config"]["parameters"]) == {"clf-cbf", "graceful", "aicardi"}
    assert all(record in whole["episodes"] for record in first["episodes"])
    assert first["tracks"].items() <= whole["tracks"].items()


@needs_the_extras
def test_resuming_after_a_change_is_refused(tmp_path, made, capsys):
    path = tmp_path / "d.json"
    base = [*QUICK, "--json", str(path), "--methods", "graceful", "--runs", "1"]
    assert command.main(base) == 0
    assert command.main([*base, "--resume", "--seed", "6"]) == 2
    assert "its seed differs" in capsys.readouterr().err
    document = json.loads(path.read_text())
    document["config"]["parameters"]["graceful"]["k_phi"] = 99.0
    path.write_text(json.dumps(document))
    assert command.main([*base, "--resume"]) == 2
    assert "its parameters differs" in capsys.readouterr().err
    path.write_text('{"a": 1}')
    assert command.main([*base, "--resume"]) == 2
    assert "no result of this benchmark" in capsys.readouterr().err
    path.write_text("")
    assert command.main([*base, "--resume"]) == 0


@needs_the_extras
def test_an_interruption_keeps_what_was_made_and_what_was_there(tmp_path, monkeypatch, capsys):
    path = tmp_path / "d.json"
    base = [*QUICK, "--json", str(path), "--methods", "clf-cbf", "--resume"]
    monkeypatch.setattr(campaign, "execute", fake)
    assert command.main([*base, "--runs", "4"]) == 0
    document = json.loads(path.read_text())
    document["episodes"] = [r for r in document["episodes"] if r["index"] not in (0, 1)]
    path.write_text(json.dumps(document))

    def interrupted(run):
        if run.index == 1:
            raise KeyboardInterrupt
        return fake(run)

    monkeypatch.setattr(campaign, "execute", interrupted)
    assert command.main([*base, "--runs", "4"]) == 130
    assert "--resume" in capsys.readouterr().err
    assert sorted(r["index"] for r in json.loads(path.read_text())["episodes"]) == [0, 2, 3]


@needs_the_extras
def test_report_has_counts_tests_and_figures(tmp_path, made):
    path, out = tmp_path / "d.json", tmp_path / "report"
    options = [*QUICK, "--methods", "graceful,ablations", "--runs", "20", "--json", str(path)]
    assert command.main([*options, "--sensors", "depth-A"]) == 0
    assert command.main(["report", str(path), "--out", str(out)]) == 0
    page = (out / "docking.md").read_text()
    document = json.loads(path.read_text())
    for name in ("clf-cbf", "graceful", "no-guard"):
        cell = document["summary"][f"R3/depth-A/{name}"]
        assert f"{cell['success']}/20 (0)" in page
    ours, theirs = (
        [r["success"] for r in document["episodes"] if r["controller"] == name]
        for name in ("clf-cbf", "graceful")
    )
    test = mcnemar(ours, theirs)
    assert f"| graceful | R3 | 20 | {test.only_first} | {test.only_second} |" in page
    assert "Ours with one part left out" in page
    assert "× a / b" in page
    names = {p.name for p in out.iterdir()}
    for name in ("success", "errors", "ablation"):
        for suffix in (".png", ".svg"):
            assert f"docking-{name}-depth-A{suffix}" in names
    assert "docking-ways-R3-depth-A.svg" in names
    excerpt = json.loads((out / "docking-runs.json").read_text())["episodes"]
    assert len(excerpt) == len(document["episodes"])
    for short, whole in zip(excerpt, document["episodes"], strict=True):
        for key, value in short.items():
            assert value == pytest.approx(whole[key], abs=5e-4)
    assert (out / "docking-success-depth-A.png").read_bytes().startswith(b"\x89PNG")
    kept = [key for key in document["tracks"] if key.startswith("R3/depth-A/graceful")]
    assert 12 <= len(kept) <= 20


def test_the_cap_of_strict_successes_is_what_draws_of_the_calibration_leave():
    model = SensorModel.named("B")
    rng = np.random.default_rng(5)
    once, slow = rng.standard_normal((2, 200_000, 3))
    sizes = [
        np.array([spread.position, spread.position, spread.yaw])
        for spread in (model.calibration, model.drift)
    ]
    for errors, cap in zip(
        (once * sizes[0], once * sizes[0] + slow * sizes[1]), strict_caps("depth-B"), strict=True
    ):
        docked = (np.hypot(errors[:, 0], errors[:, 1]) < 0.01) & (
            np.abs(errors[:, 2]) < math.radians(2.0)
        )
        assert docked.mean() == pytest.approx(cap, abs=0.005)
    assert strict_caps("depth-A") == (1.0, 1.0)


@needs_the_extras
def test_report_without_ours_and_without_runs(tmp_path):
    store = Store(None, 0, ("R1",), ("graceful",))
    assert command.main(["report", "/no/such.json"]) == 2
    store.add(fake(Run("R1", "A", "graceful", 0, 0)))
    assert "No method ran on the same starts as ours." in markdown(store.document())
    empty = tmp_path / "e.json"
    empty.write_text(json.dumps({"config": store.config, "episodes": []}, default=str))
    assert command.main(["report", str(empty)]) == 2


# --- engines ------------------------------------------------------------------------------------


def test_engines():
    runs = planned(("clf-cbf",), ("R1",), ("A",), 3, 0)
    assert list(engine.records("local", 1, runs, fake)) == [fake(run) for run in runs]
    for name, workers, told in (("slurm", 1, "choose from local, dask"), ("local", 0, "workers")):
        with pytest.raises(ConfigurationError, match=told):
            next(engine.records(name, workers, runs, fake))


def test_missing_dask_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(MissingExtraError, match="mc"):
        next(engine.records("dask", 1, [1], fake))


# --- ablations ----------------------------------------------------------------------------------


def altered(name):
    return ABLATIONS[name].method.controller(SETUP).controller


def test_ablations_differ_in_what_they_name_alone():
    ours = METHODS["clf-cbf"].controller(SETUP).controller.config
    base = ours.filter

    barrier = altered("no-barrier").config
    assert barrier.filter.barriers == ()
    assert barrier.filter.guard.barriers == base.guard.barriers
    guard = altered("no-guard").config
    assert guard.filter.barriers == base.barriers
    assert guard.filter.guard.barriers == ()
    assert guard.planner.guard.barriers == base.guard.barriers
    for config in (barrier, guard):
        assert (config.filter.limits, config.filter.lag) == (base.limits, base.lag)
        assert config.gains == ours.gains
    for name in ("no-planner", "no-back-off"):
        config = altered(name).config
        assert config.filter.guard.barriers == base.guard.barriers
        assert type(config.planner) is not type(ours.planner)
        assert config.planner.edge == ours.planner.edge
    assert altered("no-compensation").config.filter == base
    assert altered("no-prediction").controller.config.filter.lag == 0.0


def test_without_back_off_there_is_no_first_leg():
    from clfcbf.errors import PlanningError

    aside = Pose2(-0.4, 0.5, -0.4)
    ours = METHODS["clf-cbf"].controller(SETUP).controller.config.planner
    assert len(ours.plan(aside).legs) == 2
    with pytest.raises(PlanningError):
        altered("no-back-off").config.planner.plan(aside)


def test_without_prediction_the_stamps_are_thrown_away():
    told = []

    class Spy:
        def step(self, observation, applied, now):
            told.append(observation)

    seen = Observation(Pose2(1.0, 0.0, 0.0), Pose2(1.6, 0.0, 0.0), 0.9)
    controller = Unpredicted(Spy())
    controller.step(seen, Twist(0.0, 0.0), 1.0)
    controller.step(None, Twist(0.0, 0.0), 1.1)
    assert told == [replace(seen, stamp=1.0), None]


@settings(max_examples=25)
@given(st.floats(-2.5, -1.0), st.floats(-0.8, 0.8), st.floats(-0.5, 0.5))
def test_sampled_quintic_is_the_quintic(x, y, theta):
    """Its curvature is that of the circle through three neighbouring points."""
    quintic = quintic_to_goal(Pose2(x, y, theta), LIMITS)
    path = sampled(quintic, 1000)
    assert path.poses[0] == pytest.approx((x, y, theta), abs=1e-6)
    assert path.poses[-1][:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert wrap_angle(path.poses[-1][2]) == pytest.approx(0.0, abs=1e-6)
    steps = np.hypot(*np.diff(path.poses[:, :2], axis=0).T)
    assert path.s == pytest.approx(np.concatenate([[0.0], np.cumsum(steps)]))
    for k in range(200, 801, 100):
        a, b, c = (complex(*path.poses[k + j, :2]) for j in (-1, 0, 1))
        area = ((b - a).conjugate() * (c - a)).imag
        menger = 2.0 * area / (abs(b - a) * abs(c - b) * abs(c - a))
        assert path.curvature[k] == pytest.approx(menger, abs=2e-3 * (1.0 + abs(menger)))


def test_quintic_planner_ends_at_the_goal_within_the_limits():
    plan = altered("no-planner").config.planner.plan(Pose2(-1.8, 0.4, 0.1))
    assert plan.rollout.arrived
    assert math.hypot(*plan.rollout.error[:2]) < 0.01
    (leg,) = plan.legs
    assert max(leg.speed) <= LIMITS.v_max + 1e-9
    assert max(map(abs, leg.turn_rate)) <= LIMITS.omega_max + 1e-9
