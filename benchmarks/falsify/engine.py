"""Runs on several cores or machines, their records in the order of the runs."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from typing import Any

from benchmarks.falsify import paper
from benchmarks.falsify.campaign import Run, execute, planned
from clfcbf.errors import ConfigurationError, MissingExtraError

__all__ = ["ENGINES", "SHARE", "campaign"]

ENGINES = ("local", "dask")

SHARE = 0.03
"""Of the steps: what each set beside the declared one gets."""

PAPER_RUNS = 100
"""Runs of the paper's barrier, if the steps allow: rates to 5 %."""

Records = Generator[dict[str, Any], None, None]
Map = Callable[[Sequence[Run]], Records]


def campaign(
    names: Sequence[str],
    steps: int,
    seed: int,
    done: dict[tuple[str, int], dict[str, Any]],
    run_all: Map,
    share: float = SHARE,
) -> Records:
    """Records of all runs, round after round until every set has its ticks.

    Runs may end early, so the number of them is not known beforehand; but what a round holds
    depends on the records of those before alone, and the whole is the same for any engine.

    Parameters
    ----------
    names : sets of assumptions; "declared" gets all of ``steps``, the others a share
    done : records of an earlier campaign of the same seed, by set and index; not run again
    run_all : records of the runs it is given, in their order
    """
    wanted = dict.fromkeys(names, max(1, round(share * steps)))
    wanted |= {"declared": steps} if "declared" in wanted else {}
    if paper.NAME in wanted:
        enough = PAPER_RUNS * planned(Run(paper.NAME, seed, 0))
        wanted[paper.NAME] = min(steps, max(wanted[paper.NAME], enough))
    ticks, following = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    while True:
        batch: list[Run] = []
        for name in names:
            missing = wanted[name] - ticks[name]
            while missing > 0:
                run = Run(name, seed, following[name])
                following[name] += 1
                missing -= planned(run)
                batch.append(run)
        if not batch:
            return
        # Closed here, not when it is collected: workers must stop where the campaign does.
        with closing(run_all([run for run in batch if (run.set, run.index) not in done])) as new:
            for run in batch:
                known = done.get((run.set, run.index))
                record = next(new) if known is None else known
                ticks[run.set] += record["ticks"]
                yield record


def engine(name: str, workers: int) -> Map:
    """How runs are spread: over processes here, or over a dask cluster.

    The cluster is the one that ``DASK_SCHEDULER_ADDRESS`` names, else one on this machine.
    """
    if name not in ENGINES:
        raise ConfigurationError(f"unknown engine {name!r}; choose from {', '.join(ENGINES)}")
    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers!r}")
    if name == "dask":
        return _dask(workers)
    return _processes(workers) if workers > 1 else _here


def _here(runs: Sequence[Run]) -> Records:
    yield from map(execute, runs)


def _processes(workers: int) -> Map:
    def run_all(runs: Sequence[Run]) -> Records:
        # A forked child may inherit a lock that one of the parent's threads holds.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(
            min(workers, max(len(runs), 1)), context, signal.signal, (signal.SIGINT, signal.SIG_IGN)
        )
        try:
            yield from pool.map(execute, runs)
        finally:
            pool.shutdown(cancel_futures=True)

    return run_all


def _dask(workers: int) -> Map:
    try:
        import joblib

        client = importlib.import_module("distributed").Client
    except ImportError as error:
        raise MissingExtraError(error.name or "distributed", "mc") from error

    def run_all(runs: Sequence[Run]) -> Records:
        options = {} if os.environ.get("DASK_SCHEDULER_ADDRESS") else {
            "n_workers": workers, "threads_per_worker": 1, "dashboard_address": None,
        }  # fmt: skip
        with client(**options), joblib.parallel_config(backend="dask"):
            yield from joblib.Parallel(return_as="generator")(
                joblib.delayed(execute)(run) for run in runs
            )

    return run_all
