"""Recorded ticks and the programs in them: what every contestant of the latency benchmark gets.

Closed-loop runs of :class:`clfcbf.TrackingController` behind a lagging body, with scenes 100 ms
old. The virtual target runs along a quintic that starts beside the robot, as after a push or a
new plan. In every second run it leads to the goal, and the barrier hardly acts; in the others it
leads away to the side, and only the barrier keeps the feature in view.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clfcbf import Decision, Limits, Pose2, Reference, Scene, TrackingController, Twist
from clfcbf.constraints.rows import Priority, Row
from clfcbf.controller import TrackingInputs
from clfcbf.qp.exact import Box, Weight
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, REGIONS, World, draw_start
from clfcbf.tick import FilterState, begin, motion_to_now
from clfcbf.trajectories.quintic import Quintic, minimum_duration

__all__ = ["Program", "Stream", "Tick", "record_stream", "stress_programs"]

LATENCY_TICKS = 3
"""Age of a scene when it is used: 100 ms at 30 Hz."""

LAG = 0.12
"""[s] First-order lag of the body, known to the controller."""

PUSH = Pose2(0.25, 0.25, 0.6)
"""[m, m, rad] Largest distance of the plan's start from the robot: an error to work off."""

ASIDE = Pose2(-0.5, 1.2, 1.2)
"""[m, m, rad] End of a plan that leads out of view, to either side, in the goal's frame."""

