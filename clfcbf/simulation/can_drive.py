"""One simulated CiA-402 drive: objects, state machine, ramps and the faults that drives have."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.can_drive import import_canopen
from clfcbf.hardware.cia402 import DriveState

__all__ = ["Objects", "SimulatedDrive"]

Objects = Mapping[tuple[int, int], int | None]
"""Values by index and subindex; None for an object that is not there."""

_S = DriveState
_WORD = {
    _S.DISABLED: 0x0240, _S.READY: 0x0221, _S.SWITCHED_ON: 0x0233, _S.OPERATION_ENABLED: 0x0237,
    _S.QUICK_STOP: 0x0217, _S.FAULT_REACTION: 0x021F, _S.FAULT: 0x0218,
}  # fmt: skip
"""Status words, with the bits set that drives set beside the state: remote, voltage."""

RAMP = 100_000
"""[units/s²] Of the ramps until they are written: what a drive takes for a fifth of its speed."""

COASTING = 0.1
"""Share of the deceleration ramp at which a wheel without voltage comes to rest by friction."""

_LOST = 0x8130  # heartbeat of the master
_CEASED = 0x8250  # command frames
_TOO_SHORT = 0x8210
_UNMAPPABLE = 0x06040041  # of an SDO
_ALWAYS = 1 << 31  # a PDO that is switched off
_QUICK_STOP_REACTION = 3
_STAYS = range(5, 9)  # quick stop options that stay in QUICK STOP ACTIVE

_OBJECTS = (
    # index, subindex, struct code, value at power-up, writable
    (0x1000, 0, "I", 0x00020192, False),
    (0x1001, 0, "B", 0, False),
    (0x1016, 1, "I", 0, True),
    (0x1017, 0, "H", 0, True),
    (0x6007, 0, "h", 1, True),
    (0x603F, 0, "H", 0, False),
    (0x6040, 0, "H", 0, True),
    (0x605A, 0, "h", 2, True),
    (0x6060, 0, "b", 0, True),
    (0x6083, 0, "I", RAMP, True),
    (0x6084, 0, "I", RAMP, True),
    (0x6085, 0, "I", RAMP, True),
    (0x60FF, 0, "i", 0, True),
    (0x6502, 0, "I", 0x00000004, False),
    *((base, sub, code, value, True) for base in (0x1400, 0x1401, 0x1800)
      for sub, code, value in ((1, "I", _ALWAYS), (2, "B", 255), (5, "H", 0))),
    *((base, sub, code, 0, True) for base in (0x1600, 0x1601, 0x1A00)
      for sub, code in ((0, "B"), (1, "I"), (2, "I"))),
)  # fmt: skip


class SimulatedDrive:
    r"""A drive in profile velocity mode, as it behaves on the bus and at its shaft.

    The velocity runs along the ramps :math:`\dot q = \pm r` of the state: 0x6083 and 0x6084 in
    operation, 0x6085 in a quick stop and after a fault, friction without voltage. What an SDO
    has written is what it does: process data follow the mapping, watchdogs the objects 0x1016
    and 0x1401:5, and a quick stop the option 0x605A.

    Parameters
    ----------
    network : a ``canopen.Network``
    node : node number
    now : time [s] that the ramps run on; process data and watchdogs run on the machine's
    objects : values at power-up, by index and subindex, that differ; None for an object that
        the drive does not have

    Attributes
    ----------
    state : of the state machine
    mute, deaf : whether its status frames, and whether the command frames to it, are lost
    unmappable : indices of objects that it lets no frame carry
    """

    def __init__(
        self, network: Any, node: int, now: Callable[[], float], objects: Objects | None = None
    ) -> None:
        canopen = import_canopen()
        self.state = DriveState.DISABLED
        self.mute = self.deaf = False
        self.unmappable: set[int] = set()
        self._node_id = node
        self._now = now
        self._aborted = canopen.SdoAbortedError
        self._local = canopen.LocalNode(node, _dictionary(canopen, objects or {}))
        self._velocity, self._at = 0.0, now()
        self._target = 0
        self._word = 0
        self._pending: dict[int, bytes] = {}
        self._last_command = self._last_beat = math.nan
        self._last_status = -math.inf
        self._persistent = False
        self._local.add_write_callback(self._check_mapping)
        network.add_node(self._local)
        self._local.nmt.state = "INITIALISING"
        self._local.nmt.state = "PRE-OPERATIONAL"

    # What happens to it --------------------------------------------------------------------

    def silence(self) -> None:
        """Lose the heartbeat, and nothing else."""
        self._local.nmt.stop_heartbeat()

    def emergency(self, code: int, register: int = 1) -> None:
        """Send an emergency message, and go on."""
        self._local.emcy.send(code, register)

    def fail(self, code: int, register: int = 1, persistent: bool = False) -> None:
        """Go into the fault state, whose reset a ``persistent`` cause makes vain."""
        self._settle()
        self._persistent = persistent
        if self.state is not DriveState.FAULT:
            self.state = DriveState.FAULT_REACTION
        self.emergency(code, register)

    def restart(self) -> None:
        """Switch it off and on: it coasts, and knows nothing of its configuration any more."""
        self._settle()
        self.state, self._target, self._word = DriveState.DISABLED, 0, 0
        self._pending.clear()
        self._last_command = self._last_beat = math.nan
        self._local.nmt.stop_heartbeat()
        self._local.data_store.clear()
        self._local.nmt.state = "INITIALISING"
        self._local.nmt.state = "PRE-OPERATIONAL"

    def repair(self) -> None:
        """Remove the cause of a persistent fault."""
        self._persistent = False

    # What it does --------------------------------------------------------------------------

    def velocity(self) -> float:
        """Velocity of its shaft now [drive units]."""
        self._settle()
        return self._velocity

    def value(self, index: int, subindex: int = 0) -> int:
        """What an object holds."""
        try:
            data = self._local.get_data(index, subindex)
        except self._aborted:  # an object that this drive lacks acts as if never written
            return 0
        code = next(c for i, s, c, *_ in _OBJECTS if (i, s) == (index, subindex))
        return int(struct.unpack(f"<{code}", data)[0])

    def take(self, identifier: int, frame: bytes) -> None:
        """Take a frame from the bus, beside those that the object server takes."""
        beat = self.value(0x1016, 1)
        if beat and identifier == 0x700 + (beat >> 16 & 0x7F):
            self._last_beat = time.monotonic()
        if self._local.nmt.state != "OPERATIONAL" or self.deaf:
            return
        if identifier == 0x080:
            for number, pending in sorted(self._pending.items()):
                self._unpack(number, pending)
            self._pending.clear()
        for number in range(2):
            if identifier != self.value(0x1400 + number, 1):  # never while it is switched off
                continue
            if number == 1:
                self._last_command = time.monotonic()
            if self.value(0x1400 + number, 2) <= 240:
                self._pending[number] = frame
            else:
                self._unpack(number, frame)

    def tick(self) -> None:
        """Look at the watchdogs, and report if it is time."""
        self._settle()
        now = time.monotonic()
        beat = self.value(0x1016, 1) & 0xFFFF
        if beat and now - self._last_beat > 1e-3 * beat:
            self._last_beat = math.nan
            self._connection_lost(_LOST)
        deadline = self.value(0x1401, 5)
        if deadline and now - self._last_command > 1e-3 * deadline:
            self._last_command = math.nan
            self._connection_lost(_CEASED)
        period = self.value(0x1800, 5)
        identifier = self.value(0x1800, 1)
        due = period and now - self._last_status >= 1e-3 * period
        if due and identifier < _ALWAYS and self._local.nmt.state == "OPERATIONAL":
            self._last_status = now
            if not self.mute:
                self._local.network.send_message(identifier, self._status())

    def _status(self) -> bytes:
        """The status frame, as it is mapped."""
        packed = {0x6041: struct.pack("<H", _WORD[self.state]),
                  0x606C: struct.pack("<i", round(self._velocity))}  # fmt: skip
        entries = (self.value(0x1A00, 1 + i) for i in range(self.value(0x1A00)))
        return b"".join(packed[entry >> 16] for entry in entries)

    def _unpack(self, number: int, frame: bytes) -> None:
        """Write what a frame holds into the objects that it is mapped to."""
        for position in range(self.value(0x1600 + number)):
            entry = self.value(0x1600 + number, 1 + position)
            size = (entry & 0xFF) // 8
            if len(frame) < size:
                self.emergency(_TOO_SHORT, 0x10)
                return
            if entry >> 16 == 0x6040:
                self._control(struct.unpack("<H", frame[:size])[0])
            elif entry >> 16 == 0x60FF:
                self._settle()
                self._target = struct.unpack("<i", frame[:size])[0]
            elif entry >> 16 == 0x6085 and 0x6085 in self._local.object_dictionary:
                self._settle()
                self._local.set_data(0x6085, 0, frame[:size])
            frame = frame[size:]

    def _control(self, word: int) -> None:
        """The state machine; bits are voltage 1, quick stop 2 (active low), reset 7."""
        self._settle()
        before, self._word = self._word, word
        state = self.state
        if state in (_S.FAULT, _S.FAULT_REACTION):
            if state is _S.FAULT and word & ~before & 0x80 and not self._persistent:
                self.state = _S.DISABLED
                self._local.emcy.reset()
            return
        if not word & 0b0010:
            self.state = _S.DISABLED
        elif not word & 0b0100:
            self.state = (
                _S.QUICK_STOP if state in (_S.OPERATION_ENABLED, _S.QUICK_STOP) else _S.DISABLED
            )
        else:
            self.state = self._led(state, word)

    def _led(self, state: DriveState, word: int) -> DriveState:
        """One transition with voltage on and no quick stop asked for."""
        switched, enabled = bool(word & 0b0001), bool(word & 0b1000)
        if state is _S.QUICK_STOP:
            stays = self.value(0x605A) in _STAYS
            return _S.OPERATION_ENABLED if switched and enabled and stays else state
        if not switched or state is _S.DISABLED:
            return state if switched else _S.READY
        if state is _S.READY or not enabled:
            return _S.SWITCHED_ON
        return _S.OPERATION_ENABLED

    def _check_mapping(self, index: int, subindex: int, data: bytes, **_: Any) -> None:
        """Refuse an object that no frame carries, as a drive does when it is mapped."""
        mapping = index in (0x1600, 0x1601, 0x1A00) and subindex > 0
        if mapping and int.from_bytes(data, "little") >> 16 in self.unmappable:
            raise self._aborted(_UNMAPPABLE)

    def _connection_lost(self, code: int) -> None:
        self.emergency(code, 0x11)
        if self.value(0x6007) == _QUICK_STOP_REACTION and self.state is _S.OPERATION_ENABLED:
            self._settle()
            self.state = _S.QUICK_STOP

    def _settle(self) -> None:
        """Bring the velocity to now, and leave states that end at standstill."""
        elapsed = max(0.0, self._now() - self._at)
        self._at += elapsed
        target = float(self._target) if self.state is _S.OPERATION_ENABLED else 0.0
        if self.state is _S.OPERATION_ENABLED:
            speeding = abs(target) > abs(self._velocity) and target * self._velocity >= 0.0
            ramp = float(self.value(0x6083 if speeding else 0x6084))
        elif self.state in (_S.QUICK_STOP, _S.FAULT_REACTION):
            ramp = float(self.value(0x6085))
        else:
            ramp = COASTING * self.value(0x6084)
        way = target - self._velocity
        self._velocity += math.copysign(min(abs(way), ramp * elapsed), way)
        if self._velocity == 0.0:
            if self.state is _S.FAULT_REACTION:
                self.state = _S.FAULT
            elif self.state is _S.QUICK_STOP and self.value(0x605A) not in _STAYS:
                self.state = _S.DISABLED


_TYPES = {"b": "INTEGER8", "h": "INTEGER16", "i": "INTEGER32",
          "B": "UNSIGNED8", "H": "UNSIGNED16", "I": "UNSIGNED32"}  # fmt: skip


def _dictionary(canopen: Any, differing: Objects) -> Any:
    """The object dictionary with the values that differ."""
    from canopen import objectdictionary as objects

    known = {(index, subindex) for index, subindex, *_ in _OBJECTS}
    if unknown := set(differing) - known:
        texts = ", ".join(f"0x{index:04X}:{subindex}" for index, subindex in sorted(unknown))
        raise ConfigurationError(f"objects must be those of the drive, got {texts}")
    records = {index for index, subindex in known if subindex}
    dictionary = canopen.ObjectDictionary()
    for index in records:
        dictionary.add_object(objects.ODRecord(f"{index:04X}", index))
    for index, subindex, code, usual, writable in _OBJECTS:
        value = differing.get((index, subindex), usual)
        if value is None:
            continue
        variable = objects.ODVariable(f"{index:04X}_{subindex}", index, subindex)
        variable.data_type = getattr(objects, _TYPES[code])
        variable.access_type = "rw" if writable else "ro"
        variable.default = value
        if index in records:
            dictionary[index].add_member(variable)
        else:
            dictionary.add_object(variable)
    return dictionary
