"""Rivals and ours behind one protocol: any of them can be driven by the same episode.

controller = method_named("graceful").controller(Setup.of(world, limits, lag))
run_episode(plant, sensor, controller, world, limits)
"""

from __future__ import annotations

from typing import Any

from benchmarks.baselines.graceful import GRACEFUL, GRACEFUL_RETRY
from benchmarks.baselines.method import Method, Range, Setup
from benchmarks.baselines.nmpc import MPC_CBF, NMPC, NMPC_STRONG
from benchmarks.baselines.ours import CLF_CBF, PAPER, PAPER_TUNED
from benchmarks.baselines.park_kuipers import PARK_KUIPERS
from benchmarks.baselines.polar import AICARDI, FEATURE_POLAR
from benchmarks.baselines.pursuit import PURE_PURSUIT
from clfcbf.errors import ConfigurationError

__all__ = ["METHODS", "Method", "Range", "Setup", "method_named"]

_ALL: tuple[Method[Any], ...] = (
    CLF_CBF, PAPER, PAPER_TUNED, NMPC, NMPC_STRONG, MPC_CBF, FEATURE_POLAR, GRACEFUL,
    GRACEFUL_RETRY, PARK_KUIPERS, AICARDI, PURE_PURSUIT,
)  # fmt: skip

METHODS: dict[str, Method[Any]] = {method.name: method for method in _ALL}
"""Every method by name, ours first."""


def method_named(name: str) -> Method[Any]:
    """The method of that name; ``ConfigurationError`` lists the valid ones."""
    if name not in METHODS:
        raise ConfigurationError(f"unknown method {name!r}; choose from {', '.join(METHODS)}")
    return METHODS[name]
