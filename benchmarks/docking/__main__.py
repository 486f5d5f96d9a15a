"""Compare methods of docking: the same starts, bodies and sensors for all, in JSON and CSV.

``python -m benchmarks.docking report FILE`` makes tables and figures of what this wrote. The exit
status is 0 whenever the campaign ran to its end, whatever it found.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from benchmarks.command import exit_status
from benchmarks.docking import campaign
from benchmarks.docking.engine import ENGINES, records
from benchmarks.docking.report import success_table, write_report
from benchmarks.docking.store import Store, load
from clfcbf.cli import usable_cores
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.report import check_writable

__all__ = ["main"]

CHECKPOINT = 60.0
"""[s] Between two writings of the files: what an interruption costs at most, beside the runs."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign or make its report; 0 whatever came out."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["report"]:
        return exit_status("docking", lambda: _report(given[1:]))
    return exit_status("docking", lambda: _compare(given))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks.docking", description=__doc__)
    add = parser.add_argument
    add("--methods", "--controllers", default="all", metavar="NAMES",
        help="methods, or the groups all and ablations")  # fmt: skip
    add("--regions", default="all", metavar="NAMES", help=", ".join(campaign.REGION_NAMES))
    add("--sensors", "--sensor", default="A", metavar="NAMES",
        help=", ".join(campaign.SENSOR_NAMES))  # fmt: skip
    add("--runs", "--episodes", type=int, default=30, help="of each method in each region")
    add("--seed", type=int, default=0)
    add("--subsample", default="", metavar="NAME=RUNS,...", help="fewer runs of slow methods")
    add("--workers", type=int, default=usable_cores(), help="processes")
    add("--engine", choices=ENGINES, default="local", help="dask: over its cluster, by joblib")
    add("--json", type=Path, metavar="FILE", help="overwritten, and the .csv beside it")
    add("--resume", action="store_true", help="keep the runs that are in the JSON file")
    add("--plots", type=Path, metavar="DIR", help="write the report there too")
    return parser


def _compare(arguments: Sequence[str]) -> int:
    options = _parser().parse_args(arguments)
    for name, least in (("runs", 1), ("seed", 0), ("workers", 1)):
        if getattr(options, name) < least:
            raise ConfigurationError(
                f"--{name} must be at least {least}, got {getattr(options, name)}"
            )
    if options.resume and options.json is None:
        raise ConfigurationError("--resume goes on from the file that --json names; give one")
    methods = campaign.methods_of(options.methods)
    regions = campaign.parts_of(options.regions, campaign.REGION_NAMES)
    sensors = campaign.parts_of(options.sensors, campaign.SENSOR_NAMES)
    subsample = campaign.subsample_of(options.subsample)
    runs = campaign.planned(methods, regions, sensors, options.runs, options.seed, subsample)
    campaign.check(methods)
    if options.json is not None:
        check_writable(options.json)
        check_writable(options.json.with_suffix(".csv"))
    store = Store(options.json, options.seed, regions, methods)
    done = store.earlier() if options.resume else {}
    wanted = {run.key for run in runs}
    for key, record in done.items():  # of other cells, or of more runs than asked for now
        if key not in wanted:
            store.add(record)
    _run(runs, done, store, options)
    document = store.document()
    print(success_table(document))
    if options.plots is not None:
        write_report(document, options.plots)
    return 0


def _run(
    runs: Sequence[campaign.Run], done: dict[str, dict[str, Any]], store: Store,
    options: argparse.Namespace,
) -> None:  # fmt: skip
    """All runs that are not done, written from time to time and at the end, however it comes."""
    missing = [run for run in runs if run.key not in done]
    made = records(options.engine, options.workers, missing, campaign.execute)
    saved = time.monotonic()
    finished = 0
    try:
        with closing(made), _progress_bar(len(runs)) as bar:
            for run in runs:
                store.add(done[run.key] if run.key in done else next(made))
                finished += 1
                bar.update()
                bar.set_postfix_str(run.cell)
                if time.monotonic() - saved > CHECKPOINT:
                    store.write()
                    saved = time.monotonic()
    finally:
        for run in runs[finished:]:  # an interruption must not drop what an earlier campaign has
            if run.key in done:
                store.add(done[run.key])
        store.write()


def _progress_bar(runs: int) -> Any:
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "cli") from error
    # Silent where stderr is not a terminal.
    return tqdm(total=runs, unit="run", leave=False, disable=None)


def _report(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="benchmarks.docking report", description=write_report.__doc__
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="the JSON of a campaign")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), metavar="DIR")
    options = parser.parse_args(arguments)
    for path in write_report(load(options.file), options.out):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
