"""The figure of a log: what was commanded, how much there was to spare, how long it took."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.decision import Status
from clfcbf.errors import LogError, MissingExtraError
from clfcbf.recorder.entries import LogEnd, LoggedTick
from clfcbf.recorder.log import FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["log_figure"]

_SIZE = (13.333, 7.5)  # [inch] a 16:9 slide
_INK, _MUTED, _GRID = "#1F2933", "#5F6C7B", "#E6EAEE"
_SENT, _NOMINAL, _BOX = "#0072B2", "#5F6C7B", "#DCE9F3"

# Wong's palette: told apart with every common kind of colour vision.
_STATUS_COLORS = {
    Status.RELAXED: "#56B4E9",
    Status.BARRIER_RELAXED: "#CC79A7",
    Status.GUARDED: "#E69F00",
    Status.BRAKING: "#D55E00",
    Status.OUT_OF_VIEW: "#D55E00",
    Status.STOPPED: "#B4BEC9",
    Status.NO_TARGET: "#5F6C7B",
    Status.OPTIMAL: "#009E73",
}
_FAULT_COLOR = "#000000"


class _History(NamedTuple):
    time: NDArray[np.float64]
    sent: NDArray[np.float64]
    nominal: NDArray[np.float64]
    box: NDArray[np.float64]
    clearance: NDArray[np.float64]
    timing: NDArray[np.float64]
    status: list[Status]


def log_figure(log: FlightLog) -> Figure:
    """Commands with the box each was chosen from, clearance, status and duration over time.

    Raises
    ------
    LogError : the log holds no tick that could be drawn
    MissingExtraError : matplotlib is not installed
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("matplotlib", "viz") from error
    history, end = _history(log)
    figure = Figure(figsize=_SIZE, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        5, 1, height_ratios=(1.0, 1.0, 1.0, 0.6, 0.25), left=0.07, right=0.985, top=0.9,
        bottom=0.12, hspace=0.16,
    )  # fmt: skip
    axes = [figure.add_subplot(grid[0])]
    axes += [figure.add_subplot(grid[row], sharex=axes[0]) for row in range(1, 5)]
    for index, (ax, label) in enumerate(zip(axes, ("v [m/s]", "ω [rad/s]"), strict=False)):
        _draw_command(ax, history, index)
        ax.set_ylabel(label)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, ncols=3)
    axes[2].plot(history.time, history.clearance, color=_SENT, lw=1.2)
    axes[2].axhline(0.0, color=_INK, lw=0.8)
    axes[2].set_ylabel("clearance\n[of its unit]")
    axes[3].plot(history.time, 1e3 * history.timing, color=_MUTED, lw=0.8)
    axes[3].set_ylabel("tick [ms]")
    _draw_status(axes[4], history)
    axes[4].set_xlabel("time since the first tick [s]")
    for ax in axes:
        ax.grid(color=_GRID, lw=0.6)
        ax.set_axisbelow(True)
        ax.tick_params(labelsize=8, labelbottom=ax is axes[4])
        ax.spines[["top", "right"]].set_visible(False)
    about = "" if end.intact else "   (cut short)" if end.cut else "   (damaged)"
    figure.text(
        0.018, 0.945, f"{log.path.name}: {len(history.status)} ticks, {history.time[-1]:.1f} s, "
        f"{log.header.get('started', '')}{about}",
        fontsize=14, color=_INK, va="center",
    )  # fmt: skip
    return figure


def _history(log: FlightLog) -> tuple[_History, LogEnd]:
    rows: list[tuple[float, ...]] = []
    status: list[Status] = []
    end = LogEnd(False, False, "", 0)
    for entry in log.entries():
        if isinstance(entry, LogEnd):
            end = entry
        elif isinstance(entry, LoggedTick) and math.isfinite(entry.now):
            d = entry.decision
            rows.append((entry.now, *entry.command, *d.nominal, *d.box, d.clearance, d.timing))
            status.append(d.status)
    if not rows:
        reason = f": {end.reason}" if end.reason else ""
        raise LogError(f"{str(log.path)!r} holds no tick{reason}")
    data = np.array(rows)
    data[~np.isfinite(data)] = np.nan
    time = data[:, 0] - data[0, 0]
    history = _History(
        time, data[:, 1:3], data[:, 3:5], data[:, 5:9], data[:, 9], data[:, 10], status
    )
    return history, end


def _draw_command(ax: Axes, history: _History, index: int) -> None:
    low, high = history.box[:, 2 * index], history.box[:, 2 * index + 1]
    ax.fill_between(history.time, low, high, color=_BOX, step="post", label="within reach")
    ax.step(
        history.time, history.nominal[:, index], where="post", color=_NOMINAL, lw=0.9, ls="--",
        label="nominal",
    )  # fmt: skip
    ax.step(history.time, history.sent[:, index], where="post", color=_SENT, lw=1.4, label="sent")


def _draw_status(ax: Axes, history: _History) -> None:
    """A band in the colour of each tick's status, and a legend of those that occur."""
    present = list(dict.fromkeys(history.status))
    for status in present:
        mask = np.array([found is status for found in history.status])
        mask[1:] |= mask[:-1]  # up to the next tick, which may have another
        color = _STATUS_COLORS.get(status, _FAULT_COLOR)
        ax.fill_between(
            history.time, 0.0, 1.0, where=mask, color=color, step="post", lw=0.0,
            label=status.value,
        )  # fmt: skip
    ax.set_yticks([])
    ax.set_ylabel("status", rotation=0, ha="right", va="center")
    ax.legend(
        loc="upper center", bbox_to_anchor=(0.5, -1.2), ncols=max(1, len(present)), fontsize=8,
        frameon=False,
    )  # fmt: skip
