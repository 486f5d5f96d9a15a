r"""Certificate: on a constant-twist arc the largest bearing off the forward direction is at an end.

For a body-fixed camera at c, a point q = (X, Y) = p - c seen from it and p = (x, y) from the
rotation centre, with :math:`\varphi = \mathrm{atan2}(Y, X)`: where :math:`\dot\varphi = 0`,
:math:`\ddot\varphi` has the sign of :math:`\varphi`, as long as X > 0 and x > 0. So an interior
extremum is a minimum of :math:`|\varphi|`, and a view that contains the forward direction holds
the arc if it holds its ends. On an arc of less than half a turn both signs follow from the ends.
"""

import math

import numpy as np
import pytest
import sympy
import z3

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.cbf import FieldOfViewBarrier, camera_edges
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc
from tests.certificates.intervals import REACH, Interval
from tests.certificates.smt import proved, reals

SYMBOLS = sympy.symbols("X Y c_x c_y v omega")
DURATION = 0.75  # [s], longer than the guard looks ahead with the limits it is delivered with


def swept(X, Y, c_x, c_y, v, omega):
    """|q|² times the bearing's rate."""
    x_rate, y_rate = omega * (Y + c_y) - v, -omega * (X + c_x)
    return X * y_rate - Y * x_rate


def swept_rate(X, Y, c_x, c_y, v, omega):
    """Its own rate, in closed form."""
    return omega * (X * (v - omega * c_y) + omega * c_x * Y)


def test_the_identity():
    r"""At an extremum the second derivative is a square times Y x."""
    X, Y, c_x, c_y, v, omega = SYMBOLS
    rate = swept(*SYMBOLS)
    x_rate, y_rate = omega * (Y + c_y) - v, -omega * (X + c_x)
    derivative = rate.diff(X) * x_rate + rate.diff(Y) * y_rate
    assert sympy.expand(derivative - swept_rate(*SYMBOLS)) == 0
    # The speed of the camera along the forward direction.
    speed = sympy.symbols("v_c")
    square = X**2 + Y**2
    at_extremum = {omega: speed * Y / (square + c_x * X)}
    assert sympy.simplify(rate.subs(v, speed + omega * c_y).subs(at_extremum)) == 0
    curved = derivative.subs(v, speed + omega * c_y).subs(at_extremum)
    stated = speed**2 * square * Y * (X + c_x) / (square + c_x * X) ** 2
    assert sympy.simplify(curved - stated) == 0
    # The same in polar coordinates of the camera.
    rho, phi = sympy.symbols("rho phi", positive=True)
    polar = {X: rho * sympy.cos(phi), Y: rho * sympy.sin(phi)}
    published = speed**2 * sympy.sin(phi) * (rho * sympy.cos(phi) + c_x)
    published /= rho * (rho + c_x * sympy.cos(phi)) ** 2
    assert sympy.simplify((stated / square).subs(polar) - published) == 0


X, Y, C_X, C_Y, V, W = reals("X Y c_x c_y v omega")
STATE = (X, Y, C_X, C_Y, V, W)
EXTREMUM = (swept(*STATE) == 0, z3.Or(V != 0, W != 0))


def test_an_extremum_is_a_minimum_of_the_bearing_to_the_side():
    for sign in (1, -1):
        side = sign * Y > 0
        claim = sign * swept_rate(*STATE) > 0
        # X > 0 is not needed for this, only for a bearing that does not jump at pi.
        assert proved(claim, *EXTREMUM, side, X + C_X > 0)
        assert not proved(claim, *EXTREMUM, side, X > 0)
    # Straight ahead there is no extremum except of a bearing that stays 0.
    assert proved(W == 0, *EXTREMUM, Y == 0, X > 0, X + C_X > 0)
    assert not proved(W == 0, *EXTREMUM, X > 0, X + C_X > 0)


