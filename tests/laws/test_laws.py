"""Each law's Lyapunov function decays as stated, along the exact motion of its command."""

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.laws.barrier_lyapunov import BarrierLyapunov
from clfcbf.laws.kanayama import Kanayama, Samson
from clfcbf.laws.park_kuipers import ParkKuipers
from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist, arc
from clfcbf.unicycle import Polar, polar, tracking_error

HALF = math.radians(35.0)
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
H = 1e-5

metre = st.floats(-0.6, 0.6)
gain = st.floats(0.1, 10.0)
errors = st.builds(Pose2, metre, metre, st.floats(-2.8, 2.8))
references = st.builds(Twist, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))


def rate(function, moved):
    """Central difference in time of ``function`` along the exact motion ``moved(t)``."""
    return (function(moved(H)) - function(moved(-H))) / (2.0 * H)


def tracked(error, reference, twist):
    return lambda t: arc(twist, t).relative(error.compose(arc(reference, t)))


def approached(state, twist):
    return lambda t: Polar.of(arc(twist, t).relative(state.pose()))


# --- tracking ---------------------------------------------------------------------------------


@settings(deadline=None)
@given(errors, references, gain, gain, gain)
def test_kanayama_decays_forward_and_reverse(error, reference, k1, k2, k3):
    law = Kanayama(k1, k2, k3)
    command = law.command(error, reference)
    measured = rate(law.lyapunov, tracked(error, reference, command))
    scale = 1.0 + abs(command.v) + abs(command.omega) ** 3
    assert measured == pytest.approx(-law.decay(error, reference), abs=1e-7 * scale)
    assert law.decay(error, reference) >= 0.0


@settings(deadline=None)
@given(errors, references, gain, gain, gain)
def test_samson_decays_forward_and_reverse(error, reference, k1, gamma, k):
    law = Samson(k1, gamma, k)
    command = law.command(error, reference)
    measured = rate(law.lyapunov, tracked(error, reference, command))
    scale = (1.0 + abs(command.v) + abs(command.omega)) ** 3 / min(gamma, 1.0)
    assert measured == pytest.approx(-law.decay(error), abs=1e-7 * scale)


def test_uncorrected_kanayama_would_grow_in_reverse():
    """With v_V in place of its magnitude the Lyapunov function grows: the magnitude matters."""
    law, error, reference = Kanayama(), Pose2(0.0, 0.1, 0.5), Twist(-0.2, 0.0)
    good = law.command(error, reference)
    printed = Twist(good.v, good.omega - 2.0 * law.k3 * abs(reference.v) * math.sin(error.theta))
    assert rate(law.lyapunov, tracked(error, reference, good)) < 0.0
    assert rate(law.lyapunov, tracked(error, reference, printed)) > 0.0


@settings(max_examples=15, deadline=None)
@given(
    st.builds(Pose2, metre, st.floats(-0.3, 0.3), st.floats(-0.8, 0.8)),
    st.sampled_from([0.2, -0.2]),
    st.floats(-0.2, 0.2),
    st.sampled_from([Kanayama(), Samson()]),
)
def test_tracking_converges_while_the_reference_moves(error, v, omega, law):
    reference = Twist(v, omega)

    def slope(_, e):
        pose = Pose2(*e)
        return tracking_error(pose, reference).rate(law.command(pose, reference))

    out = solve_ivp(slope, (0.0, 60.0), error, rtol=1e-8, atol=1e-10)
    assert out.y[:, -1] == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)


@settings(deadline=None)
@given(errors, references, st.sampled_from([Kanayama(), Samson()]))
def test_tracking_mirror_image(error, reference, law):
    v, omega = law.command(error, reference)
    x, y, theta = error
    mirrored = law.command(Pose2(x, -y, -theta), Twist(reference.v, -reference.omega))
    assert mirrored == pytest.approx((v, -omega), abs=1e-12)


@pytest.mark.parametrize("law", [Kanayama(), Samson()])
def test_no_error_gives_the_feedforward(law):
    reference = Twist(0.2, -0.1)
    assert law.command(Pose2(0.0, 0.0, 0.0), reference) == reference
    assert law.lyapunov(Pose2(0.0, 0.0, 0.0)) == 0.0


# --- graceful motion --------------------------------------------------------------------------

states = st.builds(Polar, st.floats(0.1, 3.0), st.floats(-2.5, 2.5), st.floats(-2.5, 2.5))
graceful = st.builds(
    ParkKuipers,
    k_phi=st.floats(0.5, 5.0),
    k_delta=st.floats(0.5, 5.0),
    bearing_limit=st.floats(0.2, 0.5 * math.pi),
)


@settings(deadline=None)
@given(states, graceful)
def test_graceful_motion_decays(state, law):
    twist = law.command(state, LIMITS)
    assume(abs(state.delta) + 2.0 * H < math.pi)
    measured = rate(law.lyapunov, approached(state, twist))
    assert measured == pytest.approx(-law.decay(state, twist.v), rel=1e-5, abs=1e-5)


