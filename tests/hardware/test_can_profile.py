"""CiA 402 as data, against canopen's own tables and against arithmetic on bytes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.can_settings import CanTiming, WheelDrive
from clfcbf.hardware.cia402 import (
    Control,
    DriveState,
    Status,
    control_frame,
    emergency_of,
    emergency_text,
    enabling,
    state_of,
    status_of,
    target_frame,
)

NAMES = {
    "NOT READY TO SWITCH ON": DriveState.NOT_READY,
    "SWITCH ON DISABLED": DriveState.DISABLED,
    "READY TO SWITCH ON": DriveState.READY,
    "SWITCHED ON": DriveState.SWITCHED_ON,
    "OPERATION ENABLED": DriveState.OPERATION_ENABLED,
    "FAULT": DriveState.FAULT,
    "FAULT REACTION ACTIVE": DriveState.FAULT_REACTION,
    "QUICK STOP ACTIVE": DriveState.QUICK_STOP,
}


@pytest.fixture(scope="module")
def tables():
    return pytest.importorskip("canopen.profiles.p402", reason="needs the extra can").State402


def test_states_of_all_status_words(tables):
    for word in range(1 << 10):  # bits above are the modes' and the maker's
        found = [NAMES[n] for n, (mask, bits) in tables.SW_MASK.items() if word & mask == bits]
        assert state_of(word) is (found[0] if found else DriveState.UNKNOWN)
        assert state_of(word | 0xFC00) is state_of(word)


def test_every_step_toward_operation_is_a_transition_of_the_profile(tables):
    by_state = {state: name for name, state in NAMES.items()}
    for state, name in by_state.items():
        word = enabling(state, 0)
        legal = {w for (start, _), w in tables.TRANSITIONTABLE.items() if start == name and w}
        if state is DriveState.OPERATION_ENABLED:
            assert word == tables.CW_OPERATION_ENABLED
        elif word is None:
            assert state in (DriveState.NOT_READY, DriveState.FAULT_REACTION)
        else:
            assert word in legal


def test_operation_is_reached_from_every_state_that_can_leave(tables):
    for start in (DriveState.DISABLED, DriveState.QUICK_STOP, DriveState.FAULT):
        state, last = start, int(Control.FAULT_RESET)
        for _ in range(6):
            word = enabling(state, last)
            rising = word & ~last & 0x80
            after = {w: NAMES[end] for (begin, end), w in tables.TRANSITIONTABLE.items()
                     if NAMES.get(begin) is state}  # fmt: skip
            if state is not DriveState.FAULT or rising:
                state = after.get(int(word), state)
            last = int(word)
        assert state is DriveState.OPERATION_ENABLED


def test_a_reset_needs_its_rising_edge():
    assert enabling(DriveState.FAULT, 0) == Control.FAULT_RESET
    assert not enabling(DriveState.FAULT, Control.FAULT_RESET) & 0x80


@given(st.integers(0, 2**16 - 1), st.integers(-(2**31), 2**31 - 1))
def test_frames_are_little_endian(word, velocity):
    assert control_frame(word) == bytes((word % 256, word // 256))
    wrapped = velocity % 2**32
    data = bytes(wrapped // 256**i % 256 for i in range(4))
    assert target_frame(velocity) == data
    assert status_of(control_frame(word) + data) == Status(word, velocity)


@pytest.mark.parametrize("velocity", [2**31, -(2**31) - 1])
def test_velocities_beyond_32_bits_are_refused(velocity):
    with pytest.raises(ConfigurationError, match=str(velocity)):
        target_frame(velocity)


@pytest.mark.parametrize("size", [0, 1, 5, 7, 9])
def test_frames_of_other_lengths_say_nothing(size):
    assert status_of(bytes(size)) is None
    assert emergency_of(bytes(size)) is None


def test_emergencies_in_words():
    frame = bytes((0x10, 0x23, 0x03, 1, 2, 3, 4, 5))
    emergency = emergency_of(frame)
    assert emergency.code == 0x2310
    assert emergency.detail == bytes((1, 2, 3, 4, 5))
    assert str(emergency) == "0x2310: continuous overcurrent (error register: generic, current)"
    assert emergency_text(0x23FE) == "0x23FE: current"
    assert emergency_text(0xB000) == "0xB000: not defined by the profile"


@given(st.floats(1e-2, 1e6), st.booleans(), st.floats(-50.0, 50.0))
def test_units_round_to_half_a_unit(scale, mirrored, rate):
    drive = WheelDrive(1, -scale if mirrored else scale)
    units = drive.units(rate)
    assert abs(drive.rate(units) - rate) <= 0.5 / scale * (1.0 + 1e-9)
    assert math.copysign(1.0, drive.rate(0)) == 1.0


@given(st.floats(1e-3, 1e5))
def test_a_ramp_is_never_zero_and_has_its_own_scale(acceleration):
    assert WheelDrive(1, -7.0).ramp(acceleration) == max(1, round(7.0 * acceleration))
    assert WheelDrive(1, -7.0, 3.0).ramp(acceleration) == max(1, round(3.0 * acceleration))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((0, 1.0), "node"), ((128, 1.0), "node"), ((True, 1.0), "node"), ((1.5, 1.0), "node"),
        ((1, 0.0), "scale"), ((1, math.nan), "scale"), ((1, math.inf), "scale"),
        ((1, 1.0, 0.0), "acceleration_scale"), ((1, 1.0, math.inf), "acceleration_scale"),
    ],
)  # fmt: skip
def test_wrong_drives_are_refused(arguments, told):
    with pytest.raises(ConfigurationError, match=f"^{told}"):
        WheelDrive(*arguments)


@pytest.mark.parametrize("name", CanTiming.__dataclass_fields__)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, 31.0])
def test_wrong_times_are_refused(name, value):
    with pytest.raises(ConfigurationError, match=name):
        CanTiming(**{name: value})


def test_silence_leaves_room_for_a_lost_frame():
    with pytest.raises(ConfigurationError, match="silence"):
        CanTiming(heartbeat=0.2, silence=0.3)
