"""View compensation: what a board cut by the edge of the view does to its estimated pose.

``python -m benchmarks.compensation [--poses N] [--seed S] [--sensor ideal|A] [--json FILE]
[--plot FILE]``

The paper's experiment: a depth camera at 50 random poses before a board, the error of the
estimated pose with compensation and without. Drawn uniformly: distance 0.6 to 2.3 m, yaw of the
board within 35°, bearing wherever a quarter of the board or more is in view. Five estimates
share each frame's line, and so the yaw:

``none``           mean of the board's pixels, as segmentation gives it
``printed``        that, and the paper's two formulas taken literally, x forward and y left
``printed, best``  the same in whichever of 128 conventions of sign, axis and edge leaves the
                   least median error on these very poses: more than the paper lets one know
``law of sines``   middle of the visible part, and the right formulas
``free end``       what the library does

Where no edge cuts the board there is nothing to compensate, and the first three are one.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clfcbf.errors import ClfcbfError
from clfcbf.perception import (
    BoardDetector,
    BoardPose,
    DepthColumns,
    End,
    compensated_centre,
    printed_centre,
    printed_length,
)
from clfcbf.se2 import Point, Pose2, wrap_angle
from clfcbf.simulation.depth import DepthCamera, DepthModel
from clfcbf.simulation.scenarios import World

__all__ = ["METHODS", "Convention", "View", "draw_board", "main", "measure"]

METHODS = ("none", "printed", "printed, best", "law of sines", "free end")
DISTANCES = (0.6, 2.3)
YAW = math.radians(35.0)
VISIBLE = 0.25
"""Least share of the board in view, a little above what the detector asks for."""
LISTED = 30
"""Poses that the table names by number; the JSON has all of them."""
SHARES = np.linspace(-0.5, 0.5, 1001)


class Convention(NamedTuple):
    """One way to read the printed formulas."""

    turned: bool  # the board's yaw counts from the direction towards the robot
    yaw: int  # its sign
    bearing: int  # sign of the bearing
    mirrored: bool  # a board cut on the right is mirrored first
    swapped: bool  # the correction is (lateral, forward)
    first: int  # signs of its components
    second: int

    def __str__(self) -> str:
        vector = [f"{'+-'[s < 0]}{axis}" for s, axis in ((self.first, "c"), (self.second, "s"))]
        if self.swapped:
            vector.reverse()
        return (
            f"yaw {'pi ' if self.turned else ''}{'+-'[self.yaw < 0]} theta, "
            f"bearing {'+-'[self.bearing < 0]}phi, right edge "
            f"{'mirrored' if self.mirrored else 'as it is'}, correction [{', '.join(vector)}] "
            "with c = cos, s = -sin of that yaw"
        )


LITERAL = Convention(False, 1, 1, False, False, 1, 1)
CONVENTIONS = tuple(
    Convention(*choice)
    for choice in itertools.product(
        (False, True), (1, -1), (1, -1), (False, True), (False, True), (1, -1), (1, -1)
    )
)


@dataclass(frozen=True, slots=True)
class View:
    """One pose: the true board in the camera's frame, its share in view, and what was found."""

    board: Pose2
    visible: float
    cut: str
    found: BoardPose | None
    pixels: Point

    @property
    def side(self) -> int:
        """+1 if the left edge alone cuts the board, -1 if the right one does, else 0."""
        if self.found is None:
            return 0
        right, left = (edge.end is not End.FREE for edge in self.found.extent)
        return int(left) - int(right)


def draw_board(rng: np.random.Generator, half_angle: float, width: float) -> Pose2:
    """A board of which enough is in view, in the camera's frame."""
    while True:
        distance = rng.uniform(*DISTANCES)
        bearing = rng.uniform(-1.0, 1.0) * (half_angle + math.atan(0.5 * width / distance))
        board = Pose2(
            distance * math.cos(bearing), distance * math.sin(bearing), rng.uniform(-YAW, YAW)
        )
        if in_view(board, half_angle, width)[0] >= VISIBLE:
            return board


def in_view(board: Pose2, half_angle: float, width: float) -> tuple[float, str]:
    """Share of the board inside the view, and which of its edges cut it."""
    x = board.x - math.sin(board.theta) * width * SHARES
    y = board.y + math.cos(board.theta) * width * SHARES
    bearing = np.arctan2(y, x)
    cut = [name for name, out in (("left", bearing.max() > half_angle),
                                  ("right", bearing.min() < -half_angle)) if out]  # fmt: skip
    return float(np.mean(np.abs(bearing) <= half_angle)), "+".join(cut) or "none"


def _look(board: Pose2, columns: DepthColumns, half_angle: float, detector: BoardDetector) -> View:
    share, cut = in_view(board, half_angle, detector.width)
    found = detector.detect(columns)
    if not isinstance(found, BoardPose):
        return View(board, share, cut, None, (math.nan, math.nan))
    depths = columns.depths(detector.span)[found.columns]
    lateral = depths * columns.tangents()[found.columns]
    return View(board, share, cut, found, (float(depths.mean()), float(lateral.mean())))


