"""The safety filter around commands that come from elsewhere, ticked by the loop."""

from __future__ import annotations

import math

from clfcbf.decision import Decision, Status
from clfcbf.errors import ConfigurationError
from clfcbf.safety_filter import SafetyFilter
from clfcbf.scene import Observation, Scene
from clfcbf.se2 import Twist
from clfcbf.tick import begin, stop

__all__ = ["CommandFilter"]

_REST = Twist(0.0, 0.0)


class CommandFilter:
    """Makes somebody else's velocity commands safe: what a joystick or a navigation stack wants.

    A command counts for ``timeout`` after its stamp; then the wish is to stand. So a source that
    has died stops the robot, where a node that repeats the last command would drive on. Before
    the target was first seen nothing can be promised about it, and the robot brakes.

    Parameters
    ----------
    safety : the filter
    timeout : longest age of a command [s], a few of its source's periods

    Raises
    ------
    ConfigurationError : the timeout is not finite and positive
    """

    def __init__(self, safety: SafetyFilter, timeout: float) -> None:
        if not (math.isfinite(timeout) and timeout > 0.0):
            raise ConfigurationError(f"timeout must be finite and positive [s], got {timeout!r}")
        self._safety = safety
        self._timeout = timeout
        self._wish = (_REST, -math.inf)
        self._scene: Scene | None = None

    def command(self, twist: Twist, stamp: float) -> None:
        """Wish for ``twist`` as of ``stamp`` [s], on the loop's clock; from any thread."""
        self._wish = (Twist(*twist), stamp)

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """The safe command closest to the latest wish, as the loop asks for it."""
        if observation is not None:
            self._scene = Scene(observation.goal, observation.feature, observation.stamp)
        twist, stamp = self._wish
        wish = twist if now - stamp <= self._timeout else _REST
        safety = self._safety
        if self._scene is None:
            begun = begin(safety.config, safety.state, applied, now)
            decision, safety.state = stop(begun, begun.fault or Status.NO_TARGET, safety.config)
            return decision
        return safety.filter(wish, self._scene, applied, now)
