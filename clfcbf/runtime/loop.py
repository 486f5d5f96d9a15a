r"""The control loop: see, decide, send, once a period; and the brake at every way out.

A tick is due at :math:`t_k`, and its command by :math:`t_k + T`, its deadline. In time, the next
is due at :math:`t_k + T`; after a miss at a period after the late command, for two commands
closer together than :math:`T` would accelerate harder than the limits say. Ticks that were
missed are not made up for. Each command is decided in its own tick, never sent again.

Whatever ends a run (the controller, a signal, an exception anywhere, too many misses), the same
follows: the brake from the command in force, tick by tick inside the acceleration limits, to
zero, then ``stop``. An exception is raised again once that is done, and the report names the part
it came from. It also names the parts whose failures the run survived, such as a solver whose
answers were replaced.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from clfcbf.decision import Decision, Phase
from clfcbf.errors import ConfigurationError, LimitsError
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.protocols import Chassis, Clock, TargetSensor
from clfcbf.limits import Limits, check_period
from clfcbf.runtime.braking import Braking
from clfcbf.runtime.ending import come_to_rest
from clfcbf.runtime.parts import Part
from clfcbf.runtime.policy import Ending, LoopPolicy, LoopReport, Overrun
from clfcbf.runtime.signals import caught
from clfcbf.runtime.statistics import LoopStatistics, Recorder
from clfcbf.runtime.watch import TickTimes, Watch
from clfcbf.scene import Observation
from clfcbf.se2 import Twist

__all__ = ["ControlLoop", "LoopController", "Tick"]

_REST = Twist(0.0, 0.0)

TOLERANCE = 1e-9
"""[m/s, rad/s] By which a command may leave its input box: the rounding of the contract."""


class LoopController(Protocol):
    """What the loop ticks: a docking controller, a filter, or anything with ``step``."""

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The command of this tick, inside the input box around ``applied``."""


class Tick(NamedTuple):
    """One tick, as ``on_tick`` is told it.

    Attributes
    ----------
    number : from 0
    due, begun, sent : when it should have begun, when it did, when its command was sent [s]
    observation : the measurement that was passed on
    applied : the command in force before
    decision : of the controller
    command : what was sent; not the decision's where that came too late
    missed : whether the deadline was
    in_force : the command in force when this one was sent, where the base has changed it since
        ``applied`` was asked; the command is then the brake's. None where it has not
    """

    number: int
    due: float
    begun: float
    sent: float
    observation: Observation | None
    applied: Twist
    decision: Decision
    command: Twist
    missed: bool
    in_force: Twist | None = None


