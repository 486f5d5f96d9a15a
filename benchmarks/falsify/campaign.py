"""Many attacks: what each run of a campaign is, by its number, and how they add up.

A run is known by assumptions, seed and index alone: the same on any machine, whatever ran before.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.falsify import paper
from benchmarks.falsify.assumptions import Assumptions, set_named
from benchmarks.falsify.attack import Attack
from benchmarks.falsify.duel import Outcome, duel
from benchmarks.falsify.evolution import HOLD, MOVES, climb
from benchmarks.falsify.strategies import STRATEGIES, TICKS
from benchmarks.falsify.subjects import ARENA, make_filter

__all__ = ["EVOLUTION", "Run", "Tally", "attack_of", "execute", "planned", "summarise", "worst_of"]

EVOLUTION = "evolution"

BATCHES = ((2, 25), (4, 50), (8, 100), (16, 200), (32, 400), (64, 800), (100, 1200))
"""Attacks in a run of a scripted strategy and of the evolution, by the turns that went before:
small ones first, and a balance of both in the end."""

_FIRST = ("outward", "charge", EVOLUTION)
_KINDS = (*_FIRST, *(name for name in STRATEGIES if name not in _FIRST))


@dataclass(frozen=True, slots=True)
class Run:
    """One piece of a campaign."""

    set: str
    seed: int
    index: int

    @property
    def strategy(self) -> str:
        """The strategies take turns."""
        return _KINDS[self.index % len(_KINDS)]

    @property
    def attacks(self) -> int:
        """Attacks tried, more in later runs."""
        scripted, evolved = BATCHES[min(self.index // len(_KINDS), len(BATCHES) - 1)]
        return evolved if self.strategy == EVOLUTION else scripted


def planned(run: Run) -> int:
    """Ticks of a run of which nothing ends early."""
    if run.set == paper.NAME:
        return paper.TICKS * len(paper.CELLS)
    length = MOVES * HOLD if run.strategy == EVOLUTION else TICKS
    return run.attacks * length


class Tally:
    """Adds up outcomes; remembers the attack that came closest."""

    def __init__(self, assumptions: Assumptions) -> None:
        self.assumptions = assumptions
        self.outcomes: list[Outcome] = []
        self.worst: Attack | None = None
        self.margin = math.inf

    def meet(self, attack: Attack) -> float:
        """Let the default filter meet the attack; its smallest margin [rad]."""
        subject = make_filter(self.assumptions.protection, gain=self.assumptions.gain)
        outcome = duel(subject, ARENA, self.assumptions, attack)
        self.outcomes.append(outcome)
        if outcome.margin < self.margin:
            self.margin, self.worst = outcome.margin, attack
        return outcome.margin


def attack_of(run: Run) -> Tally:
    """Make all attacks of a run."""
    tally = Tally(set_named(run.set))
    rng = np.random.default_rng([run.seed, run.index])
    if run.strategy == EVOLUTION:
        climb(tally.meet, rng, run.attacks)
    else:
        for _ in range(run.attacks):
            tally.meet(STRATEGIES[run.strategy](rng))
    return tally


def execute(run: Run) -> dict[str, Any]:
    """The record of a run: plain numbers, for JSON."""
    if run.set == paper.NAME:
        return paper.run_paper(run.seed, run.index)
    tally = attack_of(run)
    outcomes = tally.outcomes
    return {
        "set": run.set,
        "index": run.index,
        "strategy": run.strategy,
        "episodes": len(outcomes),
        "lost": sum(outcome.outside > 0 for outcome in outcomes),
        "ticks": sum(outcome.ticks for outcome in outcomes),
        "fov_violations": sum(outcome.outside for outcome in outcomes),
        "limit_violations": sum(outcome.limit_violations for outcome in outcomes),
        "uncertified_ticks": sum(outcome.uncertified for outcome in outcomes),
        "exceptions": sum(outcome.exceptions for outcome in outcomes),
        "margin_deg": math.degrees(tally.margin),
    }


def worst_of(records: Iterable[Mapping[str, Any]]) -> Mapping[str, Any]:
    """The record of the smallest margin."""
    return min(records, key=lambda record: float(record["margin_deg"]))


_COUNTS = (
    "ticks", "episodes", "lost", "fov_violations", "limit_violations", "uncertified_ticks",
    "exceptions",
)  # fmt: skip


def summarise(records: list[dict[str, Any]], seed: int) -> dict[str, Any]:
    """Counts and the smallest margin of the records of one set, and which run found it."""
    worst = worst_of(records)
    summary: dict[str, Any] = {name: sum(r[name] for r in records) for name in _COUNTS}
    summary["min_margin_deg"] = worst["margin_deg"]
    summary["found_by"] = {
        "strategy": worst["strategy"], "seed": seed, "index": worst["index"]
    }  # fmt: skip
    if "cells" in worst:
        summary["cells"] = {
            cell: {
                "infeasible_runs": sum(r["cells"][cell]["infeasible"] for r in records)
                / len(records),
                "lost_runs": sum(r["cells"][cell]["lost"] for r in records) / len(records),
                "min_margin_deg": min(r["cells"][cell]["margin_deg"] for r in records),
            }
            for cell in worst["cells"]
        }
    return summary
