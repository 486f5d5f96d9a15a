"""The guard's theorem: from an admissible command a certified brake keeps the view."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from clfcbf.camera import FieldOfView
from clfcbf.constraints.barrier import HERE, Sweep
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.errors import ConfigurationError
from clfcbf.estimation import body_after
from clfcbf.guard import ROUNDING, Brake, Guard, Verdict, moved_scene
from clfcbf.limits import InputBox, Limits
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc

PERIOD = 1 / 30
REST = Twist(0.0, 0.0)

cameras = st.builds(
    FieldOfView,
    half_angle=st.floats(0.3, 1.2),
    camera=st.builds(Pose2, st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(-0.25, 0.25)),
)
all_limits = st.builds(
    Limits,
    v_max=st.floats(0.1, 0.6),
    omega_max=st.floats(0.1, 1.0),
    a_max=st.floats(0.1, 1.0),
    alpha_max=st.floats(0.3, 2.0),
)


def guard_of(camera, limits, lag=0.0, margin=0.0):
    return Guard(limits, (FieldOfViewBarrier(camera, 1.0, margin),), PERIOD, lag)


def scene_at(camera, distance, bearing):
    x, y, yaw = camera.camera
    feature = Pose2(
        x + distance * math.cos(yaw + bearing), y + distance * math.sin(yaw + bearing), 0.0
    )
    return Scene(feature, feature, 0.0)


def lowest_on_arc(guard, scene, twist, duration, samples=200):
    return min(
        guard.clearance(moved_scene(scene, arc(twist, t)))
        for t in np.linspace(0.0, duration, samples)
    )


@given(cameras, st.floats(0.3, 3.0), st.floats(-1.0, 1.0), st.floats(-0.6, 0.6),
       st.floats(-1.0, 1.0), st.floats(0.01, 1.0))  # fmt: skip
def test_an_arc_with_both_ends_in_view_is_in_view(camera, distance, share, v, omega, duration):
    """Densely sampled, while the point is ahead of camera and rotation centre, and the robot's
    forward direction is in view.
    """
    assume(abs(camera.camera.theta) < camera.half_angle)
    scene = scene_at(camera, distance, share * camera.half_angle)
    guard = guard_of(camera, Limits(1, 1, 1, 1))
    ends = min(
        guard.clearance(scene), guard.clearance(moved_scene(scene, arc(Twist(v, omega), duration)))
    )
    assume(ends >= 0.0)
    samples = np.linspace(0.0, duration, 50)
    seen = [arc(Twist(v, omega), t).seen(scene.feature) for t in samples]
    assume(min(x for x, _ in seen) > 0.0)
    assert lowest_on_arc(guard, scene, Twist(v, omega), duration) >= -1e-9


@given(cameras, all_limits, st.floats(0.3, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
       st.floats(-1.0, 1.0))  # fmt: skip
def test_an_admissible_command_has_an_admissible_brake(camera, limits, distance, share, v, w):
    twist = Twist(v * limits.v_max, w * limits.omega_max)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, distance, share * camera.half_angle)
    assume(guard.clearance(scene) >= 0.0)
    brake = guard.brake_from(twist)
    assume(guard.admissible(scene, guard.sweep(REST, brake)))
    while brake.ticks > 0:
        assert lowest_on_arc(guard, scene, brake.twist, PERIOD, 20) >= -1e-9
        scene = moved_scene(scene, arc(brake.twist, PERIOD))
        following = brake.next()
        box = limits.input_box(brake.twist, PERIOD)
        assert box.contains(following.twist, 1e-12)
        rest = arc(following.twist, 0.5 * PERIOD * (following.ticks + 1))
        assert guard.clearance(moved_scene(scene, rest)) >= -1e-9
        brake = following
    assert brake.twist == REST


def run(guard, camera, scene, commands, lag):
    """Adversarial commands through the guard, on a body that lags; smallest clearance seen."""
    limits = guard.limits
    body, applied, brake = REST, REST, Brake(REST, 0)
    lowest, braked = guard.clearance(scene), 0
    for wanted in commands:
        box = limits.input_box(applied, PERIOD)
        outcome = guard.filter(box.clip(wanted), scene, body, box, brake)
        assert outcome.certified
        assert box.contains(outcome.twist, 1e-12)
        braked += outcome.verdict is not Verdict.ADMITTED
        brake, applied = outcome.brake, outcome.twist
        for _ in range(4):
            body, mean = body_after(body, applied, PERIOD / 4, lag)
            scene = moved_scene(scene, arc(mean, PERIOD / 4))
            lowest = min(lowest, guard.clearance(scene))
    return lowest, braked


bang_bang = st.lists(
    st.tuples(
        st.sampled_from([-9.0, 0.0, 9.0]), st.sampled_from([-9.0, 0.0, 9.0]), st.integers(1, 25)
    ),
    min_size=2,
    max_size=10,
)


@settings(max_examples=60)
@given(all_limits, st.floats(0.5, 3.0), st.floats(-0.9, 0.9), bang_bang)
def test_an_adversary_never_loses_the_view_without_lag(limits, distance, share, switches):
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    lowest, _ = run(
        guard, camera, scene_at(camera, distance, share * camera.half_angle), commands, 0.0
    )
    assert lowest >= -1e-9


@settings(max_examples=60)
@given(st.sampled_from([0.05, 0.12, 0.25]), st.floats(0.6, 3.0), st.floats(-0.9, 0.9), bang_bang)
def test_an_adversary_stays_within_the_declared_margin_with_lag(lag, distance, share, switches):
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits, lag=0.25)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    start = scene_at(camera, distance, share * camera.half_angle)
    lowest, _ = run(guard, camera, start, commands, lag)
    assert lowest >= -math.radians(0.5)


@settings(max_examples=150)
@given(
    all_limits, st.floats(0.0, 0.3), st.floats(0.3, 3.0), st.floats(-0.9, 0.9), bang_bang,
    st.floats(0.0, 1.0),
)  # fmt: skip
def test_no_margin_is_needed_for_a_known_lag(limits, lag, distance, share, switches, cover):
    """The corners of (coast, brake) with the blur of their order are exact: no margin at all.

    The body lags by any ``lag``, its twist is known, and the guard covers a lag at least as long.
    """
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    guard = guard_of(camera, limits, lag=lag + 0.1 * cover)
    commands = [Twist(v, w) for v, w, n in switches for _ in range(n)]
    start = scene_at(camera, distance, share * camera.half_angle)
    lowest, _ = run(guard, camera, start, commands, lag)
    assert lowest >= -1e-9


def test_the_adversary_wins_without_the_guard():
    """So the two tests above have teeth."""
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    open_guard = Guard(limits, (), PERIOD)
    judge = guard_of(camera, limits)
    scene, body, applied, brake = scene_at(camera, 1.5, 0.0), REST, REST, Brake(REST, 0)
    for _ in range(60):
        box = limits.input_box(applied, PERIOD)
        outcome = open_guard.filter(box.clip(Twist(0.22, 0.4)), scene, body, box, brake)
        brake, applied = outcome.brake, outcome.twist
        scene = moved_scene(scene, arc(applied, PERIOD))
    assert judge.clearance(scene) < -0.05


def test_the_brake_is_counted_down_exactly():
    for n in range(1, 200):
        brake = Brake(Twist(0.22, -0.4), n)
        seen = 0
        while brake.ticks:
            brake = brake.next()
            seen += 1
        assert seen == n
        assert brake.twist == REST


def test_outside_the_view_it_may_turn_back_but_not_further_out():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits, lag=0.25)
    scene = scene_at(camera, 1.5, math.radians(40))
    box = limits.input_box(REST, PERIOD)
    inward = guard.filter(Twist(0.0, 1 / 30), scene, REST, box, Brake(REST, 0))
    outward = guard.filter(Twist(0.0, -1 / 30), scene, REST, box, Brake(REST, 0))
    assert inward.verdict is Verdict.ADMITTED
    assert inward.clearance == pytest.approx(math.radians(-5))
    assert outward.verdict is not Verdict.ADMITTED
    assert outward.twist.omega >= 0.0


def test_behind_the_camera_it_brakes():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, 1.5, math.radians(120))
    applied = Twist(0.1, 0.1)
    brake = Brake(applied, limits.brake_ticks(applied, PERIOD), True)
    outcome = guard.filter(applied, scene, applied, limits.input_box(applied, PERIOD), brake)
    assert outcome.verdict is Verdict.BRAKED
    assert outcome.twist == brake.next().twist
    assert outcome.certified


def test_a_chassis_that_did_not_follow_voids_the_certificate():
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits)
    scene = scene_at(camera, 1.5, math.radians(120))
    elsewhere = Twist(0.2, 0.0)
    box = limits.input_box(elsewhere, PERIOD)
    outcome = guard.filter(elsewhere, scene, elsewhere, box, Brake(REST, 0))
    assert not outcome.certified
    assert outcome.twist == Twist(box.v_lo, 0.0)


@pytest.mark.parametrize("lag", [-0.1, math.nan, math.inf])
def test_bad_lag(lag):
    with pytest.raises(ConfigurationError, match="lag"):
        Guard(Limits(1, 1, 1, 1), (), PERIOD, lag)


def test_recovery_from_outside_does_not_stall_with_lag():
    """A lagging body outside the view is turned back in, not started and stopped."""
    camera = FieldOfView(math.radians(35), Pose2(0.2, 0, 0))
    limits = Limits(0.22, 0.4, 0.3, 1.0)
    guard = guard_of(camera, limits, lag=0.28, margin=math.radians(3))
    scene = scene_at(camera, 1.5, math.radians(38))
    body, applied, brake = REST, REST, Brake(REST, 0)
    for _ in range(90):
        box = limits.input_box(applied, PERIOD)
        inward = box.clip(Twist(0.0, -1.5 * min(guard.clearance(scene), 0.0)))
        outcome = guard.filter(inward, scene, body, box, brake)
        brake, applied = outcome.brake, outcome.twist
        body, mean = body_after(body, applied, PERIOD, 0.12)
        scene = moved_scene(scene, arc(mean, PERIOD))
    assert guard.clearance(scene) > math.radians(-0.3)


class Scripted:
    """A barrier that answers as told and keeps what it was asked: the guard's logic by itself."""

    name = "scripted"

    def __init__(self, here=1.0, bound=-math.inf, along=-1.0, coasted=1.0, rows=()):
        self.here, self.bound, self.along = here, bound, along
        self.at_rest, self.lines = coasted, rows
        self.asked, self.at = [], []
        self.motion = HERE

    def rows(self, scene, motion=None):
        names = tuple(f"row{i}" for i in range(len(self.lines)))
        coefficients = tuple((a, c, 0.0) for a, c, _ in self.lines)
        return Rows(names, coefficients, Priority.SAFETY, tuple(h for _, _, h in self.lines))

    def clearance(self, scene, motion=HERE):
        self.at.append(motion)
        return self.here if motion == self.motion else self.at_rest

    def clearance_around(self, scene, sweep):
        return self.here, self.bound

    def clearance_along(self, scene, sweep):
        self.asked.append(sweep)
        return self.along(sweep.twist) if callable(self.along) else self.along


LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
STRAIGHT = Scene(Pose2(2.0, 0.5, 0.1), Pose2(2.5, 0.5, 0.1), 7.0)
BODY = Twist(0.05, -0.1)
MOVED = Pose2(0.1, -0.05, 0.2)
unit = st.floats(0.0, 1.0)


SHARES = (0.25, 0.5, 0.75)
PARTS = 4  # commands that may be sent in place of a refused one


def candidates_between(safe, wanted, box):
    """What may be sent instead: parts of the way from the brake, then the turn alone."""
    dv, dw = wanted.v - safe.v, wanted.omega - safe.omega
    way = [Twist(safe.v + k * dv, safe.omega + k * dw) for k in SHARES]
    return [box.clip(t) for t in (*way, Twist(safe.v, wanted.omega))]


def tried_between(safe, wanted, box, good=lambda _: False):
    """What is tried in place of ``wanted``, in order, and what is sent of it."""
    if safe == wanted:
        return [], None
    less, half, more, turn = candidates_between(safe, wanted, box)
    if good(half):
        return [half, more], more if good(more) else half
    tried = [half]
    for other in (less, turn):
        tried.append(other)
        if good(other):
            return tried, other
    return tried, None


def one_of(twists):
    return lambda twist: any(twist == pytest.approx(other) for other in twists)


