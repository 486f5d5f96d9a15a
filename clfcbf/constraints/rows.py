"""The typed block of rows that every constraint builder returns."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Priority", "Row", "Rows"]

Row = tuple[float, float, float]
"""``(a_v, a_omega, b)``, the half-plane ``a_v v + a_omega omega <= b`` of commands."""


class Priority(IntEnum):
    """Order in which rows are given up, the largest first; limits never are."""

    LIMITS = 0
    SAFETY = 10
    STABILITY = 20


class Rows(NamedTuple):
    r"""Named half-planes :math:`A u \le b` on the command :math:`u = (v, \omega)`.

    Attributes
    ----------
    names : one name a row, such as ``"fov.left"``
    coefficients : one ``(a_v, a_omega, b)`` a row, plain floats for the tick's sake
    priority : level in the order limits, safety, stability; smaller is kept longer
    values : the barrier or Lyapunov function of each row at the present state
    """

    names: tuple[str, ...]
    coefficients: tuple[Row, ...]
    priority: int
    values: tuple[float, ...]

    @property
    def A(self) -> NDArray[np.float64]:
        """Left-hand sides, shape (m, 2)."""
        return np.array([row[:2] for row in self.coefficients], dtype=float).reshape(-1, 2)

    @property
    def b(self) -> NDArray[np.float64]:
        """Right-hand sides, shape (m,)."""
        return np.array([row[2] for row in self.coefficients], dtype=float)
