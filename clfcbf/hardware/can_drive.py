"""One CiA-402 drive behind CANopen: its configuration, its start, and what it reports.

Command and status travel in process data objects (PDO): the control word in the first receive
PDO, taken at once; the target velocity in the second, taken at the next SYNC, so that both
wheels change at the same instant, and with it, where that is asked for, the deceleration of the
next quick stop; status word and velocity in the first transmit PDO, sent periodically. Everything
else is written once by SDO [CiA2011]_.
"""

from __future__ import annotations

import struct
import threading
import time
from typing import Any

from clfcbf.errors import ClfcbfError, MissingExtraError
from clfcbf.hardware.can_settings import MASTER, CanTiming, WheelDrive
from clfcbf.hardware.cia402 import (
    Control,
    DriveState,
    Emergency,
    Status,
    control_frame,
    emergency_of,
    enabling,
    status_of,
    target_frame,
)

__all__ = ["CanDrive", "CanDriveError", "import_canopen"]

_PROFILE_VELOCITY = 3
_STOP_AND_STAY = 6  # quick stop on its own ramp, and then stay in QUICK STOP ACTIVE
_CONNECTION_LOST = 3  # answered with a quick stop
_INVALID = 1 << 31  # of a PDO while it is being configured
_AT_ONCE, _AT_SYNC = 255, 1
_ONE, _TWO, _FOUR = (struct.Struct(f"<{kind}") for kind in "BHI")
_TARGET, _RAMP = 0x60FF0020, 0x60850020  # as they are mapped: index, subindex, bits
_BOOTED = b"\x00"  # a heartbeat that says: just switched on


STILL = 0.01
"""[rad/s] Below which a wheel stands: the last digit of an encoder, under 1 mm/s at the rim."""


class CanDriveError(ClfcbfError):
    """A drive does not answer, reports a fault, or left operation; the message says which."""


def import_canopen() -> Any:
    """The library, or ``MissingExtraError``."""
    try:
        import canopen
    except ImportError as error:
        raise MissingExtraError("canopen", "can") from error
    return canopen


