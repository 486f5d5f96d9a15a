"""CAN frames between two processes, over UDP on this machine: as lossy as a bus, and as dumb."""

from __future__ import annotations

import select
import socket
import struct
from typing import Any

from clfcbf.errors import MissingExtraError

__all__ = ["open_wire"]

_FRAME = struct.Struct(">IB8s")


def open_wire(peer: int | None = None) -> tuple[Any, int]:
    """A python-can bus and its port; it talks to ``peer``, or to whoever talked to it last."""
    try:
        import can
    except ImportError as error:
        raise MissingExtraError("python-can", "can") from error

    class Wire(can.BusABC):
        def __init__(self) -> None:
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.bind(("127.0.0.1", 0))
            self.socket.setblocking(False)
            self.peer = None if peer is None else ("127.0.0.1", peer)
            self.channel_info = f"wire {self.socket.getsockname()[1]}"
            super().__init__(channel=self.channel_info)

        def send(self, msg: Any, timeout: float | None = None) -> None:
            if self.peer is None:
                return
            data = bytes(msg.data)
            try:
                self.socket.sendto(
                    _FRAME.pack(msg.arbitration_id, len(data), data.ljust(8, b"\0")), self.peer
                )
            except (BlockingIOError, ConnectionError):  # nobody listens: frames vanish
                return

        def _recv_internal(self, timeout: float | None) -> tuple[Any, bool]:
            ready, _, _ = select.select([self.socket], [], [], timeout)
            if not ready:
                return None, False
            try:
                frame, sender = self.socket.recvfrom(_FRAME.size + 1)
            except (BlockingIOError, ConnectionError):
                return None, False
            if peer is None:
                self.peer = sender
            identifier, size, data = _FRAME.unpack(frame)
            return can.Message(
                arbitration_id=identifier, data=data[:size], is_extended_id=False
            ), False

        def shutdown(self) -> None:
            super().shutdown()
            self.socket.close()

    wire = Wire()
    return wire, wire.socket.getsockname()[1]
