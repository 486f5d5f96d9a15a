"""What is assumed of the world, as data: the declared bounds, and sets that break one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from clfcbf.errors import ConfigurationError
from clfcbf.simulation.plant import DEFAULT_GYRO_BIAS, DEFAULT_LAG, DEFAULT_SLIP

__all__ = ["DECLARED", "GROUPS", "SETS", "Assumptions", "names_of", "set_named"]

SIGMAS = 3.0
"""Slip and gyro bias are normal in the simulated body; what is declared is three sigma of them."""

PROTECTIONS = ("full", "rows", "limits")


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Bounds within which the adversary is free, at each tick unless said otherwise.

    Attributes
    ----------
    bearing : error of the feature's bearing at the camera [rad]
    range_offset, range_scale : error of its distance from the camera, [m] and share of it
    latency : longest age of a frame at the tick it arrives [s]
    stamp : error of a frame's stamp [s]
    dropouts : ticks in a row without a frame, at most
    lag : shortest and longest first-order lag of the body [s], constant in a run
    scale : scale error of speed and turn rate, constant in a run
    drift : bias of the turn rate while the command is to move [rad/s], constant in a run
    nudge : distance by which the feature is moved once in a run [m]
    missed : ticks in a row in which no command is computed and the last one stays, at most
    clip : share of the acceleration limits that the chassis really has
    gain : class-K gain of the rows [1/s]; 0 for the default one
    protection : "full", "rows" without the guard, or "limits" without the rows as well
    """

    bearing: float = 0.0
    range_offset: float = 0.0
    range_scale: float = 0.0
    latency: float = 0.0
    stamp: float = 0.0
    dropouts: int = 0
    lag: tuple[float, float] = (DEFAULT_LAG, DEFAULT_LAG)
    scale: float = 0.0
    drift: float = 0.0
    nudge: float = 0.0
    missed: int = 0
    clip: float = math.inf
    gain: float = 0.0
    protection: str = "full"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "protection":
                if value not in PROTECTIONS:
                    raise ConfigurationError(
                        f"protection must be one of {', '.join(PROTECTIONS)}; got {value!r}"
                    )
                continue
            low, high = value if field.name == "lag" else (value, value)
            if not 0.0 <= low <= high:
                raise ConfigurationError(f"{field.name} must be at least 0, got {value!r}")


DECLARED = Assumptions(
    bearing=math.radians(1.0),
    range_offset=0.005,
    range_scale=0.02,
    latency=0.12,
    stamp=0.03,
    dropouts=3,
    lag=(0.05, 0.25),
    scale=SIGMAS * DEFAULT_SLIP,
    drift=SIGMAS * DEFAULT_GYRO_BIAS,
)
"""The bounds that the guarantee is stated for. Besides, the feature is at rest and stays farther
from the camera than the run's end, and the chassis takes every command."""

_LATE = Assumptions(latency=DECLARED.latency, dropouts=DECLARED.dropouts)

_SINGLE: dict[str, Assumptions] = {
    "no error at all": Assumptions(),
    "old frames": _LATE,
    "only bearing": replace(_LATE, bearing=DECLARED.bearing),
    "only range": replace(
        _LATE, range_offset=DECLARED.range_offset, range_scale=DECLARED.range_scale
    ),
    "only stamps": replace(_LATE, stamp=DECLARED.stamp),
    "only lag 0.05 s": replace(_LATE, lag=(0.05, 0.05)),
    "only lag 0.25 s": replace(_LATE, lag=(0.25, 0.25)),
    "only slip": replace(_LATE, scale=DECLARED.scale, drift=DECLARED.drift),
}
_BROKEN: dict[str, Assumptions] = {
    "slip 10 %": replace(DECLARED, scale=0.1),
    "lag 0.5 s": replace(DECLARED, lag=(0.5, 0.5)),
    "stamps off by 0.1 s": replace(DECLARED, stamp=0.1),
    "bearing error 3 deg": replace(DECLARED, bearing=math.radians(3.0)),
    "feature nudged 0.1 m": replace(DECLARED, nudge=0.1),
    "10 missed ticks": replace(DECLARED, missed=10),
    "chassis clips at half": replace(DECLARED, clip=0.5),
    "gain 10/s": replace(DECLARED, gain=10.0),
    "gain 10/s, guard off": replace(DECLARED, gain=10.0, protection="rows"),
    "guard off": replace(DECLARED, protection="rows"),
    "guard and rows off": replace(DECLARED, protection="limits"),
}

SETS: dict[str, Assumptions] = {"declared": DECLARED, **_SINGLE, **_BROKEN}

GROUPS: dict[str, tuple[str, ...]] = {
    "single": tuple(_SINGLE),
    "broken": tuple(_BROKEN),
    "all": (*_SINGLE, *_BROKEN),
}
"""``single``: one source of error at a time, beside old frames; ``broken``: the declared bounds
with one of them broken, or parts of the filter switched off."""


def set_named(name: str) -> Assumptions:
    """The set of that name; ``ConfigurationError`` lists the valid ones."""
    if name not in SETS:
        raise ConfigurationError(f"unknown assumptions {name!r}; choose from {', '.join(SETS)}")
    return SETS[name]


def names_of(text: str, others: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Sets by name or group, separated by commas, each once; ``others`` are names as well.

    Raises ``ConfigurationError`` for a name that is neither.
    """
    names: dict[str, None] = {}
    for word in filter(None, (part.strip() for part in text.split(","))):
        if word not in GROUPS and word not in SETS and word not in others:
            valid = ", ".join((*GROUPS, *SETS, *others))
            raise ConfigurationError(f"unknown assumptions {word!r}; choose from {valid}")
        names |= dict.fromkeys(GROUPS.get(word, (word,)))
    return tuple(names)
