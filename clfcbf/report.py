"""What a campaign leaves behind: a table to read and a JSON file to compute with."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from clfcbf.errors import ConfigurationError

__all__ = ["PAPER", "PaperRow", "check_writable", "table", "versions", "write_json"]

SHOWN_FAILURES = 10
"""Runs listed one by one that were not "ok": as many as fit on a screen beside the table."""

_DISTRIBUTIONS = ("numpy", "daqp", "qpsolvers", "mujoco-core")
_ERRORS = (("e_lon_mm", "e_lon [mm]"), ("e_lat_mm", "e_lat [mm]"), ("e_theta_deg", "e_theta [deg]"))


class PaperRow(NamedTuple):
    """A published result to stand beside ours: errors as (mean, standard deviation)."""

    success: int
    runs: int
    errors: Mapping[str, tuple[float, float]]
    times_s: tuple[float, ...]
    source: str


PAPER = PaperRow(
    success=30,
    runs=30,
    errors={"e_lon_mm": (2.08, 0.96), "e_lat_mm": (9.33, 10.51), "e_theta_deg": (2.12, 1.55)},
    times_s=(21.35, 23.83),
    source=(
        'Xie et al. (2024), "Autonomous Multiple-Trolley Collection System with Nonholonomic\n'
        'Robots", comparison of control strategies over 30 docking experiments: a real robot with\n'
        "its own sensor, errors of the successful runs (all 30), e_x and e_y there taken as e_lon\n"
        "and e_lat; times of the two trajectories it shows"
    ),
)
"""Terminal errors over 30 runs of the Approaching stage, and the durations of two, [Xie2024]_."""


def table(records: Sequence[Mapping[str, Any]], summary: Mapping[str, Any], heading: str) -> str:
    """The campaign as aligned plain text, with the paper's result beside it.

    Parameters
    ----------
    records, summary : the runs, and what ``summarise`` makes of them
    heading : what was run; goes on top
    """
    lines = [heading, "", *_success(summary), ""]
    failures = _failures(records)
    if failures:
        lines += [*failures, ""]
    lines += [*_errors(summary), "", *_quantities(summary), "", f"paper: {PAPER.source}."]
    return "\n".join(lines)


def _success(summary: Mapping[str, Any]) -> list[str]:
    n = summary["episodes"]

    def line(label: str, criterion: str, count: int, paper: str = "") -> str:
        return f"{label:<9}{criterion:<28}{f'{count}/{n}':>9}{paper}"

    paper = f"      paper {PAPER.success}/{PAPER.runs}"
    lines = [
        line("success", "rho < 30 mm, |theta| < 5 deg", summary["success"], paper),
        line("strict", "rho < 10 mm, |theta| < 2 deg", summary["strict"]),
    ]
    if summary["success"] < n:
        counts = (f"{name} {count}" for name, count in summary["outcomes"].items())
        lines.append(f"outcomes {', '.join(counts)}")
    return lines


def _failures(records: Sequence[Mapping[str, Any]]) -> list[str]:
    failed = [record for record in records if not record["success"]]
    lines = [
        f"  run {record['index']:<4} {record['outcome']:<15} "
        f"e_lon {record['e_lon_mm']:+.1f} mm, e_lat {record['e_lat_mm']:+.1f} mm, "
        f"e_theta {record['e_theta_deg']:+.2f} deg"
        + (f"  ({record['reason']})" if record["reason"] else "")
        for record in failed[:SHOWN_FAILURES]
    ]
    if len(failed) > SHOWN_FAILURES:
        lines.append(f"  and {len(failed) - SHOWN_FAILURES} more")
    return lines


def _spread(mean: float, deviation: float, sign: str = "+") -> str:
    return f"{mean:{sign}.2f} ± {deviation:5.2f}"


def _errors(summary: Mapping[str, Any]) -> Iterator[str]:
    yield f"{'error, all runs':<16}{'mean ± sd':>18}{'mean |e|':>11}{'max |e|':>11}{'paper':>18}"
    for key, label in _ERRORS:
        ours, paper = summary[key], PAPER.errors[key]
        yield (
            f"{label:<16}{_spread(ours['mean'], ours['std']):>18}"
            f"{ours['mean_abs']:>11.2f}{ours['max_abs']:>11.2f}{_spread(*paper, sign=''):>18}"
        )


def _quantities(summary: Mapping[str, Any]) -> list[str]:
    n, ticks = summary["episodes"], summary["ticks"]
    times = " and ".join(f"{time:.2f}" for time in PAPER.times_s)
    rows = [
        (
            "time [s]",
            f"mean {summary['time_s_mean']:.2f}, max {summary['time_s_max']:.2f}"
            f"      paper {times}",
        ),
        (
            "view margin",
            f"smallest {summary['min_fov_margin_deg']:.2f} deg, "
            f"lost in {summary['fov_lost']} of {n} runs",
        ),
        ("limits", f"violated by {summary['limit_violations']} of {ticks} commands"),
        (
            "ticks",
            f"{summary['infeasible_ticks']} infeasible, {summary['guarded_ticks']} guarded, "
            f"{summary['unguarded_ticks']} without a certified brake, of {ticks}",
        ),
        (
            "tick [us]",
            f"p50 {summary['step_us_p50']:.0f}, p99 {summary['step_us_p99']:.0f} (median run)",
        ),
    ]
    return [f"{label:<16}{text}" for label, text in rows]


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of what it computes with, where installed."""
    import platform

    import clfcbf

    found = {"python": platform.python_version(), "clfcbf": clfcbf.__version__}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def check_writable(path: Path) -> None:
    """Raise ``ConfigurationError`` unless a file can be written at ``path``; leave it as it is."""
    with _unwritable(path):
        if path.is_dir():
            raise IsADirectoryError(None, "it is a directory")
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(None, "permission denied")
        if _replaceable(path):
            scratch = _scratch(path)
            scratch.touch(exist_ok=False)
            scratch.unlink()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write ``content``, all of it or nothing, over whatever is at ``path``.

    JSON has no number for what is not finite: that becomes ``null``. Raises
    ``ConfigurationError`` where the file cannot be written.
    """
    text = json.dumps(_finite(content), indent=1, allow_nan=False) + "\n"
    with _unwritable(path):
        if not _replaceable(path):
            path.write_text(text, encoding="utf-8")
            return
        scratch = _scratch(path)
        try:
            scratch.write_text(text, encoding="utf-8")
            scratch.replace(path.resolve())
        finally:
            scratch.unlink(missing_ok=True)


def _replaceable(path: Path) -> bool:
    """Whether a new file may take this place: a device or a pipe must stay what it is."""
    return path.is_file() or not path.exists()


def _scratch(path: Path) -> Path:
    target = path.resolve()  # through a link, whose target is what has to change
    return target.with_name(f".{target.name}.{os.getpid()}.tmp")


@contextmanager
def _unwritable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigurationError(f"cannot write {str(path)!r}: {reason}") from error


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
