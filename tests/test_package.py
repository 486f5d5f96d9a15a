"""What an installation promises: a light, silent import, its names, its types, its version."""

import ast
import importlib.metadata
import inspect
import re
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

import clfcbf

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

HEAVY = (
    "can", "canopen", "casadi", "cbfpy", "clarabel", "control", "cvxpy", "cyclonedds", "daqp",
    "highspy", "jax", "joblib", "matplotlib", "mcap", "mujoco", "osqp", "proxsuite", "qpsolvers",
    "quadprog", "rclpy", "scipy", "tqdm", "tyro", "zstandard",
)  # fmt: skip

FRESH = f"""
import sys
before = set(sys.modules)
{{imports}}
heavy = set(sys.modules) & set({HEAVY!r})
assert not heavy, sorted(heavy)
"""

EVERYTHING = """
import importlib, pkgutil, clfcbf
found = [m.name for m in pkgutil.walk_packages(clfcbf.__path__, "clfcbf.")]
assert len(found) > 20, found
for name in found:
    if not name.endswith("__main__"):
        importlib.import_module(name)
"""

PUBLIC = {
    "Barrier", "Chassis", "ClfcbfError", "Decision", "DockingController", "FieldOfView", "Limits",
    "Observation", "Pose2", "QpSolution", "QpStatus", "QuadraticProgram", "Reference",
    "SafetyFilter", "Scene", "Status", "TargetSensor", "TrackingController", "Twist",
    "available_backends", "solve_qp",
}  # fmt: skip


def run_fresh(code):
    """Run ``code`` in a new interpreter in which every warning is an error."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize("imports", ["import clfcbf", EVERYTHING], ids=["clfcbf", "every module"])
def test_import_is_light_and_silent(imports):
    outcome = run_fresh(FRESH.format(imports=imports))
    assert outcome.returncode == 0, outcome.stderr
    assert (outcome.stdout, outcome.stderr) == ("", "")


def test_the_check_sees_a_heavy_import():
    outcome = run_fresh(FRESH.format(imports="import clfcbf, scipy"))
    assert outcome.returncode != 0
    assert "['scipy']" in outcome.stderr


def test_import_leaves_global_state_alone():
    code = """
import random, warnings
import numpy as np
def state():
    return (
        np.geterr(), repr(np.get_printoptions()), repr(np.random.get_state()),
        repr(random.getstate()), repr(warnings.filters),
    )
before = state()
import clfcbf
assert state() == before
"""
    outcome = run_fresh(code)
    assert outcome.returncode == 0, outcome.stderr


def test_public_names():
    names = clfcbf.__all__
    assert len(names) == len(set(names))
    assert set(names) >= PUBLIC
    for name in names:
        assert getattr(clfcbf, name) is not None
    namespace = {}
    exec("from clfcbf import *", namespace)
    assert set(names) <= set(namespace)


def test_public_names_are_documented():
    for name in clfcbf.__all__:
        thing = getattr(clfcbf, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), name


def test_types_are_shipped():
    assert files("clfcbf").joinpath("py.typed").is_file()


def test_version_is_that_of_the_distribution():
    assert clfcbf.__version__ == importlib.metadata.version("clfcbf")
    assert re.fullmatch(r"\d+\.\d+\.\d+", clfcbf.__version__)


def test_command_is_installed():
    (entry,) = importlib.metadata.entry_points(group="console_scripts", name="clfcbf")
    assert callable(entry.load())


def test_requirements_are_few():
    """Without extras: numpy, and two packages that are imported only when used."""
    base = {re.split(r"[\s<>=!~\[;]", name)[0] for name in PROJECT["dependencies"]}
    assert base == {"numpy", "daqp", "qpsolvers"}


def test_every_extra_named_in_an_error_exists():
    """``MissingExtraError(package, extra)``: the advice it prints can be followed."""
    extras = PROJECT["optional-dependencies"]
    named = set()
    for path in (ROOT / "clfcbf").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "MissingExtraError":
                extra = node.args[1]
                if isinstance(extra, ast.Constant):
                    named.add(extra.value)
    assert named
    assert named <= set(extras)


def test_all_holds_every_extra_of_a_user():
    (everything,) = PROJECT["optional-dependencies"]["all"]
    listed = set(re.fullmatch(r"clfcbf\[(.*)\]", everything).group(1).split(","))
    assert listed == set(PROJECT["optional-dependencies"]) - {"all", "test", "dev", "docs"}


def test_citation_agrees_with_the_project():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", text, re.MULTILINE).group(1) == PROJECT["version"]
    assert re.search(r"^license: (.*)$", text, re.MULTILINE).group(1) == PROJECT["license"]
    assert "arXiv:2401.08433" in text


def test_changelog_has_this_version():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{PROJECT['version']}]" in text