def printed(
    convention: Convention, middle: Point, theta: float, half_angle: float, width: float, side: int
) -> Point:
    """The printed compensation, read by one convention."""
    x, y = middle
    flip = -1.0 if convention.mirrored and side < 0 else 1.0
    yaw = convention.yaw * flip * theta + (math.pi if convention.turned else 0.0)
    seen = (x, convention.bearing * flip * y)
    if convention == LITERAL:
        return printed_centre(seen, yaw, half_angle, width)
    shift = 0.5 * (printed_length(seen, yaw, half_angle) - width)
    first = shift * convention.first * math.cos(yaw)
    second = -shift * convention.second * math.sin(yaw)
    if convention.swapped:
        first, second = second, first
    return x + first, y + flip * second


def _error(centre: Point, board: Pose2) -> Point:
    return centre[0] - board.x, centre[1] - board.y


def best_convention(views: Sequence[View], half_angle: float, width: float) -> Convention:
    """The reading with the least median error of the centre over the boards that are cut."""
    cut = [view for view in views if view.side]
    if not cut:
        return LITERAL

    def median(convention: Convention) -> float:
        errors = []
        for view in cut:
            assert view.found is not None
            theta = view.found.fit.line.theta
            centre = printed(convention, view.pixels, theta, half_angle, width, view.side)
            errors.append(math.hypot(*_error(centre, view.board)))
        return float(np.median(errors))

    return min(CONVENTIONS, key=median)


def estimates(view: View, best: Convention, half_angle: float, width: float) -> dict[str, Point]:
    """The board's centre by each method, in the camera's frame."""
    assert view.found is not None
    line, extent = view.found.fit.line, view.found.extent
    theta, side = line.theta, view.side
    ends = np.array([line.at(extent.right.tangent), line.at(extent.left.tangent)])
    x, y = ends.mean(axis=0).tolist()
    sines = compensated_centre((x, y), theta, half_angle, width, side) if side else (x, y)

    def read(convention: Convention) -> Point:
        if not side:
            return view.pixels
        return printed(convention, view.pixels, theta, half_angle, width, side)

    pose = view.found.pose
    return {
        "none": view.pixels,
        "printed": read(LITERAL),
        "printed, best": read(best),
        "law of sines": sines,
        "free end": (pose.x, pose.y),
    }


def measure(
    poses: int = 50, seed: int = 0, sensor: str = "A", world: World | None = None
) -> dict[str, Any]:
    """Run the experiment; every pose is in the result, also where no board was found."""
    world = world or World()
    width, half_angle = world.board_width, world.camera.half_angle
    model = DepthModel.named(sensor)
    camera = DepthCamera(model, half_angle, width)
    detector = BoardDetector(width, noise=model.noise, span=model.span)
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(poses):
        board = draw_board(rng, half_angle, width)
        columns = camera.columns(board, camera.draw(rng))
        views.append(_look(board, columns, half_angle, detector))
    best = best_convention(views, half_angle, width)
    rows = [_row(k, view, best, half_angle, width) for k, view in enumerate(views)]
    return {
        "settings": {
            "poses": poses, "seed": seed, "sensor": sensor, "width_m": width,
            "half_angle_deg": math.degrees(half_angle), "columns": model.columns,
        },
        "best_convention": str(best),
        "poses": rows,
        "summary": {
            "all": _summary(rows),
            "cut": _summary([row for row in rows if row["cut"] != "none"]),
        },
    }  # fmt: skip


def _row(
    index: int, view: View, best: Convention, half_angle: float, width: float
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "pose": index, "x_m": view.board.x, "y_m": view.board.y,
        "theta_deg": math.degrees(view.board.theta), "visible": view.visible, "cut": view.cut,
        "found": view.found is not None, "e_theta_deg": None, "errors": {},
    }  # fmt: skip
    if view.found is not None:
        row["e_theta_deg"] = math.degrees(wrap_angle(view.found.pose.theta - view.board.theta))
        for name, centre in estimates(view, best, half_angle, width).items():
            lon, lat = _error(centre, view.board)
            row["errors"][name] = {"e_lon_mm": 1e3 * lon, "e_lat_mm": 1e3 * lat}
    return row


def _summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    found = [row for row in rows if row["found"]]
    summary: dict[str, Any] = {"poses": len(rows), "found": len(found)}
    if not found:
        return summary
    summary["e_theta_deg"] = _spread([row["e_theta_deg"] for row in found])
    for name in METHODS:
        errors = [row["errors"][name] for row in found]
        lon, lat = ([error[axis] for error in errors] for axis in ("e_lon_mm", "e_lat_mm"))
        centre = np.hypot(lon, lat)
        summary[name] = {
            "e_lon_mm": _spread(lon),
            "e_lat_mm": _spread(lat),
            "centre_mm": {"median": float(np.median(centre)), "max": float(centre.max())},
        }
    return summary


