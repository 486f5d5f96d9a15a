"""One line that says whether a user's own adapter keeps the rules of the protocols.

>>> from clfcbf.hardware.clocks import MonotonicClock
>>> from clfcbf.hardware.conformance import check_clock
>>> check_clock(MonotonicClock, tolerance=0.1).passed
True

In a test, ``check_chassis(MyChassis).require()`` raises with the whole report. Every rule is put
to a fresh adapter, closed afterwards where it has a ``close``. Checks of a real base move it:
put it on blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from clfcbf.hardware._chassis_rules import ChassisRules
from clfcbf.hardware._other_rules import ClockRules, ManipulatorRules
from clfcbf.hardware._rules import PROMPT, ConformanceReport, Failure, check_rules
from clfcbf.hardware._sensor_rules import SensorRules
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.protocols import Chassis, Clock, Manipulator, TargetSensor
from clfcbf.se2 import Twist

__all__ = [
    "ConformanceReport",
    "Failure",
    "check_chassis",
    "check_clock",
    "check_manipulator",
    "check_sensor",
]

TWISTS = (Twist(0.05, 0.0), Twist(0.0, -0.1), Twist(-0.05, 0.1))
"""[m/s, rad/s] Commands of a check: slow, straight, on the spot and backward."""

HOLD = 0.1
"""[s] After which a command must still be in force: three periods at 30 Hz, so that what is
reported is not a body that catches up with its command."""

FRAMES = 0.5
"""[s] Time for which a sensor is listened to: 15 frames at 30 Hz."""

MAX_AGE = 1.0
"""[s] Between stamp and delivery: more than any camera takes, less than clocks differ."""

WAKE = 0.01
"""[s] By which a wait may be late: the median of several, on a machine that does other things."""


def _named(make: Callable[[], object]) -> str:
    return getattr(make, "__name__", type(make).__name__)


def check_chassis(
    make: Callable[[], Chassis],
    *,
    clock: Clock | None = None,
    twists: Sequence[Twist] = TWISTS,
    resolution: float = 1e-9,
    hold: float = HOLD,
    timeout: float | None = None,
    prompt: float = PROMPT,
) -> ConformanceReport:
    """Put a chassis to the rules of :class:`~clfcbf.hardware.protocols.Chassis`.

    Parameters
    ----------
    make : gives a fresh chassis at rest, such as its class
    clock : that the chassis lives on; the machine's if not given
    twists : commands to try, within its limits and each reachable at once
    resolution : to which it passes commands on [m/s, rad/s], such as 1e-3 for integers of mm/s
    hold : time for which a command must stay in force [s]
    timeout : after which it stops by itself without commands [s]; None does not ask
    prompt : longest duration of a call [s]

    Raises
    ------
    ConfigurationError : an argument is out of its range
    """
    rules = ChassisRules(
        clock or MonotonicClock(), tuple(twists), resolution, hold, timeout, prompt
    ).checked()
    return check_rules(_named(make), make, Chassis, rules.rules())


def check_sensor(
    make: Callable[[], TargetSensor],
    *,
    clock: Clock | None = None,
    duration: float = FRAMES,
    period: float = 1.0 / 30.0,
    standoff: float | None = None,
    max_age: float = MAX_AGE,
    prompt: float = PROMPT,
) -> ConformanceReport:
    """Put a sensor that has the target in view to the rules of a ``TargetSensor``.

    Parameters
    ----------
    make : gives a fresh sensor
    clock : that its stamps are on; the machine's monotonic one if not given
    duration, period : for how long and how often it is asked [s]
    standoff : distance from the goal to the feature ahead of it [m]; None does not ask
    max_age : longest time from a stamp to its delivery [s]
    prompt : longest duration of a call [s]

    Raises
    ------
    ConfigurationError : an argument is out of its range
    """
    rules = SensorRules(
        clock or MonotonicClock(), duration, period, standoff, max_age, prompt
    ).checked()
    return check_rules(_named(make), make, TargetSensor, rules.rules())


def check_clock(
    make: Callable[[], Clock], *, wait: float = 0.02, tolerance: float = WAKE
) -> ConformanceReport:
    """Put a clock to the rules of :class:`~clfcbf.hardware.protocols.Clock`.

    Parameters
    ----------
    make : gives a fresh clock
    wait : to try [s]
    tolerance : by which it may wake late [s]

    Raises
    ------
    ConfigurationError : an argument is out of its range
    """
    return check_rules(_named(make), make, Clock, ClockRules(wait, tolerance).checked().rules())


def check_manipulator(
    make: Callable[[], Manipulator],
    *,
    timeout: float,
    clock: Clock | None = None,
    prompt: float = PROMPT,
) -> ConformanceReport:
    """Put a manipulator to the rules of :class:`~clfcbf.hardware.protocols.Manipulator`.

    Parameters
    ----------
    make : gives a fresh manipulator, open
    timeout : longest time from open to closed or back [s]
    clock : that the manipulator lives on; the machine's if not given
    prompt : longest duration of a call [s]

    Raises
    ------
    ConfigurationError : an argument is out of its range
    """
    rules = ManipulatorRules(clock or MonotonicClock(), timeout, prompt).checked()
    return check_rules(_named(make), make, Manipulator, rules.rules())
