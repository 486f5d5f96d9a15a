"""The campaigns on a whole robot, short, and that they would notice."""

from __future__ import annotations

import json
import math
import time

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim")
pytest.importorskip("mcap", reason="needs the extra record")
pytest.importorskip("tqdm", reason="needs the extra cli")

from benchmarks.robot import __main__ as robot
from benchmarks.robot import docks, fuzz, fuzz_configs, kills, realtime
from benchmarks.robot.casualties import Cable
from benchmarks.robot.mutation import leaves, mutated_bytes, mutated_tree
from benchmarks.robot.rig import VIAS, Setting, make_rig
from benchmarks.robot.witness import Witness
from clfcbf import Pose2, Twist
from clfcbf.errors import ConfigurationError
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World

PERIOD = 1.0 / 30.0
LIMIT = LIMITS["approaching"]


# The witness ------------------------------------------------------------------------------------


def witness(body=None):
    start = Pose2(-1.5, 0.0, 0.0)
    plant = KinematicPlant(start, LIMIT, body or Body.ideal(), np.random.default_rng(0))
    return Witness(plant, World(), LIMIT, PERIOD)


def drive(seen, commands):
    for command in commands:
        seen.send(Twist(*command))
        seen.advance(PERIOD)


def ramp(step, ticks=20):
    return [(min(0.22, step * k), 0.0) for k in range(1, ticks)]


@pytest.mark.parametrize(("share", "held"), [(1.0, True), (0.5, True), (1.4, False)])
def test_the_witness_tells_accelerations_beyond_the_limits(share, held):
    seen = witness()
    drive(seen, ramp(share * LIMIT.a_max * PERIOD))
    assert seen.within_limits is held


@pytest.mark.parametrize("command", [(0.25, 0.0), (-0.25, 0.0), (0.0, 0.45)])
def test_the_witness_tells_speeds_beyond_the_limits(command):
    seen = witness()
    shares = np.linspace(0.0, 1.0, 40)[:, None]
    drive(seen, (shares * np.array(command)).tolist())
    assert not seen.within_limits


def test_the_witness_tells_an_abrupt_stop():
    seen = witness()
    drive(seen, ramp(0.01, 30))
    assert seen.within_limits
    seen.stop()
    assert not seen.within_limits


def test_the_witness_looks_between_the_ends_of_a_step():
    """A turn out of the view and back within one advance."""
    seen = witness(body=Body(lag=0.12, slip=0.0, gyro_bias=0.0, rate=480.0))
    angle = math.radians(35.0)
    before = seen.margin
    assert before == pytest.approx(angle)
    seen.send(Twist(0.0, 0.4))
    seen.advance(4.0)
    assert seen.margin < 0.0
    assert math.isnan(seen.stood_at)


def test_the_witness_tells_when_the_robot_came_to_rest():
    seen = witness(body=Body(slip=0.0, gyro_bias=0.0))
    drive(seen, ramp(0.01, 30))
    seen.mark()
    marked = seen.time
    drive(seen, [(0.22 - 0.01 * k, 0.0) for k in range(1, 23)] + [(0.0, 0.0)] * 40)
    assert seen.stopped == seen.halted == seen.stood_at
    # Braking, and the lag's decay from 0.22 m/s to a millimetre a second.
    assert 0.73 < seen.stopped - marked < 0.73 + 0.12 * math.log(220.0)


# Docks ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("via", VIAS)
def test_docks_undocks_and_replays(via, tmp_path):
    if via == "can":
        pytest.importorskip("canopen", reason="needs the extra can")
    record = docks.fly(Setting(0, 1), via, tmp_path / "log")
    for name in ("docked", "strict", "undocked", "replayed", "within_limits"):
        assert record[name], name
    assert record["commands_differing"] == 0
    assert record["min_fov_margin_deg"] > 0.0
    assert not record["contact"]
    assert record["way_out_m"] == pytest.approx(1.2, abs=0.05)
    assert record["ticks"] > 300


