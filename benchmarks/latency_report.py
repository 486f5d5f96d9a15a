"""The latency benchmark's figures as text."""

from __future__ import annotations

from typing import Any

__all__ = ["table"]


def table(result: dict[str, Any]) -> str:
    """All of a result, to be read in a terminal."""
    parts = [_rows(result), _ratios(result), _scaling(result), _batch(result), _stress(result)]
    calls, active = result["calls_per_tick"], result["stream"]["active"]
    held = ", ".join(f"{count} by {name}" for name, count in active.items())
    machine = result["machine"]
    parts.append(
        f"{result['stream']['ticks']} recorded ticks; the command was held by: {held}\n"
        f"a tick calls {calls['python']:.1f} Python functions and {calls['builtin']:.1f} "
        f"built-in ones\n"
        f"largest difference between cbfpy's rows and ours: {result['cbfpy_rows_difference']}\n"
        f"Python {machine['python']}, {machine['cpus']} CPUs, load {machine['load']}"
    )
    parts += [f"note: {note}" for note in result["notes"]]
    return "\n\n".join(parts)


def _rows(result: dict[str, Any]) -> str:
    lines = [
        f"{'route':38} {'what':5} {'median':>9} {'p99':>9} {'p99.9':>9} [us]"
        f" {'worst error':>12} {'wrong':>6} {'failed':>6} of"
    ]
    lines += [
        f"{r['name']:38} {r['what']:5} {r['median_us']:9.2f} {r['p99_us']:9.2f} "
        f"{r['p999_us']:9.2f}      {r['worst_error']:12.1e} {r['wrong']:6d} {r['failed']:6d} "
        f"{r['programs']}"
        for r in sorted(result["rows"], key=lambda r: (r["what"] != "tick", r["median_us"]))
    ]
    return "\n".join(lines)


def _ratios(result: dict[str, Any]) -> str:
    lines = [f"{'ratio, over the rounds':26} {'min':>8} {'median':>8} {'max':>8}"]
    lines += [
        f"{name:26} {s['min']:8.2f} {s['median']:8.2f} {s['max']:8.2f}"
        for name, s in result["ratio_spread"].items()
    ]
    return "\n".join(lines)


def _scaling(result: dict[str, Any]) -> str:
    lines = ["obstacle rows, assembly included: median (p99) [us]"]
    names = list(dict.fromkeys(r["name"] for r in result["scaling"]))
    for name in names:
        own = [r for r in result["scaling"] if r["name"] == name]
        cells = (f"{r['obstacles']}: {r['median_us']:.1f} ({r['p99_us']:.1f})" for r in own)
        lines.append(f"{name:26} " + "   ".join(cells))
    return "\n".join(lines)


def _batch(result: dict[str, Any]) -> str:
    lines = ["programs per second in one call of B"]
    for name in dict.fromkeys(r["name"] for r in result["batch"]):
        own = [r for r in result["batch"] if r["name"] == name]
        cells = (f"{r['B']}: {r['per_second']:,.0f}" for r in own)
        lines.append(f"{name:26} " + "   ".join(cells))
    return "\n".join(lines)


def _stress(result: dict[str, Any]) -> str:
    lines = ["stress sets: worst error, wrong, failed of programs"]
    for name, rows in result["stress"].items():
        lines += [
            f"{name:18} {r['name']:26} {r['worst_error']:9.1e} {r['wrong']:4d} {r['failed']:4d} "
            f"of {r['programs']}"
            for r in rows
        ]
    return "\n".join(lines)
