"""The positive definite weight of a tracking error, as a diagonal or as a full matrix."""

from __future__ import annotations

import math
from typing import TypeAlias

from clfcbf.errors import ConfigurationError

__all__ = ["Weights", "check_weights", "weigh"]

Vector: TypeAlias = tuple[float, float, float]
Weights: TypeAlias = Vector | tuple[Vector, Vector, Vector]
"""``(h1, h2, h3)`` or the rows of a symmetric matrix; [1, 1, m²/rad²] keeps V in m²."""

_CHOICES = "three positive numbers or a symmetric positive definite 3 x 3 matrix by rows"


def check_weights(weights: Weights) -> Weights:
    """Return ``weights`` if they are positive definite.

    Raises
    ------
    ConfigurationError : neither a positive diagonal nor a symmetric matrix with positive
        leading minors (Sylvester's criterion)
    """
    try:
        first, second, third = weights
        if isinstance(first, tuple) and isinstance(second, tuple) and isinstance(third, tuple):
            (a, b, c), (b2, d, e), (c2, e2, f) = first, second, third
            definite = (
                (b, c, e) == (b2, c2, e2)
                and 0.0 < a < math.inf
                and 0.0 < a * d - b * b < math.inf
                and 0.0 < a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d) < math.inf
            )
        else:
            definite = all(0.0 < weight < math.inf for weight in weights)  # type: ignore[operator]
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"weights must be {_CHOICES}, got {weights!r}") from error
    if not definite:
        raise ConfigurationError(f"weights must be {_CHOICES}, got {weights!r}")
    return weights


def weigh(weights: Weights, error: Vector) -> tuple[float, float, float, float]:
    r"""The vector :math:`Hx` and the square :math:`x^\top Hx`, four numbers."""
    x, y, theta = error
    first, second, third = weights
    if isinstance(first, tuple) and isinstance(second, tuple) and isinstance(third, tuple):
        gx = first[0] * x + first[1] * y + first[2] * theta
        gy = second[0] * x + second[1] * y + second[2] * theta
        gt = third[0] * x + third[1] * y + third[2] * theta
    else:
        gx, gy, gt = first * x, second * y, third * theta  # type: ignore[operator]
    return gx, gy, gt, x * gx + y * gy + theta * gt
