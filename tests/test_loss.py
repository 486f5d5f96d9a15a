"""Measurements that fail, lie or come late, and clocks and loops that misbehave."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from clfcbf import DockingController, Observation, Pose2, Status, Twist, defaults
from clfcbf.decision import Event, Failure, Phase
from clfcbf.estimation import Innovation, is_from_behind, measured, mirrored, spread
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World, facing
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from tests.strategies import poses
from tests.test_docking import LIMITS, PERIOD, WORLD, Blindfold, make_run, run

ORIGIN = Pose2(0.0, 0.0, 0.0)
EYE = (WORLD.camera.camera.x, WORLD.camera.camera.y)
START = facing(-1.9, 0.8, 0.1, WORLD)
MODEL = defaults.NOISE
SMALL = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))
points = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))


def seen_as(goal, stamp=0.0):
    return Observation(goal, goal.compose(Pose2(0.6, 0.0, 0.0)), stamp, SMALL)


def mirror(seen):
    """The measurement with the target's normal on the other side of the line of sight."""
    goal = mirrored(seen.goal, (WORLD.standoff, 0.0), EYE)
    return Observation(goal, goal.compose(WORLD.feature), seen.stamp, seen.covariance)


def from_behind(seen):
    x, y, theta = seen.feature
    board = Pose2(x, y, theta + math.pi)
    goal = board.compose(Pose2(-WORLD.standoff, 0.0, 0.0))
    return Observation(goal, board, seen.stamp, seen.covariance)


def events_of(trace):
    return {event for decision in trace.decisions for event in decision.events}


def approach(change=None, covered=None, start=START, seed=0, **options):
    cover = covered or (lambda now: False)
    alter = change or (lambda seen, now: seen)
    return run(start, ideal=False, seed=seed, wrap=lambda s: Blindfold(s, cover, alter), **options)


# The geometry ------------------------------------------------------------------------------------


@given(poses, points, points)
def test_without_perspective_the_mirrored_target_looks_the_same(goal, ahead, eye):
    """Every point of the board is as far off the line of sight, and as deep with another sign."""
    other = mirrored(goal, ahead, eye)
    centre = np.array(goal.transform(ahead))
    assert other.transform(ahead) == pytest.approx(tuple(centre), abs=1e-9)
    sight = centre - eye
    if np.hypot(*sight) < 0.1:
        return
    sight /= np.hypot(*sight)
    across = np.array([-sight[1], sight[0]])
    for end in (-0.25, 0.25):
        offsets = [
            np.array(pose.transform((ahead[0], ahead[1] + end))) - centre for pose in (goal, other)
        ]
        (depth, side), (other_depth, other_side) = [(o @ sight, o @ across) for o in offsets]
        # Which end is left is seen by the marker's pattern, its depth is what is not.
        assert abs(other_side) == pytest.approx(abs(side), abs=1e-9)
        assert abs(other_depth) == pytest.approx(abs(depth), abs=1e-9)
        assert other_side * other_depth == pytest.approx(-side * depth, abs=1e-9)


@given(poses, points, points)
def test_mirrored_twice_is_as_before(goal, ahead, eye):
    assume(math.dist(goal.transform(ahead), eye) > 0.1)  # at the eye there is no line of sight
    again = mirrored(mirrored(goal, ahead, eye), ahead, eye)
    assert again[:2] == pytest.approx(goal[:2], abs=1e-9)
    assert math.cos(again.theta - goal.theta) == pytest.approx(1.0, abs=1e-12)


@given(poses, points)
def test_a_target_shows_its_back_on_the_far_side_of_its_plane(goal, eye):
    seen = seen_as(goal)
    normal = np.array([math.cos(goal.theta), math.sin(goal.theta)])
    depth = (np.array(eye) - seen.feature[:2]) @ normal
    if abs(depth) > 1e-9:
        assert is_from_behind(seen, eye) == (depth > 0.0)


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0), st.floats(-0.9, 0.9), st.floats(-4.0, 4.0))
def test_spread_is_the_covariance_in_turned_axes(a, b, correlation, theta):
    p = np.diag([a * a, b * b, 0.04])
    p[0, 1] = p[1, 0] = correlation * a * b
    c, s = math.cos(theta), math.sin(theta)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = np.sqrt(np.diag(turn @ p @ turn.T))
    np.testing.assert_allclose(spread(tuple(map(tuple, p.tolist())), theta), expected, atol=1e-9)


