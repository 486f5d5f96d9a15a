r"""Between stamps in ROS time, which can be set, and the loop's clock, which cannot.

A stamp :math:`s` that is read at ROS time :math:`r` and loop's time :math:`t` was at
:math:`t - (r - s)` on the loop's clock, as long as ROS time went on evenly in between. Where
somebody has set it (NTP steps it when it is far off), that is wrong for every message stamped
before: those are refused.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from clfcbf.hardware.protocols import Clock
from clfcbf.ros2.messages import Time

__all__ = ["MAX_AHEAD", "Stamps"]

JUMP = 10_000_000
"""[ns] Between the two clocks' differences at two readings that is a jump: a third of a frame,
and more than a process waits between reading one clock and the other."""

MAX_AHEAD = 0.05
"""[s] By which a stamp may be ahead: more than clocks kept by NTP on one network differ."""

PROMPT = 0.001
"""[s] Within which both clocks have to be read for the reading to count; else they are read
again."""

READINGS = 3
"""Readings made for one that is prompt; a process is rarely put to sleep thrice running."""


class Stamps:
    """Stamps for instants on the loop's clock, and back.

    Parameters
    ----------
    clock : the loop's
    ros_time : nanoseconds of ROS time, which nodes stamp with; None where the clock *is* ROS time,
        as that of a simulation
    """

    def __init__(self, clock: Clock, ros_time: Callable[[], int] | None = time.time_ns) -> None:
        self._clock = clock
        self._ros_time = ros_time
        self._set_at: int | None = None
        self._difference = self._read()[1] if ros_time is not None else 0

    def now(self) -> Time:
        """Of this moment."""
        return self.at(self._clock.now()) if self._ros_time is None else Time.of(self._ros_time())

    def at(self, instant: float) -> Time:
        """Of an instant on the loop's clock [s]."""
        return Time.of(round(1e9 * instant) + self._renewed()[1])

    def instant(self, stamp: Time) -> float | None:
        """When it was on the loop's clock [s]; None if ROS time was set since."""
        if self._ros_time is None:
            return 1e-9 * stamp.nanoseconds
        now, difference = self._renewed()
        if self._set_at is not None and stamp.nanoseconds < self._set_at:
            return None
        ros_time = round(1e9 * now) + difference
        return now - 1e-9 * (ros_time - stamp.nanoseconds)

    def _renewed(self) -> tuple[float, int]:
        """The loop's time and what ROS time is ahead of it, having looked for a jump."""
        if self._ros_time is None:
            return self._clock.now(), 0
        now, difference = self._read()
        jump = difference - self._difference
        if abs(jump) > JUMP:
            # Set back, the last stamps of before are in the future now; far ones tell by that.
            back = min(max(-jump, 0), round(1e9 * MAX_AHEAD))
            self._set_at = round(1e9 * now) + difference + back
        self._difference = difference
        return now, difference

    def _read(self) -> tuple[float, int]:
        ros_time = self._ros_time or time.time_ns
        for _ in range(READINGS):
            before = self._clock.now()
            ros = ros_time()
            after = self._clock.now()
            if after - before <= PROMPT:
                break
        return before, ros - round(1e9 * 0.5 * (before + after))
