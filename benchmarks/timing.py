"""Interleaved timing: every contestant on every program, in turns short enough to share the noise.

The programs are cut into blocks; on each block the contestants run one after the other, in an
order drawn anew, so that what else the machine does falls on all of them alike. The garbage
collector is frozen and off. A time is one call, as short as ``perf_counter_ns`` can tell.
"""

from __future__ import annotations

import contextlib
import gc
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["WRONG", "Answer", "Contestant", "Sample", "interleave", "quiet", "row"]

Answer = tuple[float, float] | None
"""A command, or None where the contestant says it has none."""

WRONG = 1e-3
"""[m/s, rad/s] An answer farther off than this is wrong: a hundredth of what a tick may change."""


@dataclass(frozen=True, slots=True)
class Contestant:
    """A route from a prepared job to a command.

    Attributes
    ----------
    name, what : "tick" from state to command, "solve" from a program's arrays to its answer
    call : what is timed, one job at a time
    jobs : one a program, prepared outside the timer in the layout the route likes best
    read : turns the outcome of a call into a command, outside the timer
    expected : exact answers, one a job
    scope : entered around every turn, outside the timer
    """

    name: str
    what: str
    call: Callable[[Any], Any]
    jobs: Sequence[Any]
    read: Callable[[Any], Answer]
    expected: Sequence[tuple[float, float]]
    scope: Callable[[], AbstractContextManager[Any]] = nullcontext


@dataclass(slots=True)
class Sample:
    """Times [ns], shape (rounds, jobs), and the answers of the first round."""

    times: NDArray[np.int64]
    answers: list[Answer] = field(default_factory=list)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Garbage collector frozen and off, third-party warnings silent; both restored."""
    was_on = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        gc.unfreeze()
        if was_on:
            gc.enable()


def interleave(
    contestants: Sequence[Contestant], rounds: int, block: int, rng: np.random.Generator
) -> list[Sample]:
    """Time all contestants on all their jobs, ``rounds`` times over.

    Each turn begins with one call that is not timed, to warm the caches that others cooled.
    """
    samples = [Sample(np.zeros((rounds, len(c.jobs)), dtype=np.int64)) for c in contestants]
    longest = max(len(c.jobs) for c in contestants)
    for turn in range(rounds):
        for start in range(0, longest, block):
            for i in rng.permutation(len(contestants)):
                _run(contestants[i], samples[i], turn, start, block)
    return samples


def _run(contestant: Contestant, sample: Sample, turn: int, start: int, block: int) -> None:
    jobs = contestant.jobs[start : start + block]
    if not jobs:
        return
    call, clock, first = contestant.call, time.perf_counter_ns, turn == 0
    outcome: Any
    with contestant.scope():
        with contextlib.suppress(Exception):
            call(jobs[0])
        for k, job in enumerate(jobs, start):
            begun = clock()
            try:
                outcome = call(job)
            except Exception:  # a rival that throws has failed, and the benchmark goes on
                outcome = None
            sample.times[turn, k] = clock() - begun
            if first:
                sample.answers.append(None if outcome is None else contestant.read(outcome))


def row(contestant: Contestant, sample: Sample) -> dict[str, Any]:
    """The figures of one contestant.

    Of each program the smallest time over the rounds counts, which leaves the machine's other
    work out; the median, 99th and 99.9th percentile are over the programs. ``all_p99_us`` is
    over every single call.
    """
    best = sample.times.min(axis=0) / 1e3
    errors = [
        _distance(answer, exact)
        for answer, exact in zip(sample.answers, contestant.expected, strict=True)
        if answer is not None
    ]
    return {
        "name": contestant.name,
        "what": contestant.what,
        "median_us": float(np.median(best)),
        "p99_us": float(np.percentile(best, 99.0)),
        "p999_us": float(np.percentile(best, 99.9)),
        "worst_error": max(errors, default=0.0),
        "wrong": sum(error > WRONG for error in errors),
        "failed": sum(answer is None for answer in sample.answers),
        "programs": len(contestant.jobs),
        "all_median_us": float(np.median(sample.times)) / 1e3,
        "all_p99_us": float(np.percentile(sample.times, 99.0)) / 1e3,
    }


def _distance(answer: tuple[float, float], exact: tuple[float, float]) -> float:
    error = max(abs(answer[0] - exact[0]), abs(answer[1] - exact[1]))
    return error if error < math.inf else 1e300  # NaN and infinity: a number that JSON can carry