# The gate ----------------------------------------------------------------------------------------


def settled(goal, count=20):
    estimate = None
    for _ in range(count):
        estimate, _ = measured(estimate, seen_as(goal), ORIGIN, MODEL, EYE)
    return estimate


@given(st.floats(0.3, 1.0), st.sampled_from([-1.0, 1.0]), st.integers(1, 100))
def test_mirror_images_never_replace_a_settled_estimate(angle, side, count):
    goal = Pose2(1.5, 0.2, side * angle)
    estimate = settled(goal)
    for _ in range(count):
        estimate, verdict = measured(estimate, mirror(seen_as(goal)), ORIGIN, MODEL, EYE)
        assert verdict.innovation is Innovation.FLIPPED
    assert estimate.goal[:2] == pytest.approx(goal[:2], abs=1e-12)


@given(st.lists(st.booleans(), min_size=40, max_size=40), st.booleans())
def test_the_majority_of_the_first_looks_decides(flips, first):
    """Until an estimate is settled it is the one of the two that was seen more often."""
    goal = Pose2(1.5, 0.2, 0.5)
    estimate, counts = None, [0, 0]
    for flip in [first, *flips]:
        seen = mirror(seen_as(goal)) if flip else seen_as(goal)
        estimate, _ = measured(estimate, seen, ORIGIN, MODEL, EYE)
        counts[flip] += 1
        if max(counts) >= MODEL.settled:
            break
        is_mirror = estimate.goal.theta != pytest.approx(goal.theta, abs=1e-6)
        if counts[0] != counts[1]:
            assert is_mirror == (counts[1] > counts[0])
        assert estimate.accepted == counts[is_mirror]
        assert estimate.flipped == counts[not is_mirror]


@pytest.mark.parametrize("turn", [-0.6, -0.1, 0.2, 0.4, 1.0])
def test_a_target_that_is_turned_in_its_place_is_no_mirror_image(turn):
    goal = Pose2(1.5, 0.4, 0.5)
    estimate = settled(goal)
    board = goal.compose(WORLD.feature)
    turned = Pose2(board.x, board.y, goal.theta + turn).compose(Pose2(-0.6, 0.0, 0.0))
    verdicts = []
    for _ in range(MODEL.rejections):
        estimate, verdict = measured(estimate, seen_as(turned), ORIGIN, MODEL, EYE)
        verdicts.append(verdict.innovation)
    assert verdicts[-1] is Innovation.MOVED
    assert set(verdicts[:-1]) == {Innovation.OUTLIER}


def test_a_guess_is_replaced_by_the_next_measurement():
    estimate = settled(Pose2(2.0, 0.0, 0.0))._replace(accepted=0)
    estimate, verdict = measured(estimate, seen_as(Pose2(1.0, 0.5, 0.2)), ORIGIN, MODEL, EYE)
    assert verdict.innovation is Innovation.FIRST
    assert estimate.goal == Pose2(1.0, 0.5, 0.2)


# In runs: what the sensor does -------------------------------------------------------------------


def test_a_short_loss_is_told_and_bridged():
    result, trace, _ = approach(covered=lambda now: 3.0 < now < 4.5)
    told = [
        t for t, d in zip(trace.times, trace.decisions, strict=True) if Event.UNSEEN in d.events
    ]
    # From 0.3 s after the last capture, up to 0.15 s before the cover, until it is off again.
    assert 3.1 < told[0] < 3.4
    assert 4.4 < told[-1] < 4.6
    assert not any(d.status is Status.STALE for d in trace.decisions)
    assert result.strict


