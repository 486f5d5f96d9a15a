"""A simulated depth camera: one row of columns across its view, and what each gets wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.perception.columns import (
    Array,
    DepthColumns,
    DepthNoise,
    DepthSpan,
    column_tangents,
)
from clfcbf.se2 import Pose2, is_finite
from clfcbf.simulation.sensor_model import SensorModel

__all__ = ["DepthCamera", "DepthDraw", "DepthModel", "cast"]

COLUMNS = 240
"""Columns: a depth image of low resolution, or a finer one with neighbours averaged."""
OUTLIERS = 0.02
"""Share of columns with a depth that has nothing to do with the scene: glints, mixed pixels."""
BEHIND = 1.0
"""[m] From the board to a wall behind it: within range near the goal, out of it at the start."""


@dataclass(frozen=True, slots=True)
class DepthModel:
    """A depth camera's errors: those of each column, and those of the run.

    Attributes
    ----------
    frames : rate, latency, drop-outs and outliers of whole frames, calibration error, drift and
        bias; its white noise is not used, for here that of the pose follows from the columns'
    noise : of the columns' depth
    columns : number of columns across the view
    span : depths outside are not measured
    outliers : share of columns with a depth uniform in the span
    behind : distance from the board to a wall behind it, parallel to it [m]; None for no wall

    Raises
    ------
    ConfigurationError : a value is outside its range
    """

    frames: SensorModel = field(default_factory=SensorModel)
    noise: DepthNoise = field(default_factory=DepthNoise)
    columns: int = COLUMNS
    span: DepthSpan = field(default_factory=DepthSpan)
    outliers: float = OUTLIERS
    behind: float | None = BEHIND

    def __post_init__(self) -> None:
        if self.columns < 2:
            raise ConfigurationError(f"columns must be at least 2, got {self.columns!r}")
        self.span.check()
        if not 0.0 <= self.outliers <= 1.0:
            raise ConfigurationError(f"outliers must be a share in [0, 1], got {self.outliers!r}")
        if self.behind is not None and not 0.0 < self.behind < math.inf:
            raise ConfigurationError(
                f"behind must be finite and positive [m], or None, got {self.behind!r}"
            )

    @classmethod
    def named(cls, level: str) -> DepthModel:
        """The model of a named level, the errors of whole frames as in ``SensorModel.named``.

        ``ideal``: exact depths in every column and none late; the board is still counted in
        columns. ``A``: noise and outliers of columns. ``B``: A with a mount that is off by
        N(0, 5 mm) across and N(0, 0.5°) in yaw and depths off by N(0, 5 mm), once a run and
        slowly varying. ``C``: A with the bias of the errors that [Xie2024]_ reports. Raises
        ``ConfigurationError`` for any other name.
        """
        frames = SensorModel.named(level)
        if level == "ideal":
            return cls(frames=frames, noise=DepthNoise.none(), outliers=0.0)
        return cls(frames=frames)


class DepthDraw(NamedTuple):
    """What one frame draws, whether or not it sees anything.

    ``white`` (N,) and ``common`` standard normal; ``odd`` (N,) which columns are outliers, and
    ``anywhere`` (N,) where, uniform in [0, 1).
    """

    white: Array
    common: float
    odd: NDArray[np.bool_]
    anywhere: Array


def cast(board: Pose2, width: float, tangents: Array) -> Array:
    r"""Depth at which each column's ray meets a board.

    With the board's normal :math:`n` and tangent :math:`t`, the ray :math:`z\,(1, \tau)`
    meets the line of the board at :math:`z = n^\top d\,/\,n^\top(1, \tau)`, and the board
    itself if it is ahead and :math:`|t^\top(z\,(1, \tau) - d)| \le l/2`.

    Parameters
    ----------
    board : pose of its centre :math:`d`, in the camera's frame
    width : :math:`l` [m]; infinite for a wall
    tangents : :math:`\tau` of the columns, (N,)

    Returns
    -------
    Depths (N,) [m], NaN where the ray passes the board or runs along it.
    """
    x, y, theta = board
    c, s = math.cos(theta), math.sin(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = (c * x + s * y) / (c + s * tangents)
        along = c * (depths * tangents - y) - s * (depths - x)
        hit = (depths > 0.0) & (depths < math.inf) & (np.abs(along) <= 0.5 * width)
    return np.where(hit, depths, np.nan)


class DepthCamera:
    """Columns of a depth camera that looks at a board and the wall behind it.

    Each column is one ray through its middle: it sees the board or it does not. The noise of a
    pose fitted to them is therefore not put in but comes out: of the yaw as the board's depth
    scatters over the visible width, and across from the columns between which its ends lie.

    Parameters
    ----------
    model : errors of the columns
    half_angle : half of the horizontal field of view [rad]
    width : of the board [m]
    """

    def __init__(self, model: DepthModel, half_angle: float, width: float) -> None:
        if not 0.0 < width < math.inf:
            raise ConfigurationError(f"width must be finite and positive [m], got {width!r}")
        self._model = model
        self._width = width
        self._tangents = column_tangents(half_angle, model.columns)
        self._bearings = np.arctan(self._tangents)

    def draw(self, rng: np.random.Generator) -> DepthDraw:
        """One frame's draw: always as many variates, so that seeds stay paired."""
        n = self._model.columns
        normal = rng.standard_normal(n + 1)
        odd, anywhere = rng.random((2, n))
        return DepthDraw(normal[:n], float(normal[n]), odd < self._model.outliers, anywhere)

    def columns(self, board: Pose2, draw: DepthDraw, depth_bias: float = 0.0) -> DepthColumns:
        """What the camera sees.

        Parameters
        ----------
        board : pose of the board's centre in the camera's frame
        draw : of this frame
        depth_bias : added to every depth of the scene [m]

        Raises
        ------
        GeometryError : the board's pose is not finite
        """
        if not is_finite(tuple(board)):
            raise GeometryError(f"board pose must be finite, got {board!r}")
        model = self._model
        depths = cast(board, self._width, self._tangents)
        if model.behind is not None:
            wall = cast(board.compose(Pose2(model.behind, 0.0, 0.0)), math.inf, self._tangents)
            depths = np.where(np.isfinite(depths), depths, wall)
        depths = depths + model.noise.white(depths) * draw.white
        depths += model.noise.common * draw.common + depth_bias
        near, far = model.span
        depths = np.where(draw.odd, near + (far - near) * draw.anywhere, depths)
        ranges = np.where(model.span.holds(depths), depths / np.cos(self._bearings), np.nan)
        return DepthColumns(self._bearings, ranges)
