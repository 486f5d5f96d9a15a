"""The examination as plain text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clfcbf.doctor.examination import Examination
from clfcbf.doctor.packages import Package

__all__ = ["table"]

_WIDEST = 44
"""Characters of a column; a longer licence or error is cut, the problems at the end are not."""


def table(examination: Examination) -> str:
    """System, packages, backends, timings and problems, aligned."""
    system = examination.system
    lines = [
        f"clfcbf {system['clfcbf']}, {system['implementation']} {system['python']} "
        f"on {system['platform']}, {system['usable_cores']} of {system['cores']} cores usable",
        f"numpy {system['numpy']} with {system['blas']}, BLAS threads: {system['blas_threads']}",
        "",
        *_aligned(
            ("package", "version", "licence", "extra", "imports"),
            [_package(package) for package in examination.packages],
        ),
        "",
        *_aligned(
            (
                "backend",
                "variables",
                "P singular",
                "multipliers",
                "median",
                "|u - exact|",
                "agrees",
            ),
            [_backend(record) for record in examination.backends],
        ),
        "",
        *_aligned(
            ("timing", "median", "of"),
            [(r["name"], _microseconds(r), str(r["solves"] or "")) for r in examination.timings],
        ),
        "",
    ]
    if not examination.problems:
        return "\n".join([*lines, "no problems found"])
    return "\n".join([*lines, "problems:", *(f"  {text}" for text in examination.problems)])


def _package(package: Package) -> tuple[str, ...]:
    state = "yes" if not package.error else package.error
    version = package.version or "-"
    licence = package.licence or "-"
    extra = package.extra or ("required" if package.required else "-")
    return package.name, version, licence, extra, state


def _backend(record: dict[str, Any]) -> tuple[str, ...]:
    if record["error"]:
        return record["name"], "-", "-", "-", "-", "-", record["error"]
    distance = record["distance"]
    return (
        record["name"],
        "any" if record["max_variables"] is None else str(record["max_variables"]),
        _yes(record["semidefinite"]),
        "its own" if record["multipliers"] else "computed here",
        _microseconds(record),
        "-" if distance is None else f"{distance:.1e}",
        _yes(record["agrees"]),
    )


def _yes(flag: bool) -> str:
    return "yes" if flag else "no"


def _microseconds(record: dict[str, Any]) -> str:
    return "-" if record["median_us"] is None else f"{record['median_us']:.1f} us"


def _aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    cut = [[cell if len(cell) <= _WIDEST else cell[: _WIDEST - 3] + "..." for cell in row]
           for row in (head, *rows)]  # fmt: skip
    widths = [max(map(len, column)) for column in zip(*cut, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in cut
    ]
