"""The world the figures refer to, and the start regions, as data.

The paper gives few of these numbers; the others are assumptions, stated here once. The regions
are a table of their own, ``regions.toml``, read by ``approach`` and by the benchmarks alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from importlib import resources

import numpy as np

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.se2 import Point, Pose2, wrap_angle
from clfcbf.simulation.regions import Region, parse_regions
from clfcbf.trajectories.log_spiral import forward_limit
from clfcbf.unicycle import Polar

__all__ = [
    "LIMITS",
    "REGIONS",
    "Region",
    "World",
    "draw_start",
    "facing",
    "limits_named",
    "must_reverse",
    "region_named",
    "visible_share",
    "world_of",
]

DRAWS = 10_000
"""Draws for one start of a region that keeps only some: a region with none is soon told."""

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


REGIONS: dict[str, Region] = parse_regions(
    resources.files("clfcbf.simulation").joinpath("regions.toml").read_text(encoding="utf-8")
)
"""The start regions by name."""


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


def world_of(region: Region, world: World | None = None) -> World:
    """The world, the default one if none is given, with what is particular to the region."""
    world = world or World()
    return replace(world, camera=region.camera(world.camera))


def facing(x: float, y: float, bearing: float, world: World, point: Point | None = None) -> Pose2:
    r"""Pose at (x, y) whose camera sees the feature, or another point, under ``bearing``.

    For a camera :math:`c_x` ahead of the centre, on its axis, and a point at the distance
    :math:`\rho` from the centre, :math:`\varphi = \beta - \arcsin(c_x\sin\beta/\rho)`.
    """
    px, py = (world.standoff, 0.0) if point is None else point
    dx, dy = px - x, py - y
    ahead = world.camera.camera.x * math.sin(bearing) / math.hypot(dx, dy)
    phi = bearing - math.asin(ahead) + world.camera.camera.theta
    return Pose2(x, y, wrap_angle(math.atan2(dy, dx) - phi))


def visible_share(pose: Pose2, world: World) -> float:
    r"""Share of the board's width between the edges of the true view, in [0, 1].

    The board is the segment :math:`p(t) = p_- + t(p_+ - p_-)` in the camera's frame; an edge
    keeps :math:`x\sin\Phi \pm y\cos\Phi \ge 0` of it, which is linear in t.
    """
    half = 0.5 * world.board_width
    camera = pose.compose(world.camera.camera)
    (ax, ay), (bx, by) = (camera.seen((world.standoff, end)) for end in (-half, half))
    s, c = math.sin(world.camera.half_angle), math.cos(world.camera.half_angle)
    low, high = 0.0, 1.0
    for side in (-c, c):
        first, last = s * ax + side * ay, s * bx + side * by
        if first < 0.0 and last < 0.0:
            return 0.0
        if first < 0.0:
            low = max(low, first / (first - last))
        elif last < 0.0:
            high = min(high, first / (first - last))
    return max(high - low, 0.0)


def must_reverse(pose: Pose2, world: World) -> bool:
    """Whether no way forward alone leads from ``pose`` to the goal with the feature in view.

    See :func:`~clfcbf.trajectories.log_spiral.forward_limit`; a turn on the spot is no help, for
    the limit is the same for every heading.
    """
    rho, _, delta = Polar.of(pose.relative(world.feature))
    if rho <= world.standoff:
        return True
    lowest, highest = forward_limit(rho, world.standoff, world.camera)
    return not lowest <= delta <= highest


def draw_start(region: Region, world: World, rng: np.random.Generator) -> Pose2:
    """One start of the region, in the goal's frame.

    Raises
    ------
    ConfigurationError : the region keeps only starts that need reversing, and has none
    """
    world = world_of(region, world)
    for _ in range(DRAWS):
        start = _draw(region, world, rng)
        if not region.needs_reversing or must_reverse(start, world):
            return start
    raise ConfigurationError(
        f"a region needs a start that has to reverse, and {DRAWS} draws gave none: {region!r}"
    )


def _draw(region: Region, world: World, rng: np.random.Generator) -> Pose2:
    x = float(rng.uniform(*region.e_lon))
    y = float(rng.uniform(*region.e_lat))
    side = float(rng.choice((-1.0, 1.0)))
    y = side * y if region.two_sided else y
    half_angle = world.camera.half_angle
    if region.visible is None:
        span = region.bearing * half_angle
        return facing(x, y, float(rng.uniform(-span, span)), world)
    share = float(rng.uniform(*region.visible))
    cut = float(rng.choice((-1.0, 1.0)))  # the edge of the view that cuts the board, +1 the left
    end = cut * (share - 0.5) * world.board_width
    return facing(x, y, cut * half_angle, world, (world.standoff, end))
