r"""What is wrong with a configuration, and what is risky though each value alone is valid."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from enum import Enum
from typing import NamedTuple

from clfcbf import defaults
from clfcbf.config.model import Config
from clfcbf.constraints.barrier import HERE
from clfcbf.errors import GeometryError
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist
from clfcbf.wheels import WheelLimits

__all__ = ["Finding", "Severity", "findings"]

COARSE = 0.25
"""Share of the top speed by which one tick may change it: four commands from rest to there."""

SHORTEST_PERIOD = 0.005
"""[s] Of CPython's switch interval: any other busy thread delays a tick by as much."""

TURNS = 2.0 * math.pi
"""[rad/s] A turn a second: no docking robot does, and 25 °/s taken for rad/s would."""

FASTEST = 3.0
"""[m/s] Twice walking pace: an industrial vehicle's highest speed among people is below."""

UNCERTIFIED = 1.0
"""[s] Longest that missed deadlines may go on before the loop brakes."""

ROUNDING = 1e-9
"""[m/s] By which wheels may seem to be exceeded."""


class Severity(Enum):
    """How bad a finding is."""

    WRONG = "wrong"
    """The robot cannot do its task, or not safely."""
    RISKY = "risky"
    """It can, but what this buys is likely not what was meant."""


class Finding(NamedTuple):
    """One thing found: how bad, which section and key, and what it means in numbers."""

    severity: Severity
    key: str
    text: str

    def __str__(self) -> str:
        return f"{self.severity.value}: {self.key}: {self.text}"


def findings(config: Config) -> tuple[Finding, ...]:
    """Everything found, what is wrong first; what merely building it refuses is not among it."""
    found = [finding for look in _LOOKS for finding in look(config)]
    return tuple(sorted(found, key=lambda finding: finding.severity is Severity.RISKY))


def _wrong(key: str, text: str) -> Finding:
    return Finding(Severity.WRONG, key, text)


def _risky(key: str, text: str) -> Finding:
    return Finding(Severity.RISKY, key, text)


def _units(config: Config) -> Iterator[Finding]:
    limits = config.limits
    if limits.omega_max > TURNS:
        yield _risky("limits.omega_max", f"{limits.omega_max:g} rad/s; is it in degrees?")
    if max(limits.v_max, -limits.reverse_speed) > FASTEST:
        yield _risky("limits.v_max", f"{limits.v_max:g} m/s; is it in another unit?")


def _period(config: Config) -> Iterator[Finding]:
    limits, period = config.limits, config.filter.period
    for key, step, top, unit in (
        ("a_max", limits.a_max * period, limits.v_max, "m/s"),
        ("alpha_max", limits.alpha_max * period, limits.omega_max, "rad/s"),
    ):
        if step > COARSE * top:
            yield _risky(
                "filter.period",
                f"one tick of {period:g} s changes the command by up to {step:g} {unit} "
                f"({key}), more than {COARSE:g} of its largest, {top:g} {unit}",
            )
    if period < SHORTEST_PERIOD:
        yield _risky(
            "filter.period",
            f"{1e3 * period:g} ms; one other busy thread delays a tick by "
            f"{1e3 * SHORTEST_PERIOD:g} ms",
        )


def _view(config: Config) -> Iterator[Finding]:
    """The board at the goal, through the barrier that has to hold there."""
    camera, standoff = config.camera, config.standoff
    distance = standoff - camera.camera.x
    if not distance > 0.0:
        yield _wrong(
            "docking.standoff",
            f"{standoff:g} m puts the feature behind the camera at {camera.camera.x:g} m",
        )
        return
    scene = Scene(HERE, Pose2(standoff, 0.0, 0.0), 0.0)
    try:
        clearance = min(barrier.clearance(scene, HERE) for barrier in config.filter.barriers)
    except GeometryError as error:
        yield _wrong("docking.standoff", str(error))
        return
    reserve = defaults.PLAN_EDGE - defaults.VIEW_MARGIN
    seen = (
        f"from the goal, {distance:g} m away, with a width of {camera.width:g} m, a half angle of "
        f"{math.degrees(camera.half_angle):.1f}° and a margin of "
        f"{math.degrees(defaults.VIEW_MARGIN):.1f}°"
    )
    if clearance < 0.0:
        yield _wrong("camera.half_angle", f"cannot see the feature {seen}")
    elif clearance < reserve:
        yield _risky("camera.half_angle", f"only {math.degrees(clearance):.2f}° to spare {seen}")


