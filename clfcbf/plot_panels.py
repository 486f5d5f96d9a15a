"""The panels of the campaign figure, each drawn into axes that it is given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.se2 import Pose2
from clfcbf.simulation.campaign import Track
from clfcbf.simulation.scenarios import World, limits_named, region_named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Record",
    "Runs",
    "Style",
    "bearings",
    "draw_errors",
    "draw_histories",
    "draw_paths",
    "span_of",
    "styles_of",
]

Record = Mapping[str, Any]

CONES = 4
"""Camera cones along a featured run; more would cover one another."""

CONE_LENGTH = 0.5
"""[m] Of a cone: long enough to read its direction, short enough not to hide the next."""

# Wong's palette, told apart with every common kind of colour vision.
FEATURED = ("#0072B2", "#009E73", "#CC79A7")
_FAILED = "#D55E00"
_OTHERS = "#B4BEC9"
INK = "#1F2933"
MUTED = "#5F6C7B"
_GRID = "#E6EAEE"

ERROR_SPAN = 36.0
"""[mm] Half the width of the panel of errors: the wider tolerance and a margin."""

_TOLERANCES = ((30.0, "30 mm"), (10.0, "10 mm"))
_ARROW = 0.16  # [m] length of a start's arrow
_GOAL_ARROW = 0.24  # [m]
_DASHED = (0.0, (5.0, 2.0))


def bearings(track: Track, world: World) -> NDArray[np.float64]:
    """The camera's bearing of the feature along a track, (N,) [rad]."""
    feature = (world.feature.x, world.feature.y)
    return np.array([world.camera.bearing(Pose2(*pose).seen(feature)) for pose in track.poses])


class Style(NamedTuple):
    """How one run is drawn in every panel; ``bold`` runs have a colour of their own."""

    color: str
    width: float
    order: int
    about: str
    bold: bool = False

    @property
    def marker_color(self) -> str:
        """Of what is small: darker than a thin line where that is pale."""
        return MUTED if self.color == _OTHERS else self.color


class Runs(NamedTuple):
    """What a panel draws: the runs, how each is drawn, and what stood where."""

    records: Sequence[Record]
    tracks: Sequence[Track]
    styles: Sequence[Style]
    world: World


def styles_of(records: Sequence[Record], tracks: Sequence[Track]) -> list[Style]:
    """A style for each run: up to three have a colour and a name, the rest stay behind them."""
    styles = [
        Style(_OTHERS, 0.9, 2, "other runs")
        if record["success"]
        else Style(_FAILED, 1.1, 3, "not within 30 mm and 5°")
        for record in records
    ]
    sides = [track.poses[0, 1] for track in tracks]
    margins = [record["min_fov_margin_deg"] for record in records]
    times = [record["time_s"] for record in records]
    chosen: dict[int, str] = {}
    for index, about in (
        (int(np.argmin(margins)), "closest to the edge of view"),
        (int(np.argmax(sides)), "leftmost start"),
        (int(np.argmin(sides)), "rightmost start"),
        (int(np.argmax(times)), "longest run"),
    ):
        chosen.setdefault(index, about)
    for rank, (color, (index, about)) in enumerate(zip(FEATURED, chosen.items(), strict=False)):
        styles[index] = Style(color, 1.6 if rank else 2.4, 5 if rank else 6, about, bold=True)
    return styles


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=11, fontweight="bold", color=INK, pad=6)
    axes.set_xlabel(x, fontsize=9.5, color=INK, labelpad=2)
    axes.set_ylabel(y, fontsize=9.5, color=INK)
    axes.tick_params(labelsize=9, colors=MUTED, length=3)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(MUTED)


