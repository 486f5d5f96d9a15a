"""ROS parameters of the node: Nav2's names where they mean the same, and what they become.

A parameter that is not given leaves the configuration as it is.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from typing import Any, NamedTuple

from clfcbf.config import Config
from clfcbf.errors import ConfigurationError
from clfcbf.ros2.chassis import BASE_FRAME, CMD_VEL, TIMEOUT
from clfcbf.ros2.detection import DetectionFrame
from clfcbf.ros2.target import DETECTED
from clfcbf.se2 import Pose2
from clfcbf.session import DockDatabase, SessionPolicy, parse_docks, read_docks

__all__ = ["PARAMETERS", "NodeSettings", "Parameter", "defaults_of", "parse_given", "settings_of"]

Value = bool | int | float | str

AXES = ("auto", "body", "optical")
"""Choices of ``detection_axes``."""

SUFFIXES = ("_optical", "_optical_frame")
"""By which names of optical frames end, by REP-103 and as camera drivers have it."""


class Parameter(NamedTuple):
    """One parameter.

    Attributes
    ----------
    name : as ROS has it
    nav2 : whose parameter of that name means the same; empty where the name is our own
    about : what it means
    """

    name: str
    nav2: str
    about: str


_SERVER, _PLUGIN, _GOAL = "docking_server", "SimpleChargingDock", "UndockRobot goal"

PARAMETERS = (
    Parameter("controller_frequency", _SERVER, "of the control loop [Hz]; 1/period"),
    Parameter("initial_perception_timeout", _SERVER, "for the first looks at the dock [s]"),
    Parameter("wait_charge_timeout", _SERVER, "for the confirmation after docking [s]"),
    Parameter("dock_approach_timeout", _SERVER, "of one approach [s]"),
    Parameter("max_retries", _SERVER, "attempts after the first"),
    Parameter("max_undocking_time", _GOAL, "to undock, or to back off for a retry [s]"),
    Parameter("base_frame", _SERVER, "frame at the rotation centre, of the commands"),
    Parameter("dock_database", _SERVER, "file of docks; TOML here"),
    Parameter("controller.v_linear_max", _SERVER, "highest forward speed [m/s]"),
    Parameter("controller.v_angular_max", _SERVER, "highest turn rate [rad/s]"),
    Parameter("external_detection_timeout", _PLUGIN, "age above which a pose is ignored [s]"),
    Parameter("external_detection_rotation_roll", _PLUGIN, "from the detector's axes of the dock"),
    Parameter("external_detection_rotation_pitch", _PLUGIN, "to x into the dock, z up [rad],"),
    Parameter("external_detection_rotation_yaw", _PLUGIN, "about fixed axes"),
    Parameter("enable_stamped_cmd_vel", _SERVER, "TwistStamped commands, else Twist"),
    Parameter("use_sim_time", "every ROS node", "the time is that of /clock"),
    Parameter("cmd_vel_timeout", "", "after which the base stops without a command [s]"),
    Parameter("cmd_vel_topic", "", "of the commands"),
    Parameter("detection_topic", "", "of the dock's poses"),
    Parameter("detection_frame", "", "frame_id that poses must carry"),
    Parameter("detection_axes", "", "of that frame: body, optical, or auto, by the name's ending"),
    Parameter("detection_roll", "", "of that frame on the robot [rad]"),
    Parameter("detection_pitch", "", "as above; a camera that looks down has a positive one"),
)
"""All of them."""

_POLICY = {
    "initial_perception_timeout": "initial_perception_timeout",
    "wait_charge_timeout": "wait_charge_timeout",
    "dock_approach_timeout": "approach_timeout",
    "max_retries": "max_retries",
    "max_undocking_time": "max_undocking_time",
}


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """What configuration and parameters come to.

    Attributes
    ----------
    config : the robot's, with the parameters in it
    policy : of the docking session
    docks : that are known by name
    detection : frame that poses of the dock come in
    base_frame : of the commands
    stamped : ``TwistStamped``, else ``Twist``
    use_sim_time : the time is that of ``/clock``
    cmd_vel_timeout : of the base [s]
    cmd_vel_topic, detection_topic : relative to the namespace, unless they begin with a slash
    """

    config: Config
    policy: SessionPolicy
    docks: DockDatabase
    detection: DetectionFrame
    base_frame: str = BASE_FRAME
    stamped: bool = True
    use_sim_time: bool = False
    cmd_vel_timeout: float = TIMEOUT
    cmd_vel_topic: str = CMD_VEL
    detection_topic: str = DETECTED


def defaults_of(config: Config) -> dict[str, Value]:
    """Every parameter by name, with the value that leaves the configuration as it is."""
    policy = SessionPolicy()
    return {
        "controller_frequency": 1.0 / config.filter.period,
        **{name: getattr(policy, field) for name, field in _POLICY.items()},
        "base_frame": BASE_FRAME,
        "dock_database": "",
        "controller.v_linear_max": config.limits.v_max,
        "controller.v_angular_max": config.limits.omega_max,
        "external_detection_timeout": config.loop.max_age,
        "external_detection_rotation_roll": 0.0,
        "external_detection_rotation_pitch": 0.0,
        "external_detection_rotation_yaw": 0.0,
        "enable_stamped_cmd_vel": True,
        "use_sim_time": False,
        "cmd_vel_timeout": TIMEOUT,
        "cmd_vel_topic": CMD_VEL,
        "detection_topic": DETECTED,
        "detection_frame": BASE_FRAME,
        "detection_axes": "auto",
        "detection_roll": 0.0,
        "detection_pitch": 0.0,
    }


def parse_given(given: Sequence[str]) -> dict[str, Value]:
    """Parameters as ROS's command lines have them, ``name:=value``.

    Raises
    ------
    ConfigurationError : one is not of that form
    """
    values: dict[str, Value] = {}
    for text in given:
        name, separator, value = text.partition(":=")
        if not (separator and name):
            raise ConfigurationError(f"a parameter must be given as name:=value, got {text!r}")
        try:
            values[name] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = value
    return values


def settings_of(config: Config, given: Mapping[str, Any] | None = None) -> NodeSettings:
    """Configuration and parameters together.

    Raises
    ------
    ConfigurationError : a parameter is unknown, of the wrong kind or out of its range
    """
    usual = defaults_of(config)
    values: dict[str, Any] = dict(usual)
    for name, value in (given or {}).items():
        values[name] = _checked(name, value, usual)
    changed = {name for name, value in values.items() if value != usual[name]}
    policy = SessionPolicy(**{field: values[name] for name, field in _POLICY.items()})
    made = _configured(config, values, changed)
    path = values["dock_database"]
    return NodeSettings(
        made, policy, read_docks(str(path)) if path else parse_docks(""),
        _detection(made, values), values["base_frame"], values["enable_stamped_cmd_vel"],
        values["use_sim_time"], values["cmd_vel_timeout"], values["cmd_vel_topic"],
        values["detection_topic"],
    )  # fmt: skip


def _checked(name: str, value: Any, usual: Mapping[str, Value]) -> Any:
    if name not in usual:
        near = get_close_matches(name, usual, 1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ConfigurationError(f"unknown parameter {name!r}{hint} (valid: {', '.join(usual)})")
    kind = type(usual[name])
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise ConfigurationError(f"parameter {name} must be {kind.__name__}, got {value!r}")
    return value


def _configured(config: Config, values: Mapping[str, Any], changed: set[str]) -> Config:
    """The configuration with what the parameters change of it, made anew where that is needed."""
    if "external_detection_timeout" in changed:
        age = values["external_detection_timeout"]
        config = replace(config, loop=replace(config.loop, max_age=age))
    speeds = {"controller.v_linear_max": "v_max", "controller.v_angular_max": "omega_max"}
    limits = replace(
        config.limits, **{key: values[name] for name, key in speeds.items() if name in changed}
    )
    kept = {f.name: getattr(config.filter, f.name) for f in fields(config.filter) if f.init}
    options = {name: kept[name] for name in kept if name not in ("limits", "barriers")}
    if "controller_frequency" in changed:
        if not values["controller_frequency"] > 0.0:
            raise ConfigurationError(
                f"controller_frequency must be positive [Hz], got {values['controller_frequency']}"
            )
        options["period"] = 1.0 / values["controller_frequency"]
    elif limits == config.limits:
        return config
    return Config.of(
        limits, config.camera, config.docking, options, gains=config.gains, noise=config.noise,
        loop=config.loop, wheels=config.wheels,
    )  # fmt: skip


def _detection(config: Config, values: Mapping[str, Any]) -> DetectionFrame:
    """A frame that is not the base's is the camera's, whose place the configuration tells."""
    name, axes = values["detection_frame"], values["detection_axes"]
    if axes not in AXES:
        raise ConfigurationError(f"detection_axes must be one of {', '.join(AXES)}, got {axes!r}")
    based = name == values["base_frame"]
    rotation = tuple(values[f"external_detection_rotation_{a}"] for a in ("roll", "pitch", "yaw"))
    return DetectionFrame(
        name,
        Pose2(0.0, 0.0, 0.0) if based else config.camera.camera,
        values["detection_roll"],
        values["detection_pitch"],
        axes == "optical" or (axes == "auto" and name.endswith(SUFFIXES)),
        rotation,
    )
