"""One part dies in mid-approach: does the robot stop, is the part named, does it go on after?"""

from __future__ import annotations

import math
import multiprocessing
import os
import secrets
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.robot.casualties import Cable, MortalBackend, MortalSensor
from benchmarks.robot.docks import LONGEST, SETTLE
from benchmarks.robot.pilot import pilot
from benchmarks.robot.rig import (
    DOCKS,
    LEFT,
    RIGHT,
    SILENCE,
    WHEELS,
    Rig,
    Setting,
    make_rig,
)
from clfcbf import defaults
from clfcbf.hardware.clocks import MonotonicClock
from clfcbf.hardware.partner_sensor import PartnerSensor
from clfcbf.hardware.pose_link import PoseReceiver, PoseSender
from clfcbf.runtime import ControlLoop, LoopReport, Part, PartFailure, PlantInTheLoop, Tick
from clfcbf.se2 import Pose2
from clfcbf.session import DockingSession, PhaseControllers, SessionResult
from clfcbf.simulation.judge import is_docked
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensors import make_sensor

__all__ = ["HEADING", "PARTS", "kill", "row"]

SHARES = (0.1, 0.85)
"""Of the way, between which the part dies."""

BRAKE = 2.0
"""[s] From the end of the detection to rest: 0.75 s of braking, lag and servos, and slack for a
machine that is shared."""

AWAY = (3.0, 20.0)
"""[s] For which a part stays dead: the longest is beyond what a controller waits."""

STEP = 2e-3
"""[s] Between two looks at a bus that somebody else's process is on."""

PARTNER = 7
POSE_NOISE = 0.002
"""[m, rad] One sigma of each pose that goes through the link."""


class Case:
    """A run with one part that dies, and what is asked afterwards.

    Attributes
    ----------
    variant : how the part dies
    detection : longest time until somebody notices [s]; infinite where nothing has to stop
    named : whether a failure names the part
    """

    def __init__(self, setting: Setting, part: str) -> None:
        self.setting, self.part = setting, part
        self.rng = setting.stream(3)
        self.share = float(self.rng.uniform(*SHARES))
        self.away = float(self.rng.uniform(*AWAY))
        self.variant = str(self.rng.choice(PARTS[part]))
        self.killed_at = math.nan

    def way(self) -> float:
        """Distance from the goal at which it dies [m]."""
        start = self.setting.start()
        return (1.0 - self.share) * math.hypot(start.x, start.y)


class Course:
    """The loop and the session of a run, and the moment of the kill."""

    def __init__(self, case: Case, rig: Rig, sensor: Any, backend: Any = "exact") -> None:
        setting = case.setting
        self.case, self.rig = case, rig
        self.session = DockingSession(
            PhaseControllers(lambda dock: setting.controller(backend)), DOCKS, setting.bounds,
            setting.period,
        )  # fmt: skip
        self.loop = ControlLoop(
            self.session, rig.chassis, sensor, rig.clock, period=setting.period,
            limits=setting.bounds, on_tick=self._on_tick,
        )  # fmt: skip
        self.strike: Callable[[], None] = lambda: None
        self.mend: Callable[[], None] = lambda: None
        self.mended = False
        self.outside = 0
        self.reports: list[LoopReport] = []
        self._way = case.way()

    def run(self) -> SessionResult | None:
        """Until the session has ended; the loop is started again after each part's death."""
        self.session.dock("a")
        while self.session.result is None and len(self.reports) < 5:
            raised = False
            try:
                self.reports.append(self.loop.run(LONGEST))
            except Exception:
                raised = True
                assert self.loop.report is not None
                self.reports.append(self.loop.report)
            if not math.isnan(self.case.killed_at) and not self.mended:
                self._wait_for_repair()
            elif raised:  # by something else, such as a machine that starved the drives' side
                self.mend()
        self.wait(SETTLE)
        return self.session.result

    def wait(self, duration: float) -> None:
        """Let the robot's time pass, in steps in which its drives can take part."""
        robot = self.rig.robot
        until = robot.now() + duration
        while robot.now() < until:
            robot.sleep_until(min(robot.now() + 5.0 * STEP, until))

    @property
    def failures(self) -> list[PartFailure]:
        """Of all runs of the loop."""
        return [failure for report in self.reports for failure in report.failures]

    def _wait_for_repair(self) -> None:
        self.wait(max(0.0, self.case.killed_at + self.case.away - self.rig.robot.now()))
        self._repair()

    def _repair(self) -> None:
        self.mend()
        self.mended = True

    def _on_tick(self, tick: Tick) -> None:
        case, witness = self.case, self.rig.witness
        limits, period = case.setting.bounds, case.setting.period
        before = tick.applied if tick.in_force is None else tick.in_force
        self.outside += not limits.input_box(before, period).contains(tick.command, 1e-9)
        if math.isnan(case.killed_at):
            pose = witness.pose()
            if math.hypot(pose.x, pose.y) <= self._way:
                case.killed_at = self.rig.robot.now()
                witness.mark()
                self.strike()
        elif not self.mended and self.rig.robot.now() >= case.killed_at + case.away:
            self._repair()


