r"""The nonlinear program of the model-predictive rivals, built once in CasADi.

.. math::
    \min\ \|x_N\|_P^2 + \sum_k \|x_k\|_Q^2 + \|u_k\|_R^2 + \|u_k - u_{k-1}\|_D^2
        + w\,s_k \quad\text{s.t.}\quad
    x_{k+1} = f(x_k, u_k),\quad
    h(x_{k+1}) \ge (1 - \gamma)h(x_k) - s_k,\quad s_k \ge 0

in the robot's pose :math:`x` in the goal's frame, by multiple shooting, with the limits of speed
and of its change from step to step. :math:`h` are the camera's two edges as half-planes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.method import Setup
from benchmarks.baselines.nmpc_parameters import NmpcParameters, approach_cost
from clfcbf.constraints.cbf import camera_edges
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.laws.kanayama import sinc
from clfcbf.limits import InputBox
from clfcbf.se2 import Pose2, Twist

__all__ = ["Nmpc", "NmpcPlan"]

Array = NDArray[np.float64]
_SINC = (1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362880.0, -1.0 / 39916800.0)
"""Taylor's coefficients of sin(a)/a in a²: below 1e-12 for turns up to 1.4 rad a step."""

_LONGEST_TURN = 1.4
"""[rad] Turn in one step up to which the series is that good."""

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-6,
        "max_iter": 100,
        "warm_start_init_point": "yes",
        "mu_init": 1e-3,
        "warm_start_bound_push": 1e-6,
        "warm_start_mult_bound_push": 1e-6,
    },
}
"""1e-6 is micrometres here; 100 iterations, several times the usual number, bound a tick."""


class NmpcPlan(NamedTuple):
    """An answer: commands (N, 2), states (N + 1, 3) in the goal's frame, cost, and its status."""

    commands: Array
    states: Array
    cost: float
    solved: bool
    message: str