def test_an_outlier_changes_no_command():
    """The tick that gets it does the same as one that gets nothing."""

    def change_at(number, alter):
        count = [0]

        def change(seen, now):
            count[0] += 1
            return alter(seen) if count[0] == number else seen

        return change

    def spoilt(seen):
        shift = Pose2(0.3, -0.2, 0.0)
        goal, feature = (
            Pose2(p.x + shift.x, p.y + shift.y, p.theta) for p in (seen.goal, seen.feature)
        )
        return Observation(goal, feature, seen.stamp, seen.covariance)

    result, trace, _ = approach(change_at(100, spoilt))
    _, other, _ = approach(change_at(100, lambda seen: None))
    told = [Event.OUTLIER in d.events for d in trace.decisions]
    assert sum(told) == sum(Event.OUTLIER in d.events for d in other.decisions) + 1
    assert [d.twist for d in trace.decisions] == [d.twist for d in other.decisions]
    assert result.strict


@pytest.mark.parametrize("flip", [mirror, from_behind])
@pytest.mark.parametrize("every", [3, 5])
def test_a_target_whose_pose_flips_now_and_then_is_docked_with(flip, every):
    count = [0]

    def change(seen, now):
        count[0] += 1
        return flip(seen) if count[0] % every == 1 else seen

    result, trace, controller = approach(change)
    assert Event.FLIPPED in events_of(trace)
    assert result.strict
    assert controller.state.attempts == 1
    assert not any(d.status is Status.INVALID_INPUT for d in trace.decisions)


def test_a_target_that_shows_its_back_only_is_waited_for_at_rest():
    world = World(patience=3.0)
    result, trace, _ = approach(lambda seen, now: from_behind(seen), world=world)
    assert result.outcome == "timeout"
    assert Event.FLIPPED in events_of(trace)
    assert all(d.status is Status.NO_TARGET for d in trace.decisions)
    assert all(d.twist == (0.0, 0.0) for d in trace.decisions)


def test_a_target_that_flips_for_good_ends_the_run_as_ambiguous():
    result, trace, _ = approach(lambda seen, now: mirror(seen) if now > 3.0 else seen)
    last = trace.decisions[-1]
    assert last.failure is Failure.AMBIGUOUS
    assert last.phase is Phase.FAILED
    assert result.outcome == "lost"
    assert result.min_fov_margin_deg > 0.0


