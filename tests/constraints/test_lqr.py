"""The regulator's weights against its equation, another solver, and motion in small steps."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf.constraints.clf import quadratic_clf
from clfcbf.constraints.lqr import (
    EFFORT_COST,
    ERROR_COST,
    LqrWeights,
    linearised,
    lqr_weights,
)
from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.se2 import Pose2, Twist
from clfcbf.unicycle import tracking_error

pytest.importorskip("control", reason="needs clfcbf[control]")
from scipy.linalg import solve_continuous_are

references = st.builds(
    Twist, st.sampled_from([-0.22, -0.1, 0.05, 0.22, 0.35]), st.floats(-0.3, 0.3)
)
unit = st.floats(-1.0, 1.0)


def law(weights, error, reference):
    correction = np.array(weights.gain) @ np.array(error)
    return Twist(reference.v - correction[0], reference.omega - correction[1])


def value(weights, error):
    return 0.5 * float(np.array(error) @ np.array(weights.weights) @ np.array(error))


def stepped(weights, error, reference, step):
    """One Runge-Kutta step of the error under the regulator."""

    def rate(x):
        command = law(weights, x, reference)
        return np.array(tracking_error(Pose2(*x), reference).rate(command))

    x = np.array(error)
    a = rate(x)
    b = rate(x + 0.5 * step * a)
    c = rate(x + 0.5 * step * b)
    d = rate(x + step * c)
    return x + step / 6.0 * (a + 2 * b + 2 * c + d)


@given(references)
def test_the_linearisation_is_the_derivative_of_the_error_dynamics(reference):
    a, b = linearised(reference)
    step = 1e-6

    def rate(x, u):
        twist = Twist(reference.v + u[0], reference.omega + u[1])
        return np.array(tracking_error(Pose2(*x), reference).rate(twist))

    assert rate((0, 0, 0), (0, 0)) == pytest.approx(np.zeros(3), abs=1e-15)
    for i, direction in enumerate(np.eye(3)):
        slope = (rate(step * direction, (0, 0)) - rate(-step * direction, (0, 0))) / (2 * step)
        np.testing.assert_allclose(a[:, i], slope, atol=1e-9)
    for i, direction in enumerate(np.eye(2)):
        slope = (rate((0, 0, 0), step * direction) - rate((0, 0, 0), -step * direction)) / 2 / step
        np.testing.assert_allclose(b[:, i], slope, atol=1e-9)


@settings(max_examples=25)
@given(references)
def test_the_riccati_residual(reference):
    weights = lqr_weights(reference)
    a, b = linearised(reference)
    q, r = np.diag(ERROR_COST), np.diag(EFFORT_COST)
    p = np.array(weights.weights)
    residual = a.T @ p + p @ a - p @ b @ np.linalg.inv(r) @ b.T @ p + q
    assert np.abs(residual).max() < 1e-9 * np.abs(p).max()
    np.testing.assert_array_equal(p, p.T)
    assert np.linalg.eigvalsh(p)[0] > 0.0
    np.testing.assert_allclose(p, solve_continuous_are(a, b, q, r), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(weights.gain, np.linalg.inv(r) @ b.T @ p, rtol=1e-7, atol=1e-7)


@settings(max_examples=25)
@given(references, st.floats(0.1, 1.0))
def test_the_decay_is_the_largest_that_the_linear_loop_keeps(reference, share):
    weights = lqr_weights(reference, share=share)
    a, b = linearised(reference)
    k, p = np.array(weights.gain), np.array(weights.weights)
    closed = a - b @ k
    left = -(closed.T @ p + p @ closed) - weights.decay / share * p
    least = np.linalg.eigvalsh(left)[0]
    assert least == pytest.approx(0.0, abs=1e-6 * np.abs(p).max())


@settings(max_examples=40)
@given(references, unit, unit, unit)
def test_the_function_decays_near_the_reference(reference, x, y, theta):
    """Along Runge-Kutta paths of the nonlinear error: at each step, and at the rate stated."""
    weights = lqr_weights(reference)
    error = 0.02 * np.array([x, y, theta])
    first = value(weights, error)
    step, before = 0.02, first
    for i in range(1, 101):
        error = stepped(weights, error, reference, step)
        now = value(weights, error)
        assert now <= before * math.exp(-weights.decay * step) + 1e-15
        assert now <= first * math.exp(-weights.decay * step * i) + 1e-15
        before = now


@settings(max_examples=60)
@given(references, unit, unit, unit)
def test_the_regulator_meets_its_row_near_the_reference(reference, x, y, theta):
    weights = lqr_weights(reference)
    error = Pose2(0.02 * x, 0.02 * y, 0.02 * theta)
    rows = quadratic_clf(error, reference, weights.weights, weights.decay)
    ((a_v, a_omega, b),) = rows.coefficients
    command = law(weights, error, reference)
    assert a_v * command.v + a_omega * command.omega <= b + 1e-12
    assert rows.values[0] == pytest.approx(value(weights, error))


def test_a_lateral_error_alone_can_be_worked_on():
    """Where a diagonal weight leaves no command to lower the function."""
    reference, error = Twist(0.22, 0.0), Pose2(0.0, 0.1, 0.0)
    weights = lqr_weights(reference)
    ((a_v, a_omega, b),) = quadratic_clf(
        error, reference, weights.weights, weights.decay
    ).coefficients
    assert abs(a_omega) > 0.1
    diagonal = quadratic_clf(error, reference, (1.0, 1.0, 1.0), weights.decay).coefficients[0]
    assert diagonal[:2] == (0.0, 0.0)
    assert diagonal[2] < 0.0
    assert b < math.inf
    assert a_v == pytest.approx(0.0, abs=1e-12)


def test_reverse_is_the_mirror_image():
    forward, reverse = lqr_weights(Twist(0.2, 0.0)), lqr_weights(Twist(-0.2, 0.0))
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(
        mirror @ np.array(forward.weights) @ mirror, reverse.weights, atol=1e-9
    )
    assert isinstance(forward, LqrWeights)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"reference": Twist(0.0, 0.0)}, "rest"),
        ({"reference": Twist(math.nan, 0.1)}, "finite"),
        ({"error_cost": (1.0, 0.0, 1.0)}, "error_cost"),
        ({"effort_cost": (1.0, -1.0)}, "effort_cost"),
        ({"share": 0.0}, "share"),
        ({"share": 1.1}, "share"),
    ],
)
def test_bad_settings(arguments, match):
    with pytest.raises(ConfigurationError, match=match):
        lqr_weights(**{"reference": Twist(0.2, 0.0), **arguments})


def test_without_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[control\]"):
        lqr_weights(Twist(0.2, 0.0))
