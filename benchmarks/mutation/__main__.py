"""Flip every sign of the guarantee's modules; say which flips the tests do not notice.

The exit status is 0 whatever was found.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.mutation.ledger import (
    Entry,
    digest,
    entry,
    equivalents,
    remembered,
    tally,
)
from benchmarks.mutation.mutants import Key, Mutant, mutants, probed
from benchmarks.mutation.targets import SHARED, TARGETS
from benchmarks.mutation.trial import Outcome, Task, copied, run, signless
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.report import check_writable, write_json

__all__ = ["main"]

ROOT = Path(__file__).resolve().parents[2]
SLOWDOWN, LEAST = 5.0, 20.0
"""Processor time a mutant may take, over that of its tests unharmed, and at least [s]."""
CHECKPOINT = 20
"""Mutants between two writings of the JSON."""
USAGE_ERROR, INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 whatever it found."""
    options = _parser().parse_args(arguments)
    # Both ways of asking for the end let the outcomes so far be written.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _interrupt)
    try:
        return _campaign(options)
    except ClfcbfError as error:
        print(f"mutation: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("mutation: interrupted; --resume goes on from the JSON file", file=sys.stderr)
        return INTERRUPTED


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks.mutation", description=__doc__)
    add = parser.add_argument
    add("--modules", metavar="NAMES", default=",".join(TARGETS),
        help="paths or their last parts, separated by commas")  # fmt: skip
    add("--json", type=Path, metavar="FILE", help="overwritten")
    add("--resume", action="store_true", help="keep the outcomes in the JSON file that still hold")
    add("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    add("--minutes", type=float, default=60.0, help="start no mutant after that long")
    add("--verify", action="store_true", help="try the listed equivalents too")
    return parser


def _campaign(options: argparse.Namespace) -> int:
    modules = _named(options.modules)
    if options.resume and options.json is None:
        raise ConfigurationError("--resume goes on from the file that --json names; give one")
    if options.json is not None:
        check_writable(options.json)
    document: dict[str, Any] = {"modules": {}}
    if options.resume and options.json.exists() and options.json.stat().st_size:
        document = json.loads(options.json.read_text())
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.dont_write_bytecode = False
    end = time.monotonic() + 60.0 * options.minutes
    with tempfile.TemporaryDirectory() as scratch:
        tree = copied(ROOT, Path(scratch))
        for module in modules:
            _module(module, tree, document, end, options)
    print(_table(document["modules"]))
    return 0


def _named(names: str) -> list[str]:
    chosen = []
    for name in filter(None, names.split(",")):
        fitting = [m for m in TARGETS if name in (m, Path(m).stem, Path(m).name)]
        if len(fitting) != 1:
            raise ConfigurationError(f"unknown module {name!r}; known are {', '.join(TARGETS)}")
        chosen += fitting
    return chosen


def _module(
    module: str, tree: Path, document: dict[str, Any], end: float, options: argparse.Namespace
) -> None:
    """Try the mutants of one module that have no outcome yet."""
    text = (tree / module).read_text()
    tests = TARGETS[module]
    texts = [(tree / name).read_text() for name in (*tests, *SHARED)]
    known = remembered(document["modules"].get(module, {}), digest([text]), digest(texts))
    listed = equivalents()
    ((_, unharmed),) = run(tree, [Task(module, text, tests, 600)], 1)
    if unharmed.status != "survived":
        raise ConfigurationError(f"the tests of {module} fail unharmed: {unharmed.by}")
    limit = int(max(LEAST, SLOWDOWN * unharmed.seconds))
    unsigned = signless(tree, Task(module, probed(text), tests, 600))
    everything = list(mutants(module, text, unsigned))
    entries: dict[Key, Entry] = {}
    pending: list[Mutant] = []
    for mutant in everything:
        if mutant.key in listed and not options.verify:
            entries[mutant.key] = entry(mutant, Outcome("equivalent", "", 0.0), listed[mutant.key])
        elif mutant.key in known:
            reason = listed.get(mutant.key, "")
            entries[mutant.key] = known[mutant.key]
            if reason and known[mutant.key]["status"] == "survived":
                entries[mutant.key] |= {"status": "equivalent", "reason": reason}
        else:
            pending.append(mutant)
    for key in listed:
        if key.module == module and key not in {m.key for m in everything}:
            print(f"listed as equivalent, but no longer a mutant: {key}", file=sys.stderr)
    print(f"{module}: {len(everything)} mutants, {len(pending)} to try, "
          f"{unharmed.seconds:.1f} s unharmed", file=sys.stderr, flush=True)  # fmt: skip
    record = {
        "text": digest([text]), "tests": digest(texts), "of": list(tests),
        "unharmed_s": unharmed.seconds, "mutants": [],
    }  # fmt: skip
    document["modules"][module] = record
    tasks = (
        Task(module, mutant.text, tests, limit) for mutant in pending if time.monotonic() < end
    )
    try:
        for done, (number, outcome) in enumerate(run(tree, tasks, options.workers), 1):
            mutant = pending[number]
            reason = listed.get(mutant.key, "")
            if reason and outcome.status != "survived":
                print(f"listed as equivalent, but noticed by {outcome.by}: {mutant.key}",
                      file=sys.stderr)  # fmt: skip
            elif reason:
                outcome = outcome._replace(status="equivalent")
            elif outcome.status == "survived":
                print(f"survived, line {mutant.number}: {mutant.key}", file=sys.stderr, flush=True)
            entries[mutant.key] = entry(mutant, outcome, reason)
            if done % CHECKPOINT == 0:
                _write(document, record, entries, options.json)
    finally:
        _write(document, record, entries, options.json)


def _write(
    document: dict[str, Any], record: dict[str, Any], entries: dict[Key, Entry], path: Path | None
) -> None:
    record["mutants"] = list(entries.values())
    record["summary"] = tally(entries.values())._asdict()
    everything = [each for one in document["modules"].values() for each in one["mutants"]]
    total = tally(everything)
    document["summary"] = {**total._asdict(), "score": total.score}
    if path is not None:
        write_json(path, document)


def _table(modules: dict[str, Any]) -> str:
    head = f"{'module':32}{'mutants':>9}{'killed':>8}{'timeout':>9}{'equivalent':>12}" \
           f"{'survived':>10}{'score':>8}"  # fmt: skip
    lines = [head]
    rows = [(name, one["mutants"]) for name, one in modules.items()]
    for name, entries in (*rows, ("all", [e for _, found in rows for e in found])):
        count = tally(entries)
        lines.append(
            f"{name:32}{count.mutants:9}{count.killed:8}{count.timeout:9}{count.equivalent:12}"
            f"{count.survived:10}{100.0 * count.score:7.1f}%"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
