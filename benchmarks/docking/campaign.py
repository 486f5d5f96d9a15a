"""What a run of the comparison is, by its names and numbers alone, and its record."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.baselines import METHODS, Method, Setup
from benchmarks.docking.ablations import ABLATIONS
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.simulation.campaign import EpisodeSpec, Track, simulate
from clfcbf.simulation.episode import EpisodeController
from clfcbf.simulation.scenarios import REGIONS, World, region_named
from clfcbf.simulation.sensors import SENSORS, SensorName

__all__ = [
    "OURS", "REGION_NAMES", "SENSOR_NAMES", "Run", "check", "execute", "method_of", "methods_of",
    "parts_of", "planned", "subsample_of",
]  # fmt: skip

OURS = "clf-cbf"
"""The method that all others are compared with."""

BLIND = 0.5
"""[s] Longest time without a measurement that is no loss of view where a run may start with the
feature out of it, and its angle to the edge says nothing."""

REGION_NAMES, SENSOR_NAMES = tuple(REGIONS), SENSORS
"""What "all" stands for on the command line."""

_ALL: dict[str, Method[Any]] = {
    **METHODS, **{name: ablation.method for name, ablation in ABLATIONS.items()}
}  # fmt: skip
_GROUPS = {"all": tuple(METHODS), "ablations": (OURS, *ABLATIONS)}


@dataclass(frozen=True, slots=True)
class Run:
    """One run of one method; start, body and sensor follow from seed and index alone."""

    region: str
    sensor: str
    method: str
    seed: int
    index: int

    @property
    def cell(self) -> str:
        """The runs it is counted with."""
        return f"{self.region}/{self.sensor}/{self.method}"

    @property
    def key(self) -> str:
        """What tells it from all others of one seed."""
        return f"{self.cell}/{self.index}"

    @property
    def spec(self) -> EpisodeSpec | None:
        """What is simulated; None where an ablation would leave out what plays no role."""
        ablation = ABLATIONS.get(self.method)
        sensor = self.sensor if ablation is None else ablation.sensor(self.sensor)
        if sensor is None:
            return None
        return EpisodeSpec(self.region, self.seed, self.index, sensor=sensor)


def method_of(name: str) -> Method[Any]:
    """A method or ablation by name; ``ConfigurationError`` lists the valid ones."""
    if name not in _ALL:
        raise ConfigurationError(
            f"unknown method {name!r}; choose from {', '.join((*_GROUPS, *_ALL))}"
        )
    return _ALL[name]


def parts_of(text: str, everything: Sequence[str]) -> tuple[str, ...]:
    """The names in a comma-separated list, each once; "all" stands for everything."""
    names = [part.strip() for part in text.split(",") if part.strip()]
    listed = [name for part in names for name in (everything if part == "all" else (part,))]
    if not listed:
        raise ConfigurationError(f"no name in {text!r}; choose from all, {', '.join(everything)}")
    return tuple(dict.fromkeys(listed))


def methods_of(text: str) -> tuple[str, ...]:
    """The methods in a comma-separated list, where "all" and "ablations" are groups."""
    names = [n for part in parts_of(text, _GROUPS["all"]) for n in _GROUPS.get(part, (part,))]
    for name in names:
        method_of(name)
    return tuple(dict.fromkeys(names))


def subsample_of(text: str) -> dict[str, int]:
    """Runs of the slow methods, from "name=runs,…"; ``ConfigurationError`` where it is wrong."""
    found: dict[str, int] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, count = part.partition("=")
        if not (count.isdecimal() and int(count) >= 1):
            raise ConfigurationError(f"expected NAME=RUNS, both given, got {part!r}")
        found[method_of(name).name] = int(count)
    return found


def planned(
    methods: Sequence[str], regions: Iterable[str], sensors: Sequence[str], runs: int, seed: int,
    subsample: Mapping[str, int] | None = None,
) -> list[Run]:  # fmt: skip
    """All runs, index by index, so that an interrupted campaign has compared like with like.

    Parameters
    ----------
    methods, regions, sensors : by name
    runs : of each of them in each of these
    seed : of the campaign
    subsample : fewer runs, the first ones, of methods that take long
    """
    for region in regions:
        region_named(region)
    for sensor in sensors:
        SensorName.of(sensor)
    counts = {name: min(runs, (subsample or {}).get(name, runs)) for name in methods}
    found = [
        Run(region, sensor, method, seed, index)
        for region in regions
        for sensor in sensors
        for index in range(runs)
        for method in methods
        if index < counts[method]
    ]
    return [run for run in found if run.spec is not None]


def check(methods: Iterable[str]) -> None:
    """Build one controller of each method: what is not installed is told before the first run."""
    world = World()
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    for name in methods:
        method_of(name).controller(Setup.of(world, limits))


def execute(run: Run) -> dict[str, Any]:
    """Make a run; its record: plain numbers, and the path it took as "track" (x, y, theta)."""
    spec = run.spec
    if spec is None:
        raise ConfigurationError(f"{run.method} is the same as {OURS} with sensor {run.sensor!r}")
    method = method_of(run.method)

    def make(world: World, limits: Limits, lag: float) -> EpisodeController:
        return method.controller(Setup.of(world, limits, lag))

    result, trace = simulate(spec, make=make)
    region = region_named(run.region)
    lost = result.fov_lost if region.visible is None else result.blind_s > BLIND
    return {
        **asdict(spec),
        "controller": run.method,
        "sensor": run.sensor,
        **asdict(result),
        "view_lost": lost,
        "track": [_rounded(pose) for pose in Track.of(trace).poses.tolist()],
    }


def _rounded(pose: Sequence[float]) -> list[float]:
    """Millimetres and milliradians, for a line in a figure."""
    return [round(value, 3) if math.isfinite(value) else 0.0 for value in pose]
