"""Adapters that keep the rules, on a clock that the test moves."""

from __future__ import annotations

import math

from clfcbf.hardware.protocols import Grip
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2, Twist

REST = Twist(0.0, 0.0)


class FakeClock:
    """Time passes only while someone waits for it."""

    def __init__(self, start: float = 100.0) -> None:
        self.time = start

    def now(self) -> float:
        return self.time

    def sleep_until(self, time: float) -> None:
        self.time = max(self.time, time)


class GoodChassis:
    """Remembers what it was told, and stops by itself after ``timeout``."""

    def __init__(self, clock: FakeClock, timeout: float = math.inf) -> None:
        self.clock = clock
        self.timeout = timeout
        self.command = REST
        self.at = -math.inf

    def send(self, twist: Twist) -> None:
        if not all(map(math.isfinite, twist)):
            raise ValueError(f"not finite: {twist!r}")
        self.command = twist
        self.at = self.clock.now()

    def applied(self) -> Twist:
        return self.command if self.clock.now() - self.at <= self.timeout else REST

    def stop(self) -> None:
        self.command = REST


class GoodSensor:
    """Sees a board 2 m ahead at 30 Hz, with a latency of 0.1 s."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.last = -math.inf

    def observe(self) -> Observation | None:
        stamp = math.floor(30.0 * (self.clock.now() - 0.1)) / 30.0
        if stamp <= self.last:
            return None
        self.last = stamp
        return self.observation(stamp)

    def observation(self, stamp: float) -> Observation:
        return Observation(Pose2(1.4, 0.1, 0.0), Pose2(2.0, 0.1, 0.0), stamp)


class GoodGripper:
    """Takes 0.3 s either way."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.end = Grip.OPEN
        self.until = -math.inf

    def _go(self, end: Grip) -> None:
        if self.end is not end:
            self.end, self.until = end, self.clock.now() + 0.3

    def grasp(self) -> None:
        self._go(Grip.HOLDING)

    def release(self) -> None:
        self._go(Grip.OPEN)

    def grip(self) -> Grip:
        return Grip.MOVING if self.clock.now() < self.until else self.end

    def stop(self) -> None:
        if self.grip() is Grip.MOVING:
            self.end, self.until = Grip.FAULT, -math.inf