def assert_asked(barrier, guard, expected, body=BODY, motion=MOVED):
    """It was asked about these commands in this order, each with its own brake's sweep."""
    assert len(barrier.asked) == len(expected)
    for sweep, twist in zip(barrier.asked, expected, strict=True):
        assert sweep.twist == pytest.approx(twist, abs=1e-15)
        ticks = max(
            math.ceil(abs(sweep.twist.v) / (LIMITS.a_max * PERIOD)),
            math.ceil(abs(sweep.twist.omega) / (LIMITS.alpha_max * PERIOD)),
        )
        assert (sweep.motion, sweep.body, sweep.lag) == (motion, body, guard.lag)
        assert sweep.duration == pytest.approx(PERIOD * (ticks + 1) / 2, rel=1e-12)


@st.composite
def ticks_of_the_guard(draw):
    """A command within the limits, the box that it leaves, and a brake with its next one there."""
    applied = Twist(
        LIMITS.v_max * draw(st.floats(-1.0, 1.0)), LIMITS.omega_max * draw(st.floats(-1.0, 1.0))
    )
    box = LIMITS.input_box(applied, PERIOD)

    def inside():
        v = box.v_lo + draw(unit) * (box.v_hi - box.v_lo)
        return Twist(v, box.w_lo + draw(unit) * (box.w_hi - box.w_lo))

    ticks = draw(st.integers(2, 30))
    brake = Brake(inside().scaled(ticks / (ticks - 1)), ticks, draw(st.booleans()))
    return box.clip(inside()), box, brake


