"""Parts that can be killed in the middle of a run, and brought back."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from clfcbf.hardware.protocols import TargetSensor
from clfcbf.qp import Backend, Capability, QpSolution, QpStatus, QuadraticProgram, get_backend
from clfcbf.scene import Observation

__all__ = ["Cable", "MortalBackend", "MortalSensor", "SensorDiedError"]


class SensorDiedError(RuntimeError):
    """The camera's driver is gone."""


class MortalSensor:
    """A sensor that can be silenced, frozen, or made to raise.

    Attributes
    ----------
    fate : "" while it works, else "silent", "raises" or "frozen" (its last frame again and again)
    """

    def __init__(self, inner: TargetSensor) -> None:
        self._inner = inner
        self._last: Observation | None = None
        self.fate = ""

    def observe(self) -> Observation | None:
        found = self._inner.observe()
        if self.fate == "raises":
            raise SensorDiedError("no frame from /dev/video0")
        if self.fate == "frozen":
            return self._last
        if self.fate == "silent":
            return None
        self._last = found if found is not None else self._last
        return found


class MortalBackend:
    """A backend that can be made to raise, to answer with no number, or to hang for a while.

    Attributes
    ----------
    fate : "" while it works, else "raises", "nan" or "hangs"
    hang : what passes the time while it hangs
    """

    capability = Capability()
    name = "mortal"

    def __init__(self, hang: Callable[[], None] = lambda: time.sleep(0.25)) -> None:
        self._inner: Backend = get_backend("daqp")
        self.fate = ""
        self.hang = hang

    def solve(self, problem: QuadraticProgram, time_limit: float | None = None) -> QpSolution:
        if self.fate == "raises":
            raise RuntimeError("licence server unreachable")
        if self.fate == "nan":
            return QpSolution(np.full(problem.n, math.nan), QpStatus.OPTIMAL, self.name)
        if self.fate == "hangs":
            self.hang()
        return self._inner.solve(problem)


class Cable:
    """A python-can bus whose cable can be cut and mended.

    Cut, frames vanish without a word in both directions; off, the controller has left the bus
    and every call raises.
    """

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self._send, self._recv = bus.send, bus.recv
        self.fate = ""
        bus.send, bus.recv = self._sending, self._receiving

    def _fail(self) -> None:
        import can

        if self.fate == "off":
            raise can.CanOperationError("bus off")

    def _sending(self, message: Any, timeout: float | None = None) -> None:
        self._fail()
        if not self.fate:
            self._send(message, timeout)

    def _receiving(self, timeout: float | None = None) -> Any:
        self._fail()
        message = self._recv(timeout)
        return None if self.fate else message
