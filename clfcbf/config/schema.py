"""The sections and keys of a configuration file, read off the dataclasses themselves."""

from __future__ import annotations

import inspect
import re
import types
import typing
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from typing import Any

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.docking import DockingConfig
from clfcbf.estimation import NoiseModel
from clfcbf.limits import Limits
from clfcbf.runtime.policy import LoopPolicy
from clfcbf.tick import FilterConfig
from clfcbf.trajectories.following import FollowingGains
from clfcbf.wheels import WheelLimits

__all__ = ["DEGREES", "REQUIRED", "SECTIONS", "Key", "Section"]

REQUIRED: Any = MISSING
"""The default of a key that has none."""

DEGREES = "_deg"
"""Ending of a key that gives an angle, or a rate of one, in degrees."""

_ANGLES = frozenset(
    {"alpha_max", "done_theta", "drift", "half_angle", "omega_max", "sigma_theta", "theta"}
)

_SHORT = {
    "half_angle": "half of the horizontal field of view [rad], 35° for a camera of 70°",
    "backend": "solver of the quadratic program, see: clfcbf doctor",
    "radius": "of the wheels [m]",
    "sigma_xy": "standard deviation of a measured position [m]",
    "sigma_theta": "standard deviation of a measured heading [rad]",
    "along": "of dead reckoning along the way, share of it",
    "across": "of dead reckoning across the way, share of it",
    "turn": "of dead reckoning's heading, share of the angle turned",
    "drift": "of dead reckoning's heading with time [rad/s]",
    "gate": "sigmas beyond which a measurement is left out",
    "rejections": "measurements left out in a row that agree, after which they are believed",
    "settled": "measurements after which mirrored ones no longer outvote an estimate",
}
"""What is told of keys in place of an attribute's docstring, or where there is none."""

_CAMERA = {
    "x": "position of the camera on the robot, forward [m]",
    "y": "as above, to the left [m]",
    "theta": "direction of the camera, counter-clockwise [rad]",
}


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section.

    Attributes
    ----------
    name : as in the file, for SI units
    kind : float, int, str, an ``Enum``, or a tuple type of floats
    default : its value where it is left out; ``REQUIRED`` where it must not be
    about : what it means, with its unit in brackets
    """

    name: str
    kind: Any
    default: Any
    about: str

    @property
    def is_angle(self) -> bool:
        """Whether the file may give it in degrees, under its name with ``_deg``."""
        return self.name in _ANGLES


@dataclass(frozen=True, slots=True)
class Section:
    """One table of the file.

    Attributes
    ----------
    name : of the table
    about : what it is for
    keys : in the order of the template
    optional : whether leaving the table out means that there is no such thing
    """

    name: str
    about: str
    keys: tuple[Key, ...]
    optional: bool = False

    def key(self, name: str) -> Key | None:
        """The key of that name, in SI units or in degrees; None if there is none."""
        for key in self.keys:
            if name == key.name or (key.is_angle and name == key.name + DEGREES):
                return key
        return None

    @property
    def names(self) -> list[str]:
        """Every name that the file may use."""
        degrees = [key.name + DEGREES for key in self.keys if key.is_angle]
        return [key.name for key in self.keys] + degrees


def _keys(kind: type[Any], skip: tuple[str, ...] = (), base: Any = None) -> tuple[Key, ...]:
    """The keys of a dataclass or named tuple: its fields of a kind that TOML can hold.

    ``base`` gives the defaults of a class whose fields have none.
    """
    hints = typing.get_type_hints(kind)
    about = _attributes(kind.__doc__ or "")
    found = []
    for name, default in _defaults(kind, base):
        simple = _simple(hints[name])
        if simple is not None and name not in skip:
            text = _SHORT.get(name) or about.get(name, "")
            found.append(Key(name, simple, default, text))
    return tuple(found)


def _defaults(kind: type[Any], base: Any) -> list[tuple[str, Any]]:
    if not is_dataclass(kind):
        return [(name, getattr(base, name)) for name in kind._fields]
    named = []
    for field in fields(kind):
        if field.init and not field.name.startswith("_"):
            made = field.default_factory
            named.append((field.name, made() if made is not MISSING else field.default))
    return named


def _simple(hint: Any) -> Any:
    """The kind of value that the file holds for a field of that type; None where it has none."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [_simple(part) for part in typing.get_args(hint) if part is not types.NoneType]
        return next((kind for kind in kinds if kind is not None), None)
    if hint in (float, int, str) or (isinstance(hint, type) and issubclass(hint, Enum)):
        return hint
    if typing.get_origin(hint) is tuple and set(typing.get_args(hint)) == {float}:
        return hint
    return None


def _attributes(doc: str) -> dict[str, str]:
    """What a NumPy docstring says of each attribute, by name."""
    # Some interpreters have already taken the indentation off.
    lines = inspect.cleandoc(doc).split("Attributes\n", 1)[-1].splitlines()
    told: dict[str, str] = {}
    names: list[str] = []
    for line in lines:
        entry = re.fullmatch(r"(\w+(?:, \w+)*) : (.*)", line)
        if entry:
            names = entry[1].split(", ")
            told.update(dict.fromkeys(names, entry[2]))
        elif names and line.startswith(" " * 4):
            told.update({name: f"{told[name]} {line.strip()}" for name in names})
        else:
            names = []
    return {name: re.sub(r":\w+:|`+|~[\w.]*\.", "", text) for name, text in told.items()}


_EYE = tuple(Key(name, float, 0.0, about) for name, about in _CAMERA.items())

SECTIONS: tuple[Section, ...] = (
    Section("limits", "what the chassis can do", _keys(Limits)),
    Section(
        "wheels",
        "what the driven wheels can do; leave it out where the limits above say it all",
        _keys(WheelLimits),
        optional=True,
    ),
    Section("camera", "where the camera sits and how wide it sees", (*_keys(FieldOfView), *_EYE)),
    Section("filter", "period, prediction and guard", _keys(FilterConfig, ("patience",))),
    Section("docking", "the task", _keys(DockingConfig)),
    Section("gains", "of the path-following law", _keys(FollowingGains)),
    Section("noise", "of measurements and dead reckoning", _keys(NoiseModel, (), defaults.NOISE)),
    Section("loop", "late ticks and old measurements", _keys(LoopPolicy)),
)
"""The whole file."""
