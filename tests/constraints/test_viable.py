"""The viable set: its braking angle, its rows, that they are feasible, and that they keep it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from clfcbf.constraints.rows import Priority
from clfcbf.constraints.viable import ViableSet, stopping_angle
from clfcbf.constraints.viable_held import _used_angle, held_rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.qp.exact import solve_lexicographic
from clfcbf.se2 import Twist, arc

PERIOD = 1 / 30
HALF_ANGLE = math.radians(35)
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
NAMES = ("viable.left", "viable.right", "viable.approach")


def random_set(rng, period=PERIOD):
    limits = Limits(*rng.uniform((0.1, 0.3, 0.1, 0.3), (0.5, 1.0, 1.0, 2.0)))
    half_angle = rng.uniform(0.3, 1.2)
    full = ViableSet.largest(limits, half_angle, period, 20.0)
    rate = full.approach_rate * rng.uniform(0.3, 1.0)
    return replace(full, approach_rate=rate, gain=rate + rng.uniform(0.0, 5.0))


def state_in(viable, rng):
    """A state of the set: rates drawn up to the largest that leaves a bearing in view."""
    limits, k = viable.limits, viable.approach_rate
    while True:
        rho, phi = rng.uniform(0.2, 3.0), viable.half_angle * rng.uniform(-1.0, 1.0)
        v = min(limits.v_max, k * rho) * rng.choice([0.0, 1.0, rng.uniform()])
        side = rng.choice([-1.0, 1.0])
        low, high = 0.0, limits.alpha_max / k * (1 - 1e-9)
        for _ in range(50):
            middle = 0.5 * (low + high)
            fits = viable.braking_angle(middle) <= viable.half_angle - side * phi
            low, high = (middle, high) if fits else (low, middle)
        rate = side * low * rng.choice([0.0, 1.0, rng.uniform()])
        omega = v / rho * math.sin(phi) - rate
        point, twist = (rho * math.cos(phi), rho * math.sin(phi)), Twist(v, omega)
        if abs(omega) <= limits.omega_max and min(viable.margins(point, twist)) >= 0.0:
            return point, twist


def moved(point, twist, acceleration, t, steps=8):
    """Point and twist while accelerations are held, in steps of exact arcs at mean twists."""
    a, alpha = acceleration
    h = t / steps
    for _ in range(steps):
        mean = Twist(twist.v + 0.5 * a * h, twist.omega + 0.5 * alpha * h)
        point = arc(mean, h).seen(point)
        twist = Twist(twist.v + a * h, twist.omega + alpha * h)
    return point, twist


@given(st.floats(1e-6, 0.99), st.floats(0.05, 3.0), st.floats(0.1, 3.0))
def test_stopping_angle_is_the_integral_of_the_rate(share, growth, brake):
    r"""Of p dp / (w - k p), the angle while p falls to rest; by quadrature."""
    rate = share * brake / growth
    integral, _ = quad(lambda p: p / (brake - growth * p), 0.0, rate, epsabs=0.0, epsrel=1e-12)
    assert stopping_angle(rate, brake, growth) == pytest.approx(integral, rel=1e-9)


def test_stopping_angle_at_its_ends():
    assert stopping_angle(0.0, 1.0, 0.5) == 0.0
    assert stopping_angle(-0.3, 1.0, 0.5) == 0.0
    assert stopping_angle(2.0, 1.0, 0.5) == math.inf
    rate = 1e-3 / 0.5  # where the series ends
    below, above = (stopping_angle(rate * (1 + e), 1.0, 0.5) for e in (-1e-9, 1e-9))
    assert below == pytest.approx(above, rel=1e-8)
    small = 1e-3
    expansion = small**2 / 2 + 0.5 * small**3 / 3
    assert stopping_angle(small, 1.0, 0.5) == pytest.approx(expansion, rel=1e-6)


@settings(max_examples=60)
@given(st.integers(0, 2**32))
def test_rows_state_the_rates_of_the_margins(seed):
    """b - A u is d(margin)/dt + gamma margin, by central differences along the motion."""
    rng = np.random.default_rng(seed)
    viable = random_set(rng)
    point, twist = state_in(viable, rng)
    acceleration = rng.uniform((-0.5, -1.5), (0.5, 1.5))
    rate = twist.v * point[1] / (point[0] ** 2 + point[1] ** 2) - twist.omega
    assume(abs(rate) > 1e-4 and viable.approach_rate * abs(rate) < 0.9 * viable.limits.alpha_max)
    rows = viable.rows(point, twist)
    h = 1e-5
    before = viable.margins(*moved(point, twist, acceleration, -h))
    after = viable.margins(*moved(point, twist, acceleration, h))
    for i in range(3):
        assert rows.values[i] == viable.margins(point, twist)[i]
        change = (after[i] - before[i]) / (2 * h)
        residual = rows.b[i] - rows.A[i] @ acceleration
        assert residual == pytest.approx(change + viable.gain * rows.values[i], abs=2e-6)
    assert rows.names == NAMES
    assert rows.priority == Priority.SAFETY


def programs(count, seed):
    rng = np.random.default_rng(seed)
    for i in range(count):
        if i % 20 == 0:
            viable = random_set(rng, rng.choice([0.01, PERIOD]))
        point, twist = state_in(viable, rng)
        yield viable, point, twist, tuple(rng.uniform((-1, -3), (1, 3)))


@pytest.mark.parametrize("build", [ViableSet.rows, held_rows])
def test_no_program_inside_the_set_is_infeasible(build):
    """0 of 20,000, to rounding; and only because the program has the whole acceleration box."""
    infeasible = starved = 0
    count = 20_000 if build is ViableSet.rows else 4_000
    for viable, point, twist, nominal in programs(count, 4):
        rows, box = build(viable, point, twist), viable.box(twist)
        solution = solve_lexicographic((1.0, 0.0, 1.0), nominal, box, [rows.coefficients])
        infeasible += solution.slacks[0] > 1e-8
        weak = tuple(0.8 * bound for bound in box)
        solution = solve_lexicographic((1.0, 0.0, 1.0), nominal, weak, [rows.coefficients])
        starved += solution.slacks[0] > 1e-8
    assert infeasible == 0
    assert starved > 0.01 * count


def test_the_witness_meets_rows_and_limits():
    for viable, point, twist, _ in programs(3_000, 5):
        a, alpha = viable.witness(point, twist)
        box, rows = viable.box(twist), viable.rows(point, twist)
        assert box.a_lo - 1e-12 <= a <= box.a_hi + 1e-12
        assert box.alpha_lo - 1e-9 <= alpha <= box.alpha_hi + 1e-9
        for a_a, a_alpha, b in rows.coefficients:
            scale = 1.0 + abs(a_a) + abs(a_alpha)
            assert a_a * a + a_alpha * alpha <= b + 1e-8 * scale


def braking_runs(viable, count, seed, braking_angle):
    """Largest bearing beyond the edge when rates on the edge of the set are braked.

    From the largest outward rate by ``braking_angle``, with the witness, until the bearing
    stops; Runge-Kutta on (rho, phi, v, omega) for all runs at once.
    """
    rng = np.random.default_rng(seed)
    k, alpha = viable.approach_rate, viable.limits.alpha_max
    rho, phi = rng.uniform(0.3, 2.0, count), rng.uniform(-0.6, 1.0, count) * viable.half_angle
    rates = np.linspace(0.0, alpha / k * (1 - 1e-6), 20_000)
    angles = np.array([braking_angle(rate) for rate in rates])
    rate = rates[np.searchsorted(angles, viable.half_angle - phi) - 1]
    v = k * rho * rng.choice([0.0, 0.5, 1.0], count)
    state = np.array([rho, phi, v, v / rho * np.sin(phi) - rate])

    def flow(state):
        rho, phi, v, omega = state
        return np.array(
            [
                -v * np.cos(phi),
                v / rho * np.sin(phi) - omega,
                -v * v / rho * np.cos(phi),
                np.full_like(v, alpha),
            ]
        )

    def outward(state):
        return state[2] / state[0] * np.sin(state[1]) - state[3] > 0.0

    h, worst = 2e-3, -math.inf
    while outward(state).any():
        k1 = flow(state)
        k2 = flow(state + 0.5 * h * k1)
        k3 = flow(state + 0.5 * h * k2)
        k4 = flow(state + h * k3)
        running = outward(state)
        state = np.where(running, state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), state)
        worst = max(worst, float(state[1].max()) - viable.half_angle)
    return worst


def test_braking_from_the_edge_of_the_set_never_overshoots():
    """2,000 runs; the parabola that leaves out the approach is not enough."""
    viable = ViableSet.largest(Limits(0.6, 1.2, 0.9, 0.5), HALF_ANGLE, PERIOD, 3.0)
    assert braking_runs(viable, 2_000, 6, viable.braking_angle) <= 1e-9
    assert braking_runs(viable, 2_000, 6, lambda p: 0.5 * p * p / 0.5) > math.radians(1)


@settings(max_examples=60)
@given(st.floats(-0.5, 0.5), st.floats(-2.0, 1.0))
def test_the_angle_used_up_by_a_held_brake(rate, brake):
    """Against p' = -w + k max(p, 0), integrated: exact for p >= 0, never too little for p < 0."""
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    k, steps = viable.approach_rate, 4_000
    p, angle, furthest, h = rate, 0.0, 0.0, PERIOD / 4_000
    for _ in range(steps):
        middle = p + 0.5 * h * (-brake + k * max(p, 0.0))
        p += h * (-brake + k * max(middle, 0.0))
        angle += h * middle
        furthest = max(furthest, angle)
    used = max(furthest, angle + viable.braking_angle(p))
    stated = _used_angle(viable, rate, brake)
    if rate > 0.0:
        assert stated == pytest.approx(used, abs=1e-8)
        hardest = _used_angle(viable, rate, viable.limits.alpha_max)
        assert hardest == pytest.approx(viable.braking_angle(rate), abs=1e-12)
    else:
        assert used - 1e-8 <= stated <= used + PERIOD * abs(rate) + 1e-3


