"""What workspaces that keep their solver open have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clfcbf.qp.problem import Array
from clfcbf.qp.reduction import Form

__all__ = ["Loader", "finite_sides", "tighten"]


class Loader:
    """Hands a solver its first program by one call, and those after it by another.

    Parameters
    ----------
    setup : takes the first program
    update : takes the numbers of another one of the same shape; the same arguments
    """

    def __init__(self, setup: Callable[..., Any], update: Callable[..., Any]) -> None:
        self._load, self._update = setup, update

    def __call__(self, *numbers: Any, **named: Any) -> None:
        """Load a program."""
        self._load(*numbers, **named)
        self._load = self._update


def finite_sides(form: Form, far: float, start: int = 0) -> tuple[Array, Array]:
    """Both sides of the rows from ``start`` on, infinite ones at the solver's own infinity."""
    return np.maximum(form.lower[start:], -far), np.minimum(form.upper[start:], far)


def tighten(settings: Any, tolerance: float, infeasible: float) -> None:
    """Absolute tolerances, the duality gap's among them, of the proximal solvers.

    Parameters
    ----------
    settings : of PIQP or ProxQP, changed in place
    tolerance : on residuals and duality gap
    infeasible : on certificates of infeasibility, primal and dual
    """
    settings.verbose = False
    settings.eps_abs = tolerance
    settings.eps_rel = 0.0
    settings.check_duality_gap = True
    settings.eps_duality_gap_abs = tolerance
    settings.eps_duality_gap_rel = 0.0
    settings.eps_primal_inf = infeasible
    settings.eps_dual_inf = infeasible
