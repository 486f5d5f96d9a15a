"""The pose link: what passes is genuine, fresh, in order and new; all else is counted."""

from __future__ import annotations

import hashlib
import hmac
import math
import os
import random
import socket
import stat
import struct
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.hardware.pose_link import (
    BATCH,
    WINDOW,
    Gate,
    PartnerPose,
    PoseReceiver,
    PoseSender,
    Rejection,
)
from clfcbf.hardware.pose_packet import PACKET_SIZE, Packet, create_key, pack, read_key
from clfcbf.se2 import Pose2

KEY = bytes(range(32))
OTHER_KEY = bytes(range(1, 33))
POSE = Pose2(1.0, -0.1, 0.3)
SESSION = b"s" * 16
PARTNER = 7
posix = pytest.mark.skipif(os.name != "posix", reason="needs permissions")


def packet(sequence=0, stamp=100.0, session=SESSION, sender=PARTNER, pose=POSE, key=KEY):
    return pack(Packet(sender, session, sequence, stamp, pose), key)


def by_hand(sender, session, sequence, stamp, x, y, theta, key=KEY):
    """The packet from its description, and the tag from the definition of HMAC."""
    body = b"CFP1" + sender.to_bytes(2, "big") + session + sequence.to_bytes(8, "big")
    body += b"".join(struct.pack("!d", value) for value in (stamp, x, y, theta))
    block = key.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(byte ^ 0x36 for byte in block) + body).digest()
    return body + hashlib.sha256(bytes(byte ^ 0x5C for byte in block) + inner).digest()


# Packets -----------------------------------------------------------------------------------------


@given(
    sender=st.integers(0, 65535), session=st.binary(min_size=16, max_size=16),
    sequence=st.integers(0, 2**64 - 1), values=st.tuples(*[st.floats(-1e9, 1e9)] * 4),
)  # fmt: skip
def test_a_packet_is_what_is_described_and_passes_to_the_last_bit(
    sender, session, sequence, values
):
    stamp, *pose = values
    data = packet(sequence, stamp, session, sender, Pose2(*pose))
    assert data == by_hand(sender, session, sequence, *values)
    assert len(data) == PACKET_SIZE
    assert Gate(KEY, sender).judge(data, stamp) == PartnerPose(Pose2(*pose), stamp, stamp)


def test_ten_thousand_packets_of_all_kinds():
    """Noise of any length, and genuine packets with some bits turned: none passes, none raises."""
    rng = random.Random(3)
    gate = Gate(KEY, PARTNER)
    assert isinstance(gate.judge(packet(0, 100.0), 100.0), PartnerPose)
    counts = dict.fromkeys(Rejection, 0)
    passed = 0
    for sequence in range(1, 10_001):
        good = bytearray(packet(sequence, 100.0 + 1e-6 * sequence))
        kind = sequence % 5
        if kind == 0:
            data = rng.randbytes(rng.randrange(0, 300))
        elif kind == 1:
            data = rng.randbytes(PACKET_SIZE)
        elif kind == 2:
            good[rng.randrange(PACKET_SIZE)] ^= 1 << rng.randrange(8)
            data = bytes(good)
        elif kind == 3:
            data = bytes(good[: rng.randrange(PACKET_SIZE)])
        else:
            data = bytes(good) + rng.randbytes(
                rng.randrange(1, 70_000) if sequence % 50 == 4 else 1
            )
        found = gate.judge(data, 100.0)
        if isinstance(found, PartnerPose):
            passed += 1
        else:
            counts[found] += 1
            size = len(data)
            expected = Rejection.FORGED
            if size != PACKET_SIZE:
                expected = Rejection.HUGE if size > PACKET_SIZE else Rejection.TRUNCATED
            assert found is expected
    assert passed == 0
    assert sum(counts.values()) == 10_000
    assert min(counts[k] for k in (Rejection.FORGED, Rejection.HUGE, Rejection.TRUNCATED)) > 1000
    assert isinstance(gate.judge(packet(20_000, 100.1), 100.1), PartnerPose)  # none did harm


