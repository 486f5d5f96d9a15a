r"""The lexicographic program through any backend, and which of its levels may give way.

The slacks of the levels are geometry and always exact; the last step, the projection of the
nominal command onto what the levels leave, is a strictly convex quadratic program that a named
backend may solve. Its answer is checked against the exact one and against the relaxed rows, and
the exact one takes its place where it fails.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from clfcbf.qp.backends import Backend, get_backend
from clfcbf.qp.lexicographic import (
    BackendHealth,
    Box,
    Level,
    LexicographicSolution,
    Weight,
    solve_lexicographic,
)
from clfcbf.qp.problem import QpStatus, QuadraticProgram
from clfcbf.qp.pruning import MANY, prune, solve_many

__all__ = ["AGREEMENT", "ask", "solve_ladder"]

AGREEMENT = 1e-6
"""Largest distance to the exact command [m/s, rad/s]: under what a drive can resolve."""


def solve_ladder(
    weight: Weight,
    nominal: tuple[float, float],
    box: Box,
    levels: Sequence[Level],
    backend: str | Backend = "exact",
) -> LexicographicSolution | None:
    """As :func:`clfcbf.qp.exact.solve_lexicographic`, its last step by ``backend``.

    Parameters
    ----------
    weight, nominal, box, levels : see there
    backend : one of :func:`clfcbf.available_backends`, or a :class:`Backend`

    Returns
    -------
    The solution; with a backend other than ``"exact"`` its ``health`` says whether the
    backend's answer was taken and why not. None where the data is not finite.

    Raises
    ------
    BackendError : no backend has that name
    MissingExtraError : the backend's package is not installed
    """
    count = 0
    for rows in levels:
        count += len(rows)
    many = count > MANY
    exact = (solve_many if many else solve_lexicographic)(weight, nominal, box, levels)
    if exact is None or backend == "exact":
        return exact
    if many:
        levels = [prune(box, rows) for rows in levels]
    problem = _last_program(weight, nominal, box, levels, exact)
    point, health = ask(get_backend(backend), problem, (exact.v, exact.omega))
    if point is None:
        return exact._replace(health=health)
    # The backend's tolerance must not become the limits' and the barriers': its point moves to
    # the nearest one that box and relaxed rows admit, to the last bit.
    admitted = solve_lexicographic(weight, point, box, levels)
    if admitted is None:
        return exact._replace(health=health._replace(used=False))
    return exact._replace(v=admitted.v, omega=admitted.omega, health=health)


def ask(
    solver: Backend, problem: QuadraticProgram, exact: tuple[float, float]
) -> tuple[tuple[float, float] | None, BackendHealth]:
    """A backend's command for ``problem`` if it is the exact one to :data:`AGREEMENT`.

    Whatever the backend does, an exception and an answer of no known kind included, is told in
    the health. The command is made of the first two variables.
    """
    try:
        name = str(solver.name)
        claim = solver.solve(problem)
        status, note = QpStatus(claim.status), str(claim.message)
        if claim.x is None or not status.found:
            return None, BackendHealth(name, False, status.value, math.inf, note)
        if claim.x.shape != (problem.n,):
            note = f"answer of shape {claim.x.shape}, expected {(problem.n,)}"
            return None, BackendHealth(name, False, status.value, math.inf, note, True)
        v, omega = (float(number) for number in claim.x[:2])
        distance = math.hypot(v - exact[0], omega - exact[1])
    except Exception as error:  # solvers raise what they please; the exact answer is at hand
        name = str(getattr(solver, "name", type(solver).__name__))
        note = f"{type(error).__name__}: {error}"
        return None, BackendHealth(name, False, QpStatus.NUMERICAL_ERROR.value, math.inf, note)
    if distance <= AGREEMENT:
        return (v, omega), BackendHealth(name, True, status.value, distance, note)
    note = f"({v!r}, {omega!r}) is not within {AGREEMENT!r} of the exact answer"
    far = distance if distance < math.inf else math.inf  # NaN becomes infinity
    return None, BackendHealth(name, False, status.value, far, note, True)


def _last_program(
    weight: Weight,
    nominal: tuple[float, float],
    box: Box,
    levels: Sequence[Level],
    exact: LexicographicSolution,
) -> QuadraticProgram:
    """The projection onto the rows as the levels' slacks leave them."""
    q11, q12, q22 = weight
    rows = [
        (a, c, b + slack * math.hypot(a, c))
        for level, slack in zip(levels, exact.slacks, strict=True)
        for a, c, b in level
        if a or c
    ]
    v, omega = nominal
    return QuadraticProgram(
        ((q11, q12), (q12, q22)),
        (-q11 * v - q12 * omega, -q12 * v - q22 * omega),
        [row[:2] for row in rows] or None,
        [row[2] for row in rows] or None,
        (box[0], box[2]),
        (box[1], box[3]),
    )
