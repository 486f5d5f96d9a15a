"""CasADi's solvers [Andersson2019]_: IPOPT on the program as a nonlinear one, and its plugins.

CasADi is LGPL-3. Its HiGHS plugin is left out: it and the package highspy crash when they meet
in one process. So is qpOASES, which prints a banner whatever it is told, and HPIPM and Fatrop,
which take optimal-control programs only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clfcbf.qp.backends import Capability
from clfcbf.qp.backends._solver import (
    Claim,
    SolverBackend,
    Workspace,
    is_installed,
    require,
    undisturbed,
)
from clfcbf.qp.problem import QpStatus
from clfcbf.qp.reduction import Form

__all__ = ["create", "installed", "names"]

_TIGHT = 1e-9
"""Tolerance of the plugins that have one, as for the solvers' own packages."""

_PLUGINS: dict[str, tuple[str, dict[str, Any]]] = {
    "daqp": ("MIT", {"daqp": {"primal_tol": 1e-11}}),
    "ipqp": (
        "LGPL-3.0-or-later",
        {
            "print_iter": False,
            "print_header": False,
            "print_info": False,
            "linear_solver": "qr",  # the default one warns of every zero pivot
        },
    ),
    "osqp": (
        "Apache-2.0",
        {
            "warm_start_primal": False,
            "warm_start_dual": False,
            "osqp": {"verbose": False, "eps_abs": _TIGHT, "eps_rel": 0.0, "max_iter": 20_000},
        },
    ),
    "piqp": ("BSD-2-Clause", {"piqp": {"eps_abs": _TIGHT, "eps_rel": 0.0}}),
    "proxqp": ("BSD-2-Clause", {"proxqp": {"eps_abs": _TIGHT, "verbose": False}}),
    "qrqp": (
        "LGPL-3.0-or-later",
        {"print_iter": False, "print_header": False, "print_info": False},
    ),
}
"""Licence and options of each plugin that the wheel brings and that answers dense programs."""

_DIRECT = frozenset({"daqp", "qrqp"})
"""The active-set methods among them."""

_FAR = 1e9
"""No bound, for IPQP, which gives NaN where a single side is finite; numbers are of order one."""

_IPOPT = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-10,
        "hessian_constant": "yes",
        "jac_c_constant": "yes",
        "jac_d_constant": "yes",
        "max_iter": 200,
    },
}
"""Tighter than IPOPT's own 1e-8, for 14 % of its time; derivatives are those of a QP."""

_STOPPED = {
    "Infeasible_Problem_Detected": QpStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": QpStatus.ITERATION_LIMIT,
    "Maximum_WallTime_Exceeded": QpStatus.TIME_LIMIT,
    "Maximum_CpuTime_Exceeded": QpStatus.TIME_LIMIT,
    "Diverging_Iterates": QpStatus.UNBOUNDED,
}


class _Conic:
    """A plugin for quadratic programs, built once for a shape."""

    def __init__(self, plugin: str, form: Form) -> None:
        with undisturbed():
            import casadi

        n, k = form.q.size, form.lower.size
        pattern = {"h": casadi.Sparsity.dense(n, n), "a": casadi.Sparsity.dense(k, n)}
        options = {"error_on_fail": False, "print_time": False, **_PLUGINS[plugin][1]}
        self._solver: Any = casadi.conic("clfcbf", plugin, pattern, options)
        self._far = _FAR if plugin == "ipqp" else np.inf

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        lower, upper = np.maximum(form.lower, -self._far), np.minimum(form.upper, self._far)
        answer = self._solver(h=form.P, g=form.q, a=form.C, lba=lower, uba=upper)
        stats = self._solver.stats()
        message = str(stats.get("return_status", ""))
        status = QpStatus.OPTIMAL if stats["success"] else QpStatus.NUMERICAL_ERROR
        return Claim(status, _vector(answer["x"]), _vector(answer["lam_a"]), message)


class _Ipopt:
    """The quadratic program as a nonlinear one, its numbers as parameters, built once."""

    def __init__(self, form: Form) -> None:
        with undisturbed():
            import casadi

        n, k = form.q.size, form.lower.size
        y = casadi.MX.sym("y", n)
        P, q = casadi.MX.sym("P", n, n), casadi.MX.sym("q", n)
        C = casadi.MX.sym("C", k, n)
        program = {
            "x": y,
            "p": casadi.veccat(P, q, C),
            "f": 0.5 * casadi.bilin(P, y, y) + casadi.dot(q, y),
            "g": casadi.mtimes(C, y),
        }
        self._program = program
        self._solvers: dict[float | None, Any] = {}

    def solve(self, form: Form, time_limit: float | None) -> Claim:
        import casadi

        solver = self._solvers.get(time_limit)
        if solver is None:
            options: dict[str, Any] = {**_IPOPT, "ipopt": dict(_IPOPT["ipopt"])}  # type: ignore[call-overload]
            if time_limit is not None:
                options["ipopt"]["max_wall_time"] = time_limit
            solver = casadi.nlpsol("clfcbf", "ipopt", self._program, options)
            self._solvers = {time_limit: solver}
        numbers = np.concatenate((form.P.T.ravel(), form.q, form.C.T.ravel()))
        answer = solver(p=numbers, lbg=form.lower, ubg=form.upper)
        stats = solver.stats()
        message = str(stats["return_status"])
        if stats["success"]:
            status = QpStatus.OPTIMAL
        else:
            status = _STOPPED.get(message, QpStatus.NUMERICAL_ERROR)
        return Claim(status, _vector(answer["x"]), _vector(answer["lam_g"]), message)


def _vector(values: Any) -> Any:
    return np.array(values, dtype=np.float64).ravel()


def names() -> tuple[str, ...]:
    """IPOPT and the plugins."""
    return ("casadi-ipopt", *(f"casadi-{plugin}" for plugin in _PLUGINS))


def installed() -> tuple[str, ...]:
    """The names, if the package is there."""
    return names() if is_installed("casadi") else ()


def create(name: str) -> SolverBackend:
    """The backend; ``name`` is one of :func:`names`."""
    require("casadi", "casadi", "solvers")
    plugin = name.partition("-")[2]
    solver = "EPL-2.0" if plugin == "ipopt" else _PLUGINS[plugin][0]
    make: Callable[[Form], Workspace] = _Ipopt
    if plugin != "ipopt":

        def make(form: Form) -> Workspace:
            return _Conic(plugin, form)

    capability = Capability(
        semidefinite=plugin != "daqp",  # where its own package regularises, the plugin errs
        package="casadi",
        licence=" AND ".join(dict.fromkeys(("LGPL-3.0-or-later", solver))),  # each name once
        extra="solvers",
        time_limit=plugin == "ipopt",
    )
    return SolverBackend(name, capability, make, direct=plugin in _DIRECT)
