"""Certificates by satisfiability modulo theories: small facts that the design rests on."""

import sympy
import z3

from clfcbf.constraints.cbf import Edge, half_plane_rows
from clfcbf.constraints.clf import quadratic_clf, quartic_clf
from clfcbf.se2 import Pose2, Twist
from tests.certificates.smt import proved, reals

X, Y, V, W, GAIN = reals("x y v omega gain")


def rows_of(*edges, velocity=(0, 0)):
    """The library's own rows, with symbols for numbers."""
    names = tuple(map(str, range(len(edges))))
    return half_plane_rows(names, edges, ((X, Y),), GAIN, velocity)


def meets(row, v, omega):
    a_v, a_w, b = row
    return a_v * v + a_w * omega <= b


def test_standing_still_meets_every_row_of_a_point_in_view():
    n_x, n_y, d = reals("n_x n_y d")
    rows = rows_of(Edge(n_x, n_y, d))
    inside = (rows.values[0] >= 0, GAIN > 0)
    assert proved(meets(rows.coefficients[0], 0, 0), *inside)
    assert not proved(meets(rows.coefficients[0], 0, 0), rows.values[0] >= -1, GAIN > 0)
    u_x, u_y = reals("u_x u_y")
    moving = rows_of(Edge(n_x, n_y, d), velocity=(u_x, u_y))
    assert not proved(meets(moving.coefficients[0], 0, 0), *inside)


def edge_of(inward, e_x, e_y, c_x, c_y):
    """As ``Edge.through``, of a camera at c, along the unit vector e."""
    n_x, n_y = -inward * e_y, inward * e_x
    return Edge(n_x, n_y, n_x * c_x + n_y * c_y)


def test_relative_degree_is_one():
    """On an edge some input acts on h: the turn rate, if the camera is not behind; else the speed.

    With a camera behind the rotation centre the turn rate alone can fail to.
    """
    e_x, e_y, c_x, c_y, r = reals("e_x e_y c_x c_y r")
    for inward in (-1, 1):
        rows = rows_of(edge_of(inward, e_x, e_y, c_x, c_y))
        a_v, a_w, _ = rows.coefficients[0]
        on_edge = (
            e_x * e_x + e_y * e_y == 1,
            r >= 0,
            c_x + r * e_x == X,
            c_y + r * e_y == Y,
        )
        assert proved(rows.values[0] == 0, *on_edge)
        assert proved(z3.Or(a_v != 0, a_w != 0), *on_edge, e_y != 0)
        ahead = (c_x * e_x + c_y * e_y >= 0, r > 0)
        assert proved(a_w != 0, *on_edge, *ahead)
        assert not proved(a_w != 0, *on_edge, r > 0)
        assert not proved(z3.Or(a_v != 0, a_w != 0), *on_edge)


def test_both_edges_bound_the_speed():
    """v <= lambda (x - c_x) + omega y, from the two together and from neither alone."""
    s, c, c_x, c_y = reals("s c c_x c_y")
    rows = rows_of(edge_of(-1, c, s, c_x, c_y), edge_of(1, c, -s, c_x, c_y))
    left, right = (meets(row, V, W) for row in rows.coefficients)
    view = (s > 0, c > 0, s * s + c * c == 1, GAIN > 0)
    bound = GAIN * (X - c_x) + W * Y >= V
    assert proved(bound, *view, left, right)
    assert not proved(bound, *view, left)
    assert not proved(GAIN * (X - c_x) - W * Y >= V, *view, left, right)


def paper_rate(weights, state, reference):
    """dV/dt of the paper's function of a diagonal H, at a heading error of 0, and V."""
    (h1, h2, _), (x, y), (v_ref, _) = weights, state, reference
    square = h1 * x * x + h2 * y * y
    x_rate, y_rate = W * y - V + v_ref, -W * x
    return square * (h1 * x * x_rate + h2 * y * y_rate), square * square / 4


def test_the_papers_function_is_no_clf():
    """On {x = theta = 0, y != 0} no command makes it fall, at any weights, decay and reference."""
    h1, h2, h3, mu, v_ref, w_ref = reals("h1 h2 h3 mu v_V omega_V")
    positive = (h1 > 0, h2 > 0, h3 > 0, mu > 0, Y != 0)
    rate, value = paper_rate((h1, h2, h3), (0, Y), (v_ref, w_ref))
    assert proved(rate > -mu * value, *positive)
    rate, value = paper_rate((h1, h2, h3), (X, Y), (v_ref, w_ref))
    assert not proved(rate > -mu * value, *positive)


def test_the_papers_rows_ask_for_the_impossible_there():
    """The library's rows of the paper at such points, to the last bit: 0 <= a negative number."""
    for builder in (quartic_clf, quadratic_clf):
        for y in (-2.0, -0.25, 0.5, 1.0):
            for v in (-0.25, 0.0, 0.125):
                rows = builder(Pose2(0.0, y, 0.0), Twist(v, 0.5), (1.0, 2.0, 4.0), 1.0)
                a_v, a_w, b = rows.coefficients[0]
                assert (a_v, a_w) == (0.0, 0.0)
                assert b < 0.0


def test_no_positive_definite_weight_helps_a_target_at_rest():
    r"""For every H there are errors other than 0 at which no command acts on x'Hx.

    With P = H⁻¹ and any small g, :math:`x = g P_{12}/(1 + g P_{13})` and the error
    :math:`g P (0, 1, -x)` have :math:`L_g V = 0`; at rest there is no drift either.
    """
    entries = sympy.symbols("p11 p12 p13 p22 p23 p33")
    p11, p12, p13, p22, p23, p33 = entries
    inverse = sympy.Matrix([[p11, p12, p13], [p12, p22, p23], [p13, p23, p33]])
    g = sympy.symbols("g")
    x = g * p12 / (1 + g * p13)
    error = g * inverse * sympy.Matrix([0, 1, -x])
    gradient = (inverse.inv() * error).applyfunc(sympy.simplify)
    assert sympy.simplify(error[0] - x) == 0
    inputs = (-gradient[0], gradient[0] * error[1] - gradient[1] * error[0] - gradient[2])
    assert [sympy.simplify(entry) for entry in inputs] == [0, 0]
    assert sympy.simplify(gradient[1]) == g


def test_the_brake_stays_in_its_box_and_counts_down():
    """From within N steps of rest: a tick on, 1/N of the speed is gone and N - 1 are enough."""
    n, step = reals("N step")
    enough = (n >= 1, step > 0, n * step >= V, -n * step <= V)
    slower = V * (1 - 1 / n)
    assert proved(z3.And(V - slower <= step, V - slower >= -step), *enough)
    assert proved(z3.And(slower <= (n - 1) * step, slower >= -(n - 1) * step), *enough)
    assert not proved(slower <= (n - 2) * step, *enough)


def test_the_safe_command_is_unique():
    """Two minimisers over a convex set would have a better one halfway between them."""
    q11, q12, q22, v1, w1, v2, w2 = reals("q11 q12 q22 v1 w1 v2 w2")

    def cost(v, w):
        return q11 * v * v + 2 * q12 * v * w + q22 * w * w

    different = (z3.Or(v1 != v2, w1 != w2), cost(v1, w1) == cost(v2, w2))
    better = cost((v1 + v2) / 2, (w1 + w2) / 2) < cost(v1, w1)
    assert proved(better, q11 > 0, q11 * q22 > q12 * q12, *different)
    assert not proved(better, q11 > 0, q11 * q22 >= q12 * q12, *different)
