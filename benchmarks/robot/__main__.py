"""Campaigns on a whole robot: docks, kills, realtime, fuzz; each with a seed, JSON and a table.

The exit status is 0 where everything held, 1 where something did not.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.command import at_least, exit_status
from benchmarks.robot import docks, fuzz, kills, realtime
from benchmarks.robot.rig import VIAS, Setting
from benchmarks.robot.store import Store, markdown, progress

__all__ = ["main"]

FAILED = 1

MISSED = 0.01
"""Share of deadlines that may be missed in real time beside a busy core, by default."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign; 0 if everything held."""
    options = _parser().parse_args(arguments)
    command: Callable[[Any], bool] = options.command
    return exit_status("robot", lambda: 0 if command(options) else FAILED)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="benchmarks.robot", description=__doc__)
    campaigns = parser.add_subparsers(required=True, metavar="CAMPAIGN")

    def campaign(name: str, command: Callable[[Any], bool], told: str) -> Any:
        made = campaigns.add_parser(name, help=told, description=told)
        made.set_defaults(command=command, campaign=name)
        made.add_argument("--seed", type=at_least(0), default=0)
        made.add_argument("--json", type=Path, metavar="FILE",
                          help="overwritten; a table goes beside it, .md")  # fmt: skip
        made.add_argument("--resume", action="store_true",
                          help="keep the runs that are in the JSON file")  # fmt: skip
        return made.add_argument

    add = campaign("docks", _docks, "dock, undock and replay")
    add("--via", choices=VIAS, default="can")
    add("--runs", type=at_least(1), default=10)
    add("--region", default="R1")
    add("--sensor", default="A")
    add("--real-time", action="store_true", help="on the machine's clock, not a simulated one")
    add("--logs", type=Path, metavar="DIR", help="where the recordings are kept")

    add = campaign("kills", _kills, "let one part die in mid-approach")
    add("--runs", type=at_least(1), default=100)
    add("--parts", type=_parts, default=tuple(kills.PARTS), metavar="NAMES",
        help=f"of {', '.join(kills.PARTS)}; they take turns")  # fmt: skip

    add = campaign("realtime", _realtime, "hold a rate beside a busy core")
    add("--via", choices=VIAS, default="can")
    add("--minutes", type=_positive, default=10.0)
    add("--rate", type=_positive, default=50.0, help="[Hz]")
    add("--idle", action="store_true", help="without the busy process")
    add("--missed", type=float, default=MISSED, help="share of deadlines that may be missed")

    add = campaign("fuzz", _fuzz, "hostile packets, configurations and logs")
    add("--packets", type=at_least(0), default=100_000)
    add("--configs", type=at_least(0), default=100_000)
    add("--logs", type=at_least(0), default=10_000)
    add("--failing", type=Path, default=Path("failing"), metavar="DIR",
        help="where inputs that break something are kept")  # fmt: skip
    add("--only", type=_case, metavar="KIND/INDEX", help="one case again, and raise what it raises")
    return parser


def _docks(options: Any) -> bool:
    names = ("campaign", "seed", "via", "region", "sensor", "real_time")
    store = Store(options.json, _settings(options, names), options.resume)
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.logs or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            for index in progress(_left(store, options.runs), "run"):
                setting = Setting(
                    options.seed, index, options.real_time, region=options.region,
                    sensor=options.sensor,
                )  # fmt: skip
                log = folder / f"{options.via}-{options.seed}-{index}.mcap"
                store.add(docks.fly(setting, options.via, log))
        finally:
            rows = [docks.row(record) for record in _sorted(store)]
            table = markdown(docks.HEADING, rows)
            kept = ("docked", "undocked", "replayed", "within_limits")
            counts = {name: sum(r[name] for r in store.records) for name in kept}
            counts["runs"] = len(store.records)
            in_view = sum(r["min_fov_margin_deg"] >= 0.0 for r in store.records)
            store.write({**counts, "in_view": in_view}, table)
    print(table)
    n = len(store.records)
    print(f"\n{counts['docked']} of {n} docked, {counts['undocked']} undocked, "
          f"{counts['replayed']} replayed bit for bit, {counts['within_limits']} within the "
          f"limits, {in_view} in view throughout")  # fmt: skip
    return bool(min(*(counts[name] for name in kept), in_view) == n >= options.runs)