class Outcome:
    """What a case came to."""

    def __init__(
        self, case: Case, rig: Rig, result: SessionResult | None, named: str, detection: float,
        failures: list[str], outside: int, stood: float,
    ) -> None:  # fmt: skip
        self.case, self.rig, self.result = case, rig, result
        self.named, self.detection, self.failures = named, detection, failures
        self.outside, self.stood = outside, stood

    def record(self) -> dict[str, Any]:
        case, witness = self.case, self.rig.witness
        end = witness.pose()
        stopped_after = self.stood - case.killed_at
        goes_on = math.isinf(self.detection)
        stopped = goes_on or stopped_after <= self.detection + BRAKE
        recovered = self.result is not None and self.result.success and is_docked(end)
        checks = {
            "stopped": stopped,
            "in_view": witness.margin >= 0.0,
            "within_limits": witness.within_limits and self.outside == 0,
            "no_contact": not witness.contact(),
            "named": bool(self.named),
            "recovered": recovered,
        }
        return {
            "index": case.setting.index, "part": case.part, "variant": case.variant,
            "killed_at_s": case.killed_at, "away_s": case.away, "share": case.share,
            "ok": all(checks.values()), **checks,
            "stopped_after_s": None if math.isnan(stopped_after) or goes_on else stopped_after,
            "detection_s": None if goes_on else self.detection,
            "min_fov_margin_deg": math.degrees(witness.margin),
            "excess_v": witness.excess_v, "excess_omega": witness.excess_omega,
            "outside_box": self.outside, "told": self.named, "failures": self.failures,
            "e_mm": 1e3 * math.hypot(end.x, end.y),
            "retries": -1 if self.result is None else self.result.num_retries,
            "result": "" if self.result is None else self.result.error_msg,
        }  # fmt: skip


def _named(failures: list[PartFailure], part: Part, *words: str) -> str:
    """The failure that names the part in these words; empty if there is none."""
    for failure in failures:
        if failure.part is part and all(word in str(failure) for word in words):
            return str(failure)
    return ""


def _outcome(
    case: Case, rig: Rig, course: Course, result: Any, named: str, detection: float
) -> dict[str, Any]:
    told = [str(failure) for failure in course.failures]
    searches = case.variant in ("silent", "frozen")  # it turns to look as soon as it stands
    stood = rig.witness.halted if searches else rig.witness.stopped
    return Outcome(case, rig, result, named, detection, told, course.outside, stood).record()


def _sensor(case: Case) -> dict[str, Any]:
    rig = make_rig("direct", case.setting)
    sensor = MortalSensor(rig.sensor)
    course = Course(case, rig, sensor)
    course.strike = lambda: setattr(sensor, "fate", case.variant)
    course.mend = lambda: setattr(sensor, "fate", "")
    try:
        result = course.run()
        if case.variant == "raises":
            named = _named(course.failures, Part.SENSOR, "raised", "/dev/video0")
            return _outcome(case, rig, course, result, named, 2.0 * case.setting.period)
        named = _named(course.failures, Part.SENSOR, "silent")
        blind = rig.witness.halted - case.killed_at < defaults.PATIENCE
        if not named and blind and len(course.reports) == 1 and result and result.success:
            named = "docked before it was missed"
        return _outcome(case, rig, course, result, named, defaults.PATIENCE + case.setting.period)
    finally:
        rig.close()


