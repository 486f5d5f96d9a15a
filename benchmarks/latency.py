"""The latency benchmark as one function: everything measured, as a dictionary for JSON.

Every route gets the same recorded ticks. A *tick* goes from state to command: ours predicts,
builds rows, solves, verifies and guards; cbfpy builds its rows and solves. A *solve* goes from a
program's arrays to its answer. Errors are against rational arithmetic; a route that says nothing
or throws has failed, one that is off by more than ``WRONG`` is wrong. How times become figures is
told in :func:`benchmarks.timing.row`. A ratio is that of two medians over the programs, taken
round by round; the middle one counts, and the smallest and largest say how steady it is.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import cbfpy_route, obstacles, reference, routes, throughput
from benchmarks.c_loop import CLoop, CompilerMissingError
from benchmarks.stream import Program, Stream, record_stream, stress_programs
from benchmarks.timing import WRONG, Contestant, Sample, interleave, quiet, row

__all__ = ["measure"]

BLOCK = 50
"""Programs a turn: long enough for warm caches, short enough to share the machine's noise."""

SCALING_PROGRAMS = 60
"""Programs a number of obstacles; IPOPT takes 20 ms for each with 1000."""

STRESS = 200
"""Programs a stress set."""

TICK = "TrackingController.step"
IPOPT = "CasADi+IPOPT (paper)"
CBFPY = "cbfpy controller, elastiqp, float64"

RATIOS = {
    "ipopt_over_tick": (IPOPT, TICK),
    "ipopt_over_exact": (IPOPT, "exact"),
    "cbfpy_over_tick": (CBFPY, TICK),
}
"""Numerator and denominator: IPOPT's solve alone against our whole tick, and against our solve;
cbfpy's fastest and most exact setting against our whole tick."""