def test_being_ahead_at_both_ends_is_being_ahead_in_between():
    r"""x'' = -omega² x: while x > 0 it is concave in time, and between two positive ends

    :math:`x(t) = (x_0\sin\omega(T - t) + x_T\sin\omega t)/\sin\omega T > 0` for less than half
    a turn. So x is nowhere below the smaller end, and X = x - c_x is not either.
    """
    omega, t, duration, x_0, x_t, y_0, v = sympy.symbols("omega t T x_0 x_T y_0 v", real=True)
    along = x_0 * sympy.cos(omega * t) + (y_0 - v / omega) * sympy.sin(omega * t)
    across = -x_0 * sympy.sin(omega * t) + (y_0 - v / omega) * sympy.cos(omega * t) + v / omega
    assert sympy.simplify(along.diff(t) - (omega * across - v)) == 0
    assert sympy.simplify(across.diff(t) + omega * along) == 0
    assert sympy.simplify(along.diff(t, 2) + omega**2 * along) == 0
    between = x_0 * sympy.sin(omega * (duration - t)) + x_t * sympy.sin(omega * t)
    between /= sympy.sin(omega * duration)
    assert sympy.simplify(between.diff(t, 2) + omega**2 * between) == 0
    assert sympy.simplify(between.subs(t, 0)) == x_0
    assert sympy.simplify(between.subs(t, duration)) == x_t
    # Half a turn and more: ahead, behind, ahead again.
    back = between.subs({x_0: 1, x_t: 1, omega: 1, duration: 5, t: sympy.Rational(5, 2)})
    assert back.evalf() < 0


def seen_on_arcs(t, v, omega, point, camera):
    """(X, Y) and its first two time derivatives by turning about the instantaneous centre."""
    centre = v / omega
    g_x, g_y = point[0], point[1] - centre
    turned = omega * t
    s, c = turned.sin(), turned.cos()
    along, across = g_x * c + g_y * s, g_y * c - g_x * s
    X, Y = along - camera[0], across + (centre - camera[1])
    return X, Y, omega * across, -omega * along, -omega.square() * along, -omega.square() * across


def test_arcs_one_by_one_in_interval_arithmetic():
    """On 400 arcs every stretch is proved monotone or, with |bearing| convex, free of a maximum.

    Not by the identity above: from the rotation itself, with outward rounding.
    """
    rng = np.random.default_rng(1)
    count = 400
    v = rng.uniform(0.05, 0.5, count) * rng.choice([-1, 1], count)
    camera = rng.uniform((-0.3, -0.2), (0.3, 0.2), (count, 2)).T
    reach, bearing = rng.uniform(0.5, 2.0, count), rng.uniform(-1.0, 1.0, count)
    seen = reach * np.array([np.cos(bearing), np.sin(bearing)])
    point = camera + seen
    # Near the turn rate at which the bearing starts at rest.
    still = v * seen[1] / (reach**2 + (camera * seen).sum(axis=0))
    omega = still * rng.uniform(0.7, 1.1, count)
    assert np.abs(omega).max() * DURATION * 2 <= REACH
    arcs = np.repeat(np.arange(count), 16)
    low = np.tile(np.linspace(0.0, 2 * DURATION, 17)[:-1], count)
    high = np.tile(np.linspace(0.0, 2 * DURATION, 17)[1:], count)
    curved = skipped = 0
    while arcs.size:
        inputs = (Interval(array[arcs]) for array in (v, omega))
        X, Y, X1, Y1, X2, Y2 = seen_on_arcs(
            Interval(low, high), *inputs,
            [Interval(column[arcs]) for column in point],
            [Interval(column[arcs]) for column in camera],
        )  # fmt: skip
        rate, curvature = X * Y1 - Y * X1, Y * (X * Y2 - Y * X2)
        behind = (X.lo <= 0.0) | ((X + Interval(camera[0][arcs])).lo <= 0.0)
        monotone = (rate.lo > 0.0) | (rate.hi < 0.0)
        convex = curvature.lo > 0.0
        curved += int((convex & ~monotone & ~behind).sum())
        skipped += int(behind.sum())
        open_ = ~(behind | monotone | convex)
        assert high[open_].size == 0 or (high - low)[open_].min() > 1e-9
        middle = 0.5 * (low + high)
        arcs = np.tile(arcs[open_], 2)
        low, high = (
            np.concatenate([low[open_], middle[open_]]),
            np.concatenate([middle[open_], high[open_]]),
        )
    assert curved > 20  # extrema were met
    assert skipped < 0.2 * 16 * count


