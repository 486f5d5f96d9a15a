"""The examples run, are short, and show what they say."""

from __future__ import annotations

import importlib.util
import itertools
import math
import os
import sys
from pathlib import Path

import pytest

from clfcbf import Pose2, Twist
from clfcbf.runtime import Ending

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_examples_are_tested_here():
    assert NAMES == ["dock_can", "dock_mujoco", "dock_ros2", "filter_cmd_vel", "jitter"]


@pytest.mark.parametrize("name", NAMES)
def test_short(name):
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) < 60


def test_mujoco_robot_docks_through_the_loop(capsys):
    pytest.importorskip("mujoco", reason="needs the extra sim")
    module = example("dock_mujoco")
    report, pose = module.dock(Pose2(-1.5, 0.3, 0.0), simulated=True)
    assert report.ending is Ending.DONE
    assert math.hypot(pose.x, pose.y) < 0.010
    assert abs(pose.theta) < math.radians(2.0)
    assert report.statistics.missed == 0
    assert 0.06 <= report.statistics.latency.p50 <= 0.15
    module.main(["--simulated"])
    assert capsys.readouterr().out.startswith("done: ")


def test_mujoco_robot_is_driven_in_real_time(monkeypatch):
    """The first second of it: the body moves as long as the wall clock says."""
    pytest.importorskip("mujoco", reason="needs the extra sim")
    module = example("dock_mujoco")
    ticks = []

    class Short(module.ControlLoop):
        def __init__(self, *parts, **options):
            super().__init__(*parts, **options, on_tick=ticks.append)

        def run(self, duration):
            return super().run(1.0)

    monkeypatch.setattr(module, "ControlLoop", Short)
    report, pose = module.dock(Pose2(-1.5, 0.0, 0.0), simulated=False)
    assert report.ending is Ending.TIMEOUT
    assert pose.x > -1.49
    for before, after in itertools.pairwise(ticks):
        assert after.sent - before.sent > 0.0
    gaps = [after.sent - before.sent for before, after in itertools.pairwise(ticks)]
    assert sum(gaps) / len(gaps) >= 1.0 / 30.0 - 1e-3


def test_mujoco_robot_docks_and_undocks_through_ros_topics(monkeypatch):
    pytest.importorskip("mujoco", reason="needs the extra sim")
    pytest.importorskip("cyclonedds", reason="needs the extra dds")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 200))
    module = example("dock_ros2")
    (docked, at), (undocked, out) = module.dock(Pose2(-1.5, 0.3, 0.0), simulated=True)
    assert docked["success"], docked
    assert math.hypot(at.x, at.y) < 0.010
    assert abs(at.theta) < math.radians(2.0)
    assert undocked["success"], undocked
    assert math.dist(at[:2], out[:2]) == pytest.approx(0.7, abs=0.05)


def test_filter_keeps_the_view_and_stops_with_its_source(capsys):
    ticks = example("filter_cmd_vel").main()
    assert max(tick.command.v for tick in ticks) > 0.15
    assert min(tick.decision.clearance for tick in ticks[10:]) > 0.0
    assert ticks[-1].command == Twist(0.0, 0.0)
    lines = capsys.readouterr().out.splitlines()
    assert all("left" in line for line in lines)
    assert len(lines) == math.ceil(len(ticks) / 15)


def test_jitter_measures_and_puts_things_back(capsys):
    usual = sys.getswitchinterval()
    found = example("jitter").main(0.1)
    assert sys.getswitchinterval() == usual
    assert next(iter(found)) == "alone"
    assert len(found) == len(capsys.readouterr().out.splitlines()) == 4
    assert all(statistics.ticks >= 1 for statistics in found.values())
