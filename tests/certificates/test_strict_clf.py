r"""Certificate: the strict Lyapunov function decays under the Kanayama law, default constants.

With s = sin(theta), c = cos(theta), :math:`\dot V_s + \mu V_s = -Ax^2 + bx + r`, where b and r
are free of x and A > 0. So its largest value over *every* x is :math:`r + b^2/(4A)`, convex in
:math:`(v_V, \omega_V)`: what is left to prove is a function of two variables at four corners.
Near the origin it is bounded by a quadratic form of (y, s) that is negative definite.
"""

import itertools
import math
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.constraints.clf import STRICT_CROSS_TERM, STRICT_DECAY, strict_clf
from clfcbf.laws.kanayama import Kanayama
from clfcbf.se2 import Pose2, Twist
from tests.certificates.branch_and_bound import branch_and_bound
from tests.certificates.intervals import Interval

LATERAL, HEADING = 0.5, 1.0  # |y| [m] and |theta| [rad]
SPEEDS, TURN_RATES = ("0.05", "0.22"), ("-0.3", "0.3")


class Constants(NamedTuple):
    """Gains of the law, cross term and decay, in any arithmetic."""

    k1: object
    k2: object
    k3: object
    cross: object
    decay: object


LAW = Kanayama()
FLOATS = Constants(LAW.k1, LAW.k2, LAW.k3, STRICT_CROSS_TERM, STRICT_DECAY)


def enclosed(constants):
    """The decimal numbers and the floats nearest to them, both."""
    return Constants(*(Interval.of(str(number)) for number in constants))


def square(number):
    return number.square() if isinstance(number, Interval) else number * number


def curvature(k):
    """A, the coefficient of -x²."""
    return k.k1 - k.decay / 2


def linear(k, y, s, v, omega):
    """b, the coefficient of x, divided by -s."""
    return k.cross * (omega + k.k2 * v * y + k.k3 * v * s)


def rest(k, c, v):
    """r as a quadratic form: minus (r11 y² + 2 r12 y s + r22 s²)."""
    return (
        k.cross * k.k2 * v * c - k.decay / 2,
        k.cross * (k.k3 * v * c - k.decay) / 2,
        v * (k.k3 / k.k2 - k.cross) - k.decay / (k.k2 * (1 + c)),
    )


def worst(k, y, s, c, v, omega):
    r"""Largest of :math:`\dot V_s + \mu V_s` over every x, and the form that bounds it."""
    r11, r12, r22 = rest(k, c, v)
    gain = square(linear(k, y, s, v, omega)) / (4 * curvature(k))
    value = square(s) * (gain - r22) - square(y) * r11 - 2 * (y * s) * r12
    return value, (r11, r12, r22 - gain)


def certify(constants, speeds=SPEEDS, heading=HEADING):
    """The first verdict over the corners that is not a proof, else the one of most boxes."""
    k = enclosed(constants)
    verdicts = []
    for v, omega in itertools.product(map(Interval.of, speeds), map(Interval.of, TURN_RATES)):

        def holds(y, theta, v=v, omega=omega):
            value, (n11, n12, n22) = worst(k, y, theta.sin(), theta.cos(), v, omega)
            definite = (n11.lo > 0.0) & ((n11 * n22 - n12.square()).lo > 0.0)
            return (value.hi < 0.0) | definite

        def fails(y, theta, v=v, omega=omega):
            return worst(k, y, theta.sin(), theta.cos(), v, omega)[0].lo > 0.0

        verdict = branch_and_bound(holds, fails, ((-LATERAL, LATERAL), (-heading, heading)))
        if not verdict.proved:
            return verdict, (float(v.middle), float(omega.middle))
        verdicts.append(verdict)
    return max(verdicts, key=lambda verdict: verdict.boxes), None


def test_the_formula_is_the_derivative():
    """Symbolically, from the error dynamics, the law and the function."""
    x, y, theta, v, omega = sympy.symbols("x y theta v omega", real=True)
    s, c = sympy.symbols("s c", real=True)
    k = Constants(*sympy.symbols("k1 k2 k3 epsilon mu", positive=True))
    function = (x**2 + y**2) / 2 + (1 - sympy.cos(theta)) / k.k2 + k.cross * y * sympy.sin(theta)
    command_v = v * sympy.cos(theta) + k.k1 * x
    command_w = omega + k.k2 * v * y + k.k3 * v * sympy.sin(theta)
    rates = {
        x: command_w * y - command_v + v * sympy.cos(theta),
        y: -command_w * x + v * sympy.sin(theta),
        theta: omega - command_w,
    }
    derived = sum(function.diff(z) * rate for z, rate in rates.items()) + k.decay * function
    derived = derived.subs({sympy.sin(theta): s, sympy.cos(theta): c})
    r11, r12, r22 = rest(k, c, v)
    stated = (
        -curvature(k) * x**2 - linear(k, y, s, v, omega) * s * x
        - r11 * y**2 - 2 * r12 * y * s - r22 * s**2
    )  # fmt: skip
    numerator, _ = sympy.fraction(sympy.together(derived - stated))
    assert sympy.rem(sympy.expand(numerator), s**2 + c**2 - 1, s) == 0
    best = -linear(k, y, s, v, omega) * s / (2 * curvature(k))
    value, _ = worst(k, y, s, c, v, omega)
    gap = value - stated - curvature(k) * (x - best) ** 2
    assert sympy.simplify(sympy.expand(gap)) == 0
    assert sympy.diff(rest(k, c, v)[0], v, 2) == sympy.diff(rest(k, c, v)[2], v, 2) == 0


