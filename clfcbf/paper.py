r"""The tracking controller of the paper as it is printed, each choice a switch.

.. math::
    \min_{u,\delta}\ (u - u_r)^\top Q_u(u - u_r) + c_\delta\delta^2 \quad\text{s.t.}\quad
    u \in \mathcal U,\quad \dot h(u) + \lambda h \ge 0,\quad \dot V(u) + \mu V \le \delta

with :math:`u_r = 0`, :math:`V = \tfrac14(x^\top Hx)^2`, :math:`h = \tfrac12(\Phi^2 -
\varphi^2)` [Xie2024]_. The program is solved exactly, :math:`\delta` eliminated. This is the
reference that improvements are measured against, not the controller to drive with: it stalls
short of its target (``stall_radius``), lags behind a moving one (``steady_state_lag``), never
removes a lateral error from a target at rest, and its hard barrier row can be infeasible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from clfcbf.camera import FieldOfView
from clfcbf.constraints.bearing import bearing_rows, paper_row
from clfcbf.constraints.cbf import edge_rows
from clfcbf.constraints.checks import check_positive
from clfcbf.constraints.clf import quadratic_clf, quartic_clf
from clfcbf.constraints.rows import Row, Rows
from clfcbf.constraints.weights import check_weights
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits, check_period
from clfcbf.qp.exact import paper_program
from clfcbf.se2 import Point, Pose2, Twist

__all__ = [
    "PaperBarrier",
    "PaperClf",
    "PaperConfig",
    "PaperDecision",
    "StallReport",
    "paper_command",
    "settling_time",
    "stall_radius",
    "stall_report",
    "steady_state_lag",
]

PaperClf = Literal["quartic", "quadratic"]
PaperBarrier = Literal["paper", "bearing", "half_plane"]

ERROR_WEIGHTS = (1.0, 1.0, 1.0)
"""Diagonal of H; not printed. With equal h1 and h2 the turn rate sees the heading alone."""

INPUT_WEIGHTS = (1.0, 1.0)
"""Diagonal of Q_u; not printed, 1 m/s counts as 1 rad/s."""

SLACK_WEIGHT = 1e4
"""c_delta; not printed. Stalls about 0.2 m out, and much larger hardens the Lyapunov row."""

CLF_DECAY = 1.0
"""mu [1/s]; not printed. The quartic then closes an error with a time constant of 4 s at best."""

BARRIER_GAIN = 1.0
"""lambda [1/s]; not printed. Below what 1 rad/s² can follow at 0.6 m, 1.27 1/s."""

HALF_ANGLE = math.radians(35.0)
"""Phi [rad]; half of the printed camera's 70°."""

_BRAKE = Twist(0.0, 0.0)
_NO_ROW: Row = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PaperConfig:
    r"""The paper's parameters, by its symbols, and a switch for each of its choices.

    Attributes
    ----------
    H : diagonal (h1, h2, h3) of the error weight
    Q_u : diagonal of the input weight
    c_delta : weight of the squared slack; ``math.inf`` makes the Lyapunov row hard
    mu, lam : decay of the Lyapunov row and gain of the barrier row [1/s]
    half_angle : :math:`\Phi` [rad], half of the field of view
    per_step_acceleration : True as printed, :math:`|v - v_0| \le a_{max}`, the acceleration
        limits taken as increments of one step; False bounds by :math:`a_{max}T`
    feedforward : False as printed; True has :math:`u_r = (v_V\cos\theta, \omega_V)` in the cost
    clf : "quartic" as printed, or "quadratic", :math:`V = \tfrac12 x^\top Hx`
    barrier : "paper" as printed, "bearing" for :math:`\Phi \mp \varphi`, or "half_plane"

    The paper prints neither weights nor gains: those defaults are assumptions.

    Raises
    ------
    ConfigurationError : a weight, gain or angle is out of range, or a choice unknown
    """

    H: tuple[float, float, float] = ERROR_WEIGHTS
    Q_u: tuple[float, float] = INPUT_WEIGHTS
    c_delta: float = SLACK_WEIGHT
    mu: float = CLF_DECAY
    lam: float = BARRIER_GAIN
    half_angle: float = HALF_ANGLE
    per_step_acceleration: bool = True
    feedforward: bool = False
    clf: PaperClf = "quartic"
    barrier: PaperBarrier = "paper"

    def __post_init__(self) -> None:
        check_weights(self.H)
        if isinstance(self.H[0], tuple):
            raise ConfigurationError(f"H must be a diagonal of three numbers, got {self.H!r}")
        check_positive("Q_u[0]", self.Q_u[0])
        check_positive("Q_u[1]", self.Q_u[1])
        if not self.c_delta > 0.0:
            raise ConfigurationError(
                f"c_delta must be positive, or inf for a hard row, got {self.c_delta!r}"
            )
        check_positive("mu", self.mu)
        check_positive("lam", self.lam)
        FieldOfView(self.half_angle)
        _check_choice("clf", self.clf, get_args(PaperClf))
        _check_choice("barrier", self.barrier, get_args(PaperBarrier))

    @property
    def degree(self) -> int:
        """Degree of V in the error: 4 or 2."""
        return 4 if self.clf == "quartic" else 2


