r"""Projection onto a box without width and half-planes, in floats: one input is left to choose.

Such a box is what the limits leave of a hand-over from faster ones: the input that is too fast
has one admissible value. A row :math:`a t \le r` on the other input cuts off one end of an
interval, and the minimum in one variable is moved into what is left.
"""

from __future__ import annotations

from collections.abc import Sequence

from clfcbf.qp.chord import NOISE, box_scale
from clfcbf.qp.objective import Objective, line_minimum
from clfcbf.qp.polygon import TRUSTED, Delicate
from clfcbf.qp.projection import check_trusted

__all__ = ["interval", "project_on_segment"]


def project_on_segment(
    objective: Objective[float],
    box: Sequence[float],
    levels: Sequence[Sequence[tuple[float, float, float]]],
) -> tuple[float, float] | int:
    """As :func:`clfcbf.qp.projection.project`, where the ends of one input or both are equal.

    Parameters
    ----------
    objective : cost
    box : ``(v_lo, v_hi, w_lo, w_hi)`` with ``v_lo == v_hi`` or ``w_lo == w_hi``
    levels : rows ``(a_v, a_w, b)``, grouped in any way; zero rows are passed over

    Returns
    -------
    The command, or the index of the first level that together with those before leaves none

    Raises
    ------
    Delicate : floats cannot answer to 1e-12
    """
    v_lo, v_hi, w_lo, w_hi = box
    upright = v_lo == v_hi
    held, lo, hi = (v_lo, w_lo, w_hi) if upright else (w_lo, v_lo, v_hi)
    found = interval(box, levels)
    if isinstance(found, int):
        return found
    first, last = found
    if lo < hi:
        t = _minimum(objective, box, held, upright)
        first = first if t < first else last if t > last else t
    return (held, first) if upright else (first, held)


def interval(
    box: Sequence[float], levels: Sequence[Sequence[tuple[float, float, float]]]
) -> tuple[float, float] | int:
    """The values of the free input that the rows leave, or the first level that leaves none.

    Parameters and raises as :func:`project_on_segment`.
    """
    v_lo, v_hi, w_lo, w_hi = box
    upright = v_lo == v_hi
    held, lo, hi = (v_lo, w_lo, w_hi) if upright else (w_lo, v_lo, v_hi)
    noise = NOISE * box_scale(v_lo, v_hi, w_lo, w_hi)
    first, last = lo, hi
    for level, rows in enumerate(levels):
        for a_v, a_w, b in rows:
            across, along = (a_v, a_w) if upright else (a_w, a_v)
            size = abs(a_v) + abs(a_w)
            rest = b - across * held
            least, most = (along * lo, along * hi) if along > 0.0 else (along * hi, along * lo)
            if most - rest < -noise * size or not size:
                continue
            if least - rest > noise * size:
                return level
            if abs(along) * TRUSTED <= size:
                raise Delicate
            end = rest / along
            if along > 0.0:
                last = end if end < last else last
            else:
                first = end if end > first else first
            if last - first <= 4.0 * noise:
                if last - first < -4.0 * noise:
                    return level
                raise Delicate
    return first, last


def _minimum(
    objective: Objective[float], box: Sequence[float], held: float, upright: bool
) -> float:
    """The free input of least cost on the whole line."""
    check_trusted(objective, box)
    n_v, n_w, c, s_v, s_w = objective[3:8]
    slope = s_w if upright else s_v
    if c and abs(slope) * TRUSTED <= abs(s_v) + abs(s_w):
        raise Delicate
    # From the nominal value, so that nothing of its size cancels.
    if upright:
        return n_w + line_minimum(objective, held, n_w, 0.0, 1.0)
    return n_v + line_minimum(objective, n_v, held, 1.0, 0.0)
