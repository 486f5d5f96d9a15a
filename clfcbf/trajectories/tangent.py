r"""Candidates: an arc, the straight line tangent to it, and a terminal curve it runs into.

For a start with heading :math:`\theta_0` and an arc of radius :math:`R` to the side
:math:`\sigma` (left +1), the centre is :math:`c = p + \sigma R\,n(\theta_0)`. The line that
enters a terminal curve at its pose :math:`(\gamma, \psi)` leaves the arc tangentially when
:math:`n(\psi)^\top (c - \gamma) = \sigma R`, with :math:`n` the left normal: a change of sign
along the tabulated curve, for all starts, arcs and curves at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clfcbf.trajectories.terminal import TerminalCurves

__all__ = ["Candidates", "tangent_candidates"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Candidates:
    """One arc-line-curve path a row, all arrays of shape (n,).

    Attributes
    ----------
    start : row of the start it belongs to
    radius : radius of the arc [m], positive to the left
    swept : heading change on the arc [rad], of the sign of ``radius``
    straight : length of the line [m]
    curve, sample : terminal curve, and the sample on the goal's side of the entry
    part : place of the entry between ``sample`` and ``sample + 1``, in [0, 1]
    """

    start: Indices
    radius: Array
    swept: Array
    straight: Array
    curve: Indices
    sample: Indices
    part: Array

    def __len__(self) -> int:
        return len(self.start)


def tangent_candidates(
    starts: Array, radii: Array, curves: TerminalCurves, turn_limit: float = 1.1 * np.pi
) -> Candidates:
    """All arc-line-curve paths from each start.

    Parameters
    ----------
    starts : poses (x, y, heading) in the goal's frame, shape (m, 3)
    radii : radii to try to either side [m], shape (k,)
    curves : terminal curves
    turn_limit : largest heading change on the arc [rad]
    """
    signed = np.concatenate([radii, -radii])
    theta = starts[:, 2]
    centre_x = starts[:, 0, None] - signed[None, :] * np.sin(theta)[:, None]
    centre_y = starts[:, 1, None] + signed[None, :] * np.cos(theta)[:, None]
    sin, cos = np.sin(curves.heading), np.cos(curves.heading)
    own = cos * curves.y - sin * curves.x
    gap = (
        cos[None, None] * centre_y[..., None, None]
        - sin[None, None] * centre_x[..., None, None]
        - own[None, None]
        - signed[None, :, None, None]
    )
    crossing = (gap[..., :-1] >= 0.0) != (gap[..., 1:] >= 0.0)
    m, k, j, i = np.nonzero(crossing)
    here, there = gap[m, k, j, i], gap[m, k, j, i + 1]
    part = here / (here - there)

    def between(table: Array) -> Array:
        entry: Array = table[j, i] + part * (table[j, i + 1] - table[j, i])
        return entry

    psi = between(curves.heading)
    radius = signed[k]
    leave_x = centre_x[m, k] + radius * np.sin(psi)
    leave_y = centre_y[m, k] - radius * np.cos(psi)
    straight = np.cos(psi) * (between(curves.x) - leave_x)
    straight += np.sin(psi) * (between(curves.y) - leave_y)
    side = np.sign(radius)
    swept = side * np.mod(side * (psi - theta[m]) + 1e-9, 2.0 * np.pi)
    good = np.nonzero((straight >= 0.0) & (np.abs(swept) <= turn_limit))[0]
    return Candidates(
        m[good], radius[good], swept[good], straight[good], j[good], i[good], part[good]
    )
