r"""The programs of the latency benchmark in rational arithmetic, by enumeration.

Nothing of the library's geometry is used: a strictly convex program in two inputs has its
minimum among the unconstrained one, the ones on each line and the crossings of two lines, and
the feasible candidate of least cost is it. Floats enter exactly and are rounded once, at the end.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

from benchmarks.stream import Program
from clfcbf.qp.rational import solve_rational

__all__ = ["lexicographic", "one_shot"]

_Point = tuple[Fraction, Fraction]
_Line = tuple[Fraction, Fraction, Fraction]


def one_shot(program: Program, penalty: float) -> tuple[float, float] | None:
    r"""The paper's program, :math:`\min |u-\bar u|_Q^2 + c\,\max(0, a^\top u-b)^2` in box and rows.

    None where no command is in the box and meets the hard rows.
    """
    q11, q12, q22 = map(Fraction, program.weight)
    n_v, n_w = map(Fraction, program.nominal)
    lines = _lines(program)
    plain = ((q11, q12, q22), (q11 * n_v + q12 * n_w, q12 * n_v + q22 * n_w))
    best = _minimum(*plain, lines)
    if best is None:
        return None
    a, c, b = map(Fraction, program.soft)
    if a * best[0] + c * best[1] > b:
        # With delta > 0 the cost is (u-n)'Q(u-n) + c (a'u-b)^2, again a quadratic one.
        k = Fraction(penalty)
        hessian = (q11 + k * a * a, q12 + k * a * c, q22 + k * c * c)
        linear = (plain[1][0] + k * b * a, plain[1][1] + k * b * c)
        best = _minimum(hessian, linear, lines)
        assert best is not None
    return float(best[0]), float(best[1])


def lexicographic(program: Program) -> tuple[float, float]:
    """The tick's own program: the Lyapunov row relaxed by as little as the barriers leave."""
    everything = program._replace(hard=(*program.hard, program.soft), soft=(0.0, 0.0, 0.0))
    held = one_shot(everything, 1.0)
    if held is not None:
        return held
    objective = (*program.weight, *program.nominal, 0.0, 0.0, 0.0, 0.0)
    answer = solve_rational(objective, program.box, (program.hard, (program.soft,)))
    return answer.v, answer.omega


def _lines(program: Program) -> list[_Line]:
    v_lo, v_hi, w_lo, w_hi = map(Fraction, program.box)
    one, zero = Fraction(1), Fraction(0)
    sides = [(one, zero, v_hi), (-one, zero, -v_lo), (zero, one, w_hi), (zero, -one, -w_lo)]
    rows = [(Fraction(a), Fraction(c), Fraction(b)) for a, c, b in program.hard]
    return sides + rows


def _minimum(
    hessian: tuple[Fraction, Fraction, Fraction], linear: _Point, lines: list[_Line]
) -> _Point | None:
    r"""The feasible candidate of least :math:`u^\top H u - 2\,l^\top u`."""
    h11, h12, h22 = hessian
    det = h11 * h22 - h12 * h12
    free = (h22 * linear[0] - h12 * linear[1]) / det, (h11 * linear[1] - h12 * linear[0]) / det
    if _feasible(free, lines):
        return free
    best: _Point | None = None
    least = Fraction(0)
    for point in _candidates(hessian, free, lines):
        x, y = point[0] - free[0], point[1] - free[1]
        cost = h11 * x * x + 2 * h12 * x * y + h22 * y * y
        if (best is None or cost < least) and _feasible(point, lines):
            best, least = point, cost
    return best


def _candidates(
    hessian: tuple[Fraction, Fraction, Fraction], free: _Point, lines: list[_Line]
) -> list[_Point]:
    """The minimum on each line, and the crossings."""
    h11, h12, h22 = hessian
    points = []
    for a, c, b in lines:
        g, f = h22 * a - h12 * c, h11 * c - h12 * a  # along H^-1 (a, c)
        length = a * g + c * f
        if length:
            k = (a * free[0] + c * free[1] - b) / length
            points.append((free[0] - k * g, free[1] - k * f))
    for (a, c, b), (d, e, f) in combinations(lines, 2):
        det = a * e - c * d
        if det:
            points.append(((b * e - c * f) / det, (a * f - b * d) / det))
    return points


def _feasible(point: _Point, lines: list[_Line]) -> bool:
    v, w = point
    return all(a * v + c * w <= b for a, c, b in lines)
