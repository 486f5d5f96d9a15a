"""What the node tells of itself: ``diagnostic_msgs/DiagnosticArray`` on ``/diagnostics``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum

from clfcbf.decision import Decision, Phase, Status
from clfcbf.ros2.messages import DiagnosticArray, DiagnosticStatus, Header, KeyValue
from clfcbf.ros2.stamps import Stamps
from clfcbf.ros2.target import TopicTarget
from clfcbf.ros2.transport import EVENTS, Transport
from clfcbf.runtime.statistics import LoopStatistics

__all__ = [
    "DIAGNOSTICS",
    "Diagnostics",
    "Level",
    "decision_status",
    "loop_status",
    "status_of",
    "target_status",
]

DIAGNOSTICS = "/diagnostics"
"""The one topic for the whole robot, whatever the namespace, that aggregators listen to."""

PERIOD = 1.0
"""[s] Between two reports, as monitors expect them; a change of level is told at once."""


class Level(IntEnum):
    """How bad it is; numbers as in the message."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


_LEVELS = {
    Status.BARRIER_RELAXED: Level.WARN,
    Status.BRAKING: Level.WARN,
    Status.STALE: Level.WARN,
    Status.NO_TARGET: Level.WARN,
    Status.OUT_OF_VIEW: Level.WARN,
    Status.INVALID_INPUT: Level.ERROR,
    Status.CLOCK_ERROR: Level.ERROR,
    Status.SOLVER_FAILED: Level.ERROR,
    Status.INTERNAL_ERROR: Level.ERROR,
}
"""Of the statuses that are not well."""


def status_of(level: Level, part: str, message: str, **values: object) -> DiagnosticStatus:
    """How a part is doing; floats are shortened, for people read them."""
    shown = tuple(KeyValue(name, _shown(value)) for name, value in values.items())
    return DiagnosticStatus(int(level), f"docking: {part}", message, "clfcbf", shown)


def _shown(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def decision_status(decision: Decision) -> DiagnosticStatus:
    """What the last tick decided."""
    failed = decision.phase is Phase.FAILED
    level = Level.ERROR if failed else _LEVELS.get(decision.status, Level.OK)
    phase = "" if decision.phase is None else decision.phase.value
    return status_of(
        level, "controller", decision.reason or decision.status.value,
        status=decision.status.value, phase=phase, certified=decision.certified,
        v=decision.twist.v, omega=decision.twist.omega, clearance=decision.clearance,
        slack=decision.slack, barrier_slack=decision.barrier_slack,
        events=", ".join(event.value for event in decision.events),
        failure="" if decision.failure is None else decision.failure.value,
    )  # fmt: skip


def target_status(target: TopicTarget, now: float, since: Mapping[str, int]) -> DiagnosticStatus:
    """What came of the target, and what was ignored: a warning where any was since last time."""
    counts = {refusal.value.replace(" ", "_"): n for refusal, n in target.counts.items()}
    grown = any(n > since.get(name, 0) for name, n in counts.items())
    age = now - target.latest if math.isfinite(target.latest) else math.nan
    if grown:
        level, message = Level.WARN, f"ignored: {target.complaint}"
    elif target.sources() == 0:
        level, message = Level.WARN, "nobody publishes poses of the dock"
    else:
        level, message = Level.OK, "poses are taken" if target.accepted else "nothing seen yet"
    return status_of(
        level, "detection", message, publishers=target.sources(), accepted=target.accepted,
        age=age, **counts,
    )  # fmt: skip


def loop_status(statistics: LoopStatistics) -> DiagnosticStatus:
    """How regular the ticks were."""
    level = Level.WARN if statistics.missed else Level.OK
    message = f"{statistics.missed} of {statistics.ticks} deadlines missed"
    spread = {
        f"{name}_{quantile}": getattr(getattr(statistics, name), quantile)
        for name in ("period", "lateness", "latency", "solve")
        for quantile in ("p50", "p99", "worst")
    }
    return status_of(
        level, "loop", message, ticks=statistics.ticks, missed=statistics.missed,
        skipped=statistics.skipped, fresh=statistics.fresh, stale=statistics.stale,
        repeated=statistics.repeated, **spread,
    )  # fmt: skip


class Diagnostics:
    """Publishes the statuses of all parts together, once a second and where a level changes.

    Parameters
    ----------
    transport : that carries the messages
    stamps : for the header
    """

    def __init__(self, transport: Transport, stamps: Stamps) -> None:
        self._publisher = transport.publisher(DiagnosticArray, DIAGNOSTICS, EVENTS)
        self._stamps = stamps
        self._told_at = -math.inf
        self._levels: tuple[int, ...] = ()

    def due(self, now: float, *levels: Level) -> bool:
        """Whether it is time for a report [s], or these levels are news."""
        return now - self._told_at >= PERIOD or (bool(levels) and levels != self._levels)

    def tell(self, now: float, *statuses: DiagnosticStatus, levels: tuple[Level, ...] = ()) -> None:
        """Publish a report; ``levels`` are what the next ``due`` compares with."""
        self._told_at, self._levels = now, levels
        self._publisher.publish(DiagnosticArray(Header(self._stamps.now()), statuses))
