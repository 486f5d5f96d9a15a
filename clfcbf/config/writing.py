"""From a configuration to TOML, and the template with every key and its default."""

from __future__ import annotations

import json
import math
import textwrap
from enum import Enum
from typing import Any

from clfcbf.config.model import Config
from clfcbf.config.schema import DEGREES, REQUIRED, SECTIONS, Key, Section

__all__ = ["template", "to_toml"]

_WIDTH = 92
"""Columns of the template's comments."""

_EXAMPLE: dict[str, Any] = {
    "limits.v_max": 0.22, "limits.omega_max": 0.4, "limits.a_max": 0.3, "limits.alpha_max": 1.0,
    "wheels.track": 0.42, "wheels.radius": 0.08, "wheels.speed": 0.5,
    "camera.half_angle": math.radians(35.0), "camera.x": 0.2,
    "filter.period": 1.0 / 30.0, "filter.lag": 0.12,
    "docking.standoff": 0.6,
}  # fmt: skip
"""What the template says where there is no default, or none that fits a robot: the paper's
robot at its approach, and a camera of 70°."""


def to_toml(config: Config) -> str:
    """All of a configuration as TOML, in SI units; reading it gives the configuration back.

    A backend of one's own has no name in a file: its place is left to the default.
    """
    parts: list[str] = []
    for section in SECTIONS:
        values = _values(config, section)
        if values is not None:
            lines = [f"{name} = {_toml(value)}" for name, value in values.items()]
            parts.append("\n".join([f"[{section.name}]", *lines]))
    return "\n\n".join(parts) + "\n"


def _values(config: Config, section: Section) -> dict[str, Any] | None:
    """What the configuration holds for a section, by the names of its keys."""
    source: Any = getattr(config, section.name)
    if source is None:
        return None
    if section.name == "docking":
        return {key.name: source[key.name] for key in section.keys if key.name in source}
    values: dict[str, Any] = {}
    for key in section.keys:
        eye = section.name == "camera" and key.name in ("x", "y", "theta")
        value = getattr(source.camera if eye else source, key.name)
        if value is not None and (key.kind is not str or isinstance(value, str)):
            values[key.name] = value
    return values


def _toml(value: Any) -> str:
    if isinstance(value, Enum):
        return _toml(value.value)
    if isinstance(value, str):  # what JSON escapes TOML does, but for this one character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value)


def template() -> str:
    """Every section and key with its meaning; a configuration as it stands.

    Keys that are commented out show their defaults.
    """
    parts = [
        "# Configuration of clfcbf. SI units and radians; an angle, or a rate of one, may be\n"
        f"# given in degrees under its name with {DEGREES}. What is commented out is the default."
    ]
    for section in SECTIONS:
        mark = "# " if section.optional else ""
        lines = [f"# {section.about[0].upper()}{section.about[1:]}.", f"{mark}[{section.name}]"]
        for key in section.keys:
            lines += [_comment(key), _line(section, key)]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _comment(key: Key) -> str:
    return textwrap.fill(
        key.about, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False
    )


def _line(section: Section, key: Key) -> str:
    value = _EXAMPLE.get(f"{section.name}.{key.name}", key.default)
    if value is None:  # which TOML has not: left out is what it means
        return f"# {key.name} ="
    shown = value is not key.default and not section.optional
    name = key.name
    if key.name == "half_angle":
        name, value = name + DEGREES, round(math.degrees(value), 9)
    assert value is not REQUIRED, (section.name, key.name)
    return f"{'' if shown else '# '}{name} = {_toml(value)}"
