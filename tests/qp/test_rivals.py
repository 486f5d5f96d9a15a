"""Ten ways in which other filters and docking stacks failed, each held against this one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Scene, Status, Twist
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.laws.kanayama import Kanayama
from clfcbf.laws.park_kuipers import ParkKuipers
from clfcbf.qp import (
    QpStatus,
    QuadraticProgram,
    available_backends,
    get_backend,
    solve_ladder,
    solve_qp,
)
from clfcbf.unicycle import Polar

PERIOD = 1.0 / 30.0
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
WIDE = Limits(5.0, 5.0, 300.0, 300.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
REST = Twist(0.0, 0.0)
WEIGHT = (1.0, 0.0, 0.3)
every_backend = pytest.mark.parametrize("name", available_backends())


def scene(x=2.0, y=0.0, stamp=0.0):
    feature = Pose2(x, y, 0.0)
    return Scene(feature.compose(Pose2(-0.6, 0.0, 0.0)), feature, stamp)


class Fixed:
    """A barrier with given rows, far from its edge."""

    def __init__(self, name, *coefficients):
        self.name, self.coefficients = name, coefficients

    def rows(self, scene, motion=None):
        names = tuple(f"{self.name}.{k}" for k in range(len(self.coefficients)))
        return Rows(names, self.coefficients, Priority.SAFETY, (1.0,) * len(names))

    def clearance(self, scene, *arguments, **options):
        return 1.0

    def clearance_along(self, scene, sweep):
        return 1.0

    def clearance_around(self, scene, *arguments, **options):
        return 1.0, 1.0


@every_backend
@pytest.mark.parametrize("inert", [(0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (0.1, 0.0, 9.0)])
def test_1_an_inert_barrier_switches_nothing_off(name, inert):
    """3.0 is wanted and 0.1 allowed; a second barrier without influence changes nothing."""
    barriers = [Fixed("hard", (1.0, 0.0, 0.1)), Fixed("inert", inert)]
    for order in (barriers, barriers[::-1], barriers[:1]):
        safe = SafetyFilter(WIDE, order, PERIOD, name)
        decision = safe.filter(Twist(3.0, 0.0), scene(), REST, 0.0)
        assert decision.twist.v == pytest.approx(0.1, abs=1e-6)
        assert decision.twist.v <= 0.1 + 1e-15


@every_backend
def test_2_an_infeasible_program_does_not_let_the_command_through(name):
    """v <= -1 and -v <= -1 cannot both hold: never the nominal command, always a word of it."""
    safe = SafetyFilter(WIDE, [Fixed("none", (1.0, 0.0, -1.0), (-1.0, 0.0, -1.0))], PERIOD, name)
    decision = safe.filter(Twist(3.0, 2.0), scene(), REST, 0.0)
    assert decision.status is not Status.OPTIMAL
    assert decision.barrier_slack == pytest.approx(1.0, abs=1e-9)
    assert decision.twist.v == pytest.approx(0.0, abs=1e-9)


@every_backend
def test_3_no_point_without_a_flag(name):
    problem = QuadraticProgram(np.eye(2), [-1, 0], [[1, 0]], [-2], [-1, -1], [1, 1])
    answer = solve_qp(problem, name, fallback=())
    assert (answer.x, answer.status, answer.found) == (None, QpStatus.INFEASIBLE, False)


@every_backend
@pytest.mark.parametrize("demand", [5e4, 1e9])
def test_4_relaxation_never_softens_the_box(name, demand):
    box = (-1.0, 1.0, -1.0, 1.0)
    levels = [[(-1.0, 0.0, -demand)], [(0.0, 1.0, -demand)]]
    answer = solve_ladder(WEIGHT, (demand, demand), box, levels, name)
    assert (answer.v, answer.omega) == (1.0, -1.0)
    assert answer.slacks == pytest.approx((demand - 1.0, demand - 1.0))


@every_backend
def test_5_no_point_where_none_was_found(name):
    """Whatever the status, ``x`` is filled if and only if it stood verification."""
    for change in ({"h": [-4]}, {"h": [-1e-4 - 3]}, {"q": [np.nan, 0]}, {"lb": [2, 2]}, {}):
        data = {"P": np.eye(2), "q": [-1, -1], "G": [[1, 2]], "h": [1], "lb": [-1, -1]}
        answer = solve_qp(QuadraticProgram(**{**data, "ub": [1, 1], **change}), name, fallback=())
        assert (answer.x is not None) == answer.found == (answer.status is QpStatus.OPTIMAL)
        assert answer.found == (not change)


@every_backend
def test_6_a_failure_does_not_beget_failures(name):
    """A thousand failures in a row began with one that became a warm start."""
    solver = get_backend(name)
    bad = QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [-4], [-1, -1], [1, 1])
    good = QuadraticProgram(np.eye(2), [-1, -1], [[1, 2]], [1], [-1, -1], [1, 1])
    fresh = solver.solve(good).x
    for _ in range(5):
        assert not solve_qp(bad, solver, fallback=()).found
        assert np.array_equal(solver.solve(good).x, fresh)


def test_7_noise_near_the_goal_does_not_spin_the_robot():
    """A law with 1/rho turns 10 mrad of noise at 1 cm into 0.6 rad/s."""
    law, noise = ParkKuipers(), 0.01
    near = [law.command(Polar(0.01, phi, noise), LIMITS) for phi in (-noise, 0.0, noise)]
    assert max(abs(twist.omega) for twist in near) <= 0.1
    tracker = Kanayama(1.0, 8.0, 6.0)
    for seen in (Pose2(0.01, 0.0, noise), Pose2(0.01, 1e-4, -noise)):
        assert abs(tracker.command(seen, REST).omega) <= 0.1


@pytest.mark.parametrize("sign", [-1, 1])
def test_8_each_limit_clamps_its_own_field(sign):
    """A clamp written to the wrong field leaves omega without a limit."""
    loose = FieldOfView(math.radians(89))
    for nominal in (Twist(0.0, sign * 50.0), Twist(sign * 50.0, 0.0), Twist(sign * 9, sign * 9)):
        safe, applied = SafetyFilter(LIMITS, [loose], PERIOD), REST
        for k in range(40):
            decision = safe.filter(nominal, scene(30.0, 0.0, k * PERIOD), applied, k * PERIOD)
            assert abs(decision.twist.v - applied.v) <= LIMITS.a_max * PERIOD + 1e-9
            assert abs(decision.twist.omega - applied.omega) <= LIMITS.alpha_max * PERIOD + 1e-9
            assert abs(decision.twist.v) <= LIMITS.v_max + 1e-9
            assert abs(decision.twist.omega) <= LIMITS.omega_max + 1e-9
            applied = decision.twist
        assert abs(applied.v) == pytest.approx(LIMITS.v_max if nominal.v else 0.0, abs=1e-9)


@every_backend
@pytest.mark.parametrize("start", [Twist(0.55, 0.0), Twist(-0.6, 1.3), Twist(0.0, -2.0)])
def test_9_a_start_outside_the_limits_comes_back(name, start):
    safe, applied = SafetyFilter(LIMITS, [CAMERA], PERIOD, name), start
    for k in range(20):
        decision = safe.filter(Twist(0.1, 0.0), scene(3.0, 0.0, k * PERIOD), applied, k * PERIOD)
        assert LIMITS.input_box(applied, PERIOD).contains(decision.twist, 1e-9)
        for limit, before, after in (
            (LIMITS.v_max, applied.v, decision.twist.v),
            (LIMITS.omega_max, applied.omega, decision.twist.omega),
        ):
            assert abs(after) <= max(limit, abs(before)) + 1e-9
            if abs(before) > limit:
                assert abs(after) < abs(before)
        applied = decision.twist


@every_backend
def test_10_a_scene_that_never_changes_stops_the_robot(name):
    """A node that republishes its last command drives on when the camera has died."""
    safe, applied = SafetyFilter(LIMITS, [CAMERA], PERIOD, name, patience=0.3), REST
    frozen, statuses = scene(3.0), []
    for k in range(60):
        decision = safe.filter(Twist(0.2, 0.0), frozen, applied, k * PERIOD)
        applied = decision.twist
        statuses.append(decision.status)
    assert Status.STALE not in statuses[:9]
    assert set(statuses[12:]) == {Status.STALE}
    assert applied == REST
