r"""Certificate: the brake on the arc of an admissible command, in exact rational arithmetic.

From u with :math:`N = \lceil\max(|v|/(a_{max}T), |\omega|/(\alpha_{max}T))\rceil` the brake
:math:`u(1 - 1/N)` is in the acceleration box, needs N - 1 ticks, and what is left of the arc of
:math:`T_{eff} = T(N + 1)/2` is its own.
"""

import math
from fractions import Fraction

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.guard import Brake
from clfcbf.limits import Limits
from clfcbf.se2 import Twist

rationals = st.fractions(-2, 2, max_denominator=10**6)
positive = st.fractions("1/1000", 4, max_denominator=10**6)
PERIOD = 1 / 30


def ticks(v, omega, step_v, step_w):
    return math.ceil(max(abs(v) / step_v, abs(omega) / step_w))


def horizon(count, period):
    return period * (count + 1) / 2


@given(rationals, rationals, positive, positive, positive)
def test_a_brake_takes_the_rest_of_the_arc(v, omega, a_max, alpha_max, period):
    """Down to rest: each step in the box, each arc what the last one left, the sum the whole."""
    step_v, step_w = a_max * period, alpha_max * period
    count = ticks(v, omega, step_v, step_w)
    assume(1 <= count <= 400)
    left, u = horizon(count, period), (v, omega)
    travelled = Fraction(0)
    while count:
        held = (u[0], u[1])
        slower = tuple(x * (1 - Fraction(1, count)) for x in u)
        assert abs(slower[0] - u[0]) <= step_v
        assert abs(slower[1] - u[1]) <= step_w
        assert ticks(*slower, step_v, step_w) <= count - 1
        # Both arcs are on the circle of u: equal where their twists' integrals are.
        for now, then in zip(held, slower, strict=True):
            assert now * horizon(count, period) == now * period + then * horizon(count - 1, period)
        travelled += held[0] * period
        u, count = slower, count - 1
    assert u == (0, 0)
    assert travelled == v * left


@given(rationals, rationals, positive, positive, positive)
def test_a_shorter_horizon_leaves_some_of_the_brake_unchecked(v, omega, a_max, alpha_max, period):
    """With T N / 2 in the place of T (N + 1) / 2 the brake goes further than what was tested."""
    count = ticks(v, omega, a_max * period, alpha_max * period)
    assume(2 <= count <= 400)
    driven = sum(abs(v) * period * Fraction(count - k, count) for k in range(count))
    turned = sum(abs(omega) * period * Fraction(count - k, count) for k in range(count))
    assert driven == abs(v) * horizon(count, period)
    assert turned == abs(omega) * horizon(count, period)
    assert driven + turned > (abs(v) + abs(omega)) * period * Fraction(count, 2)


@given(rationals, rationals, positive, positive, positive)
def test_the_limits_count_the_same_ticks(v, omega, a_max, alpha_max, period):
    """``Limits.brake_ticks`` on rationals, where nothing is rounded."""
    limits = Limits(Fraction(4), Fraction(4), a_max, alpha_max)
    count = ticks(v, omega, a_max * period, alpha_max * period)
    assert limits.brake_ticks(Twist(v, omega), period) == count


@given(st.floats(-0.6, 0.6), st.floats(-1.5, 1.5), st.floats(0.05, 2.0), st.floats(0.1, 4.0))
def test_the_brake_of_the_guard_is_this_one(v, omega, a_max, alpha_max):
    """Counted down on floats it stays within a few roundings of the rational one."""
    limits = Limits(1.0, 2.0, a_max, alpha_max)
    brake = Brake(Twist(v, omega), limits.brake_ticks(Twist(v, omega), PERIOD))
    assume(brake.ticks)
    total = brake.ticks
    while brake.ticks:
        share = Fraction(brake.ticks, total)
        assert brake.twist.v == pytest.approx(float(v * share), rel=5e-16 * total, abs=1e-300)
        assert brake.twist.omega == pytest.approx(
            float(omega * share), rel=5e-16 * total, abs=1e-300
        )
        brake = brake.next()
    assert brake.twist == Twist(0.0, 0.0)


def test_on_floats_the_ticks_cannot_be_computed_again():
    """Why they are counted down: recomputed from the rounded brake they fail to drop by one."""
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    stuck = total = 0
    for numerator in range(1, 220):
        brake = Brake(Twist(numerator / 1000, 0.0), 0)
        brake = brake._replace(ticks=limits.brake_ticks(brake.twist, PERIOD))
        while brake.ticks > 1:
            following = brake.next()
            stuck += limits.brake_ticks(following.twist, PERIOD) > following.ticks
            total += 1
            brake = following
    assert 0 < stuck < 0.2 * total
