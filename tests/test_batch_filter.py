"""The batched filter against SafetyFilter robot by robot, over several ticks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import FieldOfView, Limits, Pose2, SafetyFilter, Scene, Status, Twist
from clfcbf.batch import STATUSES, BatchState, filter_batch
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.errors import ConfigurationError
from clfcbf.guard import Brake

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
GAIN, MARGIN = 1.2, math.radians(0.5)
TURNED = FieldOfView(math.radians(30), Pose2(0.1, -0.05, 0.2))
WIDE = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.1), width=0.5)


def robots(rng, count, broken=0.0):
    """Features about the view, in and out of it, and commands within and beyond the limits."""
    distance = rng.uniform(0.3, 3.0, count)
    bearing = np.choose(
        rng.choice(3, count, p=(0.5, 0.4, 0.1)),
        (
            rng.uniform(-0.5, 0.5, count),
            rng.choice([-1.0, 1.0], count) * rng.uniform(0.45, 0.65, count),
            rng.uniform(-3.1, 3.1, count),
        ),
    )
    feature = np.stack(
        (
            0.2 + distance * np.cos(bearing),
            distance * np.sin(bearing),
            rng.uniform(-math.pi, math.pi, count),
        ),
        axis=1,
    )
    nominal = rng.uniform(-1.5, 1.5, (count, 2)) * (0.22, 0.4)
    applied = rng.uniform(-1.2, 1.2, (count, 2)) * (0.22, 0.4)
    applied[rng.random(count) < 0.2] = 0.0
    for array in (feature, nominal, applied):
        array[rng.random(array.shape) < broken] = rng.choice([math.nan, math.inf, -math.inf])
    return nominal, feature, applied


def one_by_one(filters, nominal, feature, applied, now):
    decisions = []
    for at, safe in enumerate(filters):
        seen = Pose2(*feature[at].tolist())
        # The goal plays no part here; that of a broken feature would count as a second fault.
        scene = Scene(Pose2(0.0, 0.0, 0.0), seen, now)
        decisions.append(
            safe.filter(Twist(*nominal[at].tolist()), scene, Twist(*applied[at].tolist()), now)
        )
    return decisions


def check(batch, decisions, filters):
    for at, (decision, safe) in enumerate(zip(decisions, filters, strict=True)):
        assert STATUSES[batch.status[at]] is decision.status
        assert batch.twist[at] == pytest.approx(decision.twist, rel=0, abs=1e-12)
        assert batch.certified[at] == decision.certified
        clear = pytest.approx(decision.clearance, rel=0, abs=1e-12, nan_ok=True)
        assert batch.clearance[at] == clear
        assert batch.slack[at] == pytest.approx(decision.barrier_slack, rel=0, abs=1e-12)
        brake = safe.state.brake
        assert batch.state.brake[at] == pytest.approx(brake.twist, rel=0, abs=1e-12)
        assert batch.state.ticks[at] == brake.ticks
        assert batch.state.sent[at] == pytest.approx(safe.state.sent, rel=0, abs=1e-12)


def run(camera, seed, count, ticks, gain=GAIN, broken=0.0, guard_lag=0.25, weight=(1.0, 0.0, 0.3)):
    rng = np.random.default_rng(seed)
    barrier = FieldOfViewBarrier(camera, gain, MARGIN)
    filters = [
        SafetyFilter(LIMITS, [barrier], PERIOD, weight=weight, guard_lag=guard_lag)
        for _ in range(count)
    ]
    state, statuses = None, set()
    nominal, feature, applied = robots(rng, count, broken)
    for tick in range(ticks):
        now = tick * PERIOD
        batch = filter_batch(
            LIMITS, camera, gain, MARGIN, nominal, feature, applied, PERIOD, weight,
            state=state, guard_lag=guard_lag, chunk=17,
        )  # fmt: skip
        decisions = one_by_one(filters, nominal, feature, applied, now)
        check(batch, decisions, filters)
        statuses |= {decision.status for decision in decisions}
        state = batch.state
        new = robots(rng, count, broken)
        # Most robots follow what was sent and see what they saw, others were pushed.
        pushed = rng.random(count) < 0.3
        nominal = new[0]
        feature = np.where(pushed[:, None], new[1], feature)
        applied = np.where(pushed[:, None], new[2], batch.twist)
    return statuses


@pytest.mark.parametrize("camera", [CAMERA, TURNED, WIDE], ids=["ahead", "turned", "wide"])
@pytest.mark.parametrize("guard_lag", [0.0, 0.25])
def test_equal_to_one_by_one(camera, guard_lag):
    # A gain this large asks too little of the program, and leaves work to the guard.
    statuses = run(camera, 1, 100, 3, gain=30.0, guard_lag=guard_lag)
    statuses |= run(camera, 1, 100, 4, guard_lag=guard_lag)
    assert statuses >= {
        Status.OPTIMAL,
        Status.BARRIER_RELAXED,
        Status.GUARDED,
        Status.BRAKING,
        Status.OUT_OF_VIEW,
    }


def test_with_broken_numbers():
    statuses = run(CAMERA, 2, 120, 5, broken=0.05)
    assert Status.INVALID_INPUT in statuses
    run(WIDE, 3, 60, 4, broken=0.1)


def test_any_weight():
    run(CAMERA, 4, 100, 3, weight=(1.0, 0.3, 0.2))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_any_robots_at_all(seed, wide):
    run(WIDE if wide else CAMERA, seed, 12, 3, broken=0.02)


def test_a_brake_is_counted_down():
    """Broken inputs for as long as it takes: every robot comes to rest on its certificate."""
    nominal, feature, applied = robots(np.random.default_rng(5), 50)
    applied /= 1.2  # beyond the limits a brake must first get back into them
    arguments = (LIMITS, CAMERA, GAIN, MARGIN)
    first = filter_batch(*arguments, nominal, feature, applied, PERIOD)
    decision, broken = first, np.full_like(nominal, math.nan)
    for _ in range(40):
        before, decision = (
            decision,
            filter_batch(*arguments, broken, feature, decision.twist, PERIOD, state=decision.state),
        )
        ticks = np.maximum(before.state.ticks - 1, 0)
        np.testing.assert_array_equal(decision.state.ticks, ticks)
        standing = before.state.ticks == 0
        np.testing.assert_array_equal(decision.certified, first.certified | standing)
    np.testing.assert_array_equal(decision.twist, 0.0)
    assert first.certified.any()
    expected = Brake(Twist(*first.state.brake[0].tolist()), int(first.state.ticks[0])).next()
    again = filter_batch(*arguments, broken, feature, first.twist, PERIOD, state=first.state)
    assert again.twist[0] == pytest.approx(expected.twist, rel=0, abs=1e-15)


def test_chunks_change_nothing():
    nominal, feature, applied = robots(np.random.default_rng(6), 200, broken=0.02)
    arguments = (LIMITS, CAMERA, GAIN, MARGIN, nominal, feature, applied, PERIOD)
    whole = filter_batch(*arguments)
    for chunk in (1, 23, 199):
        part = filter_batch(*arguments, chunk=chunk)
        for ours, theirs in zip((*part[:5], *part.state), (*whole[:5], *whole.state), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_arguments_are_left_alone():
    arrays = robots(np.random.default_rng(7), 80, broken=0.05)
    state = filter_batch(LIMITS, CAMERA, GAIN, MARGIN, *arrays, PERIOD).state
    before = [array.copy() for array in (*arrays, *state)]
    filter_batch(LIMITS, CAMERA, GAIN, MARGIN, *arrays, PERIOD, state=state)
    for array, copy in zip((*arrays, *state), before, strict=True):
        np.testing.assert_array_equal(array, copy)


NOMINAL, FEATURE = np.zeros((3, 2)), np.ones((3, 2))
GOOD = {
    "limits": LIMITS, "camera": CAMERA, "gain": 1.0, "margin": 0.0, "nominal": NOMINAL,
    "features": FEATURE, "applied": NOMINAL, "period": PERIOD,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain": 0.0}, "gain"),
        ({"margin": 1.0}, "margin"),
        ({"period": 0.0}, "period"),
        ({"weight": (1.0, 1.0, 1.0)}, "weight"),
        ({"guard_lag": math.nan}, "guard_lag"),
        ({"chunk": 0}, "chunk"),
        ({"nominal": NOMINAL[0]}, "nominal must have shape"),
        ({"features": FEATURE[:2]}, r"features must have shape \(3, 2\) or \(3, 3\)"),
        ({"camera": WIDE}, r"features must have shape \(3, 3\)"),
        ({"applied": FEATURE[:, :1]}, "applied must have shape"),
        ({"state": BatchState.at_rest(2)}, "state.brake must have shape"),
    ],
)
def test_bad_arguments_are_named(change, message):
    filter_batch(**GOOD)
    with pytest.raises(ConfigurationError, match=message):
        filter_batch(**{**GOOD, **change})