STRETCHES = (1.2, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Durations tried for a plan, in units of a straight line's, until the limits hold."""

RUN = 8.0
"""[s] Length of a run: by then the error is worked off, or the barrier holds the robot."""

STRESS_SETS = ("badly scaled", "nearly infeasible", "nearly parallel")


class Program(NamedTuple):
    r"""Box, barrier rows and Lyapunov row of a tick.

    ``nominal`` is the tick's command of the law; the paper's program has zero in its place.
    """

    weight: Weight
    nominal: Twist
    box: Box
    hard: tuple[Row, ...]
    soft: Row

    def without_nominal(self) -> Program:
        """The paper's form, its reference command zero."""
        return self._replace(nominal=Twist(0.0, 0.0))


class Tick(NamedTuple):
    """One tick as it was: state and inputs, what was decided, and where its rows were taken.

    ``error`` (virtual target) and ``feature`` are as seen from where the body coasts to.
    """

    state: FilterState
    inputs: TrackingInputs
    now: float
    decision: Decision
    program: Program
    error: Pose2
    feature: Pose2


@dataclass(frozen=True, slots=True)
class Stream:
    """Ticks of several runs in a row, and the controller that made them."""

    controller: TrackingController
    ticks: tuple[Tick, ...]
    ticks_without_program: int

    @property
    def programs(self) -> list[Program]:
        """The program of every tick."""
        return [tick.program for tick in self.ticks]

    def active(self) -> dict[str, int]:
        """Ticks by what kept the command from the nominal one."""
        counts = {"nothing": 0, "a barrier": 0, "barrier and Lyapunov row relaxed": 0}
        for tick in self.ticks:
            answer = tick.decision.answer
            assert answer is not None
            if (answer.v, answer.omega) == tick.program.nominal:
                counts["nothing"] += 1
            elif answer.relaxed:
                counts["barrier and Lyapunov row relaxed"] += 1
            else:
                counts["a barrier"] += 1
        return counts


def program_of(decision: Decision) -> Program:
    """The program a decision answered."""
    assert decision.weight is not None
    hard: list[Row] = []
    soft: list[Row] = []
    for block in decision.rows:
        (hard if block.priority < Priority.STABILITY else soft).extend(block.coefficients)
    (row,) = soft
    v_lo, v_hi, w_lo, w_hi = decision.box
    return Program(decision.weight, decision.nominal, (v_lo, v_hi, w_lo, w_hi), tuple(hard), row)


def plan_beside(start: Pose2, end: Pose2, limits: Limits, rng: np.random.Generator) -> Quintic:
    """A quintic to ``end`` from a pose near ``start``, within the limits if a stretch does it."""
    offset = Pose2(*(float(rng.uniform(-largest, largest)) for largest in PUSH))
    beside = start.compose(offset)
    length = math.hypot(beside.x - end.x, beside.y - end.y)
    shortest = minimum_duration(length, limits)
    for stretch in STRETCHES:
        duration = stretch * shortest
        push = min(4.0 * length / duration**2, limits.a_max)
        plan = Quintic.between(
            beside, end, duration,
            start_acceleration=push, end_acceleration=-push,
        )  # fmt: skip
        if not plan.limits_exceeded(limits):
            break
    return plan


def record_stream(programs: int = 2000, seed: int = 0) -> Stream:
    """Run after run until ``programs`` ticks with a program are recorded."""
    world, limits = World(), LIMITS["approaching"]
    controller = TrackingController(limits, [world.camera], world.period, lag=LAG)
    ticks: list[Tick] = []
    missed = 0
    for run in itertools.count():
        rng = np.random.default_rng((seed, run))
        start = draw_start(REGIONS["R1"], world, rng)
        plan = plan_beside(start, _end(run), limits, rng)
        plant = KinematicPlant(start, limits, Body(lag=LAG), rng)
        controller.state = FilterState()
        seen: list[tuple[Scene, Reference]] = []
        for k in range(int(RUN / world.period)):
            now, pose = k * world.period, plant.pose()
            target, twist = plan.at(now)
            scene = Scene(pose.inverse(), pose.relative(world.feature), now)
            seen.append((scene, Reference(pose.relative(target), twist)))
            scene, reference = seen[max(0, k - LATENCY_TICKS)]
            state, applied = controller.state, plant.applied()
            decision = controller.step(reference, scene, applied, now)
            if decision.answer is None:
                missed += 1
            elif k:
                inputs = TrackingInputs(reference, scene, applied)
                ticks.append(_tick(controller, state, inputs, now, decision))
                if len(ticks) == programs:
                    return Stream(controller, tuple(ticks), missed)
            plant.send(decision.twist)
            plant.advance(world.period)
    raise AssertionError("unreachable")


def _end(run: int) -> Pose2:
    """The goal, or a pose out of whose way the feature is seen no more, left and right in turn."""
    if run % 2:
        return Pose2(0.0, 0.0, 0.0)
    return ASIDE if run % 4 else Pose2(ASIDE.x, -ASIDE.y, -ASIDE.theta)


def _tick(
    controller: TrackingController,
    state: FilterState,
    inputs: TrackingInputs,
    now: float,
    decision: Decision,
) -> Tick:
    base = controller.config.filter
    begun = begin(base, state, inputs.applied, now)
    motion = motion_to_now(base, begun, inputs.scene)
    assert isinstance(motion, Pose2)
    ahead = motion.moved(begun.reckoning.body, base.lag)
    return Tick(
        state, inputs, now, decision, program_of(decision),
        ahead.relative(inputs.reference.pose), ahead.relative(inputs.scene.feature),
    )  # fmt: skip


def stress_programs(
    programs: list[Program], count: int = 200, seed: int = 0
) -> dict[str, list[Program]]:
    """Recorded programs made hard in three ways; all feasible, box and one barrier row at least."""
    rng = np.random.default_rng((seed, len(STRESS_SETS)))
    chosen = [programs[i] for i in rng.integers(len(programs), size=count)]
    return {
        "badly scaled": [_badly_scaled(p, rng) for p in chosen],
        "nearly infeasible": [_nearly_infeasible(p, rng) for p in chosen],
        "nearly parallel": [_nearly_parallel(p, rng) for p in chosen],
    }


def _badly_scaled(program: Program, rng: np.random.Generator) -> Program:
    """Rows and weight over eight decades, the Lyapunov row over four."""
    factors = (10.0 ** rng.uniform(-4.0, 4.0, len(program.hard))).tolist()
    hard = tuple((k * a, k * c, k * b) for k, (a, c, b) in zip(factors, program.hard, strict=True))
    k = 10.0 ** float(rng.uniform(-2.0, 2.0))
    a, c, b = program.soft
    q11, q12, q22 = program.weight
    weight = (q11, q12, q22 * 10.0 ** float(rng.uniform(-4.0, 4.0)))
    return program._replace(hard=hard, soft=(k * a, k * c, k * b), weight=weight)


def _nearly_infeasible(program: Program, rng: np.random.Generator) -> Program:
    """One row in a random direction leaves a corner of the box 1e-9 to 1e-3 deep."""
    angle = float(rng.uniform(-math.pi, math.pi))
    a, c = math.cos(angle), math.sin(angle)
    v_lo, v_hi, w_lo, w_hi = program.box
    least = a * (v_lo if a > 0.0 else v_hi) + c * (w_lo if c > 0.0 else w_hi)
    row = (a, c, least + 10.0 ** float(rng.uniform(-9.0, -3.0)))
    return program._replace(hard=(row, row))


def _nearly_parallel(program: Program, rng: np.random.Generator) -> Program:
    """Two rows 1e-10 to 1e-3 rad apart whose lines meet in the box."""
    angle = float(rng.uniform(-math.pi, math.pi))
    v_lo, v_hi, w_lo, w_hi = program.box
    v, w = float(rng.uniform(v_lo, v_hi)), float(rng.uniform(w_lo, w_hi))
    tilt = 10.0 ** float(rng.uniform(-10.0, -3.0))
    rows = tuple(
        (a, c, a * v + c * w)
        for a, c in ((math.cos(t), math.sin(t)) for t in (angle, angle + tilt))
    )
    return program._replace(hard=rows)
