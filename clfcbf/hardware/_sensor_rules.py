"""The rules of a target sensor, put to the measurements of one short recording."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clfcbf.errors import ConfigurationError
from clfcbf.hardware._rules import BrokenRuleError, Rule, prompt
from clfcbf.hardware.protocols import Clock, TargetSensor
from clfcbf.scene import Observation
from clfcbf.se2 import Pose2

__all__ = ["SensorRules"]

_STANDOFF_ERROR = 0.1
"""[m] A feature seen so far from where the standoff puts it is not the one configured."""
_SYMMETRY = 1e-6
"""Relative rounding of a covariance that was computed in single precision."""


class _Heard(NamedTuple):
    observation: Observation
    when: float


class SensorRules(NamedTuple):
    """What a sensor is checked with, see :func:`~clfcbf.hardware.conformance.check_sensor`."""

    clock: Clock
    duration: float
    period: float
    standoff: float | None
    max_age: float
    prompt: float

    def checked(self) -> SensorRules:
        """These, or ``ConfigurationError``."""
        for name in ("duration", "period", "max_age", "prompt"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigurationError(
                    f"{name} must be finite and positive [s], got {getattr(self, name)!r}"
                )
        if self.standoff is not None and not 0.0 <= self.standoff < math.inf:
            raise ConfigurationError(f"standoff must be at least 0 m, got {self.standoff!r}")
        return self

    def rules(self) -> list[Rule[TargetSensor]]:
        """All of them; that of the standoff only where it is given."""
        rules = [
            Rule("sees the target", self.sees),
            Rule("poses are finite", self.finite),
            Rule("target is ahead", self.ahead),
            Rule("hands out each measurement once", self.once),
            Rule("stamps increase", self.increasing),
            Rule("stamps are of the past", self.past),
            Rule("stamps are on the clock", self.on_the_clock),
            Rule("covariance is one", self.covariance),
            Rule("returns without waiting", self.returns_at_once),
        ]
        if self.standoff is not None:
            rules.append(Rule("feature is at the standoff", self.at_standoff))
        return rules

    def _heard(self, sensor: TargetSensor) -> list[_Heard]:
        """All that it hands out while asked twice a period; nothing at all breaks any rule."""
        clock = self.clock
        heard: list[_Heard] = []
        begun = clock.now()
        tick = 0
        while tick * self.period < self.duration:
            for observation in (sensor.observe(), sensor.observe()):
                if observation is None:
                    continue
                if not isinstance(observation, Observation):
                    raise BrokenRuleError(
                        f"observe() must give an Observation or None, got {observation!r}"
                    )
                heard.append(_Heard(observation, clock.now()))
            tick += 1
            clock.sleep_until(begun + tick * self.period)
        if not heard:
            raise BrokenRuleError(
                f"nothing was measured in {self.duration:g} s; is the target in view?"
            )
        return heard

    def sees(self, sensor: TargetSensor) -> None:
        self._heard(sensor)

    def finite(self, sensor: TargetSensor) -> None:
        for observation, _ in self._heard(sensor):
            values = (*observation.goal, *observation.feature, observation.stamp)
            if not all(map(math.isfinite, values)):
                raise BrokenRuleError(f"not finite: {observation!r}")
            if not abs(observation.goal[2]) <= math.pi:
                raise BrokenRuleError(
                    f"heading must be in (-pi, pi] rad, got {observation.goal[2]!r}; degrees?"
                )

    def ahead(self, sensor: TargetSensor) -> None:
        for observation, _ in self._heard(sensor):
            x, y = observation.feature[0], observation.feature[1]
            if not x > abs(y):
                raise BrokenRuleError(
                    f"a feature seen must be ahead of the robot (x forward, y left), got ({x:.3f}, "
                    f"{y:.3f}) m; is it in an optical frame (z forward, x right)?"
                )

    def once(self, sensor: TargetSensor) -> None:
        stamps = [observation.stamp for observation, _ in self._heard(sensor)]
        if len(set(stamps)) < len(stamps):
            raise BrokenRuleError("a measurement was handed out twice (two have the same stamp)")

    def increasing(self, sensor: TargetSensor) -> None:
        stamps = [observation.stamp for observation, _ in self._heard(sensor)]
        for before, after in pairwise(stamps):
            if not after >= before:
                raise BrokenRuleError(f"a stamp of {after!r} s came after one of {before!r} s")

    def past(self, sensor: TargetSensor) -> None:
        for observation, when in self._heard(sensor):
            if not observation.stamp <= when:
                raise BrokenRuleError(
                    f"a stamp of {observation.stamp!r} s was handed out at {when!r} s"
                )

    def on_the_clock(self, sensor: TargetSensor) -> None:
        for observation, when in self._heard(sensor):
            if not abs(when - observation.stamp) <= self.max_age:
                raise BrokenRuleError(
                    f"a stamp of {observation.stamp!r} s was handed out at {when!r} s, more than "
                    f"{self.max_age:g} s apart; is it on the loop's monotonic clock?"
                )

    def covariance(self, sensor: TargetSensor) -> None:
        for observation, _ in self._heard(sensor):
            if observation.covariance is not None and not _is_covariance(observation.covariance):
                raise BrokenRuleError(
                    "a covariance must be 3 by 3, symmetric, finite, without negative variance "
                    f"and not zero; None where it is not known; got {observation.covariance!r}"
                )

    def returns_at_once(self, sensor: TargetSensor) -> None:
        prompt("observe()", sensor.observe, self.prompt)

    def at_standoff(self, sensor: TargetSensor) -> None:
        assert self.standoff is not None
        for observation, _ in self._heard(sensor):
            x, y = Pose2(*observation.goal).seen((observation.feature[0], observation.feature[1]))
            if math.hypot(x - self.standoff, y) > _STANDOFF_ERROR:
                raise BrokenRuleError(
                    f"the feature must be {self.standoff:g} m straight ahead of the goal, it is at "
                    f"({x:.3f}, {y:.3f}) m"
                )


def _is_covariance(values: object) -> bool:
    try:
        matrix = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        return False
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return False
    largest = float(np.abs(matrix).max())
    if largest == 0.0 or float(np.abs(matrix - matrix.T).max()) > _SYMMETRY * largest:
        return False
    return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min()) >= -_SYMMETRY * largest
