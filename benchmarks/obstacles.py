r"""The step with 0 to 1000 obstacle rows, their assembly included.

Discs that a point :math:`\ell` ahead of the robot's centre must not enter, one row each:

.. math:: h = d - r,\qquad
          \dot h = -\frac{p_x v + \ell\,p_y\,\omega}{d} \ge -\lambda h

with :math:`p` the disc's centre seen from that point and :math:`d = |p|` [Ames2019]_. Ours drops
the rows that cannot bind in the tick's input box, :func:`clfcbf.qp.pruning.prune`; the answer is
the same. The others get every row.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.routes import PENALTY, ipopt_solver
from benchmarks.stream import Program
from benchmarks.timing import Answer, Contestant
from clfcbf import Pose2
from clfcbf.qp.exact import paper_program
from clfcbf.qp.pruning import prune

__all__ = ["OBSTACLES", "obstacle_routes"]

OBSTACLES = (0, 10, 100, 1000)
RADIUS = 0.15
"""[m] Disc and robot together."""
LEVER = 0.1
"""[m] The point kept clear lies so far ahead of the rotation centre."""
GAIN = 1.5
"""[1/s] As the field of view's: one over the time to brake."""
AREA = 3.0
"""[m] Half the side of the square of discs around the robot."""
CLEAR = 0.02
"""[m] Nearest a disc is drawn, so that standing still is allowed."""

Array = NDArray[np.float64]


class Job(NamedTuple):
    """A program, the robot's pose, and the discs in the world as complex numbers, shape (N,)."""

    program: Program
    pose: Pose2
    at: NDArray[np.complex128]


def draw_jobs(programs: Sequence[Program], count: int, rng: np.random.Generator) -> list[Job]:
    """The same programs among ``count`` discs; those that the discs make infeasible left out."""
    jobs = []
    for program in programs:
        east, north, heading = rng.uniform((-1.0, -1.0, -math.pi), (1.0, 1.0, math.pi)).tolist()
        pose = Pose2(east, north, heading)
        ahead = pose.transform((LEVER, 0.0))
        near = RADIUS + CLEAR
        x, y = rng.uniform(-AREA, AREA, (2, 2 * count + 20))
        clear = np.flatnonzero(np.hypot(x, y) > near)[:count]
        job = Job(program, pose, complex(*ahead) + x[clear] + 1j * y[clear])
        if _ours(job).feasible:
            jobs.append(job)
    return jobs


def all_rows(job: Job) -> Array:
    """Rows of all discs, shape (N, 3), a column of them contiguous."""
    x, y, theta = job.pose
    c, s = math.cos(theta), math.sin(theta)
    columns = np.empty((3, job.at.size))
    seen = job.at - complex(x + LEVER * c, y + LEVER * s)
    seen *= complex(c, -s)
    d = np.abs(seen, out=columns[2])
    np.divide(seen.real, d, out=columns[0])
    np.divide(seen.imag, d, out=columns[1])
    columns[1] *= LEVER
    d -= RADIUS
    d *= GAIN
    return columns.T


def _ours(job: Job) -> Any:
    p = job.program
    hard = (*p.hard, *prune(p.box, all_rows(job))) if job.at.size else p.hard
    return paper_program(p.weight, p.nominal, p.box, hard, p.soft, PENALTY)


def _read_ours(answer: Any) -> Answer:
    return (answer.v, answer.omega) if answer.feasible else None


def obstacle_routes(
    programs: Sequence[Program], count: int, rng: np.random.Generator
) -> list[Contestant]:
    """Ours, DAQP and IPOPT with ``count`` obstacles; judged by ours, which is exact."""
    jobs = draw_jobs(programs, count, rng)
    exact = [(answer.v, answer.omega) for answer in map(_ours, jobs)]
    routes = [Contestant("exact", "solve", _ours, jobs, _read_ours, exact)]
    for make in (_daqp, _ipopt):
        try:
            routes.append(make(jobs, exact))
        except ImportError:
            continue  # the table of routes says what is missing
    return routes


def _daqp(jobs: Sequence[Job], exact: Sequence[tuple[float, float]]) -> Contestant:
    daqp = importlib.import_module("daqp")

    def call(job: Job) -> Any:
        p = job.program
        q11, q12, q22 = p.weight
        v_lo, v_hi, w_lo, w_hi = p.box
        G = np.zeros((len(p.hard) + job.at.size + 1, 3))
        top = np.empty(3 + len(G))
        top[:3] = v_hi, w_hi, 1e30
        own = np.array((*p.hard, p.soft))
        G[: len(own), :2], top[3 : 3 + len(own)] = own[:, :2], own[:, 2]
        G[len(own) - 1, 2] = -1.0
        if job.at.size:
            rows = all_rows(job)
            G[len(own) :, :2], top[3 + len(own) :] = rows[:, :2], rows[:, 2]
        low = np.full(len(top), -1e30)
        low[:3] = v_lo, w_lo, 0.0
        H = np.array(
            ((2.0 * q11, 2.0 * q12, 0.0), (2.0 * q12, 2.0 * q22, 0.0), (0.0, 0.0, 2.0 * PENALTY))
        )
        v, w = p.nominal
        f = np.array((-2.0 * (q11 * v + q12 * w), -2.0 * (q12 * v + q22 * w), 0.0))
        sense = np.zeros(len(top), dtype=np.int32)
        return daqp.solve(H, f, G, top, low, sense, primal_tol=1e-11)

    def read(answer: Any) -> Answer:
        x, _, flag, _ = answer
        return (float(x[0]), float(x[1])) if flag > 0 else None

    return Contestant("daqp", "solve", call, jobs, read, exact)


def _ipopt(jobs: Sequence[Job], exact: Sequence[tuple[float, float]]) -> Contestant:
    solver = ipopt_solver(len(jobs[0].program.hard) + jobs[0].at.size)

    def call(job: Job) -> Any:
        p = job.program
        v_lo, v_hi, w_lo, w_hi = p.box
        head = np.array((*p.nominal, *p.weight, *(x for row in p.hard for x in row)))
        rows = all_rows(job).ravel() if job.at.size else np.empty(0)
        numbers = np.concatenate((head, rows, p.soft))
        return solver(
            x0=(0.0, 0.0, 0.0), p=numbers, lbx=(v_lo, w_lo, 0.0), ubx=(v_hi, w_hi, math.inf),
            lbg=-math.inf, ubg=0.0,
        )  # fmt: skip

    def read(answer: Any) -> Answer:
        x = answer["x"]
        return (float(x[0]), float(x[1])) if solver.stats()["success"] else None

    return Contestant("CasADi+IPOPT (paper)", "solve", call, jobs, read, exact)
