r"""The one-shot program with a quadratic slack through any backend, in three variables.

.. math:: \min_{u,\delta}\ (u-u_{ref})^\top Q (u-u_{ref}) + c\,\delta^2
          \quad\text{s.t.}\quad u \in \text{box},\quad A u \le b_h,\quad
          a^\top u - b \le \delta,\quad \delta \ge 0

as [Xie2024]_ hands it to a solver. :func:`clfcbf.qp.exact.paper_program` is the same program with
the slack eliminated; it is what a backend's answer is held against here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from clfcbf.qp.backends import Backend, get_backend
from clfcbf.qp.ladder import ask
from clfcbf.qp.lexicographic import BackendHealth, Box, Row, Weight, solve_lexicographic
from clfcbf.qp.one_shot import paper_program
from clfcbf.qp.problem import QuadraticProgram

__all__ = ["OneShotSolution", "one_shot_problem", "solve_one_shot"]


class OneShotSolution(NamedTuple):
    r"""Answer of :func:`solve_one_shot`.

    Attributes
    ----------
    v, omega, delta, feasible : as of :class:`clfcbf.qp.exact.PaperSolution`
    health : of the backend, where one other than the exact geometry was asked
    """

    v: float
    omega: float
    delta: float
    feasible: bool
    health: BackendHealth | None = None


def one_shot_problem(
    weight: Weight,
    reference: tuple[float, float],
    box: Box,
    hard: Sequence[Row],
    soft: Row,
    penalty: float,
) -> QuadraticProgram:
    r"""The program in :math:`z = (v, \omega, \delta)`, arguments as of :func:`solve_one_shot`."""
    q11, q12, q22 = weight
    v, omega = reference
    return QuadraticProgram(
        ((2.0 * q11, 2.0 * q12, 0.0), (2.0 * q12, 2.0 * q22, 0.0), (0.0, 0.0, 2.0 * penalty)),
        (-2.0 * (q11 * v + q12 * omega), -2.0 * (q12 * v + q22 * omega), 0.0),
        [*((a, c, 0.0) for a, c, _ in hard), (soft[0], soft[1], -1.0)],
        [*(b for _, _, b in hard), soft[2]],
        (box[0], box[2], 0.0),
        (box[1], box[3], float("inf")),
    )


def solve_one_shot(
    weight: Weight,
    reference: tuple[float, float],
    box: Box,
    hard: Sequence[Row],
    soft: Row,
    penalty: float,
    backend: str | Backend = "exact",
) -> OneShotSolution:
    r"""As :func:`clfcbf.qp.exact.paper_program`, by ``backend``.

    Parameters
    ----------
    weight : ``(q11, q12, q22)``, positive definite
    reference : :math:`u_{ref}` [m/s], [rad/s]
    box : ``(v_lo, v_hi, w_lo, w_hi)``
    hard : rows ``(a_v, a_w, b)`` that say ``a_v v + a_w omega <= b``
    soft : the row that :math:`\delta` relaxes
    penalty : :math:`c > 0`, finite
    backend : one of :func:`clfcbf.available_backends`, or a :class:`Backend`

    Returns
    -------
    The solution. The backend's command is taken where it agrees with the exact one, moved onto
    box and hard rows to the last bit; ``health`` tells. A program without a feasible point, or
    without finite data, is not put to a backend.

    Raises
    ------
    ConfigurationError : the penalty is not finite and positive
    BackendError : no backend has that name
    MissingExtraError : the backend's package is not installed
    """
    exact = OneShotSolution(*paper_program(weight, reference, box, hard, soft, penalty))
    if backend == "exact" or not exact.feasible:
        return exact
    problem = one_shot_problem(weight, reference, box, hard, soft, penalty)
    point, health = ask(get_backend(backend), problem, (exact.v, exact.omega))
    if point is None:
        return exact._replace(health=health)
    admitted = solve_lexicographic(weight, point, box, (hard,))
    if admitted is None or admitted.relaxed:
        return exact._replace(health=health._replace(used=False))
    v, omega = admitted.v, admitted.omega
    delta = max(0.0, soft[0] * v + soft[1] * omega - soft[2])
    return OneShotSolution(v, omega, delta, True, health)
