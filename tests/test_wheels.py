"""Wheel limits: the polytope of twists against the wheels themselves."""

import math
from fractions import Fraction

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from clfcbf.errors import LimitsError
from clfcbf.se2 import Twist, arc
from clfcbf.wheels import WheelLimits

wheels = st.builds(
    WheelLimits,
    track=st.floats(0.1, 1.5),
    radius=st.floats(0.02, 0.4),
    speed=st.floats(0.05, 3.0),
    acceleration=st.one_of(st.just(math.inf), st.floats(0.05, 5.0)),
)
twists = st.builds(Twist, st.floats(-4.0, 4.0), st.floats(-6.0, 6.0))
periods = st.floats(0.005, 0.2)


def exact_rims(limits: WheelLimits, twist: Twist) -> tuple[Fraction, Fraction]:
    """Rim speeds in exact rationals."""
    lead = Fraction(limits.track) * Fraction(twist.omega) / 2
    return Fraction(twist.v) - lead, Fraction(twist.v) + lead


@given(limits=wheels, twist=twists, duration=st.floats(0.01, 0.5))
def test_wheels_roll_as_far_as_their_contact_points_move(limits, twist, duration):
    """Arc lengths of two points beside the centre, from the exact arc cut into chords."""
    cuts = 400
    pose = arc(Twist(0.0, 0.0), 1.0)
    travelled = [0.0, 0.0]
    for _ in range(cuts):
        after = pose.moved(twist, duration / cuts)
        for index, side in enumerate((+0.5, -0.5)):
            x0, y0 = pose.transform((0.0, side * limits.track))
            x1, y1 = after.transform((0.0, side * limits.track))
            forward = (x1 - x0) * math.cos(pose.theta) + (y1 - y0) * math.sin(pose.theta)
            travelled[index] += forward
        pose = after
    rates = limits.wheel_rates(twist)
    for rate, length in zip(rates, travelled, strict=True):
        assert limits.radius * rate * duration == pytest.approx(length, abs=2e-4)


@given(limits=wheels, twist=twists)
def test_twist_and_wheel_rates_are_inverse(limits, twist):
    back = limits.twist_of(*limits.wheel_rates(twist))
    assert back == pytest.approx(twist, rel=1e-12, abs=1e-12)


@given(limits=wheels, twist=twists)
def test_contained_exactly_when_no_wheel_is_too_fast(limits, twist):
    fastest = max(abs(rim) for rim in exact_rims(limits, twist))
    assume(abs(fastest - Fraction(limits.speed)) > Fraction(1, 10**12))
    assert limits.contains(twist) == (fastest <= Fraction(limits.speed))


@given(limits=wheels, applied=twists, twist=twists, period=periods)
def test_rows_say_what_the_wheels_say(limits, applied, twist, period):
    """Speeds and accelerations of each wheel, in exact rationals, against the four rows."""
    assume(limits.contains(applied))
    box = limits.box(applied, period)
    ends = exact_rims(limits, twist)
    starts = exact_rims(limits, applied)
    excess = max(abs(end) - Fraction(limits.speed) for end in ends)
    if math.isfinite(limits.acceleration):
        step = Fraction(limits.acceleration) * Fraction(period)
        excess = max(excess, *(abs(e - s) - step for e, s in zip(ends, starts, strict=True)))
    rows = max(a * twist.v + c * twist.omega - b for a, c, b in box.rows)
    assert rows == pytest.approx(float(excess), abs=1e-12)
    assert len(set(box.names)) == len(box.rows)
    if abs(excess) > Fraction(1, 10**12):
        assert box.contains(twist) == (excess <= 0)


@given(limits=wheels, twist=twists)
def test_scaling_keeps_the_curvature_and_the_limit(limits, twist):
    slower = limits.scaled(twist)
    assert limits.contains(slower)
    cross = slower.v * twist.omega - slower.omega * twist.v
    assert cross == pytest.approx(0.0, abs=1e-12)
    if limits.contains(twist):
        assert slower == twist
    else:
        assert slower.v * twist.v >= 0.0
        assert slower.omega * twist.omega >= 0.0
        assert not limits.contains(slower.scaled(1.0 + 1e-9))


