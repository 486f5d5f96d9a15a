"""A simulated robot behind the topics of a real one: takes commands, tells where the dock is."""

from __future__ import annotations

import math
import threading
import time
from typing import Any, NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.ros2 import messages
from clfcbf.ros2.chassis import CMD_VEL, TIMEOUT, twist_of
from clfcbf.ros2.detection import DetectionFrame
from clfcbf.ros2.messages import Clock, Header, PoseStamped
from clfcbf.ros2.stamps import Stamps
from clfcbf.ros2.target import DETECTED
from clfcbf.ros2.transport import EVENTS, LATEST, Quality, Transport, absolute
from clfcbf.runtime.simulated import CapturingSensor, PlantInTheLoop
from clfcbf.se2 import Pose2, is_finite
from clfcbf.simulation.plant import Plant

__all__ = ["TRUTH", "SimulatedRobot"]

TRUTH = "ground_truth"
"""Topic of the robot's true pose in the dock's frame, for whoever judges."""

TRUTH_PERIOD = 0.03
"""[s] Between two true poses: a camera's frame, rounded down so that a lockstep tells each."""

STEP = 0.004
"""[s] Between two looks for commands in real time: a tenth of a camera's frame."""

PATIENCE = 1.0
"""[s] Longer than a controller takes to be built, and than any planning."""

POLL = 2e-4
"""[s] Between two looks for the command of a lockstep."""

RELIABLE = Quality(reliable=True, depth=1)
"""Of what is published: who wants less may."""


class _Heard(NamedTuple):
    """Whether there was any command, and one of this very time."""

    any: bool
    of_now: bool


class SimulatedRobot:
    """A plant and its sensor as a node: ``cmd_vel`` in, ``detected_dock_pose`` out.

    In real time it keeps up with the machine's clock. In lockstep time passes only for commands:
    the time is told on ``/clock``, and goes on by ``step`` once a command stamped with it has come
    (or nobody has sent any for a while, so that the next task can begin); a run is as fast as
    the machines are.

    Parameters
    ----------
    plant, sensor : as for :class:`~clfcbf.runtime.PlantInTheLoop`
    transport : that carries the messages; not closed with the robot
    namespace : of the topics
    frame : that poses of the dock are told in
    stamped : takes ``TwistStamped``, else ``Twist``
    timeout : without a command until it stops [s]
    step : of a lockstep, the period of the loop [s]; None for real time
    patience : of a lockstep with a command that it expects, of the machine's time [s]

    Raises
    ------
    ConfigurationError : a lockstep of commands without stamps, or no positive duration
    """

    def __init__(
        self,
        plant: Plant,
        sensor: CapturingSensor,
        transport: Transport,
        namespace: str = "",
        *,
        frame: DetectionFrame | None = None,
        stamped: bool = True,
        timeout: float = TIMEOUT,
        step: float | None = None,
        patience: float = PATIENCE,
    ) -> None:
        if step is not None and not (stamped and step > 0.0):
            raise ConfigurationError(f"a lockstep needs stamps and a step > 0 s, got {step!r}")
        self._plant = plant
        self._robot = PlantInTheLoop(plant, sensor, MonotonicClock() if step is None else None)
        self._stamps = Stamps(self._robot) if step is None else Stamps(self._robot, None)
        # A nanosecond more: a time told is never short of the one that the loop waits for.
        self._step = None if step is None else math.floor(1e9 * step) + 1
        self._frame = frame if frame is not None else DetectionFrame()
        self._timeout = timeout
        self._patience = patience
        kind: Any = messages.TwistStamped if stamped else messages.Twist
        self._stamped = stamped
        self._commands = transport.subscription(kind, absolute(namespace, CMD_VEL), LATEST)
        self._poses = transport.publisher(PoseStamped, absolute(namespace, DETECTED), RELIABLE)
        self._truth = transport.publisher(PoseStamped, absolute(namespace, TRUTH), EVENTS)
        self._clock = None if step is None else transport.publisher(Clock, "/clock", RELIABLE)
        self._time = 0
        self._heard_at = -math.inf
        self._in_step = False
        self._told_at = -math.inf
        self.refused = 0
        """Commands that were not finite."""

    def pose(self) -> Pose2:
        """The truth, in the dock's frame."""
        return self._plant.pose()

    def run(self, over: threading.Event) -> None:
        """Drive until ``over`` is set."""
        while not over.is_set():
            self.step()

    def step(self) -> None:
        """Take commands, tell what is seen, let some time pass."""
        if self._clock is not None:
            self._step_together(self._clock)
            return
        self._take()
        self._tell()
        self._robot.sleep_until(self._robot.now() + STEP)

    def close(self) -> None:
        """Release what the simulation holds."""
        self._robot.close()

    def _step_together(self, clock: Any) -> None:
        self._tell()
        clock.publish(Clock(messages.Time.of(self._time)))
        end = time.monotonic() + self._patience
        heard = self._take()
        while self._in_step and not heard.of_now and time.monotonic() < end:
            time.sleep(POLL)
            heard = self._take()
        if not self._in_step:
            time.sleep(POLL)  # nobody drives: leave the processor to whoever decides to
        self._in_step = heard.of_now or (heard.any and not self._in_step)
        assert self._step is not None
        self._time += self._step
        self._robot.sleep_until(1e-9 * self._time)

    def _take(self) -> _Heard:
        """Obey the newest command; what was heard."""
        heard = of_now = False
        for message in self._commands.take():
            heard = True
            twist = twist_of(message.twist if self._stamped else message)
            of_now |= self._stamped and message.header.stamp.nanoseconds >= self._time
            if is_finite(tuple(twist)):
                self._robot.send(twist)
                self._heard_at = self._robot.now()
            else:
                self.refused += 1
        if self._robot.now() - self._heard_at > self._timeout:
            self._robot.stop()
        return _Heard(heard, of_now)

    def _tell(self) -> None:
        observation = self._robot.observe()
        if observation is not None:
            header = Header(self._stamps.at(observation.stamp), self._frame.name)
            self._poses.publish(PoseStamped(header, self._frame.encode(observation.feature)))
        now = self._robot.now()
        if now - self._told_at >= TRUTH_PERIOD:
            self._told_at = now
            truth = DetectionFrame("dock").encode(self._plant.pose())
            self._truth.publish(PoseStamped(Header(self._stamps.now(), "dock"), truth))
