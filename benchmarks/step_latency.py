"""How long a tick takes, and a solve, against the other routes: a table, three ratios, JSON.

``python -m benchmarks.step_latency [--json FILE] [--plot FILE] [--programs N] [--repeats N]``

What is compared with what, and how times become figures, is told in :mod:`benchmarks.latency`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = ["main"]

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}
"""One thread for linear algebra; the last is what cbfpy's manual advises for speed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 0 whatever it found."""
    parser = argparse.ArgumentParser(prog="benchmarks.step_latency", description=__doc__)
    parser.add_argument("--programs", type=_at_least_one, default=2000, help="recorded ticks")
    parser.add_argument("--repeats", type=_at_least_one, default=3, help="rounds over all of them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE", help="overwritten")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="PNG, PDF or SVG, by its ending")
    options = parser.parse_args(arguments)
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    # Only now: the threads of linear algebra are counted when NumPy is imported.
    from benchmarks.latency import measure
    from benchmarks.latency_report import table

    result = measure(options.programs, options.repeats, options.seed, progress=_progress)
    print(table(result))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if options.plot is not None:
        _plot(result, options.plot)
    return 0


def _plot(result: dict[str, Any], path: Path) -> None:
    try:
        from benchmarks.latency_figure import save
    except ImportError as error:
        print(f"no figure: {error}; install it with: pip install 'clfcbf[viz]'")
    else:
        save(result, path)


def _progress(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def _at_least_one(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number


if __name__ == "__main__":
    sys.exit(main())
