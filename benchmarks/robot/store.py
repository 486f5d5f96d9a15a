"""What a campaign leaves behind: a JSON file to resume from, and a table in Markdown beside it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from clfcbf import defaults
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.report import check_writable, versions, write_json

__all__ = ["Store", "markdown", "progress"]

CHECKPOINT = 20.0
"""[s] Between two writings of the JSON: what an interruption costs at most, beside one run."""


class Store:
    """Records of a campaign, by index, and where they go.

    Parameters
    ----------
    path : of the JSON file, whose table goes beside it with the suffix ``.md``; None to keep none
    settings : of the campaign; a file with others is not resumed
    resume : whether the records in the file are kept
    """

    def __init__(self, path: Path | None, settings: Mapping[str, Any], resume: bool) -> None:
        if resume and path is None:
            raise ConfigurationError("--resume goes on from the file that --json names; give one")
        self.path = path
        self.settings = {**settings, "config_hash": defaults.fingerprint()}
        self.records: list[dict[str, Any]] = []
        self._saved = time.monotonic()
        if path is not None:
            if resume:
                self.records = self._earlier(path)
            check_writable(path)

    @property
    def done(self) -> set[int]:
        """Indices of the runs that there are."""
        return {record["index"] for record in self.records}

    def add(self, record: dict[str, Any]) -> None:
        """Keep a record; on file from time to time."""
        self.records.append(record)
        if time.monotonic() - self._saved > CHECKPOINT:
            self.write({})
            self._saved = time.monotonic()

    def write(self, summary: Mapping[str, Any], table: str = "") -> None:
        """Write what there is."""
        if self.path is None:
            return
        self.records.sort(key=lambda record: record["index"])
        document = {
            **summary, "config": {**self.settings, "versions": versions()}, "runs": self.records
        }  # fmt: skip
        write_json(self.path, document)
        if table:
            self.path.with_suffix(".md").write_text(table + "\n", encoding="utf-8")

    def _earlier(self, path: Path) -> list[dict[str, Any]]:
        if not path.exists() or not path.stat().st_size:
            return []
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            found = {name: document["config"][name] for name in self.settings}
            runs: list[dict[str, Any]] = document["runs"]
            assert all(isinstance(run["index"], int) for run in runs)
        except (ValueError, KeyError, TypeError, AssertionError) as error:
            raise ConfigurationError(f"{str(path)!r} is no result of this campaign") from error
        for name, value in found.items():
            if value != self.settings[name]:
                raise ConfigurationError(
                    f"cannot resume {str(path)!r}: its {name} is {value!r}, now "
                    f"{self.settings[name]!r}"
                )
        return runs


def markdown(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def progress(items: Sequence[Any], unit: str) -> Iterator[Any]:
    """The items, with a bar where stderr is a terminal."""
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "cli") from error
    yield from tqdm(items, unit=unit, leave=False, disable=None)
