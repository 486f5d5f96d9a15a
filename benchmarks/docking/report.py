"""The comparison as Markdown tables with intervals and tests, and its figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.docking.ablations import ABLATIONS
from benchmarks.docking.campaign import OURS, method_of
from benchmarks.docking.statistics import bootstrap, demonstrated, holm, mcnemar, wilson
from benchmarks.docking.store import cells_of
from clfcbf.errors import ConfigurationError
from clfcbf.simulation.judge import STRICT, STRICT_THETA
from clfcbf.simulation.scenarios import region_named
from clfcbf.simulation.sensor_model import SensorModel, Spread
from clfcbf.simulation.sensors import SensorName

__all__ = ["names_in", "strict_caps", "success_table", "write_report"]

Record = Mapping[str, Any]
Cells = Mapping[str, Sequence[Record]]

FORMATS = (".png", ".svg")
"""Of the figures: one for a slide, one for a page."""

KEPT = (
    "region", "sensor", "controller", "seed", "index", "success", "strict", "time_s", "e_lon_mm",
    "e_lat_mm", "e_theta_deg",
)  # fmt: skip
"""Columns of the excerpt of the runs that goes with the report."""

KEPT_RUNS = 40
"""Runs of a cell in that excerpt: the whole of a campaign is ten megabytes."""

SHOWN_REASONS = 3
"""Reasons of failure listed for a cell, the most frequent ones."""


def names_in(records: Sequence[Record], field: str) -> list[str]:
    """The different names in a column, in the order in which they come."""
    return list(dict.fromkeys(record[field] for record in records))


def write_report(document: Mapping[str, Any], out: Path) -> list[Path]:
    """Write docking.md, its figures, PNG and SVG, and an excerpt of the runs to a folder.

    The paths written.

    Raises
    ------
    ConfigurationError : there is no run in the document, or the folder cannot be written
    MissingExtraError : matplotlib is not installed
    """
    from benchmarks.docking.figure import figures_of
    from clfcbf.plots import save_figure

    if not document["episodes"]:
        raise ConfigurationError("a report needs at least one run, got none")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"cannot write {str(out)!r}: {error.strerror}") from error
    written, figures = [], []
    for name, title, figure in figures_of(document):
        for suffix in FORMATS:
            path = out / f"docking-{name}{suffix}"
            save_figure(figure, path)
            written.append(path)
        figures.append(f"![{title}](docking-{name}.png)")
    page, excerpt = out / "docking.md", out / "docking-runs.json"
    page.write_text(markdown(document, figures), encoding="utf-8")
    excerpt.write_text(json.dumps({"episodes": _excerpt(document["episodes"])}, indent=0) + "\n")
    return [page, excerpt, *written]


def _excerpt(records: Sequence[Record]) -> list[Record]:
    """The first runs of every cell with the columns that a table needs, for who reads on."""
    return [
        {key: round(value, 3) if isinstance(value := record[key], float) else value for key in KEPT}
        for record in records
        if record["index"] < KEPT_RUNS
    ]


def markdown(document: Mapping[str, Any], figures: Sequence[str] = ()) -> str:
    """The whole page."""
    records = document["episodes"]
    config = document["config"]
    sensors = names_in(records, "sensor")
    lines = [
        "# Docking: who docks best", "",
        f"{len(records)} runs, seed {config['seed']}, defaults {config['config_hash']}, "
        + ", ".join(f"{name} {version}" for name, version in config["versions"].items()) + ".",
        "", "Success: within 30 mm and 5° of the goal at standstill, 1 s after the method says "
        "that it is done. Strict: 10 mm and 2°. Every method meets the same starts, bodies, "
        "sensor errors and nudges. Errors and times are over all runs, failed ones included.", "",
        *[f"- **{name}**: {region_named(name).about}" for name in names_in(records, "region")], "",
    ]  # fmt: skip
    for sensor in sensors:
        own = [record for record in records if record["sensor"] == sensor]
        rivals = [r for r in own if r["controller"] not in ABLATIONS]
        ablated = [r for r in own if r["controller"] in (OURS, *ABLATIONS)]
        lines += [f"## Sensor {sensor}", ""]
        if rivals:
            lines += ["### Success", "", *_success(rivals), ""]
            lines += ["### Against ours, run by run", "", *_paired(rivals), ""]
            lines += ["### Errors, time and effort", "", *_quantities(rivals), ""]
            lines += ["### Failures", "", *_failures(rivals), ""]
        if len(names_in(ablated, "controller")) > 1:
            lines += ["### Ours with one part left out", "", *_success(ablated), ""]
            lines += [*_paired(ablated), ""]
            lines += [*_quantities(ablated), ""]
    return "\n".join([*lines, *[line for figure in figures for line in (figure, "")]])


def success_table(document: Mapping[str, Any]) -> str:
    """Successes by method and region as plain text, a block for each sensor."""
    records = document["episodes"]
    lines = []
    for sensor in names_in(records, "sensor"):
        own = [record for record in records if record["sensor"] == sensor]
        regions = names_in(own, "region")
        lines.append(f"{'sensor ' + sensor:<18}" + "".join(f"{name:>14}" for name in regions))
        cells = cells_of(own)
        for method in names_in(own, "controller"):
            row = ""
            for region in regions:
                cell = cells.get(f"{region}/{sensor}/{method}", ())
                counts = f"{_count(cell)}/{len(cell)} ({_count(cell, 'strict')})" if cell else "-"
                row += f"{counts:>14}"
            lines.append(f"{method:<18}{row}")
    return "\n".join([*lines, "successes of runs (strict)"])


def _count(records: Sequence[Record], field: str = "success") -> int:
    return sum(bool(record[field]) for record in records)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    ruler = ["---", *["---:"] * (len(head) - 1)]
    return [f"| {' | '.join(row)} |" for row in (head, ruler, *rows)]


def _success(records: Sequence[Record]) -> list[str]:
    cells, sensor = cells_of(records), records[0]["sensor"]
    regions = names_in(records, "region")

    def shown(method: str, region: str) -> str:
        cell = cells.get(f"{region}/{sensor}/{method}", ())
        if not cell:
            return ""
        wins, runs = _count(cell), len(cell)
        low, high = wilson(wins, runs)
        return (
            f"{wins}/{runs} ({_count(cell, 'strict')}) {100 * low:.0f}–{100 * high:.0f} %, "
            f"R ≥ {demonstrated(wins, runs):.3f}"
        )

    rows = [
        [f"{m}: {method_of(m).about}", *[shown(m, region) for region in regions]]
        for m in names_in(records, "controller")
    ]
    legend = (
        "Successes of runs (strict ones), Wilson's interval, and the reliability R that they "
        "demonstrate; both at 95 %."
    )
    return [*_table(["method", *regions], rows), "", legend, *_cap(sensor)]


def strict_caps(sensor: str) -> tuple[float, float]:
    """Share of strict successes that a sensor's calibration leaves, whoever drives.

    To a method that stops where it measures the goal: for the constant error of a run alone, and
    with the slow one as it is at one instant. Errors along and across are normal and independent,
    so the distance that they make is Rayleigh's. Both 1 without a calibration error.
    """
    model = SensorModel.named(SensorName.of(sensor).level)
    return _within((model.calibration,)), _within((model.calibration, model.drift))


def _within(errors: tuple[Spread, ...]) -> float:
    position = sum(error.position**2 for error in errors)
    yaw = math.sqrt(sum(error.yaw**2 for error in errors))
    if not position or not yaw:
        return 1.0
    near = 1.0 - math.exp(-(STRICT**2) / (2.0 * position))
    return near * math.erf(STRICT_THETA / (math.sqrt(2.0) * yaw))


def _cap(sensor: str) -> list[str]:
    constant, both = strict_caps(sensor)
    if both == 1.0:
        return []
    return [
        "",
        f"A run's calibration error alone leaves {100 * constant:.0f} % of strict successes to a "
        "method that stops where it measures the goal; together with the slow error, as at one "
        f"instant, {100 * both:.0f} %.",
    ]


def _paired(records: Sequence[Record]) -> list[str]:
    """Exact tests of each method against ours, corrected for all of them."""
    cells, sensor = cells_of(records), records[0]["sensor"]
    found = []
    for method in names_in(records, "controller"):
        for region in names_in(records, "region") if method != OURS else ():
            ours = {
                r["index"]: bool(r["success"]) for r in cells.get(f"{region}/{sensor}/{OURS}", ())
            }
            theirs = {
                r["index"]: bool(r["success"]) for r in cells.get(f"{region}/{sensor}/{method}", ())
            }
            both = sorted(ours.keys() & theirs.keys())
            if both:
                test = mcnemar([ours[i] for i in both], [theirs[i] for i in both])
                found.append((method, region, test))
    if not found:
        return ["No method ran on the same starts as ours."]
    adjusted = holm([test.p for _, _, test in found])
    rows = [
        [method, region, str(test.runs), str(test.only_first), str(test.only_second),
         f"{test.p:.2g}", f"{p:.2g}"]
        for (method, region, test), p in zip(found, adjusted, strict=True)
    ]  # fmt: skip
    head = ["method", "region", "runs", "only ours", "only theirs", "p", "p, Holm"]
    legend = "McNemar's exact test of the runs on which one succeeded and the other did not."
    return [*_table(head, rows), "", legend]


def _quantities(records: Sequence[Record]) -> list[str]:
    head = [
        "method, region", "abs e_lon mm", "abs e_lat mm", "abs e_θ °", "time s", "path m",
        "chatter mm/s, mrad/s", "least margin °", "view lost", "blind s", "tick µs p50, p99",
    ]  # fmt: skip
    rows = []
    for cell, own in cells_of(records).items():
        region, _, method = cell.split("/")

        def column(name: str, own: Sequence[Record] = own) -> np.ndarray[Any, Any]:
            return np.array([record[name] for record in own], dtype=float)

        rows.append([
            f"{method}, {region}",
            *[_middle(np.abs(column(name))) for name in ("e_lon_mm", "e_lat_mm", "e_theta_deg")],
            _middle(column("time_s"), 1),
            _middle(column("path_m"), 2),
            f"{1e3 * np.median(column('chatter_v')):.1f}, "
            f"{1e3 * np.median(column('chatter_omega')):.1f}",
            f"{column('min_fov_margin_deg').min():.2f}",
            f"{int(column('view_lost').sum())}",
            f"{column('blind_s').max():.2f}",
            f"{np.median(column('step_us_p50')):.0f}, {np.median(column('step_us_p99')):.0f}",
        ])  # fmt: skip
    legend = (
        "Median with its 95 % bootstrap interval, 95th percentile after the semicolon; chatter is "
        "the median root mean square of the commands' increments from tick to tick; margin and "
        "blind time are the worst of all runs."
    )
    return [*_table(head, rows), "", legend]


def _middle(values: np.ndarray[Any, Any], digits: int = 2) -> str:
    low, high = bootstrap(values)
    return (
        f"{np.median(values):.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]; "
        f"{np.quantile(values, 0.95):.{digits}f}"
    )


def _failures(records: Sequence[Record]) -> list[str]:
    rows = [
        [cell.replace("/", ", "), ", ".join(_outcomes(own)), "; ".join(_reasons(own))]
        for cell, own in cells_of(records).items()
        if _count(own) < len(own)
    ]
    if not rows:
        return ["None."]
    return _table(["region, sensor, method", "outcomes", "reasons given"], rows)


def _outcomes(records: Sequence[Record]) -> Iterator[str]:
    failed = [record for record in records if not record["success"]]
    for name in names_in(failed, "outcome"):
        yield f"{name} {sum(record['outcome'] == name for record in failed)}"


def _reasons(records: Sequence[Record]) -> list[str]:
    given = [record["reason"] for record in records if not record["success"] and record["reason"]]
    counts = {reason: given.count(reason) for reason in dict.fromkeys(given)}
    ranked = sorted(counts.items(), key=lambda item: -item[1])[:SHOWN_REASONS]
    return [f"{count} × {reason.replace('|', '/')}" for reason, count in ranked]
