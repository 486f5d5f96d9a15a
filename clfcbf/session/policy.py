"""How long a docking session waits for what, and how often it tries."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clfcbf import defaults
from clfcbf.errors import ConfigurationError

__all__ = ["SessionPolicy"]

MAX_STAGING_TIME = 1000.0
"""[s] To the staging pose: Nav2's; it is the navigation stack that gives up, not the clock."""

INITIAL_PERCEPTION_TIMEOUT = 5.0
"""[s] For the first looks at the dock: Nav2's, 150 frames at 30 Hz."""

APPROACH_TIMEOUT = 60.0
"""[s] For one approach: 2.5 m at 0.22 m/s with a back-off take 30 s, and a search 9 s."""

WAIT_CHARGE_TIMEOUT = 5.0
"""[s] For the confirmation: Nav2's; chargers negotiate for two or three."""

MAX_UNDOCKING_TIME = 30.0
"""[s] For the way out: Nav2's; 0.7 m at 0.22 m/s take 4 s."""

MAX_TIME = 1800.0
"""[s] For all of it: the longest staging and three retries, and then somebody should look."""

MAX_RETRIES = 3
"""Attempts after the first: Nav2's."""

PAUSE = 1.0
"""[s] Before the first retry, doubled each time: a glare or a person in the way passes."""

LONGEST_PAUSE = 30.0
"""[s] That the doubling ends at."""

PRESTAGING_TOLERANCE = 0.5
"""[m, rad] Around the staging pose, where it is not staged again: Nav2's."""

_TIMES = ("max_staging_time", "initial_perception_timeout", "approach_timeout",
          "wait_charge_timeout", "max_undocking_time", "max_time")  # fmt: skip


@dataclass(frozen=True, slots=True)
class SessionPolicy:
    r"""Time-outs and retries.

    Attributes
    ----------
    max_staging_time : to the staging pose [s]
    initial_perception_timeout : for ``looks`` measurements of the dock [s]
    approach_timeout : of one approach [s]
    wait_charge_timeout : for the confirmation [s]
    max_undocking_time : to undock, or to back off for a retry [s]
    max_time : of the whole session, beyond which it stops wherever it is [s]
    max_retries : attempts after the first, at least 0
    pause, longest_pause : before the retry :math:`n = 1, 2, \dots` it waits
        :math:`\min(p\,2^{n-1}, p_{max})` [s]
    prestaging_tolerance : norm of (x, y, theta) from the staging pose within which the robot is
        taken to be there [m, rad]
    looks : measurements that count as having seen the dock

    Raises
    ------
    ConfigurationError : a value is out of its range
    """

    max_staging_time: float = MAX_STAGING_TIME
    initial_perception_timeout: float = INITIAL_PERCEPTION_TIMEOUT
    approach_timeout: float = APPROACH_TIMEOUT
    wait_charge_timeout: float = WAIT_CHARGE_TIMEOUT
    max_undocking_time: float = MAX_UNDOCKING_TIME
    max_time: float = MAX_TIME
    max_retries: int = MAX_RETRIES
    pause: float = PAUSE
    longest_pause: float = LONGEST_PAUSE
    prestaging_tolerance: float = PRESTAGING_TOLERANCE
    looks: int = defaults.FIRST_LOOKS

    def __post_init__(self) -> None:
        for name in (*_TIMES, "prestaging_tolerance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigurationError(f"{name} must be finite and positive, got {value!r}")
        for name in ("pause", "longest_pause"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ConfigurationError(f"{name} must be finite and at least 0 s, got {value!r}")
        for name, least in (("max_retries", 0), ("looks", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ConfigurationError(f"{name} must be an integer >= {least}, got {value!r}")

    def pause_before(self, retry: int) -> float:
        """Wait before the retry of that number, from 1 on [s]."""
        # Beyond 2^60 pauses of a nanosecond the doubling has long met its end.
        return min(self.pause * 2.0 ** min(retry - 1, 60), self.longest_pause)
