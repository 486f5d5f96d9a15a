"""The exceptions of the library: one root, each naming the value that was wrong."""

from __future__ import annotations

__all__ = [
    "BackendError",
    "ClfcbfError",
    "ConfigurationError",
    "GeometryError",
    "LimitsError",
    "LogError",
    "MissingExtraError",
    "PlanningError",
]


class ClfcbfError(Exception):
    """Root of every exception raised by ``clfcbf``."""


class ConfigurationError(ClfcbfError, ValueError):
    """A setting is outside its valid range; the message names both."""


class LimitsError(ConfigurationError):
    """Speed or acceleration limits are not usable, or a start lies beyond them."""


class GeometryError(ClfcbfError, ValueError):
    """A pose or point is not finite, or lies where the geometry is undefined."""


class PlanningError(ClfcbfError):
    """No trajectory exists in the families tried; ``reasons`` says what forbids each.

    Attributes
    ----------
    reasons : constraint name to the number of candidates it rejected
    """

    def __init__(self, message: str, reasons: dict[str, int] | None = None) -> None:
        super().__init__(message)
        self.reasons: dict[str, int] = dict(reasons or {})


class BackendError(ClfcbfError):
    """A quadratic-program backend is unknown or cannot take the program."""


class LogError(ClfcbfError, ValueError):
    """A flight recorder's log is unusable; the message says what is wrong with it, and where."""


class MissingExtraError(ClfcbfError, ImportError):
    """An optional dependency is missing; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"{package!r} is not installed; install it with: pip install 'clfcbf[{extra}]'"
        )
        self.package = package
        self.extra = extra

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        """Pickled by its arguments, so that it crosses from a worker process."""
        return type(self), (self.package, self.extra)
