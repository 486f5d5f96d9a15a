r"""Certificate: the viable set is control invariant under bounded accelerations.

Where the rate is :math:`p = s\dot\varphi > 0`, s = 1 or -1, and
:math:`d'(p) = p/(\alpha_{max} - k_vp)`, its witness :math:`\alpha = s\alpha_{max}`,
:math:`a = -(v^2/\rho)\cos\varphi` gives :math:`\dot b_s = p^2(k_v -
(v/\rho)\cos\varphi)/(\alpha_{max} - k_vp) \ge 0`, and :math:`\dot b_v = -(v/\rho)\cos\varphi\,
b_v`.
"""

import pytest
import sympy
import z3

from clfcbf.constraints.viable import stopping_angle
from tests.certificates.smt import proved, reals

RHO, ALPHA_MAX, K = sympy.symbols("rho alpha_max k_v", positive=True)
PHI, V, W = sympy.symbols("varphi v omega", real=True)
ACCELERATIONS = sympy.symbols("a alpha", real=True)


def bearing_rate():
    return V / RHO * sympy.sin(PHI) - W


def derivative(expression, a, alpha):
    """Along the motion, from the polar kinematics alone."""
    rates = {RHO: -V * sympy.cos(PHI), PHI: bearing_rate(), V: a, W: alpha}
    return sum(expression.diff(symbol) * rate for symbol, rate in rates.items())


def braking_angle(p):
    return -p / K - ALPHA_MAX / K**2 * sympy.log(1 - K * p / ALPHA_MAX)


def is_zero(expression):
    return sympy.simplify(expression) == 0


def test_the_braking_angle_is_the_solution_of_its_equation():
    r"""d'(p) = p/(alpha_max - k_v p) and d(0) = 0, as :math:`p\,dp/d\varphi = -\alpha + k_vp`."""
    p = sympy.symbols("p", real=True)
    assert is_zero(braking_angle(p).diff(p) - p / (ALPHA_MAX - K * p))
    assert braking_angle(sympy.Integer(0)) == 0
    series = sympy.series(braking_angle(p), p, 0, 4).removeO()
    assert is_zero(series - p**2 / (2 * ALPHA_MAX) - K * p**3 / (3 * ALPHA_MAX**2))
    for share in (1e-4, 0.3, 0.9):
        rate = share * 0.8 / 0.6
        exact = braking_angle(p).subs({p: rate, K: 0.6, ALPHA_MAX: 0.8}).evalf(40)
        assert stopping_angle(rate, 0.8, 0.6) == pytest.approx(float(exact), rel=1e-9)


def test_the_bearing_acceleration():
    a, alpha = ACCELERATIONS
    q = V / RHO
    stated = (
        -alpha + a / RHO * sympy.sin(PHI) + q**2 * sympy.sin(PHI) * sympy.cos(PHI)
        + q * sympy.cos(PHI) * bearing_rate()
    )  # fmt: skip
    assert is_zero(derivative(bearing_rate(), a, alpha) - stated)


@pytest.mark.parametrize("side", [1, -1])
def test_rates_of_the_barriers_under_the_witness(side):
    p = side * bearing_rate()
    witness = -(V**2) / RHO * sympy.cos(PHI), side * ALPHA_MAX
    growth = V / RHO * sympy.cos(PHI)
    rate = derivative(-side * PHI - braking_angle(p), *witness)
    assert is_zero(rate - p**2 * (K - growth) / (ALPHA_MAX - K * p))
    approach = K * RHO - V
    assert is_zero(derivative(approach, *witness) + growth * approach)


@pytest.mark.parametrize("side", [1, -1])
def test_the_row_is_the_rate_of_the_barrier(side):
    """For any accelerations: what ``ViableSet.rows`` documents."""
    a, alpha = ACCELERATIONS
    p, q = side * bearing_rate(), V / RHO
    slope = p / (ALPHA_MAX - K * p)
    left = slope * side * (alpha - a / RHO * sympy.sin(PHI))
    drift = q**2 * sympy.sin(PHI) * sympy.cos(PHI) + q * sympy.cos(PHI) * bearing_rate()
    rate = derivative(-side * PHI - braking_angle(p), a, alpha)
    assert is_zero(rate - (left - p - slope * side * drift))


v, rho, c, s, p, w, k, b, gain, period, alpha_max, a_max, v_max, w_max, sin_edge = reals(
    "v rho c s p omega k_v b gamma T alpha_max a_max v_max omega_max sin_Phi"
)
VIEW = (rho > 0, c >= 0, c <= 1, s * s + c * c == 1, -sin_edge <= s, s <= sin_edge, sin_edge > 0)
SLOW = (v >= 0, v <= v_max, v <= k * rho, k > 0)
RATED = (p > 0, k * p < alpha_max)
DESIGN = (k * v_max <= a_max, k * sin_edge + alpha_max * period <= w_max, period > 0, alpha_max > 0)


def test_the_witness_meets_the_rows():
    """In z3, from the closed form of the rates above: for every gain of at least k_v."""
    growth = v / rho * c
    rate = p * p * (k - growth) / (alpha_max - k * p)
    inside = (*VIEW, *SLOW, *RATED, b >= 0, gain >= k)
    assert proved(rate >= -gain * b, *inside)
    assert proved(-growth * b >= -gain * b, *inside)
    # Below k_v the row of the approach is not met, above k_v rho that of the bearing is not.
    assert not proved(-growth * b >= -gain * b, *VIEW, *SLOW, b >= 0, gain >= k / 2)
    fast = (*VIEW, *RATED, v >= 0, v <= 2 * k * rho, k > 0, b >= 0, gain >= k)
    assert not proved(rate >= -gain * b, *fast)


def test_a_braking_angle_without_the_growth_is_not_invariant():
    """d = p²/(2 alpha_max): its barrier falls at its own zero, however hard one brakes."""
    growth = v / rho * c
    rate = -p + p / alpha_max * (alpha_max - growth * p)
    assert not proved(rate >= 0, *VIEW, *SLOW, *RATED)
    assert proved(rate <= 0, *VIEW, *SLOW, *RATED)


def test_the_witness_is_inside_the_limits():
    deceleration = v * v / rho * c
    inside = (*VIEW, *SLOW, *DESIGN)
    assert proved(z3.And(deceleration >= 0, deceleration <= a_max), *inside)
    # Held for a period it does not reverse, while k_v T <= 1.
    assert proved(v - deceleration * period >= 0, *inside, k * period <= 1)
    assert not proved(v - deceleration * period >= 0, *inside, k * period <= 2)
    # It turns up the turn rate only while the bearing outruns it: p = (v/rho) sin - omega > 0.
    turning = (w == v / rho * s - p, p > 0, w >= -w_max)
    held = w + alpha_max * period
    assert proved(z3.And(held <= w_max, held >= -w_max), *inside, *turning)
    wide = (*VIEW, *SLOW, k * sin_edge <= w_max, period > 0, alpha_max > 0)
    assert not proved(held <= w_max, *wide, *turning)


def test_the_other_row_asks_for_nothing():
    """Of two opposite rows the one of an inward rate reads 0 >= p - gamma b, with p < 0 <= b."""
    assert proved(-p - gain * b <= 0, p >= 0, b >= 0, gain > 0)
    assert not proved(p - gain * b <= 0, p >= 0, b >= 0, gain > 0)
