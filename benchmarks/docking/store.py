"""What a campaign leaves behind: a JSON document to resume from, and the same runs as CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.docking.campaign import Run, method_of
from benchmarks.docking.statistics import CONFIDENCE, demonstrated, wilson
from clfcbf import defaults
from clfcbf.errors import ConfigurationError
from clfcbf.report import versions, write_json
from clfcbf.simulation.campaign import summarise
from clfcbf.simulation.scenarios import World, region_named

__all__ = ["Store", "cells_of", "run_of"]

TRACKS = 12
"""Paths kept of each cell, of its first wins and of its first losses: as many as a panel shows."""

_SETTINGS = ("seed", "config_hash", "world", "regions", "parameters")


def run_of(record: Mapping[str, Any]) -> Run:
    """The run that a record is of."""
    return Run(
        record["region"], record["sensor"], record["controller"], record["seed"], record["index"]
    )


def cells_of(records: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """The records of each cell, in the order of their first runs."""
    cells: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        cells.setdefault(run_of(record).cell, []).append(record)
    return cells


class Store:
    """The records of a campaign, and where they go.

    Parameters
    ----------
    path : of the JSON document, whose table goes beside it with the suffix ``.csv``; None to keep
        nothing
    seed : of the campaign
    regions, methods : by name; what they are is kept, for others to compare with
    """

    def __init__(
        self, path: Path | None, seed: int, regions: Sequence[str], methods: Sequence[str]
    ) -> None:
        self.path = path
        self.config: dict[str, Any] = {
            "seed": seed,
            "config_hash": defaults.fingerprint(),
            "world": asdict(World()),
            "regions": {name: asdict(region_named(name)) for name in regions},
            "parameters": {name: asdict(method_of(name).stock) for name in methods},
            "versions": versions(),
        }
        self.records: list[dict[str, Any]] = []
        self.tracks: dict[str, list[list[float]]] = {}
        self._drawn: dict[tuple[str, bool], int] = {}

    def add(self, record: dict[str, Any]) -> None:
        """Take a record; its path is kept if it is one of the first of its kind in its cell."""
        track = record.pop("track", None)
        self.records.append(record)
        run = run_of(record)
        kind = (run.cell, bool(record["success"]))
        if track is not None and self._drawn.get(kind, 0) < TRACKS:
            self._drawn[kind] = self._drawn.get(kind, 0) + 1
            self.tracks[run.key] = track

    def earlier(self) -> dict[str, dict[str, Any]]:
        """The records of an earlier campaign in the file, by key, with the paths that it has.

        Empty if there is no such file yet. Raises ``ConfigurationError`` if the file is of
        something else, or if seed, defaults, world, regions or parameters were others.
        """
        if self.path is None or not self.path.exists() or not self.path.stat().st_size:
            return {}
        document = load(self.path)
        config = json.loads(json.dumps(self.config))
        for name in _SETTINGS:
            then, now = document["config"].get(name), config[name]
            if isinstance(now, dict) and isinstance(then, dict):
                shared = then.keys() & now.keys()
                same = all(then[key] == now[key] for key in shared)
            else:
                same = then == now
            if not same:
                raise ConfigurationError(
                    f"cannot resume {str(self.path)!r}: its {name} differs: {then!r}, now {now!r}"
                )
        for name in ("regions", "parameters"):
            self.config[name] = {**document["config"][name], **self.config[name]}
        found = {}
        for record in document["episodes"]:
            key = run_of(record).key
            track = document.get("tracks", {}).get(key)
            found[key] = record if track is None else {**record, "track": track}
        return found

    def document(self) -> dict[str, Any]:
        """Episodes, a summary of each cell, settings and paths."""
        summary = {}
        for cell, records in cells_of(self.records).items():
            row = summarise([dict(record) for record in records])
            wins, runs = row["success"], row["episodes"]
            row["success_interval"] = list(wilson(wins, runs))
            row["demonstrated"] = demonstrated(wins, runs)
            row["confidence"] = CONFIDENCE
            summary[cell] = row
        return {
            "config": self.config, "episodes": self.records, "summary": summary,
            "tracks": self.tracks,
        }  # fmt: skip

    def write(self) -> None:
        """Write both files, if there is a path and a record."""
        if self.path is None or not self.records:
            return
        write_json(self.path, self.document())
        names = list(dict.fromkeys(name for record in self.records for name in record))
        with self.path.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names, restval="")
            writer.writeheader()
            writer.writerows(self.records)


def load(path: Path) -> dict[str, Any]:
    """A document as ``Store`` writes it; ``ConfigurationError`` if it is none."""
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        for record in document["episodes"]:
            run_of(record)
        _ = document["config"]["seed"]
    except OSError as error:
        raise ConfigurationError(f"cannot read {str(path)!r}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{str(path)!r} is no result of this benchmark") from error
    return document
