"""The paper's hard barrier row under acceleration limits, against random switches of the command.

The row wants more braking than the limits give: the program becomes infeasible, and nothing says
what to send then. The same attack meets the half-plane rows for comparison, at the same gain.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clfcbf.limits import Limits
from clfcbf.paper import HALF_ANGLE, PaperBarrier, PaperConfig, paper_command
from clfcbf.se2 import Pose2, Twist, arc
from clfcbf.simulation.scenarios import World, limits_named

__all__ = ["CELLS", "NAME", "TICKS", "cell_name", "run_paper"]

NAME = "paper barrier"

TICKS = 210
"""Length of a run, 7 s: about ten switches of the command."""

HELD = (5, 40)
"""Ticks from one switch to the next: up to what it takes to turn from limit to limit."""

CELLS: tuple[tuple[PaperBarrier, float, float, float], ...] = (
    *(
        ("paper", gain, a, alpha)
        for gain in (1.0, 2.0, 5.0)
        for a, alpha in ((0.3, 0.5), (0.3, 1.0), (1.0, 2.0))
    ),
    ("half_plane", 1.0, 0.3, 0.5),
    ("half_plane", 1.0, 0.3, 1.0),
)
"""Barrier, gain [1/s], and acceleration limits [m/s², rad/s²]."""

_NO_ERROR, _REST = Pose2(0.0, 0.0, 0.0), Twist(0.0, 0.0)
_PERIOD = World().period


def cell_name(cell: tuple[PaperBarrier, float, float, float]) -> str:
    """Such as "paper, lambda 1, a 0.3, alpha 0.5"."""
    barrier, gain, a, alpha = cell
    return f"{barrier.replace('_', '-')}, lambda {gain:g}, a {a:g}, alpha {alpha:g}"


def run_paper(seed: int, index: int) -> dict[str, Any]:
    """One start and one sequence of commands, for every cell.

    With no tracking error the Lyapunov row is empty, and with feedforward the program wants the
    adversary's command: the barrier alone is tested. An infeasible tick sends the paper
    controller's brake.
    """
    cells: dict[str, dict[str, float]] = {}
    totals = {"ticks": 0, "fov_violations": 0, "limit_violations": 0, "uncertified_ticks": 0}
    lost, lowest = 0, math.inf
    for cell in CELLS:
        # The same stream for each: they differ in the barrier and in the limits alone.
        ticks, infeasible, outside, over, margin = _run(cell, np.random.default_rng([seed, index]))
        totals["ticks"] += ticks
        totals["fov_violations"] += outside
        totals["limit_violations"] += over
        totals["uncertified_ticks"] += infeasible
        lost += outside > 0
        lowest = min(lowest, margin)
        cells[cell_name(cell)] = {
            "infeasible": float(infeasible > 0),
            "lost": float(outside > 0),
            "margin_deg": math.degrees(margin),
        }
    return {
        "set": NAME, "index": index, "strategy": "random switches", "episodes": len(CELLS),
        "lost": lost, **totals, "exceptions": 0, "margin_deg": math.degrees(lowest),
        "cells": cells,
    }  # fmt: skip


def _run(
    cell: tuple[PaperBarrier, float, float, float], rng: np.random.Generator
) -> tuple[int, int, int, int, float]:
    barrier, gain, a, alpha = cell
    config = PaperConfig(lam=gain, barrier=barrier, feedforward=True, per_step_acceleration=False)
    base = limits_named("approaching")
    limits = Limits(base.v_max, base.omega_max, a, alpha)
    rho, phi = float(rng.uniform(1.0, 2.5)), float(rng.uniform(-0.3, 0.3))
    point, applied, wanted = (rho * math.cos(phi), rho * math.sin(phi)), _REST, _REST
    ticks = infeasible = outside = over = switch = 0
    lowest = HALF_ANGLE - abs(phi)
    for tick in range(TICKS):
        if tick == switch:
            v = limits.v_max * float(rng.choice((-1.0, 0.0, 1.0)))
            wanted = Twist(v, limits.omega_max * float(rng.choice((-1.0, 1.0))))
            switch = tick + int(rng.integers(*HELD))
        got = paper_command(config, _NO_ERROR, wanted, point, applied, limits, _PERIOD)
        infeasible += not got.feasible
        over += not limits.input_box(applied, _PERIOD).contains(got.twist, 1e-9)
        applied = got.twist
        point = arc(applied, _PERIOD).seen(point)
        margin = HALF_ANGLE - abs(math.atan2(point[1], point[0]))
        outside += margin < 0.0
        lowest = min(lowest, margin)
        ticks += 1
    return ticks, infeasible, outside, over, lowest
