"""Checks that the builders of rows share, cheap enough for every tick."""

from __future__ import annotations

import math

from clfcbf.errors import ConfigurationError, GeometryError

__all__ = ["check_finite", "check_positive"]


def check_positive(name: str, value: float) -> float:
    """Return ``value`` if it is finite and positive, else raise ``ConfigurationError``."""
    if not 0.0 < value < math.inf:
        raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")
    return value


def check_finite(name: str, *groups: tuple[float, ...]) -> None:
    """Raise ``GeometryError`` if the numbers of ``groups`` are not finite.

    Only ``total - total`` of a sum that is not finite is not 0, which one test catches.
    """
    total = 0.0
    for group in groups:
        total += sum(group)
    if total - total != 0.0:
        raise GeometryError(f"{name} must be finite, got {', '.join(map(repr, groups))}")
