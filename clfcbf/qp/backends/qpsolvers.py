"""Whatever qpsolvers [Caron2022]_ finds, as ``qpsolvers:<name>``: a generic door.

qpsolvers is LGPL-3 and tells no more than whether its solver found an answer. Its first use
imports every solver that is installed, JAX included, and takes up to a second.
"""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np

from clfcbf.errors import BackendError, MissingExtraError
from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import (
    Claim,
    SolverBackend,
    is_installed,
    require,
    undisturbed,
)
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TIGHT = 1e-9
"""Tolerance asked of those solvers that have one, as of the same solvers without the door."""

_Options = dict[str, Any]

_SOLVERS: dict[str, tuple[str, str, _Options]] = {
    "clarabel": (
        "clarabel",
        "Apache-2.0",
        {"tol_gap_abs": _TIGHT, "tol_gap_rel": _TIGHT, "tol_feas": _TIGHT},
    ),
    "cvxopt": ("cvxopt", "GPL-3.0-or-later", {"abstol": _TIGHT, "feastol": _TIGHT}),
    "daqp": ("daqp", "MIT", {"primal_tol": 1e-11}),
    "ecos": ("ecos", "GPL-3.0-only", {}),
    "highs": ("highspy", "MIT", {}),
    "osqp": (
        "osqp",
        "Apache-2.0",
        {"eps_abs": _TIGHT, "eps_rel": 0.0, "eps_prim_inf": 1e-8, "eps_dual_inf": 1e-8},
    ),
    "piqp": ("piqp", "BSD-2-Clause", {"eps_abs": _TIGHT, "eps_rel": 0.0}),
    "proxqp": (
        "proxsuite",
        "BSD-2-Clause",
        {
            "eps_abs": _TIGHT,
            "eps_rel": 0.0,
            "check_duality_gap": True,
            "eps_duality_gap_abs": _TIGHT,
            "eps_duality_gap_rel": 0.0,
        },
    ),
    "pyqpmad": ("pyqpmad", "BSD-3-Clause", {}),
    "qpalm": ("qpalm", "LGPL-3.0-or-later", {"eps_abs": _TIGHT, "eps_rel": 0.0}),
    "quadprog": ("quadprog", "GPL-2.0-or-later", {}),
    "scs": ("scs", "MIT", {"eps_abs": _TIGHT, "eps_rel": 0.0}),
}
"""Module, licence and options of the solvers that were measured to agree with 'exact'. Others are
made when asked for by name and not listed: qpax and jaxopt_osqp take half a second a solve."""

_DIRECT = frozenset({"daqp", "pyqpmad", "quadprog"})
"""The active-set methods among them."""

_DEFINITE = frozenset({"pyqpmad", "quadprog"})
"""Those that factorise P."""


class _Workspace:
    """Nothing to keep: qpsolvers sets its solver up at every call."""

    def __init__(self, solver: str, options: _Options, form: Form) -> None:
        self._solver, self._options = solver, options

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        with undisturbed():
            import qpsolvers
            from scipy import sparse

        matrix = sparse.csc_matrix if self._solver in qpsolvers.sparse_solvers else np.array
        G, h = form.one_sided()
        equal = form.equal
        rows = (matrix(G), h) if h.size else (None, None)
        equalities = (matrix(form.C[:equal]), form.lower[:equal]) if equal else (None, None)
        problem = qpsolvers.Problem(matrix(form.P), form.q, *rows, *equalities)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its solvers' deprecations, which are not ours
            answer = qpsolvers.solve_problem(problem, solver=self._solver, **self._options)
        # Its ``x`` may be filled though nothing was found.
        status = QpStatus.OPTIMAL if answer.found else QpStatus.NUMERICAL_ERROR
        message = f"found: {answer.found}"
        if answer.x is None:
            return Claim(status, message=message)
        dual = None
        y = np.zeros(0) if answer.y is None else np.asarray(answer.y)
        z = np.zeros(0) if answer.z is None else np.asarray(answer.z)
        if y.size == equal and z.size == h.size:
            dual = form.two_sided_dual(y, z)
        return Claim(status, np.array(answer.x), dual, message)


def names() -> tuple[str, ...]:
    """Those that were measured."""
    return tuple(f"qpsolvers:{solver}" for solver in _SOLVERS)


def installed() -> tuple[str, ...]:
    """Those of them that are installed; a module is looked for, not imported."""
    if not (is_installed("qpsolvers") and is_installed("scipy")):
        return ()
    return tuple(
        f"qpsolvers:{solver}" for solver, (module, _, _) in _SOLVERS.items() if is_installed(module)
    )


def create(name: str) -> SolverBackend:
    """The backend ``qpsolvers:<solver>``, also of a solver that :func:`names` does not list."""
    require("qpsolvers", "qpsolvers", "solvers")
    solver = name.partition(":")[2]
    module, licence, options = _SOLVERS.get(solver, ("", "unknown", {}))
    if module and not is_installed(module):
        if module in ("clarabel", "osqp", "piqp", "proxsuite"):
            raise MissingExtraError(module, "solvers")
        if module == "quadprog":
            raise MissingExtraError(module, "gpl")
        raise BackendError(f"{name!r} needs the package {module!r}, which no extra brings")
    if not module:
        with undisturbed():
            import qpsolvers
        if solver not in qpsolvers.available_solvers:
            known = ", ".join(qpsolvers.available_solvers)
            raise BackendError(f"qpsolvers finds no solver {solver!r}; it finds: {known}")
    capability = Capability(
        package="qpsolvers",
        licence=f"LGPL-3.0-or-later AND {licence}",
        semidefinite=bool(module) and solver not in _DEFINITE,
    )
    make = partial(_Workspace, solver, options)
    return SolverBackend(name, capability, make, direct=solver in _DIRECT)
