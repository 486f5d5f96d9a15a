"""The comparison as figures: success, errors, and the ways of wins and losses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.docking.ablations import ABLATIONS
from benchmarks.docking.campaign import OURS
from benchmarks.docking.statistics import wilson
from benchmarks.docking.store import cells_of, run_of
from clfcbf.simulation.scenarios import World, region_named, world_of

__all__ = ["figures_of"]

Record = Mapping[str, Any]

_OURS, _OTHERS, _WON, _LOST = "#0072b2", "#8a94a0", "#009e73", "#d55e00"  # apart for all eyes
_TOLERANCES = {"e_lon_mm": 30.0, "e_lat_mm": 30.0, "e_theta_deg": 5.0}
_LABELS = {"e_lon_mm": "|e_lon| [mm]", "e_lat_mm": "|e_lat| [mm]", "e_theta_deg": "|e_θ| [deg]"}
_COLUMNS = 4  # panels side by side
_LEAST = 1e-2  # [mm, deg] an error that a logarithmic axis still shows


def figures_of(document: Mapping[str, Any]) -> Iterator[tuple[str, str, Figure]]:
    """Each figure with a name for its file and a title."""
    records, tracks = document["episodes"], document.get("tracks", {})
    for sensor in dict.fromkeys(record["sensor"] for record in records):
        own = [record for record in records if record["sensor"] == sensor]
        rivals = [r for r in own if r["controller"] not in ABLATIONS]
        ablated = [r for r in own if r["controller"] in (OURS, *ABLATIONS)]
        if rivals:
            yield f"success-{sensor}", f"Success, sensor {sensor}", _success(rivals)
            yield f"errors-{sensor}", f"Errors, sensor {sensor}", _errors(rivals)
        if any(record["controller"] in ABLATIONS for record in ablated):
            title = f"Ours with one part left out, sensor {sensor}"
            yield f"ablation-{sensor}", title, _success(ablated)
        for region in dict.fromkeys(record["region"] for record in rivals):
            there = [r for r in rivals if r["region"] == region and run_of(r).key in tracks]
            if there:
                title = f"Ways from {region}, sensor {sensor}: wins green, losses orange"
                yield f"ways-{region}-{sensor}", title, _ways(there, tracks, title)


def _names(records: Sequence[Record], field: str) -> list[str]:
    return list(dict.fromkeys(record[field] for record in records))


def _panels(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(count, _COLUMNS)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for unused in panels[count:]:
        unused.set_visible(False)
    return figure, panels


def _success(records: Sequence[Record]) -> Figure:
    """A panel for each region: success rates with their intervals."""
    cells, sensor = cells_of(records), records[0]["sensor"]
    regions, methods = _names(records, "region"), _names(records, "controller")[::-1]
    figure, panels = _panels(len(regions), 4.0, 0.28 * len(methods) + 1.2)
    for region, axes in zip(regions, panels, strict=False):
        for y, method in enumerate(methods):
            cell = cells.get(f"{region}/{sensor}/{method}")
            if not cell:
                continue
            wins, runs = sum(bool(r["success"]) for r in cell), len(cell)
            strict = sum(bool(r["strict"]) for r in cell)
            color = _OURS if method == OURS else _OTHERS
            low, high = wilson(wins, runs)
            axes.plot([100 * low, 100 * high], [y, y], color=color, linewidth=2.5)
            axes.plot(100 * wins / runs, y, "o", color=color)
            axes.plot(100 * strict / runs, y, "|", color=color, markersize=9)
        axes.set_yticks(range(len(methods)), methods)
        axes.set(title=region, xlim=(-3.0, 103.0), xlabel="success [%], | strict")
        axes.grid(axis="x", alpha=0.25)
    return figure


def _errors(records: Sequence[Record]) -> Figure:
    """A panel for each error and region: the share of runs below each size."""
    cells, sensor = cells_of(records), records[0]["sensor"]
    regions, methods = _names(records, "region"), _names(records, "controller")
    figure = Figure(figsize=(12.0, 2.6 * len(regions) + 0.8), layout="constrained")
    panels = figure.subplots(len(regions), len(_LABELS), squeeze=False, sharey=True)
    styles = ("-", "--", ":", "-.")
    for row, region in zip(panels, regions, strict=True):
        for axes, (name, label) in zip(row, _LABELS.items(), strict=True):
            for rank, method in enumerate(methods):
                cell = cells.get(f"{region}/{sensor}/{method}")
                if not cell:
                    continue
                sizes = np.sort(np.maximum(np.abs([record[name] for record in cell]), _LEAST))
                axes.step(
                    sizes, np.arange(1, len(sizes) + 1) / len(sizes), where="post", label=method,
                    linestyle="-" if method == OURS else styles[rank // 10 % 4],
                    color=_OURS if method == OURS else f"C{rank % 10}",
                    linewidth=2.4 if method == OURS else 1.1,
                    zorder=3 if method == OURS else 2,
                )  # fmt: skip
            axes.axvline(_TOLERANCES[name], color="black", linewidth=0.8, linestyle=":")
            axes.set(xscale="log", xlabel=label, ylim=(0.0, 1.03))
            axes.grid(alpha=0.25)
        row[0].set_ylabel(f"{region}: share of runs")
    figure.legend(
        *panels[0][0].get_legend_handles_labels(), loc="outside lower center",
        ncols=6, fontsize="small",
    )  # fmt: skip
    return figure


def _ways(records: Sequence[Record], tracks: Mapping[str, Any], title: str) -> Figure:
    """A panel for each method: the first ways that were won and lost, from start to end."""
    methods = _names(records, "controller")
    figure, panels = _panels(len(methods), 3.6, 2.8)
    figure.suptitle(title)
    world = world_of(region_named(records[0]["region"]), World())
    half = 0.5 * world.board_width
    for method, axes in zip(methods, panels, strict=False):
        for record in records:
            if record["controller"] != method:
                continue
            x, y, _ = np.array(tracks[run_of(record).key]).T
            color = _WON if record["success"] else _LOST
            axes.plot(x, y, color=color, linewidth=1.0, zorder=2 if record["success"] else 3)
            axes.plot(x[-1], y[-1], "o" if record["success"] else "X", color=color, markersize=4)
        axes.plot([world.standoff] * 2, [-half, half], color="black", linewidth=4)
        axes.plot(0.0, 0.0, "+", color="black", markersize=10, zorder=4)
        axes.set(title=method, xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.grid(alpha=0.25)
    return figure
