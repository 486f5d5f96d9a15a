"""The error budget, against linear programming and against bodies that really err."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from clfcbf import FieldOfView, Limits, Pose2, Twist
from clfcbf.constraints.budget import ErrorBounds, _maximum, error_budget
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import DeadReckoning, advance, body_after, motion_since

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
PERIOD, LAG, NEAREST = 1 / 30, 0.12, 0.25
BOUNDS = ErrorBounds(
    bearing=math.radians(1), range_offset=0.005, range_scale=0.02, stamp=0.03, age=0.2,
    lag=(0.05, 0.25), scale=0.03, drift=math.radians(0.3),
)  # fmt: skip
BUDGET = error_budget(BOUNDS, LIMITS, CAMERA, PERIOD, LAG, NEAREST)
REST = Twist(0.0, 0.0)
ORIGIN = Pose2(0.0, 0.0, 0.0)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=12),
    st.floats(0.1, 1.0),
    st.floats(0.02, 3.0),
)
def test_the_maximum_is_that_of_linear_programming(weights, most, step):
    n = len(weights)
    slopes = np.eye(n, k=1)[: n - 1] - np.eye(n)[: n - 1]
    answer = linprog(
        -np.array(weights),
        A_ub=np.vstack((slopes, -slopes)) if n > 1 else None,
        b_ub=np.full(2 * (n - 1), step) if n > 1 else None,
        bounds=[(-most, most)] * n,
    )
    assert _maximum(np.array(weights), most, step) == pytest.approx(-answer.fun, abs=1e-7)


def believed_and_true(rng, bounds, ticks, switch):
    """A run of commands at the limits: where the feature is believed to be now, and where it is."""
    tau = rng.uniform(*bounds.lag) if rng.random() < 0.5 else rng.choice(bounds.lag)
    scale_v, scale_w = rng.choice([-1.0, 1.0], 2) * bounds.scale
    drift = rng.choice([-1.0, 1.0]) * bounds.drift
    steps = 10
    model, command = DeadReckoning(0.0, ORIGIN, REST), REST
    body, pose, track = REST, ORIGIN, [ORIGIN]
    wanted = REST
    for tick in range(ticks):
        if tick % switch == 0:
            wanted = Twist(*(rng.choice([-1.0, 0.0, 1.0], 2) * 9.0))
        command = LIMITS.input_box(command, PERIOD).clip(wanted)
        model = advance(model, command, (tick + 1) * PERIOD, LAG)
        true = Twist(command.v * (1 + scale_v), command.omega * (1 + scale_w) + drift)
        for _ in range(steps):
            body, mean = body_after(body, true, PERIOD / steps, tau)
            pose = pose.moved(mean, PERIOD / steps)
            track.append(pose)
    old = int(rng.integers(0, int(bounds.age / PERIOD * steps) + 1))
    captured = len(track) - 1 - old
    stamp = captured * PERIOD / steps + rng.choice([-1.0, 0.0, 1.0]) * bounds.stamp
    at = track[captured].transform(CAMERA.camera.transform((0.0, 0.0)))
    angle = track[captured].theta + rng.uniform(-0.5, 0.5)
    distance = rng.uniform(NEAREST + 0.2, 2.5)
    feature = (at[0] + distance * math.cos(angle), at[1] + distance * math.sin(angle))
    x, y = CAMERA.camera.seen(track[captured].seen(feature))
    error = rng.choice([-1.0, 1.0]) * (bounds.range_offset + bounds.range_scale * math.hypot(x, y))
    bearing = math.atan2(y, x) + rng.choice([-1.0, 1.0]) * bounds.bearing
    rho = math.hypot(x, y) + error
    measured = CAMERA.camera.transform((rho * math.cos(bearing), rho * math.sin(bearing)))
    believed = motion_since(model, min(stamp, model.time)).seen(measured)
    return CAMERA.camera.seen(believed), CAMERA.camera.seen(pose.seen(feature))


def left_over(believed, true, margin):
    """The displacement left after the best turn about the camera by up to ``margin``."""
    between = math.atan2(true[1], true[0]) - math.atan2(believed[1], believed[0])
    turn = max(-margin, min(margin, math.remainder(between, 2 * math.pi)))
    c, s = math.cos(turn), math.sin(turn)
    x, y = c * believed[0] - s * believed[1], s * believed[0] + c * believed[1]
    # What lies along the ray moves the feature to and fro in it, not out of view.
    rho = math.hypot(*true)
    return abs(x * true[1] - y * true[0]) / rho


@settings(max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(3, 25))
def test_what_is_believed_errs_by_no_more_than_the_budget(seed, switch):
    rng = np.random.default_rng(seed)
    believed, true = believed_and_true(rng, BOUNDS, 45, switch)
    assert left_over(believed, true, BUDGET.margin) <= BUDGET.setback


def test_the_budget_is_no_larger_than_it_has_to_be():
    """Commands at the limits reach half of the turn by now; it has to last until rest."""
    bounds = ErrorBounds(bearing=BOUNDS.bearing, lag=BOUNDS.lag, age=BOUNDS.age)
    budget = error_budget(bounds, LIMITS, CAMERA, PERIOD, LAG, NEAREST)
    rng = np.random.default_rng(7)
    worst = 0.0
    for _ in range(400):
        believed, true = believed_and_true(rng, bounds, 45, int(rng.integers(3, 25)))
        turned = math.atan2(true[1], true[0]) - math.atan2(believed[1], believed[0])
        worst = max(worst, abs(math.remainder(turned, 2 * math.pi)))
    assert worst > 0.5 * budget.margin


def test_each_error_adds_to_the_budget():
    perfect = ErrorBounds(lag=(LAG, LAG))
    nothing = error_budget(perfect, LIMITS, CAMERA, PERIOD, LAG, NEAREST)
    assert nothing.margin == pytest.approx(0.0, abs=2e-3)
    assert nothing.setback == pytest.approx(0.0, abs=2e-3)
    for name in ("bearing", "range_offset", "range_scale", "stamp", "scale", "drift"):
        one = ErrorBounds(**{"lag": (LAG, LAG), "age": 0.1, name: getattr(BOUNDS, name)})
        base = ErrorBounds(lag=(LAG, LAG), age=0.1)
        more = error_budget(one, LIMITS, CAMERA, PERIOD, LAG, NEAREST)
        less = error_budget(base, LIMITS, CAMERA, PERIOD, LAG, NEAREST)
        assert more.margin + more.setback > less.margin + less.setback, name


@pytest.mark.parametrize(
    ("name", "value"),
    [("bearing", -0.1), ("age", math.nan), ("lag", (0.2, 0.1)), ("scale", math.inf)],
)  # fmt: skip
def test_bounds_out_of_range(name, value):
    with pytest.raises(ConfigurationError, match=name):
        ErrorBounds(**{name: value})


def test_arguments_out_of_range():
    with pytest.raises(ConfigurationError, match="within its bounds"):
        error_budget(BOUNDS, LIMITS, CAMERA, PERIOD, 0.3, NEAREST)
    with pytest.raises(ConfigurationError, match="nearest"):
        error_budget(BOUNDS, LIMITS, CAMERA, PERIOD, LAG, 0.0)
