r"""The time-optimal program of the floor, by direct multiple shooting in CasADi.

.. math::
    \min_{T, x, u}\ T + \varepsilon\int_0^T
        \frac{a^2}{a_{max}^2} + \frac{\alpha^2}{\alpha_{max}^2}\,dt
    \quad\text{s.t.}\quad
    \dot x = v\cos\theta,\ \dot y = v\sin\theta,\ \dot\theta = \omega,\
    \dot v = a,\ \dot\omega = \alpha

from rest at the start to rest at the goal, with the four limits, the feature between the
camera's two edges and the robot no further past the goal than the judge of the runs allows (or
than it starts). The accelerations are constant over each of N equal intervals, so speeds and
heading are exact polynomials and only the position needs a quadrature, three-point
Gauss-Legendre: what the program answers is a motion of the robot itself, not of a
discretisation, and its time an upper bound of the least one that N to infinity closes.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.cbf import camera_edges
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2
from clfcbf.simulation.judge import PAST_GOAL
from clfcbf.simulation.scenarios import World

__all__ = ["FloorProgram", "Motion", "floor_program"]

Array = NDArray[np.float64]

REGULARISATION = 1e-4
"""Price of the accelerations: makes the turning along a straight line unique, for 1e-4 of T."""

LONGEST = 120.0
"""[s] Twice the patience of a run: beyond it a start has no floor of interest."""

SHORTEST = 1e-2
"""[s] Keeps T positive in the search; the robot moves by micrometres in it."""

_GAUSS = tuple(0.5 + node * math.sqrt(0.15) for node in (-1.0, 0.0, 1.0))
_WEIGHTS = (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "expand": True,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-8, "max_iter": 500},
}
"""1e-8 m and s; a solve takes 15 to 40 iterations, and one that needs 500 is lost."""


class Motion(NamedTuple):
    """A motion of N intervals of equal duration.

    ``duration`` [s], ``states`` (N + 1, 5) as (x, y, theta, v, omega) in the goal's frame and
    ``accelerations`` (N, 2) as (a, alpha), constant in each interval.
    """

    duration: float
    states: Array
    accelerations: Array

    @property
    def times(self) -> Array:
        """Time of each state [s], shape (N + 1,)."""
        return np.linspace(0.0, self.duration, len(self.states))

    def resampled(self, intervals: int) -> Motion:
        """The same motion on another mesh, its states interpolated; a guess, not a solution."""
        old, new = self.times, np.linspace(0.0, self.duration, intervals + 1)
        states = np.column_stack([np.interp(new, old, column) for column in self.states.T])
        return Motion(self.duration, states, _slopes(states, self.duration))


def _slopes(states: Array, duration: float) -> Array:
    return np.diff(states[:, 3:], axis=0) * ((len(states) - 1) / duration)


class FloorProgram:
    """The program for one robot, world and mesh; starts and guesses are its arguments.

    Raises
    ------
    MissingExtraError : CasADi is not installed
    ConfigurationError : fewer than two intervals
    """

    def __init__(self, world: World, limits: Limits, intervals: int) -> None:
        try:
            import casadi
        except ImportError as error:
            raise MissingExtraError("casadi", "solvers") from error
        if intervals < 2:
            raise ConfigurationError(f"intervals must be at least 2, got {intervals!r}")
        self.intervals = n = intervals
        states, inputs = casadi.MX.sym("x", 5, n + 1), casadi.MX.sym("u", 2, n)
        duration = casadi.MX.sym("T")
        steps = casadi.repmat(duration / n, 1, n)
        gaps = states[:, 1:] - _interval(casadi).map(n)(states[:, :-1], inputs, steps)
        seen = _view(casadi, world).map(n - 1)(states[:, 1:-1])
        most = casadi.DM([limits.a_max, limits.alpha_max])
        effort = casadi.sumsqr(inputs / casadi.repmat(most, 1, n))
        program = {
            "x": casadi.vertcat(casadi.vec(states), casadi.vec(inputs), duration),
            "f": duration * (1.0 + REGULARISATION / n * effort),
            "g": casadi.vertcat(casadi.vec(gaps), casadi.vec(seen)),
        }
        self._solver: Any = casadi.nlpsol("floor", "ipopt", program, _OPTIONS)
        self._rows = np.zeros(5 * n + 2 * (n - 1)), np.zeros(5 * n + 2 * (n - 1))
        self._rows[1][5 * n :] = math.inf
        free = math.inf
        low = np.array([-free, -free, -free, limits.reverse_speed, -limits.omega_max])
        high = np.array([free, free, free, limits.v_max, limits.omega_max])
        self._speeds = np.tile(low, (n + 1, 1)), np.tile(high, (n + 1, 1))
        self._inputs = np.tile([limits.a_max, limits.alpha_max], (n, 1))

    def solve(self, start: Pose2, guess: Motion) -> Motion | None:
        """The local optimum that ``guess`` leads to; None where the solver finds none."""
        n, most = self.intervals, self._inputs
        if len(guess.states) != n + 1:
            guess = guess.resampled(n)
        low, high = self._speeds[0].copy(), self._speeds[1].copy()
        high[:, 0] = max(PAST_GOAL, start.x)
        low[0] = high[0] = (*start, 0.0, 0.0)
        low[-1] = high[-1] = 0.0
        accelerations = np.clip(guess.accelerations, -most, most)
        answer = self._solver(
            x0=np.concatenate((guess.states.ravel(), accelerations.ravel(), [guess.duration])),
            lbx=np.concatenate((low.ravel(), -most.ravel(), [SHORTEST])),
            ubx=np.concatenate((high.ravel(), most.ravel(), [LONGEST])),
            lbg=self._rows[0],
            ubg=self._rows[1],
        )
        found = np.array(answer["x"], dtype=np.float64).ravel()
        if not (self._solver.stats()["success"] and np.isfinite(found).all()):
            return None
        split = 5 * (n + 1)
        return Motion(
            float(found[-1]), found[:split].reshape(-1, 5), found[split:-1].reshape(-1, 2)
        )


@lru_cache(maxsize=16)
def floor_program(world: World, limits: Limits, intervals: int) -> FloorProgram:
    """The program of that robot and mesh, built once; building takes as long as a few solves."""
    return FloorProgram(world, limits, intervals)


def _interval(casadi: Any) -> Any:
    """State at the end of an interval, from that at its beginning, the inputs and its duration."""
    state, u, h = casadi.SX.sym("x", 5), casadi.SX.sym("u", 2), casadi.SX.sym("h")
    x, y, theta, v, omega = (state[i] for i in range(5))
    for node, weight in zip(_GAUSS, _WEIGHTS, strict=True):
        t = node * h
        heading = theta + t * (omega + 0.5 * t * u[1])
        way = weight * h * (v + t * u[0])
        x += way * casadi.cos(heading)
        y += way * casadi.sin(heading)
    end = casadi.vertcat(x, y, theta + h * (omega + 0.5 * h * u[1]), v + h * u[0], omega + h * u[1])
    return casadi.Function("interval", [state, u, h], [end])


def _view(casadi: Any, world: World) -> Any:
    """Distances of the feature from the camera's edges [m], positive inside."""
    state = casadi.SX.sym("x", 5)
    c, s = casadi.cos(state[2]), casadi.sin(state[2])
    dx, dy = world.feature.x - state[0], world.feature.y - state[1]
    seen = c * dx + s * dy, c * dy - s * dx
    edges = camera_edges(world.camera)
    inside = casadi.vertcat(*(n_x * seen[0] + n_y * seen[1] - d for n_x, n_y, d in edges))
    return casadi.Function("view", [state], [inside])
