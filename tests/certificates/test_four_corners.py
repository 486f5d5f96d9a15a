r"""Certificate: four corners and a blur answer for every way in which coasting and braking mix.

The body coasts by E in [0, tau] seconds' worth of b and follows S in [0, T_eff] seconds' worth
of u. The position is the integral of the one-form (v cos, v sin) dS + (v_b cos, v_b sin) dE of
the heading :math:`\omega S + \omega_b E`, along a monotone path in the rectangle.
"""

import math

import numpy as np
import pytest
import sympy
import z3
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import Sweep
from clfcbf.constraints.cbf import FieldOfViewBarrier, camera_edges
from clfcbf.estimation import body_after
from clfcbf.guard import Brake, Guard
from clfcbf.limits import Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc
from tests.certificates.smt import proved, reals

PERIOD = 1 / 30
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))


def test_the_exterior_derivative():
    r"""d of the one-form is :math:`(v_b\omega - v\omega_b)(-\sin, \cos)\,dS\wedge dE`."""
    S, E, v, omega, v_b, omega_b = sympy.symbols("S E v omega v_b omega_b", real=True)
    heading = omega * S + omega_b * E
    strength = v_b * omega - v * omega_b
    for along, expected in (
        (sympy.cos(heading), -strength * sympy.sin(heading)),
        (sympy.sin(heading), strength * sympy.cos(heading)),
    ):
        derivative = sympy.diff(v_b * along, S) - sympy.diff(v * along, E)
        assert sympy.simplify(derivative - expected) == 0
    # So by Green two orders differ by an integral of vectors of this length over the area between.
    length = sympy.sqrt((strength * sympy.sin(heading)) ** 2 + (strength * sympy.cos(heading)) ** 2)
    assert sympy.simplify(length - sympy.Abs(strength)) == 0


def staircase(rng, S, E, steps):
    """A monotone path from (0, 0) to (S, E): parts of S and of E, in a random order."""
    parts = []
    for total, kind in ((S, 0), (E, 1)):
        cuts = np.sort(rng.uniform(0.0, total, steps - 1))
        parts += [(kind, float(part)) for part in np.diff([0.0, *cuts, total])]
    order = rng.permutation(len(parts))
    return [parts[i] for i in order]


def along(path, u, b):
    """Poses after each part of a path, by exact arcs."""
    pose, poses = Pose2(0.0, 0.0, 0.0), []
    for kind, part in path:
        pose = pose.compose(arc(b if kind else u, part))
        poses.append(pose)
    return poses


def blur(u, b, S, E):
    return abs(b.v * u.omega - u.v * b.omega) * S * E


def test_no_order_strays_further_than_the_blur():
    """Exact arcs, 3,000 random orders: within it, and within half of it they are not."""
    rng = np.random.default_rng(1)
    worst = 0.0
    for i in range(3_000):
        scale = 10.0 ** rng.uniform(-2, 0)
        u = Twist(*rng.uniform((-0.5, -1.0), (0.5, 1.0)))
        b = Twist(*rng.uniform((-0.5, -1.0), (0.5, 1.0)))
        S, E = scale * rng.uniform(0.1, 1.0, 2)
        path = staircase(rng, S, E, 6) if i % 3 else [(0, S), (1, E)]
        end = along(path, u, b)[-1]
        coast_first = arc(b, E).compose(arc(u, S))
        assert end.theta == pytest.approx(coast_first.theta, abs=1e-12)
        strayed = math.hypot(end.x - coast_first.x, end.y - coast_first.y)
        bound = blur(u, b, S, E)
        assert strayed <= bound + 1e-15
        worst = max(worst, strayed / bound)
    assert worst > 0.99


@given(
    st.floats(0.05, 1.0), st.floats(-1.0, 1.0), st.floats(0.2, 2.0), st.floats(0.2, 4.0),
    st.floats(1e-3, 0.3),
)  # fmt: skip
def test_a_lagging_body_takes_such_a_path(v, omega, a_max, alpha_max, lag):
    """The twist is e b + s u with e, s >= 0; E stays within the lag, S within T_eff."""
    limits = Limits(1.0, 1.0, a_max, alpha_max)
    brake = Brake(Twist(v, omega), limits.brake_ticks(Twist(v, omega), PERIOD))
    effective = 0.5 * PERIOD * (brake.ticks + 1)
    coast, follow = Twist(1.0, 0.0), Twist(0.0, 0.0)
    coasted = followed = 0.0
    for _ in range(brake.ticks + 400):
        share = brake.twist.v / v
        coast, coast_mean = body_after(coast, Twist(0.0, 0.0), PERIOD, lag)
        follow, follow_mean = body_after(follow, Twist(share, 0.0), PERIOD, lag)
        assert coast_mean.v >= 0.0
        assert follow_mean.v >= 0.0
        coasted += PERIOD * coast_mean.v
        followed += PERIOD * follow_mean.v
        assert coasted <= lag + 1e-12
        assert followed <= effective + 1e-12
        brake = brake.next()
    assert coasted == pytest.approx(lag, abs=1e-9)
    assert followed == pytest.approx(effective, abs=1e-9)