def draw_paths(axes: Axes, runs: Runs) -> None:
    """Paths in the goal's frame, camera cones along the bold ones, the board and the goal."""
    title = "a  Paths in the goal's frame, with the camera's view along some of them"
    _dress(axes, title, "ahead of the goal [m]", "left of the goal [m]")
    named: set[str] = set()
    for track, style in zip(runs.tracks, runs.styles, strict=True):
        axes.plot(
            track.poses[:, 0], track.poses[:, 1], color=style.color, linewidth=style.width,
            zorder=style.order, label=None if style.about in named else style.about,
        )  # fmt: skip
        named.add(style.about)
        if style.bold:
            _draw_cones(axes, track, style, runs.world)
    starts = np.array([track.poses[0] for track in runs.tracks])
    axes.quiver(
        starts[:, 0], starts[:, 1], np.cos(starts[:, 2]), np.sin(starts[:, 2]),
        color=[style.marker_color for style in runs.styles],
        angles="xy", scale_units="xy", scale=1.0 / _ARROW, width=0.0042, headwidth=3.6,
        headlength=4.2, headaxislength=3.8, zorder=7,
    )  # fmt: skip
    _draw_world(axes, runs)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.04)
    entries = sorted(
        zip(*axes.get_legend_handles_labels(), strict=True), key=lambda e: -e[0].get_zorder()
    )
    axes.legend(
        *zip(*entries, strict=True), loc="upper center", bbox_to_anchor=(0.5, -0.075),
        ncol=len(entries), frameon=False, fontsize=9.5, labelcolor=INK, handlelength=1.6,
        columnspacing=1.6,
    )  # fmt: skip


def _draw_cones(axes: Axes, track: Track, style: Style, world: World) -> None:
    from matplotlib.patches import Wedge

    half = math.degrees(world.camera.half_angle)
    for pose in _spaced(track, CONES):
        camera = pose.compose(world.camera.camera)
        ahead = math.degrees(camera.theta)
        axes.plot(
            [pose.x], [pose.y], "o", color=style.color, markersize=7, markeredgecolor="white",
            markeredgewidth=1.0, zorder=8,
        )  # fmt: skip
        axes.add_patch(
            Wedge(
                (camera.x, camera.y), CONE_LENGTH, ahead - half, ahead + half,
                facecolor=style.color, edgecolor=style.color, alpha=0.16, linewidth=0.8,
                zorder=style.order - 2,
            )
        )  # fmt: skip


def _draw_world(axes: Axes, runs: Runs) -> None:
    from matplotlib.patches import Rectangle

    name = runs.records[0]["region"]
    region = region_named(name)
    (near, far), (right, left) = region.e_lon, region.e_lat
    for low, high in ((right, left), (-left, -right)) if region.two_sided else ((right, left),):
        axes.add_patch(
            Rectangle(
                (near, low), far - near, high - low, fill=False, edgecolor=MUTED,
                linestyle=(0, (4, 3)), linewidth=1.0, zorder=1,
            )
        )  # fmt: skip
    lowest = -left if region.two_sided else right
    axes.text(near + 0.03, lowest + 0.03, f"start region {name}", fontsize=9, color=MUTED)
    ahead, wide = runs.world.standoff, 0.5 * runs.world.board_width
    axes.plot(
        [ahead, ahead], [-wide, wide], color=INK, linewidth=6, solid_capstyle="butt", zorder=8
    )
    axes.text(ahead, wide + 0.05, "board", ha="center", fontsize=10, color=INK)
    head = {
        "arrowstyle": "-|>,head_width=0.32,head_length=0.6", "color": INK, "linewidth": 2.2,
        "shrinkA": 0, "shrinkB": 0,
    }  # fmt: skip
    axes.annotate("", (_GOAL_ARROW, 0.0), (0.0, 0.0), zorder=9, arrowprops=head)
    axes.plot([0.0], [0.0], "o", color=INK, markersize=5, zorder=9)
    axes.text(0.1, -0.09, "goal", ha="center", va="top", fontsize=10, color=INK, zorder=9)


def _spaced(track: Track, count: int) -> list[Pose2]:
    """Poses at equal steps of the way, from the start; the last step before the end is left out."""
    steps = np.hypot(*np.diff(track.poses[:, :2], axis=0).T)
    way = np.concatenate(([0.0], np.cumsum(steps)))
    wanted = way[-1] * np.arange(count) / count
    return [Pose2(*track.poses[k]) for k in np.unique(np.searchsorted(way, wanted))]


