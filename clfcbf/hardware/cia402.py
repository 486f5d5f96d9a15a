r"""The device profile CiA 402 of electric drives: states, control words, frames and errors as data.

A drive reports its state in the status word (object 0x6041) and is led by the control word
(0x6040) from SWITCH ON DISABLED through READY TO SWITCH ON and SWITCHED ON to OPERATION ENABLED,
where it follows the target velocity (0x60FF) [IEC2015]_. Nothing here knows a bus.

>>> state_of(0x0637)
<DriveState.OPERATION_ENABLED: 'operation enabled'>
>>> emergency_text(0x8130, 0x11)
'0x8130: heartbeat of the master lost (error register: generic, communication)'
"""

from __future__ import annotations

import struct
from enum import Enum, IntEnum
from typing import NamedTuple

from clfcbf.errors import ConfigurationError

__all__ = [
    "Control",
    "DriveState",
    "Emergency",
    "Status",
    "control_frame",
    "emergency_of",
    "emergency_text",
    "enabling",
    "state_of",
    "status_of",
    "target_frame",
]

TARGET_RANGE = (-(2**31), 2**31 - 1)
"""Of the target velocity, a signed 32-bit integer [drive units]."""


class DriveState(Enum):
    """States of the power drive system."""

    NOT_READY = "not ready to switch on"
    DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"
    """A combination of bits that the profile does not define."""


_PATTERNS = (
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.OPERATION_ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP),
    (0x4F, 0x0F, DriveState.FAULT_REACTION),
    (0x4F, 0x08, DriveState.FAULT),
)
"""Bits of the status word that tell, their values, and the state."""


class Control(IntEnum):
    """Control words; quick stop is active low, so that a word of zeros stops as well."""

    DISABLE_VOLTAGE = 0x0000
    QUICK_STOP = 0x0002
    SHUTDOWN = 0x0006
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    FAULT_RESET = 0x0080


_ENABLING = {
    DriveState.DISABLED: Control.SHUTDOWN,
    DriveState.READY: Control.SWITCH_ON,
    DriveState.SWITCHED_ON: Control.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: Control.ENABLE_OPERATION,
    DriveState.QUICK_STOP: Control.ENABLE_OPERATION,
}


def state_of(statusword: int) -> DriveState:
    """State that a status word reports; bits that the profile leaves to others are ignored."""
    for mask, bits, state in _PATTERNS:
        if statusword & mask == bits:
            return state
    return DriveState.UNKNOWN


def enabling(state: DriveState, last: int) -> Control | None:
    """Control word that leads one state further toward OPERATION ENABLED; None where to wait.

    A fault is reset by the rising edge of bit 7, so a word without that bit comes first.

    Parameters
    ----------
    state : that the drive reports
    last : control word sent last
    """
    if state is DriveState.FAULT:
        return Control.DISABLE_VOLTAGE if last & Control.FAULT_RESET else Control.FAULT_RESET
    return _ENABLING.get(state)


class Status(NamedTuple):
    """Content of the status frame: status word, and velocity as measured [drive units]."""

    word: int
    velocity: int

    @property
    def state(self) -> DriveState:
        """State that the word reports."""
        return state_of(self.word)


_STATUS = struct.Struct("<Hi")
_CONTROL = struct.Struct("<H")
_TARGET = struct.Struct("<i")
_EMERGENCY = struct.Struct("<HB5s")


def status_of(frame: bytes) -> Status | None:
    """What a status frame says, None where its length is another."""
    return Status(*_STATUS.unpack(frame)) if len(frame) == _STATUS.size else None


def control_frame(word: int) -> bytes:
    """The frame of a control word, little-endian as everything in CANopen."""
    return _CONTROL.pack(word)


def target_frame(velocity: int) -> bytes:
    """The frame of a target velocity [drive units].

    Raises
    ------
    ConfigurationError : it does not fit into 32 bits; the scale is wrong
    """
    low, high = TARGET_RANGE
    if not low <= velocity <= high:
        raise ConfigurationError(f"a target velocity must be in [{low}, {high}], got {velocity}")
    return _TARGET.pack(velocity)


class Emergency(NamedTuple):
    """An emergency message: error code, error register, and five bytes of the maker's."""

    code: int
    register: int
    detail: bytes

    def __str__(self) -> str:
        return emergency_text(self.code, self.register)


def emergency_of(frame: bytes) -> Emergency | None:
    """What an emergency frame says, None where its length is another."""
    return Emergency(*_EMERGENCY.unpack(frame)) if len(frame) == _EMERGENCY.size else None


_REGISTER = ("generic", "current", "voltage", "temperature", "communication", "device profile",
             "reserved", "manufacturer")  # fmt: skip
"""Meaning of the error register's bits, the lowest first [CiA2011]_."""

_CODES = {
    0x2220: "continuous overcurrent inside the drive",
    0x2310: "continuous overcurrent",
    0x2320: "short circuit or earth leakage",
    0x2350: "motor overloaded (I²t)",
    0x3110: "mains overvoltage",
    0x3120: "mains undervoltage",
    0x3210: "supply overvoltage",
    0x3220: "supply undervoltage",
    0x4210: "drive too hot",
    0x4310: "motor or drive too hot",
    0x5441: "emergency stop input",
    0x5530: "parameter memory",
    0x6010: "software reset by the watchdog",
    0x6320: "a parameter is wrong",
    0x7121: "motor blocked",
    0x7122: "motor error or commutation",
    0x7305: "encoder signals",
    0x7500: "communication inside the drive",
    0x8110: "CAN overrun, messages lost",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of the master lost",
    0x8140: "recovered from CAN bus off",
    0x8210: "command frame too short",
    0x8220: "command frame too long",
    0x8250: "command frames ceased",
    0x8400: "velocity controller",
    0x8500: "position controller",
    0x8611: "following error",
}
"""Error codes that drives send in practice, as the two profiles define them."""

_CLASSES = {
    0x0: "no error",
    0x1: "generic error",
    0x2: "current",
    0x3: "voltage",
    0x4: "temperature",
    0x5: "hardware",
    0x6: "software",
    0x7: "motor, brake or sensor",
    0x8: "monitoring",
    0x9: "external error",
    0xF: "specific to the device",
}


def emergency_text(code: int, register: int = 0) -> str:
    """An error code and the error register in words; a code not known by its class."""
    words = _CODES.get(code) or _CLASSES.get(code >> 12) or "not defined by the profile"
    bits = ", ".join(name for bit, name in enumerate(_REGISTER) if register >> bit & 1)
    return f"0x{code:04X}: {words}" + (f" (error register: {bits})" if bits else "")
