r"""A smallest set of half-planes that exclude each other, found exactly.

By Helly's theorem half-planes :math:`a_i^\top u \le b_i` of the plane have no common point
exactly where some three of them, or fewer, have none [Helly1923]_. So all ones, twos and threes
are tried, and each is decided by Farkas' lemma: multipliers :math:`\lambda \ge 0` with

.. math:: \sum_i \lambda_i a_i = 0, \qquad \sum_i \lambda_i b_i < 0 .

Floats are rationals with a power of two below, so the test runs on integers and rounds nothing.
A set found here is irreducible: without any one of its members the others have a common point.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations
from typing import NamedTuple

from clfcbf.constraints.rows import Row

__all__ = ["Conflict", "HalfPlane", "smallest_conflict"]

NEGLIGIBLE = 1e-9
"""[m/s and rad/s] Shortfall not counted as a conflict: what a tick allows for rounding."""


class HalfPlane(NamedTuple):
    """One member of the search.

    Attributes
    ----------
    name : of the row or of the side of the box
    row : ``(a_v, a_omega, b)``
    soft : whether it may give way; limits and rows of a more important level do not
    """

    name: str
    row: Row
    soft: bool


class Conflict(NamedTuple):
    r"""Half-planes without a common point, and how much is missing.

    Attributes
    ----------
    members : one to three half-planes, at least one of them soft
    short : least :math:`s` with :math:`a_i^\top u \le b_i + s|a_i|` for the soft members, the
        distance in the plane of commands by which these have to move; infinite for a member
        that no command satisfies, :math:`a = 0 > b`
    """

    members: tuple[HalfPlane, ...]
    short: float

    @property
    def soft(self) -> tuple[HalfPlane, ...]:
        """The members that had to give way."""
        return tuple(member for member in self.members if member.soft)

    @property
    def hard(self) -> tuple[HalfPlane, ...]:
        """The members they had to give way to."""
        return tuple(member for member in self.members if not member.soft)

    @property
    def shortfalls(self) -> dict[str, float]:
        r"""By name, what each soft member lacks in its own unit, :math:`s|a_i|`."""
        return {
            name: -b if a == c == 0.0 else self.short * math.hypot(a, c)
            for name, (a, c, b), _ in self.soft
        }


class _Scaled(NamedTuple):
    """A row times ``scale``, a power of two, so that its entries are integers."""

    a: int
    c: int
    b: int
    scale: int


def smallest_conflict(planes: Sequence[HalfPlane]) -> Conflict | None:
    """The smallest subset of ``planes`` that no command satisfies.

    Of several as small as each other, one that is short by the most. Subsets of hard members
    alone, and those short by no more than :data:`NEGLIGIBLE`, do not count. Takes time with the
    third power of the number of half-planes, 10 ms for thirty.

    Parameters
    ----------
    planes : half-planes with finite coefficients

    Returns
    -------
    The conflict, or None where there is none

    Raises
    ------
    OverflowError, ValueError : a coefficient is infinite or NaN
    """
    rows = [_scaled(plane.row) for plane in planes]
    for certificates in (_ones(rows), _twos(rows), _threes(rows)):
        best: Conflict | None = None
        for indices, weights in certificates:
            members = tuple(planes[i] for i in indices)
            if not any(member.soft for member in members):
                continue
            short = _shortfall(members, [rows[i] for i in indices], weights)
            if short > (NEGLIGIBLE if best is None else best.short):
                best = Conflict(members, short)
        if best is not None:
            return best
    return None


_Certificate = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of the members, and Farkas' multipliers of their scaled rows."""


def _scaled(row: Row) -> _Scaled:
    ratios = [number.as_integer_ratio() for number in map(float, row)]
    scale = max(denominator for _, denominator in ratios)
    a, c, b = (numerator * (scale // denominator) for numerator, denominator in ratios)
    return _Scaled(a, c, b, scale)


def _ones(rows: Sequence[_Scaled]) -> Iterator[_Certificate]:
    for i, (a, c, b, _) in enumerate(rows):
        if a == c == 0 > b:
            yield (i,), (1,)


def _twos(rows: Sequence[_Scaled]) -> Iterator[_Certificate]:
    """Opposite directions, and no strip between them."""
    for (i, (a, c, b, _)), (j, (d, e, f, _)) in combinations(enumerate(rows), 2):
        if a * e == c * d and a * d + c * e < 0:
            p, q = abs(d) + abs(e), abs(a) + abs(c)
            if p * b + q * f < 0:
                yield (i, j), (p, q)


def _threes(rows: Sequence[_Scaled]) -> Iterator[_Certificate]:
    """Three directions that span the plane positively, and no triangle between them."""
    count = len(rows)
    cross = [[a * e - c * d for d, e, _, _ in rows] for a, c, _, _ in rows]
    for i, j in combinations(range(count), 2):
        r = cross[i][j]
        if r == 0:
            continue
        sign = 1 if r > 0 else -1
        for k in range(j + 1, count):
            p, q = sign * cross[j][k], sign * cross[k][i]
            if p > 0 and q > 0:
                weights = (p, q, sign * r)
                total = p * rows[i].b + q * rows[j].b + sign * r * rows[k].b
                if total < 0:
                    yield (i, j, k), weights


def _shortfall(
    members: Sequence[HalfPlane], rows: Sequence[_Scaled], weights: Sequence[int]
) -> float:
    r""":math:`s = -\sum_i\lambda_ib_i / \sum_{soft}\lambda_i|a_i|`, rounded once at the end."""
    missing = -sum(weight * row.b for weight, row in zip(weights, rows, strict=True))
    length = Fraction(0)
    for member, row, weight in zip(members, rows, weights, strict=True):
        a, c, _ = member.row
        if member.soft:
            # Halves, for the length of a finite row may overflow.
            length += weight * row.scale * 2 * Fraction(math.hypot(0.5 * a, 0.5 * c))
    if length == 0:
        return math.inf
    try:
        return float(missing / length)
    except OverflowError:
        return math.inf
