"""How attacks are made: each strategy draws one from a random stream."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.falsify.attack import CHANNELS, CONSTANTS, Attack, Move

__all__ = ["STRATEGIES", "Strategy"]

TICKS = 240
"""Length of a scripted run: 8 s, enough to turn from one edge to the other and twice back."""

Array = NDArray[np.float64]
Strategy = Callable[[np.random.Generator], Attack]
_V, _OMEGA, _BEARING = map(Move._fields.index, ("v", "omega", "bearing"))
_LATENCY, _STAMP, _FRAME = map(Move._fields.index, ("latency", "stamp", "frame"))


def _vertices(rng: np.random.Generator, shape: int | tuple[int, int]) -> Array:
    return rng.choice((-1.0, 1.0), shape)


def _constants(rng: np.random.Generator) -> Array:
    """At the vertices or anywhere; half of the starts in the nearest quarter of the range."""
    drawn = _vertices(rng, CONSTANTS) if rng.random() < 0.7 else rng.uniform(-1, 1, CONSTANTS)
    drawn[0] = rng.uniform(-1.0, -0.5) if rng.random() < 0.5 else rng.uniform(-1.0, 1.0)
    drawn[1] = rng.uniform(-1.0, 1.0)
    return drawn


def _switching(rng: np.random.Generator, ticks: int, shortest: int, longest: int) -> Array:
    """Vertices, all channels drawn anew at random instants; shape (ticks, channels)."""
    rows: list[Array] = []
    while len(rows) < ticks:
        rows += [_vertices(rng, CHANNELS)] * int(rng.integers(shortest, longest + 1))
    return np.array(rows[:ticks])


def random(rng: np.random.Generator) -> Attack:
    """Everything uniform, held for a random time."""
    hold = int(rng.integers(1, 21))
    return Attack(_constants(rng), rng.uniform(-1, 1, (TICKS // hold, CHANNELS)), hold, False)


def bang_bang(rng: np.random.Generator) -> Attack:
    """Full speeds and errors, switched at random."""
    return Attack(_constants(rng), _switching(rng, TICKS, 3, 40), 1, False)


def resonant(rng: np.random.Generator) -> Attack:
    """Full speeds in a square wave; each half as long as the turn rate takes to change sign."""
    half = int(rng.integers(8, 33))
    moves = _switching(rng, TICKS, 3, 40)
    wave = np.where(np.arange(TICKS) // half % 2 == 0, 1.0, -1.0)
    moves[:, _OMEGA] = wave
    moves[:, _V] = wave * _vertices(rng, 1) if rng.random() < 0.5 else _vertices(rng, 1)
    return Attack(_constants(rng), moves, 1, False)


def outward(rng: np.random.Generator) -> Attack:
    """Always toward the nearer edge, which the errors make look farther away."""
    moves = np.tile(_vertices(rng, CHANNELS), (TICKS, 1))
    moves[:, _OMEGA] = moves[:, _BEARING] = 1.0
    moves[:, _V] = rng.choice((-1.0, 0.0, 1.0))
    return Attack(_constants(rng), moves, 1, True)


def spiral(rng: np.random.Generator) -> Attack:
    """Slowly toward the edge and along it, closing in or backing off."""
    moves = _switching(rng, TICKS, 10, 60)
    moves[:, _OMEGA] = rng.uniform(0.0, 0.4)
    moves[:, _V] = rng.uniform(-1.0, 1.0)
    return Attack(_constants(rng), moves, 1, True)


def charge(rng: np.random.Generator) -> Attack:
    """Fast toward the feature while the turn holds its bearing, then out of it."""
    ticks = int(rng.integers(30, 90))
    moves = np.tile(_vertices(rng, CHANNELS), (TICKS // 2, 1))
    moves[:, _V] = rng.uniform(0.5, 1.0)
    moves[:ticks, _OMEGA] = rng.uniform(-0.5, 0.0)
    moves[ticks:, _OMEGA] = 1.0
    moves[:ticks, _BEARING] = 1.0
    constants = _constants(rng)
    constants[0] = rng.uniform(-1.0, -0.3)
    return Attack(constants, moves, 1, True)


def vertices(rng: np.random.Generator) -> Attack:
    """Toward the nearer edge, the errors at the vertices of their bounds, held or switched."""
    moves = _switching(rng, TICKS, 1, int(rng.integers(1, 31)))
    moves[:, _OMEGA] = 1.0
    return Attack(_constants(rng), moves, 1, True)


def schedules(rng: np.random.Generator) -> Attack:
    """Frames that age: latency in a saw-tooth, drop-outs in bursts, stamps off either way."""
    moves = _switching(rng, TICKS, 5, 40)
    tooth, phase = int(rng.integers(2, 12)), int(rng.integers(0, 12))
    moves[:, _LATENCY] = 2.0 * ((np.arange(TICKS) + phase) % tooth) / (tooth - 1) - 1.0
    moves[:, _FRAME] = np.where(np.arange(TICKS) // tooth % 2 == 0, 1.0, 0.0)
    moves[:, _STAMP] = np.repeat(_vertices(rng, TICKS // 8), 8)
    return Attack(_constants(rng), moves, 1, rng.random() < 0.5)


STRATEGIES: dict[str, Strategy] = {
    "random": random,
    "bang-bang": bang_bang,
    "resonant": resonant,
    "outward": outward,
    "spiral": spiral,
    "charge": charge,
    "vertices": vertices,
    "schedules": schedules,
}
