"""The campaign as a figure: the smallest margin of every set, and what each strategy found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.falsify import paper
from benchmarks.falsify.subjects import ARENA
from clfcbf.plots import save_figure

__all__ = ["draw", "save"]

_TICKS = (-100.0, -50.0, -20.0, -10.0, -5.0, -2.5, 0.0, 2.5, 5.0)
_KEPT, _LOST = "#0072b2", "#d55e00"  # apart for every kind of colour vision


def draw(result: Mapping[str, Any]) -> Figure:
    """Two panels: a bar a set, a dot a run within the declared assumptions."""
    sets = {k: v for k, v in result["by_assumption"].items() if k != paper.NAME}
    figure = Figure(figsize=(12.0, 0.32 * len(sets) + 2.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = list(sets)[::-1]
    margins = [sets[name]["min_margin_deg"] for name in names]
    left.barh(names, margins, color=[_KEPT if value >= 0.0 else _LOST for value in margins])
    left.set(xlabel="smallest margin found [deg]", title="in view (right) and lost (left of 0)")
    left.set_xscale("symlog", linthresh=5.0)
    span = left.get_xlim()
    left.set_xticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
    left.set_xlim(span)
    _edge(left)
    runs = [run for run in result["runs"] if run["set"] == "declared"]
    strategies = list(dict.fromkeys(run["strategy"] for run in runs))[::-1]
    for y, strategy in enumerate(strategies):
        found = [run["margin_deg"] for run in runs if run["strategy"] == strategy]
        right.plot(found, [y] * len(found), "o", color=_KEPT, alpha=0.4, markersize=5)
    right.set_yticks(range(len(strategies)), strategies)
    right.set(xlabel="smallest margin of a run [deg]", title="declared assumptions, by strategy")
    right.axvline(
        math.degrees(ARENA.margin), color="grey", linestyle=":", label="kept at the start"
    )
    _edge(right)
    right.legend(loc="lower right", fontsize="small")
    return figure


def _edge(axes: Axes) -> None:
    axes.axvline(0.0, color="black", linewidth=1.0)
    axes.grid(axis="x", alpha=0.25)


def save(result: Mapping[str, Any], path: Path) -> None:
    """Write the figure; the ending says the format."""
    save_figure(draw(result), path)