def test_measurements_that_are_too_old_stop_the_robot_until_they_are_fresh_again():
    old = []

    def change(seen, now):
        old.append(seen)
        return old[0] if 3.0 < now < 6.0 else seen

    def delayed(seen, now):
        old.append(seen)
        if 3.0 < now < 6.0:  # what was captured at the start, a little later each time
            stale = old[len(old) // 40]
            return Observation(seen.goal, seen.feature, stale.stamp + now - 3.0 - 2.5)
        return seen

    for alter in (change, delayed):
        old.clear()
        result, trace, _ = approach(alter)
        stale = [d for d in trace.decisions if d.status is Status.STALE]
        assert stale
        assert result.strict


@pytest.mark.parametrize(("when", "anew"), [(-1.3, False), (-0.9, False), (-0.5, True)])
def test_a_target_nudged_by_five_centimetres_is_docked_with(when, anew):
    """By the law where there is way enough, by another plan at once where there is not."""
    plant, sensor, controller, world = make_run(facing(-1.9, 0.2, 0.0, WORLD), ideal=False)
    moved = []

    def nudge(plant):
        if not moved and plant.pose().x > when:
            plant.move_target(Pose2(0.03, 0.04, 0.0))
            moved.append(plant.time)

    result, trace = run_episode(plant, sensor, controller, world, LIMITS, nudge)
    assert moved
    assert Event.MOVED in events_of(trace)
    stopped = [
        t
        for t, d in zip(trace.times, trace.decisions, strict=True)
        if d.phase is Phase.STOPPING and d.reason == "the target has moved"
    ]
    assert bool(stopped) == anew
    if stopped:
        assert stopped[0] < moved[0] + 0.5
    assert controller.state.attempts == 1 + anew
    assert result.strict


MOVES = {
    "away": (Pose2(1.0, 0.0, 0.0), True),
    "aside": (Pose2(0.0, 1.0, 0.0), True),
    "far aside": (Pose2(0.0, 1.5, 0.0), False),
}


@pytest.mark.parametrize("move", MOVES)
def test_a_target_moved_by_a_metre_is_followed_or_found_or_lost_and_said_so(move):
    """Moved aside it leaves the view; from a little further back it is in it again."""
    shift, found = MOVES[move]
    plant, sensor, controller, world = make_run(facing(-1.9, 0.2, 0.0, WORLD), ideal=False)
    moved = []

    def nudge(plant):
        if not moved and plant.pose().x > -1.2:
            plant.move_target(shift)
            moved.append(WORLD.camera.margin(plant.pose().seen(WORLD.feature)))

    result, trace = run_episode(plant, sensor, controller, world, LIMITS, nudge)
    last = trace.decisions[-1]
    assert (moved[0] < 0.0) == (shift.y > 0.0)
    assert (Phase.SEARCHING in [d.phase for d in trace.decisions]) == (shift.y > 0.0)
    assert (Event.MOVED in events_of(trace)) == found
    if found:
        assert result.strict
    else:
        assert last.failure is Failure.LOST
        assert result.outcome == "lost"
        assert last.twist == (0.0, 0.0)


# In runs: what clock and loop do -----------------------------------------------------------------


def clocked(clock, ticks=600, start=START, skipped=lambda k: False, watchdog=math.inf):
    """A run by hand under a clock of its own; in ``skipped`` ticks the loop does not call.

    The chassis stops where it has not been told anything for ``watchdog`` seconds.
    """
    body = Body()
    plant = KinematicPlant(start, LIMITS, body, np.random.default_rng([0, 1]))
    sensor = PoseSensor(
        plant, WORLD.camera, WORLD.standoff, SensorModel(), np.random.default_rng([0, 2])
    )
    controller = DockingController(LIMITS, WORLD.camera, WORLD.standoff, PERIOD, lag=body.lag)
    decisions, told = [], 0.0
    for k in range(ticks):
        sensor.capture()
        if skipped(k):
            if plant.time - told > watchdog:
                plant.stop()
        else:
            seen = sensor.observe()
            if seen is not None:
                seen = Observation(seen.goal, seen.feature, clock(seen.stamp), seen.covariance)
            applied = plant.applied()
            decision = controller.step(seen, applied, clock(plant.time))
            assert LIMITS.input_box(applied, PERIOD).contains(decision.twist, 1e-9)
            plant.send(decision.twist)
            decisions.append(decision)
            told = plant.time
        plant.advance(PERIOD)
    return decisions, plant


def statuses(decisions):
    return {d.status for d in decisions}


@pytest.mark.parametrize("jump", [-100.0, -1.0, 0.4, 1.0, 10.0, 1000.0])
def test_a_clock_that_jumps_is_survived(jump):
    decisions, plant = clocked(lambda now: now + (jump if now > 3.0 else 0.0), ticks=800)
    event = Event.LAPSED if jump > 0.5 else Event.LATE
    at = next(k for k in range(len(decisions)) if k * PERIOD > 3.0)
    if jump < 0.0:
        assert Status.CLOCK_ERROR in statuses(decisions[at - 1 : at + 2])
    else:
        assert any(event in d.events for d in decisions[at - 1 : at + 2])
    assert not all(d.certified for d in decisions[at - 1 : at + 2])
    assert decisions[-1].done
    assert math.hypot(*plant.pose()[:2]) < 0.01


def test_a_clock_that_stands_still_for_a_while_is_survived():
    decisions, plant = clocked(lambda now: now if now < 3.0 else max(3.0, now - 2.0), ticks=700)
    assert sum(d.status is Status.CLOCK_ERROR for d in decisions) >= 55
    assert decisions[-1].done
    assert math.hypot(*plant.pose()[:2]) < 0.01


def test_a_clock_that_stands_still_for_good_ends_the_run():
    decisions, plant = clocked(lambda now: min(now, 3.0), ticks=600)
    last = decisions[-1]
    assert last.phase is Phase.FAILED
    assert last.failure is Failure.FAULT
    assert "clock" in last.reason
    assert last.twist == (0.0, 0.0)
    assert plant.twist().v == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("missed", [2, 5, 12])
def test_missed_ticks_are_told_and_not_certified(missed):
    """The chassis holds the last command, so the reckoning still holds: it goes on."""
    decisions, plant = clocked(lambda now: now, skipped=lambda k: 120 <= k < 120 + missed)
    first = decisions[120]
    assert Event.LATE in first.events
    assert Event.LAPSED not in first.events
    assert not first.certified
    assert decisions[119].certified
    assert decisions[-1].done
    assert math.hypot(*plant.pose()[:2]) < 0.01
    assert not any(Event.MOVED in d.events for d in decisions)


@pytest.mark.parametrize("watchdog", [0.5, math.inf])
def test_after_a_long_silence_the_target_has_to_be_seen_first(watchdog):
    """Whether the chassis held the command for all of it or stopped, nobody has to know."""
    silence = 45
    decisions, plant = clocked(
        lambda now: now, ticks=900, skipped=lambda k: 100 <= k < 100 + silence, watchdog=watchdog
    )
    assert Event.LAPSED in decisions[100].events
    again = next(k for k in range(100, len(decisions)) if decisions[k].rows)
    before = decisions[100:again]
    # It brakes, uncertified until it stands, and moves again only after a new measurement.
    assert again > 103
    assert all(d.status in (Status.STALE, Status.STOPPED, Status.NO_TARGET) for d in before)
    assert not any(d.certified for d in before if d.twist != (0.0, 0.0))
    speeds = [abs(d.twist.v) for d in before]
    assert speeds == sorted(speeds, reverse=True)
    assert decisions[-1].done
    assert math.hypot(*plant.pose()[:2]) < 0.01


def test_the_distance_a_watchdog_covers_is_as_documented():
    r"""v t_w + v²/(2a) + v tau, for a chassis that holds the last command and then stops."""
    silence, watchdog, lag = 60, 0.5, 0.12
    body = Body(lag=lag, slip=0.0, gyro_bias=0.0)
    for v in (0.05, 0.15, 0.22):
        plant = KinematicPlant(
            Pose2(-3.0, 0.0, 0.0), LIMITS, body, np.random.default_rng(0), Twist(v, 0.0)
        )
        start = plant.pose().x
        for k in range(silence):
            if k * PERIOD >= watchdog:
                plant.stop()
            plant.advance(PERIOD)
        covered = plant.pose().x - start
        assert covered <= v * (watchdog + PERIOD) + v * v / (2.0 * LIMITS.a_max) + v * lag
        assert covered >= v * watchdog


# Near the goal -----------------------------------------------------------------------------------


def last_second(seed, quiet):
    model = SensorModel(
        latency=(0.09, 0.09), jitter=0.0, dropout=0.0, outlier=0.0,
        range_noise=(0.0, 0.0), lateral_noise=0.0, yaw_noise=0.0,
    ) if quiet else SensorModel()  # fmt: skip
    plant = KinematicPlant(START, LIMITS, Body(), np.random.default_rng([0, 1]))
    rng = np.random.default_rng([seed, 2])
    sensor = PoseSensor(plant, WORLD.camera, WORLD.standoff, model, rng)
    controller = DockingController(LIMITS, WORLD.camera, WORLD.standoff, PERIOD, lag=0.12)
    commands, peak = [], 0.0
    while plant.time < 20.0:
        sensor.capture()
        decision = controller.step(sensor.observe(), plant.applied(), plant.time)
        if decision.done:
            break
        plant.send(decision.twist)
        plant.advance(PERIOD)
        commands.append(decision.twist)
        if math.hypot(*plant.pose()[:2]) < 0.01:
            peak = max(peak, abs(decision.twist.omega))
    return np.array(commands[-30:]), peak


def test_near_the_goal_noise_does_not_reach_the_commands():
    """Second differences tell chatter from the slowing down that both have."""

    def chatter(commands):
        return np.std(np.diff(commands, 2, axis=0), axis=0) / math.sqrt(6.0)

    still = chatter(last_second(0, True)[0])
    for seed in range(8):
        commands, peak = last_second(seed, False)
        excess = np.sqrt(np.maximum(chatter(commands) ** 2 - still**2, 0.0))
        assert excess[0] < 2e-3
        assert excess[1] < 8e-3
        assert peak < 0.25 * LIMITS.omega_max
        turns = commands[np.abs(commands[:, 1]) > 2e-3, 1][-12:]
        assert np.count_nonzero(np.diff(np.sign(turns))) <= 1