def _lag(config: Config) -> Iterator[Finding]:
    lag, guard_lag, period = config.filter.lag, config.filter.guard_lag, config.filter.period
    if guard_lag < lag:  # which the filter itself refuses
        yield _wrong("filter.guard_lag", f"{guard_lag:g} s does not cover a lag of {lag:g} s")
    elif guard_lag < lag + period:
        yield _risky(
            "filter.guard_lag",
            f"{guard_lag:g} s leaves less than a period beyond the lag of {lag:g} s for latency "
            "that the stamps do not tell",
        )
    if lag == 0.0:
        yield _risky("filter.lag", "0 s, but every body lags behind its commands; identify it")


def _stopping(config: Config) -> Iterator[Finding]:
    r"""Braking against the room there is: :math:`v^2/2a + v\tau` and the same in turning."""
    limits, lag = config.limits, config.filter.guard_lag
    room = config.standoff - config.camera.camera.x
    way = _stop(limits.v_max, limits.a_max, lag)
    if 0.0 < room < way:
        yield _risky(
            "limits.v_max",
            f"{limits.v_max:g} m/s takes {way:.2f} m to stop, and the feature is {room:.2f} m from "
            "the camera at the goal",
        )
    turn = _stop(limits.omega_max, limits.alpha_max, lag)
    if turn > config.camera.half_angle:
        yield _risky(
            "limits.omega_max",
            f"{limits.omega_max:g} rad/s takes {math.degrees(turn):.0f}° to stop, more than the "
            f"half angle of {math.degrees(config.camera.half_angle):.0f}°: the guard will slow "
            "most turns down",
        )
    if limits.reverse_speed == 0.0:
        yield _risky("limits.v_min", "0 forbids reverse, so a missed approach is never repeated")


def _stop(speed: float, deceleration: float, lag: float) -> float:
    return speed * (0.5 * speed / deceleration + lag)


def _patience(config: Config) -> Iterator[Finding]:
    patience = float(config.docking.get("patience", defaults.PATIENCE))
    way = patience * config.limits.v_max
    if way > config.standoff:
        yield _risky(
            "docking.patience",
            f"{patience:g} s at {config.limits.v_max:g} m/s are {way:.2f} m driven unseen, more "
            f"than the standoff of {config.standoff:g} m",
        )
    if config.loop.max_age > patience:
        yield _risky(
            "loop.max_age",
            f"{config.loop.max_age:g} s, but a measurement older than the patience of "
            f"{patience:g} s makes the controller brake",
        )
    blind = config.loop.misses * config.filter.period
    if blind > UNCERTIFIED:
        yield _risky(
            "loop.misses",
            f"{config.loop.misses} are {blind:.2f} s in which no command is certified",
        )


def _wheels(config: Config) -> Iterator[Finding]:
    wheels = config.wheels
    if wheels is None:
        return
    fastest, hardest = _corner(config.limits, wheels)
    if fastest > wheels.speed + ROUNDING:
        yield _wrong(
            "wheels.speed",
            f"v_max and omega_max together ask {fastest:.3f} m/s of a wheel that does "
            f"{wheels.speed:g} m/s; the limits must fit inside",
        )
    if hardest > wheels.acceleration + ROUNDING:
        yield _wrong(
            "wheels.acceleration",
            f"a_max and alpha_max together ask {hardest:.3f} m/s² of a wheel that does "
            f"{wheels.acceleration:g} m/s²; the limits must fit inside",
        )


def _corner(limits: Limits, wheels: WheelLimits) -> tuple[float, float]:
    """The fastest and the hardest accelerated wheel of any twist inside the limits."""
    speed = max(limits.v_max, -limits.reverse_speed)
    fastest = wheels.rim_speeds(Twist(speed, limits.omega_max)).right
    return fastest, wheels.rim_speeds(Twist(limits.a_max, limits.alpha_max)).right


_LOOKS: tuple[Callable[[Config], Iterator[Finding]], ...] = (
    _units, _period, _view, _lag, _stopping, _patience, _wheels,
)  # fmt: skip
