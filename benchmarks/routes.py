r"""Routes from a program to its answer: ours, every backend, IPOPT as the paper has it, qpsolvers.

All solve the paper's one-shot program
:math:`\min (u-\bar u)^\top Q(u-\bar u) + c\delta^2`, box, barrier rows,
:math:`a^\top u - b \le \delta`, with zero for the nominal command as printed. Arrays are built
beforehand, in the layout a route likes best; ours and the C loop leave out :math:`\delta`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.stream import Program, Stream
from benchmarks.timing import Answer, Contestant
from clfcbf import QpSolution, QuadraticProgram, available_backends
from clfcbf.qp import get_backend
from clfcbf.qp.exact import LexicographicSolution, PaperSolution, paper_program, solve_lexicographic

__all__ = [
    "PENALTY",
    "as_quadratic_program",
    "backend_route",
    "backend_routes",
    "exact_route",
    "ipopt_route",
    "ipopt_solver",
    "lexicographic_route",
    "qpsolvers_route",
    "tick_route",
]

PENALTY = 1e3
"""c of the slack, not printed in the paper: a slack of 1 mm/s-unit costs as much as 3 cm/s."""

PLAIN = ("daqp", "quadprog", "piqp", "proxqp", "osqp", "clarabel")
"""What qpsolvers is tried with, at its defaults; its JAX solvers take half a second a call."""

Exact = Sequence[tuple[float, float]]
Array = NDArray[np.float64]


def tick_route(stream: Stream, exact: Exact) -> Contestant:
    """The whole certified tick; judged by the program's answer within it."""
    controller = stream.controller

    def call(job: tuple[Any, Any, Any, Any, float]) -> Any:
        controller.state, reference, scene, applied, now = job
        return controller.step(reference, scene, applied, now)

    def read(decision: Any) -> Answer:
        answer = decision.answer
        return None if answer is None or decision.status.is_fault else (answer.v, answer.omega)

    jobs = [(tick.state, *tick.inputs, tick.now) for tick in stream.ticks]
    return Contestant("TrackingController.step", "tick", call, jobs, read, exact)


def exact_route(programs: Sequence[Program], exact: Exact) -> Contestant:
    """``paper_program``: the one-shot program with its slack eliminated."""

    def call(p: Program) -> PaperSolution:
        return paper_program(p.weight, p.nominal, p.box, p.hard, p.soft, PENALTY)

    def read(answer: PaperSolution) -> Answer:
        return (answer.v, answer.omega) if answer.feasible else None

    return Contestant("exact", "solve", call, list(programs), read, exact)


def lexicographic_route(programs: Sequence[Program], exact: Exact) -> Contestant:
    """``solve_lexicographic``: the tick's own program, on the tick's own nominal command."""

    def call(job: tuple[Any, ...]) -> LexicographicSolution | None:
        return solve_lexicographic(*job)

    def read(answer: LexicographicSolution) -> Answer:
        return answer.v, answer.omega

    jobs = [(p.weight, p.nominal, p.box, (p.hard, (p.soft,))) for p in programs]
    return Contestant("exact-lexicographic", "solve", call, jobs, read, exact)


def as_quadratic_program(program: Program) -> QuadraticProgram:
    """Three variables, v, omega and delta; ``solve_qp`` halves the cost, hence the twos."""
    q11, q12, q22 = program.weight
    v, omega = program.nominal
    v_lo, v_hi, w_lo, w_hi = program.box
    a, c, b = program.soft
    return QuadraticProgram(
        [[2.0 * q11, 2.0 * q12, 0.0], [2.0 * q12, 2.0 * q22, 0.0], [0.0, 0.0, 2.0 * PENALTY]],
        [-2.0 * (q11 * v + q12 * omega), -2.0 * (q12 * v + q22 * omega), 0.0],
        [*((x, y, 0.0) for x, y, _ in program.hard), (a, c, -1.0)],
        [*(z for *_, z in program.hard), b],
        [v_lo, w_lo, 0.0],
        [v_hi, w_hi, math.inf],
    )


