r"""Rows that make a Lyapunov function of the tracking error decrease.

The error :math:`(x, y, \theta)` is the virtual target seen from the robot, and obeys

.. math::
    \dot x = \omega y - v + v_V\cos\theta,\quad
    \dot y = -\omega x + v_V\sin\theta,\quad
    \dot\theta = \omega_V - \omega

[Xie2024]_, first used by [Kanayama1990]_. Each builder gives one half-plane of commands,
:math:`L_gV\,u \le -r - L_fV`, that is :math:`\dot V \le -r`; they differ in :math:`V` and in
the rate :math:`r` asked for.
"""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias

from clfcbf.constraints.checks import check_finite, check_positive
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.constraints.weights import Weights, check_weights, weigh
from clfcbf.errors import ConfigurationError
from clfcbf.se2 import Pose2, Twist

__all__ = [
    "STRICT_CROSS_TERM",
    "STRICT_DECAY",
    "TrackingGains",
    "kanayama_clf",
    "quadratic_clf",
    "quartic_clf",
    "strict_clf",
    "witnessed_clf",
]

_KANAYAMA, _STABILITY = ("clf.kanayama",), Priority.STABILITY

STRICT_CROSS_TERM = 0.3
"""Cross term [1/m] of the strict function: certified with gains 1, 8, 6, see ``strict_clf``."""

STRICT_DECAY = 0.1
"""Decay [1/s] of the strict function: certified with gains 1, 8, 6, see ``strict_clf``."""

Vector: TypeAlias = tuple[float, float, float]


class TrackingGains(Protocol):
    """Gains of the Kanayama law: ``k1`` [1/s], ``k2`` [1/m²], ``k3`` [1/m]."""

    @property
    def k1(self) -> float:
        """Gain of the longitudinal error [1/s]."""

    @property
    def k2(self) -> float:
        """Gain of the lateral error [1/m²]."""

    @property
    def k3(self) -> float:
        """Gain of the heading error [1/m]."""


def quartic_clf(error: Pose2, reference: Twist, weights: Weights, decay: float) -> Rows:
    r"""Row :math:`\dot V \le -\mu V` of the paper's :math:`V = \tfrac14(x^\top H x)^2`.

    Not a control Lyapunov function: on :math:`\{x = \theta = 0,\ y \ne 0\}` the row reads
    :math:`0 \le -\tfrac14\mu(h_2y^2)^2` for diagonal :math:`H`, which no command meets. It
    needs a slack there, and a lateral error is left standing. ``kanayama_clf`` has no such set.

    Parameters
    ----------
    error : virtual target seen from the robot [m, m, rad], theta in (-pi, pi]
    reference : its own twist :math:`(v_V, \omega_V)` [m/s, rad/s]
    weights : :math:`H`, its diagonal (h1, h2, h3) or the symmetric 3 x 3 matrix by rows
    decay : :math:`\mu` [1/s]

    Returns
    -------
    One row named "clf.quartic", priority STABILITY, values (V,)

    Raises
    ------
    GeometryError : error or reference is not finite
    ConfigurationError : H is not symmetric positive definite, or decay not positive

    References
    ----------
    [Xie2024]_
    """
    check_positive("decay", decay)
    check_finite("error and reference", error, reference)
    gx, gy, gt, square = weigh(check_weights(weights), error)
    value = 0.25 * square * square
    gradient = (square * gx, square * gy, square * gt)
    return _rows("clf.quartic", value, gradient, error, reference, decay * value)


def quadratic_clf(error: Pose2, reference: Twist, weights: Weights, decay: float) -> Rows:
    r"""Row :math:`\dot V \le -\mu V` of :math:`V = \tfrac12 x^\top H x`.

    The paper's function without its outer square, so that its row does not fade with the third
    power of the error. Fails as a control Lyapunov function on the same set.

    Parameters, raises and shape of the result: as ``quartic_clf``, row "clf.quadratic".
    """
    check_positive("decay", decay)
    check_finite("error and reference", error, reference)
    gx, gy, gt, square = weigh(check_weights(weights), error)
    value = 0.5 * square
    return _rows("clf.quadratic", value, (gx, gy, gt), error, reference, decay * value)


def kanayama_clf(error: Pose2, reference: Twist, gains: TrackingGains, fraction: float) -> Rows:
    r"""Row :math:`\dot V \le -\sigma W` that the Kanayama law itself satisfies.

    .. math::
        V = \tfrac12(x^2 + y^2) + \frac{1 - \cos\theta}{k_2},\qquad
        W = k_1x^2 + \frac{k_3}{k_2}\,|v_V|\sin^2\theta

    The law :math:`v = v_V\cos\theta + k_1x`, :math:`\omega = \omega_V + k_2v_Vy +
    k_3|v_V|\sin\theta` gives :math:`\dot V = -W`, so for every fraction up to 1 the row is
    feasible without a slack where the inputs are not limited. The speed's modulus makes that
    hold in reverse too. W is only semidefinite (it does not see y): the decrease asked for
    can be 0 away from the target, and the law in the cost is what removes y.

    Parameters
    ----------
    error : virtual target seen from the robot [m, m, rad]
    reference : its own twist :math:`(v_V, \omega_V)` [m/s, rad/s]; either sign of :math:`v_V`
    gains : the law's :math:`k_1, k_2, k_3`
    fraction : :math:`\sigma` in (0, 1], the part of the law's decrease that is asked for

    Returns
    -------
    One row named "clf.kanayama", priority STABILITY, values (V,)

    Raises
    ------
    GeometryError : error or reference is not finite
    ConfigurationError : a gain is not positive, or fraction not in (0, 1]

    References
    ----------
    [Kanayama1990]_
    """
    if not 0.0 < fraction <= 1.0:
        raise ConfigurationError(f"fraction must be in (0, 1], got {fraction!r}")
    check_finite("error and reference", error, reference)
    _check_gains(gains)
    return witnessed_clf(error, reference, gains, fraction)