@given(st.floats(-0.5, 0.5), st.floats(-2.0, 1.0), st.floats(0.0, 1.0))
def test_a_harder_brake_uses_no_more(rate, brake, share):
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    harder = brake + share * (1.0 - brake)
    assert _used_angle(viable, rate, harder) <= _used_angle(viable, rate, brake) + 1e-12


def adversarial_run(viable, build, seed, ticks=300):
    """Bang-bang accelerations through the rows; least margin to the view, and slacks needed."""
    rng = np.random.default_rng(seed)
    point, twist = (rng.uniform(0.8, 2.5), 0.0), Twist(0.0, 0.0)
    lowest, slack, wanted = math.inf, 0.0, (0.0, 0.0)
    for _ in range(ticks):
        if rng.uniform() < 0.08:
            signs = rng.choice([-1.0, 0.0, 1.0], 2)
            wanted = (signs[0] * viable.limits.a_max, signs[1] * viable.limits.alpha_max)
        rows = build(viable, point, twist)
        solution = solve_lexicographic(
            (1.0, 0.0, 1.0), wanted, viable.box(twist), [rows.coefficients]
        )
        slack = max(slack, solution.slacks[0])
        for _ in range(4):
            held = (solution.v, solution.omega)
            point, twist = moved(point, twist, held, viable.period / 4, 2)
            lowest = min(lowest, viable.half_angle - abs(math.atan2(point[1], point[0])))
        if math.hypot(*point) < 0.4:
            break
    return lowest, slack


