"""Docks and their types, from a TOML file.

[types.charger]
staging_offset = [-0.7, 0.0, 0.0]   # of the staging pose, seen from the dock
confirm = true                      # wait until charging has begun

[docks.kitchen]
type = "charger"
pose = [3.1, 0.4, 1.57]             # in the frame, where the robot stands when docked
frame = "map"
id = "42"
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2, is_finite

__all__ = ["Dock", "DockDatabase", "DockType", "parse_docks", "read_docks"]

STAGING = Pose2(-0.7, 0.0, 0.0)
"""[m, rad] Staging pose seen from the dock: Nav2's, from where a board 0.5 m wide is in view."""

BACKOFF = 0.5
"""[m] Reversed before another attempt: a lateral error of 5 cm takes as much way to correct."""


@dataclass(frozen=True, slots=True)
class DockType:
    """What docks of one kind have in common.

    Attributes
    ----------
    name : of the type
    staging_offset : staging pose seen from the dock
    backoff : reversed before another attempt [m]
    contact : the approach ends by contact, and without one it has failed
    confirm : success needs confirmation after it, such as that charging has begun

    Raises
    ------
    ConfigurationError : the offset is not finite or not behind the dock, or the back-off is not
        finite and positive
    """

    name: str = "default"
    staging_offset: Pose2 = STAGING
    backoff: float = BACKOFF
    contact: bool = False
    confirm: bool = False

    def __post_init__(self) -> None:
        if not (is_finite(tuple(self.staging_offset)) and self.staging_offset.x < 0.0):
            raise ConfigurationError(
                f"staging_offset must be finite with x < 0 m, got {self.staging_offset!r}"
            )
        if not 0.0 < self.backoff < math.inf:
            raise ConfigurationError(f"backoff must be finite and positive [m], got {self.backoff}")


@dataclass(frozen=True, slots=True)
class Dock:
    """One dock.

    Attributes
    ----------
    name : of the dock
    type : what kind it is
    pose : where the robot stands when docked, in the frame
    frame : name of the frame; told to whoever stages the robot
    id : such as of the marker on it; told to whoever makes the sensor

    Raises
    ------
    ConfigurationError : the pose is not finite
    """

    name: str
    type: DockType
    pose: Pose2
    frame: str = "map"
    id: str = ""

    def __post_init__(self) -> None:
        if not is_finite(tuple(self.pose)):
            raise ConfigurationError(f"pose must be finite, got {self.pose!r}")

    @property
    def staging_pose(self) -> Pose2:
        """Where the approach begins, in the frame."""
        return self.pose.compose(self.type.staging_offset)

    @property
    def undocking_distance(self) -> float:
        """Way from the dock straight out to the staging pose's distance [m]."""
        return -self.type.staging_offset.x


@dataclass(frozen=True, slots=True)
class DockDatabase:
    """Docks and types by name."""

    docks: Mapping[str, Dock]
    types: Mapping[str, DockType]


def read_docks(path: Path | str) -> DockDatabase:
    """The docks in a file.

    Raises
    ------
    ConfigurationError : the file cannot be read, is not TOML, or something in it is wrong; the
        message names the file, the table, the key, the value and the valid choices
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigurationError(f"cannot read {str(path)!r}: {reason}") from error
    try:
        return parse_docks(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def parse_docks(text: str) -> DockDatabase:
    """The docks in a TOML document; raises ``ConfigurationError`` as ``read_docks`` does.

    A dock may leave its type out where there is only one.
    """
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"not TOML: {error}") from error
    _known("table", document, ["types", "docks"], "")
    types = {
        name: _made(DockType, name, table, f"types.{name}")
        for name, table in _tables(document, "types").items()
    } or {"default": DockType()}
    docks = {}
    for name, table in _tables(document, "docks").items():
        where = f"docks.{name}"
        if not isinstance(table, dict):
            raise ConfigurationError(f"{where} must be a table, got {table!r}")
        given = table.get("type", next(iter(types)) if len(types) == 1 else None)
        if not isinstance(given, str) or given not in types:
            raise ConfigurationError(
                f"[{where}] type must be one of {', '.join(map(repr, types))}, got {given!r}"
            )
        if "pose" not in table:
            raise ConfigurationError(f"[{where}] pose is missing: [x, y, theta] [m, m, rad]")
        docks[name] = _made(Dock, name, {**table, "type": types[given]}, where)
    return DockDatabase(docks, types)


def _tables(document: Mapping[str, Any], name: str) -> dict[str, Any]:
    tables = document.get(name, {})
    if not isinstance(tables, dict):
        raise ConfigurationError(f"{name} must be a table of tables, got {tables!r}")
    return tables


def _known(what: str, given: Mapping[str, Any], valid: list[str], where: str) -> None:
    for name in given:
        if name not in valid:
            near = get_close_matches(name, valid, 1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ConfigurationError(
                f"{where}unknown {what} {name!r}{hint} (valid: {', '.join(valid)})"
            )


def _made(kind: Any, name: str, table: Any, where: str) -> Any:
    """A dock or a type out of its table, whose values have to be of the fields' kinds."""
    if not isinstance(table, dict):
        raise ConfigurationError(f"{where} must be a table, got {table!r}")
    kinds = {field.name: str(field.type) for field in fields(kind) if field.name != "name"}
    _known("key", table, list(kinds), f"[{where}] ")
    values = {key: _value(kinds[key], value, f"[{where}] {key}") for key, value in table.items()}
    try:
        return kind(name=name, **values)
    except ConfigurationError as error:
        raise ConfigurationError(f"[{where}] {error}") from error


def _value(kind: str, value: Any, what: str) -> Any:
    if kind == "Pose2":
        if not (isinstance(value, list) and len(value) == 3):
            raise ConfigurationError(f"{what} must be a list of x, y and theta, got {value!r}")
        return Pose2(*(_number(item, what) for item in value))
    if kind == "float":
        return _number(value, what)
    if kind in ("bool", "str") and type(value).__name__ != kind:
        raise ConfigurationError(f"{what} must be a {kind}, got {value!r}")
    return value


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(f"{what} must be a number, got {value!r}")
    try:
        return float(value)
    except OverflowError as error:
        raise ConfigurationError(f"{what} is too large for a number") from error
