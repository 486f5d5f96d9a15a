"""Horizon, weights and terminal cost of the model-predictive rivals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from clfcbf.constraints.checks import check_positive
from clfcbf.errors import ConfigurationError

__all__ = ["Model", "NmpcParameters", "Terminal", "approach_cost"]

Model = Literal["euler", "arc"]
Terminal = Literal["scaled", "approach"]


@dataclass(frozen=True, slots=True)
class NmpcParameters:
    r"""Horizon and weights.

    Attributes
    ----------
    steps, step : of the horizon, and the length of one [s]; 20 of 0.1 s, as published
    model : "euler" for the explicit Euler rule, as published, "arc" for the exact motion of a
        held twist
    first_is_tick : the first step lasts one control period and its command lies in the chassis's
        own input box; else it lasts as long as the others and may change by as much
    q_x, q_y, q_theta : Q [1/m², 1/m², 1/rad²], charged per second of the horizon; a lateral
        error weighs ten times a longitudinal one, which is as easily removed as it is cheap
    p : factor of P, the terminal weight; 10 stands for the 10 s that an approach takes
    terminal : P is "scaled", p times Q, or "approach", p times the cost of ``approach_cost``
    r_v, r_omega : R [s²/m², s²/rad²], per second; full speed costs what 2 cm beside the axis do
    d_v, d_omega : D, per step; as R, which keeps the commands smooth at the noise of the sensor
    slack : w [1/m] of an edge of the view given up by so much, L1; above every multiplier met
    view_margin : from the camera's edges to those of the program [rad]
    gamma : 1 asks for the view at each step, below 1 is the discrete-time barrier condition
    """

    steps: int = 20
    step: float = 0.1
    model: Model = "euler"
    first_is_tick: bool = False
    q_x: float = 1.0
    q_y: float = 10.0
    q_theta: float = 0.1
    p: float = 10.0
    terminal: Terminal = "scaled"
    r_v: float = 0.1
    r_omega: float = 0.02
    d_v: float = 0.1
    d_omega: float = 0.02
    slack: float = 100.0
    view_margin: float = 0.0
    gamma: float = 1.0

    def __post_init__(self) -> None:
        if not (isinstance(self.steps, int) and self.steps >= 1):
            raise ConfigurationError(f"steps must be an integer >= 1, got {self.steps!r}")
        for name in ("step", "q_x", "q_y", "q_theta", "p", "r_v", "r_omega", "slack"):
            check_positive(name, getattr(self, name))
        for name in ("d_v", "d_omega", "view_margin"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigurationError(f"{name} must be finite and at least 0, got {value!r}")
        if not 0.0 < self.gamma <= 1.0:
            raise ConfigurationError(f"gamma must be in (0, 1], got {self.gamma!r}")
        for name, kind in (("model", Model), ("terminal", Terminal)):
            value, choices = getattr(self, name), get_args(kind)
            if value not in choices:
                raise ConfigurationError(
                    f"{name} must be one of {', '.join(choices)}; got {value!r}"
                )


def approach_cost(q_y: float, q_theta: float, r: float) -> tuple[float, float, float]:
    r"""Coefficients :math:`p_{yy}, p_{y\theta}, p_{\theta\theta}` of the cost-to-go along an axis.

    That of the linear problem :math:`y' = \theta,\ \theta' = \kappa` per metre, with the running
    cost :math:`q_yy^2 + q_\theta\theta^2 + r\kappa^2`, is
    :math:`p_{yy}y^2 + 2p_{y\theta}y\theta + p_{\theta\theta}\theta^2`. From its Riccati equation

    .. math::
        p_{y\theta} = \sqrt{q_yr},\quad p_{\theta\theta} = \sqrt{r(q_\theta + 2p_{y\theta})},\quad
        p_{yy} = p_{y\theta}\,p_{\theta\theta}/r
    """
    cross = math.sqrt(q_y * r)
    theta = math.sqrt(r * (q_theta + 2.0 * cross))
    return cross * theta / r, cross, theta
