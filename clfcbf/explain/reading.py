"""A decision from JSON, checked field by field, for a file may come from anywhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from enum import Enum
from typing import Any, TypeVar

from clfcbf.constraints.rows import Priority, Row, Rows
from clfcbf.decision import Decision, Phase, Status
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.guard import Verdict
from clfcbf.limits import InputBox, Limits
from clfcbf.qp.exact import BackendHealth, LexicographicSolution, check_weight
from clfcbf.se2 import Twist

__all__ = ["decision_from_json", "decisions_in"]

E = TypeVar("E", bound=Enum)
T = TypeVar("T")

_NOT_FINITE = ("nan", "inf", "-inf")


def decision_from_json(content: object) -> Decision:
    """The decision that :func:`decision_to_json` made ``content`` of.

    Fields that a :class:`Decision` has defaults for may be missing.

    Raises
    ------
    ConfigurationError : a field is missing, unknown or not what it should be; the message
        names it
    """
    given = _object(content, "decision", tuple(_READERS), _REQUIRED)
    return Decision(
        **{key: _READERS[key](value, f"decision.{key}") for key, value in given.items()}
    )


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


# Each reader takes a value and the name of its field ------------------------------------------


def _refuse(field: str, expected: str, value: object) -> ConfigurationError:
    return ConfigurationError(f"{field} must be {expected}, got {value!r}")


def _float(value: object, field: str) -> float:
    if isinstance(value, str) and value in _NOT_FINITE:
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _refuse(field, f"a number or one of {_NOT_FINITE}", value)
    try:
        return float(value)
    except OverflowError as error:
        raise _refuse(field, "a number that a float can hold", value) from error


def _integer(value: object, field: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _refuse(field, "an integer", value)
    return value


def _flag(value: object, field: str) -> bool:
    if not isinstance(value, bool):
        raise _refuse(field, "true or false", value)
    return value


def _text(value: object, field: str) -> str:
    if not isinstance(value, str):
        raise _refuse(field, "a string", value)
    return value


def _list(
    read: Callable[[object, str], T], length: int | None = None
) -> Callable[[object, str], tuple[T, ...]]:
    def reader(value: object, field: str) -> tuple[T, ...]:
        if not isinstance(value, list) or length not in (None, len(value)):
            size = "" if length is None else f" of {length} entries"
            raise _refuse(field, f"a list{size}", value)
        return tuple(read(item, f"{field}[{index}]") for index, item in enumerate(value))

    return reader


def _member(kind: type[E]) -> Callable[[object, str], E]:
    def reader(value: object, field: str) -> E:
        for member in kind:
            if member.value == value:
                return member
        choices = ", ".join(repr(member.value) for member in kind)
        raise _refuse(field, f"one of {choices}", value)

    return reader


def _optional(read: Callable[[object, str], T]) -> Callable[[object, str], T | None]:
    return lambda value, field: None if value is None else read(value, field)


def _object(
    value: object, field: str, known: tuple[str, ...], required: tuple[str, ...]
) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise _refuse(field, "an object", value)
    for key in value:
        if key not in known:
            raise ConfigurationError(f"{field} has no field {key!r}; it has: {', '.join(known)}")
    for key in required:
        if key not in value:
            raise ConfigurationError(f"{field}.{key} is missing")
    return value


def _read_twist(value: object, field: str) -> Twist:
    return Twist(*_list(_float, 2)(value, field))


def _read_row(value: object, field: str) -> Row:
    a, c, b = _list(_float, 3)(value, field)
    return a, c, b


def _read_rows(value: object, field: str) -> Rows:
    given = _object(value, field, Rows._fields, Rows._fields)
    names = _list(_text)(given["names"], f"{field}.names")
    coefficients = _list(_read_row, len(names))(given["coefficients"], f"{field}.coefficients")
    level = _integer(given["priority"], f"{field}.priority")
    values = _list(_float, len(names))(given["values"], f"{field}.values")
    known = {int(priority): priority for priority in Priority}
    return Rows(names, coefficients, known.get(level, level), values)


def _read_box(value: object, field: str) -> InputBox:
    return InputBox(*_list(_float, 4)(value, field))


def _read_weight(value: object, field: str) -> tuple[float, float, float]:
    try:
        return check_weight(_list(_float, 3)(value, field))
    except ConfigurationError as error:
        raise ConfigurationError(f"{field}: {error}") from error


def _read_health(value: object, field: str) -> BackendHealth:
    given = _object(value, field, BackendHealth._fields, BackendHealth._fields)
    return BackendHealth(
        _text(given["backend"], f"{field}.backend"),
        _flag(given["used"], f"{field}.used"),
        _text(given["status"], f"{field}.status"),
        _float(given["distance"], f"{field}.distance"),
        _text(given["note"], f"{field}.note"),
    )


def _read_answer(value: object, field: str) -> LexicographicSolution:
    names = LexicographicSolution._fields
    given = _object(value, field, names, names)
    return LexicographicSolution(
        _float(given["v"], f"{field}.v"),
        _float(given["omega"], f"{field}.omega"),
        _list(_float)(given["slacks"], f"{field}.slacks"),
        _list(_integer)(given["violated"], f"{field}.violated"),
        _flag(given["rational"], f"{field}.rational"),
        _optional(_read_health)(given["health"], f"{field}.health"),
    )


def _read_limits(value: object, field: str) -> Limits:
    names = tuple(entry.name for entry in fields(Limits))
    given = _object(value, field, names, names)
    numbers = {name: _float(given[name], f"{field}.{name}") for name in names}
    try:
        return Limits(**numbers)
    except ClfcbfError as error:
        raise ConfigurationError(f"{field}: {error}") from error


_REQUIRED = ("twist", "status", "certified", "nominal", "clearance")

_READERS: dict[str, Callable[[object, str], Any]] = {
    "twist": _read_twist,
    "status": _member(Status),
    "certified": _flag,
    "nominal": _read_twist,
    "clearance": _float,
    "slack": _float,
    "barrier_slack": _float,
    "rows": _list(_read_rows),
    "box": _read_box,
    "done": _flag,
    "phase": _optional(_member(Phase)),
    "reason": _text,
    "timing": _float,
    "weight": _optional(_read_weight),
    "answer": _optional(_read_answer),
    "verdict": _optional(_member(Verdict)),
    "limits": _optional(_read_limits),
}
