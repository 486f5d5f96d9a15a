import math
from fractions import Fraction

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.errors import ConfigurationError, GeometryError, LimitsError
from clfcbf.limits import InputBox, Limits, check_period
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


speeds = st.floats(-3.0, 3.0)
wide_twists = st.builds(Twist, speeds, speeds)
boxes = st.builds(
    lambda v, dv, w, dw: InputBox(v, v + dv, w, w + dw),
    speeds,
    st.floats(0.0, 2.0),
    speeds,
    st.floats(0.0, 2.0),
)


@given(boxes, wide_twists)
def test_clip_moves_each_coordinate_to_the_nearer_end(box, twist):
    expected = (
        min(max(twist.v, box.v_lo), box.v_hi),
        min(max(twist.omega, box.w_lo), box.w_hi),
    )
    clipped = box.clip(twist)
    assert clipped == Twist(*expected)
    assert isinstance(clipped, Twist)
    assert box.contains(clipped)
    assert box.clip(clipped) == clipped


@given(boxes, wide_twists, st.floats(0.0, 1.0))
def test_a_box_contains_what_is_no_further_than_the_tolerance(box, twist, tolerance):
    (v, w), (v_lo, v_hi, w_lo, w_hi) = twist, box
    distance = max(v_lo - v, v - v_hi, w_lo - w, w - w_hi)
    assume(abs(distance - tolerance) > 1e-12)
    assert box.contains(twist, tolerance) == (distance < tolerance)


def test_the_corners_of_a_box_are_in_it():
    box = InputBox(-0.25, 0.5, -1.0, 0.125)
    for v in (box.v_lo, box.v_hi):
        for w in (box.w_lo, box.w_hi):
            assert box.contains(Twist(v, w))
    for outside in (Twist(-0.5, 0.0), Twist(1.0, 0.0), Twist(0.0, -2.0), Twist(0.0, 1.0)):
        assert not box.contains(outside)
        assert not box.contains(outside, 0.1)


@given(limits, wide_twists, st.floats(0.0, 1.0))
def test_speed_limits_contain_what_is_no_further_than_the_tolerance(limits, twist, tolerance):
    v, w = twist
    distance = max(limits.reverse_speed - v, v - limits.v_max, abs(w) - limits.omega_max)
    assume(abs(distance - tolerance) > 1e-12)
    assert limits.contains(twist, tolerance) == (distance < tolerance)


def test_the_ends_of_the_speed_limits_are_within_them():
    limits = Limits(0.5, 0.75, 1.0, 1.0, v_min=-0.25)
    for v in (-0.25, 0.5):
        for w in (-0.75, 0.75):
            assert limits.contains(Twist(v, w))
    assert limits.contains(Twist(0.625, -0.875), 0.125)
    assert limits.contains(Twist(-0.375, 0.875), 0.125)


@given(limits, wide_twists, periods)
def test_the_input_box_is_the_nearest_to_the_speed_limits(limits, applied, period):
    """Each end is the end of the acceleration box, brought as near to the limits as it allows."""
    dv, dw = limits.a_max * period, limits.alpha_max * period
    box = limits.input_box(applied, period)
    for (lo, hi), centre, reach, (least, most) in (
        ((box.v_lo, box.v_hi), applied.v, dv, (limits.reverse_speed, limits.v_max)),
        ((box.w_lo, box.w_hi), applied.omega, dw, (-limits.omega_max, limits.omega_max)),
    ):
        inner, outer = centre - reach, centre + reach
        assert lo == min(max(inner, least), outer) if inner <= most else lo == inner
        assert hi == max(min(outer, most), inner) if outer >= least else hi == outer


@given(limits, wide_twists, periods)
def test_ticks_of_a_brake_are_the_fewest_that_suffice(limits, twist, period):
    """In rational arithmetic, to the rounding of one division."""
    ticks = limits.brake_ticks(twist, period)
    needed = max(
        Fraction(abs(twist.v)) / (Fraction(limits.a_max) * Fraction(period)),
        Fraction(abs(twist.omega)) / (Fraction(limits.alpha_max) * Fraction(period)),
    )
    assert isinstance(ticks, int)
    assert needed * (1 - Fraction(1, 10**14)) <= ticks < needed * (1 + Fraction(1, 10**14)) + 1


def test_ticks_of_an_absurd_twist_are_bounded():
    limits = Limits(1.0, 1.0, 1.0, 1.0)
    assert limits.brake_ticks(Twist(-1e300, 0.0), 0.1) == 1_000_000_000
    assert limits.brake_ticks(Twist(0.0, math.inf), 0.1) == 1_000_000_000


@given(limits, periods)
def test_the_horizon_is_that_of_the_fastest_command(limits, period):
    """Forward or backward, whichever is faster, while turning at the limit."""
    fastest = max(
        limits.brake_ticks(Twist(v, w), period)
        for v in (limits.v_max, limits.reverse_speed)
        for w in (limits.omega_max, -limits.omega_max)
    )
    expected = period * (fastest + 1) / 2
    assert limits.brake_horizon(period) == pytest.approx(expected, rel=1e-15)


def test_settings_at_the_ends_of_their_ranges():
    assert Limits(1.0, 1.0, 1.0, 1.0, v_min=-0.0).reverse_speed == 0.0
    assert check_period(0.25) == 0.25


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


@pytest.mark.parametrize("name", ["v_max", "omega_max", "a_max", "alpha_max"])
def test_a_limit_too_small_to_count_with_is_refused(name):
    values = {"v_max": 0.2, "omega_max": 0.4, "a_max": 0.3, "alpha_max": 1.0}
    least = Limits(**{**values, name: 1e-9})
    assert least.brake_ticks(Twist(0.2, 0.4), 1e-3) > 0
    with pytest.raises(LimitsError, match=f"{name} must be at least 1e-09, got 5e-324"):
        Limits(**{**values, name: 5e-324})
    with pytest.raises(LimitsError, match=f"{name} must be finite and positive, got 0.0"):
        Limits(**{**values, name: 0.0})