@pytest.mark.parametrize("gain", [2.0, 30.0])
def test_held_rows_keep_the_view_from_tick_to_tick(gain):
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, gain)
    runs = [adversarial_run(viable, held_rows, seed) for seed in range(12)]
    assert min(lowest for lowest, _ in runs) >= -math.radians(1e-4)
    assert max(slack for _, slack in runs) <= 1e-6
    assert min(lowest for lowest, _ in runs) < math.radians(0.1)  # the edge was reached


def test_rows_of_the_instant_are_not_enough_for_a_held_acceleration():
    """So the test above has teeth: the same runs leave the set with ``ViableSet.rows``."""
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 30.0)
    runs = [adversarial_run(viable, ViableSet.rows, seed) for seed in range(12)]
    assert min(lowest for lowest, _ in runs) < -math.radians(0.1)


def test_held_rows_outside_the_set_ask_for_the_hardest_brake_and_no_more():
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    phi = HALF_ANGLE + 0.02
    point, twist = (math.cos(phi), math.sin(phi)), Twist(0.0, -0.2)
    assert not viable.contains(point, twist)
    rows = held_rows(viable, point, twist)
    a, alpha = viable.witness(point, twist)
    assert (a, alpha) == (0.0, LIMITS.alpha_max)
    assert rows.A[0] @ (a, alpha) == pytest.approx(rows.b[0], abs=1e-9)