@settings(deadline=None)
@given(st.floats(-3.0, 3.0), graceful)
def test_manifold_and_its_slope(delta, law):
    assert abs(law.manifold(delta)) < law.bearing_limit
    slope = (law.manifold(delta + H) - law.manifold(delta - H)) / (2.0 * H)
    assert law.manifold_slope(delta) == pytest.approx(slope, abs=1e-6)


@settings(deadline=None)
@given(st.floats(-3.0, 3.0))
def test_standard_law_has_the_published_manifold(delta):
    assert ParkKuipers().manifold(delta) == pytest.approx(math.atan(3.0 * delta), abs=1e-14)


@settings(deadline=None)
@given(states)
def test_standard_curvature_as_published(state):
    """In the authors' own variables: delta' = -phi, phi' = -delta."""
    r, d, p, k1, k2 = state.rho, -state.phi, -state.delta, 3.0, 2.0
    published = (
        -(k2 * (d - math.atan(-k1 * p)) + (1.0 + k1 / (1.0 + (k1 * p) ** 2)) * math.sin(d)) / r
    )
    assert ParkKuipers().curvature(state) == pytest.approx(published, rel=1e-12, abs=1e-12)


@settings(deadline=None)
@given(st.floats(0.1, 3.0), st.floats(-3.0, 3.0), st.floats(0.2, 1.5), st.floats(0.05, 0.99))
def test_view_is_forward_invariant_under_the_saturated_law(rho, delta, half, share):
    """On either edge the bearing turns inward."""
    law = ParkKuipers(bearing_limit=share * half)
    for side in (1.0, -1.0):
        state = Polar(rho, side * half, delta)
        bearing_rate = polar(state).rate(law.command(state, LIMITS))[1]
        assert side * bearing_rate < 0.0


def simulate(law, start, stop, limits=LIMITS):
    def slope(_, s):
        state = Polar(*s)
        return polar(state).rate(law.command(state, limits))

    def near(_, s):
        return s[0] - stop

    near.terminal = True
    return solve_ivp(slope, (0.0, 200.0), start, events=near, rtol=1e-9, atol=1e-11, max_step=0.5)


@settings(max_examples=12, deadline=None)
@given(st.floats(1.0, 2.5), st.floats(-0.6, 0.6), st.floats(-1.0, 1.0))
def test_saturated_law_arrives_in_view(rho, phi, delta):
    out = simulate(ParkKuipers(bearing_limit=0.9 * HALF), Polar(rho, phi, delta), 0.01)
    assert out.status == 1
    assert max(abs(out.y[1])) <= max(HALF, abs(phi)) + 1e-9
    assert abs(out.y[2, -1]) < 0.05


@settings(deadline=None)
@given(states, graceful)
def test_graceful_speeds_stay_within_limits(state, law):
    v, omega = law.command(state, LIMITS)
    assert 0.0 < v <= LIMITS.v_max
    assert abs(omega) <= LIMITS.omega_max * (1.0 + 1e-12)
    assert omega == pytest.approx(law.curvature(state) * v, rel=1e-12)


@settings(deadline=None)
@given(st.floats(0.01, 1.0))
def test_graceful_speed_on_the_axis_is_proportional_near_the_goal(rho):
    v, omega = ParkKuipers(slowdown_radius=0.4).command(Polar(rho, 0.0, 0.0), LIMITS)
    assert v == pytest.approx(LIMITS.v_max * min(1.0, rho / 0.4), rel=1e-12)
    assert omega == 0.0


def test_graceful_speed_in_a_bend_as_published():
    law, state = ParkKuipers(), Polar(1.0, 0.2, -0.3)
    kappa = law.curvature(state)
    v, _ = law.command(state, Limits(0.22, 10.0, 0.3, 1.0))
    assert abs(kappa) > 0.1
    assert v == pytest.approx(0.22 / (1.0 + 0.4 * kappa**2), rel=1e-12)


# --- barrier Lyapunov -------------------------------------------------------------------------

inside = st.builds(
    Polar, st.floats(0.3, 3.0), st.floats(-0.95 * HALF, 0.95 * HALF), st.floats(-1.2, 1.2)
)
barriers = st.builds(
    BarrierLyapunov,
    st.just(HALF),
    stiffness=st.floats(1.0, 30.0),
    damping=st.floats(0.5, 12.0),
    rate=st.floats(0.05, 1.0),
)


@settings(deadline=None)
@given(inside, barriers)
def test_barrier_lyapunov_decays(state, law):
    k = law.largest_rate(state, LIMITS)
    twist = law.command(state, LIMITS)
    measured = rate(law.lyapunov, approached(state, twist))
    assert measured == pytest.approx(-law.decay(state, k), rel=1e-5, abs=1e-6)
    half_square = rate(lambda s: 0.5 * s.rho**2, approached(state, twist))
    assert half_square == pytest.approx(-k * (state.rho * math.cos(state.phi)) ** 2, abs=1e-6)