@pytest.mark.parametrize("bit", range(PACKET_SIZE * 8))
def test_every_bit_is_authenticated(bit):
    data = bytearray(packet())
    data[bit // 8] ^= 1 << bit % 8
    assert Gate(KEY, PARTNER).judge(bytes(data), 100.0) is Rejection.FORGED


def test_another_key_or_another_robot_does_not_pass():
    gate = Gate(KEY, PARTNER)
    assert gate.judge(packet(key=OTHER_KEY), 100.0) is Rejection.FORGED
    assert gate.judge(packet(sender=PARTNER + 1), 100.0) is Rejection.FOREIGN
    assert isinstance(gate.judge(packet(), 100.0), PartnerPose)


def test_a_packet_of_another_version_does_not_pass():
    body = b"CFP0" + packet()[4:-32]
    data = body + hmac.new(KEY, body, hashlib.sha256).digest()
    assert Gate(KEY, PARTNER).judge(data, 100.0) is Rejection.FORGED


@pytest.mark.parametrize("index", range(4))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_does_not_pass_though_genuine(index, value):
    values = [100.0, 1.0, 2.0, 3.0]
    values[index] = value
    gate = Gate(KEY, PARTNER)
    assert gate.judge(by_hand(PARTNER, SESSION, 0, *values), 100.0) is Rejection.NOT_FINITE
    assert isinstance(gate.judge(packet(), 100.0), PartnerPose)


# Time and order ----------------------------------------------------------------------------------


def test_age_and_clocks_that_differ():
    for now, expected in (
        (100.0, None), (100.5, None), (100.501, Rejection.STALE), (99.96, None),
        (99.9, Rejection.AHEAD), (math.nan, Rejection.STALE), (math.inf, Rejection.STALE),
    ):  # fmt: skip
        found = Gate(KEY, PARTNER).judge(packet(), now)
        assert found is expected or (expected is None and isinstance(found, PartnerPose)), now


deliveries = st.lists(
    st.tuples(
        st.integers(0, 2),  # session
        st.integers(0, 90),  # sequence
        st.floats(0.0, 0.3),  # how long it took
    ),
    max_size=120,
)


@given(deliveries=deliveries)
@settings(max_examples=150)
def test_whatever_is_delivered_passes_once_fresh_and_in_order(deliveries):
    """Any order, any repetition, sessions mixed, against a model that remembers everything."""
    gate = Gate(KEY, PARTNER, max_age=0.2)
    passed, seen, ended = [], set(), set()
    now = 100.0
    for session, sequence, delay in deliveries:
        name = bytes([session]) * 16
        stamp = 100.0 + 10.0 * session + 0.1 * sequence  # each packet has one stamp
        now = max(now, stamp + delay)
        found = gate.judge(packet(sequence, stamp, name), now)
        current = passed[-1][0] if passed else None
        newer = not passed or stamp > passed[-1][2]
        fresh = now - stamp <= 0.2
        before = session == current and sequence <= passed[-1][1]
        if isinstance(found, PartnerPose):
            assert newer
            assert fresh
            assert session not in ended
            assert (session, sequence) not in {entry[:2] for entry in passed}
            if current is not None and current != session:
                ended.add(current)
            passed.append((session, sequence, stamp))
        elif found is Rejection.REPLAYED:
            far = before and passed[-1][1] - sequence >= WINDOW
            assert (session, sequence) in seen or session in ended or far
        elif found is Rejection.REORDERED:
            assert before
            assert (session, sequence) not in {entry[:2] for entry in passed}
        else:
            assert found is Rejection.STALE
            assert not (newer and fresh)
        seen.add((session, sequence))
    stamps = [entry[2] for entry in passed]
    assert stamps == sorted(set(stamps))


def test_late_packets_are_told_from_replayed_ones():
    gate = Gate(KEY, PARTNER)
    for sequence in (0, 1, 100):
        assert isinstance(gate.judge(packet(sequence, 100 + 1e-3 * sequence), 100.1), PartnerPose)
    late = 100 - WINDOW + 1
    assert gate.judge(packet(late, 100.0), 100.1) is Rejection.REORDERED
    assert gate.judge(packet(late, 100.0), 100.1) is Rejection.REPLAYED
    assert gate.judge(packet(late - 1, 100.0), 100.1) is Rejection.REPLAYED
    assert gate.judge(packet(100, 100.1), 100.1) is Rejection.REPLAYED


def test_a_jump_of_the_sequence_costs_nothing():
    gate = Gate(KEY, PARTNER)
    for sequence in (0, 2**63, 2**64 - 1):
        found = gate.judge(packet(sequence, 100.0 + 1e-21 * sequence), 100.1)
        assert isinstance(found, PartnerPose)
    assert gate.judge(packet(2**64 - 2, 100.0), 100.1) is Rejection.REORDERED


def test_a_recorded_session_cannot_be_played_again():
    """Neither while it lasts, nor after a restart of the sender, nor after one's own."""
    recorded = [packet(k, 100.0 + 0.01 * k) for k in range(100)]
    gate = Gate(KEY, PARTNER)
    for k, data in enumerate(recorded):
        assert isinstance(gate.judge(data, 100.0 + 0.01 * k), PartnerPose)
    assert {gate.judge(data, 101.0) for data in recorded} == {Rejection.REPLAYED}
    assert isinstance(gate.judge(packet(0, 101.0, b"n" * 16), 101.0), PartnerPose)
    assert {gate.judge(data, 101.0) for data in recorded} == {Rejection.REPLAYED}
    assert {Gate(KEY, PARTNER).judge(data, 102.0) for data in recorded} == {Rejection.STALE}


def test_many_restarts_forget_no_more_than_names():
    gate = Gate(KEY, PARTNER)
    names = [bytes([k]) * 16 for k in range(40)]
    for k, name in enumerate(names):
        assert isinstance(gate.judge(packet(0, 100.0 + 1e-3 * k, name), 100.1), PartnerPose)
    found = {gate.judge(packet(1, 100.0 + 1e-3 * k, n), 100.1) for k, n in enumerate(names[:-1])}
    assert found == {Rejection.REPLAYED, Rejection.STALE}


# Sockets -----------------------------------------------------------------------------------------


def polled(receiver, tries=200):
    for _ in range(tries):
        found = receiver.poll()
        if found is not None:
            return found
        time.sleep(0.005)
    return None


def settled(receiver, total):
    """Poll until ``total`` packets were judged."""
    for _ in range(400):
        receiver.poll()
        if sum(receiver.counts.values()) + receiver.accepted >= total:
            return
        time.sleep(0.005)


def test_a_pose_goes_over():
    with PoseReceiver(KEY, PARTNER) as receiver:
        host, port = receiver.address
        assert host == "127.0.0.1"
        assert receiver.poll() is None
        with PoseSender(KEY, PARTNER, port) as sender:
            before = time.time()
            assert sender.send(POSE)
            found = polled(receiver)
            assert found is not None
            assert found.pose == POSE
            assert before <= found.stamp <= found.received <= time.time()
            assert receiver.poll() is None
            for k in range(5):
                sender.send(POSE._replace(x=float(k)))
            settled(receiver, 6)
        with PoseSender(KEY, PARTNER, port) as again:
            again.send(POSE._replace(x=9.0))
            found = polled(receiver)
        assert found is not None
        assert found.pose.x == 9.0
        assert receiver.accepted == 7
        assert set(receiver.counts.values()) == {0}


def test_only_the_newest_is_handed_out_and_a_call_is_bounded():
    with PoseReceiver(KEY, PARTNER) as receiver, PoseSender(
        KEY, PARTNER, receiver.address[1]
    ) as sender:  # fmt: skip
        now = time.time()
        for k in range(BATCH + 10):
            sender.send(POSE._replace(x=float(k)), now + 1e-4 * k)
        time.sleep(0.05)
        first, second = receiver.poll(), receiver.poll()
        assert first is not None
        assert second is not None
        assert (first.pose.x, second.pose.x) == (BATCH - 1, BATCH + 9)
        assert receiver.accepted == BATCH + 10


def test_each_kind_is_counted():
    now = 100.0
    with (
        PoseReceiver(KEY, PARTNER, clock=lambda: now) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker,
    ):
        good = packet(5, 100.0)
        sent = {
            Rejection.HUGE: [good + b"x", good * 400],
            Rejection.TRUNCATED: [b"", good[:-1], b"x"],
            Rejection.FORGED: [packet(9, 100.1, key=OTHER_KEY)],
            Rejection.FOREIGN: [packet(9, 100.1, sender=1)],
            Rejection.NOT_FINITE: [packet(9, 100.1, pose=Pose2(math.nan, 0.0, 0.0))],
            Rejection.STALE: [packet(9, 99.0)],
            Rejection.AHEAD: [packet(9, 101.0)],
            Rejection.REPLAYED: [good, good],
            Rejection.REORDERED: [packet(4, 99.9)],
        }
        assert set(sent) == set(Rejection)
        flat = [good, *(data for group in sent.values() for data in group)]
        for data in flat:
            attacker.sendto(data, receiver.address)
        settled(receiver, len(flat))
        assert receiver.counts == {kind: len(group) for kind, group in sent.items()}
        assert receiver.accepted == 1


def test_the_sender_refuses_what_is_no_pose():
    with PoseSender(KEY, 1, 9) as sender:
        for pose, stamp in ((Pose2(math.nan, 0.0, 0.0), 0.0), (POSE, math.inf)):
            with pytest.raises(GeometryError, match="finite"):
                sender.send(pose, stamp)


def test_settings_out_of_range_are_refused():
    for options, told in (
        ({"key": b""}, "key"), ({"key": "secret"}, "key"), ({"partner": -1}, "partner"),
        ({"partner": 65536}, "partner"), ({"partner": 1.0}, "partner"),
        ({"max_age": math.nan}, "max_age"), ({"max_age": -1.0}, "max_age"),
        ({"max_ahead": math.inf}, "max_ahead"), ({"host": "203.0.113.1"}, "cannot listen"),
        ({"port": 70_000}, "70000"), ({"host": "no such host"}, "no such host"),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=told):
            PoseReceiver(**{"key": KEY, "partner": 1, **options})
    for options, told in (({"robot": 70_000}, "robot"), ({"port": 0}, "port"), ({"key": b""}, "k")):
        with pytest.raises(ConfigurationError, match=told):
            PoseSender(**{"key": KEY, "robot": 1, "port": 9, **options})
    with PoseReceiver(KEY, 1) as taken, pytest.raises(ConfigurationError, match="cannot listen"):
        PoseReceiver(KEY, 1, taken.address[1])


# Keys --------------------------------------------------------------------------------------------


def test_a_new_key_is_random_private_and_read_back(tmp_path):
    create_key(tmp_path / "one")
    create_key(tmp_path / "two")
    one, two = read_key(tmp_path / "one"), read_key(str(tmp_path / "two"))
    assert len(one) == len(two) == 32
    assert one != two
    with pytest.raises(ConfigurationError, match="File exists"):
        create_key(tmp_path / "one")
    assert read_key(tmp_path / "one") == one
    if os.name == "posix":
        assert stat.S_IMODE((tmp_path / "one").stat().st_mode) == 0o600


@posix
@pytest.mark.parametrize("mode", [0o604, 0o640, 0o660, 0o602, 0o610, 0o777])
def test_a_key_that_others_may_touch_is_refused(mode, tmp_path):
    create_key(tmp_path / "key")
    (tmp_path / "key").chmod(mode)
    with pytest.raises(ConfigurationError, match=f"mode 0600 or 0400, got {mode:04o}"):
        read_key(tmp_path / "key")
    (tmp_path / "key").chmod(0o400)
    assert len(read_key(tmp_path / "key")) == 32


@posix
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs root")
def test_a_key_of_another_user_is_refused(tmp_path):
    create_key(tmp_path / "key")
    os.chown(tmp_path / "key", 12345, -1)
    with pytest.raises(ConfigurationError, match="must belong to user 0 or 0, got 12345"):
        read_key(tmp_path / "key")


@posix
def test_pipes_and_folders_are_no_keys_and_nobody_waits_for_them(tmp_path):
    os.mkfifo(tmp_path / "pipe", 0o600)
    (tmp_path / "folder").mkdir(0o700)
    for name in ("pipe", "folder"):
        with pytest.raises(ConfigurationError, match="no regular file"):
            read_key(tmp_path / name)
    for name in ("none", "a\0b"):
        with pytest.raises(ConfigurationError, match="cannot read key"):
            read_key(tmp_path / name)


@given(content=st.one_of(st.binary(max_size=80), st.text("0123456789abcdef \n", max_size=70)))
def test_any_content_is_a_key_or_refused_and_never_told(content, tmp_path_factory):
    path = tmp_path_factory.mktemp("key") / "key"
    data = content.encode() if isinstance(content, str) else content
    path.write_bytes(data)
    path.chmod(0o600)
    try:
        key = read_key(path)
    except ConfigurationError as error:
        told = str(error).replace(repr(str(path)), "")
        assert len(data) < 8 or data.decode("latin-1").strip() not in told
    else:
        assert len(key) >= 32
        assert key.hex() == "".join(data.decode().lower().split())


@pytest.mark.parametrize(
    ("size", "told"),
    [(0, "at least 32 bytes, got 0"), (31, "at least 32 bytes, got 31"), (512, ""),
     (513, "at most 1024 characters"), (10**6, "at most 1024 characters")],
)  # fmt: skip
def test_keys_of_the_wrong_length_are_refused(size, told, tmp_path):
    path = tmp_path / "key"
    path.write_text("ab" * size)
    path.chmod(0o600)
    if not told:
        assert read_key(path) == b"\xab" * size
        return
    with pytest.raises(ConfigurationError, match=told):
        read_key(path)