def draw_histories(figure: Figure, cells: tuple[Any, Any, Any], runs: Runs) -> None:
    """Commanded speed and turn rate, and the bearing of the feature, with their bounds."""
    limits = limits_named(runs.records[0]["limits"])
    half = math.degrees(runs.world.camera.half_angle)
    speeds = [track.commands[:, 0] for track in runs.tracks]
    turn_rates = [track.commands[:, 1] for track in runs.tracks]
    angles = [np.degrees(bearings(track, runs.world)) for track in runs.tracks]
    reverses = min(float(speed.min()) for speed in speeds) < 0.05 * limits.reverse_speed

    top = figure.add_subplot(cells[0])
    middle = figure.add_subplot(cells[1], sharex=top)
    bottom = figure.add_subplot(cells[2], sharex=top)
    _dress(top, "b  Commanded speed and turn rate", "", "v [m/s]")
    _dress(middle, "", "", "ω [rad/s]")
    _dress(bottom, "c  Bearing of the board's centre in the camera", "time [s]", "β [°]")
    _bound(top, limits.reverse_speed, limits.v_max, both=reverses)
    _bound(middle, -limits.omega_max, limits.omega_max)
    _bound(bottom, -half, half)
    for axes, histories in ((top, speeds), (middle, turn_rates), (bottom, angles)):
        axes.tick_params(labelbottom=axes is bottom)
        for track, values, style in zip(runs.tracks, histories, runs.styles, strict=True):
            axes.plot(
                track.times, values, color=style.color, zorder=style.order,
                linewidth=1.3 if style.bold else 0.5,
            )  # fmt: skip
    end = max(float(track.times[-1]) for track in runs.tracks)
    top.set_xlim(0.0, max(end, runs.world.period))
    figure.align_ylabels([top, middle, bottom])


def _bound(axes: Axes, lower: float, upper: float, both: bool = True) -> None:
    """Lines at the upper or both bounds, shaded beyond."""
    room = 0.14 * (upper - lower)
    axes.set_ylim(lower - room if both else -0.5 * room, upper + room)
    axes.set_yticks([lower, 0.0, upper] if both else [0.0, upper])
    for bound, beyond in ((upper, room), (lower, -room)) if both else ((upper, room),):
        axes.axhline(bound, color=INK, linewidth=1.0, linestyle=_DASHED, zorder=8)
        axes.axhspan(bound, bound + beyond, color=INK, alpha=0.07, linewidth=0)


def span_of(records: Sequence[Record]) -> float:
    """Half the width [mm] of a square that shows every error, in steps that read well."""
    largest = max(max(abs(r["e_lon_mm"]), abs(r["e_lat_mm"]), 0.5) for r in records)
    power = 10.0 ** math.floor(math.log10(largest))
    return power * next(step for step in (1.2, 2.4, 6.0, 12.0) if largest < 0.9 * step * power)


def draw_errors(axes: Axes, runs: Runs, span: float, title: str) -> None:
    """Final position errors with the tolerances; a cross failed, and lies farther out at an edge.

    ``span`` [mm] is half the width shown.
    """
    from matplotlib.patches import Circle

    _dress(axes, title, r"$e_\mathrm{lon}$ [mm]", r"$e_\mathrm{lat}$ [mm]")
    for radius, name in _TOLERANCES:
        axes.add_patch(Circle((0.0, 0.0), radius, color=FEATURED[0], alpha=0.1, linewidth=0.0))
        axes.add_patch(
            Circle(
                (0.0, 0.0), radius, fill=False, edgecolor=MUTED, linewidth=1.0,
                linestyle=_DASHED, zorder=2,
            )
        )  # fmt: skip
        if 0.25 * span < radius < span:
            axes.text(
                0.0, -radius - 0.02 * span, name, ha="center", va="top", fontsize=8,
                color=MUTED, zorder=3,
            )  # fmt: skip
    edge = 0.97 * span
    for record, style in zip(runs.records, runs.styles, strict=True):
        good = record["success"]
        axes.plot(
            [min(max(record["e_lon_mm"], -edge), edge)],
            [min(max(record["e_lat_mm"], -edge), edge)],
            "o" if good else "X", color=style.marker_color,
            markersize=5.5 if style.bold or not good else 3.4,
            markeredgecolor="white", markeredgewidth=0.4, zorder=style.order + 3,
        )  # fmt: skip
    axes.set_xlim(-span, span)
    axes.set_ylim(-span, span)
    axes.set_aspect("equal", adjustable="box")
