"""From a TOML file to a configuration; whatever is in it, the only error is ConfigurationError."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from enum import Enum
from pathlib import Path
from typing import Any, get_args

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.config.model import Config
from clfcbf.config.schema import DEGREES, REQUIRED, SECTIONS, Key, Section
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.estimation import NoiseModel
from clfcbf.limits import Limits
from clfcbf.runtime.policy import LoopPolicy
from clfcbf.se2 import Pose2
from clfcbf.trajectories.following import FollowingGains
from clfcbf.wheels import WheelLimits

__all__ = ["parse_config", "read_config"]


def read_config(path: Path | str) -> Config:
    """The configuration in a file.

    Raises
    ------
    ConfigurationError : the file cannot be read, is not TOML, or something in it is wrong; the
        message names the file, the section, the key, the value and the valid choices
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # no such file; not UTF-8, or no such name can be
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigurationError(f"cannot read {str(path)!r}: {reason}") from error
    try:
        return parse_config(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def parse_config(text: str) -> Config:
    """The configuration in a TOML document; raises ``ConfigurationError`` as ``read_config``."""
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not TOML, an endless integer, nested too deeply
        raise ConfigurationError(f"not TOML: {error}") from error
    _check_names("section", document, [section.name for section in SECTIONS], "")
    values = {section.name: _section(section, document) for section in SECTIONS}
    return _built(values)


def _check_names(what: str, given: Mapping[str, Any], valid: list[str], where: str) -> None:
    for name in given:
        if name not in valid:
            stem = name.removesuffix(DEGREES)  # right but for the degrees, where it is no angle
            near = [stem] if stem in valid else get_close_matches(name, valid, 1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ConfigurationError(
                f"{where}unknown {what} {name!r}{hint} (valid: {', '.join(valid)})"
            )


def _section(section: Section, document: Mapping[str, Any]) -> dict[str, Any] | None:
    """The values of a table by the names of the fields; those left out are left out."""
    where = f"[{section.name}] "
    table = document.get(section.name)
    if table is None:
        if section.optional:
            return None
        table = {}
    if not isinstance(table, dict):
        raise ConfigurationError(f"{section.name} must be a table, [{section.name}], got {table!r}")
    _check_names("key", table, section.names, where)
    values: dict[str, Any] = {}
    for name, value in table.items():
        key = section.key(name)
        assert key is not None  # the names were checked
        if key.name in values:
            raise ConfigurationError(f"{where}{key.name} is given twice, in radians and degrees")
        values[key.name] = _value(key, name, value, where)
    for key in section.keys:
        if key.default is REQUIRED and key.name not in values:
            degrees = f" (or {key.name}{DEGREES})" if key.is_angle else ""
            raise ConfigurationError(f"{where}{key.name}{degrees} is missing: {key.about}")
    return values


def _value(key: Key, name: str, value: Any, where: str) -> Any:
    kind = key.kind
    if kind is float:
        number = _number(value, f"{where}{name}")
        return math.radians(number) if name != key.name else number
    if kind is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ConfigurationError(f"{where}{name} must be an integer, got {value!r}")
        _number(value, f"{where}{name}")  # one that a float can hold, for it is computed with
        return value
    if kind is str:
        if not isinstance(value, str):
            raise ConfigurationError(f"{where}{name} must be a string, got {value!r}")
        return value
    if isinstance(kind, type) and issubclass(kind, Enum):
        return _choice(kind, value, f"{where}{name}")
    count = len(get_args(kind))
    if not (isinstance(value, list) and len(value) == count):
        raise ConfigurationError(f"{where}{name} must be a list of {count} numbers, got {value!r}")
    return tuple(_number(item, f"{where}{name}") for item in value)


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(f"{what} must be a number, got {value!r}")
    try:
        return float(value)
    except OverflowError as error:
        raise ConfigurationError(f"{what} is too large for a number") from error


def _choice(kind: type[Enum], value: Any, what: str) -> Enum:
    for choice in kind:
        if type(value) is type(choice.value) and value == choice.value:
            return choice
    choices = ", ".join(repr(choice.value) for choice in kind)
    raise ConfigurationError(f"{what} must be one of {choices}, got {value!r}")


def _built(values: Mapping[str, dict[str, Any] | None]) -> Config:
    """The parts made of their sections; what a part refuses is told with its section."""
    limits = _made("limits", Limits, values["limits"])
    eye = dict(values["camera"] or {})
    mounting = Pose2(*(eye.pop(name, 0.0) for name in Pose2._fields))
    camera = _made("camera", FieldOfView, {**eye, "camera": mounting})
    wheels = values["wheels"]
    parts = {
        "gains": _made("gains", FollowingGains, values["gains"]),
        "noise": _made("noise", _noise, values["noise"]),
        "loop": _made("loop", LoopPolicy, values["loop"]),
        "wheels": None if wheels is None else _made("wheels", WheelLimits, wheels),
    }
    docking = values["docking"] or {}
    for name, value in docking.items():  # which only the controller itself looks at
        if not math.isfinite(value):
            raise ConfigurationError(f"[docking] {name} must be finite, got {value!r}")
    made = {"limits": limits, "camera": camera, "docking": docking}
    whole = {**made, "filter": values["filter"] or {}, **parts}
    config: Config = _made("filter", Config.of, whole, values)
    return config


def _made(
    section: str,
    kind: Any,
    values: Mapping[str, Any] | None,
    concerned: Mapping[str, Mapping[str, Any] | None] | None = None,
) -> Any:
    """The part made of ``values``; ``concerned`` are the sections it depends on, itself if None."""
    try:
        return kind(**(values or {}))
    except ClfcbfError as error:
        raise ConfigurationError(f"[{section}] {error}") from error
    except ArithmeticError as error:  # finite, but what is computed of it is not
        name, key, value = _farthest(concerned or {section: values})
        raise ConfigurationError(f"[{name}] {key} is far out of range: {value!r}") from error


def _farthest(sections: Mapping[str, Mapping[str, Any] | None]) -> tuple[str, str, float]:
    """Section and key of the number whose order of magnitude is the farthest from one."""
    numbers = (
        (abs(math.log10(abs(value))), name, key, value)
        for name, table in sections.items()
        for key, value in (table or {}).items()
        if isinstance(value, float) and value
    )
    return max(numbers)[1:]


def _noise(**values: Any) -> NoiseModel:
    noise = defaults.NOISE._replace(**values)
    for name, value in noise._asdict().items():
        if not (math.isfinite(value) and value > 0):
            raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")
    return noise
