"""Tuning: an objective in the order it promises, one budget for all, and a search that resumes."""

import importlib.util
import itertools
import json
import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import tuning
from benchmarks.baselines import METHODS, method_named
from benchmarks.tuning import Outcome, Plan, evaluate, main, read_tuned, tune, tuned_parameters
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.simulation.campaign import simulate

LONGEST = 61.0
AICARDI = method_named("aicardi")

needs_optuna = pytest.mark.skipif(
    importlib.util.find_spec("optuna") is None, reason="Optuna is not installed"
)

runs = st.lists(
    st.tuples(st.booleans(), st.booleans(), st.floats(0.0, LONGEST)).map(
        lambda run: (run[0], run[0] and run[1], run[2])
    ),
    min_size=5,
    max_size=5,
)


@given(runs, runs)
def test_the_objective_is_success_then_strict_then_time(first, second):
    a, b = Outcome.of(first, LONGEST), Outcome.of(second, LONGEST)

    def order(outcome):
        return -outcome.success, -outcome.strict, outcome.time_s

    if order(a)[:2] != order(b)[:2]:
        assert (a.objective < b.objective) == (order(a) < order(b))
    elif abs(a.time_s - b.time_s) > 1e-6:
        assert (a.objective < b.objective) == (a.time_s < b.time_s)


def test_a_failed_run_counts_the_whole_patience():
    outcome = Outcome.of([(True, True, 10.0), (False, False, 2.0)], LONGEST)
    assert outcome.time_s == pytest.approx(0.5 * (10.0 + LONGEST))
    assert (outcome.runs, outcome.success, outcome.strict) == (2, 1, 1)


def test_the_starts_are_the_same_for_all_and_of_no_campaign():
    plan = Plan(starts=7)
    assert plan.specs == Plan(trials=3, starts=7).specs
    assert [spec.region for spec in plan.specs] == ["R1", "R3", "R4", "R1", "R3", "R4", "R1"]
    streams = {tuple(spec.stream(0).uniform(size=3)) for spec in plan.specs}
    assert len(streams) == 7
    assert all(spec.seed == tuning.SEED > 10**9 for spec in plan.specs)


def test_what_is_evaluated_is_the_run_of_that_start():
    plan = Plan(starts=1, regions=("R3",))
    quick = AICARDI.parameters({"gamma": 2.0})
    outcome = evaluate(AICARDI, quick, plan)
    (spec,) = plan.specs
    result, _ = simulate(
        spec,
        make=lambda world, limits, lag: AICARDI.controller(
            tuning.Setup.of(world, limits, lag), quick
        ),
    )
    assert outcome.success == result.success
    assert outcome.time_s == (result.time_s if result.success else LONGEST)


def quadratic(method, parameters, plan, mapper=map):
    """An objective with its minimum at gamma 0.5, k 3, in place of the runs."""
    error = math.log(parameters.gamma / 0.5) ** 2 + math.log(parameters.k / 3.0) ** 2
    return Outcome(plan.starts, plan.starts, plan.starts, error, error)


@needs_optuna
def test_the_search_starts_at_stock_improves_on_it_and_resumes(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "evaluate", quadratic)
    journal, told = tmp_path / "journal.log", []
    first = tune(AICARDI, Plan(trials=12, starts=4), journal, progress=lambda n, _: told.append(n))
    assert told == list(range(1, 13))
    assert first["trials"] == 12
    more = tune(AICARDI, Plan(trials=30, starts=4), journal, progress=lambda n, _: told.append(n))
    assert told == list(range(1, 31))
    assert more["stock"]["objective"] == pytest.approx(math.log(2.0) ** 2 + math.log(3.0) ** 2)
    assert more["tuned"]["objective"] < 0.3 * more["stock"]["objective"]
    assert more["tuned"]["objective"] <= first["tuned"]["objective"]
    assert tune(AICARDI, Plan(trials=30, starts=4), journal) == more
    with pytest.raises(ConfigurationError, match="other starts"):
        tune(AICARDI, Plan(trials=40, starts=5), journal)
    study = tuning._study(tuning._optuna(), AICARDI, Plan(starts=4), journal)
    assert study.trials[0].params == more["stock_parameters"]
    drawn = [tuple(trial.params.values()) for trial in study.trials]
    assert len(set(drawn)) == 30


@needs_optuna
def test_values_that_do_not_go_together_lose_and_are_remembered(tmp_path, monkeypatch):
    def refusing(method, parameters, plan, mapper=map):
        if parameters.gamma != AICARDI.stock.gamma:
            raise ConfigurationError("no")
        return quadratic(method, parameters, plan)

    monkeypatch.setattr(tuning, "evaluate", refusing)
    result = tune(AICARDI, Plan(trials=4, starts=2))
    assert result["best_trial"] == 0
    assert result["parameters"] == result["stock_parameters"]


@needs_optuna
def test_the_command_tunes_and_its_file_is_read_back(tmp_path, capsys):
    out, journal = tmp_path / "tuned", tmp_path / "journal.log"
    command = [
        "--methods", "aicardi", "--trials", "2", "--starts", "2", "--regions", "R3",
        "--workers", "1", "--storage", str(journal), "--out", str(out),
    ]  # fmt: skip
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "stock" in printed
    assert "tuned" in printed
    found = read_tuned("aicardi", out)
    assert found["plan"]["starts"] == found["tuned"]["runs"] == found["stock"]["runs"] == 2
    assert found["tuned"]["objective"] <= found["stock"]["objective"]
    parameters = tuned_parameters("aicardi", out)
    assert {name: getattr(parameters, name) for name in AICARDI.space} == found["parameters"]
    assert evaluate(AICARDI, parameters, Plan(starts=2, regions=("R3",))) == Outcome(
        **found["tuned"]
    )


@pytest.mark.parametrize(
    "arguments",
    [["--methods", "none"], ["--trials", "0"], ["--workers", "0"], ["--regions", "R99"]],
)
def test_what_cannot_run_is_told(arguments, capsys, tmp_path):
    assert main([*arguments, "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("tuning: ")


def test_without_optuna_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[bench\]"):
        tune(AICARDI, Plan(trials=1, starts=1))


def test_a_file_that_is_none_or_of_another_space_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no tuned parameters"):
        read_tuned("aicardi", tmp_path)
    (tmp_path / "aicardi.json").write_text('{"parameters": {"gamma": 99.0}}', encoding="utf-8")
    with pytest.raises(ConfigurationError, match="must be in"):
        tuned_parameters("aicardi", tmp_path)


@pytest.mark.parametrize("path", sorted(tuning.TUNED.glob("*.json")), ids=lambda path: path.stem)
def test_committed_parameters_are_valid_and_no_worse_than_stock(path):
    found = json.loads(path.read_text(encoding="utf-8"))
    assert found["method"] == path.stem
    tuned_parameters(path.stem)
    assert found["tuned"]["objective"] <= found["stock"]["objective"]
    space = {name: range_._asdict() for name, range_ in METHODS[path.stem].space.items()}
    assert found["space"] == space


def test_every_method_can_be_tuned():
    for method, share in itertools.product(METHODS.values(), (0.0, 1.0)):
        values = {name: (r.low, r.high)[int(share)] for name, r in method.space.items()}
        assert values
        method.parameters(values)
