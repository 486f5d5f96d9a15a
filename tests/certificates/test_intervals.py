"""The interval arithmetic encloses: against exact rationals and 60-digit arithmetic."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.certificates.branch_and_bound import branch_and_bound
from tests.certificates.intervals import REACH, Interval

numbers = st.floats(-1e100, 1e100) | st.floats(-4.0, 4.0)


@st.composite
def intervals_with_a_member(draw):
    """An interval and an exact rational number in it."""
    low, high = sorted((draw(numbers), draw(numbers)))
    share = Fraction(draw(st.integers(0, 1000)), 1000)
    member = Fraction(low) + share * (Fraction(high) - Fraction(low))
    return Interval(low, high), member


members = intervals_with_a_member()


@given(members, members)
def test_arithmetic_encloses_the_exact_result(x, y):
    (a, p), (b, q) = x, y
    assert (a + b).contains(p + q)
    assert (a - b).contains(p - q)
    assert (a * b).contains(p * q)
    assert (-a).contains(-p)
    assert a.square().contains(p * p)
    assert a.magnitude().contains(abs(p))
    assert (2.0 - a).contains(2 - p)
    assert (3.0 * a).contains(3 * p)
    if not b.contains(0):
        assume(b.magnitude().lo > 1e-100)
        assert (a / b).contains(p / q)
        assert (1.0 / b).contains(1 / q)


@given(numbers, numbers)
def test_bounds_are_no_more_than_three_neighbours_apart(x, y):
    """Outward rounding, not a blanket widening."""
    total = Interval(x) + Interval(y)
    assert total.hi <= math.nextafter(math.nextafter(total.lo, math.inf), math.inf)
    product = Interval(x) * Interval(y)
    assert product.hi <= math.nextafter(math.nextafter(product.lo, math.inf), math.inf)


@given(st.floats(-REACH, REACH), st.floats(-REACH, REACH), st.floats(0.0, 1.0))
def test_sine_and_cosine_enclose(one, other, share):
    x = Interval(min(one, other), max(one, other))
    member = min(max(x.lo + share * (x.hi - x.lo), x.lo), x.hi)
    with mpmath.workdps(60):
        for enclosure, exact in ((x.sin(), mpmath.sin), (x.cos(), mpmath.cos)):
            value = exact(mpmath.mpf(float(member)))
            assert mpmath.mpf(float(enclosure.lo)) <= value <= mpmath.mpf(float(enclosure.hi))


@given(st.floats(-REACH, REACH))
def test_sine_and_cosine_of_a_point_are_sharp(x):
    for enclosure in (Interval(x).sin(), Interval(x).cos()):
        assert enclosure.hi - enclosure.lo <= 3e-15


@given(st.decimals(-10, 10, allow_nan=False, places=6))
def test_decimals_are_enclosed(number):
    assert Interval.of(number).contains(Fraction(number))
    assert not Interval.of("0.1").contains(Fraction(1, 10) + Fraction(1, 10**16))


def test_arrays_and_mixed_operands():
    x = Interval(np.array([0.0, 1.0]), np.array([1.0, 2.0]))
    total = np.array([1.0, -1.0]) + x
    assert total.lo == pytest.approx([1.0, 0.0])
    assert total.hi == pytest.approx([2.0, 1.0])


def test_what_is_undefined_is_refused():
    with pytest.raises(ZeroDivisionError):
        Interval(1.0) / Interval(-1.0, 1.0)
    with pytest.raises(ValueError, match="reversed"):
        Interval(1.0, 0.0)
    with pytest.raises(ValueError, match="reversed"):
        Interval(math.nan)
    with pytest.raises(ValueError, match="arguments"):
        Interval(1.6).sin()


def test_branch_and_bound_proves_refutes_and_gives_up():
    """x² + y² - xy >= 0.75 y² on a square, with the constant lowered, exact and raised."""

    def of(constant, most=20_000):
        def value(x, y):
            return x.square() + y.square() - x * y - constant * y.square()

        return branch_and_bound(
            lambda x, y: value(x, y).lo > 0.0,
            lambda x, y: value(x, y).hi < 0.0,
            ((-1.0, 1.0), (0.5, 1.0)),
            most,
        )

    assert of(0.7).proved
    refuted = of(0.8)
    assert not refuted.proved
    x, y = map(Fraction, refuted.counterexample)
    assert x * x + y * y - x * y < Fraction(4, 5) * y * y
    undecided = of(0.75)
    assert not undecided.proved
    assert undecided.counterexample is None
