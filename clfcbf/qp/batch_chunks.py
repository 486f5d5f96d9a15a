"""Many two-input programs: their arguments checked, cut into chunks, turned into columns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clfcbf.errors import ConfigurationError
from clfcbf.qp.batch_geometry import Array, Index, Mask, excess, reach_of
from clfcbf.qp.batch_objective import Objectives
from clfcbf.qp.lexicographic import Box, Row, Weight, check_weight

__all__ = ["CHUNK", "TAME", "Chunk", "One", "Programs", "invalid_columns", "slices"]

CHUNK = 65536
"""Programs worked on at a time: with an eighth it takes nearly half as long again, and beyond
nothing is gained (measured). At most 6 MB of columns for a program of two rows."""

TAME = 1e100
"""Numbers up to this have residuals that cannot overflow."""


class One(NamedTuple):
    """One program of a batch, as the exact path takes it."""

    weight: Weight
    nominal: tuple[float, float]
    box: Box
    levels: tuple[list[Row], list[Row]]


class Chunk(NamedTuple):
    """Programs side by side, a column each: box (4, n), rows (r, 3, n), the hard ones first.

    ``place`` says where in the batch they are, ``hard`` how many rows are hard, ``invalid``
    which columns have no answer, None where all have one.
    """

    place: slice | Index
    objective: Objectives
    box: Array
    rows: Array
    hard: int
    invalid: Mask | None

    @classmethod
    def of(
        cls, place: slice | Index, objective: Objectives, box: Array, rows: Array, hard: int
    ) -> Chunk:
        """Look for columns without an answer: see :func:`invalid_columns`."""
        return cls(place, objective, box, rows, hard, invalid_columns(objective, box, rows))

    def take(self, at: Index) -> Chunk:
        """The columns ``at``."""
        invalid = None if self.invalid is None else self.invalid.take(at)
        box, rows = self.box.take(at, axis=1), self.rows.take(at, axis=2)
        return Chunk(self.place, self.objective.take(at), box, rows, self.hard, invalid)

    def clear_blank_rows(self, count: int | None = None) -> Mask | None:
        """Make rows ``(0, 0, b)`` hold, the first ``count``; those that did not, or None."""
        rows = self.rows[:count]
        blank: Mask = rows[:, 0] == 0.0
        if not blank.any():
            return None
        blank &= rows[:, 1] == 0.0
        if not blank.any():
            return None
        blank &= rows[:, 2] < 0.0
        rows[:, 2][blank] = 0.0
        return blank

    def one(self, at: int) -> One:
        """The program of a column in plain floats."""
        q11, q12, q22 = (q if isinstance(q, float) else float(q[at]) for q in self.objective.weight)
        n_v, n_w = self.objective.nominal[:, at].tolist()
        v_lo, v_hi, w_lo, w_hi = self.box[:, at].tolist()
        rows = [(a, c, b) for a, c, b in self.rows[:, :, at].tolist()]
        levels = rows[: self.hard], rows[self.hard :]
        return One((q11, q12, q22), (n_v, n_w), (v_lo, v_hi, w_lo, w_hi), levels)


@dataclass(frozen=True, slots=True)
class Programs:
    """The arguments of a batch, checked; what is common to all programs is not copied.

    Attributes
    ----------
    weight : shape (3,) or (B, 3)
    nominal, box : shapes (B, 2), (B, 4)
    hard, soft : shapes (B, m, 3), (B, k, 3)
    """

    weight: Array
    nominal: Array
    box: Array
    hard: Array
    soft: Array

    @classmethod
    def read(
        cls,
        weight: ArrayLike,
        nominal: ArrayLike,
        box: ArrayLike,
        hard: ArrayLike,
        soft: ArrayLike | None,
    ) -> Programs:
        """Check shapes and weights, see :func:`clfcbf.qp.batch.solve_batch`."""
        n = _shaped("nominal", nominal, (-1, 2), None)
        count = n.shape[0]
        return cls(
            _weights(weight, count),
            n,
            _shaped("box", box, (count, 4), count),
            _shaped("hard", hard, (count, -1, 3), count),
            _shaped("soft", np.empty((0, 3)) if soft is None else soft, (count, -1, 3), count),
        )

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Number of programs, of hard rows, and of all rows of each."""
        hard, soft = self.hard.shape[1], self.soft.shape[1]
        return self.nominal.shape[0], hard, hard + soft

    @property
    def numbers(self) -> int:
        """Of one program, the weight apart."""
        return 6 + 3 * self.sizes[2]

    def gather(self, place: slice, at: Index, columns: Array) -> None:
        """Copy the programs ``at`` of a place to columns: nominal, box, hard rows, soft rows."""
        hard = 6 + 3 * self.sizes[1]
        parts = columns[:2], columns[2:6], columns[6:hard], columns[hard:]
        for part, array in zip(parts, (self.nominal, self.box, self.hard, self.soft), strict=True):
            part[:] = array[place].take(at, axis=0).reshape(at.size, len(part)).T

    def chunk(self, origin: Index, columns: Array) -> Chunk:
        """Gathered programs as a chunk; ``origin`` says where in the batch they were."""
        _, hard, rows = self.sizes
        nominal, box, block = columns[:2], columns[2:6], columns[6:].reshape(rows, 3, len(origin))
        if self.weight.ndim == 1:
            q11, q12, q22 = self.weight.tolist()
            return Chunk.of(origin, Objectives((q11, q12, q22), nominal), box, block, hard)
        weights = self.weight.take(origin, axis=0).T.copy()
        objective = Objectives((weights[0], weights[1], weights[2]), nominal)
        return Chunk.of(origin, objective, box, block, hard)


