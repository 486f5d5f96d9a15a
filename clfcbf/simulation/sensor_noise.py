"""One run's draw of a sensor model: its constant errors, and each frame's own."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clfcbf.simulation.sensor_model import (
    DRIFT_TIME,
    OUTLIER_POSITION,
    OUTLIER_YAW,
    SensorModel,
    Spread,
)

__all__ = ["FrameDraw", "SensorNoise", "ViewError"]


class ViewError(NamedTuple):
    """Error along the line of sight, across it to the left [m], and of the yaw [rad]."""

    along: float
    across: float
    yaw: float


_NO_ERROR = ViewError(0.0, 0.0, 0.0)


class FrameDraw(NamedTuple):
    """What one frame draws, whether or not it sees anything."""

    delay: float
    lost: bool
    white: ViewError
    slow: ViewError
    outlier: ViewError


class SensorNoise:
    """The random part of a sensor over one run.

    Every frame draws the same number of variates, seen or not, so that two controllers with
    one seed meet the same noise at the same time however differently they move.

    Parameters
    ----------
    model : what is drawn from
    rng : draws this run's latency, calibration, bias and initial drift, then each frame
    """

    def __init__(self, model: SensorModel, rng: np.random.Generator) -> None:
        self.model = model
        self._rng = rng
        self.latency = float(rng.uniform(*model.latency))
        self._calibration = _scaled(model.calibration, *rng.standard_normal(3).tolist())
        self._share = ViewError(*rng.uniform(-1.0, 1.0, 3).tolist())
        self._drift = _scaled(model.drift, *rng.standard_normal(3).tolist())
        self._drift_time: float | None = None

    def draw(self, time: float) -> FrameDraw:
        """What the frame captured at ``time`` [s] draws; times must not decrease."""
        normal = self._rng.standard_normal(6).tolist()
        lost, odd, *box = self._rng.random(5).tolist()
        self._move_drift(time, normal[3:])
        slow = ViewError(*(a + b for a, b in zip(self._calibration, self._drift, strict=True)))
        outlier = _NO_ERROR
        if odd < self.model.outlier:
            spread = Spread(OUTLIER_POSITION, OUTLIER_YAW)
            outlier = _scaled(spread, *(2.0 * share - 1.0 for share in box))
        return FrameDraw(
            self._delay(), lost < self.model.dropout, ViewError(*normal[:3]), slow, outlier
        )

    def error(self, draw: FrameDraw, distance: float) -> ViewError:
        """The error of a frame's pose at ``distance`` [m] from the camera."""
        along, across, yaw = (
            sigma * white
            for sigma, white in zip(self.model.sigma(distance), draw.white, strict=True)
        )
        bias = _NO_ERROR
        if self.model.bias is not None:
            bias = _scaled(self.model.bias.at(distance), *self._share)
        slow, outlier = draw.slow, draw.outlier
        return ViewError(
            along + slow.along + bias.along + outlier.along,
            across + slow.across + bias.across + outlier.across,
            yaw + slow.yaw + bias.yaw + outlier.yaw,
        )

    def _delay(self) -> float:
        """The run's latency with this frame's jitter, redrawn while it is not positive."""
        if self.model.jitter == 0.0:
            return self.latency
        while True:
            delay = self.latency + self.model.jitter * float(self._rng.standard_normal())
            if delay > 0.0:
                return delay

    def _move_drift(self, time: float, normal: list[float]) -> None:
        """Exact discretisation of a stationary Gauss-Markov process, at any frame spacing."""
        if self._drift_time is not None:
            elapsed = (time - self._drift_time) / DRIFT_TIME
            kept = math.exp(-elapsed)
            fresh = _scaled(self.model.drift, *normal)
            new = math.sqrt(-math.expm1(-2.0 * elapsed))
            self._drift = ViewError(
                *(kept * old + new * step for old, step in zip(self._drift, fresh, strict=True))
            )
        self._drift_time = time


def _scaled(spread: Spread, along: float, across: float, yaw: float) -> ViewError:
    return ViewError(spread.position * along, spread.position * across, spread.yaw * yaw)