admitted_parts = st.sets(st.integers(0, PARTS - 1))


@given(ticks_of_the_guard(), st.booleans(), admitted_parts)
def test_the_nearest_admissible_found_by_bisection_is_sent(case, whole, parts):
    wanted, box, brake = case
    safe = box.clip(brake.next().twist)
    between = candidates_between(safe, wanted, box)
    good = one_of([*([wanted] if whole else []), *[between[i] for i in sorted(parts)]])
    barrier = Scripted(along=lambda twist: 0.0 if good(twist) else -1.0)
    barrier.motion = MOVED
    guard = Guard(LIMITS, (barrier,), PERIOD, 0.1)
    outcome = guard.filter(wanted, STRAIGHT, BODY, box, brake, MOVED)
    tried, found = ([], wanted) if good(wanted) else tried_between(safe, wanted, box, good)
    assert_asked(barrier, guard, [wanted, *tried])
    assert outcome.clearance == 1.0
    if found is None:
        assert outcome.verdict is Verdict.BRAKED
        assert outcome.twist == safe
        followed = box.contains(brake.next().twist, ROUNDING)
        assert outcome.certified == outcome.brake.verified == (followed and brake.verified)
        return
    assert outcome.twist == pytest.approx(found, abs=1e-15)
    assert outcome.verdict is (Verdict.REPLACED if tried else Verdict.ADMITTED)
    assert outcome.certified is True
    assert outcome.brake == Brake(outcome.twist, LIMITS.brake_ticks(outcome.twist, PERIOD), True)
    assert isinstance(outcome.brake.twist, Twist)


