"""The model-predictive rivals: the program of this package's ``nmpc_program`` behind the driver."""

from __future__ import annotations

from benchmarks.baselines.driver import LawController
from benchmarks.baselines.law import Answer, View
from benchmarks.baselines.method import Method, Range, Setup
from benchmarks.baselines.nmpc_parameters import NmpcParameters
from benchmarks.baselines.nmpc_program import Nmpc
from clfcbf import defaults
from clfcbf.se2 import Twist

__all__ = ["MPC_CBF", "NMPC", "NMPC_STRONG", "NmpcLaw"]

_REST = Twist(0.0, 0.0)


class NmpcLaw:
    """Receding horizon: solve at every tick, send the first command.

    Where the solver fails, the rest of the last plan goes out, by its own clock, and rest after
    its end; the next solve starts cold.
    """

    def __init__(self, nmpc: Nmpc) -> None:
        self.nmpc = nmpc
        self.fallback: list[list[float]] = []
        self.planned = 0.0

    def command(self, view: View) -> Answer:
        """The command at a tick."""
        plan = self.nmpc.solve(view.pose, view.applied, view.box)
        if plan.solved:
            self.fallback, self.planned = plan.commands.tolist(), view.time
            v, omega = self.fallback[0]
            return Answer(Twist(v, omega))
        return Answer(self._from_last_plan(view.time - self.planned), solved=False)

    def _from_last_plan(self, age: float) -> Twist:
        for (v, omega), duration in zip(self.fallback, self.nmpc.durations, strict=False):
            age -= duration
            if age < 0.0:
                return Twist(v, omega)
        return _REST


def _build(setup: Setup, parameters: NmpcParameters) -> LawController:
    return LawController(setup, NmpcLaw(Nmpc(setup, parameters)))


_SPACE = {
    "q_y": Range(0.1, 100.0), "q_theta": Range(0.01, 10.0), "p": Range(0.1, 100.0),
    "r_v": Range(0.001, 1.0), "r_omega": Range(0.001, 1.0),
    "d_v": Range(0.001, 1.0), "d_omega": Range(0.001, 1.0), "slack": Range(1.0, 1e4),
}  # fmt: skip

NMPC = Method(
    name="nmpc",
    about="NMPC in the group's published settings",
    source="arXiv 2110.06648 (NMPC with discrete-time barriers for trolley collection) and arXiv "
    "2303.06624 by the same group: explicit Euler, 20 steps of 0.1 s, CasADi and IPOPT",
    departures=(
        "The weights are not published: these are assumptions in its favour. With the lateral "
        "error weighted as the longitudinal one (q_y = 1) it stops some 20 mm beside the goal.",
        "A heading term and running costs on the pose are added to the published terminal cost on "
        "the position: the goal here is a pose.",
        "A step may change the command by 0.1 s of acceleration; they print an increment per step. "
        "The chassis's box clips what goes out.",
        "Their obstacle barriers are left out; the view is a constraint at every step, softened by "
        "an L1 slack.",
    ),
    stock=NmpcParameters(),
    space=_SPACE,
    build=_build,
)

NMPC_STRONG = Method(
    name="nmpc-strong",
    about="NMPC with exact arcs, 8 s horizon, terminal cost",
    source="as nmpc, improved by us as a user who knows the robot would",
    departures=(
        "Exact arcs for Euler steps; 40 steps of 0.2 s, the whole approach, for 20 of 0.1 s; the "
        "cost-to-go of following the axis as terminal cost; acceleration limits as the chassis "
        "applies them, the first step being one control period.",
        "The weights are ours.",
    ),
    stock=NmpcParameters(
        steps=40,
        step=0.2,
        model="arc",
        first_is_tick=True,
        terminal="approach",
        view_margin=defaults.VIEW_MARGIN,
    ),
    space=_SPACE,
    build=_build,
)

MPC_CBF = Method(
    name="mpc-cbf",
    about="NMPC with discrete-time barrier constraints",
    source="Zeng, Zhang and Sreenath, Safety-critical model predictive control with discrete-time "
    "control barrier function, ACC 2021",
    departures=(
        "Their barrier is a distance to an obstacle, ours are the camera's edges, softened by an "
        "L1 slack as they stay feasible under noise.",
        "Unicycle by exact arcs for their double integrator; horizon, weights and gamma are ours.",
    ),
    stock=NmpcParameters(steps=20, step=0.2, model="arc", first_is_tick=True, gamma=0.3),
    space={**_SPACE, "gamma": Range(0.05, 1.0)},
    build=_build,
)
