"""Hostile input by the thousand: what may come out is an error of the library, and nothing else.

A case is known by its kind, the seed and its index alone; one that breaks something is kept in a
file and named. ``--only KIND/INDEX`` does it again.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.robot import fuzz_configs, fuzz_logs, fuzz_packets
from benchmarks.robot.broken import BrokenError, HungError

__all__ = ["HEADING", "KINDS", "Batch", "again", "batches", "rows", "run", "summary"]

MEMORY = 768
"""[MB] By which a process may grow over a batch of hostile files of which none has 1 MB; the
interpreter with all readers and matplotlib takes a third of it."""


class Kind(NamedTuple):
    """How one kind of input is made and judged.

    Attributes
    ----------
    check : makes the input from random numbers and gives it to the library; says what became of
        it, and raises ``BrokenError`` with the input where that must not be
    each : inputs in a case
    size : cases in a batch
    limit : of one case [s]
    """

    check: Callable[[np.random.Generator], Counter[str]]
    each: int
    size: int
    limit: float


KINDS: dict[str, Kind] = {
    "packets": Kind(fuzz_packets.check, fuzz_packets.EPISODE, 20, 10.0),
    "configs": Kind(fuzz_configs.check, 1, 500, 10.0),
    "logs": Kind(fuzz_logs.check, 1, 50, 30.0),
}


class Batch(NamedTuple):
    """Some cases in a row; ``number`` is its own among all batches of all kinds."""

    number: int
    kind: str
    first: int
    cases: int


def batches(wanted: Mapping[str, int], done: set[int]) -> list[Batch]:
    """What is left to do."""
    found = []
    for number, (name, kind) in enumerate(KINDS.items()):
        cases = -(-wanted[name] // kind.each)
        for turn, first in enumerate(range(0, cases, kind.size)):
            index = 1_000_000 * number + turn
            if index not in done:
                found.append(Batch(index, name, first, min(kind.size, cases - first)))
    return found


def run(batch: Batch, seed: int, folder: Path) -> dict[str, Any]:
    """The record of a batch; inputs that broke something go to the folder."""
    kind = KINDS[batch.kind]
    outcomes: Counter[str] = Counter()
    failing = []
    before = _memory()
    for index in range(batch.first, batch.first + batch.cases):
        try:
            with _within(kind.limit):
                outcomes += kind.check(_stream(batch.kind, seed, index))
        except BrokenError as broken:
            failing.append(_kept(broken, folder, batch.kind, seed, index))
        except HungError:
            hung = BrokenError(f"not done within {kind.limit:g} s", b"")
            failing.append(_kept(hung, folder, batch.kind, seed, index))
        except Exception as error:
            wrong = BrokenError(f"{type(error).__name__}: {error}", b"")
            failing.append(_kept(wrong, folder, batch.kind, seed, index))
    grown = _memory() - before
    if grown > MEMORY:
        why = BrokenError(f"{grown:.0f} MB more after this batch", b"")
        failing.append(_kept(why, folder, batch.kind, seed, batch.first))
    return {
        "index": batch.number, "kind": batch.kind, "first": batch.first,
        "inputs": batch.cases * kind.each, "outcomes": dict(outcomes), "failing": failing,
        "grown_mb": grown,
    }  # fmt: skip


def again(kind: str, index: int, seed: int) -> dict[str, int]:
    """One case again; raises what it raises."""
    return dict(KINDS[kind].check(_stream(kind, seed, index)))


def summary(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Of each kind: inputs, what became of them, and how many broke something."""
    found: dict[str, Any] = {}
    for record in records:
        entry = found.setdefault(
            record["kind"], {"inputs": 0, "outcomes": Counter(), "failing": 0, "grown_mb": 0.0}
        )
        entry["inputs"] += record["inputs"]
        entry["outcomes"] += Counter(record["outcomes"])
        entry["failing"] += len(record["failing"])
        entry["grown_mb"] = max(entry["grown_mb"], record["grown_mb"])
    return {kind: {**entry, "outcomes": dict(entry["outcomes"])} for kind, entry in found.items()}


HEADING = ("kind", "inputs", "broke something", "what became of them")


def rows(found: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """The table."""
    for kind, entry in found.items():
        outcomes = sorted(entry["outcomes"].items(), key=lambda pair: -pair[1])
        told = ", ".join(f"{count} {name}" for name, count in outcomes)
        yield kind, str(entry["inputs"]), str(entry["failing"]), told


def _stream(kind: str, seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, list(KINDS).index(kind), index])


def _kept(broken: BrokenError, folder: Path, kind: str, seed: int, index: int) -> dict[str, str]:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{kind}-{seed}-{index}"
    path.write_bytes(broken.data)
    return {"case": f"{kind}/{index}", "why": str(broken)[:500], "file": str(path)}


def _memory() -> float:
    """[MB] Most that this process ever had; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0.0
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / unit


@contextmanager
def _within(limit: float) -> Iterator[None]:
    """Raise in the main thread once the time is over, where the system has such an alarm."""
    main = threading.current_thread() is threading.main_thread()
    if not (main and hasattr(signal, "setitimer")):
        yield
        return

    def over(number: int, frame: object) -> None:
        raise HungError

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, limit)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
