"""A tick saved as JSON: a decision, or a list of them."""

from __future__ import annotations

from typing import Any

from clfcbf.constraints.rows import Priority, Rows
from clfcbf.decision import Decision
from clfcbf.errors import ConfigurationError
from clfcbf.explain.codec import reader, writer
from clfcbf.limits import InputBox
from clfcbf.qp.exact import check_weight

__all__ = ["decision_from_json", "decision_to_json", "decisions_in"]

_LEVELS = {int(priority): priority for priority in Priority}


def decision_to_json(decision: Decision) -> dict[str, Any]:
    """The decision as what ``json.dumps(..., allow_nan=False)`` takes.

    :func:`decision_from_json` gives it back with every float to the last bit. Write one to a
    file, or a list of them, and ``clfcbf explain FILE`` explains it.
    """
    content: dict[str, Any] = writer(Decision)(decision)
    return content


def decision_from_json(content: object) -> Decision:
    """The decision that :func:`decision_to_json` made ``content`` of.

    Fields that a :class:`Decision` has defaults for may be missing.

    Raises
    ------
    ConfigurationError : a field is missing, unknown or not what it should be; the message
        names it
    """
    decision: Decision = reader(Decision)(content, "decision")
    if decision.weight is not None:
        try:
            check_weight(decision.weight)
        except ConfigurationError as error:
            raise ConfigurationError(f"decision.weight: {error}") from error
    blocks = tuple(
        _checked(block, f"decision.rows[{index}]") for index, block in enumerate(decision.rows)
    )
    return decision._replace(rows=blocks, box=InputBox(*decision.box))


def decisions_in(content: object) -> list[Decision]:
    """The decisions of a file's content: one, or a list of them.

    Raises
    ------
    ConfigurationError : as :func:`decision_from_json`; the message says which of the list
    """
    if not isinstance(content, list):
        return [decision_from_json(content)]
    found: list[Decision] = []
    for index, item in enumerate(content):
        try:
            found.append(decision_from_json(item))
        except ConfigurationError as error:
            raise ConfigurationError(f"tick {index}: {error}") from error
    return found


def _checked(block: Rows, field: str) -> Rows:
    """The block with its priority as a :class:`Priority`, if its parts are of one length."""
    count = len(block.names)
    for name in ("coefficients", "values"):
        length = len(getattr(block, name))
        if length != count:
            raise ConfigurationError(
                f"{field}.{name} must have one entry for each of the {count} names, got {length}"
            )
    return block._replace(priority=_LEVELS.get(block.priority, block.priority))
