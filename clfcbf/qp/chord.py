r"""The line of a row inside a box and other rows, in floats."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clfcbf.qp.polygon import PARALLEL, TRUSTED, Delicate

__all__ = ["NOISE", "SAME_ANGLE", "SMALL_ANGLE", "box_scale", "chord"]

NOISE = 2.0**-40
"""Relative size under which a float gap counts as undecided: rounding, 2**-52, times TRUSTED."""

SMALL_ANGLE = 1.0 / TRUSTED**2
"""Squared sine of the angle under which the crossing of two lines is not left to floats."""

SAME_ANGLE = 1.0 / PARALLEL**2
"""Squared sine of the angle under which two directions are one."""

_SHORTEST2, _LONGEST2 = 1e-300, 1e300  # squared lengths between which rounding stays relative

Row = tuple[float, float, float]


def box_scale(v_lo: float, v_hi: float, w_lo: float, w_hi: float) -> float:
    """A length that no coordinate of the box exceeds."""
    return abs(v_lo) + abs(v_hi) + abs(w_lo) + abs(w_hi)


def chord(
    box: Sequence[float], row: Row, v: float, w: float, taken: Sequence[Row]
) -> tuple[float, float, float, float] | None:
    r"""The part of the line of ``row`` in the box and on the right side of the rows ``taken``.

    Parameters
    ----------
    box : ``(v_lo, v_hi, w_lo, w_hi)``, not empty
    row : ``(a_v, a_w, b)``, not a zero row
    v, w : a point of the box
    taken : rows; zero rows are passed over

    Returns
    -------
    ``(x, y, lo, hi)``: the points :math:`(x - a_w t,\ y + a_v t)` with ``lo <= t <= hi``, t = 0 at
    the foot of ``(v, w)``; or None where nothing is left

    Raises
    ------
    Delicate : rounding could change the answer by more than 1e-12
    """
    v_lo, v_hi, w_lo, w_hi = box
    a_v, a_w, b = row
    length2 = a_v * a_v + a_w * a_w
    if not _SHORTEST2 < length2 < _LONGEST2:
        raise Delicate
    small = SMALL_ANGLE * length2
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
        other2 = c_v * c_v + c_w * c_w
        if other2 <= _SHORTEST2:
            if not (c_v or c_w):
                continue
            c_v, c_w, e = _order_one(c_v, c_w, e)
            other2 = c_v * c_v + c_w * c_w
        rate = a_v * c_w - a_w * c_v
        gap = e - c_v * x - c_w * y
        if rate * rate > small * other2:
            t = gap / rate
            if rate > 0.0:
                if t < hi:
                    hi = t
            elif t > lo:
                lo = t
        else:
            # Nearly parallel: it holds, or fails, along all of the line that matters.
            other = other2**0.5
            drift = reach * abs(rate) / (other * length2**0.5) + undecided
            if gap < -drift * other:
                return None
            same = rate * rate <= SAME_ANGLE * length2 * other2 and a_v * c_v + a_w * c_w > 0.0
            if gap <= drift * other and not same:
                raise Delicate
    width = hi - lo
    if width * width * length2 <= undecided * undecided:
        raise Delicate
    return (x, y, lo, hi) if width > 0.0 else None


def _order_one(a_v: float, a_w: float, b: float) -> tuple[float, float, float]:
    """A row times the power of two that brings its larger coefficient to [1/2, 1)."""
    exponent = math.frexp(max(abs(a_v), abs(a_w)))[1]
    try:
        return math.ldexp(a_v, -exponent), math.ldexp(a_w, -exponent), math.ldexp(b, -exponent)
    except OverflowError:  # the line is out of every float's reach
        raise Delicate from None
