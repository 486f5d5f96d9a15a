"""One small program, solved some hundred times: what an interpreter of its own runs and prints."""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable
from typing import Any

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.decision import Decision
from clfcbf.limits import Limits
from clfcbf.qp import QuadraticProgram, get_backend, solve_lexicographic
from clfcbf.qp.ladder import AGREEMENT
from clfcbf.safety_filter import SafetyFilter
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist

__all__ = ["TIMINGS", "program_of", "report_backend", "report_timing", "time_backend"]

SOLVES = 300
"""Solves timed: their median repeats to a few percent."""

LONGEST = 2.0
"""[s] For one timing, where a solver is slow."""

WARM_UP = 20
"""Solves before the first one timed: what a solver sets up once is not a tick's cost."""

_PERIOD = 1.0 / 30.0
_NOMINAL = Twist(0.22, -0.4)
_APPLIED = Twist(0.2, -0.2)
_SCENE = Scene(Pose2(1.4, 0.8, 0.0), Pose2(2.0, 0.8, 0.0), 0.0)


def _filter() -> SafetyFilter:
    """A filter whose command the camera's left edge holds in :data:`_SCENE`."""
    limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
    camera = FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
    return SafetyFilter(limits, [FieldOfViewBarrier(camera, gain=1.5)], _PERIOD)


def _decided() -> Decision:
    return _filter().filter(_NOMINAL, _SCENE, _APPLIED, 0.0)


def program_of(decision: Decision) -> QuadraticProgram:
    r"""The program of a tick whose rows can all hold, :math:`q = -Qu_{nom}`."""
    q11, q12, q22 = decision.weight or defaults.QP_WEIGHT
    v, omega = decision.nominal
    v_lo, v_hi, w_lo, w_hi = decision.box
    rows = list(decision.named_rows.values())
    return QuadraticProgram(
        ((q11, q12), (q12, q22)),
        (-q11 * v - q12 * omega, -q12 * v - q22 * omega),
        [row[:2] for row in rows] or None,
        [row[2] for row in rows] or None,
        (v_lo, w_lo),
        (v_hi, w_hi),
    )


def _median_us(call: Callable[[], object]) -> tuple[float, int]:
    """Median duration of ``call`` [us], and of how many."""
    end = time.perf_counter() + LONGEST
    for _ in range(WARM_UP):
        call()
        if time.perf_counter() > end:
            break
    durations: list[float] = []
    while len(durations) < SOLVES and (not durations or time.perf_counter() < end):
        begun = time.perf_counter()
        call()
        durations.append(time.perf_counter() - begun)
    return 1e6 * statistics.median(durations), len(durations)


def time_backend(name: str) -> dict[str, Any]:
    """What a backend can take, its median [us], and how far its answer is from the exact one."""
    backend = get_backend(name)
    capability = backend.capability
    problem = program_of(_decided())
    exact = get_backend("exact").solve(problem).x
    answer = backend.solve(problem).x
    distance = math.inf
    if exact is not None and answer is not None:
        distance = math.hypot(answer[0] - exact[0], answer[1] - exact[1])
    median, solves = _median_us(lambda: backend.solve(problem))
    return {
        "package": capability.package,
        "licence": capability.licence,
        "max_variables": capability.max_variables,
        "semidefinite": capability.semidefinite,
        "multipliers": capability.multipliers,
        "median_us": median,
        "solves": solves,
        "distance": distance if math.isfinite(distance) else None,
        "agrees": distance <= AGREEMENT,
    }


def _time_exact() -> tuple[float, int]:
    decision = _decided()
    levels = [block.coefficients for block in decision.rows]
    weight = decision.weight or defaults.QP_WEIGHT
    return _median_us(lambda: solve_lexicographic(weight, decision.nominal, decision.box, levels))


def _time_tick() -> tuple[float, int]:
    """The second tick of a run, time and again from the same state."""
    safe = _filter()
    safe.filter(_NOMINAL, _SCENE, _APPLIED, 0.0)
    state = safe.state

    def tick() -> None:
        safe.state = state
        safe.filter(_NOMINAL, _SCENE, _APPLIED, _PERIOD)

    return _median_us(tick)


TIMINGS: dict[str, Callable[[], tuple[float, int]]] = {
    "exact solve": _time_exact,
    "SafetyFilter tick": _time_tick,
}
"""What is timed beside the backends, by name."""


def report_backend(name: str) -> None:
    """Print :func:`time_backend` as JSON, on a line of its own behind what a solver prints."""
    print("\n" + json.dumps(time_backend(name), allow_nan=False))


def report_timing(name: str) -> None:
    """As above, one of :data:`TIMINGS`."""
    median, solves = TIMINGS[name]()
    print("\n" + json.dumps({"median_us": median, "solves": solves}, allow_nan=False))
