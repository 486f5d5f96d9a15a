"""A tick explained: in one sentence, or as a dictionary for JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from clfcbf.explain.findings import Findings, LimitReport, RowReport
from clfcbf.explain.words import sentence_of
from clfcbf.qp.exact import BackendHealth
from clfcbf.se2 import Twist

__all__ = ["Explanation", "LimitReport", "RowReport"]


@dataclass(frozen=True, slots=True)
class Explanation(Findings):
    """Why a tick sent what it sent; ``str()`` is one sentence.

    Attributes
    ----------
    All of :class:`clfcbf.explain.findings.Findings`.
    """

    def sentence(self) -> str:
        """All of it in one sentence."""
        return sentence_of(self)

    def __str__(self) -> str:
        return self.sentence()

    def to_dict(self) -> dict[str, Any]:
        """For JSON: numbers that are not finite become None."""
        conflict = None
        if self.conflict is not None:
            conflict = {
                "members": [member.name for member in self.conflict.members],
                "gave_way": [member.name for member in self.conflict.soft],
                "short": _number(self.conflict.short),
                "short_by": {n: _number(x) for n, x in self.conflict.shortfalls.items()},
            }
        return {
            "sentence": self.sentence(),
            "status": self.status.value,
            "phase": None if self.phase is None else self.phase.value,
            "reason": self.reason,
            "done": self.done,
            "certified": self.certified,
            "clearance": _number(self.clearance),
            "nominal": _twist(self.nominal),
            "answer": None if self.answer is None else _twist(self.answer),
            "sent": _twist(self.sent),
            "guard": None if self.verdict is None else self.verdict.value,
            "active": [row.name for row in self.active_rows]
            + [limit.name for limit in self.active_limits],
            "rows": [_record(row) for row in self.rows],
            "limits": [_record(limit) for limit in self.limits],
            "slack": _number(self.slack),
            "barrier_slack": _number(self.barrier_slack),
            "conflict": conflict,
            "backend": None if self.backend is None else _record(self.backend),
        }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _twist(twist: Twist) -> dict[str, float | None]:
    return {"v": _number(twist[0]), "omega": _number(twist[1])}


def _record(record: RowReport | LimitReport | BackendHealth) -> dict[str, Any]:
    return {
        key: _number(value) if isinstance(value, float) else value
        for key, value in record._asdict().items()
    }
