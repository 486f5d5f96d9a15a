r"""A lower bound of a distance over all poses of a sweep, by tangents at the nodes of a grid.

The poses of a sweep are :math:`g\,\mathrm{Exp}(Eb)\,\mathrm{Exp}(Su)`. Let :math:`f` be the
distance to a convex set, or any other function of one point whose second derivative is at least
:math:`-\beta` along a line at unit speed. Where the point moves as :math:`p(E, S)`,

.. math::
    f(p(E + e, S + s)) \ge f(p) + e\,\nabla f^\top p_E + s\,\nabla f^\top p_S
        - \tfrac12(M_{EE}e^2 + 2M_{ES}es + M_{SS}s^2)

with :math:`M` the accelerations of the point plus :math:`\beta` times products of its speeds:
a convex function lies above its tangents, and only the bending of the arcs takes it below. On a
straight line the bound of a distance is a plain tangent.

Where the smallest value is at a node and the slopes around it are steeper than the bending, the
bound *is* that value, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clfcbf.constraints.barrier import Sweep
from clfcbf.se2 import arc

__all__ = ["CELLS", "RESOLUTION", "ROUNDING", "Array", "Bundle", "Grid", "Seen", "least_along"]

Array = NDArray[np.float64]

RESOLUTION = 1e-3
"""[m] A bound this near to the smallest value found is not made better: 1 mm of room unused."""

ROUNDING = 1e-12
"""[m] Given back for what arithmetic alone takes off between two poses that are nearly one: a
robot outside is asked not to lose clearance, and must not be refused for its last bit."""

CELLS = (2, 8)
"""Cells a side, first and where those do not decide: errors shrink with the square. With 8 an
arc of 0.4 rad about a point 1 m away is bounded to 3 mm, one of 0.2 rad to a millimetre."""


class Grid(NamedTuple):
    """Poses of a sweep at the nodes of a grid, ``(E_i, S_j)``; arrays of shape (m, n, 1).

    Attributes
    ----------
    sweep : the sweep itself
    x, y, cos, sin : position [m] and direction of the robot at each node
    w_x, w_y : velocity of the robot's origin by E, in its own axes, shape (1, n, 1) [m/s]
    """

    sweep: Sweep
    x: Array
    y: Array
    cos: Array
    sin: Array
    w_x: Array
    w_y: Array

    @classmethod
    def of(cls, sweep: Sweep, cells: int) -> Grid:
        """A grid of ``cells`` a side; one row of nodes stands for both where nothing lags."""
        motion, body, lag, twist, duration = sweep[:5]
        shares = [i / cells for i in range(cells + 1)]
        coasted = [motion.moved(body, share * lag) for share in (shares if lag else (0.0, 0.0))]
        braked = [arc(twist, share * duration) for share in shares]
        x, y, _ = np.array(coasted).T[:, :, None, None]
        cos = np.array([math.cos(pose[2]) for pose in coasted])[:, None, None]
        sin = np.array([math.sin(pose[2]) for pose in coasted])[:, None, None]
        d_x, d_y, _ = np.array(braked).T[:, None, :, None]
        c = np.array([math.cos(pose[2]) for pose in braked])[None, :, None]
        s = np.array([math.sin(pose[2]) for pose in braked])[None, :, None]
        v, omega = body
        forward, left = v - omega * d_y, omega * d_x
        return cls(
            sweep,
            x + cos * d_x - sin * d_y,
            y + sin * d_x + cos * d_y,
            cos * c - sin * s,
            sin * c + cos * s,
            c * forward + s * left,
            c * left - s * forward,
        )

    def seen(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Points as seen from each node, shape (m, n, k)."""
        d_x, d_y = x - self.x, y - self.y
        return self.cos * d_x + self.sin * d_y, self.cos * d_y - self.sin * d_x


class Seen(NamedTuple):
    """A function of points at rest, at the nodes of a grid; arrays of shape (m, n, k).

    Attributes
    ----------
    value : the function
    n_x, n_y : its gradient with respect to the point, in the robot's axes, at most of length 1
    x, y : the point, in the robot frame [m]
    bend : most negative second derivative along a line, as a positive number [1/m]
    """

    value: Array
    n_x: Array
    n_y: Array
    x: Array
    y: Array
    bend: float = 0.0


class Bundle(NamedTuple):
    """Functions seen over a sweep, and how far from the origin their points can be.

    ``look`` evaluates them on a grid; ``reach`` bounds the distance from the rotation centre of
    every point, and of every body-fixed point that stands for one, at any pose of the sweep [m].
    """

    look: Callable[[Grid], Seen]
    reach: float


def least_along(sweep: Sweep, bundles: tuple[Bundle, ...], off: float = 0.0) -> float:
    r"""A lower bound of the smallest value of any function, less ``off``, over a sweep.

    It is within :data:`RESOLUTION` of the true one or has its sign, as far as the finest grid
    goes; the sign is all that is asked of a sweep that starts at a value of at least 0. Plus
    infinity where there is no function.

    Parameters
    ----------
    sweep : its blur is not taken account of: pass it in ``off``
    bundles : functions to be bounded
    off : taken off every value
    """
    least = math.inf
    for bundle in bundles:
        bound = -math.inf
        for cells in CELLS:
            grid = Grid.of(sweep, cells)
            seen = bundle.look(grid)
            bound = _bound(grid, seen, cells, bundle.reach) - off
            found, first = float(seen.value.min()) - off, float(seen.value[0, 0].min()) - off
            if bound >= 0.0 or found < 0.0 <= first or found - bound <= RESOLUTION:
                break
        least = min(least, bound)
    return least + ROUNDING


def _bound(grid: Grid, seen: Seen, cells: int, reach: float) -> float:
    """The smallest over all cells of the best of the tangents at a cell's four corners."""
    _, (v_b, omega_b), lag, (v, omega), duration = grid.sweep[:5]
    value, n_x, n_y, x, y, bend = seen
    across = n_x * y - n_y * x
    by_s = omega * across - v * n_x
    by_e = omega_b * across - grid.w_x * n_x - grid.w_y * n_y
    speed, coasting = abs(v) + abs(omega) * reach, abs(v_b) + abs(omega_b) * reach
    m_ss = (abs(omega) + bend * speed) * speed
    m_ee = (abs(omega_b) + bend * coasting) * coasting
    # Of a point at rest seen from the robot the one, of a point of the robot the other.
    m_es = max(abs(omega) * coasting, abs(omega_b) * speed) + bend * speed * coasting
    e, s = (lag / cells if lag else 0.0), duration / cells
    bent_e, bent_s = 0.5 * (m_ee * e + m_es * s), 0.5 * (m_ss * s + m_es * e)
    on, back = e * np.minimum(by_e - bent_e, 0.0), e * np.minimum(-by_e - bent_e, 0.0)
    ahead, behind = s * np.minimum(by_s - bent_s, 0.0), s * np.minimum(-by_s - bent_s, 0.0)
    low, high = slice(None, -1), slice(1, None)
    bound = (value + on + ahead)[low, low]
    np.maximum(bound, (value + on + behind)[low, high], out=bound)
    np.maximum(bound, (value + back + ahead)[high, low], out=bound)
    np.maximum(bound, (value + back + behind)[high, high], out=bound)
    return float(bound.min())
