"""A rate held in real time beside a busy process, with every command checked."""

from __future__ import annotations

import gc
import math
import multiprocessing
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.robot.docks import LONGEST, SETTLE
from benchmarks.robot.rig import DOCKS, Setting, make_rig
from clfcbf.errors import ClfcbfError
from clfcbf.runtime import ControlLoop, Tick
from clfcbf.se2 import Twist, is_finite
from clfcbf.session import DockingSession, PhaseControllers

__all__ = ["QUANTILES", "busy_core", "drive"]

REST = Twist(0.0, 0.0)

TRIPS = 20
"""Times that the drives' fault is reset before the campaign is given up."""

QUANTILES = (50.0, 90.0, 99.0, 99.9)
"""Of lateness and of the gap between two commands, beside the worst [%]."""


def _spin(core: int) -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    while True:
        pass


@contextmanager
def busy_core() -> Iterator[int]:
    """A process that computes without a pause, on the last core meanwhile."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    process = multiprocessing.get_context("spawn").Process(
        target=_spin, args=(cores[-1],), daemon=True
    )
    process.start()
    try:
        yield cores[-1]
    finally:
        process.kill()
        process.join()


class _Check:
    """What each tick was: how late, how far from the one before, inside its box or not."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._sent = math.nan
        self.lateness: list[float] = []
        self.gaps: list[float] = []
        self.steps: list[float] = []
        self.missed = self.missed_moving = self.outside = self.uncertified = 0

    def on_tick(self, tick: Tick) -> None:
        setting = self._setting
        before = tick.applied if tick.in_force is None else tick.in_force
        box = setting.bounds.input_box(before, setting.period)
        self.outside += not (is_finite(tuple(tick.command)) and box.contains(tick.command, 1e-9))
        self.uncertified += not tick.decision.certified
        self.missed += tick.missed
        self.missed_moving += tick.missed and before != REST
        self.lateness.append(tick.begun - tick.due)
        self.steps.append(tick.sent - tick.begun)
        if tick.number:
            self.gaps.append(tick.sent - self._sent)
        self._sent = tick.sent


def drive(setting: Setting, via: str, seconds: float, loaded: bool = True) -> dict[str, Any]:
    """Dock and undock over and over for so long; what became of the deadlines.

    Parameters
    ----------
    setting : its index counts the robots, one after another
    via : the robot
    seconds : of real time
    loaded : whether another core is kept busy
    """
    check = _Check(setting)
    tasks = failed = trips = 0
    told: list[str] = []
    begun, index = 0.0, setting.index
    with busy_core() if loaded else _nothing():
        rig = make_rig(via, setting)
        try:
            session = DockingSession(
                PhaseControllers(lambda dock: setting.controller()), DOCKS, setting.bounds,
                setting.period,
            )  # fmt: skip
            loop = ControlLoop(
                session, rig.chassis, rig.sensor, rig.clock, period=setting.period,
                limits=setting.bounds, on_tick=check.on_tick,
            )  # fmt: skip
            gc.collect()
            gc.freeze()
            begun = rig.clock.now()
            end = begun + seconds
            while rig.clock.now() < end:
                if not session.active:
                    session.undock() if tasks % 2 else session.dock("a")
                try:
                    report = loop.run(min(LONGEST, end - rig.clock.now()))
                except ClfcbfError as error:  # a chassis whose drives have stopped by themselves
                    trips += 1
                    told.append(f"{type(error).__name__}: {error}")
                    release = getattr(rig.chassis, "release", None)
                    if release is None or trips > TRIPS:
                        break
                    release()
                    continue
                told += [str(failure) for failure in report.failures]
                if session.result is None:  # the time is over
                    break
                tasks += 1
                failed += not session.result.success
                if not session.result.success:
                    told.append(session.result.error_msg)
                    break
                rig.robot.sleep_until(rig.robot.now() + SETTLE)
            lasted = rig.clock.now() - begun
        finally:
            gc.unfreeze()
            rig.close()
    ticks = len(check.lateness)
    return {
        "index": index, "seconds": lasted, "rate": setting.rate, "ticks": ticks,
        "missed": check.missed, "missed_moving": check.missed_moving,
        "missed_share": check.missed / max(ticks, 1),
        "outside_contract": check.outside, "uncertified": check.uncertified,
        "tasks": tasks, "tasks_failed": failed,
        "trips": trips,
        "lateness_ms": _quantiles(check.lateness), "gap_ms": _quantiles(check.gaps),
        "tick_ms": _quantiles(check.steps),
        "within_limits": rig.witness.within_limits,
        "min_fov_margin_deg": math.degrees(rig.witness.margin),
        "failures": told[:50],
    }  # fmt: skip


@contextmanager
def _nothing() -> Iterator[int]:
    yield -1


def _quantiles(seconds: list[float]) -> dict[str, float]:
    if not seconds:
        return {}
    values = 1e3 * np.array(seconds)
    found = {f"p{q:g}": float(np.percentile(values, q)) for q in QUANTILES}
    return {**found, "worst": float(values.max())}