@pytest.mark.parametrize("here", [1.0, -0.1])
@pytest.mark.parametrize(("v", "w"), [(1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 0.0)])
def test_a_command_that_differs_in_one_part_alone_has_candidates_too(v, w, here):
    """And the brake itself, wanted and refused, is not tried again."""
    barrier = Scripted(here=here, along=-9.0)
    guard = Guard(LIMITS, (barrier,), PERIOD, 0.1)
    brake = Brake(Twist(0.1, 0.1), 20, True)
    box = LIMITS.input_box(brake.twist, PERIOD)
    safe = brake.next().twist
    wanted = box.clip(Twist(safe.v + 0.005 * v, safe.omega + 0.005 * w))
    outcome = guard.filter(wanted, STRAIGHT, BODY, box, brake)
    between, _ = tried_between(safe, wanted, box)
    assert len(between) == (3 if v or w else 0)
    assert_asked(barrier, guard, [wanted, *between], motion=HERE)
    assert outcome.verdict is Verdict.BRAKED


def test_outside_coasting_is_along_the_bodys_own_arc_for_all_of_the_lag():
    """For what is kept and for what is certified."""
    barrier = Scripted(here=-0.1, coasted=-0.2, along=-0.2)
    barrier.bare = Scripted(here=0.1, coasted=0.1)
    barrier.motion = barrier.bare.motion = MOVED
    guard = Guard(LIMITS, (barrier,), PERIOD, 0.3)
    box = LIMITS.input_box(REST, PERIOD)
    guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0), MOVED)
    ends = [motion for motion in (*barrier.at, *barrier.bare.at) if motion != MOVED]
    assert len(ends) == 2
    for end in ends:
        assert end == pytest.approx(MOVED.compose(arc(BODY, 0.3)), abs=1e-15)


@pytest.mark.parametrize("bounds", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.0, -0.1), (-0.1, 0.0)])
def test_the_cheap_bound_of_every_barrier_answers_alone_or_not_at_all(bounds):
    first, second = (Scripted(here=h, bound=b) for h, b in zip((0.7, 0.6), bounds, strict=True))
    box = LIMITS.input_box(REST, PERIOD)
    for barriers in ((first, second), (second, first)):
        guard = Guard(LIMITS, barriers, PERIOD)
        outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
        assert (outcome.verdict is Verdict.ADMITTED) == (min(bounds) >= 0.0)
        assert outcome.clearance == 0.6


@pytest.mark.parametrize(("beyond", "certified"), [(0.5e-12, True), (3e-12, False), (0.1, False)])
@pytest.mark.parametrize("here", [1.0, -0.1])
def test_what_is_beyond_the_speed_limits_is_not_certified(beyond, certified, here):
    """Its next command is forced by them; inside and outside the safe set alike."""
    fast = Twist(LIMITS.v_max + beyond, 0.0)
    around = InputBox(fast.v - 0.01, fast.v, -0.03, 0.03)
    for along in (1.0, lambda twist: -1.0 if twist == fast else 1.0):
        barrier = Scripted(here=here, along=along, coasted=0.5)
        barrier.bare = Scripted(here=0.5)
        guard = Guard(LIMITS, (barrier,), PERIOD)
        brake = Brake(fast, LIMITS.brake_ticks(fast, PERIOD), True)
        outcome = guard.filter(fast, STRAIGHT, BODY, around, brake)
        if outcome.verdict is Verdict.ADMITTED:
            assert outcome.certified is certified
            assert outcome.brake.verified is certified
        else:
            assert outcome.verdict is Verdict.REPLACED
            beyond_now = outcome.twist.v - LIMITS.v_max
            assert outcome.certified is (beyond_now <= ROUNDING)


