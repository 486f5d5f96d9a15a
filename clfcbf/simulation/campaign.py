"""Many runs: a seeded specification of each, workers to run them, and a summary."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clfcbf.controller import DockingController
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.simulation.episode import EpisodeController, EpisodeResult, Trace, run_episode
from clfcbf.simulation.events import Nudges
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body, Plant
from clfcbf.simulation.scenarios import World, draw_start, limits_named, region_named, world_of
from clfcbf.simulation.sensors import SensorName, make_sensor

__all__ = [
    "CONTROLLERS",
    "PLANTS",
    "EpisodeSpec",
    "MakeController",
    "Track",
    "check_spec",
    "record",
    "record_and_track",
    "run_all",
    "run_specs",
    "simulate",
    "summarise",
]

PLANTS = ("kinematic", "mujoco")
CONTROLLERS = ("clf-cbf", "paper")

T = TypeVar("T")

TRACK_TICKS = 3
"""Ticks from one sample of a track to the next: 10 Hz, 4 cm at full speed, enough for a line."""


MakeController = Callable[[World, Limits, float], EpisodeController]
"""Makes a run's controller from the world, the limits and the body's lag [s]."""


@dataclass(frozen=True, slots=True)
class EpisodeSpec:
    """One run, reproducible from these values alone.

    Attributes
    ----------
    region : where it starts
    seed, index : of the campaign, and of the run in it; start, body, sensor and nudges each have
        their own random stream, so that controllers meet the same ones
    controller, plant, backend : by name
    sensor : one of :data:`~clfcbf.simulation.sensors.SENSORS`
    limits : by name; those of the region if none is given
    ideal : no lag, no slip, no noise, no latency
    """

    region: str = "R1"
    seed: int = 0
    index: int = 0
    controller: str = "clf-cbf"
    plant: str = "kinematic"
    sensor: str = "A"
    limits: str = ""
    backend: str = "exact"
    ideal: bool = False

    def __post_init__(self) -> None:
        region = region_named(self.region)
        if not self.limits:
            object.__setattr__(self, "limits", region.limits)
        limits_named(self.limits)
        SensorName.of(self.sensor)
        for name, choices in (("plant", PLANTS), ("controller", CONTROLLERS)):
            if getattr(self, name) not in choices:
                raise ConfigurationError(
                    f"unknown {name} {getattr(self, name)!r}; choose from {', '.join(choices)}"
                )

    def stream(self, what: int) -> np.random.Generator:
        """The random stream of one part of the run: 0 start, 1 body, 2 sensor, 3 nudges."""
        return np.random.default_rng([self.seed, self.index, what])


def _plant(spec: EpisodeSpec, world: World) -> tuple[Plant, Body]:
    start = draw_start(region_named(spec.region), world, spec.stream(0))
    body = Body.ideal() if spec.ideal else Body()
    limits = limits_named(spec.limits)
    if spec.plant == "kinematic":
        return KinematicPlant(start, limits, body, spec.stream(1)), body
    from clfcbf.simulation.mujoco_plant import MujocoPlant

    plant = MujocoPlant(
        start, limits, body, spec.stream(1), standoff=world.standoff, board_width=world.board_width
    )
    return plant, body


def _controller(spec: EpisodeSpec, world: World, lag: float) -> EpisodeController:
    limits = limits_named(spec.limits)
    if spec.controller == "paper":
        from clfcbf.paper_docking import PaperDocking

        return PaperDocking(limits, world.camera, world.standoff, world.period, lag=lag)
    return DockingController(
        limits, world.camera, world.standoff, world.period, spec.backend, lag=lag
    )


def _ideal(spec: EpisodeSpec) -> str:
    """The sensor of the spec's kind that makes no errors."""
    kind, _ = SensorName.of(spec.sensor)
    return f"{kind}-ideal" if kind else "ideal"


def simulate(
    spec: EpisodeSpec, world: World | None = None, make: MakeController | None = None
) -> tuple[EpisodeResult, Trace]:
    """Run one episode from its specification.

    Parameters
    ----------
    spec : the run
    world : what stands where, before what is particular to the region
    make : makes the controller, in place of the one that the spec names
    """
    region = region_named(spec.region)
    world = world_of(region, world)
    limits = limits_named(spec.limits)
    plant, body = _plant(spec, world)
    name = _ideal(spec) if spec.ideal else spec.sensor
    sensor = make_sensor(name, plant, world, spec.stream(2), region.markers)
    nudges = Nudges(region.nudges, spec.stream(3)) if region.nudges else None
    if make is None:
        controller = _controller(spec, world, body.lag)
    else:
        controller = make(world, limits, body.lag)
    try:
        return run_episode(plant, sensor, controller, world, limits, nudges)
    finally:
        plant.close()