class CanDrive:
    """One drive on a CANopen network, with what it last reported.

    Its methods but ``start`` return without waiting. Frames come in on the network's thread.

    Parameters
    ----------
    network : a connected ``canopen.Network``
    name : of the wheel, for messages
    drive, timing : see there

    Attributes
    ----------
    status : last reported, None before the first
    unsupported : optional objects that the drive does not have, in words
    restarted : whether it was switched off and on since it was configured
    """

    def __init__(self, network: Any, name: str, drive: WheelDrive, timing: CanTiming) -> None:
        canopen = import_canopen()
        self.name = name
        self.status: Status | None = None
        self.unsupported: tuple[str, ...] = ()
        self.restarted = False
        self._carries = False
        self._drive = drive
        self._timing = timing
        self._network = network
        self._aborted = canopen.SdoAbortedError
        self._failures = (canopen.SdoCommunicationError, canopen.SdoAbortedError)
        self._node = network.add_node(drive.node, canopen.ObjectDictionary())
        self._word = int(Control.DISABLE_VOLTAGE)
        self._reported = threading.Condition()
        self._emergency: Emergency | None = None
        self._status_at = self._heartbeat_at = time.monotonic()
        node = drive.node
        network.subscribe(0x180 + node, self._on_status)
        network.subscribe(0x080 + node, self._on_emergency)
        network.subscribe(0x700 + node, self._on_heartbeat)

    def __str__(self) -> str:
        return f"{self.name} drive (node {self._drive.node})"

    @property
    def state(self) -> DriveState:
        """State last reported."""
        status = self.status
        return DriveState.UNKNOWN if status is None else status.state

    @property
    def is_still(self) -> bool:
        """Whether its wheel did not turn when it last reported."""
        status = self.status
        return status is not None and abs(self._drive.rate(status.velocity)) < STILL

    def stands(self, since: float) -> bool:
        """Whether it has reported, after ``since`` [s], that it is stopped and stands.

        A report from before may be one from before it began to move.
        """
        return (
            self.is_still
            and self._status_at > since
            and self.state is not DriveState.OPERATION_ENABLED
        )

    def target(self, units: int, ramp: int = 1) -> None:
        """Send a target velocity [drive units], which takes effect at the next SYNC.

        With it goes ``ramp``, the deceleration of a quick stop from there [drive units], if the
        drive takes it from the frame.
        """
        frame = target_frame(units) + (_FOUR.pack(ramp) if self._carries else b"")
        self._network.send_message(0x300 + self._drive.node, frame)

    def control(self, word: int) -> None:
        """Send a control word."""
        self._word = int(word)
        self._network.send_message(0x200 + self._drive.node, control_frame(word))

    def fault(self, now: float, enabled: bool) -> str:
        """What is wrong with the drive, in words; empty if nothing is.

        Parameters
        ----------
        now : time [s] of the monotonic clock
        enabled : whether it has to be in operation
        """
        if (emergency := self._emergency) is not None:
            return f"{self}: emergency {emergency}"
        if self.restarted:
            return f"{self}: was switched off and on, and has lost its configuration"
        silence = self._timing.silence
        if now - self._heartbeat_at > silence:
            return f"{self}: no heartbeat for longer than {silence:g} s"
        if now - self._status_at > silence:
            return f"{self}: no status frame for longer than {silence:g} s"
        state = self.state
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            return f"{self}: {state.value}"
        if enabled and state is not DriveState.OPERATION_ENABLED:
            return f"{self}: {state.value} instead of operation enabled"
        return ""

    def configure(
        self, acceleration: float, quick_stop: float | None, carried: bool = False
    ) -> None:
        """Write everything that is written once; the drive is pre-operational during it.

        Parameters
        ----------
        acceleration : of the wheel's ramps [rad/s²], infinite leaves the drive's own
        quick_stop : deceleration of the quick stop [rad/s²], None leaves the drive's own
        carried : each command frame carries that of a quick stop from its command, if the drive
            can do that; ``quick_stop`` is for one that cannot, and until the first command

        Raises
        ------
        CanDriveError : the drive does not answer, is of another profile, refuses a value, or
            could not notice that this side is gone
        """
        self.unsupported, self.restarted = (), False
        self._node.nmt.state = "PRE-OPERATIONAL"
        try:
            self._write_all(acceleration, quick_stop, carried)
        except self._failures as error:
            raise CanDriveError(f"{self}: {error}") from error
        self._node.nmt.state = "OPERATIONAL"
        self._heartbeat_at = self._status_at = time.monotonic()  # from when on both are due

    def start(self) -> None:
        """Lead the drive to OPERATION ENABLED, out of a fault too; waits for it.

        Raises
        ------
        CanDriveError : it does not get there in time; the message names the state it is in
        """
        try:  # the target that was in force when it stopped must not be driven to
            self._write(0x60FF, 0, target_frame(0))
        except self._failures as error:
            raise CanDriveError(f"{self}: {error}") from error
        deadline = time.monotonic() + self._timing.startup
        with self._reported:
            self.status = None  # what it reports from now on counts
            self._emergency = None
            while (state := self.state) is not DriveState.OPERATION_ENABLED:
                word = enabling(state, self._word)
                if word is not None:
                    self.control(word)
                left = deadline - time.monotonic()
                if left <= 0.0:
                    why = f"; emergency {self._emergency}" if self._emergency else ""
                    raise CanDriveError(
                        f"{self}: {state.value} instead of operation enabled after "
                        f"{self._timing.startup:g} s{why}"
                    )
                self._reported.wait(min(left, self._timing.status))

    def _write_all(self, acceleration: float, quick_stop: float | None, carried: bool) -> None:
        kind = self._read(0x1000, 0) & 0xFFFF
        if kind != 402:
            raise CanDriveError(f"{self}: device profile {kind}, and 402 is needed")
        if not self._read(0x6502, 0) >> (_PROFILE_VELOCITY - 1) & 1:
            raise CanDriveError(f"{self}: has no profile velocity mode")
        node, timing, write = self._drive.node, self._timing, self._write
        write(0x6060, 0, _ONE.pack(_PROFILE_VELOCITY))
        write(0x605A, 0, struct.pack("<h", _STOP_AND_STAY))
        write(0x60FF, 0, target_frame(0))
        if acceleration != float("inf"):
            ramp = _FOUR.pack(self._drive.ramp(acceleration))
            write(0x6083, 0, ramp)
            write(0x6084, 0, ramp)
        if quick_stop is not None:
            write(0x6085, 0, _FOUR.pack(self._drive.ramp(quick_stop)))
        write(0x1017, 0, _TWO.pack(_milliseconds(timing.heartbeat)))
        self._map(0x1400, 0x1600, 0x200 + node, _AT_ONCE, (0x60400010,))
        self._map_target(carried)
        period = _milliseconds(timing.status)
        self._map(0x1800, 0x1A00, 0x180 + node, _AT_ONCE, (0x60410010, 0x606C0020), period)
        self._watch_master()

    def _map_target(self, carried: bool) -> None:
        """Target velocity, and if the drive lets it be mapped, the ramp of a quick stop."""
        node = self._drive.node
        self._carries = carried
        try:
            mapped = (_TARGET, _RAMP) if carried else (_TARGET,)
            self._map(0x1401, 0x1601, 0x300 + node, _AT_SYNC, mapped)
        except CanDriveError:
            if not carried:
                raise
            self._carries = False
            self.unsupported = (*self.unsupported, "quick stop ramp in command frames (0x6085)")
            self._map(0x1401, 0x1601, 0x300 + node, _AT_SYNC, (_TARGET,))

    def _watch_master(self) -> None:
        """Let the drive stop by itself when this side falls silent."""
        timing = self._timing
        beats = _FOUR.pack(MASTER << 16 | _milliseconds(timing.silence))
        ceased = _TWO.pack(_milliseconds(2.0 * timing.timeout))
        heartbeat = self._optional("heartbeat consumer (0x1016)", 0x1016, 1, beats)
        frames = self._optional("deadline of command frames (0x1401:5)", 0x1401, 5, ceased)
        if not (heartbeat or frames):
            raise CanDriveError(
                f"{self}: has neither a heartbeat consumer nor a deadline of command frames, so "
                "it would drive on when this process is gone"
            )
        reaction = struct.pack("<h", _CONNECTION_LOST)
        self._optional("reaction to a lost connection (0x6007)", 0x6007, 0, reaction)

    def _map(
        self, communication: int, mapping: int, identifier: int, kind: int,
        objects: tuple[int, ...], period: int = 0,
    ) -> None:  # fmt: skip
        """Configure a PDO in the order that CiA 301 demands: off, mapping, on."""
        write = self._write
        write(communication, 1, _FOUR.pack(_INVALID | identifier))
        write(communication, 2, _ONE.pack(kind))
        if period:
            write(communication, 5, _TWO.pack(period))
        write(mapping, 0, _ONE.pack(0))
        for position, mapped in enumerate(objects, 1):
            write(mapping, position, _FOUR.pack(mapped))
        write(mapping, 0, _ONE.pack(len(objects)))
        write(communication, 1, _FOUR.pack(identifier))

    def _read(self, index: int, subindex: int) -> int:
        return int.from_bytes(self._node.sdo.upload(index, subindex)[:4], "little")

    def _write(self, index: int, subindex: int, data: bytes) -> None:
        try:
            self._node.sdo.download(index, subindex, data)
        except self._aborted as error:
            raise CanDriveError(f"{self}: refuses 0x{index:04X}:{subindex}: {error}") from error

    def _optional(self, name: str, index: int, subindex: int, data: bytes) -> bool:
        try:
            self._node.sdo.download(index, subindex, data)
        except self._aborted:
            self.unsupported = (*self.unsupported, name)
            return False
        return True

    def _on_status(self, _: int, frame: bytearray, __: float) -> None:
        status = status_of(bytes(frame))
        if status is None:  # a frame that says nothing is as good as none
            return
        with self._reported:
            self.status, self._status_at = status, time.monotonic()
            self._reported.notify_all()

    def _on_emergency(self, _: int, frame: bytearray, __: float) -> None:
        emergency = emergency_of(bytes(frame))
        if emergency is not None and emergency.code >> 8:  # the others say that an error is over
            self._emergency = emergency

    def _on_heartbeat(self, _: int, frame: bytearray, __: float) -> None:
        self._heartbeat_at = time.monotonic()
        if bytes(frame) == _BOOTED:
            self.restarted = True


def _milliseconds(duration: float) -> int:
    return max(1, round(1e3 * duration))
