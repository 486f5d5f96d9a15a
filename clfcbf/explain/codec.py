"""Typed records (named tuples, dataclasses, enumerations) as JSON and back, to the last bit.

Both ways follow the annotations, so a field that is added to a record is saved and read without
a word here. JSON has no number for what is not finite: those are the strings ``"nan"``, ``"inf"``
and ``"-inf"``. What is read is checked field by field, for a file may come from anywhere.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
from collections.abc import Callable
from enum import Enum
from typing import Any, Union, get_args, get_origin, get_type_hints

from clfcbf.errors import ClfcbfError, ConfigurationError

__all__ = ["Reader", "Writer", "reader", "writer"]

Reader = Callable[[object, str], Any]
"""Takes what JSON gave and the name of its field; raises ConfigurationError."""

Writer = Callable[[Any], Any]

_NOT_FINITE = ("nan", "inf", "-inf")


@functools.cache
def writer(hint: Any) -> Writer:
    """The function that turns a value of type ``hint`` into what JSON can hold."""
    if hint is float:
        return _write_float
    if hint in (int, bool, str):
        return hint  # type: ignore[no-any-return]
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        inner = writer(_not_none(arguments))
        return lambda value: None if value is None else inner(value)
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            item = writer(arguments[0])
            return lambda values: [item(value) for value in values]
        items = [writer(argument) for argument in arguments]
        return lambda values: [write(v) for write, v in zip(items, values, strict=True)]
    if issubclass(hint, Enum):
        return lambda member: member.value
    fields = {name: writer(kind) for name, (kind, _) in _fields(hint).items()}
    return lambda record: {name: write(getattr(record, name)) for name, write in fields.items()}


@functools.cache
def reader(hint: Any) -> Reader:
    """The function that reads a value of type ``hint``; fields with a default may be missing."""
    if hint in _PLAIN:
        return _PLAIN[hint]
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        inner = reader(_not_none(arguments))
        return lambda value, field: None if value is None else inner(value, field)
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return _reader_of_list(reader(arguments[0]))
        return _reader_of_tuple(tuple(reader(argument) for argument in arguments))
    if issubclass(hint, Enum):
        return _reader_of_member(hint)
    return _reader_of_record(hint)


def _not_none(arguments: tuple[Any, ...]) -> Any:
    (kind,) = (argument for argument in arguments if argument is not type(None))
    return kind


def _fields(kind: type[Any]) -> dict[str, tuple[Any, bool]]:
    """Type of each field of a record, and whether it has to be given."""
    hints = get_type_hints(kind)
    if dataclasses.is_dataclass(kind):
        return {
            field.name: (hints[field.name], field.default is dataclasses.MISSING)
            for field in dataclasses.fields(kind)
            if field.init
        }
    defaults = kind._field_defaults
    return {name: (hints[name], name not in defaults) for name in kind._fields}


def _write_float(value: float) -> float | str:
    value = float(value)
    return value if math.isfinite(value) else str(value)


def _refuse(field: str, expected: str, value: object) -> ConfigurationError:
    return ConfigurationError(f"{field} must be {expected}, got {value!r}")


def _read_float(value: object, field: str) -> float:
    if isinstance(value, str) and value in _NOT_FINITE:
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _refuse(field, f"a number or one of {_NOT_FINITE}", value)
    try:
        return float(value)
    except OverflowError as error:
        # An integer of so many digits is not repeated: Python refuses to print some.
        raise ConfigurationError(f"{field} must be a number that a float can hold") from error


def _read_int(value: object, field: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _refuse(field, "an integer", value)
    return value


def _read_bool(value: object, field: str) -> bool:
    if not isinstance(value, bool):
        raise _refuse(field, "true or false", value)
    return value


def _read_str(value: object, field: str) -> str:
    if not isinstance(value, str):
        raise _refuse(field, "a string", value)
    return value


_PLAIN: dict[Any, Reader] = {
    float: _read_float,
    int: _read_int,
    bool: _read_bool,
    str: _read_str,
}


def _reader_of_list(read: Reader) -> Reader:
    def read_list(value: object, field: str) -> tuple[Any, ...]:
        if not isinstance(value, list):
            raise _refuse(field, "a list", value)
        return tuple(read(item, f"{field}[{index}]") for index, item in enumerate(value))

    return read_list


def _reader_of_tuple(readers: tuple[Reader, ...]) -> Reader:
    def read_tuple(value: object, field: str) -> tuple[Any, ...]:
        if not isinstance(value, list) or len(value) != len(readers):
            raise _refuse(field, f"a list of {len(readers)} entries", value)
        pairs = enumerate(zip(readers, value, strict=True))
        return tuple(read(item, f"{field}[{index}]") for index, (read, item) in pairs)

    return read_tuple


def _reader_of_member(kind: type[Enum]) -> Reader:
    choices = ", ".join(repr(member.value) for member in kind)

    def read_member(value: object, field: str) -> Enum:
        for member in kind:
            if member.value == value:
                return member
        raise _refuse(field, f"one of {choices}", value)

    return read_member


def _reader_of_record(kind: type[Any]) -> Reader:
    fields = {name: (reader(hint), needed) for name, (hint, needed) in _fields(kind).items()}

    def read_record(value: object, field: str) -> Any:
        if not isinstance(value, dict):
            raise _refuse(field, "an object", value)
        for key in value:
            if key not in fields:
                known = ", ".join(fields)
                raise ConfigurationError(f"{field} has no field {key!r}; it has: {known}")
        given: dict[str, Any] = {}
        for name, (read, needed) in fields.items():
            if name in value:
                given[name] = read(value[name], f"{field}.{name}")
            elif needed:
                raise ConfigurationError(f"{field}.{name} is missing")
        try:
            return kind(**given)
        except ClfcbfError as error:  # the record's own checks
            raise ConfigurationError(f"{field}: {error}") from error

    return read_record
