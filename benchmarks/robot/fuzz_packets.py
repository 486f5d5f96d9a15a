"""Packets of the pose link: noise, forgeries, and what only a holder of the key could send."""

from __future__ import annotations

import math
import socket
from collections import Counter

import numpy as np

from benchmarks.robot.broken import BrokenError
from benchmarks.robot.mutation import mutated_bytes
from clfcbf.hardware.pose_link import MAX_AGE, MAX_AHEAD, PoseReceiver
from clfcbf.hardware.pose_packet import PACKET_SIZE, Packet, pack
from clfcbf.se2 import Pose2

__all__ = ["EPISODE", "check"]

EPISODE = 100
"""Packets to one receiver: enough for replays, restarts of the sender, and reordering."""

PARTNER = 7
LONGEST = 60_000
"""[byte] Of a datagram, a little less than UDP takes."""

_NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e15)
_SEQUENCES = (0, 1, 2**32, 2**63, 2**64 - 1)


class _Sender:
    """Makes packets of every kind, and knows which are genuine."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.key, self.other = rng.bytes(32), rng.bytes(32)
        self.session, self.sequence, self.now = rng.bytes(16), 0, float(rng.uniform(-1e6, 1e9))
        self.signed: list[tuple[bytes, Packet]] = []

    def _pose(self) -> Pose2:
        return Pose2(*self.rng.normal(size=3).tolist())

    def sign(self, packet: Packet, key: bytes | None = None) -> bytes:
        data = pack(packet, key or self.key)
        if key is None:
            self.signed.append((data, packet))
        return data

    def good(self) -> bytes:
        """The packet that an honest sender would send now."""
        self.sequence += 1
        return self.sign(Packet(PARTNER, self.session, self.sequence, self.now, self._pose()))

    def restart(self) -> None:
        """A new session, as of a sender that starts anew."""
        self.session, self.sequence = self.rng.bytes(16), 0

    def make(self) -> bytes:
        """A packet of some kind."""
        rng = self.rng
        kind = int(rng.integers(14))
        plain = Packet(PARTNER, self.session, self.sequence + 1, self.now, self._pose())
        if kind < 3:
            return self.good()
        if kind == 3:
            return rng.bytes(int(rng.integers(0, 300)))
        if kind == 4:
            return rng.bytes(PACKET_SIZE)
        if kind == 5:
            return mutated_bytes(rng, self.good())
        if kind == 6:
            return self.good() + rng.bytes(int(rng.integers(1, LONGEST)))
        if kind == 7:
            return self.sign(plain, self.other)
        if kind == 8:
            values = [*plain.pose, plain.stamp]
            values[int(rng.integers(4))] = float(rng.choice(_NUMBERS))
            return self.sign(plain._replace(pose=Pose2(*values[:3]), stamp=values[3]))
        if kind == 9:
            return self.sign(plain._replace(sender=int(rng.integers(1 << 16))))
        if kind == 10:
            return self.sign(plain._replace(stamp=self.now + float(rng.normal(0.0, 1.0))))
        if kind == 11:
            return self.sign(plain._replace(sequence=int(rng.choice(len(_SEQUENCES)))))
        if kind == 12:
            self.restart()
            return self.sign(plain._replace(session=rng.bytes(16)))
        if not self.signed:
            return b""
        return self.signed[int(rng.integers(len(self.signed)))][0]


def check(rng: np.random.Generator) -> Counter[str]:
    """One receiver's life: each packet is counted once, and none passes that must not."""
    sender = _Sender(rng)
    sent: list[bytes] = []
    outcomes: Counter[str] = Counter()
    passed: set[bytes] = set()
    latest = -math.inf
    with (
        PoseReceiver(sender.key, PARTNER, clock=lambda: sender.now) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link,
    ):

        def give(data: bytes) -> None:
            nonlocal latest
            sent.append(data)
            before = receiver.accepted, sum(receiver.counts.values())
            counts = receiver.counts
            link.sendto(data[:LONGEST], receiver.address)
            pose = receiver.poll()
            after = receiver.accepted, sum(receiver.counts.values())
            if sum(after) != sum(before) + 1 or (pose is None) != (after[0] == before[0]):
                raise _broken(f"packet {len(sent) - 1} was counted {before} to {after}", sent)
            if pose is None:
                (reason,) = (r for r, count in receiver.counts.items() if count > counts[r])
                outcomes[reason.value] += 1
                return
            outcomes["accepted"] += 1
            genuine = [packet for made, packet in sender.signed if made == data]
            if not genuine:
                raise _broken(f"packet {len(sent) - 1} is forged and passed", sent)
            packet, age = genuine[0], sender.now - genuine[0].stamp
            sound = all(map(math.isfinite, (packet.stamp, *packet.pose)))
            fresh = -MAX_AHEAD <= age <= MAX_AGE and packet.stamp > latest
            if not (sound and fresh and packet.sender == PARTNER and data not in passed):
                raise _broken(f"packet {len(sent) - 1}, {packet}, passed after {latest}", sent)
            if tuple(pose.pose) != tuple(packet.pose):
                raise _broken(f"packet {len(sent) - 1} came out as {pose}", sent)
            passed.add(data)
            latest = packet.stamp

        for _ in range(EPISODE - 1):
            sender.now += float(rng.exponential(0.05))
            give(sender.make())
        sender.now += 1.0  # whatever came before, an honest sender that starts now is heard
        sender.restart()
        give(sender.good())
        if sent[-1] not in passed:
            raise _broken("a good packet was ignored after the others", sent)
    return outcomes


def _broken(why: str, sent: list[bytes]) -> BrokenError:
    return BrokenError(why, b"\n".join(data.hex().encode() for data in sent))