@pytest.mark.parametrize(
    ("short", "admitted"), [(0.0, True), (0.5e-12, True), (ROUNDING, True), (3e-12, False)]
)
@pytest.mark.parametrize(("here", "coasted"), [(-0.2, 0.3), (-0.2, -0.4), (-0.2, -0.1)])
def test_outside_what_does_not_make_it_worse_is_admitted(here, coasted, short, admitted):
    """To rounding; what coasting alone makes worse is no reason to refuse the way back."""
    floor = min(here, coasted)
    barrier = Scripted(here=here, coasted=coasted, along=floor - short)
    other = Scripted(here=0.1, along=0.0)
    guard = Guard(LIMITS, (other, barrier), PERIOD, 0.1)
    box = LIMITS.input_box(REST, PERIOD)
    wanted = Twist(box.v_hi, box.w_lo)
    outcome = guard.filter(wanted, STRAIGHT, BODY, box, Brake(REST, 0))
    assert (outcome.verdict is Verdict.ADMITTED) == admitted
    assert outcome.clearance == here
    # Inside its set a barrier is kept with the blur of the order; outside there is none to keep.
    assert barrier.asked[0].blur == 0.0 < other.asked[0].blur
    assert barrier.asked[0][:7] == other.asked[0][:7]
    if admitted:
        assert outcome.twist == wanted
        assert outcome.brake[:2] == (wanted, LIMITS.brake_ticks(wanted, PERIOD))
        assert isinstance(outcome.brake.verified, bool)


@pytest.mark.parametrize("here", [0.0, 0.1])
def test_outside_a_barrier_that_holds_has_to_go_on_holding(here):
    """On its edge too, and though the body coasts out of it."""
    broken = Scripted(here=-0.2, along=0.0, coasted=0.0)
    for along, admitted in ((0.0, True), (-0.5 * ROUNDING, True), (-0.1, False)):
        kept = Scripted(here=here, along=along, coasted=min(along, 0.0))
        guard = Guard(LIMITS, (broken, kept), PERIOD, 0.1)
        box = LIMITS.input_box(REST, PERIOD)
        outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
        assert (outcome.verdict is Verdict.ADMITTED) == admitted


@given(ticks_of_the_guard(), st.booleans(), admitted_parts)
def test_outside_the_candidates_are_those_of_the_inward_command(case, whole, parts):
    wanted, box, brake = case
    safe = box.clip(brake.next().twist)
    between = candidates_between(safe, wanted, box)
    good = one_of([*([wanted] if whole else []), *[between[i] for i in sorted(parts)]])
    barrier = Scripted(here=-0.2, coasted=-0.2, along=lambda twist: 0.0 if good(twist) else -9.0)
    barrier.motion = MOVED
    guard = Guard(LIMITS, (barrier,), PERIOD, 0.1)
    outcome = guard.filter(wanted, STRAIGHT, BODY, box, brake, MOVED)
    tried, found = ([], wanted) if good(wanted) else tried_between(safe, wanted, box, good)
    assert_asked(barrier, guard, [wanted, *tried])
    if found is None:
        assert outcome.verdict is Verdict.BRAKED
        assert outcome.twist == safe
    else:
        assert outcome.twist == pytest.approx(found, abs=1e-15)
        assert outcome.verdict is (Verdict.REPLACED if outcome.twist != wanted else
                                   Verdict.ADMITTED)  # fmt: skip
        assert outcome.brake.ticks == LIMITS.brake_ticks(outcome.twist, PERIOD)
        assert outcome.brake.twist == outcome.twist


signs = st.sampled_from([-1.0, -0.3, 0.0, 0.4, 1.0])