def backend_routes(programs: Sequence[Program], exact: Exact) -> list[Contestant]:
    """Every available backend that takes three variables, its own ``solve`` alone."""
    problems = [as_quadratic_program(program) for program in programs]
    return [
        backend_route(name, problems, exact)
        for name in available_backends()
        if (get_backend(name).capability.max_variables or 3) >= 3
    ]


def backend_route(name: str, problems: Sequence[QuadraticProgram], exact: Exact) -> Contestant:
    """A backend at its default settings; our verification of its answer is not timed."""

    def read(answer: QpSolution) -> Answer:
        return None if answer.x is None else (float(answer.x[0]), float(answer.x[1]))

    return Contestant(name, "solve", get_backend(name).solve, problems, read, exact)


def qpsolvers_route(programs: Sequence[Program], exact: Exact) -> list[Contestant]:
    """``qpsolvers.solve_qp`` as its manual shows it, with each small dense solver installed."""
    qpsolvers = importlib.import_module("qpsolvers")
    jobs = [
        tuple(np.array(x) for x in (p.P, p.q, p.G, p.h, p.lb, p.ub))
        for p in map(as_quadratic_program, programs)
    ]

    def call(name: str, job: tuple[Array, ...]) -> Any:
        P, q, G, h, lb, ub = job
        return qpsolvers.solve_qp(P, q, G, h, lb=lb, ub=ub, solver=name)

    def read(x: Array) -> Answer:
        return float(x[0]), float(x[1])

    return [
        Contestant(f"qpsolvers.solve_qp {name}", "solve", partial(call, name), jobs, read, exact)
        for name in PLAIN
        if name in qpsolvers.available_solvers
    ]


def ipopt_solver(rows: int) -> Any:
    """CasADi's ``nlpsol`` with IPOPT for so many hard rows, the numbers its parameters.

    Built once, as the paper has it, silent, and otherwise at its defaults. Parameters: nominal
    command, weight, then the rows one after the other, the soft one last.
    """
    casadi = importlib.import_module("casadi")
    z, p = casadi.SX.sym("z", 3), casadi.SX.sym("p", 5 + 3 * (rows + 1))
    u, delta = z[:2] - p[:2], z[2]
    cost = p[2] * u[0] ** 2 + 2 * p[3] * u[0] * u[1] + p[4] * u[1] ** 2 + PENALTY * delta**2
    table = casadi.reshape(p[5:], 3, rows + 1).T
    excess = table[:, 0] * z[0] + table[:, 1] * z[1] - table[:, 2]
    excess[rows] -= delta
    options = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    problem = {"x": z, "p": p, "f": cost, "g": excess}
    return casadi.nlpsol("step", "ipopt", problem, options)


def ipopt_job(program: Program) -> dict[str, Any]:
    """Arguments of one call of :func:`ipopt_solver`'s function."""
    v_lo, v_hi, w_lo, w_hi = program.box
    rows = [x for row in (*program.hard, program.soft) for x in row]
    return {
        "x0": [0.0, 0.0, 0.0],
        "p": [*program.nominal, *program.weight, *rows],
        "lbx": [v_lo, w_lo, 0.0],
        "ubx": [v_hi, w_hi, math.inf],
        "lbg": -math.inf,
        "ubg": 0.0,
    }


def ipopt_route(programs: Sequence[Program], exact: Exact) -> Contestant:
    """The paper's CasADi and IPOPT."""
    solver = ipopt_solver(len(programs[0].hard))

    def call(job: dict[str, Any]) -> Any:
        return solver(**job)

    def read(answer: dict[str, Any]) -> Answer:
        x = answer["x"]
        return (float(x[0]), float(x[1])) if solver.stats()["success"] else None

    jobs = [ipopt_job(program) for program in programs]
    return Contestant("CasADi+IPOPT (paper)", "solve", call, jobs, read, exact)
