"""Mutations: of bytes, and of trees of tables, lists and values."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

__all__ = ["HOSTILE", "leaves", "mutated_bytes", "mutated_tree"]

HOSTILE: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 0, 0.0, -0.0, -1, -1.0, 1, 2, 1e-300, 5e-324, -5e-324, 1e-12,
    1e-9, 1e-3, 0.5, 10, 1e6, 1e9, 1e15, 1e18, 1e300, 1.7e308, -1.7e308, 2**31, 2**63, -(2**63),
    2**64, 10**400, True, False, "", "0.1", "nan", "exact", "\0", "é" * 50, "x" * 5000, [], [1.0],
    [math.nan] * 3, [[]], [0.0] * 1000, {}, {"a": 1}, {"x": {"x": {"x": 1}}}, [{}], None,
)  # fmt: skip
"""Values that somebody forgot to think of."""

_SCALES = (0.0, -1.0, 1e-12, 1e-6, 1e-3, 0.1, 0.9, 1.1, 10.0, 1e3, 1e6, 1e12)


def mutated_bytes(rng: np.random.Generator, data: bytes, most: int = 4) -> bytes:
    """Some bits turned; pieces set to zero, replaced, repeated, moved, inserted, or cut off."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, most + 1))):
        if not changed:
            break
        at = int(rng.integers(len(changed)))
        length = int(min(rng.geometric(0.05), 400))
        match int(rng.integers(8)):
            case 0:
                changed[at] ^= 1 << int(rng.integers(8))
            case 1:
                changed[at : at + length] = bytes(len(changed[at : at + length]))
            case 2:
                changed[at : at + length] = rng.bytes(length)
            case 3:
                changed[at:at] = rng.bytes(length)
            case 4:
                del changed[at : at + length]
            case 5:
                changed[at:at] = changed[at : at + length]
            case 6:
                other = int(rng.integers(len(changed)))
                changed[other:other] = changed[at : at + length]
            case _:
                del changed[at:]
    return bytes(changed)


Path = tuple[Any, ...]


def leaves(tree: Any, path: Path = ()) -> list[Path]:
    """Paths of everything in a tree but its root."""
    entries: list[tuple[Any, Any]] = []
    if isinstance(tree, dict):
        entries = list(tree.items())
    elif isinstance(tree, list):
        entries = list(enumerate(tree[:50]))
    found: list[Path] = []
    for key, value in entries:
        found += [(*path, key), *leaves(value, (*path, key))]
    return found


def mutated_tree(
    rng: np.random.Generator, tree: Any, most: int = 3, absent: bool = True
) -> tuple[Any, list[Path]]:
    """A copy with some entries replaced, scaled, removed, renamed or added; and which.

    Parameters
    ----------
    absent : whether entries may be removed, renamed and added too
    """
    changed = copy.deepcopy(tree)
    touched: list[Path] = []
    for _ in range(int(rng.integers(1, most + 1))):
        paths = leaves(changed)
        if not paths:
            break
        path = paths[int(rng.integers(len(paths)))]
        parent = changed
        for key in path[:-1]:
            parent = parent[key]
        key = path[-1]
        touched.append(path)
        choice = int(rng.integers(10 if absent else 6))
        value = parent[key]
        if choice < 3 and isinstance(value, (int, float)) and not isinstance(value, bool):
            try:
                parent[key] = float(value) * float(rng.choice(_SCALES))
            except OverflowError:
                parent[key] = 0.0
        elif choice < 6:
            parent[key] = copy.deepcopy(HOSTILE[int(rng.integers(len(HOSTILE)))])
        elif choice == 6:
            del parent[key]
        elif choice == 7 and isinstance(parent, dict):
            parent[f"{key}x" if rng.random() < 0.5 else str(key)[1:]] = parent.pop(key)
        elif choice == 8 and isinstance(parent, dict):
            parent["unheard of"] = value
        else:
            other = paths[int(rng.integers(len(paths)))]
            node = changed
            try:
                for step in other:
                    node = node[step]
                parent[key] = copy.deepcopy(node)
            except (KeyError, IndexError, TypeError):
                parent[key] = None
    return changed, touched
