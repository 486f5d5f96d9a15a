"""From a controller's decisions to a robot: the loop that ticks it, and how a run ends."""

from clfcbf.runtime.command_filter import CommandFilter
from clfcbf.runtime.loop import ControlLoop, LoopController, Tick
from clfcbf.runtime.parts import Part, PartFailure
from clfcbf.runtime.policy import Ending, LoopPolicy, LoopReport, Overrun
from clfcbf.runtime.simulated import PlantInTheLoop
from clfcbf.runtime.statistics import LoopStatistics, Percentiles

__all__ = [
    "CommandFilter",
    "ControlLoop",
    "Ending",
    "LoopController",
    "LoopPolicy",
    "LoopReport",
    "LoopStatistics",
    "Overrun",
    "Part",
    "PartFailure",
    "Percentiles",
    "PlantInTheLoop",
    "Tick",
]
