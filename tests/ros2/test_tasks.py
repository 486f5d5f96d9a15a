"""Goals, feedback and results as messages; parameters and what they become."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.config import parse_config, template
from clfcbf.errors import ConfigurationError
from clfcbf.ros2.client import TaskClient
from clfcbf.ros2.messages import String
from clfcbf.ros2.parameters import PARAMETERS, defaults_of, parse_given, settings_of
from clfcbf.ros2.tasks import Action, Goal, TaskServer, parse_goal
from clfcbf.ros2.transport import EVENTS, LATCHED, TransportError
from clfcbf.se2 import Pose2
from clfcbf.session import ErrorCode, Feedback, SessionPolicy, SessionResult, SessionState
from tests.ros2.bus import Bus
from tests.strategies import poses

CONFIG = parse_config(template())
DOCS = Path(__file__).parents[2] / "docs" / "ros2.md"

goals = st.builds(
    Goal, st.sampled_from(Action), st.text(), st.one_of(st.none(), poses), st.text(), st.text()
)

# Goals ----------------------------------------------------------------------------------------


@given(goals)
def test_a_goal_and_back(goal):
    assert parse_goal(goal.action, goal.to_text()) == goal


@pytest.mark.parametrize("text", ["kitchen", "  kitchen\n", '{"dock_id": "kitchen"}'])
def test_a_name_is_enough(text):
    assert parse_goal(Action.DOCK, text) == Goal(Action.DOCK, "kitchen")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "not JSON"), ('{"dock": "kitchen"}', "unknown field 'dock'"),
        ('{"dock_id": 7}', "dock_id must be a string"),
        ('{"dock_pose": [1, 2]}', "dock_pose must be"), ('{"dock_pose": "here"}', "dock_pose"),
        ('{"dock_pose": [1, 2, NaN]}', "dock_pose"), ('{"dock_pose": [1, 2, true]}', "dock_pose"),
        ('{"dock_pose": [1e999, 2, 3]}', "dock_pose"), ("{" * 100_000, "not JSON"),
    ],
)  # fmt: skip
def test_what_is_no_goal_is_rejected_with_its_reason(text, complaint):
    with pytest.raises(ConfigurationError, match=re.escape(complaint)):
        parse_goal(Action.DOCK, text)
    bus = Bus()
    server = TaskServer(bus.transport(), "rob1")
    bus.transport().publisher(String, "/rob1/docking/dock", EVENTS).publish(String(text))
    assert server.goals() == []
    (told,) = bus.messages("/rob1/docking/result")
    result = json.loads(told.data)
    assert (result["error_code"], result["error_name"]) == (1, "GOAL_REJECTED")
    assert not result["success"]
    assert complaint in result["error_msg"]


def test_client_and_server():
    bus = Bus()
    client = TaskClient(bus.transport())
    with pytest.raises(TransportError, match="no docking node"):
        client.wait_for_node(0.01)
    server = TaskServer(bus.transport())
    client.wait_for_node(0.01)
    asked = client.send(Goal(Action.UNDOCK, "kitchen"))
    assert server.goals() == [asked]
    assert asked.goal_id
    assert not server.canceled()
    client.cancel()
    assert server.canceled()
    assert not server.canceled()
    server.feedback(asked, Feedback(SessionState.CONTROLLING, 1.5, 2))
    (state,) = client.states()
    assert state == {
        "action": "undock", "goal_id": asked.goal_id, "dock_id": "kitchen", "state": 3,
        "state_name": "CONTROLLING", "docking_time": 1.5, "num_retries": 2,
    }  # fmt: skip
    assert client.result(asked) is None
    server.result(asked, SessionResult(False, ErrorCode.FAILED_TO_CONTROL, 2, "why"))
    told = client.result(asked)
    assert (told["success"], told["error_code"], told["error_name"]) == (
        False, 905, "FAILED_TO_CONTROL",
    )  # fmt: skip
    assert (told["num_retries"], told["error_msg"], told["canceled"]) == (2, "why", False)
    with pytest.raises(TransportError, match="no result"):
        client.perform(Goal(Action.DOCK), timeout=0.01)


def test_the_last_result_is_there_for_who_comes_later():
    bus = Bus()
    goal = Goal(Action.DOCK, goal_id="7")
    TaskServer(bus.transport()).result(goal, SessionResult(True, ErrorCode.NONE, 0))
    (told,) = bus.transport().subscription(String, "/docking/result", LATCHED).take()
    assert json.loads(told.data)["success"]


# Parameters -----------------------------------------------------------------------------------


def test_no_parameter_leaves_the_configuration_as_it_is():
    settings = settings_of(CONFIG)
    assert settings.config is CONFIG
    assert settings.policy == SessionPolicy()
    assert settings_of(CONFIG, defaults_of(CONFIG)) == settings
    assert settings.stamped
    assert not settings.use_sim_time
    assert settings.detection.name == settings.base_frame == "base_link"


def test_each_parameter_is_listed_and_documented():
    names = [parameter.name for parameter in PARAMETERS]
    assert sorted(names) == sorted(defaults_of(CONFIG))
    told = set(re.findall(r"^\| `([\w.]+)`", DOCS.read_text(encoding="utf-8"), re.MULTILINE))
    assert told >= set(names)


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("controller_frequency", 50.0, lambda s: 1.0 / s.config.filter.period),
        ("controller.v_linear_max", 0.15, lambda s: s.config.limits.v_max),
        ("controller.v_angular_max", 0.3, lambda s: s.config.limits.omega_max),
        ("external_detection_timeout", 0.7, lambda s: s.config.loop.max_age),
        ("initial_perception_timeout", 3.0, lambda s: s.policy.initial_perception_timeout),
        ("wait_charge_timeout", 3.0, lambda s: s.policy.wait_charge_timeout),
        ("dock_approach_timeout", 33.0, lambda s: s.policy.approach_timeout),
        ("max_undocking_time", 3.0, lambda s: s.policy.max_undocking_time),
        ("max_retries", 7, lambda s: s.policy.max_retries),
        ("base_frame", "base_footprint", lambda s: s.base_frame),
        ("enable_stamped_cmd_vel", False, lambda s: s.stamped),
        ("use_sim_time", True, lambda s: s.use_sim_time),
        ("cmd_vel_timeout", 0.25, lambda s: s.cmd_vel_timeout),
        ("cmd_vel_topic", "cmd_vel_docking", lambda s: s.cmd_vel_topic),
        ("detection_topic", "/tag", lambda s: s.detection_topic),
        ("detection_frame", "cam", lambda s: s.detection.name),
        ("detection_roll", 0.1, lambda s: s.detection.roll),
        ("detection_pitch", 0.1, lambda s: s.detection.pitch),
        ("external_detection_rotation_roll", 0.1, lambda s: s.detection.rotation[0]),
        ("external_detection_rotation_pitch", 0.1, lambda s: s.detection.rotation[1]),
        ("external_detection_rotation_yaw", 0.1, lambda s: s.detection.rotation[2]),
    ],
)
def test_a_parameter_becomes_what_it_says(name, value, found):
    before, after = settings_of(CONFIG), settings_of(CONFIG, {name: value})
    assert found(after) == (pytest.approx(value) if isinstance(value, float) else value)
    assert found(before) != found(after)
    assert after != before


def test_changed_limits_and_period_reach_the_filter_and_what_it_keeps():
    config = settings_of(
        CONFIG, {"controller.v_linear_max": 0.15, "controller_frequency": 20}
    ).config
    assert config.filter.limits == config.limits == replace(CONFIG.limits, v_max=0.15)
    assert config.filter.period == 0.05
    assert (config.filter.lag, config.filter.guard_lag) == (
        CONFIG.filter.lag,
        CONFIG.filter.guard_lag,
    )
    assert (config.gains, config.noise, config.loop) == (CONFIG.gains, CONFIG.noise, CONFIG.loop)
    assert config.controller().config.filter.period == 0.05


@pytest.mark.parametrize(
    ("frame", "axes", "optical"),
    [
        ("camera_optical", "auto", True), ("camera_color_optical_frame", "auto", True),
        ("camera_link", "auto", False), ("camera_link", "optical", True),
        ("camera_optical_frame", "body", False), ("base_link", "auto", False),
    ],
)  # fmt: skip
def test_axes_of_the_detections_frame(frame, axes, optical):
    detection = settings_of(CONFIG, {"detection_frame": frame, "detection_axes": axes}).detection
    assert detection.optical is optical
    at = Pose2(0.0, 0.0, 0.0) if frame == "base_link" else CONFIG.camera.camera
    assert detection.mount == at


def test_docks_from_a_file(tmp_path):
    path = tmp_path / "docks.toml"
    path.write_text("[docks.kitchen]\npose = [1.0, 2.0, 0.5]\n")
    docks = settings_of(CONFIG, {"dock_database": str(path)}).docks
    assert docks.docks["kitchen"].pose == Pose2(1.0, 2.0, 0.5)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"controler_frequency": 50.0}, "did you mean 'controller_frequency'"),
        ({"max_retries": 2.5}, "max_retries must be int"),
        ({"max_retries": True}, "max_retries must be int"),
        ({"controller_frequency": "fast"}, "must be float"),
        ({"controller_frequency": 0.0}, "controller_frequency must be positive"),
        ({"controller_frequency": math.nan}, "controller_frequency must be positive"),
        ({"controller.v_linear_max": -1.0}, "v_max"),
        ({"wait_charge_timeout": -1.0}, "wait_charge_timeout"),
        ({"external_detection_timeout": 0.0}, "max_age"),
        ({"detection_axes": "image"}, "detection_axes must be one of auto, body, optical"),
        ({"detection_frame": ""}, "must have a name"),
        ({"detection_pitch": math.inf}, "pitch"),
        ({"dock_database": "/nowhere/docks.toml"}, "cannot read"),
    ],
)
def test_what_is_wrong_with_a_parameter_is_told(given, complaint):
    with pytest.raises(ConfigurationError, match=re.escape(complaint)):
        settings_of(CONFIG, given)


def test_parameters_of_a_command_line():
    given = ["a:=1.5", "b:=7", "c:=true", "d:=camera_link", "e:=/a/b", 'f:="1"', "g:="]
    assert parse_given(given) == {
        "a": 1.5, "b": 7, "c": True, "d": "camera_link", "e": "/a/b", "f": "1", "g": "",
    }  # fmt: skip
    assert type(parse_given(["b:=7"])["b"]) is int
    for wrong in ("a=1", ":=1", "a"):
        with pytest.raises(ConfigurationError, match="name:=value"):
            parse_given([wrong])
