"""The packages that this library and its extras use: version, licence, and whether they import."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from typing import NamedTuple

from clfcbf.doctor.probe import TIME_LIMIT, probe

__all__ = ["Package", "check_packages", "licence_of"]

_ALSO = {"elastiqp": "bench", "piqp": "", "quadprog": ""}
"""Used where present by packages of ours, and the extra that brings them along."""

_MODULES = {"mujoco-core": "mujoco"}
"""Packages that are imported under another name than they are installed under."""

_COLLECTIONS = ("all", "test", "dev")
"""Extras that only repeat others, or that users do not need."""

_LONGEST_LICENCE = 40
"""Characters; what is longer is the text of a licence, not its name."""

_IMPORT = "import importlib, sys; importlib.import_module(sys.argv[1])"


class Package(NamedTuple):
    """One package.

    Attributes
    ----------
    name, module : as it is installed, and as it is imported
    extra : of this library that brings it; empty for what comes without one, or not at all
    required : whether it comes without an extra
    version, licence : from its metadata; empty where it is not installed
    error : why it cannot be imported, ``"not installed"`` where it is not; empty where it can
    """

    name: str
    module: str
    extra: str
    required: bool
    version: str
    licence: str
    error: str

    @property
    def installed(self) -> bool:
        """Whether it has a version."""
        return bool(self.version)


def check_packages(more: Iterable[str] = (), time_limit: float = TIME_LIMIT) -> list[Package]:
    """Every package that this library, its extras and its backends use, by name.

    Each one installed is imported in an interpreter of its own.

    Parameters
    ----------
    more : further names, such as those that backends ask for
    time_limit : for one import [s]
    """
    ours = _requirements()
    wanted = {**dict.fromkeys(more, ""), **_ALSO, **ours}
    required = {name for name, extra in ours.items() if not extra}

    def check(name: str) -> Package:
        return _checked(name, wanted[name], name in required, time_limit)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(check, sorted(wanted)))


def _requirements() -> dict[str, str]:
    """Names to extras, from this library's own metadata; the first extra that brings each."""
    found: dict[str, str] = {}
    for line in metadata.requires("clfcbf") or []:
        name = re.match(r"[\w.-]*", line)
        marker = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
        extra = marker.group(1) if marker else ""
        if name and name.group() != "clfcbf" and extra not in _COLLECTIONS:
            found.setdefault(name.group(), extra)
    return found


def _checked(name: str, extra: str, required: bool, time_limit: float) -> Package:
    module = _MODULES.get(name, name.replace("-", "_"))
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Package(name, module, extra, required, "", "", "not installed")
    error = probe(_IMPORT, module, time_limit=time_limit).error
    return Package(name, module, extra, required, version, licence_of(name), error)


def licence_of(name: str) -> str:
    """Licence of an installed package from its metadata, the most exact field first.

    Raises
    ------
    importlib.metadata.PackageNotFoundError : it is not installed
    """
    about = metadata.metadata(name)
    for expression in about.get_all("License-Expression") or []:
        return str(expression)
    text = "\n".join(about.get_all("License") or [])
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    classified: list[str] = [
        entry.rpartition(" :: ")[2]
        for entry in about.get_all("Classifier") or []
        if entry.startswith("License ::") and entry != "License :: OSI Approved"
    ]
    if len(lines) == 1 and (len(lines[0]) <= _LONGEST_LICENCE or not classified):
        return lines[0]
    named = [line for line in lines if "licen" in line.lower()]
    return ", ".join(classified or named[:1] or lines[:1]) or "not stated"
