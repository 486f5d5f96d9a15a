"""What is known of every mutant: outcomes kept between runs, equivalents by reason, the score."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.mutation.mutants import Key, Mutant
from benchmarks.mutation.trial import Outcome
from clfcbf.errors import ConfigurationError

__all__ = ["Entry", "Tally", "digest", "entry", "equivalents", "remembered", "tally"]

EQUIVALENTS = Path(__file__).with_name("equivalents.toml")

Entry = dict[str, Any]


class Tally(NamedTuple):
    """Counts of one module, or of all."""

    mutants: int
    killed: int
    timeout: int
    equivalent: int
    survived: int

    @property
    def score(self) -> float:
        """Share of the mutants that are not equivalent which some test notices."""
        return (self.killed + self.timeout) / max(1, self.mutants - self.equivalent)


def tally(entries: Iterable[Entry]) -> Tally:
    """Count the outcomes."""
    statuses = [each["status"] for each in entries]
    return Tally(len(statuses), *(statuses.count(name) for name in Tally._fields[1:]))


def digest(texts: Iterable[str]) -> str:
    """Fingerprint of some texts."""
    found = hashlib.sha256()
    for text in texts:
        found.update(text.encode())
        found.update(b"\0")
    return found.hexdigest()[:16]


def entry(mutant: Mutant, outcome: Outcome, reason: str = "") -> Entry:
    """A mutant and its outcome as they are written down."""
    return {
        **mutant.key._asdict(),
        "number": mutant.number,
        "operator": mutant.operator,
        **outcome._asdict(),
        "reason": reason,
    }


def remembered(known: Mapping[str, Any], text: str, tests: str) -> dict[Key, Entry]:
    """Outcomes of an earlier run that still hold.

    All of them while neither module nor tests have changed; with other tests those that some
    test noticed; with another module none.
    """
    if known.get("text") != text:
        return {}
    settled = {"killed", "timeout"} | ({"survived"} if known.get("tests") == tests else set())
    return {
        Key(*(each[name] for name in Key._fields)): each
        for each in known["mutants"]
        if each["status"] in settled
    }


def equivalents(path: Path = EQUIVALENTS) -> dict[Key, str]:
    """Mutants that are the same program to everyone who calls it, and why.

    Raises
    ------
    ConfigurationError : an entry lacks its reason, or a mutant is there twice
    """
    found: dict[Key, str] = {}
    for group in tomllib.loads(path.read_text())["equivalent"]:
        reason = " ".join(group.get("reason", "").split())
        if not reason:
            raise ConfigurationError(f"an equivalent mutant needs a reason, got {group!r}")
        for line, mutant, *copy in _pairs(group["mutants"]):
            key = Key(group["module"], group["scope"], line, mutant, *copy)
            if key in found:
                raise ConfigurationError(f"listed twice as equivalent: {key}")
            found[key] = reason
    return found


def _pairs(mutants: Sequence[Sequence[Any]]) -> Sequence[Sequence[Any]]:
    for each in mutants:
        if len(each) not in (2, 3):
            raise ConfigurationError(
                f"a mutant is its line, the line it becomes, and a copy number, got {each!r}"
            )
    return mutants