class Nmpc:
    """The program for one robot; :meth:`solve` starts from the answer before.

    ``durations`` are those of the steps [s].

    Raises
    ------
    MissingExtraError : CasADi is not installed
    ConfigurationError : a step is so long that the robot could turn by more than 1.4 rad in it
    """

    def __init__(self, setup: Setup, parameters: NmpcParameters) -> None:
        try:
            import casadi
        except ImportError as error:
            raise MissingExtraError("casadi", "solvers") from error
        if parameters.step * setup.limits.omega_max > _LONGEST_TURN:
            raise ConfigurationError(
                f"step must be at most {_LONGEST_TURN} rad / omega_max, got {parameters.step!r} s"
            )
        self.setup, self.parameters = setup, parameters
        n = parameters.steps
        first = setup.period if parameters.first_is_tick else parameters.step
        self.durations = (first, *(parameters.step,) * (n - 1))
        self._build(casadi)
        self._dual: tuple[Any, Any] | None = None
        self._commands: Array | None = None

    def _build(self, casadi: Any) -> None:
        setup, p, n = self.setup, self.parameters, self.parameters.steps
        limits = setup.limits
        edges = camera_edges(setup.camera.eroded(p.view_margin))
        start, before = casadi.SX.sym("x0", 3), casadi.SX.sym("u_", 2)
        U, X = casadi.SX.sym("u", 2, n), casadi.SX.sym("x", 3, n)
        S = casadi.SX.sym("s", n)
        cost: Any = 0.0
        rows: list[Any] = []
        lower: list[float] = []
        upper: list[float] = []
        state, last = start, before
        view = self._view(casadi, state, edges)
        for k, duration in enumerate(self.durations):
            u, after = U[:, k], X[:, k]
            change = u - last
            rows.append(after - self._moved(casadi, state, u, duration))
            lower += [0.0] * 3
            upper += [0.0] * 3
            if k:
                rows.append(change)
                dv, dw = limits.a_max * p.step, limits.alpha_max * p.step
                lower += [-dv, -dw]
                upper += [dv, dw]
            seen = self._view(casadi, after, edges)
            rows.append(seen - (1.0 - p.gamma) * view + S[k])
            lower += [0.0] * 2
            upper += [math.inf] * 2
            cost += duration * (p.r_v * u[0] ** 2 + p.r_omega * u[1] ** 2)
            cost += p.d_v * change[0] ** 2 + p.d_omega * change[1] ** 2 + p.slack * S[k]
            if k < n - 1:
                cost += duration * _square(after, p)
            state, last, view = after, u, seen
        cost += self._terminal(state)
        unknowns = casadi.vertcat(casadi.vec(U), casadi.vec(X), S)
        program = {
            "x": unknowns, "p": casadi.vertcat(start, before), "f": cost,
            "g": casadi.vertcat(*rows),
        }  # fmt: skip
        self._solver: Any = casadi.nlpsol("nmpc", "ipopt", program, _OPTIONS)
        self._rows = np.array(lower), np.array(upper)
        far = math.inf
        low = [limits.reverse_speed, -limits.omega_max] * n + [-far] * (3 * n) + [0.0] * n
        high = [limits.v_max, limits.omega_max] * n + [far] * (4 * n)
        self._bounds = np.array(low), np.array(high)

    def _moved(self, casadi: Any, state: Any, u: Any, duration: float) -> Any:
        """The state after one step of the model."""
        turn = u[1] * duration
        along, chord = state[2], u[0] * duration
        if self.parameters.model == "arc":
            half = 0.5 * turn
            square, series = half * half, 0.0
            for coefficient in reversed(_SINC):
                series = series * square + coefficient
            along, chord = along + half, chord * series
        return casadi.vertcat(
            state[0] + chord * casadi.cos(along),
            state[1] + chord * casadi.sin(along),
            state[2] + turn,
        )

    def _view(self, casadi: Any, state: Any, edges: Any) -> Any:
        """Distances of the feature from the camera's edges [m], positive inside."""
        c, s = casadi.cos(state[2]), casadi.sin(state[2])
        dx, dy = self.setup.standoff - state[0], -state[1]
        seen = c * dx + s * dy, c * dy - s * dx
        return casadi.vertcat(*(n_x * seen[0] + n_y * seen[1] - d for n_x, n_y, d in edges))

    def _terminal(self, state: Any) -> Any:
        p = self.parameters
        if p.terminal == "scaled":
            return p.p * _square(state, p)
        # The price of a metre at full speed: 1/v_max seconds, in which omega is v_max kappa.
        speed = self.setup.limits.v_max
        yy, cross, tt = approach_cost(p.q_y / speed, p.q_theta / speed, p.r_omega * speed)
        x, y, theta = state[0], state[1], state[2]
        return p.p * (p.q_x * x * x + yy * y * y + 2.0 * cross * y * theta + tt * theta * theta)

    def rolled_out(self, start: Pose2, commands: Array) -> Array:
        """States of the model from ``start`` under ``commands``, (N + 1, 3)."""
        states = [tuple(start)]
        for (v, omega), duration in zip(commands.tolist(), self.durations, strict=True):
            x, y, theta = states[-1]
            chord, turn = v * duration, omega * duration
            along = theta
            if self.parameters.model == "arc":
                along += 0.5 * turn
                chord *= sinc(0.5 * turn)
            states.append((x + chord * math.cos(along), y + chord * math.sin(along), theta + turn))
        return np.array(states)

    def solve(self, start: Pose2, applied: Twist, box: InputBox) -> NmpcPlan:
        """The plan from ``start`` in the goal's frame, with ``applied`` in force.

        ``box`` is the chassis's own, for a first step of one tick.
        """
        n, p = self.parameters.steps, self.parameters
        guess = self._commands
        if guess is None:
            guess = np.tile(np.array([0.5 * self.setup.limits.v_max, 0.0]), (n, 1))
        states = self.rolled_out(start, guess)
        low, high = self._bounds[0].copy(), self._bounds[1].copy()
        if not p.first_is_tick:
            box = self.setup.limits.input_box(applied, p.step)
        low[:2], high[:2] = (box.v_lo, box.w_lo), (box.v_hi, box.w_hi)
        unknowns = np.concatenate((guess.ravel(), states[1:].ravel(), np.zeros(n)))
        duals = {}
        if self._dual is not None:
            duals = {"lam_x0": self._dual[0], "lam_g0": self._dual[1]}
        answer = self._solver(
            x0=unknowns, p=np.array([*start, *applied]), lbx=low, ubx=high,
            lbg=self._rows[0], ubg=self._rows[1], **duals,
        )  # fmt: skip
        stats = self._solver.stats()
        found = np.array(answer["x"], dtype=np.float64).ravel()
        solved = bool(stats["success"]) and bool(np.isfinite(found).all())
        commands = found[: 2 * n].reshape(n, 2)
        if solved:
            self._commands, self._dual = commands, (answer["lam_x"], answer["lam_g"])
        else:
            self._commands = self._dual = None
        states = np.vstack((np.array(start), found[2 * n : 5 * n].reshape(n, 3)))
        return NmpcPlan(commands, states, float(answer["f"]), solved, str(stats["return_status"]))


def _square(state: Any, p: NmpcParameters) -> Any:
    return p.q_x * state[0] ** 2 + p.q_y * state[1] ** 2 + p.q_theta * state[2] ** 2