def test_held_rows_outside_the_set_let_a_bearing_that_returns_return():
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    phi = HALF_ANGLE + 0.02
    point, twist = (math.cos(phi), math.sin(phi)), Twist(0.0, 0.1)
    rows = held_rows(viable, point, twist)
    assert rows.values[0] < 0.0
    # Nothing asked of a held speed, and no turning back out within the period.
    assert rows.A[0] @ (0.0, 0.0) < rows.b[0]
    assert rows.A[0] @ (0.0, -0.11 / PERIOD) > rows.b[0]


def test_mirror_symmetry():
    for viable, (x, y), (v, omega), _ in programs(200, 7):
        for build in (ViableSet.rows, held_rows):
            left = build(viable, (x, y), Twist(v, omega))
            right = build(viable, (x, -y), Twist(v, -omega))
            for i, j in ((0, 1), (1, 0), (2, 2)):
                a, alpha, b = left.coefficients[i]
                assert right.coefficients[j] == pytest.approx((a, -alpha, b), abs=1e-12)
                assert left.values[i] == pytest.approx(right.values[j], abs=1e-12)


def test_contains():
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    assert viable.contains((1.0, 0.0), Twist(0.2, 0.0))
    assert not viable.contains((1.0, 0.0), Twist(-0.01, 0.0))
    assert not viable.contains((0.2, 0.0), Twist(0.2, 0.0))
    assert not viable.contains((1.0, 0.0), Twist(0.0, 0.5))
    assert not viable.contains((math.cos(0.6), math.sin(0.6)), Twist(0.0, -0.2))


def test_largest_approach_rate():
    speed = ViableSet.largest(Limits(0.5, 1.0, 0.2, 1.0), HALF_ANGLE, PERIOD, 2.0)
    assert speed.approach_rate == pytest.approx(0.2 / 0.5)
    turn = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    assert turn.approach_rate == pytest.approx((0.4 - 1 / 30) / math.sin(HALF_ANGLE))
    tick = ViableSet.largest(Limits(0.1, 9.0, 9.0, 0.1), HALF_ANGLE, 0.2, 9.0)
    assert tick.approach_rate == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"half_angle": 0.0}, "half_angle"),
        ({"half_angle": 35.0}, "half_angle"),
        ({"half_angle": 0.005}, "too narrow"),
        ({"period": 0.0}, "period"),
        ({"period": 0.5}, "approach_rate"),
        ({"approach_rate": 0.0}, "approach_rate"),
        ({"approach_rate": 0.65}, "approach_rate"),
        ({"gain": 0.49}, "gain"),
        ({"gain": math.nan}, "gain"),
        ({"limits": Limits(1.0, 0.4, 0.3, 1.0)}, "approach_rate"),
    ],
)
def test_bad_configuration(change, match):
    good = ViableSet(LIMITS, HALF_ANGLE, PERIOD, 0.5, 2.0)
    with pytest.raises(ConfigurationError, match=match):
        replace(good, **change)


def test_no_admissible_rate():
    with pytest.raises(ConfigurationError, match="approach_rate"):
        ViableSet.largest(Limits(0.2, 0.4, 0.3, 1.0), HALF_ANGLE, 0.5, 2.0)


@pytest.mark.parametrize("build", [ViableSet.rows, held_rows])
@pytest.mark.parametrize(
    ("point", "twist", "match"),
    [
        ((0.0, 0.0), (0.0, 0.0), "undefined"),
        ((math.nan, 0.0), (0.0, 0.0), "finite"),
        ((1.0, 0.0), (math.inf, 0.0), "finite"),
        ((1.0, 0.0), (0.0, 2.0), "cannot be braked"),
        ((1.0, 0.0), (0.0, -2.0), "cannot be braked"),
    ],
)
def test_undefined_states(build, point, twist, match):
    viable = ViableSet.largest(LIMITS, HALF_ANGLE, PERIOD, 2.0)
    with pytest.raises(GeometryError, match=match):
        build(viable, point, Twist(*twist))
