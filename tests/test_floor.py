"""The time-optimal floor: known optima, an independent integration, and bounds it must respect."""

import importlib.util
import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from benchmarks.floor import Motion, certify, floor_time, least_time
from benchmarks.floor.__main__ import main
from benchmarks.floor.certificate import rest_to_rest
from benchmarks.floor.guesses import guesses
from benchmarks.floor.program import floor_program
from benchmarks.floor.report import episodes_in, floor_record, ratios, summary
from clfcbf import FieldOfView, Limits, Pose2
from clfcbf.errors import ConfigurationError, GeometryError, MissingExtraError
from clfcbf.simulation.campaign import EpisodeSpec
from clfcbf.simulation.scenarios import World, draw_start, region_named, visible_share

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
WORLD = World()

needs_casadi = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None, reason="CasADi is not installed"
)


def seen(x, y, theta):
    """Bearing of the feature from the camera, written out."""
    camera = WORLD.camera.camera.x
    eye_x, eye_y = x + camera * np.cos(theta), y + camera * np.sin(theta)
    return np.arctan2(-eye_y, WORLD.standoff - eye_x) - theta


def drawn(spec):
    return draw_start(region_named(spec.region), WORLD, spec.stream(0))


def integrated(motion, start):
    """States at 2 ms and the end, by an adaptive method of order 8 (not the certificate's)."""
    knots, state, states = motion.times, np.array([*start, 0.0, 0.0]), []
    for begin, end, (a, alpha) in zip(knots[:-1], knots[1:], motion.accelerations, strict=True):
        run = solve_ivp(
            lambda _, s, a=a, alpha=alpha: [
                s[3] * math.cos(s[2]), s[3] * math.sin(s[2]), s[4], a, alpha
            ],
            (begin, end), state, "DOP853", np.arange(begin, end, 0.002), rtol=1e-10, atol=1e-12,
            dense_output=True,
        )  # fmt: skip
        states.append(run.y.T)
        state = run.sol(end)
    return np.vstack((*states, state))


@given(st.floats(1e-3, 5.0), st.floats(0.05, 1.0), st.floats(0.05, 2.0))
def test_rest_to_rest_is_the_trapezium_that_covers_the_distance(distance, speed, acceleration):
    time = rest_to_rest(distance, speed, acceleration)
    # All kinks of the profile, between which it is linear.
    kink = min(speed / acceleration, 0.5 * time)
    t = np.array([0.0, kink, 0.5 * time, time - kink, time])
    profile = np.minimum(speed, acceleration * np.minimum(t, time - t))
    covered = np.sum(0.5 * (profile[1:] + profile[:-1]) * np.diff(t))
    assert covered == pytest.approx(distance, rel=1e-9)


@needs_casadi
@pytest.mark.parametrize(
    ("start", "time"),
    [
        (Pose2(-1.0, 0.0, 0.0), 1.0 / 0.22 + 0.22 / 0.3),
        (Pose2(-0.1, 0.0, 0.0), 2.0 * math.sqrt(0.1 / 0.3)),
        (Pose2(0.1, 0.0, 0.0), 2.0 * math.sqrt(0.1 / 0.3)),
        (Pose2(0.0, 0.0, 0.3), 0.3 / 0.4 + 0.4 / 1.0),
        (Pose2(0.0, 0.0, -0.1), 2.0 * math.sqrt(0.1)),
    ],
    ids=("straight", "short", "reverse", "turn", "small turn"),
)
def test_known_optima_are_found_and_are_the_bound(start, time):
    floor = floor_time(start, WORLD, LIMITS, 80)
    assert floor.bound == pytest.approx(time, rel=1e-12)
    assert time * (1.0 - 1e-6) <= floor.time <= time * 1.001


