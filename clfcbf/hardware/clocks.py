"""The machine's monotonic clock, and how precisely a process can wait for it."""

from __future__ import annotations

import math
from time import monotonic, sleep

from clfcbf.errors import ConfigurationError

__all__ = ["MonotonicClock"]


class MonotonicClock:
    """The machine's monotonic clock: not set by NTP, the same in every thread and process.

    Parameters
    ----------
    spin : last part of a wait that is spent asking for the time over and over [s]. The
        scheduler wakes a process a tenth of a millisecond late; spinning for longer than that
        meets the time to some microseconds, and keeps a core busy for ``spin / period`` of the
        time. 0, the default, does not spin: a tenth of a millisecond is nothing to a robot.

    Raises
    ------
    ConfigurationError : the spin is negative or not finite
    """

    def __init__(self, spin: float = 0.0) -> None:
        if not 0.0 <= spin < math.inf:
            raise ConfigurationError(f"spin must be finite and at least 0 s, got {spin!r}")
        self._spin = spin

    def now(self) -> float:
        """Time [s] of :func:`time.monotonic`, which stamps have to be on, too."""
        return monotonic()

    def sleep_until(self, time: float) -> None:
        """Wait until ``time`` [s]; signal handlers run meanwhile."""
        while (left := time - monotonic()) > self._spin:
            sleep(left - self._spin)
        while monotonic() < time:
            pass