def _solver(case: Case) -> dict[str, Any]:
    """Raising or answering nonsense it does not stop the robot; hanging it does, for a while."""
    hangs = case.variant == "hangs"
    case.setting = Setting(case.setting.seed, case.setting.index, hangs, SILENCE)
    rig = make_rig("can" if hangs else "direct", case.setting)
    duration = float(case.rng.uniform(0.05, 0.4))
    backend = MortalBackend(lambda: time.sleep(duration))
    course = Course(case, rig, rig.sensor, backend)
    course.strike = lambda: setattr(backend, "fate", case.variant)
    course.mend = lambda: setattr(backend, "fate", "")
    case.away = min(case.away, 6.0)
    try:
        result = course.run()
        if hangs:
            case.variant = f"hangs for {duration:.2f} s"
            named = _named(course.failures, Part.CONTROLLER, "late", "the solver 'mortal'")
            # Brake commands come as late as decisions, until as many were missed as are allowed.
            late = 16.0 * (duration + case.setting.period)
            return _outcome(case, rig, course, result, named, late)
        named = _named(course.failures, Part.SOLVER, "'mortal'")
        return _outcome(case, rig, course, result, named, math.inf)
    finally:
        rig.close()


def _bus(case: Case) -> dict[str, Any]:
    case.setting = Setting(case.setting.seed, case.setting.index, True, SILENCE)
    case.away = float(case.rng.uniform(2.5, 4.0))
    rig = make_rig("can", case.setting)
    cable = Cable(rig.parts["bus"])
    chassis = rig.chassis
    course = Course(case, rig, rig.sensor)

    def strike() -> None:
        cable.fate = case.variant

    def mend() -> None:
        cable.fate = ""
        chassis.release()  # type: ignore[attr-defined]

    course.strike, course.mend = strike, mend
    try:
        result = course.run()
        words = {"cut": "drive (node", "off": "bus"}[case.variant]
        named = _named(course.failures, Part.CHASSIS, "raised", words)
        return _outcome(case, rig, course, result, named, SILENCE + 0.1)
    finally:
        cable.fate = ""
        rig.close()


def _peer(case: Case) -> dict[str, Any]:
    """The target says where it is, through the link; then its sender dies."""
    rig = make_rig("direct", case.setting)
    robot, world = rig.robot, World()
    key = secrets.token_bytes(32)
    rng, period = case.rng, case.setting.period
    alive = True
    last = -math.inf

    def noisy(pose: Pose2) -> Pose2:
        return Pose2(*(value + POSE_NOISE * float(rng.standard_normal()) for value in pose))

    with PoseReceiver(key, PARTNER, clock=robot.now) as receiver:
        port = receiver.address[1]
        senders = [PoseSender(key, PARTNER, port, clock=robot.now)]
        link = PartnerSensor(
            receiver, lambda stamp: noisy(rig.witness.pose()), robot, world.standoff,
            covariance=tuple(  # type: ignore[arg-type]
                tuple(2.0 * POSE_NOISE**2 * (i == k) * (1.0 if i else 1.4) for k in range(3))
                for i in range(3)
            ),
        )  # fmt: skip

        class Peer:
            """Sends at 30 Hz as long as it lives; the loop asks at every tick."""

            def observe(self) -> Any:
                nonlocal last
                now = robot.now()
                robot.observe()
                if alive and now - last >= 0.9 * period:
                    senders[-1].send(noisy(world.feature))
                    last = now
                return link.observe()

        course = Course(case, rig, Peer())

        def strike() -> None:
            nonlocal alive
            alive = False
            senders[-1].close()

        def mend() -> None:
            nonlocal alive
            alive = True
            if case.variant == "restarts":
                senders.append(PoseSender(key, PARTNER, port, clock=robot.now))
            else:  # another key at first, and then the right one
                with PoseSender(secrets.token_bytes(32), PARTNER, port, clock=robot.now) as forger:
                    forger.send(Pose2(9.0, 9.0, 0.0))
                senders.append(PoseSender(key, PARTNER, port, clock=robot.now))

        course.strike, course.mend = strike, mend
        try:
            result = course.run()
            named = _named(course.failures, Part.SENSOR, "raised", f"partner {PARTNER}")
            return _outcome(case, rig, course, result, named, 0.5 + 2.0 * period)
        finally:
            senders[-1].close()
            rig.close()


