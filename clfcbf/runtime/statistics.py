"""How regular the ticks were: periods, latencies, durations and misses, as data."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["LoopStatistics", "Percentiles", "Recorder"]

_COLUMNS = ("period", "lateness", "latency", "solve")


class Percentiles(NamedTuple):
    """A distribution in a few numbers, all NaN where there was nothing to measure [s]."""

    p50: float
    p90: float
    p99: float
    worst: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Percentiles:
        """Of the finite ones among ``values``, shape (n,)."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return cls(math.nan, math.nan, math.nan, math.nan)
        p50, p90, p99 = np.percentile(finite, (50.0, 90.0, 99.0)).tolist()
        return cls(p50, p90, p99, float(finite.max()))


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """What a run's ticks took.

    Counts are of the whole run, distributions of its last ticks, see ``LoopPolicy.window``.

    Attributes
    ----------
    ticks : decisions made
    missed : of them later than their deadline, one period after the tick was due
    skipped : whole periods that passed without a command
    fresh : ticks with a new measurement that was passed on
    stale : measurements left out because of their age
    repeated : measurements left out because their stamp was not newer
    period : from one command to the next [s]
    lateness : from when a tick was due to when it began [s]
    latency : from a measurement's stamp to the command that used it first [s]
    solve : duration of the controller's step [s]
    """

    ticks: int
    missed: int
    skipped: int
    fresh: int
    stale: int
    repeated: int
    period: Percentiles
    lateness: Percentiles
    latency: Percentiles
    solve: Percentiles

    def to_dict(self) -> dict[str, int | dict[str, float | None]]:
        """The same for JSON: None where there was nothing to measure."""
        record: dict[str, int | dict[str, float | None]] = {}
        for name, value in asdict(self).items():
            if isinstance(value, tuple):
                named = zip(Percentiles._fields, value, strict=True)
                record[name] = {key: v if math.isfinite(v) else None for key, v in named}
            else:
                record[name] = value
        return record


class Recorder:
    """Collects the numbers of a run's last ``window`` ticks without allocating.

    Attributes
    ----------
    ticks, missed, skipped, fresh, stale, repeated : as in :class:`LoopStatistics`
    """

    __slots__ = ("_table", "fresh", "missed", "repeated", "skipped", "stale", "ticks")

    def __init__(self, window: int) -> None:
        self._table = np.full((window, len(_COLUMNS)), math.nan)
        self.ticks = self.missed = self.skipped = 0
        self.fresh = self.stale = self.repeated = 0

    def add(self, period: float, lateness: float, latency: float, solve: float) -> None:
        """Count a tick; NaN for what it did not have."""
        self._table[self.ticks % len(self._table)] = (period, lateness, latency, solve)
        self.ticks += 1

    def statistics(self) -> LoopStatistics:
        """What was collected so far."""
        held = self._table[: min(self.ticks, len(self._table))]
        columns = {name: Percentiles.of(held[:, i]) for i, name in enumerate(_COLUMNS)}
        return LoopStatistics(
            self.ticks, self.missed, self.skipped, self.fresh, self.stale, self.repeated, **columns
        )
