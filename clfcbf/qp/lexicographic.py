r"""The safe command nearest to the nominal one, exactly: two inputs, levels of rows.

.. math:: \min_u\ \tfrac12 (u-\bar u)^\top Q (u-\bar u)
          \quad\text{s.t.}\quad u \in \text{box},\quad a_i^\top u \le b_i + s_{\ell(i)}|a_i|

with :math:`u = (v, \omega)` and the slack of every level as small as the more important levels
allow, :math:`s_\ell = \min_u \max_{i\in\ell} (a_i^\top u - b_i)^+/|a_i|` (lexicographic
optimisation, [Kerrigan2002]_). Rows enter with unit length and a level has one slack,
so scaling, reordering, repeating or adding inactive rows changes nothing but the last bits.

Plain floats on the way that every tick takes. Where they could not be trusted to 1e-12 (nearly
parallel rows, sets empty or thin to rounding, badly scaled weights), or a level that cannot hold
leaves more than one command, the same geometry runs on fractions, which takes a fraction of a
millisecond and rounds nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.qp.least_violation import relax_to_corner
from clfcbf.qp.objective import Objective
from clfcbf.qp.polygon import Delicate
from clfcbf.qp.projection import project
from clfcbf.qp.rational import solve_rational
from clfcbf.qp.segment import project_on_segment

__all__ = [
    "BackendHealth",
    "Box",
    "Level",
    "LexicographicSolution",
    "Row",
    "Weight",
    "check_weight",
    "minimise",
    "solve_lexicographic",
]

_new = tuple.__new__  # makes a named tuple in half the time of its own constructor

Row = tuple[float, float, float]
Level = Sequence[Row]
Weight = tuple[float, float, float]
Box = tuple[float, float, float, float]


class BackendHealth(NamedTuple):
    """What a backend's answer to the last step was worth.

    Attributes
    ----------
    backend : its name
    used : whether its answer was taken; the exact one was otherwise
    status : what it claimed
    distance : largest difference to the exact command; infinite without an answer
    note : why its answer was not taken, or what the backend said
    refused : whether it gave an answer, and a wrong one
    """

    backend: str
    used: bool
    status: str
    distance: float
    note: str
    refused: bool = False


class LexicographicSolution(NamedTuple):
    """The command, and what had to be given up for it.

    Attributes
    ----------
    v, omega : the command [m/s], [rad/s]; inside the box to the last bit
    slacks : one a level, the distance by which its rows had to move [units of the command]
    violated : indices, counted through all levels, of rows ``(0, 0, b)`` with ``b < 0``, which
        no command can satisfy and which therefore influence none
    rational : whether fractions were needed
    health : of the backend, where one other than the exact geometry took the last step
    """

    v: float
    omega: float
    slacks: tuple[float, ...]
    violated: tuple[int, ...] = ()
    rational: bool = False
    health: BackendHealth | None = None

    @property
    def relaxed(self) -> bool:
        """Whether some row does not hold as it was given."""
        return bool(self.violated) or any(self.slacks)


def check_weight(weight: Sequence[float]) -> Weight:
    r"""Return ``(q11, q12, q22)`` as floats if :math:`Q` is positive definite.

    Raises
    ------
    ConfigurationError : not three finite numbers with ``q11 > 0`` and ``q11 q22 > q12**2``
    """
    entries = tuple(float(q) for q in weight)
    if len(entries) == 3 and all(map(math.isfinite, entries)):
        q11, q12, q22 = entries
        if q11 > 0.0 and q22 > 0.0 and abs(q12) < math.sqrt(q11) * math.sqrt(q22):
            return q11, q12, q22
    raise ConfigurationError(
        f"weight must be (q11, q12, q22), finite, with q11 > 0 and q11*q22 > q12**2, got {weight!r}"
    )


def solve_lexicographic(
    weight: Weight, nominal: tuple[float, float], box: Box, levels: Sequence[Level]
) -> LexicographicSolution | None:
    """The command nearest to ``nominal`` that gives up as little as it must, in order.

    Parameters
    ----------
    weight : ``(q11, q12, q22)``, positive definite (see :func:`check_weight`; not checked here)
    nominal : ``(v, omega)`` [m/s], [rad/s]
    box : ``(v_lo, v_hi, w_lo, w_hi)``; equal ends are allowed
    levels : rows ``(a_v, a_w, b)`` that say ``a_v v + a_w omega <= b``, in levels, the most
        important level first; never relaxed before a less important one is

    Returns
    -------
    The solution, or None where a number is not finite (or overflows) or the box is reversed
    """
    n_v, n_w = nominal
    v_lo, v_hi, w_lo, w_hi = box
    total = n_v + n_w + v_lo + v_hi + w_lo + w_hi
    holds = v_lo <= n_v <= v_hi and w_lo <= n_w <= w_hi
    violated: tuple[int, ...] = ()
    index = 0
    for rows in levels:
        for a_v, a_w, b in rows:
            residual = a_v * n_v + a_w * n_w - b
            total += residual
            if residual > 0.0:
                if a_v or a_w:
                    holds = False
                else:
                    violated += (index,)
            index += 1
    if total - total != 0.0:  # NaN and infinity alike
        return None
    if holds:
        return _new(LexicographicSolution, (n_v, n_w, (0.0,) * len(levels), violated, False, None))
    if v_lo > v_hi or w_lo > w_hi:
        return None
    q11, q12, q22 = weight
    objective = (q11, q12, q22, n_v, n_w, 0.0, 0.0, 0.0, 0.0)
    return minimise(objective, box, levels, violated)


def minimise(
    objective: Objective[float],
    box: Box,
    levels: Sequence[Level],
    violated: tuple[int, ...] = (),
) -> LexicographicSolution:
    """:func:`solve_lexicographic` for any :class:`Objective`, on data known to be finite."""
    v_lo, v_hi, w_lo, w_hi = box
    try:
        flat = v_lo == v_hi or w_lo == w_hi
        found = (project_on_segment if flat else project)(objective, box, levels)
        if isinstance(found, tuple):
            v, omega = found
            return _new(
                LexicographicSolution, (v, omega, (0.0,) * len(levels), violated, False, None)
            )
        v, omega, slacks = relax_to_corner(box, levels, found)
        return _new(LexicographicSolution, (v, omega, slacks, violated, False, None))
    except Delicate:
        v, omega, slacks = solve_rational(objective, box, levels)
        return LexicographicSolution(v, omega, slacks, violated, True)
