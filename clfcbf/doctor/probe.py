"""Code run in an interpreter of its own, which may crash or hang without harm to this one."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import NamedTuple

__all__ = ["Probe", "probe"]

TIME_LIMIT = 60.0
"""[s] For one import or one backend: several times what jax takes to import from a cold disk."""

_LONGEST_MESSAGE = 300
"""Characters of an error that are kept: what fits on a few lines."""


class Probe(NamedTuple):
    """What came of it.

    Attributes
    ----------
    output : the last line printed
    error : how it failed, in words; empty where it did not
    """

    output: str
    error: str


def probe(code: str, *arguments: str, time_limit: float = TIME_LIMIT) -> Probe:
    """Run Python ``code`` for at most ``time_limit`` [s], ``arguments`` as its ``sys.argv[1:]``."""
    try:
        outcome = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            stdin=subprocess.DEVNULL,
            encoding="utf-8",
            errors="replace",
            timeout=time_limit,
        )
    except subprocess.TimeoutExpired:
        return Probe("", f"no answer in {time_limit:g} s")
    except OSError as error:
        return Probe("", f"no interpreter: {error}")
    if outcome.returncode == 0:
        return Probe(_last_line(outcome.stdout), "")
    message = _last_line(outcome.stderr)[:_LONGEST_MESSAGE]
    if outcome.returncode < 0:
        crash = f"crashed with {_signal(-outcome.returncode)}"
        return Probe("", f"{crash}: {message}" if message else crash)
    return Probe("", message or f"ended with status {outcome.returncode}")


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1].strip() if lines else ""


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
