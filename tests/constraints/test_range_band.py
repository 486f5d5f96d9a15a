"""The range barrier against finite differences and dense motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.constraints.barrier import HERE, Barrier, Sweep
from clfcbf.constraints.range_band import RangeBarrier
from clfcbf.constraints.swept import ROUNDING
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.se2 import Pose2, Twist
from tests.constraints.sweeps import any_order, motions, rectangle, scene_of, sweeps, twists
from tests.constraints.test_obstacles import derivative

GAIN = 1.3
coordinate = st.floats(-3.0, 3.0)
origins = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
bands = st.builds(
    RangeBarrier, st.floats(0.1, 0.8), st.floats(1.0, 3.0), st.just(GAIN), origins,
    st.floats(0.0, 0.04), st.just("range"),
)  # fmt: skip


def distance(band, robot, scene):
    """From the camera's place on the ground to the feature."""
    return math.dist(robot.transform(band.origin), scene.feature[:2])


def room(band, robot, scene):
    rho = distance(band, robot, scene)
    return min(rho - band.nearest, band.farthest - rho) - band.margin


@given(bands, coordinate, coordinate, motions, twists)
def test_rows_are_rates_of_the_distance(band, x, y, motion, twist):
    scene = scene_of(x, y)
    rho = distance(band, motion, scene)
    assume(rho > 0.1)
    rows = band.rows(scene, motion)
    assert rows.names == ("range.near", "range.far")
    margins = rho - band.nearest - band.margin, band.farthest - band.margin - rho
    assert rows.values == pytest.approx(margins)
    rate = derivative(lambda t: distance(band, motion.moved(twist, t), scene))
    for sign, value, (a_v, a_omega, b) in zip((1.0, -1.0), margins, rows.coefficients, strict=True):
        excess = a_v * twist.v + a_omega * twist.omega - b
        assert excess == pytest.approx(-sign * rate - GAIN * value, rel=1e-6, abs=1e-7)
    assert band.clearance(scene, motion) == pytest.approx(min(margins))


@given(bands, coordinate, coordinate, sweeps, st.integers(0, 10**6))
def test_along_is_below_every_pose_in_every_order(band, x, y, sweep, seed):
    scene = scene_of(x, y)
    assume(distance(band, sweep.motion, scene) > 1e-6)
    bound = band.clearance_along(scene, sweep)
    lowest = min(room(band, pose, scene) for pose in any_order(sweep, seed))
    assert bound <= lowest + 2 * ROUNDING
    here, crude = band.clearance_around(scene, sweep)
    assert here == pytest.approx(room(band, sweep.motion, scene), abs=1e-12)
    assert crude <= bound + ROUNDING


@pytest.mark.parametrize("side", ["near", "far"])
def test_along_is_tight(side):
    rng = np.random.default_rng(5)
    band = RangeBarrier(0.6, 1.6, GAIN, (0.2, 0.0))
    gaps, refused = [], []
    while len(gaps) < 30 or len(refused) < 30:
        sweep = Sweep.of(
            Pose2(*rng.uniform(-0.2, 0.2, 3)), Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.28,
            Twist(*rng.uniform((-0.3, -0.5), (0.3, 0.5))), 0.45,
        )._replace(blur=0.0)  # fmt: skip
        reach, bearing = rng.uniform(0.5, 1.8), rng.uniform(-1.5, 1.5)
        scene = scene_of(0.2 + reach * math.cos(bearing), reach * math.sin(bearing))
        bound = band.clearance_along(scene, sweep)
        near = distance(band, sweep.motion, scene) < 1.1
        if -0.2 < bound < 0.0 and near == (side == "near"):
            least = min(room(band, pose, scene) for pose in rectangle(sweep, 20))
            inside = room(band, sweep.motion, scene) >= 0.0
            (refused if inside else gaps).append(least - (0.0 if inside else bound))
    assert min(gaps) >= -2 * ROUNDING
    assert max(gaps) < 4e-3
    assert max(refused) < 4e-3


def test_the_nearest_point_of_an_arc_can_be_in_its_middle():
    """Driving past the feature: both ends are in the band, the middle is not."""
    band = RangeBarrier(0.5, 9.0, GAIN)
    scene = scene_of(0.5, 0.45)
    sweep = Sweep.of(HERE, Twist(0, 0), 0.0, Twist(1.0, 0.0), 1.0)
    ends = [band.clearance(scene, pose) for pose in sweep.corners()]
    assert min(ends) > 0.1
    assert band.clearance_along(scene, sweep) <= -0.05 + 2 * ROUNDING
    # It is the middle that it looks at: a band that holds that is admitted.
    assert RangeBarrier(0.447, 9.0, GAIN).clearance_along(scene, sweep) >= 0.0


