"""Configuration files of robots and of docks: broken text, and sound text that says nonsense."""

from __future__ import annotations

import functools
import json
import math
import time
import tomllib
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.robot.broken import BrokenError, HungError
from benchmarks.robot.mutation import Path, mutated_bytes, mutated_tree
from clfcbf.config import findings, parse_config, template, to_toml
from clfcbf.config.schema import SECTIONS
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.session import parse_docks

__all__ = ["check", "toml"]

LIMIT = 1.0
"""[s] For reading one file and looking at it; the machine may be shared."""

BUILT = 0.05
"""Share of the files taken whose controller is built too: that takes a tenth of a second."""

DOCKS = """
[types.charger]
staging_offset = [-1.0, 0.0, 0.1]
backoff = 0.3
contact = true
confirm = true

[types.conveyor]

[docks.kitchen]
type = "charger"
pose = [3.1, 0.4, 1.5]
frame = "hall"
id = "42"

[docks.belt]
type = "conveyor"
pose = [0, 0, 0]
"""

_NAMES = {name for section in SECTIONS for name in (section.name, *section.names)}


@functools.cache
def _bases() -> tuple[tuple[str, dict[str, Any]], ...]:
    """Sound files: the template as it stands, and one with every key there is."""
    small = template()
    whole = to_toml(parse_config(small))
    return tuple((text, tomllib.loads(text)) for text in (small, whole))


def check(rng: np.random.Generator) -> Counter[str]:
    """One file, read as a robot's or as one of docks."""
    if rng.random() < 0.25:
        return _check(rng, DOCKS, tomllib.loads(DOCKS), parse_docks, _docks_taken)
    bases = _bases()
    text, tree = bases[int(rng.integers(len(bases)))]
    return _check(rng, text, tree, parse_config, functools.partial(_config_taken, rng))


def _check(
    rng: np.random.Generator, text: str, tree: dict[str, Any], parse: Callable[[str], Any],
    taken: Callable[[Any], None],
) -> Counter[str]:  # fmt: skip
    touched: list[Path] | None = None
    if rng.random() < 0.35:
        text = mutated_bytes(rng, text.encode()).decode("utf-8", "replace")
    else:
        changed, touched = mutated_tree(rng, tree, 2)
        text = toml(changed)
    begun = time.perf_counter()
    try:
        made = parse(text)
        outcome = "taken"
        taken(made)
    except ConfigurationError as error:
        outcome = "refused" if not str(error).startswith("not TOML") else "not TOML"
        if touched is not None and not _names_one(str(error), touched):
            raise _broken(f"names no key of {touched}: {error}", text) from error
    except HungError as hung:
        raise _broken("it hangs", text) from hung
    except BrokenError as broken:
        raise _broken(str(broken), text) from broken
    except Exception as error:
        raise _broken(f"{type(error).__name__}: {error}", text) from error
    duration = time.perf_counter() - begun
    if duration > LIMIT and outcome != "taken":
        raise _broken(f"took {duration:.2f} s", text)
    return Counter([outcome])


def _names_one(message: str, touched: list[Path]) -> bool:
    """Whether the message names something that was changed, or what misses what was removed."""
    words = [str(part).removesuffix("x").removesuffix("_deg") for path in touched for part in path]
    missing = [word[1:] for word in words if len(word) > 2]  # renamed by its first letter
    if any(word in message for word in (*words, *missing)):
        return True
    return "types" in words and "type must be one of" in message  # of the docks of such a type


def _config_taken(rng: np.random.Generator, config: Any) -> None:
    found = findings(config)
    if parse_config(to_toml(config)) != config:
        raise BrokenError("written and read again it is another", b"")
    if rng.random() < BUILT and all(f.severity.value != "wrong" for f in found):
        try:
            config.controller()
        except ClfcbfError as error:
            if not any(name in str(error) for name in _NAMES):
                raise BrokenError(f"the controller's refusal names no key: {error}", b"") from error


def _docks_taken(docks: Any) -> None:
    for dock in docks.docks.values():
        if not all(map(math.isfinite, (*dock.staging_pose, dock.undocking_distance))):
            raise BrokenError(f"a dock with the staging pose {dock.staging_pose} was taken", b"")


def _broken(why: str, text: str) -> BrokenError:
    return BrokenError(why, text.encode("utf-8", "surrogatepass"))


def toml(tree: dict[str, Any]) -> str:
    """A tree as TOML; what TOML has not (None) is left out."""
    lines: list[str] = []
    plain = {key: value for key, value in tree.items() if not isinstance(value, dict)}
    lines += [f"{_key(key)} = {_value(value)}" for key, value in plain.items() if value is not None]
    for name, table in tree.items():
        if not isinstance(table, dict):
            continue
        lines.append(f"[{_key(name)}]")
        lines += [
            f"{_key(key)} = {_value(value)}" for key, value in table.items() if value is not None
        ]
    return "\n".join(lines) + "\n"


def _key(name: object) -> str:
    return json.dumps(str(name))


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return "nan" if math.isnan(value) else repr(value)
    if isinstance(value, int):
        return repr(value) if abs(value) < 1 << 70 else "1" + "0" * 400
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value if item is not None)}]"
    if isinstance(value, dict):
        inner = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None)
        return f"{{{inner}}}"
    return '""'
