"""The world the figures refer to, and the start regions, as data.

The paper gives few of these numbers; the others are assumptions, stated here once. Extend the
tables to add a region: one row each, read by ``approach`` and by the benchmarks alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, wrap_angle

__all__ = ["LIMITS", "REGIONS", "Region", "World", "draw_start", "limits_named", "region_named"]

LIMITS: dict[str, Limits] = {
    "approaching": Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0),
    "docking": Limits(v_max=0.35, omega_max=0.25, a_max=0.3, alpha_max=1.0),
}
"""Speed limits of the paper's two stages; accelerations are assumed."""


@dataclass(frozen=True, slots=True)
class World:
    """What stands where, and how fast things happen.

    Attributes
    ----------
    standoff : distance from the goal pose to the board's centre ahead of it [m]
    board_width : width of the board [m]
    camera : pose on the robot and half angle; the paper's camera sees 70°
    period : of control and camera [s]
    patience : longest run [s]
    wait : time after "done" at which the result is judged [s]
    """

    standoff: float = 0.6
    board_width: float = 0.5
    camera: FieldOfView = field(
        default_factory=lambda: FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
    )
    period: float = 1.0 / 30.0
    patience: float = 60.0
    wait: float = 1.0

    @property
    def feature(self) -> Pose2:
        """The board's centre in the goal's frame."""
        return Pose2(self.standoff, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Region:
    """A box of starts in the goal's frame.

    Attributes
    ----------
    e_lon : range of the longitudinal position, negative before the goal [m]
    e_lat : range of the lateral position, or of its magnitude if ``two_sided`` [m]
    two_sided : draw the side by a coin
    bearing : the camera's bearing of the board's centre is uniform within this share of its
        half angle to either side
    about : what it is for
    """

    e_lon: tuple[float, float]
    e_lat: tuple[float, float]
    two_sided: bool
    bearing: float
    about: str


REGIONS: dict[str, Region] = {
    "R1": Region((-2.5, -1.5), (-1.0, 1.0), False, 0.9, "the paper's region"),
    "R3": Region((-1.5, -0.9), (-0.6, 0.6), False, 0.9, "close"),
    "R4": Region((-1.5, -0.9), (0.4, 0.7), True, 0.9, "close and to the side"),
}


def region_named(name: str) -> Region:
    """The region of that name; ``ConfigurationError`` lists the valid ones."""
    if name not in REGIONS:
        raise ConfigurationError(f"unknown region {name!r}; choose from {', '.join(REGIONS)}")
    return REGIONS[name]


def limits_named(name: str) -> Limits:
    """The limits of that stage; ``ConfigurationError`` lists the valid ones."""
    if name not in LIMITS:
        raise ConfigurationError(f"unknown limits {name!r}; choose from {', '.join(LIMITS)}")
    return LIMITS[name]


def facing(x: float, y: float, bearing: float, world: World) -> Pose2:
    r"""Pose at (x, y) whose camera sees the feature under ``bearing``.

    For a camera :math:`c_x` ahead of the centre, on its axis, and a feature at the distance
    :math:`\rho` from the centre, :math:`\varphi = \beta - \arcsin(c_x\sin\beta/\rho)`.
    """
    dx, dy = world.standoff - x, -y
    ahead = world.camera.camera.x * math.sin(bearing) / math.hypot(dx, dy)
    phi = bearing - math.asin(ahead) + world.camera.camera.theta
    return Pose2(x, y, wrap_angle(math.atan2(dy, dx) - phi))


def draw_start(region: Region, world: World, rng: np.random.Generator) -> Pose2:
    """One start of the region, in the goal's frame."""
    x = float(rng.uniform(*region.e_lon))
    y = float(rng.uniform(*region.e_lat))
    side = float(rng.choice((-1.0, 1.0)))
    span = region.bearing * world.camera.half_angle
    bearing = float(rng.uniform(-span, span))
    return facing(x, side * y if region.two_sided else y, bearing, world)
