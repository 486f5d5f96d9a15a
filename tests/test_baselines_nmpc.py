"""The model-predictive rivals solve the program they state, and dock."""

import importlib.util
import itertools
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from benchmarks.baselines import Setup, method_named
from benchmarks.baselines.law import Answer, View
from benchmarks.baselines.nmpc import MPC_CBF, NMPC, NMPC_STRONG, NmpcLaw
from benchmarks.baselines.nmpc_parameters import NmpcParameters, approach_cost
from benchmarks.baselines.nmpc_program import Nmpc, NmpcPlan
from clfcbf import Limits, Pose2, Twist
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World, facing
from clfcbf.simulation.sensor import PoseSensor, SensorModel

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
WORLD = World()
SETUP = Setup.of(WORLD, LIMITS)
REST = Twist(0.0, 0.0)
METHODS = (NMPC, NMPC_STRONG, MPC_CBF)

needs_casadi = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None, reason="CasADi is not installed"
)


def edges(x, y, theta, margin):
    """Distances of the feature from the two edges of the camera [m], written out by angles."""
    dx, dy = WORLD.standoff - x, -y
    ahead = np.cos(theta) * dx + np.sin(theta) * dy - WORLD.camera.camera.x
    aside = np.cos(theta) * dy - np.sin(theta) * dx
    rho, bearing = np.hypot(ahead, aside), np.arctan2(aside, ahead)
    half = WORLD.camera.half_angle - margin
    return rho * np.sin(half - bearing), rho * np.sin(half + bearing)


def rolled_out_cost(p, durations, start, applied, commands):
    """Cost of command sequences (N, 2, ...), the slack taken as small as it may be."""
    x, y, theta = (np.full(commands.shape[2:], value) for value in start)
    last = np.array(applied).reshape(2, *[1] * (commands.ndim - 2))
    cost = np.zeros(commands.shape[2:])
    before = edges(x, y, theta, p.view_margin)
    for k, (u, duration) in enumerate(zip(commands, durations, strict=True)):
        v, w = u
        turn = w * duration
        if p.model == "euler":
            x, y = x + v * duration * np.cos(theta), y + v * duration * np.sin(theta)
        else:  # the circle about its centre
            r = v / np.where(w == 0.0, 1.0, w)
            bend = r * (np.sin(theta + turn) - np.sin(theta))
            rise = r * (np.cos(theta) - np.cos(theta + turn))
            x = x + np.where(w == 0.0, v * duration * np.cos(theta), bend)
            y = y + np.where(w == 0.0, v * duration * np.sin(theta), rise)
        theta = theta + turn
        now = edges(x, y, theta, p.view_margin)
        lacking = [(1.0 - p.gamma) * b - a for a, b in zip(now, before, strict=True)]
        cost += p.slack * np.maximum(0.0, np.maximum(*lacking))
        cost += duration * (p.r_v * v**2 + p.r_omega * w**2)
        cost += p.d_v * (v - last[0]) ** 2 + p.d_omega * (w - last[1]) ** 2
        square = p.q_x * x**2 + p.q_y * y**2 + p.q_theta * theta**2
        if k < len(durations) - 1:
            cost += duration * square
        elif p.terminal == "scaled":
            cost += p.p * square
        else:
            top = LIMITS.v_max
            a, b, c = approach_cost(p.q_y / top, p.q_theta / top, p.r_omega * top)
            cost += p.p * (p.q_x * x**2 + a * y**2 + 2.0 * b * y * theta + c * theta**2)
        last, before = u, now
    return cost


def rounding(p):
    """IPOPT relaxes every bound by 1e-8, which the slacks price; its own tolerance is 1e-6."""
    return 1e-6 + 2e-8 * p.slack * p.steps


STARTS = [
    (Pose2(-1.5, 0.3, -0.1), Twist(0.1, 0.05)),
    (Pose2(-0.15, 0.0, 0.3), Twist(0.15, -0.3)),  # the goal is nearer than full speed leads
    (facing(-1.2, 0.5, 0.97 * WORLD.camera.half_angle, WORLD), Twist(0.2, 0.2)),
]