class PaperDecision(NamedTuple):
    r"""What the paper's program answers.

    Attributes
    ----------
    twist : the command; where the program is infeasible, which the paper leaves open, the
        hardest brake inside the input box
    delta : :math:`\max(0, \dot V + \mu V)` at that command, the slack
    V, h : Lyapunov and barrier function at the state; h is the smaller of two rows
    feasible : whether the hard rows could be met
    """

    twist: Twist
    delta: float
    V: float
    h: float
    feasible: bool


def paper_command(
    config: PaperConfig,
    error: Pose2,
    reference: Twist,
    target_point: Point,
    applied: Twist,
    limits: Limits,
    period: float,
) -> PaperDecision:
    """Solve the paper's program at one state, exactly.

    Parameters
    ----------
    config : weights, gains and switches
    error : virtual target V seen from the robot [m, m, rad]
    reference : its own twist [m/s, rad/s]; at rest after the end of the trajectory
    target_point : the target seen from the robot's centre, which is also the camera's [m]
    applied : command of the step before
    limits, period : input set, see ``PaperConfig.per_step_acceleration``

    Raises
    ------
    GeometryError : error, reference or target point is not finite, or the point is at the
        robot's centre, where its bearing is undefined
    ConfigurationError : the period is not positive

    References
    ----------
    [Xie2024]_
    """
    check_period(period)
    build = quartic_clf if config.clf == "quartic" else quadratic_clf
    clf = build(error, reference, config.H, config.mu)
    cbf = _barrier_rows(config, target_point)
    # A "period" of 1 s turns a limit per second into the same number per step.
    box = limits.input_box(applied, 1.0 if config.per_step_acceleration else period)
    wanted = _BRAKE
    if config.feedforward:
        wanted = Twist(reference[0] * math.cos(error[2]), reference[1])
    hard, soft, weight = cbf.coefficients, clf.coefficients[0], config.c_delta
    if math.isinf(weight):
        hard, soft, weight = (*hard, soft), _NO_ROW, 1.0
    answer = paper_program((config.Q_u[0], 0.0, config.Q_u[1]), wanted, box, hard, soft, weight)
    twist = Twist(answer.v, answer.omega) if answer.feasible else box.clip(_BRAKE)
    a_v, a_w, b = clf.coefficients[0]
    delta = max(0.0, a_v * twist.v + a_w * twist.omega - b)
    return PaperDecision(twist, delta, clf.values[0], min(cbf.values), answer.feasible)


def stall_radius(config: PaperConfig) -> float:
    r"""Longitudinal error below which the soft Lyapunov row loses its grip [m].

    The unconstrained answer is :math:`u^\star = -c\,aQ^{-1}b^\top/(1 + c\,bQ^{-1}b^\top)` with
    :math:`a = L_fV + \mu V`, :math:`b = L_gV`. At a pure longitudinal error :math:`e` and a
    reference at rest, with :math:`n` the degree of V,

    .. math::
        v = \frac{\mu e}{n}\,\frac{(e/e^\star)^{2n-2}}{1 + (e/e^\star)^{2n-2}},\qquad
        e^\star = \left(\frac{q_1}{c_\delta h_1^n}\right)^{1/(2n-2)}

    so below :math:`e^\star` the speed of the quartic falls with :math:`e^7`, of the quadratic
    with :math:`e^3`. 0 for a hard row.
    """
    n = config.degree
    return float((config.Q_u[0] / (config.c_delta * config.H[0] ** n)) ** (1.0 / (2 * n - 2)))