@settings(deadline=None)
@given(inside, barriers, st.floats(0.0, 1.0))
def test_any_rate_stays_on_the_same_path(state, law, share):
    full, slow = law.command(state, LIMITS), law.shape(state).scaled(share)
    assert full.v * slow.omega == pytest.approx(slow.v * full.omega, abs=1e-12)


@settings(deadline=None)
@given(st.floats(0.3, 3.0), st.floats(-1.2, 1.2), st.sampled_from([1, -1]), barriers)
def test_bearing_turns_inward_at_the_edge(rho, delta, side, law):
    state = Polar(rho, side * HALF, delta)
    k = law.largest_rate(state, LIMITS)
    bearing_rate = polar(state).rate(law.command(state, LIMITS))[1]
    assert bearing_rate == pytest.approx(-side * k * law.damping * HALF, rel=1e-9)


@settings(deadline=None)
@given(
    st.builds(Polar, st.floats(0.3, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
    barriers,
    st.sampled_from([-0.22, -0.1, 0.0]),
)
def test_barrier_law_keeps_the_speed_limits_everywhere(state, law, v_min):
    limits = Limits(0.22, 0.4, 0.3, 1.0, v_min=v_min)
    twist = law.command(state, limits)
    assert limits.contains(twist, 1e-12)
    assert math.isfinite(twist.v + twist.omega)


@settings(max_examples=12, deadline=None)
@given(st.floats(1.0, 2.5), st.floats(-0.55, 0.55), st.floats(-0.5, 0.5))
def test_barrier_law_keeps_the_feature_in_view(rho, phi, delta):
    law = BarrierLyapunov(HALF)
    out = simulate(law, Polar(rho, phi, delta), 0.6)
    assert out.status == 1
    assert max(abs(out.y[1])) < HALF
    values = [law.lyapunov(Polar(*s)) for s in out.y.T]
    assert all(b <= a + 1e-8 for a, b in pairwise(values))


@settings(max_examples=15, deadline=None)
@given(
    st.floats(0.8, 2.5),
    st.floats(-0.3, 0.3),
    st.floats(-0.5, 0.5),
    st.sampled_from([(6.0, 5.0), (25.0, 10.0), (25.0, 4.0)]),
)
def test_predicted_line_of_sight_of_a_small_start(rho, phi, delta, gains):
    """Scaled down, the motion is linear: distinct, double and complex roots."""
    small = 1e-4
    law = BarrierLyapunov(HALF, stiffness=gains[0], damping=gains[1])
    start = Polar(rho, small * phi, small * delta)
    out = simulate(law, start, 0.6)
    assert law.predicted_delta(start, 0.6) == pytest.approx(out.y[2, -1], abs=1e-4 * small)


def test_double_root_by_hand():
    law, T = BarrierLyapunov(HALF), math.log(2.0)
    expected = (0.3 + (0.1 + 5.0 * 0.3) * T) * math.exp(-5.0 * T)
    assert law.predicted_delta(Polar(1.2, 0.1, 0.3), 0.6) == pytest.approx(expected, rel=1e-12)


# --- both polar laws --------------------------------------------------------------------------


@settings(deadline=None)
@given(
    inside, st.sampled_from([ParkKuipers(), ParkKuipers(bearing_limit=0.5), BarrierLyapunov(HALF)])
)
def test_polar_mirror_image(state, law):
    v, omega = law.command(state, LIMITS)
    mirrored = law.command(Polar(state.rho, -state.phi, -state.delta), LIMITS)
    assert mirrored == pytest.approx((v, -omega), abs=1e-12)


def test_bad_gains_and_states():
    with pytest.raises(ConfigurationError, match=r"Kanayama: gain k2 .* got 0"):
        Kanayama(k2=0.0)
    with pytest.raises(ConfigurationError, match="gamma"):
        Samson(gamma=math.nan)
    with pytest.raises(ConfigurationError, match="bearing_limit"):
        ParkKuipers(bearing_limit=35.0)
    with pytest.raises(ConfigurationError, match="exponent"):
        ParkKuipers(exponent=-1.0)
    with pytest.raises(ConfigurationError, match="half_angle"):
        BarrierLyapunov(35.0)
    with pytest.raises(ConfigurationError, match="damping"):
        BarrierLyapunov(HALF, damping=-1.0)
    for rho in (0.0, math.nan):
        with pytest.raises(GeometryError, match="range"):
            ParkKuipers().command(Polar(rho, 0.0, 0.0), LIMITS)
    law = BarrierLyapunov(HALF)
    for call in (law.lyapunov, lambda state: law.decay(state, 1.0)):
        with pytest.raises(GeometryError, match="half angle"):
            call(Polar(1.0, HALF, 0.0))
    with pytest.raises(GeometryError, match="standoff"):
        law.predicted_delta(Polar(0.5, 0.0, 0.0), 0.6)