@needs_casadi
@pytest.mark.parametrize(("start", "applied"), STARTS)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_one_step_is_the_cheapest_of_a_dense_grid(method, start, applied):
    p = replace(method.stock, steps=1, step=1.0)
    nmpc = Nmpc(SETUP, p)
    box = LIMITS.input_box(applied, WORLD.period)
    plan = nmpc.solve(start, applied, box)
    assert plan.solved, plan.message
    if not p.first_is_tick:
        box = LIMITS.input_box(applied, p.step)
    v, w = np.meshgrid(
        np.linspace(box.v_lo, box.v_hi, 601), np.linspace(box.w_lo, box.w_hi, 601), indexing="ij"
    )
    costs = rolled_out_cost(p, nmpc.durations, start, applied, np.stack((v, w))[None])
    best = np.unravel_index(np.argmin(costs), costs.shape)
    own = rolled_out_cost(p, nmpc.durations, start, applied, plan.commands[:, :, None])
    assert box.contains(Twist(*plan.commands[0]), 1e-6)
    assert own == pytest.approx(plan.cost, rel=1e-6, abs=rounding(p))
    assert float(own[0]) <= costs[best] + rounding(p)
    assert abs(plan.commands[0, 0] - v[best]) < 2.0 * (v[1, 0] - v[0, 0])
    assert abs(plan.commands[0, 1] - w[best]) < 2.0 * (w[0, 1] - w[0, 0])


@needs_casadi
@pytest.mark.parametrize(("start", "applied"), STARTS)
def test_two_steps_are_the_cheapest_of_a_grid(start, applied):
    p = replace(NMPC.stock, steps=2, step=0.5, d_v=0.0, d_omega=0.0)
    nmpc = Nmpc(SETUP, p)
    plan = nmpc.solve(start, applied, LIMITS.input_box(applied, p.step))
    assert plan.solved, plan.message
    box = LIMITS.input_box(applied, p.step)
    side = 25
    axes = [np.linspace(box.v_lo, box.v_hi, side), np.linspace(box.w_lo, box.w_hi, side)]
    axes += [np.linspace(-LIMITS.v_max, LIMITS.v_max, side)]
    axes += [np.linspace(-LIMITS.omega_max, LIMITS.omega_max, side)]
    v1, w1, v2, w2 = np.meshgrid(*axes, indexing="ij")
    commands = np.stack((np.stack((v1, w1)), np.stack((v2, w2))))
    costs = rolled_out_cost(p, nmpc.durations, start, applied, commands)
    reachable = (abs(v2 - v1) <= LIMITS.a_max * p.step) & (
        abs(w2 - w1) <= LIMITS.alpha_max * p.step
    )
    cheapest = np.where(reachable, costs, np.inf).min()
    own = float(rolled_out_cost(p, nmpc.durations, start, applied, plan.commands[:, :, None])[0])
    assert own == pytest.approx(plan.cost, rel=1e-6, abs=rounding(p))
    assert own <= cheapest + rounding(p)
    first, second = (Twist(*u) for u in plan.commands)
    assert box.contains(first, 1e-6)
    assert LIMITS.input_box(first, p.step).contains(second, 1e-6)


@needs_casadi
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_plan_keeps_model_limits_and_barrier(method):
    p, start, applied = method.stock, facing(-1.4, 0.6, 0.8 * 0.61, WORLD), Twist(0.1, 0.0)
    nmpc = Nmpc(SETUP, p)
    box = LIMITS.input_box(applied, WORLD.period)
    plan = nmpc.solve(start, applied, box)
    assert plan.solved
    assert plan.states == pytest.approx(nmpc.rolled_out(start, plan.commands), abs=1e-6)
    first = box if p.first_is_tick else LIMITS.input_box(applied, p.step)
    assert first.contains(Twist(*plan.commands[0]), 1e-6)
    for before, after in itertools.pairwise(plan.commands.tolist()):
        assert LIMITS.input_box(Twist(*before), p.step).contains(Twist(*after), 1e-6)
    assert nmpc.durations[0] == (WORLD.period if p.first_is_tick else p.step)
    h = np.array([edges(*state, p.view_margin) for state in plan.states])
    assert np.all(h[1:] >= (1.0 - p.gamma) * h[:-1] - 1e-5)


@needs_casadi
@given(
    st.builds(Pose2, st.floats(-2, 0), st.floats(-1, 1), st.floats(-1, 1)),
    st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-1, 1)), min_size=4, max_size=4),
)
def test_roll_out_by_arcs_is_the_exact_motion(start, commands):
    nmpc = _ARCS[0] if _ARCS else Nmpc(SETUP, NmpcParameters(4, 0.2, "arc", True))
    _ARCS[:] = [nmpc]
    states = nmpc.rolled_out(start, np.array(commands))
    pose = start
    for command, duration, state in zip(commands, nmpc.durations, states[1:], strict=True):
        pose = pose.moved(Twist(*command), duration)
        assert state == pytest.approx(pose, abs=1e-12)


