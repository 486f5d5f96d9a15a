"""The judge of a run: what it counts on the way, against scripted runs."""

import math

import numpy as np
import pytest

from clfcbf.decision import Decision, Phase, Status
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.judge import Watch
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel

WORLD, APPROACHING = World(wait=0.0), LIMITS["approaching"]
REST = Twist(0.0, 0.0)
START = Pose2(-1.5, 0.0, 0.0)
TICK = WORLD.period


class Script:
    """Sends a list of commands, then says that it is done."""

    def __init__(self, commands, status=Status.OPTIMAL):
        self.commands, self.status, self.k = list(commands), status, -1

    def step(self, observation, applied, now):
        self.k += 1
        over = self.k >= len(self.commands)
        twist = REST if over else self.commands[self.k]
        return Decision(twist, self.status, True, twist, 1.0, done=over, timing=1e-6 * self.k)


def scripted(commands, start=START, status=Status.OPTIMAL):
    plant = KinematicPlant(start, APPROACHING, Body.ideal(), np.random.default_rng(0))
    watcher = PoseSensor(
        plant, WORLD.camera, WORLD.standoff, SensorModel.ideal(), np.random.default_rng(1)
    )  # fmt: skip
    result, _ = run_episode(plant, watcher, Script(commands, status), WORLD, APPROACHING)
    return result


def ramp(v, ticks, up=0.01):
    """Up to a speed, along, and down to rest at 0.3 m/s²."""
    rise = [Twist(up * k, 0.0) for k in range(1, round(v / up))]
    return [*rise, *[Twist(v, 0.0)] * ticks, *reversed(rise)]


def test_chatter_is_the_rms_of_the_increments():
    commands = [Twist(0.01, 0.02), Twist(0.02, -0.01), Twist(0.01, 0.0)]
    result = scripted(commands)
    v, omega = np.diff(np.array([*commands, REST]), axis=0).T
    assert result.chatter_v == pytest.approx(math.sqrt(np.mean(v**2)))
    assert result.chatter_omega == pytest.approx(math.sqrt(np.mean(omega**2)))
    assert scripted([]).chatter_v == 0.0


def test_driving_over_the_goal_and_back_is_contact():
    there = ramp(0.2, 20)
    back = [Twist(-v, w) for v, w in there]
    length = TICK * sum(v for v, _ in there)
    for past, outcome in ((0.045, "miss"), (0.055, "contact")):
        result = scripted([*there, REST, *back], Pose2(past - length, 0.0, 0.0))
        assert result.path_m == pytest.approx(2.0 * length)
        assert result.e_lon_mm == pytest.approx(1e3 * (past - length))
        assert result.outcome == outcome


def test_time_out_of_view_counts_from_the_first_view():
    """A turn on the spot at a constant rate, with its feature beyond the edge for a while."""
    rate = 0.4
    rise = [Twist(0.0, rate * k / 12) for k in range(1, 12)]
    turn = [*rise, *[Twist(0.0, rate)] * 90, *reversed(rise)]
    result = scripted(turn, Pose2(-1.5, 0.0, 0.0))
    headings = np.cumsum([w * TICK for _, w in turn])
    outside = [
        WORLD.camera.margin(Pose2(-1.5, 0.0, h).seen((WORLD.standoff, 0.0))) < 0.0 for h in headings
    ]
    assert result.fov_lost
    assert result.fov_lost_s == pytest.approx(TICK * (sum(outside) + 1), abs=2 * TICK)
    assert result.min_visible == 0.0
    away = scripted(turn, Pose2(-1.5, 0.0, math.radians(60.0)))
    assert away.fov_lost_s == 0.0  # never seen, so never lost
    assert away.fov_lost


def test_blind_time_is_the_longest_gap_between_measurements():
    watch = Watch(Pose2(-1.0, 0.0, 0.0), WORLD, APPROACHING)
    decision = Decision(REST, Status.OPTIMAL, True, REST, 1.0, phase=Phase.APPROACHING)
    seen = {3, 4, 9, 10}
    for k in range(14):
        watch.decided(0.1 * k, Pose2(-1.0, 0.0, 0.0), REST, REST, k in seen, decision)
    result = watch.verdict(Pose2(-1.0, 0.0, 0.0))
    assert result.blind_s == pytest.approx(0.5)
    assert result.min_visible == 1.0
    assert result.outcome == "timeout"


def test_solver_failures_and_durations_are_counted():
    result = scripted([REST] * 9, status=Status.SOLVER_FAILED)
    assert result.solver_failures == result.ticks == result.infeasible_ticks == 10
    assert result.step_us_max == pytest.approx(9.0)
    assert result.step_us_p50 == pytest.approx(4.5)


@pytest.mark.parametrize(
    ("end", "outcome", "strict"),
    [
        (Pose2(0.0, 0.009, 0.0), "ok", True),
        (Pose2(0.0, 0.011, 0.0), "ok", False),
        (Pose2(-0.02, 0.0, math.radians(2.1)), "ok", False),
        (Pose2(-0.029, 0.0, 0.0), "ok", False),
        (Pose2(-0.031, 0.0, 0.0), "miss", False),
        (Pose2(0.0, 0.0, math.radians(5.1)), "miss", False),
        (Pose2(0.0, 0.0, 2.0 * math.pi), "ok", True),
    ],
)
def test_criteria(end, outcome, strict):
    result = scripted([], end)
    assert (result.outcome, result.strict) == (outcome, strict)


def test_commands_outside_the_box_are_violations():
    result = scripted([Twist(0.5, 0.0), REST])
    assert result.limit_violations == 2  # too fast at once, and too fast back
    assert result.outcome == "limit violated"
