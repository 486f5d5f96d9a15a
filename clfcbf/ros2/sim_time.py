"""The clock of a simulation, as its ``/clock`` tells it: ``use_sim_time`` in ROS's words."""

from __future__ import annotations

import time

from clfcbf.ros2.messages import Clock as ClockMessage
from clfcbf.ros2.transport import Subscription, TransportError

__all__ = ["SimulatedTime"]

SILENCE = 5.0
"""[s] Of the machine's time without a new time after which a simulation is taken to be gone."""

POLL = 2e-4
"""[s] Between two looks: a simulation in step with the loop waits for it that much longer."""


class SimulatedTime:
    """A :class:`~clfcbf.hardware.protocols.Clock` that follows ``/clock`` and never runs back.

    Parameters
    ----------
    subscription : to ``rosgraph_msgs/msg/Clock``
    silence : wait for a new time after which waiting raises [s]
    """

    def __init__(self, subscription: Subscription[ClockMessage], silence: float = SILENCE) -> None:
        self._subscription = subscription
        self._silence = silence
        self._time = 0.0

    def now(self) -> float:
        """The newest time that was told [s]; 0 before the first."""
        for message in self._subscription.take():
            self._time = max(self._time, 1e-9 * message.clock.nanoseconds)
        return self._time

    def sleep_until(self, time_: float) -> None:
        """Wait until the simulation is there.

        Raises
        ------
        TransportError : no new time was told for long
        """
        heard, latest = time.monotonic(), self.now()
        while (now := self.now()) < time_:
            if now > latest:
                heard, latest = time.monotonic(), now
            elif time.monotonic() - heard > self._silence:
                raise TransportError(f"no new time on /clock for {self._silence:g} s")
            time.sleep(POLL)