def test_docks_from_the_command_line(tmp_path, capsys):
    path = tmp_path / "docks.json"
    arguments = ["docks", "--via", "direct", "--runs", "1", "--json", str(path)]
    assert robot.main([*arguments, "--logs", str(tmp_path)]) == 0
    assert "1 of 1 docked, 1 undocked, 1 replayed bit for bit" in capsys.readouterr().out
    assert (tmp_path / "direct-0-0.mcap").exists()
    assert path.with_suffix(".md").read_text().startswith("| run | docked |")
    document = json.loads(path.read_text())
    assert document["docked"] == document["replayed"] == 1
    # What is there is not run again, and what failed fails again.
    document["runs"][0]["replayed"] = False
    path.write_text(json.dumps(document))
    assert robot.main([*arguments, "--resume"]) == 1
    assert robot.main([*arguments, "--resume", "--seed", "1"]) == 2
    assert "cannot resume" in capsys.readouterr().err
    path.write_text("[]")
    assert robot.main([*arguments, "--resume"]) == 2
    assert robot.main(["docks", "--resume"]) == 2


# Kills ------------------------------------------------------------------------------------------


def indices(part, variant):
    """The first run in which that part dies in that way."""
    for index in range(100):
        setting = Setting(0, index)
        if kills.Case(setting, part).variant == variant:
            return setting
    raise AssertionError(variant)


SIMULATED = [("sensor", "raises"), ("sensor", "silent"), ("sensor", "frozen"), ("solver", "raises"),
             ("solver", "nan"), ("peer", "restarts"), ("peer", "forged first")]  # fmt: skip


@pytest.mark.parametrize(("part", "variant"), SIMULATED)
def test_a_part_dies_is_named_and_comes_back(part, variant):
    record = kills.kill(indices(part, variant), part)
    assert record["ok"], record
    assert record["told"]
    if part != "solver":
        assert record["stopped_after_s"] > 0.5


def test_a_kill_that_goes_wrong_is_told(monkeypatch, tmp_path, capsys):
    """A loop that says nothing of its parts."""
    monkeypatch.setattr(kills, "_named", lambda *_: "")
    path = tmp_path / "kills.json"
    arguments = ["kills", "--runs", "1", "--parts", "solver", "--seed", "1", "--json", str(path)]
    assert kills.Case(Setting(1, 0), "solver").variant != "hangs"
    assert robot.main(arguments) == 1
    assert "not named" in capsys.readouterr().out
    assert json.loads(path.read_text())["runs_ok"] == 0


def test_parts_take_turns():
    assert [list(kills.PARTS)[k % 5] for k in range(5)] == [
        "sensor", "solver", "bus", "peer", "process"
    ]  # fmt: skip
    with pytest.raises(SystemExit):
        robot.main(["kills", "--parts", "wheel"])


@pytest.mark.parametrize("fate", ["cut", "off"])
def test_a_cable(fate):
    can = pytest.importorskip("can", reason="needs the extra can")
    with (
        can.Bus(interface="virtual", channel=f"cable-{fate}") as one,
        can.Bus(interface="virtual", channel=f"cable-{fate}") as other,
    ):
        cable = Cable(one)
        message = can.Message(arbitration_id=1, is_extended_id=False)
        one.send(message)
        assert other.recv(0.1) is not None
        cable.fate = fate
        if fate == "off":
            with pytest.raises(can.CanError):
                one.send(message)
        else:
            one.send(message)
        assert other.recv(0.01) is None
        cable.fate = ""
        one.send(message)
        assert other.recv(0.1) is not None


# Real time --------------------------------------------------------------------------------------


def test_real_time_beside_a_busy_core():
    record = realtime.drive(Setting(0, 0, real=True, rate=50.0), "direct", 1.5)
    assert record["ticks"] > 30
    assert record["outside_contract"] == 0
    assert record["within_limits"]
    assert record["tasks_failed"] == 0
    for name in ("lateness_ms", "gap_ms", "tick_ms"):
        values = list(record[name].values())
        assert values == sorted(values)
    assert 19.0 < record["gap_ms"]["p50"] < 40.0