def test_a_disc_is_in_view_when_its_centre_is_seen_from_further_ahead():
    """An edge: n·(q + w) >= 0 for all |w| <= B just when n·q >= B, as seen from B/sin ahead."""
    n_x, n_y, q_x, q_y, w_x, w_y, radius, sine = reals("n_x n_y q_x q_y w_x w_y B sin")
    e_x, e_y = reals("e_x e_y")
    unit = (n_x * n_x + n_y * n_y == 1, radius >= 0)
    inside = n_x * q_x + n_y * q_y >= radius
    disc = w_x * w_x + w_y * w_y <= radius * radius
    assert proved(n_x * (q_x + w_x) + n_y * (q_y + w_y) >= 0, *unit, inside, disc)
    nearest = n_x * (q_x - radius * n_x) + n_y * (q_y - radius * n_y)
    assert proved(z3.Implies(nearest >= 0, inside), *unit)
    # e along the axis makes the angle Phi with both edges: n·e = sin(Phi).
    axis = (n_x * e_x + n_y * e_y == sine, sine > 0)
    shifted = n_x * (q_x - radius / sine * e_x) + n_y * (q_y - radius / sine * e_y) >= 0
    assert proved(shifted == inside, *unit, *axis)
    unshifted = n_x * (q_x - radius * e_x) + n_y * (q_y - radius * e_y) >= 0
    assert not proved(unshifted == inside, *unit, *axis)


@given(
    st.floats(0.2, 1.4), st.floats(-1.0, 1.0), st.floats(-0.3, 0.3), st.floats(-0.5, 1.5),
    st.floats(-1.5, 1.5), st.floats(0.0, 0.3),
)  # fmt: skip
def test_the_barrier_with_a_blur_is_that_lemma(half_angle, yaw, offset, x, y, radius):
    camera = FieldOfView(half_angle, Pose2(offset, 0.1, yaw))
    barrier = FieldOfViewBarrier(camera, 1.0)
    point = Pose2(x, y, 0.0)
    clearance = barrier.clearance_along(Scene(point, point, 0.0), Sweep(blur=radius))
    assume(x > 0.0 and abs(yaw) < half_angle)  # what a sweep can be judged for
    distances = [
        edge.normal_x * x + edge.normal_y * y - edge.offset for edge in camera_edges(camera)
    ]
    assume(abs(min(distances) - radius) > 1e-9)
    assert (clearance >= 0.0) == (min(distances) >= radius)


def lowest_at(barrier, scene, motions):
    return min(barrier.clearance(scene, motion) for motion in motions)


def corners_hold(guard, scene, body, brake, blurred):
    """``Guard.admissible``, or the same four corners without their blur."""
    if blurred:
        return guard.admissible(scene, guard.sweep(body, brake))
    coasted = arc(body, guard.lag)
    braked = arc(brake.twist, 0.5 * PERIOD * (brake.ticks + 1))
    motions = (Pose2(0.0, 0.0, 0.0), coasted, braked, coasted.compose(braked))
    return lowest_at(guard.barriers[0], scene, motions) >= 0.0


def hardest_cases(blurred, count, seed):
    """Lowest clearance on paths from states that the corners just admit."""
    rng = np.random.default_rng(seed)
    lowest, tried = math.inf, 0
    barrier = FieldOfViewBarrier(CAMERA, 1.0)
    while tried < count:
        limits = Limits(0.6, 1.5, rng.uniform(0.3, 1.0), rng.uniform(0.8, 2.0))
        guard = Guard(limits, (barrier,), PERIOD, rng.uniform(0.1, 0.4))
        signs = rng.choice([-1.0, 1.0], 4)
        u = Twist(0.6 * signs[0], rng.uniform(0.0, 1.5) * signs[1])
        b = Twist(0.6 * signs[2], rng.uniform(0.0, 1.5) * signs[3])
        brake = guard.brake_from(u)
        reach = rng.uniform(0.6, 1.5)

        def scene(bearing, reach=reach):
            point = Pose2(0.2 + reach * math.cos(bearing), reach * math.sin(bearing), 0.0)
            return Scene(point, point, 0.0)

        # The last bearing that is admitted, going left from one that is.
        low, high = 0.0, CAMERA.half_angle
        if not corners_hold(guard, scene(low), b, brake, blurred):
            continue
        for _ in range(40):
            middle = 0.5 * (low + high)
            fits = corners_hold(guard, scene(middle), b, brake, blurred)
            low, high = (middle, high) if fits else (low, middle)
        S, E = 0.5 * PERIOD * (brake.ticks + 1), guard.lag
        edge = scene(low)
        for path in (
            [(0, S / 8)] * 8 + [(1, E / 8)] * 8,
            [(1, E / 8)] * 8 + [(0, S / 8)] * 8,
            *(staircase(rng, S, E, 5) for _ in range(3)),
        ):
            lowest = min(lowest, lowest_at(barrier, edge, along(path, u, b)))
        tried += 1
    return lowest


def test_what_is_admitted_stays_in_view_on_every_path():
    assert hardest_cases(True, 400, 3) >= -1e-9


def test_corners_without_their_blur_are_not_enough():
    assert hardest_cases(False, 400, 3) < -math.radians(0.05)