def _spread(values: Sequence[float]) -> dict[str, float]:
    low, median, high = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
    return {"median": median, "iqr": high - low, "max_abs": float(np.abs(values).max())}


def table(result: dict[str, Any]) -> str:
    """The summary as text, all poses and those at which the board is cut."""
    lines = []
    for group, about in (("all", "all poses"), ("cut", "poses at which the view cuts the board")):
        summary = result["summary"][group]
        lines.append(f"{about}: {summary['poses']}, the board found at {summary['found']}")
        if not summary["found"]:
            continue
        lines.append(f"  {'':15}{'longitudinal [mm]':>24}{'lateral [mm]':>24}{'centre [mm]':>20}")
        lines.append(f"  {'':15}{'median     IQR':>24}{'median     IQR':>24}{'median     max':>20}")
        for name in METHODS:
            one = summary[name]
            lon, lat, centre = one["e_lon_mm"], one["e_lat_mm"], one["centre_mm"]
            lines.append(
                f"  {name:15}{lon['median']:16.1f}{lon['iqr']:8.1f}{lat['median']:16.1f}"
                f"{lat['iqr']:8.1f}{centre['median']:12.1f}{centre['max']:8.1f}"
            )
        yaw = summary["e_theta_deg"]
        lines.append(f"  yaw, the same for all: median {yaw['median']:.2f}°, IQR {yaw['iqr']:.2f}°")
    for edge in ("left", "right", "left+right"):
        cut = [row["pose"] for row in result["poses"] if row["cut"] == edge]
        some = ", ".join(map(str, cut[:LISTED])) + (", ..." if len(cut) > LISTED else "")
        lines.append(f"cut {edge}: {len(cut)} poses" + (f", no. {some}" if cut else ""))
    lines.append(f"printed, best: {result['best_convention']}")
    return "\n".join(lines)


def figure(result: dict[str, Any]) -> Any:
    """Box plots of the three errors; each pose a dot, filled where the board is cut."""
    from matplotlib.figure import Figure

    rows = [row for row in result["poses"] if row["found"]]
    drawn = Figure(figsize=(12.0, 4.5), layout="constrained")
    lon, lat, yaw = drawn.subplots(1, 3, width_ratios=(1.0, 1.0, 0.35))
    for axes, axis, name in ((lon, "e_lon_mm", "longitudinal"), (lat, "e_lat_mm", "lateral")):
        columns = [[row["errors"][method][axis] for row in rows] for method in METHODS]
        _boxes(axes, columns, rows, METHODS)
        axes.set_yscale("symlog", linthresh=10.0)
        axes.set_ylabel(f"{name} error [mm], linear within ±10")
    _boxes(yaw, [[row["e_theta_deg"] for row in rows]], rows, ("all",))
    yaw.set_ylabel("yaw error [°]")
    summary = result["summary"]
    drawn.suptitle(
        f"Board seen from {summary['all']['poses']} random poses, "
        f"cut by the edge of the view at {summary['cut']['poses']} (filled)"
    )
    return drawn


def _boxes(
    axes: Any,
    columns: Sequence[Sequence[float]],
    rows: Sequence[dict[str, Any]],
    names: Sequence[str],
) -> None:
    axes.boxplot(columns, widths=0.6, showfliers=False, medianprops={"color": "black"})
    axes.set_xticks(range(1, len(names) + 1), [name.replace(", ", ",\n") for name in names])
    axes.axhline(0.0, color="grey", linewidth=0.6)
    spread = np.linspace(-0.2, 0.2, len(rows))
    for cut, face in ((False, "none"), (True, "#d55e00")):
        chosen = [k for k, row in enumerate(rows) if (row["cut"] != "none") == cut]
        for place, values in enumerate(columns, start=1):
            axes.scatter(place + spread[chosen], [values[k] for k in chosen], s=12,
                         facecolors=face, edgecolors="#d55e00" if cut else "#0072b2",
                         linewidths=0.7, zorder=3)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 whatever it found."""
    parser = argparse.ArgumentParser(
        prog="benchmarks.compensation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--poses", type=_at_least_one, default=50, help="the paper's 50")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sensor", choices=("ideal", "A"), default="A")
    parser.add_argument("--json", type=Path, metavar="FILE", help="overwritten")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="PNG, PDF or SVG, by its ending")
    options = parser.parse_args(arguments)
    if options.plot is not None:
        from clfcbf.plots import check_format

        try:
            check_format(options.plot)
        except ClfcbfError as error:
            parser.error(str(error))
    result = measure(options.poses, options.seed, options.sensor)
    print(table(result))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if options.plot is not None:
        from clfcbf.plots import save_figure

        save_figure(figure(result), options.plot)
    return 0


def _at_least_one(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {count}")
    return count


if __name__ == "__main__":
    sys.exit(main())
