"""Fault injection: the safety filter with a backend that fails in every way a solver can.

``python -m benchmarks.faults [--ticks N] [--seed S] [--rate R] [--backends …] [--json FILE]``

Each tick is decided twice from the same state, with ``exact`` and with the faulty backend, and
must be the same command to 1e-6, finite and inside the tick's input box. The faults are put
around the backend; the answers that are not spoilt are its own, solved for in that tick, so a
long run takes as long as the solvers do: all of them at 200 000 ticks about half an hour, most
of it IPOPT's and qpsolvers'. The file is written anew after each backend.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Scene, Twist, available_backends
from clfcbf.guard import Verdict, moved_scene
from clfcbf.qp import (
    Backend,
    Capability,
    QpSolution,
    QpStatus,
    QuadraticProgram,
    SolverHealth,
    get_backend,
)
from clfcbf.se2 import arc

__all__ = ["FAULTS", "Faulty", "main", "run"]

PERIOD = 1.0 / 30.0
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
AGREES = 1e-6
"""[m/s, rad/s] Largest difference to the command without a fault."""

DELAY = 2e-4
"""[s] Of a late answer: longer than a solve, short enough for a long run."""

FAULTS = (
    "raises", "divides by zero", "out of memory", "nan", "infinity", "off a little", "off a lot",
    "outside the box", "claims infeasible", "claims unbounded", "gives up", "empty", "late",
    "three numbers", "one number", "a scalar", "objects", "a list", "none", "text", "no status",
)  # fmt: skip
"""What :class:`Faulty` can do."""


class Faulty:
    """A backend whose answers are spoilt at random.

    Parameters
    ----------
    inner : the backend behind it
    rng : decides when and how
    rate : share of the answers that are spoilt
    faults : kinds, of :data:`FAULTS`

    Attributes
    ----------
    injected : how often each kind was
    """

    capability = Capability()

    def __init__(
        self,
        inner: Backend,
        rng: np.random.Generator,
        rate: float = 0.5,
        faults: Sequence[str] = FAULTS,
    ) -> None:
        self.inner, self.rng, self.rate, self.faults = inner, rng, rate, tuple(faults)
        self.name = f"faulty {inner.name}"
        self.injected: Counter[str] = Counter()

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> Any:
        """What the inner backend says, or something else."""
        if self.rng.random() >= self.rate:
            return self.inner.solve(problem)
        fault = self.faults[int(self.rng.integers(len(self.faults)))]
        self.injected[fault] += 1
        return self._spoil(fault, problem)

    def _spoil(self, fault: str, problem: QuadraticProgram) -> Any:
        n = problem.n

        def point(*values: float) -> QpSolution:
            return QpSolution(np.array(values), QpStatus.OPTIMAL, self.name)

        match fault:
            case "raises":
                raise RuntimeError("singular matrix")
            case "divides by zero":
                raise ZeroDivisionError("division by zero")
            case "out of memory":
                raise MemoryError
            case "nan":
                return point(math.nan, *[0.0] * (n - 1))
            case "infinity":
                return point(*[math.inf] * n)
            case "off a little" | "off a lot":
                honest = self.inner.solve(problem)
                size = 1e-3 if fault == "off a little" else 1e9
                moved = np.zeros(n) if honest.x is None else honest.x
                return point(*(moved + size * self.rng.normal(size=n)))
            case "outside the box":
                return point(*(problem.ub + 1e-2))
            case "claims infeasible":
                return QpSolution(None, QpStatus.INFEASIBLE, self.name)
            case "claims unbounded":
                return QpSolution(np.full(n, -1e20), QpStatus.UNBOUNDED, self.name)
            case "gives up":
                return QpSolution(problem.lb, QpStatus.ITERATION_LIMIT, self.name)
            case "empty":
                return QpSolution(np.zeros(0), QpStatus.OPTIMAL, self.name)
            case "late":
                time.sleep(DELAY)
                return self.inner.solve(problem)
            case "three numbers":
                return point(*[0.0] * (n + 1))
            case "one number":
                return point(0.0)
            case "a scalar":
                return QpSolution(np.array(0.0), QpStatus.OPTIMAL, self.name)
            case "objects":
                return QpSolution(np.array([None] * n), QpStatus.OPTIMAL, self.name)
            case "a list":
                return replace(point(0.0), x=[0.0] * n)  # type: ignore[arg-type]
            case "none":
                return None
            case "text":
                return "solved"
            case _:
                return replace(point(*[0.0] * n), status="solved")  # type: ignore[arg-type]


def run(
    backend: str,
    ticks: int,
    seed: int = 0,
    rate: float = 0.5,
    faults: Sequence[str] = FAULTS,
) -> dict[str, Any]:
    """Drive the filter at random for ``ticks`` ticks; what was injected, and what came of it.

    Returns
    -------
    ``ticks``, ``injected`` by kind, ``outside`` (commands not finite or outside the box),
    ``different`` (from the command without a fault), ``exceptions``, ``uncertified``, and what
    the health said: ``asked``, ``used``, ``refused``, ``failed``
    """
    rng = np.random.default_rng((seed, ticks))
    faulty = Faulty(get_backend(backend), np.random.default_rng(seed), rate, faults)
    name: Any = faulty  # a backend itself may stand for its name
    spoilt = SafetyFilter(LIMITS, [CAMERA], PERIOD, name)
    sound = SafetyFilter(LIMITS, [CAMERA], PERIOD)
    health = SolverHealth()
    counts: Counter[str] = Counter()
    scene, applied = _start(rng), Twist(0.0, 0.0)
    nominal, hold = Twist(0.0, 0.0), 0
    for k in range(ticks):
        now = k * PERIOD
        if k % 400 == 0:
            scene = _start(rng)
        if hold == 0:
            nominal = Twist(float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.8, 0.8)))
            hold = int(rng.integers(1, 30))
        hold -= 1
        shown = scene._replace(stamp=now)
        sound.state = spoilt.state
        expected = sound.filter(nominal, shown, applied, now)
        try:
            decision = spoilt.filter(nominal, shown, applied, now)
        except Exception:
            counts["exceptions"] += 1
            decision = expected
        if decision.answer is not None:
            health.record_tick(decision.answer.health)
        box = LIMITS.input_box(applied, PERIOD)
        if not (all(map(math.isfinite, decision.twist)) and box.contains(decision.twist, 1e-9)):
            counts["outside"] += 1
        distance = math.dist(decision.twist, expected.twist)
        # Which fallback the guard chooses may turn on the last bit; then both are certified.
        chosen = decision.verdict is not expected.verdict or decision.verdict is Verdict.REPLACED
        if not distance <= AGREES and not (chosen and decision.certified and expected.certified):
            counts["different"] += 1
        counts["uncertified"] += not decision.certified
        applied = decision.twist
        scene = moved_scene(scene, arc(applied, PERIOD))
    tally = health.backends.get(faulty.name)
    return {
        "backend": backend,
        "ticks": ticks,
        "injected": dict(faulty.injected),
        **{key: counts[key] for key in ("outside", "different", "exceptions", "uncertified")},
        "asked": tally.asked if tally else 0,
        "used": tally.used if tally else 0,
        "refused": tally.refused if tally else 0,
        "failed": tally.failed if tally else 0,
    }


def _start(rng: np.random.Generator) -> Scene:
    distance, bearing = rng.uniform(0.6, 2.5), rng.uniform(-0.5, 0.5)
    feature = Pose2(
        float(0.2 + distance * math.cos(bearing)), float(distance * math.sin(bearing)), 0.0
    )
    return Scene(feature.compose(Pose2(-0.6, 0.0, 0.0)), feature, 0.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every backend and print what came of it; 0 whatever was found."""
    parser = argparse.ArgumentParser(prog="benchmarks.faults", description=__doc__)
    parser.add_argument("--ticks", type=int, default=200_000, help="for each backend")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=0.5, help="share of answers spoilt")
    parser.add_argument("--backends", nargs="+", default=list(available_backends()))
    parser.add_argument("--json", type=Path, metavar="FILE", help="overwritten")
    options = parser.parse_args(arguments)
    rows = []
    for name in options.backends:
        row = run(name, options.ticks, options.seed, options.rate)
        rows.append(row)
        print(
            f"{name:22} {row['ticks']} ticks, {sum(row['injected'].values())} faults: "
            f"{row['outside']} outside the contract, {row['different']} different commands, "
            f"{row['exceptions']} exceptions, {row['uncertified']} uncertified; of "
            f"{row['asked']} answers {row['used']} used, {row['refused']} refused, "
            f"{row['failed']} failed",
            flush=True,
        )
        if options.json is not None:
            text = json.dumps({"backends": rows}, indent=1) + "\n"
            options.json.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
