r"""Programs solved in one call, B at a time: ours in NumPy, a C loop, and what others call a batch.

All solve the paper's one-shot program with one barrier row; ours and the C loop also in
lexicographic form. The programs are the recorded ones, each repeated with small changes, so that
no two are alike.
"""

from __future__ import annotations

import functools
import importlib
import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.c_loop import CLoop, CompilerMissingError
from benchmarks.routes import PENALTY
from benchmarks.stream import Program
from clfcbf.qp.batch import solve_batch
from clfcbf.qp.batch_one_shot import solve_batch_paper
from clfcbf.qp.exact import paper_program, solve_lexicographic

__all__ = ["SIZES", "Arrays", "batch_arrays", "measure_batches"]

SIZES = (1, 100, 10_000, 100_000)

MOST = {"ProxQP parallel batch": 10_000}
"""Largest B of a route; its objects would need a gigabyte beyond."""

SPREAD = 0.05
"""Relative change of each coefficient from one repetition of a program to the next."""

JUDGED = 1000
"""Programs of a batch whose answers are compared with the exact solve one by one."""

SHORTEST = 0.02
"""[s] Least duration of a measurement; small batches are called again and again until then."""

Array = NDArray[np.float64]


class Arrays(NamedTuple):
    """B programs: nominal (B, 2), box (B, 4), hard (B, 3), soft (B, 3), of one weight."""

    weight: tuple[float, float, float]
    nominal: Array
    box: Array
    hard: Array
    soft: Array

    def head(self, count: int) -> Arrays:
        """The first ``count`` programs."""
        parts = (np.ascontiguousarray(part[:count]) for part in self[1:])
        return Arrays(self.weight, *parts)


@dataclass(frozen=True, slots=True)
class Route:
    """A way to solve a batch: ``prepare`` outside the timer gives the call that is timed.

    The call returns the commands, shape (B, 2), or something ``read`` makes them of.
    """

    name: str
    prepare: Callable[[Arrays], Callable[[], Any]]
    read: Callable[[Any], Array]
    scope: Callable[[], AbstractContextManager[Any]] = nullcontext


def batch_arrays(programs: Sequence[Program], count: int, seed: int = 0) -> Arrays:
    """``count`` programs from the recorded ones, the barrier row next to being violated kept."""
    rng = np.random.default_rng((seed, count))
    hard = [
        min(p.hard, key=lambda row, p=p: row[2] - row[0] * p.nominal.v - row[1] * p.nominal.omega)  # type: ignore[misc]
        for p in programs
    ]
    picked = rng.integers(len(programs), size=count)

    def spread(rows: Sequence[Sequence[float]]) -> Array:
        values = np.array(rows)[picked]
        return np.ascontiguousarray(values * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, values.shape))

    box = np.array([p.box for p in programs])[picked]
    return Arrays(
        programs[0].weight,
        spread([p.nominal for p in programs]),
        np.ascontiguousarray(box),
        spread(hard),
        spread([p.soft for p in programs]),
    )


def measure_batches(
    programs: Sequence[Program],
    sizes: Sequence[int],
    rounds: int,
    rng: np.random.Generator,
    notes: list[str],
) -> list[dict[str, Any]]:
    """Programs per second of every route at every size: the best of ``rounds`` interleaved ones.

    ``worst_error`` is the largest difference to the exact solve one by one, over the first
    ``JUDGED`` programs where both have a command.
    """
    routes = _routes(notes)
    rows: list[dict[str, Any]] = []
    for size in sizes:
        arrays = batch_arrays(programs, size)
        exact = _one_by_one(arrays)
        calls: list[tuple[Route, Callable[[], Any], float]] = []
        for route in routes:
            if size > MOST.get(route.name, size):
                notes.append(f"{route.name}: not measured at B = {size}, too large")
                continue
            with route.scope():
                call = route.prepare(arrays)
                reference = exact["lexicographic" in route.name]
                calls.append((route, call, _error(route.read(call()), reference)))
        best = [math.inf] * len(calls)
        for _ in range(rounds):
            for i in rng.permutation(len(calls)):
                route, call, _ = calls[i]
                with route.scope():
                    best[i] = min(best[i], _duration(call))
        rows += [
            {"name": r.name, "B": size, "per_second": size / t, "worst_error": error}
            for (r, _, error), t in zip(calls, best, strict=True)
        ]
    return rows


def _duration(call: Callable[[], Any]) -> float:
    """Seconds a call takes, from as many as make a measurable time."""
    count, begun = 0, time.perf_counter()
    while True:
        call()
        count += 1
        elapsed = time.perf_counter() - begun
        if elapsed >= SHORTEST:
            return elapsed / count


def _one_by_one(arrays: Arrays) -> tuple[Array, Array]:
    """The exact answers of the one-shot and of the lexicographic programs; NaN for no answer."""
    one_shot, lexicographic = [], []
    columns = (part[:JUDGED].tolist() for part in arrays[1:])
    for nominal, box, hard, soft in zip(*columns, strict=True):
        paper = paper_program(arrays.weight, nominal, box, (hard,), soft, PENALTY)
        one_shot.append((paper.v, paper.omega) if paper.feasible else (math.nan, math.nan))
        answer = solve_lexicographic(arrays.weight, nominal, box, ((hard,), (soft,)))
        assert answer is not None
        lexicographic.append((answer.v, answer.omega))
    return np.array(one_shot), np.array(lexicographic)


