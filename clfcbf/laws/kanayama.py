r"""Tracking laws of Kanayama and of Samson, each with its Lyapunov function and its decay.

Both track a virtual target whose pose is seen from the robot, ``error = (x, y, theta)``. Their
decays W are only semidefinite: :math:`\dot V \le -\mu V` is not always possible, but
:math:`\dot V \le -\sigma W` with :math:`0 < \sigma \le 1` always is, the law being a witness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2, Twist

__all__ = ["Kanayama", "Samson", "check_gains", "sinc"]


def check_gains(law: str, **gains: float) -> None:
    """Raise ``ConfigurationError`` unless every gain is finite and positive."""
    for name, value in gains.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigurationError(
                f"{law}: gain {name} must be finite and positive, got {value!r}"
            )


@dataclass(frozen=True, slots=True)
class Kanayama:
    r"""Kanayama's tracking law [Kanayama1990]_, corrected for reverse.

    .. math::
        v = v_V\cos\theta + k_1 x, \qquad
        \omega = \omega_V + k_2 v_V y + k_3 |v_V| \sin\theta

    .. math::
        V = \tfrac12(x^2 + y^2) + \frac{1 - \cos\theta}{k_2}, \qquad
        \dot V = -k_1 x^2 - \frac{k_3}{k_2}|v_V|\sin^2\theta

    As first published the last term of :math:`\omega` has :math:`v_V`, not its magnitude: right
    forward, destabilising in reverse.

    Attributes
    ----------
    k1 : [1/s]; 1 closes a longitudinal error in a second or so
    k2 : [1/m²]; with 8 a lateral error decays over some 0.35 m of travel
    k3 : [1/m]; :math:`2\sqrt{k_2}` damps critically, 6 a little more

    Raises
    ------
    ConfigurationError : a gain is not finite and positive

    Notes
    -----
    Domain :math:`|\theta| < \pi`; at :math:`\theta = \pi` with x = y = 0 the law rests on a saddle.
    A lateral error is corrected only while the reference moves: :math:`v_V` must not tend to 0.
    """

    k1: float = 1.0
    k2: float = 8.0
    k3: float = 6.0

    def __post_init__(self) -> None:
        check_gains("Kanayama", k1=self.k1, k2=self.k2, k3=self.k3)

    def command(self, error: Pose2, reference: Twist) -> Twist:
        """The twist that tracks a virtual target at ``error`` moving with ``reference``."""
        x, y, theta = error
        v, omega = reference
        speed = v * math.cos(theta) + self.k1 * x
        turn = omega + self.k2 * v * y + self.k3 * abs(v) * math.sin(theta)
        return tuple.__new__(Twist, (speed, turn))

    def lyapunov(self, error: Pose2) -> float:
        """V [m²]."""
        x, y, theta = error
        return 0.5 * (x * x + y * y) + (1.0 - math.cos(theta)) / self.k2

    def decay(self, error: Pose2, reference: Twist) -> float:
        """W = -dV/dt under the law [m²/s]; 0 at a pure lateral error, so only semidefinite."""
        s = math.sin(error.theta)
        return self.k1 * error.x * error.x + self.k3 / self.k2 * abs(reference.v) * s * s


@dataclass(frozen=True, slots=True)
class Samson:
    r"""Tracking law of Samson [Samson1993]_ and Jiang and Nijmeijer [Jiang1997]_.

    .. math::
        v = v_V\cos\theta + k_1 x, \qquad
        \omega = \omega_V + \gamma\, v_V\, y\, \frac{\sin\theta}{\theta} + k\,\theta

    .. math::
        V = \tfrac12(x^2 + y^2) + \frac{\theta^2}{2\gamma}, \qquad
        \dot V = -k_1 x^2 - \frac{k}{\gamma}\theta^2

    Attributes
    ----------
    k1 : [1/s]; 1 closes a longitudinal error in a second or so
    gamma : [1/m²]; 8, as Kanayama's ``k2``
    k : [1/s]; :math:`2|v_V|\sqrt\gamma` damps critically, 1.25 at 0.22 m/s

    Raises
    ------
    ConfigurationError : a gain is not finite and positive

    Notes
    -----
    For either sign of :math:`v_V`, and for any :math:`\theta` that is not wrapped: where a
    wrapped heading jumps from :math:`\pi` to :math:`-\pi` the turn rate jumps by
    :math:`2\pi k`. The lateral error needs :math:`v_V` or :math:`\omega_V` to persist.
    """

    k1: float = 1.0
    gamma: float = 8.0
    k: float = 1.25

    def __post_init__(self) -> None:
        check_gains("Samson", k1=self.k1, gamma=self.gamma, k=self.k)

    def command(self, error: Pose2, reference: Twist) -> Twist:
        """The twist that tracks a virtual target at ``error`` moving with ``reference``."""
        x, y, theta = error
        v, omega = reference
        return Twist(
            v * math.cos(theta) + self.k1 * x,
            omega + self.gamma * v * y * sinc(theta) + self.k * theta,
        )

    def lyapunov(self, error: Pose2) -> float:
        """V [m²]."""
        x, y, theta = error
        return 0.5 * (x * x + y * y) + 0.5 * theta * theta / self.gamma

    def decay(self, error: Pose2) -> float:
        """W = -dV/dt under the law [m²/s], whatever the reference; only semidefinite."""
        x, _, theta = error
        return self.k1 * x * x + self.k / self.gamma * theta * theta


def sinc(angle: float) -> float:
    """``sin(angle)/angle``, 1 at 0."""
    return math.sin(angle) / angle if angle else 1.0