def check_spec(spec: EpisodeSpec, world: World | None = None) -> None:
    """Build the plant and the controller of a run once and throw them away.

    What is unknown or not installed is then reported before a campaign starts, in the process
    that starts it. Raises what their constructors raise, all of it a ``ClfcbfError``.
    """
    world = world_of(region_named(spec.region), world)
    plant, body = _plant(spec, world)
    try:
        _controller(spec, world, body.lag)
    finally:
        plant.close()


class Track(NamedTuple):
    """A run thinned out for a figure.

    ``times`` (N,) [s], true ``poses`` (N, 3) in the goal's frame [m, m, rad] and the
    ``commands`` (N, 2) sent there [m/s, rad/s].
    """

    times: NDArray[np.float64]
    poses: NDArray[np.float64]
    commands: NDArray[np.float64]

    @classmethod
    def of(cls, trace: Trace, every: int = TRACK_TICKS) -> Track:
        """Every ``every``-th tick of a trace, and its last one."""
        last = len(trace.times) - 1
        kept = [*range(0, last, every), last]
        return cls(
            np.array([trace.times[k] for k in kept]),
            np.array([trace.poses[k] for k in kept]),
            np.array([trace.decisions[k].twist for k in kept]),
        )


def record(spec: EpisodeSpec, world: World | None = None) -> dict[str, Any]:
    """Run one episode; its specification and its result in one flat table row."""
    result, _ = simulate(spec, world)
    return {**asdict(spec), **asdict(result)}


def record_and_track(spec: EpisodeSpec, world: World | None = None) -> dict[str, Any]:
    """As :func:`record`, with the run's :class:`Track` as ``"track"``."""
    result, trace = simulate(spec, world)
    return {**asdict(spec), **asdict(result), "track": Track.of(trace)}


def _leave_interrupts_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_specs(
    specs: Sequence[EpisodeSpec],
    workers: int = 1,
    work: Callable[[EpisodeSpec], dict[str, Any]] = record,
) -> Iterator[dict[str, Any]]:
    """Records of the runs, in their order, as they are finished; see :func:`run_all`."""
    return run_all(specs, workers, work)


def run_all(
    items: Sequence[T], workers: int, work: Callable[[T], dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """What ``work`` makes of each item, in their order, as they are finished.

    ``work`` goes to other processes if ``workers > 1``, so it has to be picklable: a function
    of a module, or a ``functools.partial`` of one.
    """
    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers!r}")
    if workers == 1:
        yield from map(work, items)
        return
    # A forked child may inherit a lock that one of the parent's threads, such as numpy's, holds.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        min(workers, max(len(items), 1)), context, _leave_interrupts_to_parent
    )
    try:
        yield from pool.map(work, items, chunksize=1)
    finally:
        pool.shutdown(cancel_futures=True)


def summarise(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts, means and worst cases over all runs, failed ones included."""
    if not records:
        return {"episodes": 0}

    def column(name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([record[name] for record in records], dtype=float)

    outcomes = [record["outcome"] for record in records]
    summary: dict[str, Any] = {
        "episodes": len(records),
        "success": int(column("success").sum()),
        "strict": int(column("strict").sum()),
        "outcomes": {name: outcomes.count(name) for name in sorted(set(outcomes))},
        "time_s_mean": float(column("time_s").mean()),
        "time_s_max": float(column("time_s").max()),
        "path_m_mean": float(column("path_m").mean()),
        "min_fov_margin_deg": float(column("min_fov_margin_deg").min()),
    }
    for name in ("e_lon_mm", "e_lat_mm", "e_theta_deg"):
        values = column(name)
        summary[name] = {
            "mean": float(values.mean()),
            "std": float(values.std(ddof=1)) if len(values) > 1 else 0.0,
            "mean_abs": float(np.abs(values).mean()),
            "max_abs": float(np.abs(values).max()),
        }
    for name in ("fov_lost", "limit_violations", "ticks", "infeasible_ticks", "guarded_ticks",
                 "unguarded_ticks"):  # fmt: skip
        summary[name] = int(column(name).sum())
    for name in ("step_us_p50", "step_us_p99"):
        summary[name] = float(np.median(column(name)))
    return summary