@needs_casadi
@pytest.mark.parametrize("start", [Pose2(-1.16, -0.7, 0.21), Pose2(-0.4, 0.35, -0.5)])
def test_the_motion_holds_its_word_under_another_integrator(start):
    floor = floor_time(start, WORLD, LIMITS, 80)
    motion = floor.trajectory
    states = integrated(motion, start)
    x, y, theta, v, omega = states.T
    assert np.hypot(x[-1], y[-1]) < 1e-3
    assert abs(theta[-1]) < math.radians(0.1)
    assert max(abs(v[-1]), abs(omega[-1])) < 1e-6
    assert np.max(np.abs(v)) <= 0.22 * (1.0 + 1e-6)
    assert np.max(np.abs(omega)) <= 0.4 * (1.0 + 1e-6)
    assert np.max(np.abs(motion.accelerations / [0.3, 1.0])) <= 1.0 + 1e-6
    beyond = np.max(np.abs(seen(x, y, theta))) - WORLD.camera.half_angle
    assert beyond < math.radians(0.05)
    assert floor.violation == pytest.approx(beyond, abs=1e-4)
    # Both ride the edge, so the constraint is what shapes them.
    assert beyond > -math.radians(0.05)
    assert floor.time > floor.bound * 1.005


@needs_casadi
def test_a_wider_view_and_higher_limits_are_never_slower_and_a_mirror_image_as_fast():
    start = Pose2(-0.95, 0.6, -0.3)
    at = {
        degrees: floor_time(
            start, replace(WORLD, camera=FieldOfView(math.radians(degrees), Pose2(0.2, 0, 0))),
            LIMITS, 60,
        ).time
        for degrees in (28.0, 35.0, 60.0)
    }  # fmt: skip
    assert at[28.0] > at[35.0] * 1.02 > at[60.0] * 1.02
    usual = floor_time(start, WORLD, LIMITS, 60)
    mirrored = floor_time(Pose2(start.x, -start.y, -start.theta), WORLD, LIMITS, 60)
    assert mirrored.time == pytest.approx(usual.time, rel=1e-4)
    assert floor_time(start, WORLD, replace(LIMITS, a_max=0.6), 60).time < usual.time
    assert least_time(start, replace(LIMITS, a_max=0.6)) < least_time(start, LIMITS)


@needs_casadi
def test_reverse_is_used_where_it_has_to_be_and_not_where_it_is_forbidden():
    start = Pose2(-0.4, 0.35, -0.5)
    floor = floor_time(start, WORLD, LIMITS, 60)
    assert floor.trajectory.states[:, 3].min() < -0.05
    assert (floor.optima > 1) == (floor.spread > 0.01)
    forward = replace(LIMITS, v_min=0.0)
    assert (
        floor_time(Pose2(-1.0, 0.1, 0.0), WORLD, forward, 60).trajectory.states[:, 3].min() >= -1e-7
    )


@needs_casadi
def test_the_mesh_hardly_matters():
    start = Pose2(-1.0, 0.5, 0.0)
    coarse, fine = (floor_time(start, WORLD, LIMITS, n).time for n in (80, 160))
    assert coarse == pytest.approx(fine, rel=1e-3)


@needs_casadi
def test_the_certificate_sees_what_is_wrong():
    start = Pose2(-1.0, 0.0, 0.0)
    motion = floor_time(start, WORLD, LIMITS, 40).trajectory
    fair = certify(motion, start, WORLD, LIMITS)
    assert max(fair.end_error, fair.end_turn) < 1e-6
    assert -WORLD.camera.half_angle - 1e-9 <= fair.violation <= -WORLD.camera.half_angle + 1e-3
    short = motion._replace(duration=0.9 * motion.duration)
    assert certify(short, start, WORLD, LIMITS).end_error > 0.05
    aside = certify(motion, Pose2(-1.0, 0.0, 0.7), WORLD, LIMITS)
    assert aside.violation > 0.0
    assert aside.end_turn == pytest.approx(0.7, abs=1e-3)
    slower = replace(LIMITS, v_max=0.2)
    assert certify(motion, start, WORLD, slower).excess == pytest.approx(0.1, abs=1e-3)


@settings(deadline=None, max_examples=30)
@given(st.floats(-2.5, 0.5), st.floats(-1.0, 1.0), st.floats(-0.6, 0.6), st.integers(2, 30))
def test_guesses_lead_from_the_start_to_the_goal(x, y, theta, intervals):
    for name, motion in guesses(Pose2(x, y, theta), LIMITS, intervals).items():
        assert isinstance(motion, Motion)
        assert motion.states.shape == (intervals + 1, 5), name
        assert motion.accelerations.shape == (intervals, 2), name
        assert motion.states[0] == pytest.approx([x, y, theta, 0.0, 0.0], abs=1e-9), name
        assert motion.states[-1] == pytest.approx(np.zeros(5), abs=1e-9), name
        assert motion.duration > 0.0
        assert np.isfinite(motion.accelerations).all()


