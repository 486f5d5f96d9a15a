r"""Projection of a command onto a box and half-planes, in floats, by two-dimensional geometry.

The minimum over :math:`k` constraints is the minimum over the first :math:`k-1` where that
satisfies the :math:`k`-th, and otherwise lies on the :math:`k`-th's line: one clipped
one-dimensional minimum replaces it [Seidel1991]_. No iterations, no step sizes, no tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Generic, NamedTuple, TypeVar

from clfcbf.qp.polygon import PARALLEL, TRUSTED, Delicate

__all__ = ["NOISE", "Objective", "box_scale", "ill_conditioned", "nearest_on_edge", "project"]

N = TypeVar("N", float, Fraction)
_Rows = Sequence[tuple[float, float, float]]

NOISE = 2.0**-40
"""Relative size under which a float gap counts as undecided: rounding, 2**-52, times TRUSTED."""

_CONDITION = float(TRUSTED**2)  # sensitivity to rounding grows like sqrt(cond Q)
_SMALL_ANGLE = 1.0 / TRUSTED**2  # squared sines
_SAME_ANGLE = 1.0 / PARALLEL**2
_NOISE_SQUARED = NOISE * NOISE
_LONGEST = 1e150  # rows whose squared length could overflow or underflow go to fractions
_SHORTEST = 1e-150


class Objective(NamedTuple, Generic[N]):
    r"""The strictly convex cost :math:`(u-\bar u)^\top Q(u-\bar u) + c\,(a^\top u - b)^2`.

    Attributes
    ----------
    q11, q12, q22 : the weight :math:`Q`
    n_v, n_w : the nominal command :math:`\bar u`
    c, s_v, s_w, s_b : penalty :math:`c \ge 0` and row :math:`(a, b)` of the soft term
    """

    q11: N
    q12: N
    q22: N
    n_v: N
    n_w: N
    c: N
    s_v: N
    s_w: N
    s_b: N

    def cost(self, v: N, omega: N) -> N:
        """The cost of the command ``(v, omega)``."""
        q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = self
        x, y, soft = v - n_v, omega - n_w, s_v * v + s_w * omega - s_b
        return x * (q11 * x + q12 * y) + y * (q12 * x + q22 * y) + c * soft * soft

    def minimiser(self) -> tuple[N, N]:
        r"""The command of least cost, :math:`\bar u - Q^{-1}a\,c\,r / (1 + c\,a^\top Q^{-1}a)`.

        Here :math:`r = a^\top\bar u - b`.
        """
        q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = self
        if c == 0:
            return n_v, n_w
        g_v, g_w = q22 * s_v - q12 * s_w, q11 * s_w - q12 * s_v
        k = (
            c
            * (s_v * n_v + s_w * n_w - s_b)
            / (q11 * q22 - q12 * q12 + c * (s_v * g_v + s_w * g_w))
        )
        return n_v - k * g_v, n_w - k * g_w

    def line_minimum(self, x: N, y: N, d_v: N, d_w: N) -> N:
        """The ``t`` of least cost along ``(x, y) + t (d_v, d_w)``."""
        q11, q12, q22, n_v, n_w, c, s_v, s_w, s_b = self
        e_v, e_w, slope = n_v - x, n_w - y, c * (s_v * d_v + s_w * d_w)
        return (
            d_v * (q11 * e_v + q12 * e_w)
            + d_w * (q12 * e_v + q22 * e_w)
            - slope * (s_v * x + s_w * y - s_b)
        ) / (
            d_v * (q11 * d_v + q12 * d_w)
            + d_w * (q12 * d_v + q22 * d_w)
            + slope * (s_v * d_v + s_w * d_w)
        )


def nearest_on_edge(objective: Objective[N], p: tuple[N, N], q: tuple[N, N]) -> tuple[N, N]:
    """The point of least cost on the segment from ``p`` to ``q``."""
    d_v, d_w = q[0] - p[0], q[1] - p[1]
    if d_v == 0 and d_w == 0:
        return p
    t = objective.line_minimum(p[0], p[1], d_v, d_w)
    if t <= 0:
        return p
    return q if t >= 1 else (p[0] + t * d_v, p[1] + t * d_w)


def box_scale(v_lo: float, v_hi: float, w_lo: float, w_hi: float) -> float:
    """A length no coordinate of the box exceeds."""
    return abs(v_lo) + abs(v_hi) + abs(w_lo) + abs(w_hi)


def ill_conditioned(q11: float, q12: float, q22: float) -> bool:
    """Whether the weight stretches rounding errors by more than floats can spare."""
    trace = q11 + q22
    return not trace * trace <= _CONDITION * (q11 * q22 - q12 * q12)


def project(
    objective: Objective[float],
    box: Sequence[float],
    levels: Sequence[_Rows],
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
    if c:
        v, w = objective.minimiser()
    else:
        v, w = n_v, n_w
    # The box: first its v-sides, then its w-sides.
    if not v_lo <= v <= v_hi:
        v = v_lo if v < v_lo else v_hi
        w = n_w + (q12 * (n_v - v) - c * s_w * (s_v * v + s_w * n_w - s_b)) / (q22 + c * s_w * s_w)
    if not w_lo <= w <= w_hi:
        w = w_lo if w < w_lo else w_hi
        v = n_v + (q12 * (n_w - w) - c * s_v * (s_v * n_v + s_w * w - s_b)) / (q11 + c * s_v * s_v)
        v = v_lo if v < v_lo else v_hi if v > v_hi else v
    checked = not (q12 or c)
    scale = 0.0
    taken: list[tuple[float, float, float]] = []
    for rows in levels:
        for row in rows:
            a_v, a_w, b = row
            r = a_v * v + a_w * w - b
            if r > 0.0 and (a_v or a_w):
                if not scale:
                    scale = box_scale(v_lo, v_hi, w_lo, w_hi)
                    if abs(n_v) + abs(n_w) > TRUSTED * scale or ill_conditioned(q11, q12, q22):
                        raise Delicate
                    checked = True
                point = _on_line(objective, box, scale, row, r, v, w, taken)
                if point is None:
                    return None
                v, w = point
            taken.append(row)
    if not checked and (
        abs(n_v) + abs(n_w) > TRUSTED * box_scale(v_lo, v_hi, w_lo, w_hi)
        or ill_conditioned(q11, q12, q22)
    ):
        raise Delicate
    return v, w


def _on_line(
    objective: Objective[float],
    box: Sequence[float],
    scale: float,
    row: tuple[float, float, float],
    r: float,
    v: float,
    w: float,
    taken: _Rows,
) -> tuple[float, float] | None:
    """The point of least cost on the line of ``row``, in the box and within ``taken``."""
    v_lo, v_hi, w_lo, w_hi = box
    a_v, a_w, _ = row
    if not _SHORTEST < abs(a_v) + abs(a_w) < _LONGEST:
        raise Delicate
    length2 = a_v * a_v + a_w * a_w
    # Start from the foot of the present point: as near to the box as the line comes.
    x, y = v - r / length2 * a_v, w - r / length2 * a_w
    reach = 2.0 * (v_hi - v_lo + w_hi - w_lo)
    lo, hi = -1e308, 1e308
    sides = (
        (1.0, 0.0, v_hi), (-1.0, 0.0, -v_lo), (0.0, 1.0, w_hi), (0.0, -1.0, -w_lo), *taken,
    )  # fmt: skip
    for c_v, c_w, e in sides:
        rate = a_v * c_w - a_w * c_v
        gap = e - c_v * x - c_w * y
        other2 = c_v * c_v + c_w * c_w
        if rate * rate > _SMALL_ANGLE * length2 * other2:
            t = gap / rate
            if rate > 0.0:
                if t < hi:
                    hi = t
            elif t > lo:
                lo = t
        elif other2 > 0.0:
            # Nearly parallel: the row must hold, or fail, along all of the line in reach.
            gap2 = gap * gap
            if gap2 <= _NOISE_SQUARED * scale * scale * other2 or (
                gap2 * length2 <= reach * reach * rate * rate
            ):
                if (
                    rate * rate <= _SAME_ANGLE * length2 * other2
                    and a_v * c_v + a_w * c_w > 0.0
                ):
                    continue  # the same half-plane but for rounding
                raise Delicate
            if gap < 0.0:
                return None
    width = hi - lo
    if width * width * length2 <= _NOISE_SQUARED * scale * scale:
        raise Delicate
    if width < 0.0:
        return None
    t = objective.line_minimum(x, y, -a_w, a_v)
    t = lo if t < lo else hi if t > hi else t
    v, w = x - a_w * t, y + a_v * t
    return (
        v_lo if v < v_lo else v_hi if v > v_hi else v,
        w_lo if w < w_lo else w_hi if w > w_hi else w,
    )