def _error(answer: Array, reference: Array) -> float:
    answer = answer[: len(reference)]
    both = np.isfinite(answer).all(axis=1) & np.isfinite(reference).all(axis=1)
    return float(np.abs(answer - reference)[both].max(initial=0.0))


def _routes(notes: list[str]) -> list[Route]:
    routes = [
        Route("exact", _one_shot, lambda answer: _feasible(answer)),
        Route("exact-lexicographic", _lexicographic, lambda answer: np.asarray(answer.twist)),
    ]
    for name, make in (("c-loop", _c_loops), ("ProxQP", _proxqp), ("qpax", _qpax)):
        try:
            routes += make()
        except (ImportError, CompilerMissingError) as error:
            notes.append(f"{name}: no batch, {error}")
    return routes


def _feasible(answer: Any) -> Array:
    return np.where(answer.feasible[:, None], answer.twist, np.nan)


def _one_shot(arrays: Arrays) -> Callable[[], Any]:
    weight, nominal, box, hard, soft = arrays
    return lambda: solve_batch_paper(weight, nominal, box, hard[:, None], soft, PENALTY)


def _lexicographic(arrays: Arrays) -> Callable[[], Any]:
    weight, nominal, box, hard, soft = arrays
    return lambda: solve_batch(weight, nominal, box, hard[:, None], soft[:, None])


def _c_loops() -> list[Route]:
    loop = CLoop()

    def one_shot(arrays: Arrays) -> Callable[[], Any]:
        return lambda: loop.one_shot(*arrays, PENALTY)

    def lexicographic(arrays: Arrays) -> Callable[[], Any]:
        return lambda: loop.lexicographic(*arrays)

    def read(out: Array) -> Array:
        return np.where(out[:, 3:] > 0.0, out[:, :2], np.nan)

    return [
        Route("c-loop", one_shot, read),
        Route("c-loop-lexicographic", lexicographic, lambda out: out[:, :2]),
    ]


def _three_variables(arrays: Arrays) -> tuple[Array, Array, Array, Array]:
    """P, q, G, h of all programs with delta as a variable; box and delta >= 0 are rows."""
    (q11, q12, q22), nominal, box, hard, soft = arrays
    count = len(nominal)
    P = np.zeros((count, 3, 3))
    P[:, :2, :2] = 2.0 * np.array(((q11, q12), (q12, q22)))
    P[:, 2, 2] = 2.0 * PENALTY
    q = np.zeros((count, 3))
    q[:, :2] = -np.einsum("nij,nj->ni", P[:, :2, :2], nominal)
    G, h = np.zeros((count, 7, 3)), np.zeros((count, 7))
    G[:, 0, :2], h[:, 0] = hard[:, :2], hard[:, 2]
    G[:, 1, :2], h[:, 1] = soft[:, :2], soft[:, 2]
    G[:, 1, 2] = -1.0
    G[:, 2:] = np.array(((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, -1)))
    h[:, 2:6] = box[:, (1, 0, 3, 2)] * np.array((1.0, -1.0, 1.0, -1.0))
    return P, q, G, h


def _proxqp() -> list[Route]:
    # Importing it sets this variable; what was there before is put back.
    before = os.environ.get("KMP_DUPLICATE_LIB_OK")
    proxsuite = importlib.import_module("proxsuite")
    if before is None:
        os.environ.pop("KMP_DUPLICATE_LIB_OK", None)
    dense = proxsuite.proxqp.dense

    def prepare(arrays: Arrays) -> Callable[[], Any]:
        P, q, G, h = _three_variables(arrays)
        batch = dense.BatchQP(len(q))
        low = np.full(7, -1e20)
        for i in range(len(q)):
            program = batch.init_qp_in_place(3, 0, 7)
            program.init(P[i], q[i], None, None, G[i], low, h[i])

        def call() -> Any:
            dense.solve_in_parallel(batch, num_threads=os.cpu_count() or 1)
            return batch

        return call

    def read(batch: Any) -> Array:
        solved = proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED
        results = [batch.get(i).results for i in range(batch.size())]
        return np.array([r.x[:2] if r.info.status == solved else (np.nan,) * 2 for r in results])

    return [Route("ProxQP parallel batch", prepare, read)]


def _qpax() -> list[Route]:
    jax = importlib.import_module("jax")
    qpax = importlib.import_module("qpax")

    def one(P: Any, q: Any, G: Any, h: Any) -> Any:
        A, b = np.zeros((0, 3)), np.zeros(0)
        x, *_, converged, _ = qpax.solve_qp(P, q, A, b, G, h, solver_tol=1e-9)
        return x, converged

    many = jax.jit(jax.vmap(one))

    def prepare(arrays: Arrays) -> Callable[[], Any]:
        data = [jax.numpy.asarray(part) for part in _three_variables(arrays)]
        return lambda: jax.block_until_ready(many(*data))

    def read(answer: Any) -> Array:
        x, converged = (np.asarray(part) for part in answer)
        return np.where(converged.reshape(-1, 1) > 0, x[:, :2], np.nan)

    return [Route("qpax vmap", prepare, read, functools.partial(jax.enable_x64, True))]
