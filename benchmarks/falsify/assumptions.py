"""What is assumed of the world, as data: the declared bounds, and sets that break one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

from clfcbf.errors import ConfigurationError

__all__ = ["BROKEN", "DECLARED", "SETS", "SINGLE", "Assumptions", "set_named"]


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
    """

    bearing: float = 0.0
    range_offset: float = 0.0
    range_scale: float = 0.0
    latency: float = 0.0
    stamp: float = 0.0
    dropouts: int = 0
    lag: tuple[float, float] = (0.12, 0.12)
    scale: float = 0.0
    drift: float = 0.0
    nudge: float = 0.0
    missed: int = 0
    clip: float = math.inf

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
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
    scale=0.03,
    drift=math.radians(0.3),
)
"""The bounds that the guarantee is stated for; slip and gyro bias are three sigma of the body's."""

LATE = Assumptions(latency=0.12, dropouts=3)
"""Nothing wrong but old frames, all else as the filter models it."""

SINGLE: dict[str, Assumptions] = {
    "nothing": Assumptions(),
    "only latency": LATE,
    "only bearing": replace(LATE, bearing=DECLARED.bearing),
    "only range": replace(LATE, range_offset=0.005, range_scale=0.02),
    "only stamp": replace(LATE, stamp=DECLARED.stamp),
    "only lag 0.05": replace(LATE, lag=(0.05, 0.05)),
    "only lag 0.25": replace(LATE, lag=(0.25, 0.25)),
    "only slip": replace(LATE, scale=DECLARED.scale, drift=DECLARED.drift),
}
"""One source of error at a time, beside old frames."""

BROKEN: dict[str, Assumptions] = {
    "slip 10 %": replace(DECLARED, scale=0.1),
    "lag 0.5 s": replace(DECLARED, lag=(0.5, 0.5)),
    "stamp error 100 ms": replace(DECLARED, stamp=0.1),
    "bearing error 3 deg": replace(DECLARED, bearing=math.radians(3.0)),
    "feature nudged 0.1 m": replace(DECLARED, nudge=0.1),
    "10 missed ticks": replace(DECLARED, missed=10),
    "chassis clips at half": replace(DECLARED, clip=0.5),
}
"""The declared bounds with one of them broken."""

SETS: dict[str, Assumptions] = {"declared": DECLARED, **SINGLE, **BROKEN}


def set_named(name: str) -> Assumptions:
    """The set of that name; ``ConfigurationError`` lists the valid ones."""
    if name not in SETS:
        raise ConfigurationError(f"unknown assumptions {name!r}; choose from {', '.join(SETS)}")
    return SETS[name]
