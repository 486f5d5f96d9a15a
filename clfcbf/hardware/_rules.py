"""How a set of rules is put to an adapter: each rule alone, on a fresh one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any, Generic, TypeVar

from clfcbf.errors import ConfigurationError

__all__ = [
    "PROMPT",
    "BrokenRuleError",
    "ConformanceReport",
    "Failure",
    "Rule",
    "check_rules",
    "prompt",
]

PROMPT = 0.005
"""[s] A call that takes no longer returned without waiting: a sixth of a period at 30 Hz."""

_CALLS = 9
"""Calls whose median is timed: one that the scheduler interrupted does not count."""

_T = TypeVar("_T")


class BrokenRuleError(Exception):
    """A rule that an adapter does not keep; the text says how."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A rule by name, and how it was broken."""

    rule: str
    reason: str


@dataclass(frozen=True, slots=True)
class ConformanceReport:
    """What an adapter was asked, and what it failed.

    Attributes
    ----------
    subject : what was checked
    rules : names of all rules that were put to it
    failures : those it broke
    """

    subject: str
    rules: tuple[str, ...]
    failures: tuple[Failure, ...]

    @property
    def passed(self) -> bool:
        """Whether every rule was kept."""
        return not self.failures

    def require(self) -> None:
        """Raise ``AssertionError`` with the whole report unless every rule was kept."""
        if self.failures:
            raise AssertionError(str(self))

    def __str__(self) -> str:
        if self.passed:
            return f"{self.subject}: all {len(self.rules)} rules kept"
        broken = [f"  {failure.rule}: {failure.reason}" for failure in self.failures]
        return "\n".join(
            [f"{self.subject}: {len(broken)} of {len(self.rules)} rules broken", *broken]
        )


@dataclass(frozen=True, slots=True)
class Rule(Generic[_T]):
    """A rule: its name, and what raises ``BrokenRuleError`` where a subject does not keep it."""

    name: str
    check: Callable[[_T], None]


def check_rules(
    subject: str, make: Callable[[], Any], protocol: type[Any], rules: Sequence[Rule[Any]]
) -> ConformanceReport:
    """Put every rule to an adapter of its own; an exception breaks the rule it came from.

    Raises
    ------
    ConfigurationError : ``make`` is not callable
    """
    if not callable(make):
        raise ConfigurationError(
            f"make must be a callable that returns a fresh {protocol.__name__}, got {make!r}"
        )
    failures: list[Failure] = []
    for rule in rules:
        try:
            with _made(make) as adapter:
                if not isinstance(adapter, protocol):
                    raise BrokenRuleError(
                        f"{type(adapter).__name__} lacks a method of {protocol.__name__}"
                    )
                rule.check(adapter)
        except BrokenRuleError as broken:
            failures.append(Failure(rule.name, str(broken)))
        except Exception as error:  # an adapter may raise whatever it likes
            failures.append(Failure(rule.name, f"raised {type(error).__name__}: {error}"))
    return ConformanceReport(subject, tuple(rule.name for rule in rules), tuple(failures))


@contextmanager
def _made(make: Callable[[], Any]) -> Iterator[Any]:
    """A fresh adapter, closed afterwards where it can be."""
    adapter = make()
    try:
        yield adapter
    finally:
        close = getattr(adapter, "close", None)
        if callable(close):
            close()


def prompt(what: str, call: Callable[[], object], longest: float) -> None:
    """Raise unless ``call`` returns within ``longest`` [s], by the median of several calls."""
    durations = []
    for _ in range(_CALLS):
        begun = time.perf_counter()
        call()
        durations.append(time.perf_counter() - begun)
    if median(durations) > longest:
        raise BrokenRuleError(
            f"{what} took {1e3 * median(durations):.1f} ms, longer than {1e3 * longest:.1f} ms"
        )
