"""The figure of a campaign: where the robots drove, how fast, what they saw, where they stopped.

Figures are drawn on a canvas of their own; nothing of matplotlib's global state is touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clfcbf import plot_panels as panels
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.plot_panels import Record
from clfcbf.simulation.campaign import Track
from clfcbf.simulation.scenarios import World, region_named, world_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "approach_figure", "check_format", "save_figure"]

FORMATS = (".png", ".svg", ".pdf")
"""Suffixes that a figure can be saved under."""

SIZE = (13.333, 7.5)
"""[inch] A 16:9 slide."""

RESOLUTION = 200
"""[dots per inch] Of a PNG: 2667 x 1500 pixels, sharp on a projector."""


def check_format(path: Path) -> None:
    """Raise unless a figure can be saved under this name and matplotlib is installed."""
    if path.suffix.lower() not in FORMATS:
        raise ConfigurationError(
            f"cannot draw to {str(path)!r}: its suffix must be one of {', '.join(FORMATS)}"
        )
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("matplotlib", "viz") from error


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure in the format of the path's suffix; ``ConfigurationError`` where it cannot."""
    check_format(path)
    try:
        figure.savefig(path, dpi=RESOLUTION)
    except OSError as error:
        raise ConfigurationError(f"cannot write {str(path)!r}: {error.strerror}") from error


def approach_figure(
    records: Sequence[Record], tracks: Sequence[Track], world: World | None = None
) -> Figure:
    """Draw a campaign on one slide.

    Paths in the goal's frame with the camera's view along a few of them; commanded speed, turn
    rate and the bearing of the feature over time with their bounds; final errors with the
    tolerances of 30 mm and 10 mm. Three runs have colours, the same in every panel: the one
    that came closest to losing the feature, and those that start farthest to either side; where
    these coincide, the longest run.

    Parameters
    ----------
    records, tracks : the runs, as ``record_and_track`` gives them
    world : what stood where

    Raises
    ------
    ConfigurationError : there are no runs, or not one track to each
    MissingExtraError : matplotlib is not installed
    """
    if not records or len(records) != len(tracks):
        raise ConfigurationError(
            f"a figure needs one track to each run and at least one run, "
            f"got {len(records)} runs and {len(tracks)} tracks"
        )
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("matplotlib", "viz") from error
    seen = world_of(region_named(records[0]["region"]), world)
    runs = panels.Runs(records, tracks, panels.styles_of(records, tracks), seen)
    figure = Figure(figsize=SIZE, facecolor="white")
    FigureCanvasAgg(figure)
    _header(figure, records)
    outer = figure.add_gridspec(
        1, 2, width_ratios=(1.5, 1.0), left=0.055, right=0.985, top=0.855, bottom=0.115, wspace=0.14
    )
    panels.draw_paths(figure.add_subplot(outer[0]), runs)
    right = outer[1].subgridspec(2, 1, height_ratios=(2.15, 1.0), hspace=0.3)
    rows = right[0].subgridspec(4, 1, height_ratios=(1.0, 1.0, 0.12, 1.0), hspace=0.2)
    panels.draw_histories(figure, (rows[0], rows[1], rows[3]), runs)
    pair = right[1].subgridspec(1, 2, wspace=0.42)
    panels.draw_errors(
        figure.add_subplot(pair[0]), runs, panels.ERROR_SPAN, "d  Final position error"
    )
    span = panels.span_of(records)
    title = "enlarged" if span < panels.ERROR_SPAN else "every run"
    panels.draw_errors(figure.add_subplot(pair[1]), runs, span, title)
    return figure


def _header(figure: Figure, records: Sequence[Record]) -> None:
    first, n = records[0], len(records)
    success = sum(bool(record["success"]) for record in records)
    strict = sum(bool(record["strict"]) for record in records)
    times = [record["time_s"] for record in records]
    margin = min(record["min_fov_margin_deg"] for record in records)
    figure.text(
        0.018, 0.955,
        f"{success} of {n} docked within 30 mm and 5°, {strict} within 10 mm and 2°",
        fontsize=18, fontweight="bold", color=panels.INK, va="center",
    )  # fmt: skip
    sensor = "ideal sensor and body" if first["ideal"] else f"sensor {first['sensor']}"
    about = (
        f"controller {first['controller']}, {first['plant']} plant, {sensor}, "
        f"{first['limits']} limits, region {first['region']}, seed {first['seed']}.  "
        f"Time {np.mean(times):.1f} s on average, {max(times):.1f} s at most.  "
        f"Smallest view margin {margin:.1f}°."
    )
    figure.text(0.018, 0.912, about, fontsize=10.5, color=panels.MUTED, va="center")
