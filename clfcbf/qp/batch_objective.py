r"""The cost of many two-input programs at once, one column a program.

:math:`(u-\bar u)^\top Q(u-\bar u) + c\,(s^\top u - s_b)^2` as in :mod:`clfcbf.qp.objective`,
with the weight and the penalty :math:`c` common to all or one a program.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from clfcbf.qp.batch_chord import Chord
from clfcbf.qp.batch_geometry import SMALL_ANGLE, Array, Index, Mask, excess, inside, size_of
from clfcbf.qp.objective import CONDITION
from clfcbf.qp.polygon import TRUSTED

__all__ = ["Entry", "Objectives"]

Entry: TypeAlias = float | Array
"""A number common to all programs, or one a program, shape (n,)."""

_SHORTEST, _LONGEST = 1e-150, 1e150  # rows whose squared length could overflow or underflow
_HALF = 2.0**27 + 1.0  # splits a double into two halves whose products are exact
_ERROR = 2.0**-45  # a fortieth of 1e-12: what the last step may add to the other roundings
_EPSILON = 2.0**-52


class Objectives(NamedTuple):
    """Costs side by side: weight ``(q11, q12, q22)``, nominal (2, n), soft rows (3, n) or None."""

    weight: tuple[Entry, Entry, Entry]
    nominal: Array
    penalty: float = 0.0
    soft: Array | None = None

    @property
    def crossed(self) -> bool:
        """Whether the weight has a term in both inputs."""
        return not isinstance(self.weight[1], float) or self.weight[1] != 0.0

    @property
    def diagonal(self) -> bool:
        """Whether the inputs do not meet in the cost."""
        return self.soft is None and not self.crossed

    def take(self, at: Index) -> Objectives:
        """The costs of the programs ``at``."""
        q11, q12, q22 = (q if isinstance(q, float) else q.take(at) for q in self.weight)
        soft = None if self.soft is None else self.soft.take(at, axis=1)
        return Objectives((q11, q12, q22), self.nominal.take(at, axis=1), self.penalty, soft)

    def untrusted(self, scale: Array) -> Mask:
        """Where rounding could exceed 1e-12: nominal far beyond ``scale``, ill-scaled costs."""
        q11, q12, q22 = self.weight
        trace = q11 + q22
        far: Mask = size_of(self.nominal) > TRUSTED * scale
        far |= ~np.less_equal(trace * trace, CONDITION * (q11 * q22 - q12 * q12))
        if self.soft is not None:
            size = size_of(self.soft)
            far |= ~((size > _SHORTEST) & (size < _LONGEST))
        return far

    def minimum_in(self, box: Array) -> tuple[Array, Array]:
        """The points of least cost in the boxes: the v-sides first, then the w-sides."""
        n_v, n_w = self.nominal
        if self.diagonal:
            return inside(box, n_v, n_w)
        q11, q12, q22 = self.weight
        v, w, r = n_v, n_w, None
        if self.soft is not None:
            s_v, s_w, _ = self.soft
            r = excess(self.soft, n_v, n_w)
            if self.crossed:
                g_v, g_w = q22 * s_v - q12 * s_w, q11 * s_w - q12 * s_v
            else:
                g_v, g_w = q22 * s_v, q11 * s_w
            k = s_v * g_v
            k += s_w * g_w
            k += (q11 * q22 - q12 * q12) / self.penalty
            np.divide(r, k, out=k)
            g_v *= k
            g_w *= k
            v, w = np.subtract(n_v, g_v, out=g_v), np.subtract(n_w, g_w, out=g_w)
        x = np.maximum(v, box[0])
        np.minimum(x, box[1], out=x)
        w = np.where(x == v, w, self._other(1, x, r))
        y = np.maximum(w, box[2])
        np.minimum(y, box[3], out=y)
        free = self._other(0, y, r)
        np.maximum(free, box[0], out=free)
        np.minimum(free, box[1], out=free)
        return np.where(y == w, x, free), y

    def _other(self, axis: int, held: Array, residual: Array | None) -> Array:
        """The coordinate ``axis`` of least cost where the other one is ``held``.

        ``residual`` is that of the soft row at the nominal command, None without one.
        """
        away = held - self.nominal[1 - axis]
        curvature: Entry = self.weight[2 * axis]
        pull: Array = self.weight[1] * away
        if self.soft is not None and residual is not None:
            steep: Array = self.penalty * self.soft[axis]
            away *= self.soft[1 - axis]
            away += residual
            away *= steep
            pull += away
            steep *= self.soft[axis]
            steep += curvature
            curvature = steep
        pull /= curvature
        np.subtract(self.nominal[axis], pull, out=pull)
        return pull

    def minimum_on(self, line: Array, ends: Chord) -> tuple[Array, Mask | None]:
        r"""The t of least cost along :math:`(x - c t,\ y + a t)`, and where it is untrusted.

        .. math:: t = \frac{d^\top Q(\bar u - p) - c\,(s^\top d)(s^\top p - s_b)}
                           {d^\top Q d + c\,(s^\top d)^2}
        """
        q11, q12, q22 = self.weight
        a, c = line[0], line[1]
        upper, right = self.nominal[0] - ends.x, self.nominal[1] - ends.y
        if self.crossed:
            g_v, g_w = q12 * a - q11 * c, q22 * a - q12 * c
        else:
            g_v, g_w = -q11 * c, q22 * a
        upper *= g_v
        right *= g_w
        upper += right
        g_v *= c
        g_w *= a
        lower = np.subtract(g_w, g_v, out=g_w)
        if self.soft is None:
            return np.divide(upper, lower, out=upper), None
        s_v, s_w, s_b = self.soft
        slope = s_w * a
        slope -= s_v * c
        length2, soft2 = ends.length2, s_v * s_v
        soft2 += s_w * s_w
        untrusted = slope * slope <= SMALL_ANGLE * length2 * soft2
        over = excess(self.soft, ends.x, ends.y)
        if untrusted.any():
            at = np.flatnonzero(untrusted)
            # The slope by exact products: what is left of its error is what p's adds to it.
            slope[at] = _difference_of_products(s_w[at], a[at], s_v[at], c[at])
            size = np.sqrt(soft2[at]) * (np.abs(ends.x[at]) + np.abs(ends.y[at])) + np.abs(s_b[at])
            force = self.penalty * np.abs(slope[at])
            error = 8.0 * _EPSILON * force * size * np.sqrt(length2[at])
            untrusted[at] = ~(error <= _ERROR * (lower[at] + force * np.abs(slope[at])))
        steep = self.penalty * slope
        over *= steep
        steep *= slope
        upper -= over
        lower += steep
        return np.divide(upper, lower, out=upper), untrusted


def _difference_of_products(a: Array, b: Array, c: Array, d: Array) -> Array:
    """``a b - c d`` with a relative error of a few 2**-52, however much of it cancels."""
    p, q = a * b, c * d
    return (p - q) + (_product_error(a, b, p) - _product_error(c, d, q))


def _product_error(a: Array, b: Array, product: Array) -> Array:
    """``a b - product``, exactly (Dekker's product)."""
    t, u = _HALF * a, _HALF * b
    a_hi, b_hi = t - (t - a), u - (u - b)
    a_lo, b_lo = a - a_hi, b - b_hi
    error: Array = ((a_hi * b_hi - product) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo
    return error
