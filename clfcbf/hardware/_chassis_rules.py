"""The rules of a chassis."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.hardware._rules import BrokenRuleError, Rule, prompt
from clfcbf.hardware.protocols import Chassis, Clock
from clfcbf.se2 import Twist

__all__ = ["ChassisRules"]

_REST = Twist(0.0, 0.0)
_NOT_FINITE = (Twist(math.nan, 0.0), Twist(0.0, math.nan), Twist(math.inf, 0.0))
_STOPS = 20
"""Stops from another thread while commands are sent."""
_LATE = 1.5
"""Time-outs after which a base must have stopped by itself."""
_HOLDS = 0.3
"""Share of the time-out for which a command must stay in force."""


class ChassisRules(NamedTuple):
    """What a chassis is checked with, see :func:`~clfcbf.hardware.conformance.check_chassis`."""

    clock: Clock
    twists: tuple[Twist, ...]
    resolution: float
    hold: float
    timeout: float | None
    prompt: float

    def rules(self) -> list[Rule[Chassis]]:
        """All of them; that of the time-out only where there is one."""
        rules = [
            Rule("starts at rest", self.starts_at_rest),
            Rule("applied is the command sent", self.applied_is_sent),
            Rule("applied holds until the next command", self.applied_holds),
            Rule("refuses what is not finite", self.refuses_not_finite),
            Rule("returns without waiting", self.returns_at_once),
            Rule("stop stops", self.stop_stops),
            Rule("stop at any time", self.stop_any_time),
            Rule("stop from another thread", self.stop_from_a_thread),
            Rule("no command is swallowed after stop", self.nothing_swallowed),
        ]
        if self.timeout is not None:
            rules.append(Rule("stops by itself", self.stops_by_itself))
        return rules

    def checked(self) -> ChassisRules:
        """These, or ``ConfigurationError``."""
        if not self.twists or any(not all(map(math.isfinite, t)) for t in self.twists):
            raise ConfigurationError(f"twists must be finite and at least one, got {self.twists!r}")
        for name in ("resolution", "hold", "prompt"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigurationError(
                    f"{name} must be finite and at least 0, got {getattr(self, name)!r}"
                )
        if self.timeout is not None and not 0.0 < self.timeout < math.inf:
            raise ConfigurationError(f"timeout must be positive [s], got {self.timeout!r}")
        return self

    def _expect(self, chassis: Chassis, twist: Twist, when: str) -> None:
        applied = chassis.applied()
        if not isinstance(applied, Twist):
            raise BrokenRuleError(f"applied() {when} must be a Twist, got {applied!r}")
        off = max(abs(applied.v - twist.v), abs(applied.omega - twist.omega))
        if not off <= self.resolution:
            raise BrokenRuleError(f"applied() {when} must be {twist!r}, got {applied!r}")

    def starts_at_rest(self, chassis: Chassis) -> None:
        self._expect(chassis, _REST, "before the first command")

    def applied_is_sent(self, chassis: Chassis) -> None:
        for twist in self.twists:
            chassis.send(twist)
            self._expect(chassis, twist, f"after send({twist!r})")

    def applied_holds(self, chassis: Chassis) -> None:
        twist = self.twists[0]
        hold = self.hold if self.timeout is None else min(self.hold, _HOLDS * self.timeout)
        chassis.send(twist)
        self.clock.sleep_until(self.clock.now() + hold)
        self._expect(chassis, twist, f"{hold:g} s after send({twist!r})")

    def refuses_not_finite(self, chassis: Chassis) -> None:
        chassis.send(self.twists[0])
        for twist in _NOT_FINITE:
            try:
                chassis.send(twist)
            except Exception:  # whatever it raises, it refused
                self._expect(chassis, self.twists[0], f"after {twist!r} was refused")
            else:
                raise BrokenRuleError(f"send({twist!r}) must raise")

    def returns_at_once(self, chassis: Chassis) -> None:
        prompt("send()", lambda: chassis.send(self.twists[0]), self.prompt)
        prompt("applied()", chassis.applied, self.prompt)
        prompt("stop()", chassis.stop, self.prompt)

    def stop_stops(self, chassis: Chassis) -> None:
        for twist in self.twists:
            if not self._sent(chassis, twist):
                return
            chassis.stop()
            self._expect(chassis, _REST, "after stop()")

    def stop_any_time(self, chassis: Chassis) -> None:
        chassis.stop()
        chassis.stop()
        self._expect(chassis, _REST, "after two stops before the first command")

    def stop_from_a_thread(self, chassis: Chassis) -> None:
        """While another thread stops it over and over, commands are taken or refused, no more."""
        errors: list[Exception] = []

        def stops() -> None:
            try:
                for _ in range(_STOPS):
                    chassis.stop()
            except Exception as error:
                errors.append(error)

        thread = threading.Thread(target=stops, name="stops")
        thread.start()
        while thread.is_alive():
            self._sent(chassis, self.twists[0])
        thread.join()
        if errors:
            raise BrokenRuleError(f"stop() raised {type(errors[0]).__name__}: {errors[0]}")
        chassis.stop()
        self._expect(chassis, _REST, "after the last stop()")

    def nothing_swallowed(self, chassis: Chassis) -> None:
        chassis.stop()
        if self._sent(chassis, self.twists[0]):
            self._expect(chassis, self.twists[0], "after a send() that followed stop()")

    def stops_by_itself(self, chassis: Chassis) -> None:
        assert self.timeout is not None
        chassis.send(self.twists[0])
        self.clock.sleep_until(self.clock.now() + _LATE * self.timeout)
        self._expect(chassis, _REST, f"{_LATE * self.timeout:g} s after the last command")

    @staticmethod
    def _sent(chassis: Chassis, twist: Twist) -> bool:
        """Whether it was accepted; a stopped base may refuse until it is released."""
        try:
            chassis.send(twist)
        except Exception:
            return False
        return True