def settling_time(config: PaperConfig, start: float, tolerance: float) -> float:
    r"""Time from one longitudinal error to a smaller one, the reference at rest [s].

    Integrates the closed loop of ``stall_radius``, inputs not limited:

    .. math::
        t = \frac{n}{\mu}\left[\ln\frac{e_0}{e} + \frac{1}{p}
            \left(\left(\frac{e^\star}{e}\right)^p - \left(\frac{e^\star}{e_0}\right)^p
            \right)\right],\qquad p = 2n - 2

    Raises
    ------
    ConfigurationError : not 0 < tolerance <= start
    """
    check_positive("start", start)
    if not 0.0 < tolerance <= start:
        raise ConfigurationError(
            f"tolerance must be in (0, start] = (0, {start!r}] m, got {tolerance!r}"
        )
    n, radius = config.degree, stall_radius(config)
    p = 2 * n - 2
    tail = ((radius / tolerance) ** p - (radius / start) ** p) / p
    return float(n / config.mu * (math.log(start / tolerance) + tail))


def steady_state_lag(config: PaperConfig, v_V: float) -> float:
    r"""Distance behind a reference that drives straight at constant speed [m].

    At zero error the Lyapunov row is inactive and :math:`u^\top Q_uu` asks for rest, so the
    target runs away until the row pulls as hard:

    .. math:: x_{ss} = \left(\frac{n\,q_1v_V}{c_\delta\,\mu\,h_1^n}\right)^{1/(2n-1)}

    positive for a target ahead, negative behind one that reverses, 0 with feedforward and for
    a hard row.
    """
    if config.feedforward:
        return 0.0
    n = config.degree
    pull = n * config.Q_u[0] * abs(v_V) / (config.c_delta * config.mu * config.H[0] ** n)
    return math.copysign(pull ** (1.0 / (2 * n - 1)), v_V)


class StallReport(NamedTuple):
    """Whether a tolerance can be expected of a configuration.

    Attributes
    ----------
    tolerance, radius : wanted longitudinal error and ``stall_radius`` [m]
    stalls : whether the tolerance is below the radius
    time : ``settling_time`` from ``start`` to the tolerance [s]
    c_delta : slack weight whose stall radius is the tolerance
    """

    tolerance: float
    radius: float
    stalls: bool
    time: float
    c_delta: float

    def __str__(self) -> str:
        verdict = (
            f"is below the stall radius {self.radius:.3g} m: expect {self.time:.3g} s, "
            f"or raise c_delta to {self.c_delta:.3g}"
            if self.stalls
            else f"is above the stall radius {self.radius:.3g} m: expect {self.time:.3g} s"
        )
        return f"tolerance {self.tolerance:.3g} m {verdict}"


def stall_report(config: PaperConfig, tolerance: float, start: float = 1.0) -> StallReport:
    """Compare a tolerance with the stall radius; a value to read or print, no warning.

    Parameters
    ----------
    tolerance : longitudinal error to be reached [m], in (0, start]
    start : error it is to be reached from [m], for the time alone

    Raises
    ------
    ConfigurationError : not 0 < tolerance <= start
    """
    time = settling_time(config, start, tolerance)
    radius, n = stall_radius(config), config.degree
    needed = config.Q_u[0] / (config.H[0] ** n * tolerance ** (2 * n - 2))
    return StallReport(tolerance, radius, tolerance < radius, time, needed)


def _barrier_rows(config: PaperConfig, point: Point) -> Rows:
    if config.barrier == "paper":
        return paper_row(point, config.half_angle, config.lam)
    build = bearing_rows if config.barrier == "bearing" else edge_rows
    return build(point, FieldOfView(config.half_angle), config.lam)


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ConfigurationError(f"{name} must be one of {', '.join(choices)}; got {value!r}")
