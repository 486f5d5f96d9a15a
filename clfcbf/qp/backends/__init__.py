"""Solvers behind one protocol, one module each.

A module here names its solvers in ``names()`` without importing them and makes one in
``create(name)``, which may import. Adding a solver is adding a module.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

from clfcbf.errors import BackendError
from clfcbf.qp.problem import QpSolution, QuadraticProgram

__all__ = ["Backend", "BackendModule", "Capability", "available_backends", "get_backend"]


@dataclass(frozen=True, slots=True)
class Capability:
    """What a backend can take, and what it is.

    Attributes
    ----------
    max_variables : largest n, or None for any
    semidefinite : whether P may be singular
    multipliers : whether it returns usable multipliers; they are reconstructed otherwise
    package : distribution that must be installed, or None
    licence : SPDX identifier of that package
    """

    max_variables: int | None = None
    semidefinite: bool = True
    multipliers: bool = True
    package: str | None = None
    licence: str = "Apache-2.0"


@runtime_checkable
class Backend(Protocol):
    """A solver of quadratic programs, free of state between calls."""

    @property
    def name(self) -> str:
        """The name it is asked for by."""

    @property
    def capability(self) -> Capability:
        """What it can take."""

    def solve(self, problem: QuadraticProgram) -> QpSolution:
        """Solve a well-posed program; the answer is the solver's claim, not yet verified."""


class BackendModule(Protocol):
    """What each module of this package offers."""

    def names(self) -> tuple[str, ...]:
        """Names it could make if everything were installed; no import of a solver."""

    def installed(self) -> tuple[str, ...]:
        """Those of them that are installed; no import of a solver."""

    def create(self, name: str) -> Backend:
        """Make one; raises MissingExtraError if its package is not installed."""


@functools.cache
def _modules() -> tuple[BackendModule, ...]:
    found = (module.name for module in pkgutil.iter_modules(__path__))
    # "exact" first, for it is the default; then by name.
    ordered = sorted((n for n in found if not n.startswith("_")), key=lambda n: (n != "exact", n))
    return tuple(
        cast(BackendModule, importlib.import_module(f"{__name__}.{name}")) for name in ordered
    )


def available_backends() -> tuple[str, ...]:
    """Names of the backends whose packages are installed, ``"exact"`` first."""
    return tuple(name for module in _modules() for name in module.installed())


@functools.cache
def get_backend(name: str) -> Backend:
    """The backend called ``name``, at its default settings.

    Raises
    ------
    BackendError : no backend has that name; the message lists those that do
    MissingExtraError : its package is not installed; the message names the extra
    """
    modules = _modules()
    for module in modules:
        if name in module.names():
            return module.create(name)
    known = ", ".join(known for module in modules for known in module.names())
    raise BackendError(f"no backend is called {name!r}; choose one of: {known}")
