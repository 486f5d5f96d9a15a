"""Every QP backend: what it takes, its licence, and whether it agrees with the exact answer.

``python -m benchmarks.backends [--json FILE] [--docs [FILE]]``

Each backend gets recorded and hard two-input programs through :func:`clfcbf.solve_qp`, at its
default settings, and is compared with rational arithmetic. ``--docs`` writes the table as
``docs/backends.md``.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.metadata
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import reference
from benchmarks.stream import Program, record_stream, stress_programs
from benchmarks.timing import quiet
from clfcbf import QuadraticProgram, available_backends, solve_qp
from clfcbf.qp import get_backend

__all__ = ["compare", "main", "markdown"]

AGREES = 1e-6
"""[m/s, rad/s] Largest difference to the exact command of a backend that agrees."""

DOCS = Path(__file__).parents[1] / "docs" / "backends.md"

_HEAD = """# Backends

Written by `python -m benchmarks.backends --docs`. Every answer of every backend is verified by
`solve_qp` before it is used; this table says what the backends are, and how they did on
{programs} two-input programs: recorded ticks, and ticks made badly scaled, nearly infeasible and
with nearly parallel rows.
*Worst error* is the largest difference to the exact command [m/s, rad/s], *off* counts those above
{agrees:g}, *none* those without an answer that stood verification, and *time* is the median of
`solve_qp`, verification included [µs].

"""

Case = tuple[QuadraticProgram, tuple[float, float]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 0 whatever it says."""
    parser = argparse.ArgumentParser(prog="benchmarks.backends", description=__doc__)
    parser.add_argument("--programs", type=int, default=300, help="recorded ticks, one in seven")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE", help="overwritten")
    parser.add_argument("--docs", type=Path, nargs="?", const=DOCS, metavar="FILE")
    options = parser.parse_args(arguments)
    result = compare(options.programs, options.seed)
    print(markdown(result))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if options.docs is not None:
        options.docs.write_text(markdown(result), encoding="utf-8")
    return 0


def compare(programs: int = 300, seed: int = 0) -> dict[str, Any]:
    """Capability, licence and agreement of every available backend, as a dictionary for JSON.

    Parameters
    ----------
    programs : recorded ticks; of each stress set half as many again
    seed : of the stream
    """
    cases = _cases(programs, seed)
    with quiet():
        rows = [_row(name, cases) for name in available_backends()]
    return {"programs": len(cases), "agrees_within": AGREES, "backends": rows}


def _cases(programs: int, seed: int) -> list[Case]:
    # One tick in seven: neighbours are much alike.
    recorded = record_stream(7 * programs, seed).programs[::7]
    chosen = list(recorded)
    for hard in stress_programs(recorded, max(1, programs // 2), seed).values():
        chosen += hard
    cases = []
    for program in chosen:
        # Both rows where they can hold together, as in most ticks; else the barrier's alone.
        both = program._replace(hard=(*program.hard, program.soft))
        for rows in (both, program):
            exact = reference.one_shot(rows._replace(soft=(0.0, 0.0, 0.0)), 1.0)
            if exact is not None:
                cases.append((_two_inputs(rows), exact))
                break
    return cases


def _two_inputs(program: Program) -> QuadraticProgram:
    q11, q12, q22 = program.weight
    v, omega = program.nominal
    v_lo, v_hi, w_lo, w_hi = program.box
    return QuadraticProgram(
        [[q11, q12], [q12, q22]],
        [-q11 * v - q12 * omega, -q12 * v - q22 * omega],
        [row[:2] for row in program.hard],
        [row[2] for row in program.hard],
        [v_lo, w_lo],
        [v_hi, w_hi],
    )


def _row(name: str, cases: Sequence[Case]) -> dict[str, Any]:
    capability = get_backend(name).capability
    errors, times, failed = [], [], 0
    for problem, exact in cases:
        begun = time.perf_counter()
        answer = solve_qp(problem, name, fallback=())  # its own answer, nobody else's
        times.append(time.perf_counter() - begun)
        if answer.x is None:
            failed += 1
        else:
            errors.append(float(np.abs(answer.x - exact).max()))
    return {
        "name": name,
        **dataclasses.asdict(capability),
        "version": _version(capability.package),
        "worst_error": max(errors, default=0.0),
        "off": sum(error > AGREES for error in errors),
        "failed": failed,
        "median_us": float(np.median(times)) * 1e6,
    }


def _version(package: str | None) -> str:
    try:
        return importlib.metadata.version(package or "clfcbf")
    except importlib.metadata.PackageNotFoundError:
        return ""


def markdown(result: dict[str, Any]) -> str:
    """The table, one row a backend."""
    columns = ("backend", "package", "licence", "variables", "singular P", "multipliers")
    figures = ("worst error", "off", "none", "time")
    lines = [
        "| " + " | ".join((*columns, *figures)) + " |",
        "|" + "---|" * len(columns) + "---:|" * len(figures),
    ]
    for row in result["backends"]:
        package = f"{row['package']} {row['version']}" if row["package"] else "none"
        cells = (
            f"`{row['name']}`", package, row["licence"],
            f"at most {row['max_variables']}" if row["max_variables"] else "any",
            "yes" if row["semidefinite"] else "no",
            "its own" if row["multipliers"] else "reconstructed",
            f"{row['worst_error']:.0e}", str(row["off"]), str(row["failed"]),
            f"{row['median_us']:.0f}",
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    head = _HEAD.format(programs=result["programs"], agrees=result["agrees_within"])
    return head + "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
