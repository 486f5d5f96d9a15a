"""What a configuration file holds, as the objects that the library takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clfcbf import defaults
from clfcbf.camera import FieldOfView
from clfcbf.controller import DockingController
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import NoiseModel
from clfcbf.limits import Limits, check_period
from clfcbf.runtime.policy import LoopPolicy
from clfcbf.safety_filter import as_barriers
from clfcbf.tick import FilterConfig
from clfcbf.trajectories.following import FollowingGains
from clfcbf.wheels import WheelLimits

__all__ = ["Config"]

SHORTEST_PERIOD = 1e-3
"""[s] Twenty times faster than a loop in Python holds; plans are tried tick by tick, and at a
shorter one that takes minutes."""


@dataclass(frozen=True, slots=True)
class Config:
    """A robot, its task, and how the library is to go about it.

    Attributes
    ----------
    limits : of the chassis
    camera : camera and field of view
    filter : period, backend and guard
    docking : further fields of :class:`~clfcbf.docking.DockingConfig` by name, ``standoff`` at
        least
    gains, noise : of the controller
    loop : what the loop does about late ticks and old measurements
    wheels : what the wheels can do, None where that is not given
    """

    limits: Limits
    camera: FieldOfView
    filter: FilterConfig
    docking: Mapping[str, Any]
    gains: FollowingGains = field(default_factory=FollowingGains)
    noise: NoiseModel = defaults.NOISE
    loop: LoopPolicy = field(default_factory=LoopPolicy)
    wheels: WheelLimits | None = None

    def __post_init__(self) -> None:
        if "standoff" not in self.docking:
            raise ConfigurationError(f"docking needs a standoff, got {dict(self.docking)!r}")
        if self.filter.period < SHORTEST_PERIOD:
            raise ConfigurationError(
                f"period must be at least {SHORTEST_PERIOD:g} s, got {self.filter.period!r}"
            )

    @classmethod
    def of(
        cls,
        limits: Limits,
        camera: FieldOfView,
        docking: Mapping[str, Any],
        filter: Mapping[str, Any],
        **parts: Any,
    ) -> Config:
        """With the filter made of its own options (``period`` at least) and the camera.

        Raises
        ------
        ConfigurationError, BackendError : as :class:`~clfcbf.tick.FilterConfig`
        """
        options = {"guard_lag": defaults.GUARD_LAG, **filter}
        period = check_period(options["period"])
        barriers = as_barriers((camera,), limits, period, options["guard_lag"])
        made = FilterConfig(limits, barriers, **options)
        return cls(limits, camera, made, dict(docking), **parts)

    @property
    def standoff(self) -> float:
        """Distance from the goal to the feature straight ahead of it [m]."""
        return float(self.docking["standoff"])

    def controller(self) -> DockingController:
        """The docking controller of this configuration; takes a tenth of a second.

        Raises
        ------
        ConfigurationError : a part of the controller refuses a value
        """
        base = self.filter
        with np.errstate(all="ignore"):  # what overflows here is refused, or harms nobody
            return DockingController(
                self.limits,
                self.camera,
                period=base.period,
                backend=base.backend,
                weight=base.weight,
                lag=base.lag,
                guard_lag=base.guard_lag,
                gains=self.gains,
                noise=self.noise,
                **self.docking,
            )
