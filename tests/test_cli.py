"""The command line as its users meet it: options, files, exit statuses."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from clfcbf import cli, defaults
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Twist
from clfcbf.simulation import campaign
from clfcbf.simulation.campaign import CONTROLLERS, PLANTS, EpisodeSpec
from clfcbf.simulation.scenarios import LIMITS, REGIONS, World

for package in ("tyro", "tqdm", "matplotlib"):
    pytest.importorskip(package, reason="the command line needs the extras cli and viz")

FAST = ["approach", "--poses", "2", "--plant", "kinematic", "--workers", "1"]

TEXT = ("region", "controller", "outcome")
NUMBERS = (
    "seed", "success", "e_lon_mm", "e_lat_mm", "e_theta_deg", "time_s", "path_m",
    "min_fov_margin_deg", "fov_lost", "limit_violations", "infeasible_ticks", "guarded_ticks",
    "step_us_p50", "step_us_p99",
)  # fmt: skip


def load(path: Path) -> dict[str, Any]:
    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is not JSON")

    document: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return document


def assert_contract(document: dict[str, Any], runs: int) -> None:
    assert set(document) == {"config", "episodes", "summary"}
    assert len(document["episodes"]) == document["summary"]["episodes"] == runs
    for episode in document["episodes"]:
        assert all(isinstance(episode[name], str) for name in TEXT)
        for name in NUMBERS:
            assert isinstance(episode[name], int | float), name
            assert math.isfinite(episode[name]), name
        assert "track" not in episode


@pytest.fixture
def no_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """What has to be refused before the campaign fails the test if the campaign starts."""

    def started(*_: Any) -> Any:
        raise AssertionError("the campaign was started")

    monkeypatch.setattr(campaign, "run_specs", started)


def test_two_runs_write_the_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.json"
    path.touch()
    assert cli.main([*FAST, "--seed", "3", "--json", str(path)]) == 0
    document = load(path)
    assert_contract(document, 2)
    config = document["config"]
    assert config["config_hash"] == defaults.fingerprint()
    assert config["poses"] == 2
    assert config["seed"] == 3
    assert config["versions"]["python"] == ".".join(map(str, sys.version_info[:3]))
    # the same runs, made without the command line
    for index, episode in enumerate(document["episodes"]):
        alone = campaign.record(EpisodeSpec(seed=3, index=index))
        for name in (*TEXT, *NUMBERS[:-2]):
            assert episode[name] == alone[name], name
    captured = capsys.readouterr()
    assert "2 runs from R1" in captured.out
    assert captured.err == ""  # no progress bar away from a terminal
    assert list(tmp_path.iterdir()) == [path]


def test_overwrites_and_workers_change_nothing(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    path.write_text("x" * 100_000)
    assert cli.main([*FAST[:-1], "2", "--json", str(path)]) == 0
    shared = load(path)["episodes"]
    assert cli.main([*FAST, "--json", str(path)]) == 0
    alone = load(path)["episodes"]
    for one, other in zip(shared, alone, strict=True):
        assert all(one[name] == other[name] for name in one if not name.startswith("step_us"))


def test_ideal_runs_meet_the_strict_tolerance(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    assert cli.main([*FAST, "--ideal", "--json", str(path)]) == 0
    document = load(path)
    assert document["config"]["ideal"] is True
    for episode in document["episodes"]:
        assert math.hypot(episode["e_lon_mm"], episode["e_lat_mm"]) < 10.0
        assert episode["limit_violations"] == 0


def test_plot_beside_json(tmp_path: Path) -> None:
    picture, path = tmp_path / "runs.png", tmp_path / "out.json"
    assert cli.main([*FAST, "--plot", str(picture), "--json", str(path)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG\r\n")
    assert picture.stat().st_size > 50_000
    assert_contract(load(path), 2)


def test_run_cut_short_is_complete(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, picture = tmp_path / "out.json", tmp_path / "runs.svg"
    options = cli.Approach(poses=3, plant="kinematic", workers=1, json=path, plot=picture)
    assert cli.approach(options, World(patience=0.3)) == 0
    document = load(path)
    assert_contract(document, 3)
    assert {episode["outcome"] for episode in document["episodes"]} == {"timeout"}
    assert document["summary"]["success"] == 0
    out = capsys.readouterr().out
    assert "0/3" in out
    assert "timeout 3" in out
    assert picture.stat().st_size > 10_000


def test_controller_that_never_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    build = campaign._controller

    class Still:
        def __init__(self, *args: Any) -> None:
            self._inner = build(*args)

        def step(self, *args: Any) -> Any:
            return self._inner.step(*args)._replace(twist=Twist(0.0, 0.0), done=False)

    monkeypatch.setattr(campaign, "_controller", Still)
    path = tmp_path / "out.json"
    options = cli.Approach(poses=2, plant="kinematic", ideal=True, workers=1, json=path)
    assert cli.approach(options, World(patience=2.0)) == 0
    document = load(path)
    assert_contract(document, 2)
    for episode in document["episodes"]:
        assert not episode["success"]
        assert episode["time_s"] == episode["path_m"] == 0.0
        assert episode["e_lon_mm"] < -1000.0
    assert "0/2" in capsys.readouterr().out


@pytest.mark.usefixtures("no_runs")
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--poses", "0"], "--poses must be at least 1, got 0"),
        (["--workers", "-1"], "--workers must be at least 1, got -1"),
        (["--seed", "-1"], "--seed must be at least 0, got -1"),
        (["--region", "R99"], "unknown region 'R99'; choose from R1,"),
        (["--controller", "pid"], "unknown controller 'pid'; choose from clf-cbf, paper"),
        (["--plant", "gazebo"], "unknown plant 'gazebo'; choose from kinematic, mujoco"),
        (["--sensor", "Z"], "unknown sensor level 'Z'; choose ideal, A, B or C"),
        (["--limits", "none"], "unknown limits 'none'; choose from approaching, docking"),
        (["--backend", "guess"], "guess"),
        (["--json", "/"], "cannot write '/'"),
        (["--json", "/no/such/place/out.json"], "cannot write '/no/such/place/out.json'"),
        (["--plot", "/no/such/place/out.png"], "cannot write '/no/such/place/out.png'"),
        (["--plot", "runs.gif"], "must be one of .png, .svg, .pdf"),
    ],
)
def test_refused_before_the_first_run(
    options: list[str], told: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert cli.main([*FAST, *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("clfcbf: ")
    assert captured.err.count("\n") == 1
    assert told in captured.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_runs")
@pytest.mark.parametrize(
    ("module", "told"), [("tyro", "clfcbf[cli]"), ("matplotlib.figure", "clfcbf[viz]")]
)
def test_missing_extra_is_named(
    module: str, told: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setitem(sys.modules, module, None)
    assert cli.main([*FAST, "--plot", str(tmp_path / "runs.png")]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "argv", [[], ["land"], ["approach", "--poses", "many"], ["approach", "-x"]]
)
def test_parser_errors(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(argv) == 2
    assert capsys.readouterr().err != ""


def test_help_names_every_choice(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    assert "approach" in capsys.readouterr().out
    assert cli.main(["approach", "--help"]) == 0
    shown = capsys.readouterr().out
    for option in fields(cli.Approach):
        assert f"--{option.name}" in shown
    for choice in (*REGIONS, *CONTROLLERS, *PLANTS, *LIMITS, "ideal", ".png", ".svg", ".pdf"):
        assert choice in shown


def test_interrupt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(campaign, "run_specs", interrupted)
    assert cli.main(FAST) == 130
    assert capsys.readouterr().err == "clfcbf: interrupted\n"


def test_default_options() -> None:
    options = cli.Approach()
    assert (options.poses, options.seed, options.plant) == (30, 0, "mujoco")
    assert options.workers == cli.usable_cores() >= 1
    assert len({(spec.seed, spec.index) for spec in options.specs}) == 30


def test_workers_of_a_campaign_are_checked() -> None:
    with pytest.raises(ConfigurationError, match="workers must be at least 1, got 0"):
        next(campaign.run_specs([EpisodeSpec()], 0))