def measure(
    programs: int = 2000,
    repeats: int = 3,
    seed: int = 0,
    *,
    sizes: Sequence[int] = throughput.SIZES,
    counts: Sequence[int] = obstacles.OBSTACLES,
    stress: int = STRESS,
    progress: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Record the stream, time every route on it, and return the figures.

    Parameters
    ----------
    programs, repeats, seed : length of the stream, rounds over it, and what it is drawn from
    sizes : batch sizes
    counts : numbers of obstacle rows
    stress : programs a stress set
    progress : called with a line before each part
    """
    notes: list[str] = []
    rng = np.random.default_rng((seed, 1))
    loads = [os.getloadavg()[0]] if hasattr(os, "getloadavg") else []
    progress(f"recording {programs} ticks and answering them in rational arithmetic")
    stream = record_stream(programs, seed)
    paper = [program.without_nominal() for program in stream.programs]
    contestants = _solvers(paper, _one_shot(paper), notes) + _ticks(stream, notes)
    progress(f"{len(contestants)} routes, {repeats} rounds")
    with quiet():
        samples = interleave(contestants, repeats, BLOCK, rng)
        rows = [row(c, s) for c, s in zip(contestants, samples, strict=True)]
        rows += _c_loop_row(paper, repeats, notes)
        by_name = {c.name: s for c, s in zip(contestants, samples, strict=True)}
        progress("stress sets")
        hard = {
            name: _stressed(chosen, rng)
            for name, chosen in stress_programs(paper, stress, seed).items()
        }
        progress("obstacle rows")
        scaling = _scaling(paper, counts, repeats, rng)
        progress("batches")
        batch = throughput.measure_batches(paper, sizes, repeats, rng, notes)
    loads += [os.getloadavg()[0]] if loads else []
    spreads = {name: _spread(by_name, *pair) for name, pair in RATIOS.items()}
    return {
        "rows": rows,
        "ratios": {name: spread["median"] for name, spread in spreads.items()},
        "ratio_spread": spreads,
        "batch": batch,
        "scaling": scaling,
        "stress": hard,
        "stream": {"ticks": len(stream.ticks), "without_program": stream.ticks_without_program}
        | {"active": stream.active()},
        "calls_per_tick": calls_per_tick(stream),
        "cbfpy_rows_difference": _cbfpy_difference(stream),
        "wrong_above": WRONG,
        "repeats": repeats,
        "seed": seed,
        "machine": {
            "python": platform.python_version(),
            "platform": platform.platform(),
            "cpus": os.cpu_count(),
            "load": loads,
            "date": time.strftime("%Y-%m-%d"),
        },
        "notes": notes,
    }


def _one_shot(programs: Sequence[Program]) -> list[tuple[float, float]]:
    answers = [reference.one_shot(program, routes.PENALTY) for program in programs]
    assert None not in answers, "the recorded programs have a feasible command each"
    return [answer for answer in answers if answer is not None]


def _solvers(
    programs: Sequence[Program], exact: Sequence[tuple[float, float]], notes: list[str]
) -> list[Contestant]:
    """Every route that solves the one-shot program; a note for those that are not installed."""
    found = [routes.exact_route(programs, exact)]
    for name, make in (
        ("backends", routes.backend_routes),
        ("qpsolvers", routes.qpsolvers_route),
        ("casadi", lambda *a: [routes.ipopt_route(*a)]),
    ):
        try:
            found += make(programs, exact)
        except ImportError as error:
            notes.append(f"{name}: no row, {error}")
    return found


def _ticks(stream: Stream, notes: list[str]) -> list[Contestant]:
    exact = [reference.lexicographic(program) for program in stream.programs]
    found = [
        routes.tick_route(stream, exact),
        routes.lexicographic_route(stream.programs, exact),
    ]
    try:
        found += cbfpy_route.cbfpy_routes(stream, _one_shot(stream.programs))
    except ImportError as error:
        notes.append(f"cbfpy: no row, {error}; pip install 'clfcbf[bench]'")
    return found


def _c_loop_row(
    programs: Sequence[Program], repeats: int, notes: list[str]
) -> list[dict[str, Any]]:
    """The C loop over all programs that one barrier row decides; times are a program's share."""
    try:
        loop = CLoop()
    except CompilerMissingError as error:
        notes.append(f"c-loop: no row, {error}")
        return []
    single = [(p, rows[0]) for p in programs if len(rows := _cutting(p)) <= 1 and rows]
    if not single:
        notes.append("c-loop: no row, no program with one barrier row that cuts its box")
        return []
    chosen = [p._replace(hard=(row,)) for p, row in single]
    columns = ([p.nominal for p in chosen], [p.box for p in chosen], [p.hard[0] for p in chosen])
    nominal, box, hard, soft = (
        np.array(x, dtype=np.float64) for x in (*columns, [p.soft for p in chosen])
    )

    def call(_: object) -> NDArray[np.float64]:
        return loop.one_shot(chosen[0].weight, nominal, box, hard, soft, routes.PENALTY)

    answers = [(v, w) if ok else None for v, w, _, ok in call(None).tolist()]
    route = Contestant("c-loop", "solve", call, chosen, lambda _: None, _one_shot(chosen))
    calls = Contestant("c-loop", "solve", call, [None] * 10 * repeats, lambda _: None, [])
    (sample,) = interleave([calls], 1, BLOCK, np.random.default_rng(0))
    figures = row(route, Sample(sample.times, answers))
    for name in [name for name in figures if name.endswith("_us")]:
        figures[name] /= len(chosen)
    return [figures]


def _cutting(program: Program) -> list[tuple[float, float, float]]:
    """The barrier rows that some command of the box violates, or the first where none does."""
    v_lo, v_hi, w_lo, w_hi = program.box
    rows = [
        (a, c, b)
        for a, c, b in program.hard
        if a * (v_hi if a > 0.0 else v_lo) + c * (w_hi if c > 0.0 else w_lo) > b
    ]
    return rows or [program.hard[0]]


def _stressed(programs: Sequence[Program], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Errors, not times, on programs made hard; those found infeasible exactly are left out."""
    answers = [reference.one_shot(program, routes.PENALTY) for program in programs]
    kept = [(p, x) for p, x in zip(programs, answers, strict=True) if x is not None]
    exact = [x for _, x in kept]
    contestants = _solvers([p for p, _ in kept], exact, [])
    samples = interleave(contestants, 1, BLOCK, rng)
    wanted = ("name", "worst_error", "wrong", "failed", "programs", "median_us")
    return [
        {key: value for key, value in row(c, s).items() if key in wanted}
        for c, s in zip(contestants, samples, strict=True)
    ]


def _scaling(
    programs: Sequence[Program], counts: Sequence[int], repeats: int, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Median and 99th percentile with so many obstacle rows, their assembly included."""
    rows = []
    for count in counts:
        contestants = obstacles.obstacle_routes(programs[:SCALING_PROGRAMS], count, rng)
        samples = interleave(contestants, repeats, BLOCK, rng)
        rows += [
            {"obstacles": count} | row(c, s) for c, s in zip(contestants, samples, strict=True)
        ]
    return rows


def _spread(samples: dict[str, Sample], over: str, under: str) -> dict[str, float]:
    """Ratio of the medians over the programs, round by round; 0 where a route is missing."""
    if over not in samples or under not in samples:
        return {"min": 0.0, "median": 0.0, "max": 0.0}
    medians = [np.median(samples[name].times, axis=1) for name in (over, under)]
    ratio = medians[0] / medians[1]
    return {
        "min": float(ratio.min()), "median": float(np.median(ratio)), "max": float(ratio.max())
    }  # fmt: skip


def _cbfpy_difference(stream: Stream) -> float | None:
    try:
        return cbfpy_route.rows_difference(stream)
    except ImportError:
        return None


def calls_per_tick(stream: Stream) -> dict[str, float]:
    """Calls of Python functions and of built-in ones in a tick, which no noise changes."""
    counts = {"call": 0, "c_call": 0}

    def count(frame: Any, event: str, argument: Any) -> None:
        if event in counts:
            counts[event] += 1

    controller = stream.controller
    for tick in stream.ticks:
        controller.state = tick.state
        sys.setprofile(count)
        try:
            controller.step(*tick.inputs, tick.now)
        finally:
            sys.setprofile(None)
    ticks = len(stream.ticks)
    # The call that takes the profiler off again is counted with the built-in ones.
    return {"python": counts["call"] / ticks, "builtin": counts["c_call"] / ticks - 1.0}
