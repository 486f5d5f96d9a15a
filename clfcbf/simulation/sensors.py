"""The simulated sensors by name: what kind of camera, and how well it measures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clfcbf.errors import ConfigurationError
from clfcbf.simulation.depth import DepthModel
from clfcbf.simulation.depth_sensor import DepthSensor
from clfcbf.simulation.marker_sensor import MarkerSensor
from clfcbf.simulation.plant import Plant
from clfcbf.simulation.regions import Markers
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensor import PoseSensor
from clfcbf.simulation.sensor_model import SensorModel

__all__ = ["SENSORS", "SensorName", "make_sensor"]

_LEVELS = ("ideal", "A", "B", "C")
_KINDS = ("", "depth", "middle")

SENSORS: tuple[str, ...] = tuple(
    [f"{kind}-{level}" if kind else level for kind in _KINDS for level in _LEVELS]
)
"""Every sensor: a level alone measures the board's pose, with white noise put in; ``depth-`` fits
the board to columns of depth; ``middle-`` does too, but without the compensation of a board that
the view cuts."""


class SensorName(NamedTuple):
    """A sensor's name in parts: ``kind``, empty for a pose sensor, and ``level`` of its errors."""

    kind: str
    level: str

    @classmethod
    def of(cls, name: str) -> SensorName:
        """The parts of a name; ``ConfigurationError`` lists the valid ones."""
        if name not in SENSORS:
            raise ConfigurationError(
                f"unknown sensor level {name!r}; choose ideal, A, B or C, or one of these after "
                "depth- (a depth camera) or middle- (that without view compensation)"
            )
        kind, _, level = name.rpartition("-")
        return cls(kind, level)


def make_sensor(
    name: str, plant: Plant, world: World, rng: np.random.Generator, markers: Markers | None = None
) -> PoseSensor:
    """The sensor of that name on a plant.

    Parameters
    ----------
    name : one of :data:`SENSORS`
    plant, world : what it looks at, and where the camera is
    rng : draws the run's and the frames' errors
    markers : what is measured in place of the board, whatever the kind; the level still says
        when frames come and what errs beside their noise

    Raises
    ------
    ConfigurationError : the name is unknown
    """
    kind, level = SensorName.of(name)
    camera, standoff = world.camera, world.standoff
    if markers is not None:
        model = SensorModel.named(level)
        seen = Markers(markers.distance, 0.0, markers.rate) if level == "ideal" else markers
        return MarkerSensor(plant, camera, standoff, model, rng, seen)
    if not kind:
        return PoseSensor(plant, camera, standoff, SensorModel.named(level), rng)
    return DepthSensor(
        plant, camera, standoff, DepthModel.named(level), rng, world.board_width,
        compensated=kind == "depth",
    )  # fmt: skip