@given(
    st.floats(-2.0, 2.0), st.floats(-LATERAL, LATERAL), st.floats(-HEADING, HEADING),
    st.floats(0.05, 0.22), st.floats(-0.3, 0.3), st.sampled_from([1.0, -1.0]),
)  # fmt: skip
def test_the_row_of_the_library_is_what_is_certified(x, y, theta, v, omega, gear):
    """Residual of ``strict_clf`` under ``Kanayama``: the formula, at most 0; in reverse too."""
    error, reference = Pose2(gear * x, gear * y, theta), Twist(gear * v, omega)
    command = LAW.command(error, reference)
    ((a_v, a_w, bound),) = strict_clf(error, reference, LAW).coefficients
    residual = a_v * command.v + a_w * command.omega - bound
    s, c = math.sin(theta), math.cos(theta)
    r11, r12, r22 = rest(FLOATS, c, v)
    stated = (
        -curvature(FLOATS) * x * x - linear(FLOATS, y, s, v, omega) * s * x
        - r11 * y * y - 2 * r12 * y * s - r22 * s * s
    )  # fmt: skip
    assert residual == pytest.approx(stated, abs=1e-13)
    assert residual <= worst(FLOATS, y, s, c, v, omega)[0] + 1e-13
    assert residual <= 1e-15


def test_it_decays():
    verdict, _ = certify(FLOATS)
    assert verdict.proved
    assert verdict.boxes < 5_000


def test_it_is_positive_definite():
    r"""With p = sin(theta/2), q = cos(theta/2): x²/2 + y²/2 + 2 eps q y p + 2 p²/k2, Sylvester.

    For |q| <= 1 the determinant is at least 1/k2 - eps², in rationals.
    """
    theta = sympy.symbols("theta", real=True)
    half = theta / 2
    identity = (1 - sympy.cos(theta)) - 2 * sympy.sin(half) ** 2
    assert sympy.simplify(identity) == 0
    assert sympy.simplify(sympy.sin(theta) - 2 * sympy.sin(half) * sympy.cos(half)) == 0
    assert determinant(STRICT_CROSS_TERM) > 0


def determinant(cross):
    return 1 / Fraction(LAW.k2) - Fraction(str(cross)) ** 2


def test_a_larger_cross_term_is_not_definite():
    """V_s < 0 at a point with rational sine and cosine."""
    cross, t = Fraction("0.36"), Fraction(1, 50)
    assert determinant(0.36) < 0
    s, q = 2 * t / (1 + t * t), (1 - t * t) / (1 + t * t)  # of theta/2
    y = -2 * cross * q * s
    assert y * y / 2 + 2 * cross * y * q * s + 2 * s * s / Fraction(LAW.k2) < 0


@pytest.mark.parametrize(
    ("wrong", "speeds", "heading"),
    [
        ({"decay": 0.15}, SPEEDS, HEADING),
        ({"cross": 0.0}, SPEEDS, HEADING),
        ({"cross": 0.1}, SPEEDS, HEADING),
        ({"k3": 3.0}, SPEEDS, HEADING),
        ({"k2": 4.0}, SPEEDS, HEADING),
        ({}, ("0.02", "0.22"), HEADING),
        ({}, SPEEDS, 1.3),
    ],
)
def test_a_wrong_constant_is_refuted(wrong, speeds, heading):
    """By a state at which the row of the library, with that constant, is not met by the law."""
    constants = FLOATS._replace(**wrong)
    verdict, reference = certify(constants, speeds, heading)
    assert not verdict.proved
    assert verdict.counterexample is not None
    y, theta = verdict.counterexample
    reference = Twist(*reference)
    s = math.sin(theta)
    x = -linear(constants, y, s, *reference) * s / (2 * curvature(constants))
    law = replace(LAW, k1=constants.k1, k2=constants.k2, k3=constants.k3)
    error = Pose2(x, y, theta)
    (row,) = strict_clf(error, reference, law, constants.cross, constants.decay).coefficients
    assert abs(x) <= 0.5
    assert np.dot(row[:2], law.command(error, reference)) > row[2]


def test_a_sign_of_the_law_is_refuted():
    """The turn rate as printed for forward, driven in reverse: its damping has the wrong sign."""
    assert not certify(FLOATS._replace(k3=-LAW.k3))[0].proved
