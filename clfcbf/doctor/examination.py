"""The whole examination, as data."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np

from clfcbf.doctor.packages import Package, check_packages
from clfcbf.doctor.probe import TIME_LIMIT, probe
from clfcbf.doctor.timing import TIMINGS
from clfcbf.qp import available_backends
from clfcbf.qp.ladder import AGREEMENT

__all__ = ["Examination", "examine", "problems_of"]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_TIMING = "clfcbf.doctor.timing"


@dataclass(frozen=True, slots=True)
class Examination:
    """What :func:`examine` found; ``to_dict()`` is for JSON.

    Attributes
    ----------
    system : interpreter, platform, cores, NumPy and its BLAS
    packages : installed or not
    backends : one record for each of ``available_backends()``: ``name``, ``error`` (empty where
        it worked) and what :func:`clfcbf.doctor.timing.time_backend` gives, None where it failed
    timings : the same of the exact solve and of the whole tick
    problems : what is wrong, in words
    """

    system: dict[str, Any]
    packages: tuple[Package, ...]
    backends: tuple[dict[str, Any], ...]
    timings: tuple[dict[str, Any], ...]
    problems: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain containers, strings and finite numbers."""
        return {
            "system": dict(self.system),
            "packages": [package._asdict() for package in self.packages],
            "backends": [dict(record) for record in self.backends],
            "timings": [dict(record) for record in self.timings],
            "problems": list(self.problems),
        }


_BACKEND_FIELDS = (
    "package", "licence", "max_variables", "semidefinite", "multipliers", "median_us", "solves",
    "distance", "agrees",
)  # fmt: skip
_TIMING_FIELDS = ("median_us", "solves")


def examine(names: Iterable[str] | None = None, time_limit: float = TIME_LIMIT) -> Examination:
    """Examine the installation; seconds for each package or backend that is slow to import.

    Parameters
    ----------
    names : of backends; those of ``available_backends()`` if not given
    time_limit : for one import or backend [s]
    """
    chosen = tuple(available_backends() if names is None else names)
    # Timings one after the other and before the imports, which keep every core busy.
    timings = tuple(
        _measured("report_timing", name, _TIMING_FIELDS, time_limit) for name in TIMINGS
    )
    backends = tuple(
        _measured("report_backend", name, _BACKEND_FIELDS, time_limit) for name in chosen
    )
    more = [record["package"] for record in backends if record["package"]]
    packages = tuple(check_packages(more, time_limit))
    problems = tuple(problems_of(packages, backends, timings))
    return Examination(_system(), packages, backends, timings, problems)


def _measured(function: str, name: str, fields: Sequence[str], time_limit: float) -> dict[str, Any]:
    code = f"import sys; from {_TIMING} import {function}; {function}(sys.argv[1])"
    outcome = probe(code, name, time_limit=time_limit)
    record: dict[str, Any] = {"name": name, "error": outcome.error, **dict.fromkeys(fields)}
    if not outcome.error:
        try:
            record.update(json.loads(outcome.output))
        except ValueError:
            record["error"] = f"printed {outcome.output!r} in place of a result"
    return record


def problems_of(
    packages: Iterable[Package],
    backends: Iterable[dict[str, Any]],
    timings: Iterable[dict[str, Any]],
) -> list[str]:
    """What is wrong, one sentence each; a package of an extra may be missing."""
    found: list[str] = []
    for package in packages:
        if package.installed and package.error:
            found.append(f"{package.name} is installed but does not import: {package.error}")
        elif package.required and package.error:
            found.append(f"{package.name} is required and not installed")
    for record in backends:
        name = record["name"]
        if record["error"]:
            found.append(f"backend {name!r} is available but fails: {record['error']}")
        elif record["distance"] is None:
            found.append(f"backend {name!r} does not solve a program that 'exact' solves")
        elif not record["agrees"]:
            found.append(
                f"backend {name!r} differs from 'exact' by {record['distance']:.1e}, "
                f"more than {AGREEMENT:.0e}"
            )
    found += [f"{record['name']} fails: {record['error']}" for record in timings if record["error"]]
    return found


def _system() -> dict[str, Any]:
    settings = [f"{name}={os.environ[name]}" for name in _THREADS if name in os.environ]
    affinity = getattr(os, "sched_getaffinity", None)
    cores = os.cpu_count() or 1
    return {
        "clfcbf": metadata.version("clfcbf"),
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cores": cores,
        "usable_cores": len(affinity(0)) if affinity is not None else cores,
        "numpy": np.__version__,
        "blas": _blas(),
        "blas_threads": ", ".join(settings) or "not limited",
    }


def _blas() -> str:
    """Name and version of the linear algebra that NumPy was built with."""
    built: Any = np.show_config(mode="dicts")
    about = built.get("Build Dependencies", {}).get("blas", {})
    return f"{about.get('name', 'unknown')} {about.get('version', '')}".strip()