_ARCS: list[Nmpc] = []


@settings(max_examples=30)
@given(st.floats(0.1, 100.0), st.floats(0.01, 10.0), st.floats(1e-3, 1.0))
def test_approach_cost_solves_the_riccati_equation(q_y, q_theta, r):
    yy, cross, tt = approach_cost(q_y, q_theta, r)
    expected = solve_continuous_are(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.diag([q_y, q_theta]), r
    )
    assert np.array([[yy, cross], [cross, tt]]) == pytest.approx(expected, rel=1e-7)


@needs_casadi
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_docks_from_an_easy_start(method):
    start = Pose2(-1.0, 0.05, 0.0)
    plant = KinematicPlant(start, LIMITS, Body.ideal(), np.random.default_rng(0))
    sensor = PoseSensor(
        plant, WORLD.camera, WORLD.standoff, SensorModel.named("ideal"), np.random.default_rng(1)
    )
    result, trace = run_episode(plant, sensor, method.controller(SETUP), WORLD, LIMITS)
    assert result.success, (result.outcome, trace.decisions[-1].reason)
    assert trace.decisions[-1].done
    assert (result.limit_violations, result.infeasible_ticks) == (0, 0)
    assert not result.fov_lost


@needs_casadi
def test_warm_start_finds_the_same_answer_as_a_cold_one():
    start, applied = Pose2(-1.4, 0.4, -0.2), Twist(0.1, 0.1)
    box = LIMITS.input_box(applied, WORLD.period)
    nmpc = Nmpc(SETUP, NMPC.stock)
    nmpc.solve(Pose2(-1.42, 0.4, -0.2), applied, box)
    warm = nmpc.solve(start, applied, box)
    cold = Nmpc(SETUP, NMPC.stock).solve(start, applied, box)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
    assert warm.commands == pytest.approx(cold.commands, abs=2e-3)


class Unsolved:
    """A program whose solver stops after ``good`` answers."""

    durations = (0.1, 0.1, 0.1)

    def __init__(self, good):
        self.good = good

    def solve(self, start, applied, box):
        self.good -= 1
        commands = np.array([[0.1, 0.0], [0.2, 0.1], [0.05, 0.0]])
        return NmpcPlan(commands, np.zeros((4, 3)), 0.0, self.good >= 0, "stopped")


def view_at(time):
    return View(
        Pose2(-1, 0, 0), Pose2(1, 0, 0), (1.6, 0.0), Pose2(-1, 0, 0), REST,
        LIMITS.input_box(REST, 1 / 30), 0.0, time,
    )  # fmt: skip


def test_a_failed_solve_sends_the_rest_of_the_last_plan_and_then_rest():
    law = NmpcLaw(Unsolved(1))
    assert law.command(view_at(5.0)) == Answer(Twist(0.1, 0.0))
    expected = {5.05: (0.1, 0.0), 5.15: (0.2, 0.1), 5.25: (0.05, 0.0), 5.35: (0.0, 0.0)}
    for now, command in expected.items():
        answer = law.command(view_at(now))
        assert answer.twist == command
        assert not answer.solved
    assert NmpcLaw(Unsolved(0)).command(view_at(1.0)).twist == REST


def test_without_casadi_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[solvers\]"):
        method_named("nmpc").controller(SETUP)


@pytest.mark.parametrize(
    "values",
    [
        {"steps": 0}, {"steps": 2.5}, {"step": 0.0}, {"model": "rk4"}, {"gamma": 0.0},
        {"gamma": 1.1}, {"q_y": -1.0}, {"d_v": math.nan}, {"terminal": "none"},
        {"view_margin": -0.1},
    ],
)  # fmt: skip
def test_bad_parameters_are_refused(values):
    with pytest.raises(ConfigurationError, match=next(iter(values))):
        NmpcParameters(**values)


@needs_casadi
def test_a_step_longer_than_the_series_is_good_for_is_refused():
    with pytest.raises(ConfigurationError, match="step"):
        Nmpc(SETUP, NmpcParameters(step=4.0))