@given(
    ticks_of_the_guard(), st.lists(st.tuples(signs, signs, st.sampled_from([-0.1, -0.2, 0.0, 0.2])),
                                   max_size=3)
)  # fmt: skip
def test_outside_no_part_drives_out_more_than_the_brake_does(case, lines):
    """A part of the command is that of the brake exactly if a row that is broken asks for it."""
    wanted, box, brake = case
    safe = box.clip(brake.next().twist)
    barrier = Scripted(here=-0.2, coasted=-0.2, along=0.0, rows=tuple(lines))
    guard = Guard(LIMITS, (barrier,), PERIOD)
    outcome = guard.filter(wanted, STRAIGHT, BODY, box, brake)
    broken = [(a, c) for a, c, h in lines if h < 0.0]
    v_out = any(a * wanted.v > a * safe.v for a, _ in broken)
    w_out = any(c * wanted.omega > c * safe.omega for _, c in broken)
    expected = Twist(safe.v if v_out else wanted.v, safe.omega if w_out else wanted.omega)
    assert outcome.twist == expected
    assert outcome.verdict is (Verdict.ADMITTED if expected == wanted else Verdict.REPLACED)


@pytest.mark.parametrize("bare_here", [-1e-9, 0.0, 0.1])
@pytest.mark.parametrize("bare_coasted", [-1e-9, 0.0, 0.1])
def test_outside_the_reserve_it_is_certified_while_the_barrier_itself_holds(
    bare_here, bare_coasted
):
    reserved = Scripted(here=-0.2, coasted=-0.1, along=0.0)
    reserved.bare = Scripted(here=bare_here, coasted=bare_coasted)
    inside = Scripted(here=0.1, along=0.0)
    inside.bare = Scripted(here=-1.0, coasted=-1.0)  # of no interest: it holds with its reserve
    guard = Guard(LIMITS, (inside, reserved), PERIOD, 0.1)
    box = LIMITS.input_box(REST, PERIOD)
    outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
    assert outcome.verdict is Verdict.ADMITTED
    assert outcome.certified is (bare_here >= 0.0 and bare_coasted >= 0.0)


def test_outside_a_barrier_without_a_reserve_certifies_nothing():
    barrier = Scripted(here=-0.2, coasted=-0.1, along=0.0)
    guard = Guard(LIMITS, (barrier,), PERIOD, 0.1)
    box = LIMITS.input_box(REST, PERIOD)
    outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
    assert outcome.verdict is Verdict.ADMITTED
    assert outcome.certified is False


def test_on_the_edge_is_inside():
    barrier = Scripted(here=0.0, along=0.0, bound=-1.0)
    guard = Guard(LIMITS, (barrier,), PERIOD)
    box = LIMITS.input_box(REST, PERIOD)
    outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
    assert outcome.verdict is Verdict.ADMITTED
    assert outcome.certified is True
    barrier.along = -0.5 * ROUNDING  # what rounding excuses outside, where no set is left to keep
    outcome = guard.filter(Twist(box.v_hi, 0.0), STRAIGHT, BODY, box, Brake(REST, 0))
    assert outcome.verdict is Verdict.BRAKED


def test_where_no_way_back_is_known_nothing_is_asked():
    barrier = Scripted(here=-math.inf, along=math.inf)
    guard = Guard(LIMITS, (Scripted(here=-0.1), barrier), PERIOD)
    brake = Brake(Twist(0.1, 0.1), 10, True)
    box = LIMITS.input_box(brake.twist, PERIOD)
    outcome = guard.filter(Twist(0.1, 0.1), STRAIGHT, BODY, box, brake)
    assert outcome.verdict is Verdict.BRAKED
    assert outcome.brake == brake.next()
    assert outcome.certified
    assert outcome.clearance == -math.inf
    assert not barrier.asked


@pytest.mark.parametrize(("off", "kept"), [(0.0, True), (0.5e-12, True), (3e-12, False)])
def test_a_brake_is_kept_while_the_chassis_follows_it(off, kept):
    barrier = Scripted(along=-1.0)
    guard = Guard(LIMITS, (barrier,), PERIOD)
    brake = Brake(Twist(0.1, 0.1), 10, True)
    following = brake.next().twist
    box = InputBox(following.v + off, following.v + 0.01, following.omega, 0.2)
    outcome = guard.filter(Twist(box.v_hi, 0.2), STRAIGHT, BODY, box, brake)
    assert outcome.verdict is Verdict.BRAKED
    assert outcome.twist == Twist(box.v_lo, following.omega)
    assert outcome.certified is kept
    if kept:
        assert outcome.brake == brake.next()
    else:
        assert outcome.brake == guard.brake_from(outcome.twist)


