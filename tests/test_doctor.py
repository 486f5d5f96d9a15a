"""The doctor: it survives broken packages, tells them from sound ones, and does not flatter."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from clfcbf import available_backends, cli
from clfcbf.decision import Status
from clfcbf.doctor import (
    Examination,
    Package,
    Probe,
    check_packages,
    examination,
    examine,
    licence_of,
    packages,
    probe,
    table,
    timing,
)
from clfcbf.doctor.examination import problems_of
from clfcbf.explain import explain
from clfcbf.qp import QpSolution, QpStatus, QuadraticProgram, get_backend

needs_cli = pytest.mark.skipif(
    importlib.util.find_spec("tyro") is None, reason="the command line needs the extra cli"
)

ROOT = Path(__file__).parents[1]

# Code in an interpreter of its own --------------------------------------------------------------


def test_probe_gives_the_last_line_and_passes_arguments() -> None:
    outcome = probe("import sys; print('noise'); print(sys.argv[1:])", "a b", "c")
    assert outcome == ("['a b', 'c']", "")


@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("raise ValueError('no licence file')", "ValueError: no licence file"),
        ("import sys; sys.exit(3)", "ended with status 3"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "crashed with SIGSEGV"),
        ("import os; os.write(2, b'\\xff bad'); os._exit(1)", "\ufffd bad"),
    ],
)
def test_probe_says_how_it_failed(code: str, error: str) -> None:
    assert probe(code) == ("", error)


def test_probe_does_not_wait_for_what_hangs() -> None:
    assert probe("while True: pass", time_limit=0.3) == ("", "no answer in 0.3 s")


# Packages ---------------------------------------------------------------------------------------


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory of packages that this interpreter and those it starts look into."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


def make_package(site: Path, name: str, code: str = "", about: str = "") -> None:
    (site / f"{name}.py").write_text(code, encoding="utf-8")
    info = site / f"{name}-1.2.3.dist-info"
    info.mkdir()
    text = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2.3\n{about}"
    (info / "METADATA").write_text(text, encoding="utf-8")


def test_broken_packages_are_reported_not_suffered(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packages, "_ALSO", {})
    monkeypatch.setattr(packages, "_requirements", lambda: {"sound": "", "absent": "solvers"})
    make_package(site, "sound", about="License: MIT\n")
    make_package(site, "missing_part", "import no_such_module")
    make_package(site, "crashing", "import os, signal; os.kill(os.getpid(), signal.SIGABRT)")
    make_package(site, "hanging", "while True: pass")
    found = check_packages(("missing_part", "crashing", "hanging"), time_limit=2.0)
    assert [package.name for package in found] == [
        "absent", "crashing", "hanging", "missing_part", "sound",
    ]  # fmt: skip
    absent, crashing, hanging, missing_part, sound = found
    assert sound == Package("sound", "sound", "", True, "1.2.3", "MIT", "")
    assert absent == Package("absent", "absent", "solvers", False, "", "", "not installed")
    assert crashing.error == "crashed with SIGABRT"
    assert hanging.error == "no answer in 2 s"
    assert missing_part.error == "ModuleNotFoundError: No module named 'no_such_module'"
    assert problems_of(found, (), ()) == [
        "crashing is installed but does not import: crashed with SIGABRT",
        "hanging is installed but does not import: no answer in 2 s",
        "missing_part is installed but does not import: "
        "ModuleNotFoundError: No module named 'no_such_module'",
    ]


@pytest.mark.parametrize(
    ("about", "licence"),
    [
        ("License-Expression: BSD-3-Clause\nLicense: something else\n", "BSD-3-Clause"),
        ("License: MIT\nClassifier: License :: OSI Approved :: MIT License\n", "MIT"),
        ("Classifier: License :: OSI Approved :: Apache Software License\n",
         "Apache Software License"),
        ("License: Copyright 2026 A. Author\n        Licensed under the X License, version 2\n",
         "Licensed under the X License, version 2"),
        ("License: The Very Long Name of a Licence That Was Written Out\nClassifier: "
         "License :: OSI Approved :: ISC License (ISCL)\n", "ISC License (ISCL)"),
        ("License: The Very Long Name of a Licence That Was Written Out\nClassifier: "
         "License :: OSI Approved\n", "The Very Long Name of a Licence That Was Written Out"),
        ("", "not stated"),
    ],
)  # fmt: skip
def test_licence_is_the_most_exact_that_the_metadata_has(
    about: str, licence: str, site: Path
) -> None:
    make_package(site, "licensed", about=about)
    assert licence_of("licensed") == licence


def test_licence_of_what_is_not_installed() -> None:
    with pytest.raises(metadata.PackageNotFoundError):
        licence_of("no-such-package")


def test_requirements_are_those_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = packages._requirements()
    assert {name for name, extra in found.items() if not extra} == {"numpy", "daqp", "qpsolvers"}
    assert set(found.values()) <= {"", *project["optional-dependencies"]} - {"all", "dev", "test"}
    wanted = {"osqp", "clarabel", "proxsuite", "casadi", "cbfpy", "matplotlib", "tyro", "tqdm"}
    assert wanted | {"control", "mujoco-core"} <= set(found)
    assert not {"pytest", "ruff", "clfcbf"} & set(found)


# Timings ----------------------------------------------------------------------------------------


def test_program_is_that_of_a_tick_in_which_something_holds() -> None:
    decision = timing._decided()
    assert decision.status is Status.OPTIMAL
    assert [row.name for row in explain(decision).active_rows] == ["fov.left"]
    problem = timing.program_of(decision)
    assert decision.answer is not None
    found = minimize(
        lambda u: 0.5 * u @ problem.P @ u + problem.q @ u,
        decision.box[::2],
        jac=lambda u: problem.P @ u + problem.q,
        bounds=list(zip(problem.lb, problem.ub, strict=True)),
        constraints={"type": "ineq", "fun": lambda u: problem.h - problem.G @ u},
        method="SLSQP",
        options={"ftol": 1e-15},
    )
    assert found.x == pytest.approx((decision.answer.v, decision.answer.omega), abs=1e-6)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "SOLVES", 5)
    monkeypatch.setattr(timing, "WARM_UP", 1)


@pytest.mark.parametrize("name", ["exact", "daqp"])
@pytest.mark.usefixtures("quick")
def test_backend_is_timed_and_compared(name: str) -> None:
    record = timing.time_backend(name)
    assert record["agrees"] is True
    assert record["distance"] <= 1e-9
    assert record["solves"] == 5
    assert 0.0 < record["median_us"] < 1e6
    capability = get_backend(name).capability
    assert (record["package"], record["licence"]) == (capability.package, capability.licence)
    assert record["max_variables"] == capability.max_variables


@pytest.mark.parametrize(
    ("shift", "agrees"), [((1e-9, 0.0), True), ((0.0, 1e-5), False), (None, False)]
)
@pytest.mark.usefixtures("quick")
def test_a_backend_that_errs_does_not_agree(
    shift: tuple[float, float] | None, agrees: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = get_backend("exact")

    class Erring:
        name = "erring"
        capability = exact.capability

        def solve(self, problem: QuadraticProgram) -> QpSolution:
            right = exact.solve(problem).x
            assert right is not None
            if shift is None:
                return QpSolution(None, QpStatus.UNBOUNDED, "erring")
            return QpSolution(right + np.array(shift), QpStatus.OPTIMAL, "erring")

    monkeypatch.setattr(timing, "get_backend", lambda name: exact if name == "exact" else Erring())
    record = timing.time_backend("erring")
    assert record["agrees"] is agrees
    if shift is None:
        assert record["distance"] is None
    else:
        assert record["distance"] == pytest.approx(math.hypot(*shift), rel=1e-3)
    (problem,) = problems_of((), [{"name": "erring", "error": "", **record}], ()) or [""]
    assert bool(problem) is not agrees


@pytest.mark.usefixtures("quick")
def test_what_is_printed_is_one_line_of_json(capsys: pytest.CaptureFixture[str]) -> None:
    print("a solver's banner", end="")
    timing.report_timing("SafetyFilter tick")
    last = capsys.readouterr().out.splitlines()[-1]
    assert set(json.loads(last)) == {"median_us", "solves"}
    timing.report_backend("exact")
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["agrees"] is True


def test_a_slow_solver_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "LONGEST", 0.0)
    calls: list[None] = []
    median, solves = timing._median_us(lambda: calls.append(None))
    assert (len(calls), solves) == (2, 1)
    assert median > 0.0


# The whole --------------------------------------------------------------------------------------


@pytest.fixture
def few_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """The imports of large packages take seconds each and are not the subject here."""
    monkeypatch.setattr(packages, "_ALSO", {"piqp": ""})
    monkeypatch.setattr(packages, "_requirements", lambda: {"numpy": "", "no-such-solver": "cli"})


@needs_cli
@pytest.mark.usefixtures("few_packages")
def test_command_prints_and_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(examination, "available_backends", lambda: ("exact", "daqp", "no-such"))
    path = tmp_path / "doctor.json"
    assert cli.main(["doctor", "--json", str(path)]) == 0
    captured = capsys.readouterr()
    document = json.loads(path.read_text(encoding="utf-8"))
    assert set(document) == {"system", "packages", "backends", "timings", "problems"}
    assert document["system"]["python"] == ".".join(map(str, sys.version_info[:3]))
    assert document["system"]["numpy"] == np.__version__
    assert document["system"]["usable_cores"] >= 1
    exact, daqp, missing = document["backends"]
    assert exact["agrees"] is daqp["agrees"] is True
    assert missing["agrees"] is None
    assert "no backend is called 'no-such'" in missing["error"]
    assert [record["name"] for record in document["timings"]] == [
        "exact solve",
        "SafetyFilter tick",
    ]
    assert all(record["median_us"] > 0.0 for record in document["timings"])
    assert {package["name"] for package in document["packages"]} == {
        "daqp", "no-such-solver", "numpy", "piqp",
    }  # fmt: skip
    (problem,) = document["problems"]
    assert problem.startswith("backend 'no-such' is available but fails: ")
    assert captured.out.rstrip().endswith(problem)
    for name in ("numpy", "no-such-solver", "exact", "daqp", "SafetyFilter tick"):
        assert f"\n{name} " in captured.out, name


@needs_cli
def test_command_refuses_a_file_it_cannot_write_before_it_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def started() -> Examination:
        raise AssertionError("the examination was started")

    monkeypatch.setattr(cli.doctor, "examine", started)
    path = tmp_path / "missing" / "doctor.json"
    assert cli.main(["doctor", "--json", str(path)]) == cli.USAGE_ERROR
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.usefixtures("few_packages")
def test_backends_are_those_available(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def fail(code: str, name: str, **_: Any) -> Probe:
        asked.append(name)
        return packages.probe("raise RuntimeError('broken')")

    monkeypatch.setattr(examination, "probe", fail)
    found = examine()
    assert asked == [*timing.TIMINGS, *available_backends()]
    assert [record["name"] for record in found.backends] == list(available_backends())
    assert len(found.problems) == len(asked)
    assert "exact solve fails: RuntimeError: broken" in found.problems
    assert "RuntimeError: broken" in table(found)


def test_what_is_no_result_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "probe", lambda *_, **__: packages.probe("print('hello')"))
    record = examination._measured("report_timing", "exact solve", ("median_us",), 9.0)
    assert record["error"] == "printed 'hello' in place of a result"
    assert record["median_us"] is None


def test_required_and_missing() -> None:
    missing = Package("numpy", "numpy", "", True, "", "", "not installed")
    optional = Package("osqp", "osqp", "solvers", False, "", "", "not installed")
    assert problems_of([missing, optional], (), ()) == ["numpy is required and not installed"]
    system = examination._system()
    found = Examination(system, (missing, optional), (), (), ())
    assert table(found).endswith("no problems found")
    assert "osqp" in table(found)