def _kills(options: Any) -> bool:
    store = Store(options.json, _settings(options, ("campaign", "seed", "parts")), options.resume)
    parts = list(options.parts)
    try:
        for index in progress(_left(store, options.runs), "run"):
            store.add(kills.kill(Setting(options.seed, index), parts[index % len(parts)]))
    finally:
        by_part = {
            part: found for part in parts if (found := [r for r in _sorted(store)
                                                        if r["part"] == part])
        }  # fmt: skip
        table = markdown(kills.HEADING, [kills.row(*entry) for entry in by_part.items()])
        good = sum(record["ok"] for record in store.records)
        store.write({"runs_ok": good, "runs_made": len(store.records)}, table)
    print(table)
    for record in _sorted(store):
        if not record["ok"]:
            wrong = [name for name, held in record.items() if held is False and name != "ok"]
            print(f"run {record['index']}: {record['part']} {record['variant']}: "
                  f"not {', '.join(wrong)}; {record['told'] or record['failures']}")  # fmt: skip
    return bool(good == len(store.records) >= options.runs)


def _realtime(options: Any) -> bool:
    settings = _settings(options, ("campaign", "seed", "via", "minutes", "rate", "idle"))
    store = Store(options.json, settings, options.resume)
    setting = Setting(options.seed, 0, real=True, rate=options.rate)
    found = realtime.drive(setting, options.via, 60.0 * options.minutes, not options.idle)
    store.records = [found]
    columns = [*(f"p{q:g}" for q in realtime.QUANTILES), "worst"]
    rows = [
        (name, *(f"{found[key].get(column, float('nan')):.3f}" for column in columns))
        for name, key in (("late [ms]", "lateness_ms"), ("gap between commands [ms]", "gap_ms"),
                          ("tick [ms]", "tick_ms"))
    ]  # fmt: skip
    table = markdown(("", *columns), rows)
    store.write({}, table)
    print(table)
    print(
        f"\n{found['ticks']} ticks in {found['seconds']:.0f} s at {found['rate']:g} Hz: "
        f"{found['missed']} deadlines missed, {found['missed_moving']} of them in motion; "
        f"{found['outside_contract']} commands outside the contract, {found['uncertified']} "
        f"uncertified; {found['tasks']} tasks done, {found['tasks_failed']} failed, "
        f"{found['trips']} stops by the drives themselves"
    )
    for told in found["failures"]:
        print(f"  {told}")
    held = found["outside_contract"] == found["tasks_failed"] == found["trips"] == 0
    held = held and found["ticks"] > 0 and found["missed_share"] <= options.missed
    return bool(held and found["within_limits"] and found["min_fov_margin_deg"] >= 0.0)


def _fuzz(options: Any) -> bool:
    if options.only is not None:
        kind, index = options.only
        print(fuzz.again(kind, index, options.seed))
        return True
    store = Store(options.json, _settings(options, ("campaign", "seed")), options.resume)
    wanted = {"packets": options.packets, "configs": options.configs, "logs": options.logs}
    try:
        batches = fuzz.batches(wanted, store.done)
        for batch in progress(batches, "batch"):
            store.add(fuzz.run(batch, options.seed, options.failing))
    finally:
        summary = fuzz.summary(store.records)
        table = markdown(fuzz.HEADING, fuzz.rows(summary))
        store.write({"kinds": summary}, table)
    print(table)
    for record in store.records:
        for failing in record["failing"]:
            print(f"{record['kind']} {failing['case']}: {failing['why']}; {failing['file']}")
    return all(not record["failing"] for record in store.records)


def _settings(options: Any, names: Sequence[str]) -> dict[str, Any]:
    values = {name: getattr(options, name) for name in names}
    return {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}


def _left(store: Store, runs: int) -> list[int]:
    return [index for index in range(runs) if index not in store.done]


def _sorted(store: Store) -> list[dict[str, Any]]:
    return sorted(store.records, key=lambda record: record["index"])


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be finite and positive, got {text}")
    return value


def _parts(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    for name in names:
        if name not in kills.PARTS:
            raise argparse.ArgumentTypeError(
                f"unknown part {name!r}; choose from {', '.join(kills.PARTS)}"
            )
    return names


def _case(text: str) -> tuple[str, int]:
    found = re.fullmatch(rf"({'|'.join(fuzz.KINDS)})/(\d+)", text)
    if found is None:
        raise argparse.ArgumentTypeError(
            f"expected one of {', '.join(fuzz.KINDS)} / index, got {text!r}"
        )
    return found[1], int(found[2])


if __name__ == "__main__":
    sys.exit(main())
