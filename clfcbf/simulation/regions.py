"""What a start region is, and how a table of them is read."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2

__all__ = ["Markers", "Nudge", "Region", "parse_regions"]

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Nudge:
    """The target is moved once during a run, in a random direction and to a random side.

    Attributes
    ----------
    distance : by which it is moved [m]
    turn : by which it is turned [rad]
    e_lon : when the robot's longitudinal position first reaches this [m] ...
    time : ... or at this time [s]; one of the two

    Raises
    ------
    ConfigurationError : a value is out of its range, or not exactly one trigger is given
    """

    distance: float
    turn: float = 0.0
    e_lon: float | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        _check_finite(self, ("distance", "turn"), at_least=0.0)
        if (self.e_lon is None) == (self.time is None):
            raise ConfigurationError(
                f"a nudge comes at an e_lon or at a time, one of the two; "
                f"got {self.e_lon!r} and {self.time!r}"
            )
        _check_finite(self, ("e_lon",) if self.time is None else ("time",))


@dataclass(frozen=True, slots=True)
class Markers:
    """Two markers to either side of the board's centre, seen by a scanner.

    Attributes
    ----------
    distance : from one to the other [m]
    sigma : standard deviation of each measured coordinate [m]
    rate : scans per second [Hz]

    Raises
    ------
    ConfigurationError : a value is not finite, or out of its range
    """

    distance: float
    sigma: float
    rate: float

    def __post_init__(self) -> None:
        _check_finite(self, ("sigma",), at_least=0.0)
        _check_finite(self, ("distance", "rate"), at_least=1e-6)


@dataclass(frozen=True, slots=True)
class Region:
    """A box of starts in the goal's frame, and what else is particular to runs from it.

    Attributes
    ----------
    e_lon : range of the longitudinal position, negative before the goal [m]
    e_lat : range of the lateral position, or of its magnitude if ``two_sided`` [m]
    two_sided : draw the side by a coin
    bearing : the camera's bearing of the board's centre is uniform within this share of its
        half angle to either side
    about : what it is for
    visible : range of the share of the board's width in view at the start, the rest beyond one
        edge of the view; None for a bearing as above
    needs_reversing : starts from which driving forward alone reaches the goal are drawn again
    limits : name of the limits of runs that name none themselves
    camera_x, half_angle : what of the world's camera differs [m, rad]
    markers : the target is measured by these
    nudges : of the target during a run

    Raises
    ------
    ConfigurationError : a range is empty or not finite, or a share is not in [0, 1]
    """

    e_lon: Span
    e_lat: Span
    two_sided: bool
    bearing: float
    about: str
    visible: Span | None = None
    needs_reversing: bool = False
    limits: str = "approaching"
    camera_x: float | None = None
    half_angle: float | None = None
    markers: Markers | None = None
    nudges: tuple[Nudge, ...] = ()

    def __post_init__(self) -> None:
        for name in ("e_lon", "e_lat", "visible"):
            span = getattr(self, name)
            if span is not None and not -math.inf < span[0] <= span[1] < math.inf:
                raise ConfigurationError(f"{name} must be a finite range [low, high], got {span!r}")
        for share in (self.bearing, *(self.visible or ())):
            if not 0.0 <= share <= 1.0:
                raise ConfigurationError(f"a share must be in [0, 1], got {share!r}")

    def camera(self, camera: FieldOfView) -> FieldOfView:
        """The world's ``camera`` with what differs here."""
        x, y, theta = camera.camera
        mount = Pose2(x if self.camera_x is None else self.camera_x, y, theta)
        half_angle = camera.half_angle if self.half_angle is None else self.half_angle
        return FieldOfView(half_angle, mount, camera.width)


def parse_regions(text: str) -> dict[str, Region]:
    """The regions in a TOML table, by name; ``regions.toml`` explains its keys.

    Raises
    ------
    ConfigurationError : it is no TOML, a key is unknown, one is missing or a value is wrong; the
        message names region and key
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"the table of regions is no TOML: {error}") from error
    return {name: _region(name, table) for name, table in tables.items()}


_REGION = (
    "about", "e_lon", "e_lat", "two_sided", "bearing", "visible", "needs_reversing", "limits",
    "camera", "markers", "nudge",
)  # fmt: skip


def _region(name: str, table: Mapping[str, Any]) -> Region:
    _check_keys(f"region {name}", table, _REGION, ("about", "e_lon", "e_lat"))
    if ("bearing" in table) == ("visible" in table):
        raise ConfigurationError(f"region {name} needs bearing or visible, one of the two")
    camera = table.get("camera", {})
    _check_keys(f"camera of region {name}", camera, ("x", "half_angle_deg"))
    half_angle = camera.get("half_angle_deg")
    markers = table.get("markers")
    if markers is not None:
        keys = ("distance", "sigma", "rate")
        _check_keys(f"markers of region {name}", markers, keys, keys)
    try:
        return Region(
            e_lon=_span(table["e_lon"]),
            e_lat=_span(table["e_lat"]),
            two_sided=table.get("two_sided", False),
            bearing=table.get("bearing", 0.0),
            about=table["about"],
            visible=_span(table["visible"]) if "visible" in table else None,
            needs_reversing=table.get("needs_reversing", False),
            limits=table.get("limits", "approaching"),
            camera_x=camera.get("x"),
            half_angle=None if half_angle is None else math.radians(half_angle),
            markers=None if markers is None else Markers(**markers),
            nudges=tuple([_nudge(name, nudge) for nudge in table.get("nudge", ())]),
        )
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"region {name}: {error}") from error


def _nudge(region: str, table: Mapping[str, Any]) -> Nudge:
    keys = ("e_lon", "time", "distance", "turn_deg")
    _check_keys(f"nudge of region {region}", table, keys, ("distance",))
    return Nudge(
        table["distance"], math.radians(table.get("turn_deg", 0.0)),
        table.get("e_lon"), table.get("time"),
    )  # fmt: skip


def _span(values: list[float]) -> Span:
    low, high = values
    return float(low), float(high)


def _check_keys(
    what: str, table: Mapping[str, Any], known: tuple[str, ...], needed: tuple[str, ...] = ()
) -> None:
    for key in table:
        if key not in known:
            raise ConfigurationError(f"{what}: unknown key {key!r}; choose from {', '.join(known)}")
    for key in needed:
        if key not in table:
            raise ConfigurationError(f"{what}: {key} is missing")


def _check_finite(holder: object, names: tuple[str, ...], at_least: float = -math.inf) -> None:
    for name in names:
        value = getattr(holder, name)
        if not (math.isfinite(value) and value >= at_least):
            bound = "" if at_least == -math.inf else f" and at least {at_least:g}"
            raise ConfigurationError(f"{name} must be finite{bound}, got {value!r}")
