"""Search for a run in which the guarantee fails: counts, the smallest margins, JSON, a figure.

The safety filter at its defaults is attacked within the declared assumptions, and then with one of
them broken at a time. The exit status is 0 whatever was found.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from benchmarks.command import at_least, exit_status
from benchmarks.falsify import paper
from benchmarks.falsify.assumptions import names_of
from benchmarks.falsify.campaign import Run
from benchmarks.falsify.engine import ENGINES, campaign, engine
from benchmarks.falsify.report import document, replay, table
from clfcbf import defaults
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.plots import check_format
from clfcbf.report import check_writable, versions, write_json

__all__ = ["main"]

CHECKPOINT = 60.0
"""[s] Between two writings of the JSON: what an interruption costs at most, beside the runs."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 whatever it found."""
    options = _parser().parse_args(arguments)
    run = _replay if options.replay else _attack
    return exit_status("falsify", lambda: run(options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks.falsify", description=__doc__)
    add = parser.add_argument
    add("--steps", type=at_least(1), default=200_000, help="ticks in the declared assumptions")
    add("--seed", type=at_least(0), default=0)
    add("--workers", type=at_least(1), default=os.cpu_count() or 1, help="processes")
    add("--assumptions", default=f"broken,{paper.NAME}", metavar="NAMES",
        help="beside the declared ones: sets, or the groups single, broken, all")  # fmt: skip
    add("--engine", choices=ENGINES, default="local", help="dask: over its cluster, by joblib")
    add("--json", type=Path, metavar="FILE", help="overwritten")
    add("--resume", action="store_true", help="keep the runs that are in the JSON file")
    add("--plot", type=Path, metavar="FILE", help="PNG, PDF or SVG, by its ending")
    add("--replay", type=_run, metavar="SEED/INDEX",
        help="print the worst attack of that run, of the first of --assumptions")  # fmt: skip
    return parser


def _attack(options: argparse.Namespace) -> int:
    names = names_of(f"declared,{options.assumptions}", (paper.NAME,))
    if options.resume and options.json is None:
        raise ConfigurationError("--resume goes on from the file that --json names; give one")
    for path in filter(None, (options.json, options.plot)):
        check_writable(path)
    if options.plot is not None:
        check_format(options.plot)
    config = {
        "seed": options.seed, "config_hash": defaults.fingerprint(), "versions": versions()
    }  # fmt: skip
    done = _earlier(options.json, config) if options.resume else {}
    records: list[dict[str, Any]] = []
    run_all = engine(options.engine, options.workers)
    saved = time.monotonic()
    try:
        with (
            _one_interrupt(),
            closing(campaign(names, options.steps, options.seed, done, run_all)) as runs,
            _progress_bar(options.steps) as bar,
        ):
            for record in runs:
                records.append(record)
                bar.update(record["ticks"] if record["set"] == "declared" else 0)
                bar.set_postfix_str(record["set"])
                if options.json is not None and time.monotonic() - saved > CHECKPOINT:
                    write_json(options.json, document(records, options.seed, config))
                    saved = time.monotonic()
    finally:
        result = document(records, options.seed, {**config, "steps": options.steps})
        if options.json is not None and records:
            write_json(options.json, result)
    print(table(result))
    if options.plot is not None:
        from benchmarks.falsify.figure import save

        save(result, options.plot)
    return 0


def _replay(options: argparse.Namespace) -> int:
    seed, index = options.replay
    given = options.assumptions != _parser().get_default("assumptions")
    names = names_of(options.assumptions) if given else ()
    for line in replay(Run(names[0] if names else "declared", seed, index)):
        print(line)
    return 0


def _earlier(path: Path, config: dict[str, Any]) -> dict[tuple[str, int], dict[str, Any]]:
    """The runs in a JSON file of the same seed and defaults; none if there is no such file yet."""
    if not path.exists() or not path.stat().st_size:
        return {}
    try:
        earlier = json.loads(path.read_text(encoding="utf-8"))
        found = {name: earlier["config"][name] for name in ("seed", "config_hash")}
        runs = {(run["set"], run["index"]): run for run in earlier["runs"]}
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{str(path)!r} is no result of this benchmark") from error
    for name, value in found.items():
        if value != config[name]:
            raise ConfigurationError(
                f"cannot resume {str(path)!r}: its {name} is {value!r}, now {config[name]!r}"
            )
    return runs


@contextmanager
def _one_interrupt() -> Iterator[None]:
    """Raise at the first Ctrl-C alone: a second one would break off the clearing up after it."""
    seen: list[int] = []

    def raise_once(number: int, frame: object) -> None:
        seen.append(number)
        if len(seen) == 1:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, raise_once)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _progress_bar(steps: int) -> Any:
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "cli") from error
    # Silent where stderr is not a terminal.
    return tqdm(total=steps, unit="tick", unit_scale=True, leave=False, disable=None)


def _run(text: str) -> tuple[int, int]:
    try:
        seed, index = (int(part) for part in text.split("/"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected SEED/INDEX, got {text!r}") from None
    return seed, index


if __name__ == "__main__":
    sys.exit(main())
