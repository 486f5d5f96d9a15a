r"""Weights of a quadratic Lyapunov function from the linear-quadratic regulator.

Along a reference of constant twist the tracking error obeys, to first order,
:math:`\dot x = Ax + B\tilde u` with :math:`\tilde u` the command less the feedforward,

.. math::
    A = \begin{pmatrix}0 & \omega_V & 0\\ -\omega_V & 0 & v_V\\ 0 & 0 & 0\end{pmatrix},\qquad
    B = \begin{pmatrix}-1 & 0\\ 0 & 0\\ 0 & -1\end{pmatrix} .

The solution :math:`P` of the Riccati equation
:math:`A^\top P + PA - PBR^{-1}B^\top P + Q = 0` gives :math:`V = \tfrac12x^\top Px` and the
decrease :math:`\dot V = -\tfrac12x^\top(Q + K^\top RK)x` under its own law
[AndersonMoore1990]_. Its cross terms between lateral error and heading are what a diagonal
weight lacks: with them the row can be met where the error is lateral alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.checks import check_positive
from clfcbf.constraints.weights import Vector, check_weights
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.se2 import Twist

__all__ = ["DECAY_SHARE", "EFFORT_COST", "ERROR_COST", "LqrWeights", "linearised", "lqr_weights"]

ERROR_COST = (4.0, 25.0, 1.0)
"""[1/m², 1/m², 1/rad²] Errors of 0.5 m, 0.2 m and 1 rad cost the same: the lateral one is what
a docking robot can correct last."""

EFFORT_COST = (4.0, 1.0)
"""[s²/m², s²/rad²] Corrections of 0.5 m/s and 1 rad/s cost the same as those errors."""

DECAY_SHARE = 0.5
"""Share of the linear decay that is asked for: half is left to what linearising leaves out."""

Matrix = tuple[Vector, Vector, Vector]


class LqrWeights(NamedTuple):
    r"""What ``quadratic_clf(error, reference, weights, decay)`` takes.

    Attributes
    ----------
    weights : :math:`P` by rows, symmetric positive definite
    decay : :math:`\mu` [1/s], a share of the largest with :math:`Q + K^\top RK \ge \mu P`
    gain : :math:`K`, two rows; the law itself is :math:`u = u_V - Kx`
    """

    weights: Matrix
    decay: float
    gain: tuple[Vector, Vector]


def linearised(reference: Twist) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Matrices A (3, 3) and B (3, 2) of the tracking error along a reference twist."""
    v, omega = reference
    a = np.array([[0.0, omega, 0.0], [-omega, 0.0, v], [0.0, 0.0, 0.0]])
    b = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, -1.0]])
    return a, b


def lqr_weights(
    reference: Twist,
    error_cost: Vector = ERROR_COST,
    effort_cost: tuple[float, float] = EFFORT_COST,
    share: float = DECAY_SHARE,
) -> LqrWeights:
    r"""Weights and decay of a quadratic Lyapunov row along a reference.

    Near the reference the regulator's law itself meets the row, so limits alone force a slack;
    how near depends on ``share``. Take one set for each speed (and direction) of a plan.

    Parameters
    ----------
    reference : twist of the virtual target; one that turns or drives
    error_cost, effort_cost : diagonals of :math:`Q` and :math:`R`, positive
    share : of the linear decay, in (0, 1]

    Raises
    ------
    MissingExtraError : the ``control`` package is not installed
    ConfigurationError : a cost is not positive, the share not in (0, 1], or the reference
        stands still, where a lateral error cannot be controlled
    """
    for name, cost in (("error_cost", error_cost), ("effort_cost", effort_cost)):
        for value in cost:
            check_positive(name, value)
    if not 0.0 < share <= 1.0:
        raise ConfigurationError(f"share must be in (0, 1], got {share!r}")
    v, omega = reference
    if not (math.isfinite(v) and math.isfinite(omega) and (v or omega)):
        raise ConfigurationError(
            f"the reference must be finite and not at rest, where a lateral error cannot be "
            f"controlled: got {reference!r}"
        )
    try:
        import control
    except ImportError as error:
        raise MissingExtraError("control", "control") from error
    a, b = linearised(reference)
    q, r = np.diag(error_cost), np.diag(effort_cost)
    gain, p, _ = control.lqr(a, b, q, r)
    p = 0.5 * (p + p.T)
    # The largest mu with Q + K'RK >= mu P, by the Cholesky factor of P.
    factor = np.linalg.inv(np.linalg.cholesky(p))
    decay = float(np.linalg.eigvalsh(factor @ (q + gain.T @ r @ gain) @ factor.T)[0])
    rows = p.tolist()
    weights: Matrix = (tuple(rows[0]), tuple(rows[1]), tuple(rows[2]))
    check_weights(weights)
    first, second = (tuple(row) for row in np.asarray(gain).tolist())
    return LqrWeights(weights, share * decay, (first, second))