def _process(case: Case) -> dict[str, Any]:
    """Body and drives here, the control in a process of its own, which is killed."""
    from benchmarks.robot.wire import open_wire
    from clfcbf.hardware.cia402 import emergency_of
    from clfcbf.simulation.can_drives import CanPlant, SimulatedDrives

    case.setting = setting = Setting(case.setting.seed, case.setting.index, True, SILENCE)
    case.away = float(case.rng.uniform(2.5, 4.0))
    witness = setting.body()
    wire, port = open_wire()
    emergencies: list[str] = []
    send = wire.send

    def sending(message: Any, timeout: float | None = None) -> None:
        if message.arbitration_id in (0x80 + LEFT.node, 0x80 + RIGHT.node):
            emergencies.append(str(emergency_of(bytes(message.data))))
        send(message, timeout)

    wire.send = sending
    drives = SimulatedDrives(wire, LEFT.node, RIGHT.node, now=lambda: witness.time)
    plant = CanPlant(witness, drives, LEFT, RIGHT, WHEELS)
    sensor = make_sensor(setting.sensor, plant, World(), setting.stream(2))
    robot = PlantInTheLoop(plant, sensor, MonotonicClock())
    rig = Rig(witness, robot, robot, robot, robot, {}, robot.close)
    context = multiprocessing.get_context("spawn")

    def begin() -> tuple[Any, Any]:
        here, there = context.Pipe()
        process = context.Process(target=pilot, args=(port, there, setting, LONGEST), daemon=True)
        process.start()
        there.close()
        return process, here

    def pump(pipe: Any, until: Callable[[], bool]) -> Any:
        """Let time pass and hand measurements over; what the pilot says, None if nothing."""
        zero = time.monotonic() - robot.now()
        end = robot.now() + LONGEST
        while robot.now() < end and not until():
            robot.sleep_until(robot.now() + STEP)
            found = robot.observe()
            if pipe is None:
                continue
            try:
                if found is not None:
                    pipe.send(replace(found, stamp=found.stamp + zero))
                if pipe.poll():
                    return pipe.recv()
            except (OSError, EOFError):
                return None
        return None

    way = case.way()
    process, pipe = begin()
    said: Any = None
    try:
        near = lambda: math.hypot(witness.pose().x, witness.pose().y) <= way  # noqa: E731
        pump(pipe, near)
        emergencies.clear()
        case.killed_at = robot.now()
        witness.mark()
        if case.variant == "SIGKILL":
            os.kill(process.pid, signal.SIGKILL)
            process.join()
        else:  # it hangs, and is killed later
            os.kill(process.pid, signal.SIGSTOP)
        pump(None, lambda: robot.now() >= case.killed_at + case.away)
        stood = witness.stopped
        process.kill()
        process.join()
        pipe.close()
        lost = [text for text in emergencies if text.startswith(("0x8130", "0x8250"))]
        named = f"drives: {lost[0]}; process ended with {process.exitcode}" if lost else ""
        process, pipe = begin()
        said = pump(pipe, lambda: not process.is_alive())
        settled = robot.now() + SETTLE
        pump(None, lambda: robot.now() >= settled)
    finally:
        process.kill()
        process.join()
        pipe.close()
        rig.close()
    success = bool(said and said[0])
    result = SessionResult(success, 0, 0, said[1] if said else "no answer")  # type: ignore[arg-type]
    return Outcome(case, rig, result, named, SILENCE + 0.1, emergencies[:4], 0, stood).record()


PARTS: dict[str, tuple[str, ...]] = {
    "sensor": ("raises", "silent", "frozen"),
    "solver": ("raises", "nan", "hangs"),
    "bus": ("cut", "off"),
    "peer": ("restarts", "forged first"),
    "process": ("SIGKILL", "SIGSTOP"),
}
"""What dies, and how."""

_KILLS: dict[str, Callable[[Case], dict[str, Any]]] = {
    "sensor": _sensor, "solver": _solver, "bus": _bus, "peer": _peer, "process": _process,
}  # fmt: skip


def kill(setting: Setting, part: str = "") -> dict[str, Any]:
    """One run with one casualty; parts take turns by the run's index unless one is named."""
    part = part or list(PARTS)[setting.index % len(PARTS)]
    return _KILLS[part](Case(setting, part))


HEADING = (
    "part", "how", "runs", "stopped", "in view", "in limits", "named", "recovered",
    "rest after [s]", "least margin [deg]",
)  # fmt: skip


def row(part: str, records: list[dict[str, Any]]) -> tuple[str, ...]:
    """One part in the table."""
    n = len(records)
    after = [r["stopped_after_s"] for r in records if r["stopped_after_s"] is not None]
    counts = (
        f"{sum(r[name] for r in records)}/{n}"
        for name in ("stopped", "in_view", "within_limits", "named", "recovered")
    )
    how = ", ".join(sorted({r["variant"].split(" for ")[0] for r in records}))
    rest = f"{np.median(after):.2f}, worst {max(after):.2f}" if after else "goes on"
    margin = min(r["min_fov_margin_deg"] for r in records)
    return (part, how, str(n), *counts, rest, f"{margin:.2f}")
