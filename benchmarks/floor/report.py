"""Floors as table rows, and the times of a controller as ratios to them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.floor.program import REGULARISATION
from benchmarks.floor.search import COARSE, FINE, floor_time
from clfcbf.errors import ConfigurationError, GeometryError, PlanningError
from clfcbf.simulation.campaign import EpisodeSpec
from clfcbf.simulation.scenarios import World, draw_start, limits_named, region_named, world_of

__all__ = ["Key", "config", "episodes_in", "floor_record", "key", "ratios", "summary", "table"]

Key = tuple[str, str, int, int]
"""Region, limits, seed and index: one start of one robot."""

_NUMBERS = (
    "time_s", "bound_s", "spread_s", "optima", "failed", "path_m", "reversed_m", "violation_deg",
    "end_mm", "end_deg", "intervals",
)  # fmt: skip


def key(record: Mapping[str, Any]) -> Key:
    """The start that a record belongs to; limits that it does not name are the region's."""
    region = str(record["region"])
    limits = str(record.get("limits") or region_named(region).limits)
    return region, limits, int(record["seed"]), int(record["index"])


def config() -> dict[str, Any]:
    """What the floors depend on besides the start."""
    return {"coarse": COARSE, "fine": FINE, "regularisation": REGULARISATION}


def floor_record(spec: EpisodeSpec) -> dict[str, Any]:
    """The floor from the start of that run, as one flat table row.

    ``outcome`` is "ok", "out of view" (the feature is, at the start) or "not found"; without a
    floor its numbers are NaN.
    """
    region, limits = region_named(spec.region), limits_named(spec.limits)
    world = world_of(region, World())
    start = draw_start(region, world, spec.stream(0))
    row: dict[str, Any] = {
        "region": spec.region, "limits": spec.limits, "seed": spec.seed, "index": spec.index,
        **start._asdict(),
    }  # fmt: skip
    try:
        floor = floor_time(start, world, limits)
    except (GeometryError, PlanningError) as error:
        outcome = "out of view" if isinstance(error, GeometryError) else "not found"
        return {**row, "outcome": outcome, "guess": "", **dict.fromkeys(_NUMBERS, math.nan)}
    motion = floor.trajectory
    v = motion.states[:, 3]
    values = (
        floor.time, floor.bound, floor.spread, floor.optima, floor.failed,
        _integral(np.abs(v), motion.duration), _integral(np.maximum(-v, 0.0), motion.duration),
        math.degrees(floor.violation), 1e3 * floor.certificate.end_error,
        math.degrees(floor.certificate.end_turn), len(motion.accelerations),
    )  # fmt: skip
    numbers = dict(zip(_NUMBERS, values, strict=True))
    return {**row, "outcome": "ok", "guess": floor.guess, **numbers}


def _integral(values: np.ndarray[Any, np.dtype[np.float64]], duration: float) -> float:
    step = duration / (len(values) - 1)
    return float(step * (values.sum() - 0.5 * (values[0] + values[-1])))


def episodes_in(path: Path) -> list[dict[str, Any]]:
    """The runs in a JSON file of ``clfcbf approach`` or of another campaign in its format."""
    try:
        episodes = list(json.loads(path.read_text(encoding="utf-8"))["episodes"])
        for episode in episodes:
            key(episode), float(episode["time_s"]), bool(episode["success"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{str(path)!r} holds no episodes: {error}") from error
    return episodes


def ratios(
    floors: Iterable[Mapping[str, Any]], episodes: Iterable[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Time of each successful run over the floor of its own start."""
    times = {key(floor): floor["time_s"] for floor in floors if floor["outcome"] == "ok"}
    return [
        {
            "region": episode["region"],
            "controller": episode.get("controller", ""),
            "seed": episode["seed"],
            "index": episode["index"],
            "time_s": episode["time_s"],
            "ratio": episode["time_s"] / times[key(episode)],
        }
        for episode in episodes
        if episode["success"] and key(episode) in times
    ]


def summary(
    floors: Sequence[Mapping[str, Any]], compared: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Any]:
    """By region: counts and means of the floors, and by controller the ratios' distribution."""
    result: dict[str, Any] = {}
    for region in dict.fromkeys(str(floor["region"]) for floor in floors):
        mine = [floor for floor in floors if floor["region"] == region]
        found = [floor for floor in mine if floor["outcome"] == "ok"]
        row: dict[str, Any] = {
            "starts": len(mine),
            "floors": len(found),
            "time_s": _mean([floor["time_s"] for floor in found]),
            "over_bound": _mean([floor["time_s"] / floor["bound_s"] for floor in found]),
            "spread_s_max": max((floor["spread_s"] for floor in found), default=math.nan),
            "reversing": sum(floor["reversed_m"] > REVERSED for floor in found),
            "violation_deg_max": max((f["violation_deg"] for f in found), default=math.nan),
        }
        names = dict.fromkeys(str(run["controller"]) for run in compared)
        row["ratios"] = {
            name: _distribution(
                [r["ratio"] for r in compared if (r["region"], r["controller"]) == (region, name)]
            )
            for name in names
        }
        result[region] = row
    return result


REVERSED = 0.01
"""[m] Driven backward by a floor that counts as reversing."""


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def _distribution(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {"runs": 0, "mean": math.nan, "median": math.nan, "max": math.nan}
    return {
        "runs": len(values),
        "mean": _mean(values),
        "median": float(np.median(values)),
        "max": float(max(values)),
    }


def table(result: Mapping[str, Any]) -> str:
    """The summary as aligned plain text."""
    lines = [
        f"{'region':<8}{'floors':>9}{'time s':>9}{'/ bound':>9}{'spread s':>10}{'reverse':>9}"
        f"{'outside deg':>13}"
    ]
    for region, row in result.items():
        count = f"{row['floors']}/{row['starts']}"
        lines.append(
            f"{region:<8}{count:>9}{row['time_s']:>9.3f}{row['over_bound']:>9.4f}"
            f"{row['spread_s_max']:>10.3f}{row['reversing']:>9}{row['violation_deg_max']:>13.3f}"
        )
        for name, ratio in row["ratios"].items():
            lines.append(
                f"  {name:<15} time/floor mean {ratio['mean']:.4f}, median "
                f"{ratio['median']:.4f}, max {ratio['max']:.4f} over {ratio['runs']} successes"
            )
    return "\n".join(lines)
