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
from collections.abc import Mapping
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
from clfcbf.errors import ClfcbfError
from clfcbf.estimation import NoiseModel
from clfcbf.laws.kanayama import Kanayama
from clfcbf.limits import Limits
from clfcbf.recorder.errors import LogError
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
        made = _read(json.loads(text))
    except LogError:
        raise
    except (ClfcbfError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise LogError(f"the log's configuration is unusable: {error}") from error
    if not isinstance(made, DockingConfig | TrackingConfig | FilterConfig):
        raise LogError(f"the log's configuration is no controller's but a {type(made).__name__}")
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
    return kind(**{key: _read(value) for key, value in content.items() if key != _KIND})
