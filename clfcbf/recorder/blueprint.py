"""A controller's configuration as JSON and back: the library's own parts by name, never code.

A log may come from anywhere, so what is read is built of the classes listed here and of nothing
else. Whatever a configuration holds besides (a barrier or a backend of the user's own) is written
as its ``repr``: such a log is explained and plotted as any other, and replayed with a
configuration that is given.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.constraints.capsule import Capsule
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.obstacle_set import Disc, Obstacles, Wall
from clfcbf.constraints.obstacles import Frame, ObstacleBarrier
from clfcbf.constraints.range_band import RangeBarrier
from clfcbf.controller import TrackingConfig
from clfcbf.docking import DockingConfig
from clfcbf.errors import ClfcbfError, LogError
from clfcbf.estimation import NoiseModel
from clfcbf.laws.kanayama import Kanayama
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2
from clfcbf.tick import FilterConfig
from clfcbf.trajectories.following import FollowingGains

__all__ = ["Configuration", "configuration_from_json", "configuration_to_json"]

Configuration = DockingConfig | TrackingConfig | FilterConfig
"""What a tick is a function of, beside its state and its inputs."""

_KINDS: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (
        Capsule, Disc, DockingConfig, FieldOfView, FieldOfViewBarrier, FilterConfig,
        FollowingGains, Frame, Kanayama, Limits, NoiseModel, ObstacleBarrier, Obstacles, Pose2,
        RangeBarrier, TrackingConfig, Wall,
    )
}  # fmt: skip

SHORTEST_PERIOD = 1e-3
"""[s] Twenty times faster than a loop in Python holds; to plan tick by tick takes the longer the
shorter they are, and a log must not keep its reader busy for ever."""

_KIND, _FOREIGN, _NUMBER = "kind", "foreign", "number"


def configuration_to_json(configuration: Configuration) -> str:
    """The configuration as JSON text, every float to the last bit."""
    return json.dumps(_written(configuration), allow_nan=False)


def configuration_from_json(text: str) -> Configuration:
    """The configuration that :func:`configuration_to_json` made ``text`` of.

    Raises
    ------
    LogError : the text is not one, or holds a part that is not the library's own
    """
    try:
        with np.errstate(all="ignore"):  # what overflows here is refused, or harms nobody
            made = _read(json.loads(text))
            if isinstance(made, DockingConfig | TrackingConfig | FilterConfig):
                base = made if isinstance(made, FilterConfig) else made.filter
                base.limits.brake_horizon(base.period)  # whose quotients must exist
    except LogError:
        raise
    except (ClfcbfError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise LogError(f"the log's configuration is unusable: {error}") from error
    if not isinstance(made, DockingConfig | TrackingConfig | FilterConfig):
        raise LogError(f"the log's configuration is no controller's but a {type(made).__name__}")
    base = made if isinstance(made, FilterConfig) else made.filter
    if base.period < SHORTEST_PERIOD:
        raise LogError(
            f"the log's period must be at least {SHORTEST_PERIOD:g} s, got {base.period!r}"
        )
    return made


def _names(kind: type[Any]) -> list[str]:
    """The fields that an object of that kind is made of."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind) if field.init]
    return list(kind._fields)


def _written(value: Any) -> Any:
    if value is None or isinstance(value, bool | str) or type(value) is int:
        return value
    if isinstance(value, np.ndarray):
        return [_written(item) for item in value.tolist()]
    if isinstance(value, int | float | np.number):
        number = float(value)
        return number if math.isfinite(number) else {_NUMBER: str(number)}
    kind = type(value)
    if _KINDS.get(kind.__name__) is kind:
        if isinstance(value, Enum):
            return {_KIND: kind.__name__, "value": value.value}
        return {_KIND: kind.__name__} | {n: _written(getattr(value, n)) for n in _names(kind)}
    if isinstance(value, tuple | list):
        return [_written(item) for item in value]
    return {_FOREIGN: repr(value)}


def _read(content: Any) -> Any:
    if isinstance(content, list):
        return tuple(_read(item) for item in content)
    if not isinstance(content, dict):
        return content
    if _FOREIGN in content:
        raise LogError(
            f"the log's configuration holds {content[_FOREIGN]}, which a log cannot: "
            "give replay the configuration that was used"
        )
    if _NUMBER in content:
        return float(content[_NUMBER])
    return _made(content)


def _made(content: Mapping[str, Any]) -> Any:
    name = content.get(_KIND)
    kind = _KINDS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise LogError(f"the log's configuration holds a {name!r}; valid: {', '.join(_KINDS)}")
    if issubclass(kind, Enum):
        return kind(content.get("value"))
    unknown = set(content) - {_KIND, *_names(kind)}
    if unknown:
        raise LogError(
            f"the log's {name} has a {unknown.pop()!r}; valid: {', '.join(_names(kind))}"
        )
    values = {key: _read(value) for key, value in content.items() if key != _KIND}
    hints = typing.get_type_hints(kind)
    for key, value in values.items():
        if not _fits(hints[key], value):
            raise LogError(f"the log's {name} has {value!r} for its {key}")
    return kind(**values)


def _fits(hint: Any, value: Any) -> bool:
    """Whether a value is of a field's type; types that say nothing of one fit anything."""
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(argument, value) for argument in arguments)
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        if arguments[-1] is Ellipsis:
            return all(_fits(arguments[0], item) for item in value)
        return len(value) == len(arguments) and all(map(_fits, arguments, value))
    if origin is Callable:
        return callable(value)
    if isinstance(hint, type) and origin is None and not _is_vague(hint):
        return isinstance(value, hint)
    return True


def _is_vague(kind: type[Any]) -> bool:
    """Whether it is a protocol that cannot be asked."""
    protocol = getattr(kind, "_is_protocol", False)
    return bool(protocol) and not getattr(kind, "_is_runtime_protocol", False)