class ControlLoop:
    """Ticks a controller at a fixed rate between a sensor and a chassis, until it stands.

    Parameters
    ----------
    controller : decides, see :class:`LoopController`; its period has to be this one
    chassis, sensor : see :mod:`clfcbf.hardware.protocols`
    clock : that the sensor's stamps are on; the machine's monotonic one if None
    period : of the ticks [s]
    limits : of the chassis, for the brake at the end and the check of every command
    policy : what is done about late ticks and old measurements
    on_tick : called after each command, such as to record it; it takes its time from the tick

    Raises
    ------
    ConfigurationError : the period is not finite and positive, or a part lacks a method
    """

    def __init__(
        self,
        controller: LoopController,
        chassis: Chassis,
        sensor: TargetSensor,
        clock: Clock | None = None,
        *,
        period: float,
        limits: Limits,
        policy: LoopPolicy | None = None,
        on_tick: Callable[[Tick], None] | None = None,
    ) -> None:
        self._clock: Clock = clock if clock is not None else MonotonicClock()
        for name, part, kind in (
            ("chassis", chassis, Chassis), ("sensor", sensor, TargetSensor),
            ("clock", self._clock, Clock),
        ):  # fmt: skip
            if not isinstance(part, kind):
                raise ConfigurationError(f"{name} lacks a method of {kind.__name__}: {part!r}")
        self._controller = controller
        self._chassis = chassis
        self._sensor = sensor
        self._period = check_period(period)
        self._limits = limits
        self._policy = policy or LoopPolicy()
        self._on_tick = on_tick
        self._signal = 0
        self._asked = False
        self.report: LoopReport | None = None
        """Of the last run, also where that raised an exception."""
        self._begin()

    def _begin(self) -> None:
        self._record = Recorder(self._policy.window)
        self._braking = Braking(self._limits, self._period)
        self._decision: Decision | None = None
        self._sent_at = -math.inf
        self._latest = -math.inf
        self._watch = Watch(self._period, self._policy.max_age)

    @property
    def statistics(self) -> LoopStatistics:
        """Of the run in progress, or of the last."""
        return self._record.statistics()

    def stop(self) -> None:
        """Ask the run to end, from any thread: it brakes from its next command on."""
        self._asked = True

    def run(self, duration: float = math.inf) -> LoopReport:
        """Tick until the controller is done or gives up, a signal comes, or time is over.

        SIGINT and SIGTERM are caught meanwhile where this is the main thread.

        Parameters
        ----------
        duration : longest time to run [s], before the brake

        Raises
        ------
        Exception : whatever a part of the loop raised, after the brake; ``report`` is set
        ConfigurationError : the duration is negative or NaN
        """
        if not duration >= 0.0:
            raise ConfigurationError(f"duration must be at least 0 s, got {duration!r}")
        self._begin()
        watch = self._watch
        error: BaseException | None = None
        with caught(self._signalled):
            try:
                ending = self._ticks(duration)
            except BaseException as failure:  # the robot may be moving, whatever it is
                ending, error = Ending.ERROR, failure
                watch.raised(watch.at, failure)
            blamed = ending is Ending.OVERRUN or isinstance(error, Exception)
            part = watch.at if blamed else None
            rest = come_to_rest(
                self._braking, self._chassis, self._clock, self._period, self._sent_at
            )
        for failed in (rest.brake_error, rest.stop_error):
            if failed is not None and failed is not error:
                watch.raised(Part.CHASSIS, failed)
        self.report = LoopReport(
            ending, self._decision, self.statistics, rest.braked, self._signal,
            error, rest.brake_error, rest.stop_error, part, watch.failures(),
        )  # fmt: skip
        self._signal, self._asked = 0, False
        for raised in (error, rest.stop_error, rest.brake_error):
            if raised is not None:
                raise raised
        return self.report

    def _signalled(self, number: int) -> None:
        self._signal = number

    def _ending(self) -> Ending | None:
        """Whether somebody has asked for an end."""
        if self._signal:
            return Ending.SIGNAL
        return Ending.STOPPED if self._asked else None

    def _ticks(self, duration: float) -> Ending:
        clock, period, policy, record = self._clock, self._period, self._policy, self._record
        watch = self._watch
        due = watch.heard = clock.now()
        end = due + duration
        misses = 0
        while True:
            watch.at = Part.CLOCK
            begun = watch.now = clock.now()
            if (asked := self._ending()) is not None:
                return asked
            if begun >= end:
                return Ending.TIMEOUT
            watch.at = Part.SENSOR
            observation = self._fresh(self._sensor.observe(), begun)
            observed = clock.now()
            watch.at = Part.CHASSIS
            applied = self._chassis.applied()
            asked_at = clock.now()
            watch.at = Part.CONTROLLER
            since = time.perf_counter()
            decision = self._controller.step(observation, applied, begun)
            solve = time.perf_counter() - since
            self._decision = decision
            decided = clock.now()
            times = TickTimes(due, begun, observed, asked_at, decided)
            missed = decided > due + period
            misses = misses + 1 if missed else 0
            record.missed += missed
            record.skipped += max(0, math.floor((decided - due) / period))
            if (asked := self._ending()) is not None:
                return asked
            watch.decided(decision, applied, self._braking, times)
            if misses >= (1 if policy.overrun is Overrun.STOP else policy.misses):
                watch.at = watch.culprit(times)[0]
                return Ending.OVERRUN
            outdated = decided > begun + period  # one that only began late is as good as any
            watch.at = Part.CHASSIS
            in_force = self._changed(applied)
            watch.at = Part.CONTROLLER
            command = self._checked(decision, applied, in_force, outdated)
            watch.at = Part.CHASSIS
            self._chassis.send(command)
            watch.at = Part.CLOCK
            before, self._sent_at = self._sent_at, clock.now()
            self._braking.accepted(command)
            latency = self._sent_at - observation.stamp if observation is not None else math.nan
            record.add(self._sent_at - before, begun - due, latency, solve)
            if self._on_tick is not None:
                watch.at = Part.OBSERVER
                self._on_tick(Tick(
                    record.ticks - 1, due, begun, self._sent_at, observation, applied, decision,
                    command, missed, in_force,
                ))  # fmt: skip
                watch.at = Part.CLOCK
            if decision.done:
                return Ending.DONE
            if decision.phase is Phase.FAILED and command == _REST:
                return Ending.FAILED
            due = (self._sent_at if missed else due) + period
            watch.ended(due, decided, self._sent_at, clock.now())
            clock.sleep_until(due)

    def _fresh(self, observation: Observation | None, now: float) -> Observation | None:
        """A measurement if it is newer than all before and not too old.

        One without a sound stamp is passed on: it is for the controller to say so.
        """
        if observation is None:
            return None
        if observation.stamp <= self._latest:
            self._record.repeated += 1
            return None
        if observation.stamp <= now:
            self._latest = observation.stamp
        if now - observation.stamp > self._policy.max_age:
            self._record.stale += 1
            return None
        self._record.fresh += 1
        self._watch.heard = now
        return observation

    def _changed(self, applied: Twist) -> Twist | None:
        """The command in force now, where that is no longer what the controller was told.

        A base whose time-out ran off during a late tick has stopped by itself.
        """
        known = self._braking.known
        in_force = known(self._chassis.applied())
        return None if in_force == known(applied) else in_force

    def _checked(
        self, decision: Decision, applied: Twist, changed: Twist | None, outdated: bool
    ) -> Twist:
        """The command to send: the decision's, or the brake's where that is outdated."""
        if changed is not None:
            return self._braking.command(changed)
        in_force = self._braking.known(applied)
        if outdated and self._policy.overrun is Overrun.BRAKE:
            return self._braking.command(in_force)
        box = self._limits.input_box(in_force, self._period)
        if not box.contains(decision.twist, TOLERANCE):  # which a NaN is not in either
            raise LimitsError(
                f"the controller's command {decision.twist!r} is outside of {box!r}, what one tick "
                f"can reach from {applied!r}"
            )
        return decision.twist