@example(
    limits=WheelLimits(0.84375, 0.25, 1.0, 0.05), applied=Twist(0.40625, 1.23828125),
    wanted=Twist(1.5, 0.0), period=0.125,
)  # fmt: skip
@given(limits=wheels, applied=twists, wanted=twists, period=periods)
def test_toward_is_inside_on_the_way_and_as_far_as_possible(limits, applied, wanted, period):
    safe = limits.scaled(applied)
    box = limits.box(safe, period)
    assume(box.contains(safe))
    found = box.toward(safe, wanted)
    assert box.contains(found)
    d = (wanted.v - safe.v, wanted.omega - safe.omega)
    length = math.hypot(*d)
    share = 1.0
    if length > 1e-6:
        share = ((found.v - safe.v) * d[0] + (found.omega - safe.omega) * d[1]) / length**2
        across = ((found.v - safe.v) * d[1] - (found.omega - safe.omega) * d[0]) / length
        assert abs(across) < 1e-12
        assert 0.0 <= share <= 1.0 + 1e-12
    if box.contains(wanted):
        assert found == wanted
    elif length > 1e-6:
        more = share + 1e-6
        assert not box.contains(Twist(safe.v + more * d[0], safe.omega + more * d[1]))


@given(limits=wheels, safe=twists, period=periods, bad=st.sampled_from([math.nan, math.inf]))
def test_toward_something_not_finite_stays(limits, safe, period, bad):
    box = limits.box(safe, period)
    assert box.toward(safe, Twist(bad, 0.0)) == safe
    assert box.toward(safe, Twist(0.0, bad)) == safe


def test_toward_from_outside_stays():
    limits = WheelLimits(track=0.4, radius=0.1, speed=0.5)
    box = limits.box(Twist(0.0, 0.0), 0.1)
    assert box.toward(Twist(1.0, 0.0), Twist(0.0, 0.0)) == Twist(1.0, 0.0)


@given(limits=wheels, twist=twists, period=periods)
def test_brake_along_the_curvature_keeps_every_wheel_limit(limits, twist, period):
    """The whole brake, tick by tick, inside the box of the command before it."""
    twist = limits.scaled(twist)
    ticks = limits.brake_ticks(twist, period)
    assume(ticks < 500)
    for left in range(ticks, 0, -1):
        after = twist.scaled(1.0 - 1.0 / left)
        assert limits.box(twist, period).contains(after, 1e-12)
        twist = after
    assert max(map(abs, twist)) <= 1e-12 or ticks == 0


@given(limits=wheels, twist=twists, period=periods)
def test_brake_is_as_short_as_the_acceleration_allows(limits, twist, period):
    assume(math.isfinite(limits.acceleration))
    step = Fraction(limits.acceleration) * Fraction(period)
    shortest = math.ceil(max(abs(rim) for rim in exact_rims(limits, twist)) / step)
    assert abs(limits.brake_ticks(twist, period) - shortest) <= 1


@given(limits=wheels, applied=twists, period=periods)
def test_box_is_never_empty_and_moves_toward_the_limits(limits, applied, period):
    box = limits.box(applied, period)
    step = limits.acceleration * period
    for low, high, rim in (
        (box.left_lo, box.left_hi, limits.rim_speeds(applied).left),
        (box.right_lo, box.right_hi, limits.rim_speeds(applied).right),
    ):
        assert low <= high
        assert low >= rim - step
        assert high <= rim + step
        if abs(rim) > limits.speed:
            assert max(abs(low), abs(high)) <= abs(rim)


@pytest.mark.parametrize("name", ["track", "radius", "speed", "acceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, -math.inf])
def test_bad_limits_are_named(name, value):
    good = {"track": 0.4, "radius": 0.08, "speed": 0.5, "acceleration": 1.0}
    with pytest.raises(LimitsError, match=rf"^{name} must be .*got {value!r}"):
        WheelLimits(**{**good, name: value})


@pytest.mark.parametrize("name", ["track", "radius", "speed"])
def test_only_the_acceleration_may_be_infinite(name):
    good = {"track": 0.4, "radius": 0.08, "speed": 0.5}
    assert WheelLimits(**good).acceleration == math.inf
    with pytest.raises(LimitsError, match=f"^{name} must be finite"):
        WheelLimits(**{**good, name: math.inf})
