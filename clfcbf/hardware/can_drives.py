r"""A differential drive of two CiA-402 drives on a CAN bus, in profile velocity mode.

A twist becomes two wheel rates, two target velocities in drive units, two frames and a SYNC at
which both drives take theirs. Whatever goes wrong ends in a quick stop of *both* wheels, since
one alone would turn the robot: a fault, an emergency message or a silent drive (noticed here),
commands that cease (noticed here after ``timeout``), and a process that is gone (noticed by the
drives, whose heartbeat consumer and frame deadline are set for it).

A quick stop at one deceleration bends the robot's path: the slower wheel stands first. Given the
limits of the twist, each command frame also tells its drive how to stop from that command,

.. math:: d_i = |s_i| / t, \qquad t = \max(|v| / a_{max}, |\omega| / \alpha_{max})

with the rim speeds :math:`s_i`: both wheels then stand after the same time :math:`t`, on the same
circle and within the limits, also when nobody is left to tell them anything.

A fault stays: ``send`` raises with its text until ``release``. Needs the extra ``can``.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from clfcbf.errors import ConfigurationError, GeometryError, MissingExtraError
from clfcbf.hardware.can_drive import CanDrive, CanDriveError, import_canopen
from clfcbf.hardware.can_settings import MASTER, CanTiming, WheelDrive
from clfcbf.hardware.cia402 import Control
from clfcbf.limits import Limits
from clfcbf.se2 import Twist, is_finite
from clfcbf.wheels import WheelLimits

__all__ = ["CanDriveError", "CanDrives", "CanTiming", "WheelDrive", "open_bus"]

_REST = Twist(0.0, 0.0)
_OPERATIONAL = b"\x05"  # what a heartbeat says of this side
_SYNC = 0x080

WATCH = 0.01
"""[s] Between two looks at the drives and at the time of the last command."""

LISTEN = 0.05
"""[s] For which the receiving thread waits for a frame, so that closing takes no longer."""


def open_bus(interface: str, channel: str, **options: Any) -> Any:
    """A python-can bus, such as ``open_bus("socketcan", "can0")``.

    Raises
    ------
    MissingExtraError : python-can is not installed
    can.CanError : the bus cannot be opened
    """
    try:
        import can
    except ImportError as error:
        raise MissingExtraError("python-can", "can") from error
    return can.Bus(interface=interface, channel=channel, **options)


LEAST = 0.1
"""Share of the deceleration of both wheels alike that a wheel stops with at least: one that is
told to stand may still be turning a little."""


class _Receiving:
    """Keeps the thread that receives alive when the bus fails, and says how it did."""

    def __init__(self, network: Any) -> None:
        self._network = network
        self.error = ""

    def __call__(self, _: Any) -> None:
        self.error = ""

    def on_error(self, error: Exception) -> None:
        self.error = str(error) or type(error).__name__
        self._network.notifier.exception = None  # which sending would raise for ever after
        time.sleep(WATCH)


class CanDrives:
    """The chassis of two drives; making one configures them and leads them into operation.

    Parameters
    ----------
    bus : a python-can bus, see :func:`open_bus`; it is closed with the chassis
    left, right : the drives of the wheels
    wheels : geometry and limits; its acceleration, if finite, becomes the drives' own ramps and
        has to leave room for that of the twists
    timing : periods and time-outs
    quick_stop : the limits that a quick stop keeps to, along the circle that the robot is on; or
        one deceleration of both wheels, at the rim [m/s²]; None leaves the drives' own

    Attributes
    ----------
    drives : left and right, with what they last reported

    Raises
    ------
    MissingExtraError : canopen is not installed
    ConfigurationError : both drives have one node number, or that of this side, or the quick
        stop is not finite and positive
    CanDriveError : a drive cannot be started

    Notes
    -----
    The command sent is the twist slowed along its own curvature where a wheel cannot follow, and
    rounded to drive units; ``applied`` gives that. Its error is at most half a unit per wheel.

    A drive that cannot take its quick stop's deceleration from command frames says so in its
    ``unsupported``; both then have the largest that keeps to the limits in any case.

    While the wheels still turn after a stop, a command counts as one to stand, and ``applied`` says
    so: taken up at once it would brake them as hard as their ramps can.
    """

    def __init__(
        self,
        bus: Any,
        left: WheelDrive,
        right: WheelDrive,
        wheels: WheelLimits,
        *,
        timing: CanTiming | None = None,
        quick_stop: float | Limits | None = None,
    ) -> None:
        canopen = import_canopen()
        self._limits = quick_stop if isinstance(quick_stop, Limits) else None
        stop = alike(quick_stop, wheels) if isinstance(quick_stop, Limits) else quick_stop
        _check(left, right, stop)
        self._timing = timing or CanTiming()
        self._settings = (left, right)
        self._wheels = wheels
        self._lock = threading.RLock()
        self._applied = _REST
        self._moving = self._stopping = False
        self._halted_at = -math.inf
        self._fault = "not started"
        self._sent_at = self._enabled_at = self._beat_at = -math.inf
        self._closed = threading.Event()
        self._network = canopen.Network(bus)
        self._receiving = _Receiving(self._network)
        self._network.listeners.append(self._receiving)
        self._network.NOTIFIER_CYCLE = LISTEN
        self._network.connect()
        self._watch = threading.Thread(target=self._watching, name="can drives", daemon=True)
        try:
            self.drives = (
                CanDrive(self._network, "left", left, self._timing),
                CanDrive(self._network, "right", right, self._timing),
            )
            rate = 1.0 / wheels.radius
            least = None if stop is None else stop * rate
            self._ramps = (1, 1) if least is None else (left.ramp(least), right.ramp(least))
            self._configuration = (wheels.acceleration * rate, least, self._limits is not None)
            for drive in self.drives:
                drive.configure(*self._configuration)
            self._watch.start()
            self.release()
        except BaseException:
            self._closed.set()
            if self._watch.is_alive():
                self._watch.join()
            self._network.disconnect()
            raise

    @property
    def fault(self) -> str:
        """What stopped the drives, in words; empty if nothing did."""
        return self._fault

    def send(self, twist: Twist) -> None:
        """Take ``twist`` [m/s, rad/s] as the command from now on.

        Raises
        ------
        GeometryError : it is not finite
        CanDriveError : a drive is at fault until ``release``, or the bus does not take frames
        """
        if not is_finite(tuple(twist)):
            raise GeometryError(f"command must be finite, got {twist!r}")
        with self._lock:
            self._refuse()
            if self._still_turns():
                self._applied, self._sent_at = _REST, time.monotonic()
                return
            rates = self._wheels.wheel_rates(self._wheels.scaled(twist))
            left, right = (d.units(rate) for d, rate in zip(self._settings, rates, strict=True))
            self._prepare_stop(twist, rates)
            now = time.monotonic()
            self._guarded(lambda: self._targets(left, right))
            if not self._moving:  # out of the quick stop, or in operation already
                self._guarded(lambda: self._control(Control.ENABLE_OPERATION))
                self._moving, self._enabled_at = True, now
            self._sent_at = now
            first, second = self._settings
            self._applied = self._wheels.twist_of(first.rate(left), second.rate(right))

    def applied(self) -> Twist:
        """The command in force, zero when the drives were stopped or commands have ceased."""
        with self._lock:
            if time.monotonic() - self._sent_at > self._timing.timeout:
                return _REST  # also where the thread that stops the drives is a moment late
            return self._applied

    def velocity(self) -> Twist:
        """The twist that the drives measure, NaN before their first report."""
        rates = [
            math.nan if (status := drive.status) is None else wheel.rate(status.velocity)
            for wheel, drive in zip(self._settings, self.drives, strict=True)
        ]
        return self._wheels.twist_of(*rates)

    def stop(self) -> None:
        """Stop both drives quickly; a later ``send`` takes them into operation again.

        Raises
        ------
        CanDriveError : the bus does not take frames; the drives stop by themselves then
        """
        with self._lock:
            self._rest()
            if not self._closed.is_set():
                self._guarded(self._halt)

    def release(self) -> None:
        """Reset a fault and lead the drives into operation again, at rest; waits for it.

        A drive that was switched off meanwhile is configured anew.

        Raises
        ------
        CanDriveError : a drive does not get there, or the bus does not take frames; the fault
            stays
        """
        with self._lock:
            self._rest()
            self._fault = self._fault or "being released"  # takes no command meanwhile
            self._receiving.error = ""
        try:
            self._halt()
            self._await_standstill()
            for drive in self.drives:
                if drive.restarted:
                    drive.configure(*self._configuration)
                drive.start()
        except CanDriveError:
            raise
        except Exception as error:  # of the bus, whose kinds are many
            raise CanDriveError(f"the bus does not take frames: {error}") from error
        with self._lock:
            self._fault, self._stopping = "", False

    def close(self) -> None:
        """Stop the drives, switch them off and close the bus; any number of times."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._watch.join()
        with self._lock:
            self._rest()
            self._fault = "closed"
            try:
                self._halt()
                self._await_standstill()
                self._control(Control.DISABLE_VOLTAGE)
            finally:
                self._network.disconnect()

    def _refuse(self) -> None:
        """Raise where a command must not be taken."""
        if not self._fault and (found := self._found(time.monotonic())):
            self._trip(found)
        if self._fault:
            raise CanDriveError(self._fault)

    def _found(self, now: float) -> str:
        if self._receiving.error:
            return f"the bus cannot be read: {self._receiving.error}"
        enabled = self._moving and now - self._enabled_at > self._timing.reaction
        return next((text for d in self.drives if (text := d.fault(now, enabled))), "")

    def _trip(self, fault: str) -> None:
        """Stop both wheels, whichever it was, and keep the reason."""
        self._fault = fault
        self._rest()
        try:
            self._halt()
        except Exception as error:  # the drives miss the heartbeat then, and stop by themselves
            self._fault = f"{fault}; and the bus does not take frames: {error}"

    def _rest(self) -> None:
        if self._moving and (self._applied != _REST or not all(d.is_still for d in self.drives)):
            self._stopping, self._halted_at = True, time.monotonic()
        self._applied, self._sent_at, self._moving = _REST, -math.inf, False

    def _guarded(self, send: Callable[[], None]) -> None:
        """Frames that do not go out stop everything, as far as that can still be told."""
        try:
            send()
        except Exception as error:
            self._rest()
            self._fault = f"the bus does not take frames: {error}"
            raise CanDriveError(self._fault) from error

    def _prepare_stop(self, twist: Twist, rates: tuple[float, float]) -> None:
        """The decelerations that stop both wheels at once from ``twist``; at rest the last ones."""
        if self._limits is None:
            return
        v, omega = self._wheels.scaled(twist)
        time_to_rest = max(abs(v) / self._limits.a_max, abs(omega) / self._limits.alpha_max)
        if time_to_rest == 0.0:
            return
        least = LEAST * alike(self._limits, self._wheels) / self._wheels.radius
        left, right = (
            drive.ramp(max(abs(rate) / time_to_rest, least))
            for drive, rate in zip(self._settings, rates, strict=True)
        )
        self._ramps = left, right

    def _still_turns(self) -> bool:
        """Whether a quick stop is in progress, as far as the drives have told."""
        if self._stopping and all(drive.stands(self._halted_at) for drive in self.drives):
            self._stopping = False
        return self._stopping

    def _halt(self) -> None:
        self._control(Control.QUICK_STOP)
        self._targets(0, 0)

    def _control(self, word: Control) -> None:
        for drive in self.drives:
            drive.control(word)

    def _targets(self, left: int, right: int) -> None:
        for drive, units, ramp in zip(self.drives, (left, right), self._ramps, strict=True):
            drive.target(units, ramp)
        self._network.send_message(_SYNC, b"")

    def _beat(self) -> None:
        """This side's heartbeat; at rest also zeros, which the drives' deadline wants to see."""
        self._beat_at = time.monotonic()
        self._network.send_message(0x700 + MASTER, _OPERATIONAL)
        if not self._moving:
            self._targets(0, 0)

    def _watching(self) -> None:
        """Look after drives and commands; the heartbeat comes from here, and ends with it."""
        while not self._closed.wait(WATCH):
            with self._lock:
                now = time.monotonic()
                try:
                    if not self._fault and (found := self._found(now)):
                        self._trip(found)
                    if self._moving and now - self._sent_at > self._timing.timeout:
                        self._rest()
                        self._halt()
                    if now - self._beat_at >= self._timing.heartbeat:
                        self._beat()
                except Exception as error:  # of the bus; this thread has to look on
                    self._rest()
                    self._fault = self._fault or f"the bus does not take frames: {error}"

    def _await_standstill(self) -> None:
        """Wait, not for ever, until the wheels stand: without voltage they would coast."""
        since = time.monotonic()
        while time.monotonic() < since + self._timing.startup:
            if all(drive.stands(since) for drive in self.drives):
                return
            self._beat()
            time.sleep(WATCH)


def alike(limits: Limits, wheels: WheelLimits) -> float:
    r"""Largest rim deceleration of both wheels alike that keeps to the limits [m/s²].

    Both wheels at :math:`d` change the speed by :math:`d` at most, and the turn rate, where they
    turn in opposite directions, by :math:`2d/b`: so :math:`d = \min(a_{max}, \alpha_{max}\,b/2)`.
    """
    return min(limits.a_max, 0.5 * wheels.track * limits.alpha_max)


def _check(left: WheelDrive, right: WheelDrive, quick_stop: float | None) -> None:
    nodes = (left.node, right.node)
    if left.node == right.node or MASTER in nodes:
        raise ConfigurationError(
            f"the drives must have two node numbers other than {MASTER}, this side's, got {nodes}"
        )
    if quick_stop is not None and not 0.0 < quick_stop < math.inf:
        raise ConfigurationError(
            f"quick_stop must be finite and positive [m/s²], got {quick_stop!r}"
        )
