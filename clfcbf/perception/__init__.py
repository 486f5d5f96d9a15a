"""The target's pose from what a depth camera sees of its board, with an honest covariance."""

from clfcbf.perception.board import BoardDetector, BoardPose, NotSeen, Reason
from clfcbf.perception.columns import DepthColumns, DepthNoise, DepthSpan, column_tangents
from clfcbf.perception.compensation import (
    compensated_centre,
    printed_centre,
    printed_length,
    uncompensated,
    visible_length,
)
from clfcbf.perception.extent import Edge, End, Extent
from clfcbf.perception.line import Line, LineFit, fit_line
from clfcbf.perception.observation import observation_of

__all__ = [
    "BoardDetector",
    "BoardPose",
    "DepthColumns",
    "DepthNoise",
    "DepthSpan",
    "Edge",
    "End",
    "Extent",
    "Line",
    "LineFit",
    "NotSeen",
    "Reason",
    "column_tangents",
    "compensated_centre",
    "fit_line",
    "observation_of",
    "printed_centre",
    "printed_length",
    "uncompensated",
    "visible_length",
]
