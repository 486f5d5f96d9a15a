r"""Projection of a command onto a box and half-planes, in floats, by two-dimensional geometry.

The minimum over :math:`k` constraints is the minimum over the first :math:`k-1` where that
satisfies the :math:`k`-th, and otherwise lies on the :math:`k`-th's line: one clipped
one-dimensional minimum replaces it [Seidel1991]_. No iterations, no step sizes, no tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence

from clfcbf.qp.objective import Objective, ill_conditioned, line_minimum, minimiser
from clfcbf.qp.polygon import PARALLEL, TRUSTED, Delicate

__all__ = ["NOISE", "box_scale", "project"]

NOISE = 2.0**-40
"""Relative size under which a float gap counts as undecided: rounding, 2**-52, times TRUSTED."""

_SMALL_ANGLE = 1.0 / TRUSTED**2  # squared sines
_SAME_ANGLE = 1.0 / PARALLEL**2
_LONGEST = 1e150  # rows whose squared length could overflow or underflow go to fractions
_SHORTEST = 1e-150


def box_scale(v_lo: float, v_hi: float, w_lo: float, w_hi: float) -> float:
    """A length that no coordinate of the box exceeds."""
    return abs(v_lo) + abs(v_hi) + abs(w_lo) + abs(w_hi)


def project(
    objective: Objective[float],
    box: Sequence[float],
    levels: Sequence[Sequence[tuple[float, float, float]]],
) -> tuple[float, float] | None:
    """The point of least cost in the box and on the right side of every row.

    Parameters
    ----------
    objective : cost
    box : ``(v_lo, v_hi, w_lo, w_hi)``, not empty
    levels : rows ``(a_v, a_w, b)``, grouped in any way; zero rows are passed over

    Returns
    -------
    The command, or None where no command satisfies all rows

    Raises
    ------
    Delicate : floats cannot answer to 1e-12
    """
    q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = objective
    v_lo, v_hi, w_lo, w_hi = box
    trusted = False
    v, w = n_v, n_w
    if c or q12:
        _check(objective, box)
        trusted = True
        v, w = minimiser(objective)
    # The box: first its v-sides, then its w-sides.
    if not v_lo <= v <= v_hi:
        v = v_lo if v < v_lo else v_hi
        w = n_w + (q12 * (n_v - v) - c * s_w * (s_v * v + s_w * n_w - s_b)) / (q22 + c * s_w * s_w)
    if not w_lo <= w <= w_hi:
        w = w_lo if w < w_lo else w_hi
        v = n_v + (q12 * (n_w - w) - c * s_v * (s_v * n_v + s_w * w - s_b)) / (q11 + c * s_v * s_v)
        v = v_lo if v < v_lo else v_hi if v > v_hi else v
    touch = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    taken: list[tuple[float, float, float]] = []
    for rows in levels:
        for row in rows:
            a_v, a_w, b = row
            size = abs(a_v) + abs(a_w)
            r = a_v * v + a_w * w - b
            if r > -touch * size and size:
                if r > 0.0:
                    if not trusted:
                        _check(objective, box)
                        trusted = True
                    point = _on_line(objective, box, row, v, w, taken)
                    if point is None:
                        return None
                    v, w = point
                elif _in_a_wedge(row, (v, w), box, taken, touch):
                    raise Delicate
            taken.append(row)
    return v, w


def _in_a_wedge(
    row: tuple[float, float, float],
    point: tuple[float, float],
    box: Sequence[float],
    taken: Sequence[tuple[float, float, float]],
    touch: float,
) -> bool:
    """Whether ``point``, on the line of ``row`` to rounding, is on a nearly parallel one too."""
    a_v, a_w, _ = row
    v, w = point
    v_lo, v_hi, w_lo, w_hi = box
    sides = ((1.0, 0.0, v_hi), (-1.0, 0.0, -v_lo), (0.0, 1.0, w_hi), (0.0, -1.0, -w_lo))
    length2 = a_v * a_v + a_w * a_w
    for c_v, c_w, e in (*sides, *taken):
        rate = a_v * c_w - a_w * c_v
        rate2 = rate * rate  # a power would overflow with an exception
        both2 = length2 * (c_v * c_v + c_w * c_w)
        near = abs(c_v * v + c_w * w - e) <= 2.0 * touch * (abs(c_v) + abs(c_w))
        same = rate2 <= _SAME_ANGLE * both2 and a_v * c_v + a_w * c_w > 0.0
        if near and not same and rate2 <= _SMALL_ANGLE * both2:
            return True
    return False


def _check(objective: Objective[float], box: Sequence[float]) -> None:
    """Refuse costs for which rounding could exceed 1e-12."""
    _, _, _, n_v, n_w, c, s_v, s_w, _ = objective
    v_lo, v_hi, w_lo, w_hi = box
    if abs(n_v) + abs(n_w) > TRUSTED * box_scale(v_lo, v_hi, w_lo, w_hi):
        raise Delicate
    if ill_conditioned(objective) or (c and not _SHORTEST < abs(s_v) + abs(s_w) < _LONGEST):
        raise Delicate


def _on_line(
    objective: Objective[float],
    box: Sequence[float],
    row: tuple[float, float, float],
    v: float,
    w: float,
    taken: Sequence[tuple[float, float, float]],
) -> tuple[float, float] | None:
    """The point of least cost on the line of ``row``, in the box and within ``taken``."""
    v_lo, v_hi, w_lo, w_hi = box
    a_v, a_w, b = row
    length2 = a_v * a_v + a_w * a_w
    if not 1e-300 < length2 < 1e300:
        raise Delicate
    small = _SMALL_ANGLE * length2
    c, s_v, s_w = objective[5:8]
    cross = a_v * s_w - a_w * s_v
    if c and cross * cross <= small * (s_v * s_v + s_w * s_w):
        raise Delicate
    undecided = NOISE * (abs(v_lo) + abs(v_hi) + abs(w_lo) + abs(w_hi))
    reach = 2.0 * (v_hi - v_lo + w_hi - w_lo)
    # Start from the foot of the present point: as near to the box as the line comes.
    k = (a_v * v + a_w * w - b) / length2
    x, y = v - k * a_v, w - k * a_w
    # Along (x - a_w t, y + a_v t) the box leaves lo <= t <= hi, ...
    lo, hi = -1e308, 1e308
    if a_w * a_w > small:
        lo, hi = ((x - v_hi) / a_w, (x - v_lo) / a_w)
        if lo > hi:
            lo, hi = hi, lo
    else:
        drift = reach * abs(a_w) / length2**0.5 + undecided
        if not (v_lo + drift < x < v_hi - drift):
            if x < v_lo - drift or x > v_hi + drift:
                return None
            raise Delicate
    if a_v * a_v > small:
        near, far = ((w_lo - y) / a_v, (w_hi - y) / a_v)
        if near > far:
            near, far = far, near
        lo, hi = (near if near > lo else lo), (far if far < hi else hi)
    else:
        drift = reach * abs(a_v) / length2**0.5 + undecided
        if not (w_lo + drift < y < w_hi - drift):
            if y < w_lo - drift or y > w_hi + drift:
                return None
            raise Delicate
    # ... and every row taken before cuts off one end more.
    for c_v, c_w, e in taken:
        rate = a_v * c_w - a_w * c_v
        gap = e - c_v * x - c_w * y
        other2 = c_v * c_v + c_w * c_w
        if rate * rate > small * other2:
            t = gap / rate
            if rate > 0.0:
                if t < hi:
                    hi = t
            elif t > lo:
                lo = t
        elif other2 > 0.0:
            # Nearly parallel: it holds, or fails, along all of the line that matters.
            other = other2**0.5
            drift = reach * abs(rate) / (other * length2**0.5) + undecided
            if gap < -drift * other:
                return None
            same = rate * rate <= _SAME_ANGLE * length2 * other2 and a_v * c_v + a_w * c_w > 0.0
            if gap <= drift * other and not same:
                raise Delicate
    width = hi - lo
    if width * width * length2 <= undecided * undecided:
        raise Delicate
    if width < 0.0:
        return None
    t = line_minimum(objective, x, y, -a_w, a_v)
    t = lo if t < lo else hi if t > hi else t
    v, w = x - a_w * t, y + a_v * t
    return (
        v_lo if v < v_lo else v_hi if v > v_hi else v,
        w_lo if w < w_lo else w_hi if w > w_hi else w,
    )
