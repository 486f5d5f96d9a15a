"""What a pose sensor gets wrong, as data: timing, losses, outliers and the levels of noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from clfcbf.errors import ConfigurationError

__all__ = ["BiasBounds", "SensorModel", "Sigma", "Spread"]

OUTLIER_POSITION = 0.5
"""[m] an outlier's largest error along and across the line of sight: a wrong segment fitted."""
OUTLIER_YAW = math.radians(30.0)
"""[rad] an outlier's largest error of the board's yaw."""
DRIFT_TIME = 2.0
"""[s] correlation time of slow errors: a changing view of the same surface."""


class Spread(NamedTuple):
    """Size of an error along and across the line of sight [m], and of the board's yaw [rad]."""

    position: float
    yaw: float


class Sigma(NamedTuple):
    """Standard deviations along and across the line of sight [m], and of the yaw [rad]."""

    along: float
    across: float
    yaw: float


class BiasBounds(NamedTuple):
    """Largest bias from ``near.distance`` inward and from ``far_distance`` outward, linear between.

    Distances are from the camera [m].
    """

    near_distance: float
    near: Spread
    far_distance: float
    far: Spread

    def at(self, distance: float) -> Spread:
        """The bounds at ``distance`` [m] from the camera."""
        share = (distance - self.near_distance) / (self.far_distance - self.near_distance)
        share = min(max(share, 0.0), 1.0)
        (near_position, near_yaw), (far_position, far_yaw) = self.near, self.far
        return Spread(
            near_position + share * (far_position - near_position),
            near_yaw + share * (far_yaw - near_yaw),
        )


_NONE = Spread(0.0, 0.0)
_CALIBRATION = Spread(0.005, math.radians(0.5))
_BOX_PLOT = BiasBounds(0.4, Spread(0.010, math.radians(0.5)), 1.5, Spread(0.1, math.radians(5.0)))


@dataclass(frozen=True, slots=True)
class SensorModel:
    r"""How a camera's pose estimate of the board differs from the truth.

    White noise at camera distance :math:`z`, one sigma: along the line of sight
    :math:`\sigma_0 + \sigma_2 z^2`, across it :math:`\sigma_1 z`, yaw :math:`\sigma_\theta z`,
    the order of structured-light and time-of-flight depth cameras. The defaults are level A.

    Attributes
    ----------
    rate : frames per second [Hz]
    latency : from capture to delivery, drawn once a run, uniform between the two [s]
    jitter : standard deviation of each frame's own delay about it [s]; the sum stays positive
    dropout : probability that a frame gives nothing
    outlier : probability that a frame's pose is off by up to ±0.5 m along and across the line
        of sight and ±30° in yaw, uniform
    range_noise : :math:`(\sigma_0, \sigma_2)` [m, 1/m]
    lateral_noise : :math:`\sigma_1` [m/m]
    yaw_noise : :math:`\sigma_\theta` [rad/m]
    calibration : standard deviation of a constant error, drawn once a run
    drift : standard deviation of a stationary Gauss-Markov error of correlation time 2 s
    bias : bounds of an error that depends on the distance; a run draws its share of them
        uniformly in [-1, 1], for each of along, across and yaw

    Raises
    ------
    ConfigurationError : a value is not finite or out of its range
    """

    rate: float = 30.0
    latency: tuple[float, float] = (0.06, 0.12)
    jitter: float = 0.01
    dropout: float = 0.02
    outlier: float = 0.02
    range_noise: tuple[float, float] = (0.002, 0.001)
    lateral_noise: float = 0.004
    yaw_noise: float = math.radians(0.3)
    calibration: Spread = _NONE
    drift: Spread = _NONE
    bias: BiasBounds | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise ConfigurationError(f"rate must be finite and positive [Hz], got {self.rate!r}")
        earliest, latest = self.latency
        if not 0.0 <= earliest <= latest < math.inf:
            raise ConfigurationError(
                f"latency must be (earliest, latest) with 0 <= earliest <= latest [s], "
                f"got {self.latency!r}"
            )
        for name in ("dropout", "outlier"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1.0:
                raise ConfigurationError(f"{name} must be a probability in [0, 1], got {value!r}")
        sizes: dict[str, tuple[float, ...]] = {
            "jitter": (self.jitter,),
            "range_noise": self.range_noise,
            "lateral_noise": (self.lateral_noise,),
            "yaw_noise": (self.yaw_noise,),
            "calibration": self.calibration,
            "drift": self.drift,
        }
        if self.bias is not None:
            sizes["bias"] = (*self.bias.near, *self.bias.far)
            if not 0.0 <= self.bias.near_distance < self.bias.far_distance < math.inf:
                raise ConfigurationError(
                    f"bias needs 0 <= near_distance < far_distance [m], got {self.bias!r}"
                )
        for name, values in sizes.items():
            if not all(0.0 <= value < math.inf for value in values):
                raise ConfigurationError(f"{name} must be finite and >= 0, got {values!r}")

    def sigma(self, distance: float) -> Sigma:
        """Standard deviations of the white noise at ``distance`` [m] from the camera."""
        constant, quadratic = self.range_noise
        return Sigma(
            constant + quadratic * distance * distance,
            self.lateral_noise * distance,
            self.yaw_noise * distance,
        )

    @classmethod
    def ideal(cls) -> SensorModel:
        """Every frame exact and at once: no noise, latency, drop-outs or outliers."""
        return cls(
            latency=(0.0, 0.0),
            jitter=0.0,
            dropout=0.0,
            outlier=0.0,
            range_noise=(0.0, 0.0),
            lateral_noise=0.0,
            yaw_noise=0.0,
        )

    @classmethod
    def named(cls, level: str) -> SensorModel:
        """The model of a named level.

        ``ideal``: no error at all. ``A``: white noise. ``B``: A with a calibration error
        N(0, 5 mm; 0.5°) and a slow one of the same size. ``C``: A with a bias of up to 0.1 m
        and 5° from 1.5 m outward, the medians reported in [Xie2024]_, that shrinks linearly to
        10 mm and 0.5° at 0.4 m. Raises ``ConfigurationError`` for any other name.
        """
        if level == "ideal":
            return cls.ideal()
        if level == "A":
            return cls()
        if level == "B":
            return cls(calibration=_CALIBRATION, drift=_CALIBRATION)
        if level == "C":
            return cls(bias=_BOX_PLOT)
        raise ConfigurationError(f"unknown sensor level {level!r}; choose ideal, A, B or C")
