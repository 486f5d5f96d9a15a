"""The time-optimal floor from the starts of a campaign, and what a controller takes above it.

python -m benchmarks.floor --regions R1,R3,R4 --starts 20 --json floors.json
clfcbf approach --region R3 --plant kinematic --poses 20 --json runs.json
python -m benchmarks.floor --regions R3 --starts 20 --episodes runs.json
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from benchmarks.command import at_least
from benchmarks.floor import report
from clfcbf.errors import ClfcbfError, ConfigurationError, MissingExtraError
from clfcbf.report import check_writable, versions, write_json
from clfcbf.simulation.campaign import EpisodeSpec, run_specs

__all__ = ["main"]

USAGE_ERROR, INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 once every start was tried."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except ClfcbfError as error:
        print(f"floor: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("floor: interrupted; --resume goes on from the JSON file", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks.floor", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("--regions", default="R1,R3,R4", metavar="NAMES", help="separated by commas")
    add("--starts", type=at_least(1), default=20, help="of each region")
    add("--seed", type=at_least(0), default=0, help="as of the campaign compared with")
    add("--limits", default="", metavar="NAME", help="in place of the region's own")
    add("--workers", type=at_least(1), default=os.cpu_count() or 1, help="processes")
    add("--json", type=Path, metavar="FILE", help="overwritten")
    add("--resume", action="store_true", help="keep the floors that are in the JSON file")
    add("--episodes", type=Path, metavar="FILE",
        help="runs whose times are divided by the floors: the JSON of clfcbf approach")  # fmt: skip
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.resume and options.json is None:
        raise ConfigurationError("--resume goes on from the file that --json names; give one")
    specs = [
        EpisodeSpec(region.strip(), options.seed, index, limits=options.limits)
        for region in options.regions.split(",")
        for index in range(options.starts)
    ]
    episodes = report.episodes_in(options.episodes) if options.episodes else []
    done = _earlier(options.json) if options.resume else {}
    if options.json is not None:
        check_writable(options.json)
    wanted = [spec for spec in specs if _key(spec) not in done]
    floors: list[dict[str, Any]] = [done[_key(spec)] for spec in specs if _key(spec) in done]
    order = {_key(spec): place for place, spec in enumerate(specs)}
    try:
        with (
            closing(_records(wanted, options.workers)) as runs,
            _progress_bar(len(wanted)) as bar,
        ):
            for record in runs:
                floors.append(record)
                bar.update()
    finally:
        floors.sort(key=lambda floor: order[report.key(floor)])
        compared = report.ratios(floors, episodes)
        result = report.summary(floors, compared)
        if options.json is not None and floors:
            write_json(
                options.json,
                {
                    "config": {**report.config(), "versions": versions()},
                    "floors": floors, "ratios": compared, "summary": result,
                },
            )  # fmt: skip
    print(report.table(result))
    return 0


def _records(specs: Sequence[EpisodeSpec], workers: int) -> Generator[dict[str, Any], None, None]:
    """As a generator, which can be closed: its workers end with it."""
    yield from run_specs(specs, workers, report.floor_record)


def _key(spec: EpisodeSpec) -> report.Key:
    return spec.region, spec.limits, spec.seed, spec.index


def _earlier(path: Path) -> dict[report.Key, dict[str, Any]]:
    """The floors found before; those that were not found are tried again."""
    if not path.exists() or not path.stat().st_size:
        return {}
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
        found = {
            report.key(floor): floor for floor in earlier["floors"] if floor["outcome"] == "ok"
        }
        before = {name: earlier["config"][name] for name in report.config()}
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{str(path)!r} is no result of this benchmark") from error
    if before != report.config():
        raise ConfigurationError(
            f"cannot resume {str(path)!r}: its settings are {before}, now {report.config()}"
        )
    return found


def _progress_bar(total: int) -> Any:
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "cli") from error
    # Silent where stderr is not a terminal.
    return tqdm(total=total, unit="start", leave=False, disable=None)


if __name__ == "__main__":
    sys.exit(main())
