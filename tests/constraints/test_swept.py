"""The lower bound over a sweep, for functions whose smallest value is known otherwise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.swept import CELLS, RESOLUTION, ROUNDING, Bundle, Grid, Seen, least_along
from clfcbf.se2 import Twist
from tests.constraints.sweeps import rectangle, sweeps

POINT = (np.array([0.8]), np.array([0.5]))
REACH = math.hypot(0.8, 0.5) + 0.5 * math.sqrt(2.0)


def linear(angle):
    """Depth in a half-plane of the robot's, through its centre."""
    n_x, n_y = math.cos(angle), math.sin(angle)

    def look(grid):
        x, y = grid.seen(*POINT)
        flat = np.zeros_like(x)
        return Seen(n_x * x + n_y * y, flat + n_x, flat + n_y, x, y)

    return look


@given(sweeps, st.integers(1, 5))
def test_nodes_are_the_poses_of_the_sweep(sweep, cells):
    grid = Grid.of(sweep, cells)
    for i, j in np.ndindex(grid.x.shape[:2]):
        share = i / cells if sweep.lag else 0.0
        pose = sweep.motion.moved(sweep.body, share * sweep.lag)
        pose = pose.moved(sweep.twist, j / cells * sweep.duration)
        assert (grid.x[i, j, 0], grid.y[i, j, 0]) == pytest.approx(pose[:2], abs=1e-12)
        assert grid.cos[i, j, 0] == pytest.approx(math.cos(pose.theta), abs=1e-12)
        assert grid.sin[i, j, 0] == pytest.approx(math.sin(pose.theta), abs=1e-12)


@given(sweeps)
def test_velocities_by_the_coasted_time_are_differences(sweep):
    grid, step = Grid.of(sweep, 2), 1e-5
    for j in range(3):
        braked = sweep.duration * j / 2

        def pose(e, braked=braked):
            return sweep.motion.moved(sweep.body, e).moved(sweep.twist, braked)

        ahead, behind = pose(step), pose(-step)
        x, y = (ahead.x - behind.x) / (2 * step), (ahead.y - behind.y) / (2 * step)
        c, s = math.cos(pose(0.0).theta), math.sin(pose(0.0).theta)
        along = float(grid.w_x[0, j, 0]), float(grid.w_y[0, j, 0])
        assert along == pytest.approx((c * x + s * y, c * y - s * x), abs=1e-8)


@given(sweeps, st.floats(-3.0, 3.0))
def test_a_linear_function_is_bounded_from_below_and_closely(sweep, angle):
    reach = REACH + sweep.travel
    bound = least_along(sweep, (Bundle(linear(angle), reach),))
    seen = [pose.seen((0.8, 0.5)) for pose in rectangle(sweep, 12)]
    least = min(math.cos(angle) * x + math.sin(angle) * y for x, y in seen)
    assert bound <= least + 2 * ROUNDING
    # Above 0 it stops as soon as the sign is sure.
    assert bound > min(least, 0.0) - 0.02


def test_on_a_straight_line_a_linear_function_is_exact():
    sweep = Sweep.of(HERE, Twist(0.3, 0.0), 0.2, Twist(0.2, 0.0), 0.5)
    bound = least_along(sweep, (Bundle(linear(0.0), 5.0),), 1.0)
    assert bound == pytest.approx(0.8 - 0.06 - 0.1 - 1.0, abs=1e-12)


@given(st.floats(0.2, 0.8), st.floats(0.1, 0.9))
def test_a_minimum_between_the_ends_is_found(omega, share):
    """Turning carries the point through the axis opposite to the normal: -|p| in the middle.

    From a value below 0 on, where more than the sign is asked for.
    """
    duration = 0.9
    angle = math.atan2(0.5, 0.8) + math.pi - share * omega * duration
    sweep = Sweep.of(HERE, Twist(0.0, 0.0), 0.0, Twist(0.0, omega), duration)
    bound = least_along(sweep, (Bundle(linear(angle), REACH),))
    least = -math.hypot(0.8, 0.5)
    # Twice half the acceleration times the square of a cell: of the tangent and of the bending.
    bent = REACH * (omega * duration / CELLS[-1]) ** 2
    assert least - RESOLUTION - bent < bound <= least + 2 * ROUNDING


def test_without_functions_there_is_no_bound():
    assert least_along(Sweep(), ()) == math.inf
