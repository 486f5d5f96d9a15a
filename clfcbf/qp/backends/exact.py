r"""The exact geometry as a backend: two variables, P positive definite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clfcbf.errors import BackendError, ConfigurationError
from clfcbf.qp.backends import Capability
from clfcbf.qp.kkt import multipliers
from clfcbf.qp.lexicographic import Box, Row, Weight, check_weight, solve_lexicographic
from clfcbf.qp.problem import QpSolution, QpStatus, QuadraticProgram

__all__ = ["ExactBackend", "create", "installed", "names"]


_SINGULAR = 1e-13
"""Determinant, relative to the product of the diagonal, that leaves the minimum no digits."""


@dataclass(frozen=True, slots=True)
class ExactBackend:
    """:func:`clfcbf.qp.exact.solve_lexicographic` with one level that must not be relaxed."""

    @property
    def name(self) -> str:
        """``"exact"``."""
        return "exact"

    @property
    def capability(self) -> Capability:
        """Two variables, P positive definite."""
        return Capability(max_variables=2, semidefinite=False, time_limit=True)

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> QpSolution:
        """Solve a well-posed program, in microseconds whatever the time limit.

        Raises
        ------
        BackendError : not two variables, or P is not positive definite
        """
        if problem.n != 2:
            raise BackendError(f"'exact' takes 2 variables, got {problem.n}; use 'daqp'")
        (q11, q12), (_, q22) = problem.P.tolist()
        try:
            weight = check_weight((q11, q12, q22))
        except ConfigurationError as error:
            raise BackendError(
                f"'exact' needs P positive definite; use 'daqp' ({error})"
            ) from error
        # The unconstrained minimum, -P^-1 q, plays the nominal command.
        c, d = problem.q.tolist()
        det = q11 * q22 - q12 * q12
        if not det > _SINGULAR * q11 * q22:
            raise BackendError(f"'exact' needs P positive definite, got determinant {det!r}")
        nominal = ((q12 * d - q22 * c) / det, (q12 * c - q11 * d) / det)
        rows = [
            (a_v, a_w, b)
            for (a_v, a_w), b in zip(problem.G.tolist(), problem.h.tolist(), strict=True)
            if b < math.inf
        ]
        finite = len(rows)
        for (a_v, a_w), b in zip(problem.A.tolist(), problem.b.tolist(), strict=True):
            rows += [(a_v, a_w, b), (-a_v, -a_w, -b)]
        box = _finite_box(problem, weight, nominal, rows)
        answer = solve_lexicographic(weight, nominal, box, (rows,))
        if answer is None:
            return QpSolution(None, QpStatus.NUMERICAL_ERROR, self.name, message="overflow")
        if answer.relaxed:
            message = f"no point satisfies the rows; least violation {max(answer.slacks)!r}"
            return QpSolution(None, QpStatus.INFEASIBLE, self.name, message=message)
        found = multipliers(weight, nominal, box, (rows,), answer)
        dual = np.zeros(problem.m)
        dual[problem.h < math.inf] = found.rows[:finite]
        pairs = np.array(found.rows[finite:]).reshape(-1, 2)
        lower_v, upper_v, lower_w, upper_w = found.box
        bounds = np.array((upper_v - lower_v, upper_w - lower_w))
        x = np.array((answer.v, answer.omega))
        return QpSolution(
            x,
            QpStatus.OPTIMAL,
            self.name,
            dual,
            bounds,
            dual_equalities=pairs[:, 0] - pairs[:, 1],
        )


def _finite_box(
    problem: QuadraticProgram, weight: Weight, nominal: tuple[float, float], rows: list[Row]
) -> Box:
    """The bounds, those at infinity replaced by ones too far out to matter.

    The minimum, and some feasible point if there is one, lie at the nominal command, at a point
    of some line (or side) next to it, or where two lines meet; all of these stay inside.
    """
    (lo_v, lo_w), (hi_v, hi_w) = problem.lb.tolist(), problem.ub.tolist()
    if max(-lo_v, -lo_w, hi_v, hi_w) < math.inf:
        return lo_v, hi_v, lo_w, hi_w
    sides = [(-1.0, 0.0, -lo_v), (1.0, 0.0, hi_v), (0.0, -1.0, -lo_w), (0.0, 1.0, hi_w)]
    lines = [line for line in (*rows, *sides) if abs(line[2]) < math.inf and (line[0] or line[1])]
    q11, q12, q22 = weight
    far = max(abs(nominal[0]), abs(nominal[1]))
    for k, (a, c, b) in enumerate(lines):
        g, f = q22 * a - q12 * c, q11 * c - q12 * a
        for x, y in ((a, c), (g, f)):
            t = (b - a * nominal[0] - c * nominal[1]) / (a * x + c * y)
            far = max(far, abs(nominal[0] + t * x), abs(nominal[1] + t * y))
        for a_2, c_2, b_2 in lines[:k]:
            det = a * c_2 - c * a_2
            if det:
                far = max(far, abs((b * c_2 - c * b_2) / det), abs((a * b_2 - b * a_2) / det))
    far = 2.0 * far + 1.0
    return max(lo_v, -far), min(hi_v, far), max(lo_w, -far), min(hi_w, far)


def names() -> tuple[str, ...]:
    """The one name."""
    return ("exact",)


def installed() -> tuple[str, ...]:
    """Always there."""
    return names()


def create(name: str) -> ExactBackend:
    """The backend; ``name`` is one of :func:`names`."""
    return ExactBackend()
