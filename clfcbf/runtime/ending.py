"""How every run ends: the brake to zero, tick by tick, and then the base's own stop."""

from __future__ import annotations

import math
from typing import NamedTuple

from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.protocols import Chassis, Clock
from clfcbf.runtime.braking import Braking
from clfcbf.se2 import Twist

__all__ = ["Rest", "come_to_rest"]

_REST = Twist(0.0, 0.0)

SPARE = 5
"""Brake commands beyond those needed, for a base that rounds what it is sent."""

STOPS = 3
"""Calls of ``stop`` before a base that cannot be stopped is reported."""


class Rest(NamedTuple):
    """What coming to rest took, and what went wrong."""

    braked: int
    brake_error: BaseException | None
    stop_error: BaseException | None


class _Pace:
    """Waits a period from one command to the next, on the machine's clock if another fails."""

    def __init__(self, clock: Clock, period: float, sent_at: float) -> None:
        self._clock = clock
        self._period = period
        self._sent_at = sent_at

    def wait(self) -> None:
        if self._sent_at == -math.inf:  # nothing was sent yet
            return
        try:
            self._clock.sleep_until(self._sent_at + self._period)
        except Exception:  # the brake must not depend on the part that may have failed
            self._clock = MonotonicClock()
            self._clock.sleep_until(self._clock.now() + self._period)

    def sent(self) -> None:
        try:
            self._sent_at = self._clock.now()
        except Exception:
            self._clock = MonotonicClock()
            self._sent_at = self._clock.now()


def come_to_rest(
    braking: Braking, chassis: Chassis, clock: Clock, period: float, sent_at: float
) -> Rest:
    """Brake from the command in force to zero, a command a period, then stop the base.

    A brake command that cannot be sent leaves nothing but the stop, which follows at once.

    Parameters
    ----------
    braking : knows the brake's next command
    sent_at : when the last command was sent [s], -inf if none was
    """
    pace = _Pace(clock, period, sent_at)
    braked = 0
    brake_error: BaseException | None = None
    try:
        for _ in range(braking.ticks(_in_force(braking, chassis)) + SPARE):
            applied = _in_force(braking, chassis)
            if applied == _REST:
                break
            pace.wait()
            command = braking.command(applied)
            chassis.send(command)
            pace.sent()
            braking.accepted(command)
            braked += 1
    except BaseException as error:
        brake_error = error
    stop_error: BaseException | None = None
    for _ in range(STOPS):
        try:
            chassis.stop()
        except BaseException as error:
            stop_error = error
        else:
            return Rest(braked, brake_error, None)
    return Rest(braked, brake_error, stop_error)


def _in_force(braking: Braking, chassis: Chassis) -> Twist:
    """The command in force; the one last sent where the chassis cannot tell."""
    try:
        return braking.known(chassis.applied())
    except Exception:  # a brake has to go on with a base that cannot answer
        return braking.sent
