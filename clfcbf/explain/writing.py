"""A decision as JSON, to the last bit.

JSON has no number for what is not finite, so those are the strings ``"nan"``, ``"inf"`` and
``"-inf"``.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from clfcbf.decision import Decision
from clfcbf.qp.exact import LexicographicSolution

__all__ = ["decision_to_json"]


def decision_to_json(decision: Decision) -> dict[str, Any]:
    """The decision as what ``json.dumps(..., allow_nan=False)`` takes.

    :func:`decision_from_json` gives it back with every float to the last bit. Write one to a
    file, or a list of them, and ``clfcbf explain FILE`` explains it.
    """
    answer, limits = decision.answer, decision.limits
    return {
        "twist": _numbers(decision.twist),
        "status": decision.status.value,
        "certified": bool(decision.certified),
        "nominal": _numbers(decision.nominal),
        "clearance": _number(decision.clearance),
        "slack": _number(decision.slack),
        "barrier_slack": _number(decision.barrier_slack),
        "rows": [
            {
                "names": list(block.names),
                "coefficients": [_numbers(row) for row in block.coefficients],
                "priority": int(block.priority),
                "values": _numbers(block.values),
            }
            for block in decision.rows
        ],
        "box": _numbers(decision.box),
        "done": bool(decision.done),
        "phase": None if decision.phase is None else decision.phase.value,
        "reason": decision.reason,
        "timing": _number(decision.timing),
        "weight": None if decision.weight is None else _numbers(decision.weight),
        "answer": None if answer is None else _answer(answer),
        "verdict": None if decision.verdict is None else decision.verdict.value,
        "limits": None if limits is None else {k: _number(x) for k, x in asdict(limits).items()},
    }


def _number(value: float) -> float | str:
    value = float(value)
    return value if math.isfinite(value) else str(value)


def _numbers(values: tuple[float, ...]) -> list[float | str]:
    return [_number(value) for value in values]


def _answer(answer: LexicographicSolution) -> dict[str, Any]:
    health = answer.health
    return {
        "v": _number(answer.v),
        "omega": _number(answer.omega),
        "slacks": _numbers(answer.slacks),
        "violated": list(answer.violated),
        "rational": bool(answer.rational),
        "health": None
        if health is None
        else {**health._asdict(), "used": bool(health.used), "distance": _number(health.distance)},
    }
