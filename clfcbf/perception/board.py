"""Pose of a board of known width from what a depth camera sees of it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from clfcbf.errors import ConfigurationError
from clfcbf.perception.centre import centre_of
from clfcbf.perception.columns import Array, DepthColumns, DepthNoise, DepthSpan
from clfcbf.perception.extent import CONFIRM, Edge, End, Extent, find_extent
from clfcbf.perception.line import LineFit, fit_line
from clfcbf.perception.segmentation import Indices, drop_outliers, runs
from clfcbf.se2 import Pose2, is_finite

__all__ = ["BoardDetector", "BoardPose", "NotSeen", "Reason"]

LEAST_COLUMNS = 6
"""Columns of a fit worth having: two ends and a spread to judge it by."""
LEAST_SHARE = 0.2
"""Share of the width that has to be seen: the yaw's error grows with the power -3/2 of it."""
LENGTH_TOLERANCE = 0.1
"""Share of the width by which a board may look longer or shorter: a bevel, a frame, the fit."""


_AHEAD = Pose2(0.0, 0.0, 0.0)


class Reason(enum.Enum):
    """Why no board was found; of several surfaces, that of the one that came farthest."""

    NO_COLUMNS = "too few columns see anything"
    NO_SURFACE = "no surface has enough columns on one line"
    WRONG_LENGTH = "the surfaces seen are longer or shorter than the board"
    TOO_SHORT = "too little of the board is in view"
    HIDDEN = "no end of the surface is its own, and something before it may be the board"


class NotSeen(NamedTuple):
    """No board in this frame: the ``reason``, and how many ``columns`` saw anything."""

    reason: Reason
    columns: int


@dataclass(frozen=True, slots=True, eq=False)
class BoardPose:
    """A board found in one frame.

    Attributes
    ----------
    pose : of the board's centre in the robot frame, heading away from the camera's side
    covariance : of it, (3, 3) [m², m rad, rad²]
    fit, extent : line and visible part, in the camera's frame
    columns : indices of the columns the line was fitted to
    """

    pose: Pose2
    covariance: Array
    fit: LineFit
    extent: Extent
    columns: Indices

    @property
    def visible(self) -> float:
        """Length of the visible part [m]."""
        return self.extent.length(self.fit.line)


@dataclass(frozen=True, slots=True)
class BoardDetector:
    """Finds a board of known width in the columns of a depth camera.

    Columns are parted into surfaces at steps of depth; through each a robust line is laid; what
    is no longer than the board, and as long if both of its ends are free, may be the board.
    Of several the one with more free ends is taken, then the one with more columns: of a wall
    behind the board the camera sees pieces that end at the board or at the edge of the view, and
    surfaces that end there are not looked at once both ends of another are free.

    Attributes
    ----------
    width : of the board [m]
    camera : where the camera is on the robot [m, m, rad]
    noise : of its depths, which the covariance follows from
    span : depths it measures; where the line leaves them the board may go on unseen
    least_columns : fewest columns on the board
    least_share : least share of its width in view

    Raises
    ------
    ConfigurationError : a value is outside its range
    """

    width: float
    camera: Pose2 = _AHEAD
    noise: DepthNoise = field(default_factory=DepthNoise)
    span: DepthSpan = field(default_factory=DepthSpan)
    least_columns: int = LEAST_COLUMNS
    least_share: float = LEAST_SHARE

    def __post_init__(self) -> None:
        if not 0.0 < self.width < math.inf:
            raise ConfigurationError(f"width must be finite and positive [m], got {self.width!r}")
        if not is_finite(tuple(self.camera)):
            raise ConfigurationError(f"camera pose must be finite, got {self.camera!r}")
        self.span.check()
        if self.least_columns < 3:
            raise ConfigurationError(
                f"least_columns must be at least 3, which a line leaves a residual, "
                f"got {self.least_columns!r}"
            )
        if not 0.0 < self.least_share <= 1.0:
            raise ConfigurationError(f"least_share must be in (0, 1], got {self.least_share!r}")

    def detect(self, columns: DepthColumns) -> BoardPose | NotSeen:
        """The board in this frame, or why there is none.

        Raises
        ------
        GeometryError : the arrays do not match, or bearings do not rise within ±pi/2
        """
        columns.check()
        tangents, depths = columns.tangents(), columns.depths(self.span)
        seen = int(np.isfinite(depths).sum())
        if seen < self.least_columns:
            return NotSeen(Reason.NO_COLUMNS, seen)
        clean = drop_outliers(depths, self.noise)
        reasons = {Reason.NO_SURFACE}
        best: tuple[LineFit, Extent, Indices] | None = None
        for run, cut in _uncut_first(runs(clean, self.noise), len(clean)):
            if cut and best is not None and best[1].free() == 2:
                break
            found = self._surface(run, tangents, depths, clean)
            if found is None:
                continue
            fit, extent, members = found
            refused = self._refused(fit, extent)
            if refused is not None:
                reasons.add(refused)
            elif best is None or (extent.free(), len(members)) > (best[1].free(), len(best[2])):
                best = found
        if best is None:
            farthest = max(reasons, key=list(Reason).index)
            return NotSeen(farthest, seen)
        return self._pose(*best)

    def _surface(
        self, run: Indices, tangents: Array, depths: Array, clean: Array
    ) -> tuple[LineFit, Extent, Indices] | None:
        if len(run) < self.least_columns:
            return None
        fit = fit_line(tangents[run], depths[run], self.noise)
        if fit is None:
            return None
        members = run[fit.inliers]
        if len(members) < self.least_columns:
            return None
        core = int(members[len(members) // 2])
        extent = find_extent(fit.line, core, tangents, depths, clean, self.noise, self.span)
        return None if extent is None else (fit, extent, members)

    def _refused(self, fit: LineFit, extent: Extent) -> Reason | None:
        line = fit.line
        length = extent.length(line)
        columns = sum(_reach(edge, fit) for edge in extent)
        tolerance = LENGTH_TOLERANCE * self.width + 2.0 * columns
        if length > self.width + tolerance:
            return Reason.WRONG_LENGTH
        if extent.free() == 2 and length < self.width - tolerance:
            return Reason.WRONG_LENGTH
        if length < self.least_share * self.width:
            return Reason.TOO_SHORT
        if not extent.free() and End.OCCLUDED in (extent.right.end, extent.left.end):
            return Reason.HIDDEN
        return None

    def _pose(self, fit: LineFit, extent: Extent, members: Indices) -> BoardPose:
        seen, covariance = centre_of(fit, extent, self.width)
        turn = self.camera.theta
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return BoardPose(
            self.camera.compose(seen), rotation @ covariance @ rotation.T, fit, extent, members
        )


def _uncut_first(surfaces: list[Indices], columns: int) -> list[tuple[Indices, bool]]:
    """Surfaces, each with whether it reaches the edge of the view, those that do not first."""
    last = columns - CONFIRM
    marked = [(run, bool(run[0] < CONFIRM or run[-1] >= last)) for run in surfaces]
    return sorted(marked, key=lambda entry: entry[1])


def _reach(edge: Edge, fit: LineFit) -> float:
    """Length on the board of the column spacing at one of its ends [m]."""
    half = 0.5 * edge.spacing
    line = fit.line
    return math.dist(line.at(edge.tangent - half), line.at(edge.tangent + half))
