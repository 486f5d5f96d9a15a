"""The rules of a clock and of a manipulator."""

from __future__ import annotations

import math
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.hardware._rules import BrokenRuleError, Rule, prompt
from clfcbf.hardware.protocols import Clock, Grip, Manipulator

__all__ = ["ClockRules", "ManipulatorRules"]

_READINGS = 1000
"""Readings of a clock that must not run backward."""
_POLL = 0.01
"""[s] from one look at a grip to the next."""


class ClockRules(NamedTuple):
    """What a clock is checked with, see :func:`~clfcbf.hardware.conformance.check_clock`."""

    wait: float
    tolerance: float

    def checked(self) -> ClockRules:
        """These, or ``ConfigurationError``."""
        for name in self._fields:
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigurationError(
                    f"{name} must be finite and positive [s], got {getattr(self, name)!r}"
                )
        return self

    def rules(self) -> list[Rule[Clock]]:
        """All of them."""
        return [
            Rule("never runs backward", self.monotonic),
            Rule("never wakes early", self.not_early),
            Rule("wakes in time", self.in_time),
            Rule("does not wait for the past", self.past),
        ]

    def monotonic(self, clock: Clock) -> None:
        before = clock.now()
        for _ in range(_READINGS):
            now = clock.now()
            if not (math.isfinite(now) and now >= before):
                raise BrokenRuleError(f"now() gave {now!r} s after {before!r} s")
            before = now

    def not_early(self, clock: Clock) -> None:
        for share in (1.0, 0.1, 0.01):
            until = clock.now() + share * self.wait
            clock.sleep_until(until)
            if not clock.now() >= until:
                raise BrokenRuleError(f"sleep_until({until!r}) returned at {clock.now()!r} s")

    def in_time(self, clock: Clock) -> None:
        late = []
        for _ in range(5):
            until = clock.now() + self.wait
            clock.sleep_until(until)
            late.append(clock.now() - until)
        if sorted(late)[2] > self.tolerance:
            raise BrokenRuleError(
                f"woke {sorted(late)[2]:.4f} s late, more than {self.tolerance:g} s"
            )

    def past(self, clock: Clock) -> None:
        begun = clock.now()
        clock.sleep_until(begun - 1.0)
        if clock.now() - begun > self.tolerance:
            raise BrokenRuleError(f"sleep_until of the past took {clock.now() - begun:.4f} s")


class ManipulatorRules(NamedTuple):
    """For :func:`~clfcbf.hardware.conformance.check_manipulator`."""

    clock: Clock
    timeout: float
    prompt: float

    def checked(self) -> ManipulatorRules:
        """These, or ``ConfigurationError``."""
        for name in ("timeout", "prompt"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigurationError(
                    f"{name} must be finite and positive [s], got {getattr(self, name)!r}"
                )
        return self

    def rules(self) -> list[Rule[Manipulator]]:
        """All of them."""
        return [
            Rule("grip is a Grip", self.grip_is_one),
            Rule("grasp closes", self.closes),
            Rule("release opens", self.opens),
            Rule("grasp twice is as once", self.twice),
            Rule("stop holds still", self.stops),
            Rule("returns without waiting", self.returns_at_once),
        ]

    def _settled(self, manipulator: Manipulator, after: str) -> Grip:
        """The grip once it no longer moves."""
        until = self.clock.now() + self.timeout
        while (grip := manipulator.grip()) is Grip.MOVING:
            if self.clock.now() >= until:
                raise BrokenRuleError(f"still moving {self.timeout:g} s after {after}")
            self.clock.sleep_until(self.clock.now() + _POLL)
        return grip

    def grip_is_one(self, manipulator: Manipulator) -> None:
        if not isinstance(manipulator.grip(), Grip):
            raise BrokenRuleError(f"grip() must give a Grip, got {manipulator.grip()!r}")

    def closes(self, manipulator: Manipulator) -> None:
        manipulator.grasp()
        grip = self._settled(manipulator, "grasp()")
        if grip not in (Grip.HOLDING, Grip.EMPTY):
            raise BrokenRuleError(f"after grasp() it is {grip!r}, neither HOLDING nor EMPTY")

    def opens(self, manipulator: Manipulator) -> None:
        manipulator.grasp()
        self._settled(manipulator, "grasp()")
        manipulator.release()
        grip = self._settled(manipulator, "release()")
        if grip is not Grip.OPEN:
            raise BrokenRuleError(f"after release() it is {grip!r}, not OPEN")

    def twice(self, manipulator: Manipulator) -> None:
        manipulator.grasp()
        grip = self._settled(manipulator, "grasp()")
        manipulator.grasp()
        if manipulator.grip() is not grip:
            raise BrokenRuleError(f"a second grasp() turned {grip!r} into {manipulator.grip()!r}")

    def stops(self, manipulator: Manipulator) -> None:
        manipulator.stop()
        manipulator.grasp()
        manipulator.stop()
        manipulator.stop()
        if manipulator.grip() is Grip.MOVING:
            raise BrokenRuleError("still moving after stop()")

    def returns_at_once(self, manipulator: Manipulator) -> None:
        for name in ("grip", "grasp", "release", "stop"):
            prompt(f"{name}()", getattr(manipulator, name), self.prompt)
