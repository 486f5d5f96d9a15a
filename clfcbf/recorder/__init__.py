"""The flight recorder: every tick in an MCAP file, to be explained, plotted and replayed.

>>> from clfcbf.recorder import FlightRecorder, read_log, replay  # doctest: +SKIP
>>> with FlightRecorder("run.mcap", controller.config) as recorder:  # doctest: +SKIP
...     ControlLoop(controller, ..., on_tick=recorder.on_tick).run()
>>> print(replay(read_log("run.mcap")))  # doctest: +SKIP
812 ticks replayed: every command to the last bit
"""

from clfcbf.errors import LogError
from clfcbf.recorder.blueprint import (
    Configuration,
    configuration_from_json,
    configuration_to_json,
)
from clfcbf.recorder.entries import (
    InTheLoop,
    LogEnd,
    LoggedTask,
    LoggedTick,
    SessionInputs,
    Unrecorded,
)
from clfcbf.recorder.flight import FlightRecorder
from clfcbf.recorder.log import FlightLog, is_log, read_log
from clfcbf.recorder.replay import Difference, ReplayReport, replay
from clfcbf.recorder.session import SessionRecorder

__all__ = [
    "Configuration",
    "Difference",
    "FlightLog",
    "FlightRecorder",
    "InTheLoop",
    "LogEnd",
    "LogError",
    "LoggedTask",
    "LoggedTick",
    "ReplayReport",
    "SessionInputs",
    "SessionRecorder",
    "Unrecorded",
    "configuration_from_json",
    "configuration_to_json",
    "is_log",
    "read_log",
    "replay",
]
