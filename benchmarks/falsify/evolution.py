"""An evolution strategy that climbs toward the smallest margin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.falsify.attack import Attack
from benchmarks.falsify.strategies import STRATEGIES

__all__ = ["FIRST", "HOLD", "MOVES", "climb"]

MOVES, HOLD = 24, 5
"""An evolved attack: 24 moves of 5 ticks, 4 s, room for an approach and for the strike."""

FIRST = 16
"""Attacks drawn at first, of which the best is improved."""

RATE, SLOWEST, FASTEST = 0.1, 0.01, 0.3
"""Share of the numbers changed at a time, at first, and its bounds."""

FASTER, SLOWER = 1.5, 0.9
"""Factors of the rate after a success and a failure: they balance at one success in five."""

SPREAD = 0.4
"""Standard deviation of a change; half of the changes go to -1, 0 or 1 at once."""

SHIFTS = 0.1
"""Share of the steps that also shift the attack in time by one move."""

Array = NDArray[np.float64]


def climb(
    score: Callable[[Attack], float], rng: np.random.Generator, evaluations: int
) -> tuple[Attack, float]:
    """Search for the attack of the lowest score; that attack and its score.

    A (1+1) evolution strategy: sparse changes, their number by the rule of one success in five
    (Rechenberg, Evolutionsstrategie, 1973). The worst is found on the bounds, so half of the
    changes go right there.
    """
    best, lowest = None, np.inf
    for _ in range(min(FIRST, evaluations)):
        attack = _first(rng)
        value = score(attack)
        if best is None or value < lowest:
            best, lowest = attack, value
    assert best is not None
    rate = RATE
    for _ in range(evaluations - FIRST):
        attack = _changed(best, rate, rng)
        value = score(attack)
        if value <= lowest:
            best, lowest, rate = attack, value, min(FASTEST, FASTER * rate)
        else:
            rate = max(SLOWEST, SLOWER * rate)
    return best, float(lowest)


def _first(rng: np.random.Generator) -> Attack:
    """A scripted strategy's attack, thinned to the form that is evolved."""
    names = ("outward", "charge", "vertices", "spiral")
    drawn = STRATEGIES[names[int(rng.integers(len(names)))]](rng)
    moves = drawn.moves[::HOLD, :][:MOVES]
    return Attack(drawn.constants, moves, HOLD, True)


def _changed(attack: Attack, rate: float, rng: np.random.Generator) -> Attack:
    moves = _mutated(attack.moves, rate, rng)
    if rng.random() < SHIFTS:
        moves = np.roll(moves, rng.choice((-1, 1)), axis=0)
    return attack._replace(constants=_mutated(attack.constants, rate, rng), moves=moves)


def _mutated(values: Array, rate: float, rng: np.random.Generator) -> Array:
    moved = np.clip(values + rng.normal(0.0, SPREAD, values.shape), -1.0, 1.0)
    jumped = rng.choice((-1.0, 0.0, 1.0), values.shape)
    changed = np.where(rng.random(values.shape) < 0.5, moved, jumped)
    return np.where(rng.random(values.shape) < rate, changed, values)