def slices(count: int, size: int) -> Iterator[slice]:
    """Cut ``range(count)`` into slices of ``size``.

    Raises
    ------
    ConfigurationError : the size is not positive
    """
    if size < 1:
        raise ConfigurationError(f"chunk must be at least 1, got {size!r}")
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


@np.errstate(over="ignore", invalid="ignore")
def invalid_columns(objective: Objectives, box: Array, rows: Array) -> Mask | None:
    """Where a number is not finite, a residual overflows, or the box is reversed; None: nowhere."""
    invalid: Mask = box[0] > box[1]
    invalid |= box[2] > box[3]
    tame = all(reach_of(array) <= TAME for array in (objective.nominal, box, rows))
    if tame:
        return invalid if invalid.any() else None
    n_v, n_w = objective.nominal
    total = n_v + n_w
    for side in box:
        total += side
    for row in rows:
        total += excess(row, n_v, n_w)
    # Only a sum that is not finite differs from 0 when taken from itself.
    total -= total
    invalid |= total != 0.0
    return invalid


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...], count: int | None) -> Array:
    """``value`` as an array of ``shape`` (-1: any length), its first axis added if missing."""
    array = np.asarray(value, dtype=np.float64)
    if count is not None and array.ndim == len(shape) - 1:
        array = np.broadcast_to(array, (count, *array.shape))
    if array.ndim != len(shape) or any(
        want not in (-1, have) for want, have in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("any" if n < 0 else str(n) for n in shape)
        raise ConfigurationError(f"{name} must have shape ({wanted}), got {np.shape(value)}")
    return array


def _weights(weight: ArrayLike, count: int) -> Array:
    """One weight for all, or one a program; every one positive definite."""
    array = np.asarray(weight, dtype=np.float64)
    if array.ndim == 1:
        return np.array(check_weight(array.tolist()))
    array = _shaped("weight", array, (count, 3), None)
    q11, q12, q22 = array.T
    with np.errstate(all="ignore"):
        good = (q11 > 0.0) & (q22 > 0.0) & (np.abs(q12) < np.sqrt(q11) * np.sqrt(q22))
        good &= np.isfinite(array).all(axis=1)
    if not good.all():
        check_weight(array[int(np.argmin(good))].tolist())
    return array