# Fuzz -------------------------------------------------------------------------------------------


def test_nothing_breaks(tmp_path, capsys):
    arguments = ["fuzz", "--packets", "600", "--configs", "150", "--logs", "12", "--seed", "9"]
    folder = tmp_path / "failing"
    path = tmp_path / "fuzz.json"
    assert robot.main([*arguments, "--failing", str(folder), "--json", str(path)]) == 0
    assert not folder.exists()
    found = json.loads(path.read_text())["kinds"]
    assert {kind: entry["inputs"] for kind, entry in found.items()} == {
        "packets": 600, "configs": 150, "logs": 12
    }  # fmt: skip
    assert sum(found["packets"]["outcomes"].values()) == 600
    assert min(found["configs"]["outcomes"].values()) > 5
    capsys.readouterr()
    assert robot.main(["fuzz", "--only", "configs/3"]) == 0
    assert sum(eval(capsys.readouterr().out).values()) == 1


@pytest.fixture
def sound_files():
    """Made before the parser is replaced, and kept from then on."""
    assert len(fuzz_configs._bases()) == 2


def raises_another(text):
    raise KeyError("limits")


@pytest.mark.parametrize(
    ("parse", "told"),
    [(raises_another, "KeyError: 'limits'"), (lambda text: time.sleep(60.0), "it hangs")],
)
@pytest.mark.usefixtures("sound_files")
def test_what_breaks_is_kept_and_named(parse, told, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(fuzz_configs, "parse_config", parse)
    monkeypatch.setattr(fuzz_configs, "parse_docks", parse)
    monkeypatch.setitem(fuzz.KINDS, "configs", fuzz.KINDS["configs"]._replace(limit=1.0))
    arguments = ["fuzz", "--packets", "0", "--logs", "0", "--configs", "1"]
    assert robot.main([*arguments, "--failing", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert f"configs configs/0: {told}" in out
    assert (tmp_path / "configs-0-0").stat().st_size > 0


@pytest.mark.usefixtures("sound_files")
def test_a_refusal_that_names_nothing_is_told(monkeypatch, tmp_path):
    def vague(text):
        raise ConfigurationError("something is wrong")

    monkeypatch.setattr(fuzz_configs, "parse_config", vague)
    monkeypatch.setattr(fuzz_configs, "parse_docks", vague)
    record = fuzz.run(fuzz.Batch(0, "configs", 0, 20), 0, tmp_path)
    assert len(record["failing"]) >= 8  # the structural ones
    assert all(failing["why"].startswith("names no key") for failing in record["failing"])


def test_batches_are_left_out_where_they_are_done():
    wanted = {"packets": 4000, "configs": 1200, "logs": 60}
    whole = fuzz.batches(wanted, set())
    assert sum(batch.cases for batch in whole if batch.kind == "packets") == 40
    assert sum(batch.cases for batch in whole if batch.kind == "configs") == 1200
    done = {whole[0].number, whole[-1].number}
    assert fuzz.batches(wanted, done) == whole[1:-1]


def test_mutations_change_something_and_leave_the_original_alone():
    tree = {"a": {"b": [1.0, 2.0], "c": "x"}, "d": 3}
    before = json.dumps(tree)
    rng = np.random.default_rng(0)
    changed = 0
    for _ in range(200):
        mutant, touched = mutated_tree(rng, tree)
        assert touched
        assert json.dumps(tree) == before
        changed += repr(mutant) != repr(tree)
    assert changed > 180
    assert set(leaves(tree)) == {
        ("a",), ("a", "b"), ("a", "b", 0), ("a", "b", 1), ("a", "c"), ("d",)
    }  # fmt: skip
    data = bytes(range(256))
    assert sum(mutated_bytes(rng, data) != data for _ in range(200)) > 180


def test_settings_are_reproducible():
    one, other = Setting(3, 4), Setting(3, 4)
    assert one.start() == other.start() != Setting(3, 5).start()
    rig = make_rig("direct", one)
    assert rig.witness.pose() == pytest.approx(tuple(one.start()), abs=1e-9)
    rig.close()