def test_the_farthest_can_be_in_the_middle_too():
    """Turning about a centre on the feature's far side: away and back again."""
    twist, duration = Twist(-0.5, 1.0), 1.0
    halfway = HERE.moved(twist, 0.5 * duration)
    centre = (0.0, -0.5)  # of the circle of radius 0.5
    away = halfway.x - centre[0], halfway.y - centre[1]
    scene = scene_of(centre[0] - 2.0 * away[0], centre[1] - 2.0 * away[1])
    band = RangeBarrier(0.1, 1.48, GAIN)
    sweep = Sweep.of(HERE, Twist(0, 0), 0.0, twist, duration)
    ends = [band.clearance(scene, pose) for pose in sweep.corners()]
    assert min(ends) > 0.02
    middle = band.clearance(scene, halfway)
    assert middle == pytest.approx(-0.02)
    assert band.clearance_along(scene, sweep) <= middle + 2 * ROUNDING
    assert RangeBarrier(0.1, 1.52, GAIN).clearance_along(scene, sweep) >= 0.0


@given(st.floats(0.0, 0.3), st.floats(0.0, 0.25))
def test_along_is_exact_on_the_way_back(speed, lag):
    band = RangeBarrier(0.6, 2.0, GAIN)
    for x, sign in ((0.5, -1.0), (2.2, 1.0)):
        scene = scene_of(x, 0.0)
        twist = Twist(sign * speed, 0.0)
        sweep = Sweep.of(HERE, twist, lag, twist, 0.4)
        here = band.clearance(scene)
        assert here < 0.0
        assert 0.0 <= band.clearance_along(scene, sweep) - here <= 2 * ROUNDING


def test_open_sides_have_no_row():
    scene = scene_of(1.0, 0.5)
    far = RangeBarrier(0.0, 2.0, GAIN)
    assert far.rows(scene).names == ("range.far",)
    assert far.clearance(scene_of(0.0, 0.0)) == 2.0
    near = RangeBarrier(0.3, math.inf, GAIN)
    assert near.rows(scene).names == ("range.near",)
    assert isinstance(near, Barrier)


def test_at_the_feature_itself():
    band = RangeBarrier(0.3, 2.0, GAIN)
    assert band.clearance(scene_of(0.0, 0.0)) == -math.inf
    assert band.rows(scene_of(0.0, 0.0)).coefficients[0][:2] == (0.0, 0.0)
    sweep = Sweep.of(HERE, Twist(0.1, 0.2), 0.1, Twist(0.1, 0.2), 0.3)
    assert band.clearance_along(scene_of(0.0, 0.0), sweep) == -math.inf


def test_bare_has_no_margin():
    band = RangeBarrier(0.3, 2.0, GAIN, margin=0.1)
    assert band.bare.clearance(scene_of(1.0, 0.0)) == pytest.approx(0.7)
    assert band.clearance(scene_of(1.0, 0.0)) == pytest.approx(0.6)


@pytest.mark.parametrize(
    "setting",
    [
        {"nearest": -0.1}, {"nearest": 2.5}, {"farthest": math.nan}, {"margin": 0.85},
        {"nearest": 0.0, "margin": 2.0}, {"margin": -0.1}, {"gain": 0.0},
        {"origin": (math.nan, 0.0)},
    ],
)  # fmt: skip
def test_bad_settings(setting):
    *_, name = setting
    match = "band" if name in ("nearest", "farthest") else name
    with pytest.raises(ConfigurationError, match=match):
        RangeBarrier(**{"nearest": 0.3, "farthest": 2.0, "gain": 1.0, **setting})


def test_scenes_that_are_not_finite():
    band = RangeBarrier(0.3, 2.0, GAIN)
    for ask in (band.rows, band.clearance):
        with pytest.raises(GeometryError, match="feature"):
            ask(scene_of(math.nan, 0.0))
        with pytest.raises(GeometryError, match="feature"):
            ask(scene_of(1e200, 0.0))
    for ask in (band.clearance_along, band.clearance_around):
        with pytest.raises(GeometryError, match="motion"):
            ask(scene_of(1.0, 0.0), Sweep(Pose2(math.inf, 0.0, 0.0)))
