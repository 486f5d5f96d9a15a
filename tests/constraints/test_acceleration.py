"""Acceleration inputs: their box, and the high-order rows of the camera's edges."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.acceleration import acceleration_box, high_order_edge_rows
from clfcbf.constraints.cbf import edge_rows
from clfcbf.constraints.rows import Priority
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.se2 import Pose2, Twist
from tests.strategies import limits, periods

points = st.tuples(st.floats(0.2, 3.0), st.floats(-2.0, 2.0))
twists = st.builds(Twist, st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))
accelerations = st.tuples(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
cameras = st.builds(
    FieldOfView,
    half_angle=st.floats(0.2, 1.4),
    camera=st.builds(Pose2, st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(-2.0, 2.0)),
)
gains = st.tuples(st.floats(0.1, 5.0), st.floats(0.1, 5.0))


def moved(point, twist, acceleration, t, steps=4):
    """Point and twist after constant accelerations, by Runge-Kutta; t of either sign."""
    a, alpha = acceleration

    def rate(state):
        x, y, v, omega = state
        return (omega * y - v, -omega * x, a, alpha)

    state, h = (*point, *twist), t / steps
    for _ in range(steps):
        k1 = rate(state)
        k2 = rate([s + 0.5 * h * k for s, k in zip(state, k1, strict=True)])
        k3 = rate([s + 0.5 * h * k for s, k in zip(state, k2, strict=True)])
        k4 = rate([s + h * k for s, k in zip(state, k3, strict=True)])
        state = [
            s + h / 6 * (p + 2 * q + 2 * r + w)
            for s, p, q, r, w in zip(state, k1, k2, k3, k4, strict=True)
        ]
    return (state[0], state[1]), Twist(state[2], state[3])


@given(points, twists, accelerations, cameras, gains)
def test_high_order_rows_state_the_derivative_of_psi(point, twist, acceleration, camera, gains):
    """b - A u is d(psi)/dt + lambda_2 psi, psi = dh/dt + lambda_1 h, by finite differences."""
    rows = high_order_edge_rows(point, twist, camera, gains)
    step = 1e-3

    def h(t):
        return edge_rows(moved(point, twist, acceleration, t)[0], camera, 1.0).values

    before, now, after = h(-step), h(0.0), h(step)
    for i in range(2):
        first = (after[i] - before[i]) / (2 * step)
        second = (after[i] - 2 * now[i] + before[i]) / step**2
        psi = first + gains[0] * now[i]
        psi_rate = second + gains[0] * first
        assert rows.values[i] == pytest.approx(psi, abs=1e-5)
        residual = rows.b[i] - rows.A[i] @ acceleration
        assert residual == pytest.approx(psi_rate + gains[1] * psi, abs=3e-5)


@given(points, twists, cameras, gains, st.floats(0.0, 0.1))
def test_high_order_rows_of_a_narrower_view(point, twist, camera, gains, margin):
    narrow = FieldOfView(camera.half_angle - margin, camera.camera)
    rows = high_order_edge_rows(point, twist, camera, gains, margin)
    same = high_order_edge_rows(point, twist, narrow, gains)
    assert pytest.approx(same.A, abs=1e-12) == rows.A
    assert rows.b == pytest.approx(same.b, abs=1e-9)
    assert rows.names == ("fov.left", "fov.right")
    assert rows.priority == Priority.SAFETY


def test_high_order_rows_alone_can_ask_for_more_than_there_is():
    """The promise they do not make: inside {h >= 0, psi >= 0}, no acceleration within limits."""
    camera = FieldOfView(math.radians(35))
    point = (math.cos(0.6), math.sin(0.6))
    twist = Twist(0.0, -0.4)
    assert edge_rows(point, camera, 1.0).values[0] > 0.0
    rows = high_order_edge_rows(point, twist, camera, (45.0, 5.0))
    assert min(rows.values) > 0.0
    least = min(rows.A[0] @ (a, alpha) for a in (-0.3, 0.3) for alpha in (-1.0, 1.0))
    assert least > rows.b[0]


@pytest.mark.parametrize("gains", [(0.0, 1.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_bad_gains(gains):
    with pytest.raises(ConfigurationError, match="gains"):
        high_order_edge_rows((1.0, 0.0), Twist(0.0, 0.0), FieldOfView(0.6), gains)


@pytest.mark.parametrize(
    ("point", "twist"),
    [((math.nan, 0.0), (0.0, 0.0)), ((1.0, math.inf), (0.0, 0.0)), ((1.0, 0.0), (math.nan, 0.0))],
)
def test_not_finite(point, twist):
    with pytest.raises(GeometryError, match="finite"):
        high_order_edge_rows(point, Twist(*twist), FieldOfView(0.6), (1.0, 1.0))


@given(
    limits, periods, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0, 1), st.floats(0, 1)
)
def test_box_keeps_the_speed_limits(limits, period, v, omega, share_a, share_alpha):
    v = limits.reverse_speed + 0.5 * (v + 1.0) * (limits.v_max - limits.reverse_speed)
    v = min(v, limits.v_max)  # the sum may round up
    twist = Twist(v, omega * limits.omega_max)
    box = acceleration_box(limits, twist, period)
    a = box.a_lo + share_a * (box.a_hi - box.a_lo)
    alpha = box.alpha_lo + share_alpha * (box.alpha_hi - box.alpha_lo)
    assert -limits.a_max <= box.a_lo <= 0.0 <= box.a_hi <= limits.a_max
    assert -limits.alpha_max <= box.alpha_lo <= 0.0 <= box.alpha_hi <= limits.alpha_max
    held = Twist(twist.v + period * a, twist.omega + period * alpha)
    assert limits.contains(held, 1e-12)


@given(limits, periods, twists)
def test_box_is_that_of_the_commands(limits, period, twist):
    """A period of it is what ``Limits.input_box`` allows, from outside the speed limits too."""
    box = acceleration_box(limits, twist, period)
    commands = limits.input_box(twist, period)
    assert twist.v + period * box.a_lo == pytest.approx(commands.v_lo, abs=1e-12)
    assert twist.v + period * box.a_hi == pytest.approx(commands.v_hi, abs=1e-12)
    assert twist.omega + period * box.alpha_lo == pytest.approx(commands.w_lo, abs=1e-12)
    assert twist.omega + period * box.alpha_hi == pytest.approx(commands.w_hi, abs=1e-12)


@given(points, twists, cameras, gains)
def test_columns_are_those_of_the_accelerations(point, twist, camera, gains):
    rows = high_order_edge_rows(point, twist, camera, gains)
    assert rows.A.shape == (2, 2)
    # The columns are how much a unit of acceleration changes the rate of h's rate.
    for column, unit in enumerate([(1.0, 0.0), (0.0, 1.0)]):
        step = 1e-3
        rates = [
            edge_rows(moved(point, twist, u, t)[0], camera, 1.0).values
            for u in (unit, (0.0, 0.0))
            for t in (-step, step)
        ]
        for i in range(2):
            change = sum(rates[j][i] * sign for j, sign in enumerate((1, 1, -1, -1))) / step**2
            assert rows.A[i, column] == pytest.approx(-change, abs=2e-5)