def test_a_camera_that_does_not_see_ahead_is_beyond_the_claim():
    """Yawed by 60° with a half angle of 35° or less: ends in view, the middle out by some 0.4°."""
    twist, duration = Twist(0.35, 0.25), 1.2
    # The bearing is at rest halfway, 25° off the forward direction.
    bearing = math.radians(25)
    rho = twist.v * math.sin(bearing) / twist.omega - 0.2 * math.cos(bearing)
    halfway = (0.2 + rho * math.cos(bearing), rho * math.sin(bearing))
    x, y = arc(twist, -0.5 * duration).seen(halfway)
    scene = Scene(Pose2(x, y, 0.0), Pose2(x, y, 0.0), 0.0)
    motions = tuple(arc(twist, duration * i / 1000) for i in range(1001))
    ends = (motions[0], motions[-1])

    def camera(half_angle, yaw):
        return FieldOfView(half_angle, Pose2(0.2, 0.0, math.radians(yaw)))

    def smallest(barrier, poses):
        return min(barrier.clearance(scene, pose) for pose in poses)

    aside = FieldOfViewBarrier(camera(math.radians(35), 60), 1.0)
    assert smallest(aside, motions) == pytest.approx(0.0, abs=1e-9)
    missed = smallest(aside, ends)
    assert missed > math.radians(0.4)
    # A view narrower by that much: both ends in it, the middle not.
    narrow = camera(math.radians(35) - 0.99 * missed, 60)
    barrier = FieldOfViewBarrier(narrow, 1.0)
    assert smallest(barrier, ends) > 0.0
    assert smallest(barrier, motions) < -math.radians(0.4)
    # Poses that stand for the arc between them are therefore refused for such a camera.
    sweep = Sweep.of(HERE, Twist(0.0, 0.0), 0.0, twist, duration)
    assert barrier.clearance_along(scene, sweep) == -math.inf
    assert lowest_on_arc(camera_edges(narrow)[1], (x, y), twist, duration) < -1e-3
    # Looking ahead, no half angle misses it; one that the arc turns out of is refused.
    refused = FieldOfViewBarrier(camera(0.9 * twist.omega * duration, 0), 1.0)
    assert refused.clearance_along(scene, sweep) == -math.inf
    for half_angle in (0.4, 0.6, 1.2):
        barrier = FieldOfViewBarrier(camera(half_angle, 0), 1.0)
        along = barrier.clearance_along(scene, sweep)
        assert along == pytest.approx(smallest(barrier, motions), abs=1e-12)


def lowest_on_arc(edge, point, twist, duration):
    r"""Least n·p - d along an arc, closed form: a sinusoid of the angle turned.

    :math:`h(\vartheta) = n^\top c_{icc} - d + A\cos\vartheta + B\sin\vartheta`; its minimum is at
    an end or where :math:`\vartheta = \mathrm{atan2}(B, A) + \pi`.
    """
    n_x, n_y, offset = edge
    centre = twist.v / twist.omega
    g_x, g_y = point[0], point[1] - centre
    a, b = n_x * g_x + n_y * g_y, n_x * g_y - n_y * g_x
    turned = twist.omega * duration
    angles = [0.0, turned]
    base = math.atan2(b, a) + math.pi
    for k in range(-2, 3):
        angle = base + 2 * math.pi * k
        if min(0.0, turned) < angle < max(0.0, turned):
            angles.append(angle)
    return n_y * centre - offset + min(a * math.cos(t) + b * math.sin(t) for t in angles)


def test_the_closed_form_extremum_holds_for_any_camera():
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(300):
        camera = FieldOfView(
            rng.uniform(0.2, 1.4), Pose2(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3, 3))
        )
        point = tuple(rng.uniform(-2.0, 2.0, 2))
        twist = Twist(rng.uniform(-0.5, 0.5), rng.uniform(0.05, 1.0) * rng.choice([-1, 1]))
        duration = rng.uniform(0.1, 6.0)
        for edge in camera_edges(camera):
            values = []
            for t in np.linspace(0.0, duration, 400):
                x, y = arc(twist, t).seen(point)
                values.append(edge.normal_x * x + edge.normal_y * y - edge.offset)
            lowest = lowest_on_arc(edge, point, twist, duration)
            curvature = (abs(point[0]) + abs(point[1]) + 10.0) * (twist.omega * duration / 400) ** 2
            assert min(values) - curvature <= lowest <= min(values) + 1e-12
            inside += lowest < min(values[0], values[-1]) - 1e-3
    assert inside > 50
