import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError, GeometryError, LimitsError
from clfcbf.limits import Limits, check_period
from clfcbf.se2 import Pose2, Twist
from tests.strategies import limits, periods, twists


@given(limits, twists, periods)
def test_the_input_box_is_never_empty_and_inside_the_acceleration_box(limits, applied, period):
    v_lo, v_hi, w_lo, w_hi = limits.input_box(applied, period)
    assert v_lo <= v_hi
    assert w_lo <= w_hi
    dv, dw = limits.a_max * period, limits.alpha_max * period
    for v in (v_lo, v_hi):
        assert abs(v - applied.v) <= dv * (1 + 1e-12) + 1e-15
    for w in (w_lo, w_hi):
        assert abs(w - applied.omega) <= dw * (1 + 1e-12) + 1e-15


@given(limits, twists, periods)
def test_the_input_box_is_all_that_is_allowed(limits, applied, period):
    """Corner by corner against the definition, inside the speed limits."""
    assume(limits.contains(applied))
    box = limits.input_box(applied, period)
    assert box.v_hi == min(limits.v_max, applied.v + limits.a_max * period)
    assert box.v_lo == max(limits.reverse_speed, applied.v - limits.a_max * period)
    assert box.w_hi == min(limits.omega_max, applied.omega + limits.alpha_max * period)
    assert box.w_lo == max(-limits.omega_max, applied.omega - limits.alpha_max * period)
    assert box.contains(applied)


def test_hand_over_from_a_faster_stage_slows_down_at_the_limit():
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    box = limits.input_box(Twist(0.55, 0.9), 1 / 30)
    assert box.v_lo == box.v_hi == 0.55 - 0.3 / 30
    assert box.w_lo == box.w_hi == 0.9 - 1.0 / 30
    ticks, applied = 0, Twist(0.55, 0.9)
    while not limits.contains(applied, 1e-12):
        box = limits.input_box(applied, 1 / 30)
        applied = Twist(box.v_hi, box.w_hi)
        ticks += 1
    assert ticks == math.ceil(0.33 / 0.01 - 1e-9)


@given(limits, twists, periods)
def test_braking_by_parts_stays_in_the_box_and_ends_at_rest(limits, twist, period):
    assume(limits.contains(twist))
    ticks = limits.brake_ticks(twist, period)
    assume(ticks < 500)
    command = twist
    for left in range(ticks, 0, -1):
        following = command.scaled(1.0 - 1.0 / left)
        assert limits.input_box(command, period).contains(following, 1e-12)
        command = following
    assert command == Twist(0.0, 0.0) or ticks == 0
    assert 0.5 * period * (ticks + 1) <= limits.brake_horizon(period) + 1e-12


@given(limits, twists, periods)
def test_clip_is_the_nearest_point(limits, applied, period):
    box = limits.input_box(applied, period)
    clipped = box.clip(Twist(9.0, -9.0))
    assert clipped == Twist(box.v_hi, box.w_lo)
    assert box.contains(clipped)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", ["v_max", "omega_max", "a_max", "alpha_max"])
def test_bad_limits_name_themselves(name, bad):
    good = {"v_max": 1.0, "omega_max": 1.0, "a_max": 1.0, "alpha_max": 1.0}
    with pytest.raises(LimitsError, match=name):
        Limits(**{**good, name: bad})


@pytest.mark.parametrize("bad", [0.1, math.nan, -math.inf])
def test_bad_reverse_speed(bad):
    with pytest.raises(LimitsError, match="v_min"):
        Limits(1.0, 1.0, 1.0, 1.0, v_min=bad)


def test_reverse_speed_defaults_to_forward_speed():
    assert Limits(0.3, 1.0, 1.0, 1.0).reverse_speed == -0.3
    assert Limits(0.3, 1.0, 1.0, 1.0, v_min=0.0).reverse_speed == 0.0


@pytest.mark.parametrize("bad", [0.0, -0.1, math.nan, math.inf])
def test_bad_period(bad):
    with pytest.raises(ConfigurationError, match="period"):
        check_period(bad)


@pytest.mark.parametrize("bad", [0.0, -0.5, math.pi / 2, 35.0, math.nan])
def test_bad_half_angle_mentions_degrees(bad):
    with pytest.raises(ConfigurationError, match="degrees"):
        FieldOfView(bad)


def test_bad_camera_and_width():
    with pytest.raises(ConfigurationError, match="camera"):
        FieldOfView(0.6, Pose2(math.nan, 0, 0))
    with pytest.raises(ConfigurationError, match="width"):
        FieldOfView(0.6, width=-0.1)


@given(st.floats(-1.5, 1.5), st.floats(0.1, 5.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_bearing_and_margin_of_an_offset_camera(bearing, distance, cx, yaw):
    camera = FieldOfView(0.6, Pose2(cx, 0.1, yaw))
    point = (cx + distance * math.cos(bearing + yaw), 0.1 + distance * math.sin(bearing + yaw))
    assert camera.bearing(point) == pytest.approx(bearing, abs=1e-9)
    assert camera.margin(point) == pytest.approx(0.6 - abs(bearing), abs=1e-9)
    camera.check_ahead(point)


def test_behind_the_camera_is_an_error_that_says_so():
    with pytest.raises(GeometryError, match="behind"):
        FieldOfView(0.6, Pose2(0.2, 0, 0)).check_ahead((0.1, 0.0))
    with pytest.raises(GeometryError, match="finite"):
        FieldOfView(0.6).check_ahead((math.nan, 0.0))
