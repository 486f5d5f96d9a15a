"""Signals that ask a run to end, caught for as long as it lasts."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["caught"]

_ASKING = (signal.SIGINT, signal.SIGTERM)
"""Ctrl-C, and what service managers and container runtimes send first."""


@contextmanager
def caught(ask: Callable[[int], None]) -> Iterator[None]:
    """Call ``ask`` with the number of each SIGINT and SIGTERM; the old handlers come back after.

    Only the main thread of a process can catch signals; in any other nothing is caught, and the
    main thread has to pass on what it catches.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handler(number: int, _: FrameType | None) -> None:
        ask(number)

    before = {number: signal.signal(number, handler) for number in _ASKING}
    try:
        yield
    finally:
        for number, old in before.items():
            # None is a handler that was not set from Python and cannot be set from it.
            signal.signal(number, signal.SIG_DFL if old is None else old)
