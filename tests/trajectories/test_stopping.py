"""The fastest stop of a lagging body: its formulas against integration, and what it achieves."""

import itertools
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from clfcbf.trajectories.stopping import command_to, stopping_distance, undershoot

PERIOD = 1 / 30
slopes = st.floats(0.1, 1.5)
lags = st.floats(0.05, 0.3)


@given(st.floats(0.0, 0.5), st.floats(0.0, 0.5), slopes, lags)
def test_command_and_body_come_to_rest_together(command, body, slope, lag):
    """Down to -w and back to zero at full slope: the body is at rest then, and not before."""
    w = undershoot(command, body, slope, lag)
    assert w >= 0.0
    assume(w > 1e-6)
    down, up = (command + w) / slope, w / slope

    def motion(time, state):
        u = command - slope * time if time < down else -w + slope * (time - down)
        return [(u - state[0]) / lag, u]

    first = solve_ivp(motion, (0.0, down), [body, 0.0], rtol=1e-10, atol=1e-12)
    last = solve_ivp(motion, (down, down + up), first.y[:, -1], rtol=1e-10, atol=1e-12)
    scale = slope * lag
    assert last.y[0, -1] == pytest.approx(0.0, abs=1e-6 * max(scale, 0.1))
    way = stopping_distance(command, body, slope, lag)
    assert last.y[1, -1] == pytest.approx(way, abs=1e-7)


def test_after_a_long_brake_it_undershoots_by_a_tau_log_2():
    slope, lag, u = 0.3, 0.12, 0.5
    assert undershoot(u, u + slope * lag, slope, lag) == pytest.approx(slope * lag * math.log(2))


def driven(error, command, body, slope, top, lag, true_lag, tolerance, ticks=400):
    """The body driven to the goal; errors of the body, its speeds and the commands."""
    goal, place, real, model = error + lag * body, 0.0, body, body
    track = []
    for _ in range(ticks):
        left = goal - place - lag * model
        new = command_to(left, command, model, slope, top, PERIOD, lag, tolerance)
        assert abs(new - command) <= slope * PERIOD * (1 + 1e-9)
        assert abs(new) <= top * (1 + 1e-9)
        command = new
        decay = math.exp(-PERIOD / true_lag)
        place += command * PERIOD + (real - command) * true_lag * (1.0 - decay)
        real = command + (real - command) * decay
        model = command + (model - command) * math.exp(-PERIOD / lag)
        track.append((goal - place, real, command))
    return track


@given(
    st.floats(-0.3, 0.3), st.floats(-1.0, 1.0), st.sampled_from([(0.3, 0.22), (1.0, 0.4)]),
    st.floats(0.08, 0.25),
)  # fmt: skip
def test_it_ends_at_the_goal_at_rest(error, share, coordinate, lag):
    slope, top = coordinate
    tolerance = slope * PERIOD * 0.3
    speed = share * top
    track = driven(error, speed, speed, slope, top, lag, lag, tolerance)
    last_error, last_speed, last_command = track[-1]
    assert abs(last_error) <= 2.0 * tolerance
    assert abs(last_speed) <= 1e-4
    assert last_command == 0.0


def test_it_is_faster_than_letting_go():
    """From full braking: at rest to a millimetre a second in less than two thirds of the time."""
    slope, top, lag, speed = 0.3, 0.22, 0.12, 0.15
    body = speed + slope * lag
    error = stopping_distance(speed, body, slope, lag)
    track = driven(error, speed, body, slope, top, lag, lag, 0.003)
    rest = next(k for k in range(len(track)) if all(abs(s) < 1e-3 for _, s, _ in track[k:]))
    let_go = speed / slope + lag * math.log(slope * lag / 1e-3)
    assert (rest + 1) * PERIOD - speed / slope < (let_go - speed / slope) / 1.5


@pytest.mark.parametrize("true_lag", [0.05, 0.2])
def test_a_wrong_lag_does_not_make_it_swing(true_lag):
    track = driven(0.05, 0.15, 0.15, 0.3, 0.22, 0.12, true_lag, 0.003)
    assert abs(track[-1][1]) < 1e-3
    turns = sum(a[1] * b[1] < -1e-7 for a, b in itertools.pairwise(track))
    assert turns <= 2
