"""Lyapunov rows against finite differences along the exact motion of both frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.constraints.clf import kanayama_clf, quadratic_clf, quartic_clf, strict_clf
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.constraints.weights import check_weights
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.laws.kanayama import Kanayama
from clfcbf.se2 import Pose2, Twist, arc

FULL = ((1.0, 0.2, 0.0), (0.2, 1.6, 0.5), (0.0, 0.5, 0.6))
MU = 0.7
GAINS = Kanayama(1.0, 8.0, 6.0)
SIGMA = 0.6
EPSILON = 0.3

unit = st.floats(-1.0, 1.0)
errors = st.builds(Pose2, unit, unit, st.floats(-3.0, 3.0))
twists = st.builds(Twist, st.floats(-0.5, 0.5), st.floats(-1.0, 1.0))
positive = st.floats(0.05, 20.0)
gain_sets = st.builds(Kanayama, positive, positive, positive)
builders = pytest.mark.parametrize("case", ["diagonal", "full", "quadratic", "kanayama", "strict"])


def energy(error: Pose2, weights: tuple[tuple[float, ...], ...]) -> float:
    vector = np.array(error)
    return float(vector @ np.array(weights) @ vector)


def diagonal(*values: float) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, np.diag(values).tolist()))


def function_of(case: str, reference: Twist) -> Callable[[Pose2], float]:
    side = math.copysign(1.0, reference.v)
    return {
        "diagonal": lambda e: 0.25 * energy(e, diagonal(1.0, 2.0, 0.5)) ** 2,
        "full": lambda e: 0.25 * energy(e, FULL) ** 2,
        "quadratic": lambda e: 0.5 * energy(e, FULL),
        "kanayama": lambda e: 0.5 * (e.x**2 + e.y**2) + (1.0 - math.cos(e.theta)) / 8.0,
        "strict": lambda e: (
            0.5 * (e.x**2 + e.y**2)
            + (1.0 - math.cos(e.theta)) / 8.0
            + EPSILON * side * e.y * math.sin(e.theta)
        ),
    }[case]


def rows_of(case: str, error: Pose2, reference: Twist) -> Rows:
    if case == "diagonal":
        return quartic_clf(error, reference, (1.0, 2.0, 0.5), MU)
    if case == "full":
        return quartic_clf(error, reference, FULL, MU)
    if case == "quadratic":
        return quadratic_clf(error, reference, FULL, MU)
    if case == "kanayama":
        return kanayama_clf(error, reference, GAINS, SIGMA)
    return strict_clf(error, reference, GAINS, EPSILON, MU)


def rate_of(case: str, error: Pose2, reference: Twist) -> float:
    if case == "kanayama":
        sine = math.sin(error.theta)
        return SIGMA * (error.x**2 + 6.0 / 8.0 * abs(reference.v) * sine**2)
    return MU * function_of(case, reference)(error)


def moved(error: Pose2, reference: Twist, command: Twist, time: float) -> Pose2:
    """The error after both frames moved along their exact arcs."""
    return arc(command, time).relative(error.compose(arc(reference, time)))


def derivative(function: Callable[[float], float], step: float = 1e-3) -> float:
    """Central difference of order six."""
    weights = ((1, 45.0), (2, -9.0), (3, 1.0))
    return sum(w * (function(k * step) - function(-k * step)) for k, w in weights) / (60.0 * step)


@builders
@given(error=errors, reference=twists, command=twists)
def test_row_is_the_rate_along_exact_motion(
    case: str, error: Pose2, reference: Twist, command: Twist
) -> None:
    rows = rows_of(case, error, reference)
    V = function_of(case, reference)
    assert rows.values[0] == pytest.approx(V(error), rel=1e-12, abs=1e-14)
    measured = derivative(lambda t: V(moved(error, reference, command, t)))
    ((a_v, a_w, b),) = rows.coefficients
    excess = a_v * command.v + a_w * command.omega - b
    assert excess == pytest.approx(measured + rate_of(case, error, reference), rel=1e-8, abs=1e-9)
    assert rows.priority == Priority.STABILITY
    assert rows.names[0].startswith("clf.")


@pytest.mark.parametrize("case", ["diagonal", "kanayama", "strict"])
@given(error=errors, reference=twists)
def test_mirror_image(case: str, error: Pose2, reference: Twist) -> None:
    """Left and right are alike (for a weight that does not couple y and theta to x)."""
    x, y, theta = error
    ((a_v, a_w, b),) = rows_of(case, error, reference).coefficients
    mirrored = rows_of(case, Pose2(x, -y, -theta), Twist(reference.v, -reference.omega))
    assert mirrored.coefficients[0] == pytest.approx((a_v, -a_w, b), rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("case", ["diagonal", "kanayama", "strict"])
@given(error=errors, reference=twists)
def test_reverse_is_forward_turned_around(case: str, error: Pose2, reference: Twist) -> None:
    """Front and back exchanged is a half turn of both frames: x, y, v and v_V change sign."""
    x, y, theta = error
    v, omega = reference
    assume(v != 0.0)
    ((a_v, a_w, b),) = rows_of(case, error, reference).coefficients
    turned = rows_of(case, Pose2(-x, -y, theta), Twist(-v, omega))
    assert turned.coefficients[0] == pytest.approx((-a_v, a_w, b), rel=1e-13, abs=1e-15)


@given(error=errors, reference=twists, gains=gain_sets, fraction=st.floats(0.01, 1.0))
def test_kanayama_law_is_a_witness_forward_and_in_reverse(
    error: Pose2, reference: Twist, gains: Kanayama, fraction: float
) -> None:
    x, y, theta = error
    v, omega = reference
    k1, k2, k3 = gains.k1, gains.k2, gains.k3
    law = Twist(v * math.cos(theta) + k1 * x, omega + k2 * v * y + k3 * abs(v) * math.sin(theta))
    ((a_v, a_w, b),) = kanayama_clf(error, reference, gains, fraction).coefficients
    decrease = k1 * x * x + k3 / k2 * abs(v) * math.sin(theta) ** 2
    scale = 1.0 + abs(a_v * law.v) + abs(a_w * law.omega) + abs(b)
    # V' = -W exactly, so the law has (1 - sigma) W to spare.
    assert b - a_v * law.v - a_w * law.omega == pytest.approx(
        (1.0 - fraction) * decrease, abs=1e-12 * scale
    )


@given(reference=st.builds(Twist, st.floats(-0.5, -0.05), unit), theta=st.floats(0.1, 3.0))
def test_law_with_signed_speed_fails_the_row_in_reverse(reference: Twist, theta: float) -> None:
    """The law as first published drives V up in reverse; the row must say so."""
    error = Pose2(0.0, 0.3, theta)
    v, omega = reference
    published = Twist(v * math.cos(theta), omega + v * (8.0 * error.y + 6.0 * math.sin(theta)))
    ((a_v, a_w, b),) = kanayama_clf(error, reference, GAINS, 1.0).coefficients
    assert a_v * published.v + a_w * published.omega - b == pytest.approx(
        2.0 * 6.0 / 8.0 * abs(v) * math.sin(theta) ** 2, rel=1e-9
    )


@given(error=errors, reference=st.builds(Twist, st.floats(0.01, 0.5), unit))
def test_strict_rate_under_the_law_term_by_term(error: Pose2, reference: Twist) -> None:
    x, y, theta = error
    v, omega = reference
    k1, k2, k3 = 1.0, 8.0, 6.0
    s, c = math.sin(theta), math.cos(theta)
    expected = (
        -k1 * x**2
        - EPSILON * k2 * v * c * y**2
        - v * (k3 / k2 - EPSILON) * s**2
        - EPSILON * k3 * v * c * y * s
        - EPSILON * omega * x * s
        - EPSILON * k2 * v * x * y * s
        - EPSILON * k3 * v * x * s**2
    )
    rows = strict_clf(error, reference, GAINS, EPSILON, MU)
    ((a_v, a_w, b),) = rows.coefficients
    law = Twist(v * c + k1 * x, omega + k2 * v * y + k3 * v * s)
    rate = a_v * law.v + a_w * law.omega - b - MU * rows.values[0]
    assert rate == pytest.approx(expected, rel=1e-9, abs=1e-12)


@given(
    error=st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), unit),
    v=st.floats(0.05, 0.22),
    side=st.sampled_from((-1.0, 1.0)),
    omega=st.floats(-0.3, 0.3),
)
def test_law_meets_the_strict_row_in_its_box(
    error: Pose2, v: float, side: float, omega: float
) -> None:
    reference = Twist(side * v, omega)
    law = GAINS.command(error, reference)
    ((a_v, a_w, b),) = strict_clf(error, reference, GAINS).coefficients
    assert a_v * law.v + a_w * law.omega <= b + 1e-9


def test_law_meets_the_strict_row_on_a_grid_with_its_corners() -> None:
    """Dense sampling of the box in which the defaults are stated to work, evaluated at once."""
    k1, k2, k3, mu = 1.0, 8.0, 6.0, 0.1
    x, y, theta, v, omega = np.meshgrid(
        np.linspace(-0.5, 0.5, 21),
        np.linspace(-0.5, 0.5, 21),
        np.linspace(-1.0, 1.0, 41),
        (0.05, 0.1, 0.22),
        (-0.3, 0.0, 0.3),
        sparse=True,
    )
    s, c = np.sin(theta), np.cos(theta)
    V = 0.5 * (x**2 + y**2) + (1 - c) / k2 + EPSILON * y * s
    speed, turn = v * c + k1 * x, omega + k2 * v * y + k3 * v * s
    rate = (
        x * (turn * y - speed + v * c)
        + (y + EPSILON * s) * (-turn * x + v * s)
        + (s / k2 + EPSILON * y * c) * (omega - turn)
    )
    assert np.min(V + 0.0 * rate) >= 0.0
    assert np.max(rate + mu * V) <= 1e-12


@given(error=errors, k2=st.floats(0.5, 20.0), share=st.floats(0.0, 0.99), v=twists)
def test_strict_function_is_definite_over_the_admitted_cross_terms(
    error: Pose2, k2: float, share: float, v: Twist
) -> None:
    assume(max(map(abs, error)) > 1e-3)
    gains = Kanayama(1.0, k2, 1.0)
    assert strict_clf(error, v, gains, share / math.sqrt(k2), MU).values[0] > 0.0


@given(y=st.floats(0.01, 10.0), command=twists, h2=positive, mu=positive, v=st.floats(-1.0, 1.0))
def test_no_command_meets_the_papers_row_at_a_lateral_error(
    y: float, command: Twist, h2: float, mu: float, v: float
) -> None:
    """On x = theta = 0 the gradient along both inputs vanishes: not a Lyapunov function."""
    error, weights = Pose2(0.0, y, 0.0), (1.3, h2, 0.7)
    for build in (quartic_clf, quadratic_clf):
        ((a_v, a_w, b),) = build(error, Twist(v, 0.4), weights, mu).coefficients
        assert (a_v, a_w) == (0.0, 0.0)
        assert b < 0.0
    ((_, _, b),) = quartic_clf(error, Twist(v, 0.4), weights, mu).coefficients
    assert b == pytest.approx(-0.25 * mu * (h2 * y * y) ** 2, rel=1e-12)


def test_kanayama_row_can_be_met_at_a_lateral_error() -> None:
    ((a_v, a_w, b),) = kanayama_clf(Pose2(0.0, 0.4, 0.0), Twist(0.2, 0.1), GAINS, 1.0).coefficients
    assert (a_v, a_w, b) == (0.0, 0.0, 0.0)


@given(
    *(st.integers(-8, 8) for _ in range(3)),
    *(st.integers(1, 8) for _ in range(3)),
)
def test_lateral_line_is_all_there_is(
    x: int, y: int, theta: int, h1: int, h2: int, h3: int
) -> None:
    """In exact rationals: both coefficients vanish on {x = theta = 0} and nowhere else."""
    square = Fraction(h1 * x * x + h2 * y * y + h3 * theta * theta, 64)
    exact = (
        -square * Fraction(h1 * x, 8),
        square * (Fraction((h1 - h2) * x * y, 64) - Fraction(h3 * theta, 8)),
    )
    error = Pose2(x / 8.0, y / 8.0, theta / 8.0)
    rows = quartic_clf(error, Twist(0.0, 0.0), (float(h1), float(h2), float(h3)), 1.0)
    ((a_v, a_w, b),) = rows.coefficients
    assert (Fraction(a_v), Fraction(a_w)) == exact
    assert Fraction(b) == -(square**2) / 4
    assert (a_v == 0.0 and a_w == 0.0) == (x == 0 and theta == 0)


@pytest.mark.parametrize(
    "weights",
    [
        (1.0, 0.0, 1.0),
        (1.0, -1.0, 1.0),
        (1.0, math.nan, 1.0),
        (1.0, math.inf, 1.0),
        (1.0, 1.0),
        (1.0, "a", 1.0),
        ((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((1.0, 0.1, 0.0), (0.2, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0)),
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 1.0),
    ],
)
def test_weights_that_are_not_definite(weights: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigurationError, match="positive definite"):
        check_weights(weights)
    with pytest.raises(ConfigurationError, match="weights"):
        quartic_clf(Pose2(0.1, 0.1, 0.1), Twist(0.1, 0.0), weights, 1.0)


@given(st.lists(unit, min_size=6, max_size=6))
def test_definite_weights_are_those_with_positive_eigenvalues(values: list[float]) -> None:
    a, b, c, d, e, f = values
    weights = ((a, b, c), (b, d, e), (c, e, f))
    least = float(np.linalg.eigvalsh(np.array(weights))[0])
    assume(abs(least) > 1e-9)
    if least > 0.0:
        assert check_weights(weights) == weights
    else:
        with pytest.raises(ConfigurationError):
            check_weights(weights)


@builders
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite(case: str, bad: float) -> None:
    good = (0.1, 0.2, 0.3, 0.2, 0.1)
    for index in range(5):
        x, y, theta, v, omega = (*good[:index], bad, *good[index + 1 :])
        with pytest.raises(GeometryError, match="finite"):
            rows_of(case, Pose2(x, y, theta), Twist(v, omega))


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_settings_out_of_range(bad: float) -> None:
    error, reference = Pose2(0.1, 0.2, 0.3), Twist(0.2, 0.0)
    with pytest.raises(ConfigurationError, match="decay"):
        quartic_clf(error, reference, (1.0, 1.0, 1.0), bad)
    with pytest.raises(ConfigurationError, match="decay"):
        quadratic_clf(error, reference, (1.0, 1.0, 1.0), bad)
    with pytest.raises(ConfigurationError, match="decay"):
        strict_clf(error, reference, GAINS, EPSILON, bad)
    with pytest.raises(ConfigurationError, match="fraction"):
        kanayama_clf(error, reference, GAINS, bad)


def test_more_settings_out_of_range() -> None:
    class Loose:
        k1, k2, k3 = 1.0, 0.0, 1.0

    error, reference = Pose2(0.1, 0.2, 0.3), Twist(0.2, 0.0)
    with pytest.raises(ConfigurationError, match="gains"):
        kanayama_clf(error, reference, Loose(), 0.5)
    with pytest.raises(ConfigurationError, match=r"fraction.*1\.01"):
        kanayama_clf(error, reference, GAINS, 1.01)
    with pytest.raises(ConfigurationError, match="cross_term"):
        strict_clf(error, reference, GAINS, 1.0 / math.sqrt(8.0))
    with pytest.raises(ConfigurationError, match="cross_term"):
        strict_clf(error, reference, GAINS, -0.1)
