"""A chassis that is driven by velocity messages, stamped (the default) or not."""

from __future__ import annotations

import math
import threading
from typing import Any

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.hardware.protocols import Clock
from clfcbf.ros2 import messages
from clfcbf.ros2.messages import Header, Vector3
from clfcbf.ros2.stamps import Stamps
from clfcbf.ros2.transport import COMMANDS, Publisher, Transport, TransportError
from clfcbf.se2 import Twist, is_finite

__all__ = ["BASE_FRAME", "CMD_VEL", "TIMEOUT", "TopicChassis", "twist_message", "twist_of"]

BASE_FRAME = "base_link"
"""REP-105's name of the frame at the rotation centre."""

CMD_VEL = "cmd_vel"
"""Nav2's topic of velocity commands."""

TIMEOUT = 0.5
"""[s] Without a command until the base stops: ``cmd_vel_timeout`` of ros2_controllers' drives."""

_REST = Twist(0.0, 0.0)


def twist_message(twist: Twist) -> messages.Twist:
    """Of a unicycle's twist: x forward, z up."""
    return messages.Twist(Vector3(x=twist.v), Vector3(z=twist.omega))


def twist_of(message: messages.Twist) -> Twist:
    """Of a message, of which a unicycle can follow two components."""
    return Twist(message.linear.x, message.angular.z)


class TopicChassis:
    """Publishes each command once, and zero at ``stop`` and ``close``.

    Nobody tells whether the base follows. What can be known is whether anybody listens: a command
    that nobody hears raises. ``applied`` is the command last sent, and zero once the base's own
    time-out has passed; so that time-out has to be the base's, and what the base clips has to be in
    the limits.

    Parameters
    ----------
    transport : that carries the messages
    clock : the loop's
    stamps : of that clock
    topic : absolute name
    stamped : ``TwistStamped``, else ``Twist`` (Nav2's ``enable_stamped_cmd_vel``)
    frame : of the twist
    timeout : of the base [s]

    Raises
    ------
    ConfigurationError : the time-out is not positive
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        stamps: Stamps,
        topic: str = f"/{CMD_VEL}",
        *,
        stamped: bool = True,
        frame: str = BASE_FRAME,
        timeout: float = TIMEOUT,
    ) -> None:
        if not timeout > 0.0:
            raise ConfigurationError(f"the base's time-out must be positive [s], got {timeout!r}")
        self._clock = clock
        self._stamps = stamps
        self._topic = topic
        self._frame = frame
        self._timeout = timeout
        self._lock = threading.Lock()
        self._applied, self._sent_at = _REST, -math.inf
        self._closed = False
        self._stamped = stamped
        kind = messages.TwistStamped if stamped else messages.Twist
        self._publisher: Publisher[Any] = transport.publisher(kind, topic, COMMANDS)

    def listeners(self) -> int:
        """Subscriptions that get the commands."""
        return self._publisher.listeners()

    def send(self, twist: Twist) -> None:
        """Publish ``twist`` [m/s, rad/s].

        Raises
        ------
        GeometryError : it is not finite
        TransportError : nobody listens, it cannot be sent, or the chassis is closed
        """
        if not is_finite(tuple(twist)):
            raise GeometryError(f"command must be finite, got {twist!r}")
        with self._lock:
            if self._closed:
                raise TransportError("the chassis is closed")
            if self.listeners() == 0:
                raise TransportError(f"nobody listens to {self._topic}")
            self._publish(twist)
            self._applied, self._sent_at = Twist(*twist), self._clock.now()

    def applied(self) -> Twist:
        """The command last sent, zero where the base has stopped for want of another."""
        with self._lock:
            if self._clock.now() - self._sent_at > self._timeout:
                return _REST
            return self._applied

    def stop(self) -> None:
        """Publish zero; a later ``send`` drives on.

        Raises
        ------
        TransportError : it cannot be sent; the base stops by its own time-out then
        """
        with self._lock:
            self._applied, self._sent_at = _REST, -math.inf
            if not self._closed:
                self._publish(_REST)

    def close(self, timeout: float = TIMEOUT) -> None:
        """Publish zero, and wait until the base has it; any number of times.

        Parameters
        ----------
        timeout : longest wait [s]; after that the base has stopped by itself
        """
        with self._lock:
            if self._closed:
                return
            self._applied, self._sent_at = _REST, -math.inf
            try:
                self._publish(_REST)
                self._publisher.flush(timeout)
            finally:
                self._closed = True

    def _publish(self, twist: Twist) -> None:
        made: messages.Message = twist_message(twist)
        if self._stamped:
            header = Header(self._stamps.now(), self._frame)
            made = messages.TwistStamped(header, twist_message(twist))
        self._publisher.publish(made)
