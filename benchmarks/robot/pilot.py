"""The control process of its own: what is killed with SIGKILL, and what takes its place."""

from __future__ import annotations

from multiprocessing.connection import Connection

from benchmarks.robot.rig import DOCKS, LEFT, RIGHT, WHEELS, Setting, can_timing
from benchmarks.robot.wire import open_wire
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.runtime import ControlLoop
from clfcbf.scene import Observation
from clfcbf.session import DockingSession, PhaseControllers

__all__ = ["pilot"]

TRIES = 4
"""Times that a fault of the drives is reset: a robot that has one every few seconds is no robot."""


class _Piped:
    """A target sensor whose measurements come through a pipe."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def observe(self) -> Observation | None:
        newest: Observation | None = None
        while self._pipe.poll():
            newest = self._pipe.recv()
        return newest


def pilot(port: int, pipe: Connection, setting: Setting, longest: float) -> None:
    """Dock through the wire on ``port``; says how it went through the pipe."""
    from clfcbf.hardware.can_drives import CanDriveError, CanDrives

    wire, _ = open_wire(port)
    chassis = CanDrives(
        wire, LEFT, RIGHT, WHEELS, timing=can_timing(setting), quick_stop=setting.bounds
    )
    try:
        session = DockingSession(
            PhaseControllers(lambda dock: setting.controller()), DOCKS, setting.bounds,
            setting.period,
        )  # fmt: skip
        session.dock("a")
        loop = ControlLoop(
            session, chassis, _Piped(pipe), MonotonicClock(), period=setting.period,
            limits=setting.bounds,
        )  # fmt: skip
        for _ in range(TRIES):
            try:
                loop.run(longest)
            except CanDriveError:  # a machine that starves the drives' side for a tenth of a second
                chassis.release()
            else:
                break
        result = session.result
        pipe.send((result is not None and result.success, "" if result is None else result[3]))
    finally:
        chassis.close()
