"""What a campaign leaves behind: the JSON document, the table, and a run replayed tick by tick."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.falsify import paper
from benchmarks.falsify.assumptions import set_named
from benchmarks.falsify.attack import Constants
from benchmarks.falsify.campaign import Run, attack_of, summarise
from benchmarks.falsify.duel import END, Glimpse, duel
from benchmarks.falsify.subjects import ARENA, make_filter

__all__ = ["COUNTS", "document", "replay", "table"]

COUNTS = ("ticks", "fov_violations", "limit_violations", "uncertified_ticks", "exceptions")
"""Counts of the declared assumptions, on top of the document."""


def document(
    records: Sequence[dict[str, Any]], seed: int, config: Mapping[str, Any]
) -> dict[str, Any]:
    """The campaign as JSON: counts on top, every set below, and the records to resume from."""
    by_set: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        by_set.setdefault(record["set"], []).append(record)
    sets = {name: summarise(own, seed) for name, own in by_set.items()}
    empty = {**dict.fromkeys(COUNTS, 0), "min_margin_deg": math.degrees(ARENA.margin)}
    declared = sets.get("declared", empty)
    return {
        **{name: declared[name] for name in COUNTS},
        "min_margin_deg": declared["min_margin_deg"],
        "by_assumption": sets,
        "config": dict(config),
        "runs": list(records),
    }


def table(result: Mapping[str, Any]) -> str:
    """Sets line by line, then the paper's barrier."""
    return "\n".join(_lines(result))


def _lines(result: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f"{'assumptions':<24}{'ticks':>10}{'margin':>9}{'attacks':>9}{'lost':>7}{'outside':>9}"
        f"{'limits':>8}{'uncert.':>9}{'raised':>8}  found by"
    )
    for name, row in result["by_assumption"].items():
        found = row["found_by"]
        yield (
            f"{name:<24}{row['ticks']:>10}{row['min_margin_deg']:>9.3f}{row['episodes']:>9}"
            f"{row['lost']:>7}{row['fov_violations']:>9}{row['limit_violations']:>8}"
            f"{row['uncertified_ticks']:>9}{row['exceptions']:>8}  "
            f"{found['strategy']} {found['seed']}/{found['index']}"
        )
    yield ""
    yield (
        "margin: smallest angle to the true edge [deg]; outside: sub-samples out of view, 20 a "
        "tick, and\nticks for the paper's barrier; limits: commands outside their input box; "
        "uncert.: ticks without\na certified brake, or infeasible. Attacks end before the feature "
        f"is nearer than {END:g} m."
    )
    for name, cell in result["by_assumption"].get(paper.NAME, {}).get("cells", {}).items():
        yield (
            f"  {name:<42}{100 * cell['infeasible_runs']:>5.0f} % infeasible"
            f"{100 * cell['lost_runs']:>5.0f} % lost{cell['min_margin_deg']:>8.2f} deg"
        )


def replay(run: Run) -> Iterator[str]:
    """The worst attack of a run once more, a line a tick."""
    assumptions = set_named(run.set)
    attack = attack_of(run).worst
    assert attack is not None
    glimpses: list[Glimpse] = []
    outcome = duel(
        make_filter(assumptions.protection), ARENA, assumptions, attack, watch=glimpses.append
    )
    yield (
        f"{run.set}, {run.strategy} {run.seed}/{run.index}: margin "
        f"{math.degrees(outcome.margin):.4f} deg in tick {outcome.worst}, "
        f"{outcome.outside} sub-samples outside"
    )
    constants = Constants(*attack.constants.tolist())._asdict().items()
    yield ", ".join(f"{name} {value:+.2f}" for name, value in constants)
    yield (
        f"{'t [s]':>6}{'age [ms]':>9}{'nominal':>16}{'sent':>16}{'body':>16}"
        f"{'clearance':>11}{'margin':>8}  status"
    )
    for now, nominal, scene, decision, body, margin in glimpses:
        twists = "".join(f"{v:>9.3f}{w:>7.3f}" for v, w in (nominal, decision.twist, body))
        yield (
            f"{now:>6.2f}{1e3 * (now - scene.stamp):>9.0f}{twists}"
            f"{math.degrees(decision.clearance):>10.2f}{math.degrees(margin):>8.2f}"
            f"  {decision.status.value}"
        )
