"""What the benchmarks' command lines share: how they end, and the numbers they take."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable

from clfcbf.errors import ClfcbfError

__all__ = ["INTERRUPTED", "USAGE_ERROR", "at_least", "exit_status"]

USAGE_ERROR, INTERRUPTED = 2, 130


def exit_status(name: str, work: Callable[[], int]) -> int:
    """The status of ``work``, or that of an error of ours or an interruption, told in a line."""
    try:
        return work()
    except ClfcbfError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return USAGE_ERROR
    except BrokenPipeError:  # such as of "| head": the interpreter must not flush again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"{name}: interrupted; --resume goes on from the JSON file", file=sys.stderr)
        return INTERRUPTED


def at_least(least: int) -> Callable[[str], int]:
    """Type of an argument: an integer not below ``least``."""

    def number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"must be at least {least}, got {value}")
        return value

    return number
