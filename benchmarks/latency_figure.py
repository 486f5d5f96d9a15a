"""The latency benchmark as a figure: latency of every route, growth with obstacles and batches."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["draw", "save"]

_TICK, _SOLVE = "#0072b2", "#d55e00"  # apart for every kind of colour vision


def draw(result: dict[str, Any]) -> Figure:
    """Three panels: median to 99th percentile of each route; obstacles; batches."""
    rows = sorted(result["rows"], key=lambda r: -float(r["median_us"]))
    figure = Figure(figsize=(13.0, 0.3 * len(rows) + 2.0), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.5, 1.0, 1.0))
    _latencies(left, rows)
    _lines(middle, result["scaling"], "obstacles", "median_us", symlog=True)
    middle.set(xlabel="obstacle rows", ylabel="median, assembly included [µs]")
    _lines(right, result["batch"], "B", "per_second", symlog=False)
    right.set(xlabel="programs in one call", ylabel="programs per second")
    return figure


def save(result: dict[str, Any], path: Path) -> None:
    """Write the figure; the ending says the format."""
    draw(result).savefig(path, dpi=150)


def _latencies(axes: Axes, rows: list[dict[str, Any]]) -> None:
    for y, row in enumerate(rows):
        colour = _TICK if row["what"] == "tick" else _SOLVE
        axes.plot((row["median_us"], row["p99_us"]), (y, y), color=colour, linewidth=2.0)
        axes.plot(row["median_us"], y, "o", color=colour)
    axes.plot([], [], "o-", color=_TICK, label="state to command")
    axes.plot([], [], "o-", color=_SOLVE, label="program to answer")
    axes.set_yticks(range(len(rows)), [row["name"] for row in rows])
    axes.set(xscale="log", xlabel="median to 99th percentile [µs]")
    axes.grid(axis="x", which="both", alpha=0.25)
    axes.legend(loc="upper right")


def _lines(axes: Axes, rows: list[dict[str, Any]], x: str, y: str, *, symlog: bool) -> None:
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        axes.plot([row[x] for row in own], [row[y] for row in own], "o-", label=name)
    if symlog:
        axes.set_xscale("symlog", linthresh=10.0)
    else:
        axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
