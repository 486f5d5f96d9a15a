"""Docked, undocked, recorded, and every command of it computed again from the recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from benchmarks.robot.rig import DOCKS, Setting, make_rig
from clfcbf.recorder import FlightRecorder, SessionRecorder, read_log, replay
from clfcbf.runtime import ControlLoop
from clfcbf.se2 import wrap_angle
from clfcbf.session import DockingSession, PhaseControllers
from clfcbf.simulation.judge import is_docked

__all__ = ["HEADING", "fly", "row"]

LONGEST = 120.0
"""[s] For docking, with the back-offs that a start may need."""

SETTLE = 0.5
"""[s] After standstill, until the result is judged."""


def fly(setting: Setting, via: str, log: Path) -> dict[str, Any]:
    """One run: dock, undock, replay; its record.

    Parameters
    ----------
    setting, via : the robot
    log : of the flight, overwritten
    """
    log.unlink(missing_ok=True)
    rig = make_rig(via, setting)
    try:
        with FlightRecorder(log, setting.controller().config, synchronous=False) as recorder:
            watch = SessionRecorder(recorder)
            approach = PhaseControllers(lambda dock: watch.controller(setting.controller()))
            session = DockingSession(approach, DOCKS, setting.bounds, setting.period)
            loop = ControlLoop(
                session, rig.chassis, rig.sensor, rig.clock, period=setting.period,
                limits=setting.bounds, on_tick=watch.on_tick,
            )  # fmt: skip
            session.dock("a")
            docking = loop.run(LONGEST)
            docked = session.result
            rig.robot.sleep_until(rig.robot.now() + SETTLE)
            end = rig.witness.pose()
            begun = rig.robot.now()
            undocked, out = None, end
            if docked is not None and docked.success:
                session.undock()
                loop.run(LONGEST)
                undocked = session.result
                rig.robot.sleep_until(rig.robot.now() + SETTLE)
                out = rig.witness.pose()
            ended = rig.robot.now()
    finally:
        rig.close()
    found = replay(read_log(log))
    way = math.hypot(out.x - end.x, out.y - end.y)
    return {
        "index": setting.index,
        "start": list(setting.start()),
        "docked": docked is not None and docked.success and is_docked(end),
        "strict": docked is not None and docked.success and is_docked(end, strict=True),
        "undocked": undocked is not None and undocked.success,
        "replayed": found.reproduced and found.ticks > 0 and recorder.dropped == 0,
        "within_limits": rig.witness.within_limits,
        "contact": rig.witness.contact(),
        "e_lon_mm": 1e3 * end.x,
        "e_lat_mm": 1e3 * end.y,
        "e_theta_deg": math.degrees(wrap_angle(end.theta)),
        "dock_s": begun - SETTLE,
        "undock_s": ended - SETTLE - begun,
        "way_out_m": way,
        "min_fov_margin_deg": math.degrees(rig.witness.margin),
        "retries": 0 if docked is None else docked.num_retries,
        "ticks": found.ticks,
        "commands_differing": found.commands,
        "missed": docking.statistics.missed,
        "failures": [str(failure) for failure in docking.failures],
        "told": "" if docked is None else docked.error_msg,
        "replay": str(found),
    }


HEADING = (
    "run", "docked", "undocked", "replayed", "ticks", "differ", "e_lon [mm]", "e_lat [mm]",
    "e_theta [deg]", "dock [s]", "undock [s]", "margin [deg]",
)  # fmt: skip


def row(record: dict[str, Any]) -> tuple[str, ...]:
    """A run in the table."""
    yes = {True: "yes", False: "NO"}
    return (
        str(record["index"]), yes[record["docked"]], yes[record["undocked"]],
        yes[record["replayed"]], str(record["ticks"]), str(record["commands_differing"]),
        f"{record['e_lon_mm']:+.1f}", f"{record['e_lat_mm']:+.1f}",
        f"{record['e_theta_deg']:+.2f}", f"{record['dock_s']:.1f}", f"{record['undock_s']:.1f}",
        f"{record['min_fov_margin_deg']:.2f}",
    )  # fmt: skip
