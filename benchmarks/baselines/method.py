"""What a method of the comparison is: a controller with a stated source and tunable parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.simulation.episode import EpisodeController
from clfcbf.simulation.scenarios import World

__all__ = ["Method", "Range", "Setup"]

P = TypeVar("P")


class Range(NamedTuple):
    """Where a tuner may look for a parameter; ``log`` for one whose order of magnitude counts."""

    low: float
    high: float
    log: bool = True


@dataclass(frozen=True, slots=True)
class Setup:
    """What every method is told about the robot, and nothing more.

    Attributes
    ----------
    limits : of the chassis
    camera : the camera whose view has to hold the feature
    standoff : distance from the goal to the feature straight ahead of it [m]
    period : of the control loop [s]
    lag : first-order lag of the body, as identified [s]
    """

    limits: Limits
    camera: FieldOfView
    standoff: float
    period: float
    lag: float = 0.0

    @classmethod
    def of(cls, world: World, limits: Limits, lag: float = 0.0) -> Setup:
        """The setup of a simulated world."""
        return cls(limits, world.camera, world.standoff, world.period, lag)


@dataclass(frozen=True, slots=True)
class Method(Generic[P]):
    """One row of the comparison.

    Attributes
    ----------
    name : as on the command line
    about : in a few words, for a table
    source : where it is from
    departures : where it differs from that source, one sentence each; none for a method of ours
    stock : its parameters as published, or as assumed where ``departures`` says so
    space : the range of each parameter that a tuner may change; all are numbers
    build : makes a fresh controller; one run each, controllers remember

    Raises
    ------
    ConfigurationError : the space names what is no number among the parameters, or a range is
        empty, or logarithmic and not positive
    """

    name: str
    about: str
    source: str
    departures: tuple[str, ...]
    stock: P
    space: Mapping[str, Range]
    build: Callable[[Setup, P], EpisodeController]

    def __post_init__(self) -> None:
        known = _numbers(self.stock)
        for name, (low, high, log) in self.space.items():
            if name not in known:
                raise ConfigurationError(
                    f"{self.name}: no parameter {name!r}; choose from {', '.join(known)}"
                )
            if not (math.isfinite(high) and low < high and (low > 0.0 or not log)):
                raise ConfigurationError(
                    f"{self.name}: {name} needs low < high, both above 0 on a logarithmic "
                    f"scale, got ({low!r}, {high!r})"
                )

    def parameters(self, values: Mapping[str, float]) -> P:
        """The stock parameters with some of those in ``space`` replaced."""
        for name, value in values.items():
            if name not in self.space:
                raise ConfigurationError(
                    f"{self.name}: {name!r} is not tunable; choose from {', '.join(self.space)}"
                )
            if not self.space[name].low <= value <= self.space[name].high:
                raise ConfigurationError(
                    f"{self.name}: {name} must be in {list(self.space[name][:2])}, got {value!r}"
                )
        changed: Any = self.stock
        return replace(changed, **values)  # type: ignore[no-any-return]

    def controller(self, setup: Setup, parameters: P | None = None) -> EpisodeController:
        """A fresh controller, with the stock parameters if none are given."""
        return self.build(setup, self.stock if parameters is None else parameters)


def _numbers(parameters: object) -> dict[str, float]:
    """The numeric fields of a dataclass of parameters."""
    if not is_dataclass(parameters):
        raise ConfigurationError(f"parameters must be a dataclass, got {parameters!r}")
    values = {field.name: getattr(parameters, field.name) for field in fields(parameters)}
    return {name: value for name, value in values.items() if type(value) is float}