def test_what_a_brake_says_of_itself():
    assert Brake(Twist(0.1, 0.2), 4, True).next() == Brake(Twist(0.1, 0.2).scaled(0.75), 3, True)
    assert Brake(Twist(0.1, 0.2), 4, False).next().verified is False
    assert Brake(Twist(0.1, 0.2), 1, True).next() == Brake(REST, 0, True)
    assert Brake(Twist(0.1, 0.2), 1, False).next() == Brake(REST, 0, False)
    assert Brake(REST, 0, False).next() == Brake(REST, 0, True)  # to stand still needs no proof
    guard = Guard(LIMITS, (), PERIOD)
    assert guard.brake_from(REST) == Brake(REST, 0, True)
    assert guard.brake_from(Twist(0.1, 0.0)) == Brake(Twist(0.1, 0.0), 10, False)


@given(all_limits, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_brake_keeps_its_curvature_and_gets_slower(limits, v, w):
    guard = Guard(limits, (), PERIOD)
    brakes = [guard.brake_from(Twist(v * limits.v_max, w * limits.omega_max))]
    while brakes[-1].ticks:
        brakes.append(brakes[-1].next())
    for before, after in pairwise(brakes):
        assert after.ticks == before.ticks - 1
        assert after.twist.v * before.twist.omega == pytest.approx(
            before.twist.v * after.twist.omega, abs=1e-12
        )
        for slower, faster in zip(after.twist, before.twist, strict=True):
            assert abs(slower) <= abs(faster)
            assert slower * faster >= 0.0


def test_the_smallest_clearance_counts():
    guard = Guard(LIMITS, (Scripted(here=0.3), Scripted(here=-0.2), Scripted(here=0.1)), PERIOD)
    assert guard.clearance(STRAIGHT) == -0.2
    assert Guard(LIMITS, (), PERIOD).clearance(STRAIGHT) == math.inf


def test_the_sweep_of_a_brake():
    guard = Guard(LIMITS, (), PERIOD, 0.2)
    brake = Brake(Twist(0.1, -0.3), 11)
    expected = Sweep.of(MOVED, BODY, 0.2, brake.twist, PERIOD * 6.0)
    sweep = guard.sweep(BODY, brake, MOVED)
    assert sweep[:4] == expected[:4]
    assert sweep[4:] == pytest.approx(expected[4:])
    assert guard.sweep(BODY, brake).motion == HERE


@given(st.builds(Pose2, *[st.floats(-2.0, 2.0)] * 3), st.builds(Pose2, *[st.floats(-2.0, 2.0)] * 3))
def test_a_scene_moves_as_seen_from_the_robot(motion, feature):
    moved = moved_scene(Scene(STRAIGHT.goal, feature, 7.0), motion)
    assert moved.stamp == 7.0
    for before, after in ((STRAIGHT.goal, moved.goal), (feature, moved.feature)):
        assert motion.compose(after)[:2] == pytest.approx(before[:2], abs=1e-12)
        turn = after.theta + motion.theta - before.theta
        assert math.cos(turn) == pytest.approx(1.0, abs=1e-12)


def test_settings_of_a_guard():
    assert Guard(LIMITS, (), PERIOD, 0.0).lag == 0.0
    assert Guard(LIMITS, (), PERIOD, 9.999).lag == 9.999
    with pytest.raises(ConfigurationError, match="lag"):
        Guard(LIMITS, (), PERIOD, 10.0)
    with pytest.raises(ConfigurationError, match="period"):
        Guard(LIMITS, (), -PERIOD)