def witnessed_clf(
    error: Pose2,
    reference: Twist,
    gains: TrackingGains,
    fraction: float,
    witness: Twist | None = None,
) -> Rows:
    """:func:`kanayama_clf` on checked arguments, no tighter than what ``witness`` meets.

    With the law's command as far as the tick's limits let it as the witness, limits alone never
    force a slack.
    """
    k1, k2, k3 = gains.k1, gains.k2, gains.k3
    x, y, theta = error
    v, omega = reference
    sine, half = math.sin(theta), math.sin(0.5 * theta)
    value = 0.5 * (x * x + y * y) + 2.0 * half * half / k2
    decrease = k1 * x * x + k3 / k2 * abs(v) * sine * sine
    g_theta = sine / k2
    drift = v * (x * math.cos(theta) + y * sine) + g_theta * omega
    b = -fraction * decrease - drift
    # The coefficient of omega is x y - y x - g_theta: turning does not change the distance.
    if witness is not None:
        met = -x * witness[0] - g_theta * witness[1]
        b = met if met > b else b
    block = _KANAYAMA, ((-x, -g_theta, b),), _STABILITY, (value,)
    return tuple.__new__(Rows, block)


def strict_clf(
    error: Pose2,
    reference: Twist,
    gains: TrackingGains,
    cross_term: float = STRICT_CROSS_TERM,
    decay: float = STRICT_DECAY,
) -> Rows:
    r"""Row :math:`\dot V_s \le -\mu V_s` of a strict, local Lyapunov function.

    .. math::
        V_s = \tfrac12(x^2 + y^2) + \frac{1 - \cos\theta}{k_2}
              + \varepsilon\,\mathrm{sgn}(v_V)\,y\sin\theta

    The cross term lets the decrease see the lateral error. With gains (1, 8, 6),
    :math:`\varepsilon = 0.3` and :math:`\mu = 0.1` the Kanayama law satisfies the row for
    :math:`|x|, |y| \le 0.5` m, :math:`|\theta| \le 1` rad, :math:`0.05 \le |v_V| \le 0.22` m/s
    and :math:`|\omega_V| \le 0.3` rad/s, inputs not limited. Outside that box, and for a
    reference at rest, the row may be infeasible. Reverse is the mirror image of forward under
    :math:`(x, y, v, v_V) \to -(x, y, v, v_V)`; :math:`v_V = 0` counts as forward.

    Parameters
    ----------
    error, reference, gains : as ``kanayama_clf``
    cross_term : :math:`\varepsilon` [1/m], in [0, 1/sqrt(k2)), where :math:`V_s` is definite
    decay : :math:`\mu` [1/s]

    Returns
    -------
    One row named "clf.strict", priority STABILITY, values (V,)

    Raises
    ------
    GeometryError : error or reference is not finite
    ConfigurationError : a gain or the decay is not positive, or the cross term out of range
    """
    check_positive("decay", decay)
    check_finite("error and reference", error, reference)
    _, k2, _ = _check_gains(gains)
    if not 0.0 <= cross_term < 1.0 / math.sqrt(k2):
        raise ConfigurationError(
            f"cross_term must be in [0, 1/sqrt(k2)) = [0, {1.0 / math.sqrt(k2):.6g}) for a "
            f"positive definite function, got {cross_term!r}"
        )
    x, y, theta = error
    sine, half = math.sin(theta), math.sin(0.5 * theta)
    cross = math.copysign(cross_term, reference[0])
    value = 0.5 * (x * x + y * y) + 2.0 * half * half / k2 + cross * y * sine
    gradient = (x, y + cross * sine, sine / k2 + cross * y * math.cos(theta))
    return _rows("clf.strict", value, gradient, error, reference, decay * value)


def _check_gains(gains: TrackingGains) -> Vector:
    k1, k2, k3 = gains.k1, gains.k2, gains.k3
    if not (0.0 < k1 < math.inf and 0.0 < k2 < math.inf and 0.0 < k3 < math.inf):
        raise ConfigurationError(f"gains k1, k2, k3 must be finite and positive, got {gains!r}")
    return k1, k2, k3


def _rows(
    name: str, value: float, gradient: Vector, error: Pose2, reference: Twist, rate: float
) -> Rows:
    r"""The row :math:`\nabla V^\top(f + gu) \le -r`, with f and g of the module's equation."""
    x, y, theta = error
    gx, gy, gt = gradient
    v, omega = reference
    drift = v * (gx * math.cos(theta) + gy * math.sin(theta)) + gt * omega
    row = (-gx, gx * y - gy * x - gt, -rate - drift)
    return Rows((name,), (row,), Priority.STABILITY, (value,))
