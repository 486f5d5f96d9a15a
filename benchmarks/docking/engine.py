"""Runs on several cores or machines, their records in the order of the runs."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.simulation.campaign import run_all

__all__ = ["ENGINES", "records"]

ENGINES = ("local", "dask")

T = TypeVar("T")
Work = Callable[[T], dict[str, Any]]


def records(
    engine: str, workers: int, runs: Sequence[T], work: Work[T]
) -> Generator[dict[str, Any], None, None]:
    """Records of the runs, over processes here or over a dask cluster.

    The cluster is the one that ``DASK_SCHEDULER_ADDRESS`` names, else one on this machine.

    Parameters
    ----------
    engine : one of :data:`ENGINES`
    workers : processes here
    runs : what is to be done, in this order
    work : makes one record; a function of a module, so that it reaches other processes

    Raises
    ------
    ConfigurationError : the engine is unknown, or there is no worker
    MissingExtraError : dask or joblib is not installed
    """
    if engine not in ENGINES:
        raise ConfigurationError(f"unknown engine {engine!r}; choose from {', '.join(ENGINES)}")
    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers!r}")
    yield from (_over_dask if engine == "dask" else _here)(workers, runs, work)


def _here(
    workers: int, runs: Sequence[T], work: Work[T]
) -> Generator[dict[str, Any], None, None]:  # fmt: skip
    yield from run_all(runs, workers, work)


def _over_dask(
    workers: int, runs: Sequence[T], work: Work[T]
) -> Generator[dict[str, Any], None, None]:  # fmt: skip
    try:
        import joblib

        client = importlib.import_module("distributed").Client
    except ImportError as error:
        raise MissingExtraError(error.name or "distributed", "mc") from error
    options = {} if os.environ.get("DASK_SCHEDULER_ADDRESS") else {
        "n_workers": workers, "threads_per_worker": 1, "dashboard_address": None,
    }  # fmt: skip
    with client(**options), joblib.parallel_config(backend="dask"):
        yield from joblib.Parallel(return_as="generator")(joblib.delayed(work)(run) for run in runs)