def test_a_start_that_does_not_see_the_feature_has_no_floor():
    with pytest.raises(GeometryError, match="outside the view"):
        floor_time(Pose2(-1.0, 0.0, 1.0), WORLD, LIMITS)
    with pytest.raises(GeometryError, match="finite"):
        floor_time(Pose2(math.nan, 0.0, 0.0), WORLD, LIMITS)
    # Less than half of the board in view: its centre is not.
    specs = (EpisodeSpec(region="R2", seed=0, index=index) for index in range(100))
    outside = next(s for s in specs if visible_share(drawn(s), WORLD) < 0.5)
    record = floor_record(outside)
    assert record["outcome"] == "out of view"
    assert math.isnan(record["time_s"])


def test_without_casadi_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[solvers\]"):
        floor_time(Pose2(-1.0, 0.0, 0.0), WORLD, replace(LIMITS, v_max=0.21))


@needs_casadi
def test_a_mesh_needs_two_intervals():
    with pytest.raises(ConfigurationError, match="at least 2"):
        floor_program(WORLD, LIMITS, 1)


@needs_casadi
def test_the_command_writes_resumes_and_compares(tmp_path, capsys, monkeypatch):
    result, runs = tmp_path / "floors.json", tmp_path / "runs.json"
    command = ["--regions", "R3", "--starts", "2", "--workers", "1", "--json", str(result)]
    assert main([*command[:3], "1", *command[4:]]) == 0
    first = json.loads(result.read_text(encoding="utf-8"))["floors"]
    runs.write_text(
        json.dumps(
            {
                "episodes": [
                    {"region": "R3", "seed": 0, "index": 0, "controller": "ours",
                     "time_s": 1.5 * first[0]["time_s"], "success": True},
                    {"region": "R3", "seed": 0, "index": 1, "controller": "ours",
                     "time_s": 60.0, "success": False},
                ]
            }
        ),
        encoding="utf-8",
    )  # fmt: skip
    assert main([*command, "--resume", "--episodes", str(runs)]) == 0
    found = json.loads(result.read_text(encoding="utf-8"))
    assert found["floors"][0] == first[0]
    assert [floor["index"] for floor in found["floors"]] == [0, 1]
    assert found["summary"]["R3"]["ratios"]["ours"]["mean"] == pytest.approx(1.5)
    assert found["summary"]["R3"]["ratios"]["ours"]["runs"] == 1
    assert "1.5000" in capsys.readouterr().out
    assert all(floor["time_s"] >= floor["bound_s"] * (1 - 1e-6) for floor in found["floors"])
    monkeypatch.setattr("benchmarks.floor.report.FINE", 7)
    assert main([*command, "--resume"]) == 2
    assert "cannot resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["--regions", "R99"], ["--resume"], ["--episodes", "nowhere.json"], ["--limits", "none"]],
)
def test_what_cannot_run_is_told(arguments, capsys):
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("floor: ")


def test_ratios_are_of_one_and_the_same_start():
    floors = [
        {"region": "R1", "limits": "approaching", "seed": 0, "index": i, "outcome": outcome,
         "time_s": time, "bound_s": 1.0, "spread_s": 0.0, "reversed_m": 0.0, "violation_deg": -1.0}
        for i, (outcome, time) in enumerate([("ok", 4.0), ("out of view", math.nan), ("ok", 8.0)])
    ]  # fmt: skip
    episodes = [
        {"region": "R1", "seed": 0, "index": i, "success": True, "time_s": 10.0} for i in range(3)
    ]
    other = [{**episodes[0], "limits": "docking"}, {**episodes[0], "seed": 1}]
    compared = ratios(floors, episodes + other)
    assert [run["ratio"] for run in compared] == [2.5, 1.25]
    row = summary(floors, compared)["R1"]
    assert (row["starts"], row["floors"], row["time_s"]) == (3, 2, 6.0)
    assert row["ratios"][""]["mean"] == pytest.approx(1.875)


def test_a_file_without_episodes_is_refused(tmp_path):
    path = tmp_path / "runs.json"
    path.write_text('{"episodes": [{"region": "R1"}]}', encoding="utf-8")
    with pytest.raises(ConfigurationError, match="holds no episodes"):
        episodes_in(path)
