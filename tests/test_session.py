"""The docking session: scripted phases, random ones, and a simulated robot."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import DockingController, Limits, Observation, Pose2, Twist
from clfcbf.decision import Decision, Failure, Phase, Status
from clfcbf.errors import ConfigurationError
from clfcbf.runtime import ControlLoop, Ending, PlantInTheLoop
from clfcbf.session import (
    Dock,
    DockDatabase,
    DockingSession,
    DockType,
    ErrorCode,
    PhaseControllers,
    SessionPolicy,
    SessionState,
    Unsensed,
    parse_docks,
    read_docks,
)
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import LIMITS, World
from clfcbf.simulation.sensor import PoseSensor, SensorModel

REST = Twist(0.0, 0.0)
FORWARD = Twist(0.05, 0.0)
LIMIT = Limits(0.22, 0.4, 0.3, 1.0)
PERIOD = 1.0 / 30.0
BOARD = Pose2(2.0, 0.0, 0.0)
QUICK = SessionPolicy(
    max_staging_time=2.0, initial_perception_timeout=0.5, approach_timeout=2.0,
    wait_charge_timeout=0.5, max_undocking_time=2.0, max_time=60.0, pause=0.1, longest_pause=0.3,
)  # fmt: skip


def told(twist=REST, **fields):
    return Decision(twist, Status.OPTIMAL, True, twist, 1.0, **fields)


class Script:
    """Drives for ``ticks`` ticks, and then ends the way it is told."""

    def __init__(self, ticks=5, end="done", failure=None):
        self.ticks, self.end, self.failure = ticks, end, failure
        self.distances = []

    def step(self, observation, applied, now):
        self.ticks -= 1
        if self.ticks > 0 or self.end == "never":
            box = LIMIT.input_box(applied, PERIOD)
            return told(box.clip(FORWARD), phase=Phase.APPROACHING)
        if self.end == "raise":
            raise RuntimeError("encoder")
        box = LIMIT.input_box(applied, PERIOD)
        stopped = box.clip(REST)
        if stopped != REST:
            return told(stopped, phase=Phase.STOPPING)
        if self.end == "done":
            return told(done=True, phase=Phase.DONE)
        return told(phase=Phase.FAILED, failure=self.failure, reason="scripted")

    def undock(self, distance):
        self.distances.append(distance)
        self.ticks, self.end = 5, "done"


class Contact(Unsensed):
    def __init__(self, docked=False, confirmed=True, released=True):
        self.values = {"docked": docked, "confirmed": confirmed, "released": released}
        self.releases = 0

    def docked(self):
        return self.values["docked"]

    def confirmed(self):
        return self.values["confirmed"]

    def released(self):
        return self.values["released"]

    def release(self):
        self.releases += 1


def database(**options):
    kind = DockType("charger", **options)
    return DockDatabase({"a": Dock("a", kind, Pose2(1.0, 2.0, math.pi / 2))}, {"charger": kind})


class Robot:
    """A session, the time, and the command in force."""

    def __init__(self, scripts, *, kind=None, seen=True, **options):
        self.made = []
        scripts = iter(scripts)

        def approach(dock):
            self.made.append(next(scripts))
            return self.made[-1]

        stage = options.pop("stage", None)
        options.setdefault("policy", QUICK)
        self.session = DockingSession(
            PhaseControllers(approach, stage, **options.pop("phases", {})),
            database(**(kind or {})), LIMIT, PERIOD, **options,
        )  # fmt: skip
        self.now, self.applied, self.seen = 10.0, REST, seen
        self.states, self.commands, self.decisions = [], [], []

    def tick(self):
        observation = Observation(Pose2(1.4, 0.0, 0.0), BOARD, self.now) if self.seen else None
        decision = self.session.step(observation, self.applied, self.now)
        assert LIMIT.input_box(self.applied, PERIOD).contains(decision.twist, 1e-9)
        self.applied = decision.twist
        self.now += PERIOD
        self.commands.append(decision.twist)
        self.decisions.append(decision)
        if not self.states or self.states[-1] is not self.session.feedback.state:
            self.states.append(self.session.feedback.state)
        return decision

    def run(self, longest=60.0):
        end = self.now + longest
        while self.session.result is None:
            assert self.now < end, "the session does not end"
            self.tick()
        return self.session.result


def test_states_and_codes_have_the_numbers_of_nav2():
    states = (
        "NONE", "NAV_TO_STAGING_POSE", "INITIAL_PERCEPTION", "CONTROLLING", "WAIT_FOR_CHARGE",
        "RETRY",
    )  # fmt: skip
    assert {state.name: int(state) for state in SessionState} == {
        name: number for number, name in enumerate(states)
    }
    assert {code.name: int(code) for code in ErrorCode} == {
        "NONE": 0, "DOCK_NOT_IN_DB": 901, "DOCK_NOT_VALID": 902, "FAILED_TO_STAGE": 903,
        "FAILED_TO_DETECT_DOCK": 904, "FAILED_TO_CONTROL": 905, "FAILED_TO_CHARGE": 906,
        "TIMEOUT": 907, "UNKNOWN": 999,
    }  # fmt: skip


def test_all_states_in_order():
    robot = Robot([Script()], kind={"confirm": True}, stage=lambda dock: Script())
    robot.session.dock("a")
    assert robot.session.active
    assert robot.run() == (True, ErrorCode.NONE, 0, "", False)
    assert [int(state) for state in robot.states] == [1, 2, 3, 4, 0]
    assert not robot.session.active
    last = robot.tick()
    assert last.done
    assert last.phase is Phase.DONE
    assert robot.session.feedback.docking_time > 0.0


def test_only_the_last_decision_is_done():
    robot = Robot([Script()], stage=lambda dock: Script())
    robot.session.dock("a")
    robot.run()
    assert [decision.done for decision in robot.decisions].index(True) == len(robot.decisions) - 1


@pytest.mark.parametrize("near", [True, False])
def test_staging_is_left_out_where_the_robot_is_there(near):
    dock = database().docks["a"]
    staging = dock.staging_pose
    assert tuple(staging) == pytest.approx((1.0, 2.0 - 0.7, math.pi / 2))
    off = 0.49 if near else 0.51
    pose = Pose2(staging.x + off, staging.y, staging.theta)
    robot = Robot([Script()], stage=lambda dock: Script(), robot_pose=lambda: pose)
    robot.session.dock("a")
    assert robot.run().success
    assert (SessionState.NAV_TO_STAGING_POSE in robot.states) is not near


STAGING_FAILURES: dict[str, Callable[[], dict]] = {
    "nothing that drives there": lambda: {"robot_pose": lambda: Pose2(9.0, 9.0, 0.0)},
    "scripted": lambda: {"stage": lambda dock: Script(end="failed")},
    "not staged within": lambda: {"stage": lambda dock: Script(end="never")},
}


@pytest.mark.parametrize("why", STAGING_FAILURES)
def test_failed_to_stage(why):
    robot = Robot([], **STAGING_FAILURES[why]())
    robot.session.dock("a")
    result = robot.run()
    assert result.error_code is ErrorCode.FAILED_TO_STAGE
    assert why in result.error_msg
    assert robot.applied == REST


def test_dock_that_is_never_seen():
    robot = Robot([], seen=False)
    robot.session.dock("a")
    result = robot.run()
    assert (result.error_code, result.num_retries) == (ErrorCode.FAILED_TO_DETECT_DOCK, 3)
    assert set(robot.commands) == {REST}
    waits = 4 * 0.5 + 0.1 + 0.2 + 0.3  # four looks, and three pauses that double up to 0.3 s
    assert robot.session.feedback.docking_time == pytest.approx(waits, abs=20 * PERIOD)


FAILED_ATTEMPTS = {
    ErrorCode.FAILED_TO_CONTROL: [
        (lambda: Script(end="never"), {}, Contact),
        (lambda: Script(end="failed", failure=Failure.GAVE_UP), {}, Contact),
        (Script, {"contact": True}, Contact),
    ],
    ErrorCode.FAILED_TO_DETECT_DOCK: [
        (lambda: Script(end="failed", failure=Failure.LOST), {}, Contact),
        (lambda: Script(end="failed", failure=Failure.AMBIGUOUS), {}, Contact),
    ],
    ErrorCode.FAILED_TO_CHARGE: [(Script, {"confirm": True}, lambda: Contact(confirmed=False))],
}


@pytest.mark.parametrize(
    ("code", "case"), [(code, case) for code, cases in FAILED_ATTEMPTS.items() for case in cases]
)
def test_failed_attempts_are_repeated_from_further_back(code, case):
    script, kind, contact = case
    sensed = contact()
    robot = Robot([script() for _ in range(4)], kind={**kind, "backoff": 0.4}, contact=sensed)
    robot.session.dock("a")
    result = robot.run()
    assert (result.error_code, result.num_retries, result.success) == (code, 3, False)
    assert [made.distances for made in robot.made] == [[0.4], [0.4], [0.4], []]
    assert sensed.releases == 3
    assert robot.tick().phase is Phase.FAILED
    assert robot.tick().reason == result.error_msg


def test_second_attempt_succeeds():
    robot = Robot([Script(end="failed", failure=Failure.GAVE_UP), Script()])
    robot.session.dock("a")
    assert robot.run() == (True, ErrorCode.NONE, 1, "", False)
    assert SessionState.RETRY in robot.states


def test_no_retries():
    policy = SessionPolicy(max_retries=0)
    robot = Robot([Script(end="failed", failure=Failure.GAVE_UP)], policy=policy)
    robot.session.dock("a")
    assert robot.run() == (False, ErrorCode.FAILED_TO_CONTROL, 0, "scripted", False)


def test_contact_ends_the_approach_at_once():
    contact = Contact()
    robot = Robot([Script(end="never")], kind={"contact": True}, contact=contact)
    robot.session.dock("a")
    while robot.applied != FORWARD:
        robot.tick()
    contact.values["docked"] = True
    robot.tick()
    assert abs(robot.applied.v) <= FORWARD.v - 0.9 * LIMIT.a_max * PERIOD
    assert robot.run().success


def test_moves_out_only_once_the_dock_has_let_go():
    contact = Contact(released=False)
    robot = Robot([Script()], contact=contact)
    robot.session.undock("a")
    for _ in range(10):
        assert robot.tick().twist == REST
    assert contact.releases == 1
    contact.values["released"] = True
    assert robot.run() == (True, ErrorCode.NONE, 0, "", False)
    assert robot.made[0].distances == [0.7]


def test_a_dock_that_does_not_let_go():
    robot = Robot([Script()], contact=Contact(released=False))
    robot.session.undock("a")
    result = robot.run()
    assert result.error_code is ErrorCode.FAILED_TO_CONTROL
    assert set(robot.commands) == {REST}


def test_undocks_with_what_the_approach_knew():
    robot = Robot([Script()])
    robot.session.dock("a")
    robot.run()
    robot.session.undock()
    assert robot.run().success
    assert len(robot.made) == 1
    assert robot.made[0].distances == [0.7]


def test_nothing_to_undock_from():
    robot = Robot([])
    for name in (None, "b"):
        robot.session.undock(name)
        assert robot.session.result.error_code is ErrorCode.DOCK_NOT_VALID


def test_unknown_docks_and_types():
    robot = Robot([Script()])
    robot.session.dock("kitchen")
    assert robot.session.result.error_code is ErrorCode.DOCK_NOT_IN_DB
    assert "'kitchen'" in robot.session.result.error_msg
    assert robot.tick().phase is Phase.FAILED
    robot.session.dock_at(Pose2(0.0, 0.0, 0.0), "conveyor")
    assert robot.session.result.error_code is ErrorCode.DOCK_NOT_VALID
    robot.session.dock_at(Pose2(0.0, 0.0, 0.0))
    assert robot.run().success


def test_one_task_at_a_time():
    robot = Robot([Script()])
    robot.session.dock("a")
    robot.tick()
    for ask in (lambda: robot.session.dock("a"), lambda: robot.session.undock("a"),
                lambda: robot.session.dock_at(Pose2(0.0, 0.0, 0.0))):  # fmt: skip
        with pytest.raises(ConfigurationError, match="in progress"):
            ask()


def test_the_whole_may_take_too_long():
    policy = SessionPolicy(max_time=1.0)
    robot = Robot([Script(end="never")], policy=policy)
    robot.session.dock("a")
    assert robot.run().error_code is ErrorCode.TIMEOUT
    assert robot.session.feedback.docking_time == pytest.approx(1.0, abs=10 * PERIOD)


def test_a_controller_without_undock_is_told():
    class Plain:
        def step(self, observation, applied, now):
            return told(phase=Phase.FAILED, reason="no")

    robot = Robot([Plain()])
    robot.session.dock("a")
    result = robot.run()
    assert result.error_code is ErrorCode.UNKNOWN
    assert "Plain has no undock()" in result.error_msg


def test_idle_session_stands():
    robot = Robot([])
    robot.applied = FORWARD
    while robot.applied != REST:
        assert robot.tick().phase is Phase.WAITING
    assert not robot.tick().done
    robot.session.cancel()
    assert robot.tick().phase is Phase.WAITING


ENDS = st.sampled_from(["done", "failed", "never", "raise"])


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 20), ENDS), min_size=4, max_size=4),
    st.booleans(), st.booleans(), st.booleans(),
    st.none() | st.integers(0, 150),
)  # fmt: skip
def test_every_session_ends_at_rest_inside_the_limits(scripts, staged, confirmed, seen, cancel):
    """Whatever the parts do; the limits are checked in every tick."""
    robot = Robot(
        [Script(ticks, end) for ticks, end in scripts],
        kind={"confirm": True}, contact=Contact(confirmed=confirmed), seen=seen,
        stage=(lambda dock: Script(3)) if staged else None,
    )  # fmt: skip
    robot.session.dock("a")
    for _ in range(cancel or 0):
        if robot.session.result is None:
            robot.tick()
    canceled = cancel is not None and robot.session.result is None
    robot.session.cancel() if canceled else None
    before = LIMIT.brake_ticks(robot.applied, PERIOD)
    ticks = len(robot.commands)
    result = robot.run()
    assert robot.applied == REST
    assert result.num_retries <= QUICK.max_retries
    assert result.success == (result.error_code is ErrorCode.NONE and not result.canceled)
    if canceled and result.canceled:
        braked = [command.v for command in robot.commands[ticks:]]
        assert len(braked) <= before + 1
        assert braked == sorted(braked, reverse=True)
    assert not robot.session.active
    robot.session.undock("a")  # and it is ready for another task
    assert robot.session.active


def test_each_task_counts_its_own_retries():
    robot = Robot([Script(end="failed", failure=Failure.GAVE_UP), Script(), Script()])
    robot.session.dock("a")
    assert robot.run().num_retries == 1
    robot.session.dock("a")
    assert robot.run() == (True, ErrorCode.NONE, 0, "", False)


@pytest.mark.parametrize("looks", [1, 2])
def test_looks_of_another_attempt_do_not_count(looks):
    """One look in each attempt is enough where one is asked for, and never where two are."""
    robot = Robot([Script()], seen=False, policy=SessionPolicy(looks=looks, pause=0.1))
    robot.session.dock("a")
    looked, before = set(), None
    while robot.session.result is None:
        state, _, retries = robot.session.feedback
        looking = state is SessionState.INITIAL_PERCEPTION and before == (state, retries)
        robot.seen = looking and retries not in looked
        looked |= {retries} if robot.seen else set()
        before = state, retries
        robot.tick()
    assert looked == set(range(1 if looks == 1 else 4))
    assert robot.session.result.success is (looks == 1)


def test_a_cancel_without_a_task_does_not_touch_the_next():
    robot = Robot([Script()])
    robot.session.cancel()
    robot.session.dock("a")
    assert robot.run().success


def test_done_is_told_with_the_command_to_stand():
    """A base that accelerates so slowly that even creeping takes several ticks to end."""
    slow = Limits(0.22, 0.4, 0.01, 1.0)
    contact = Contact(docked=True)
    session = DockingSession(
        PhaseControllers(lambda dock: Script()), database(), slow, PERIOD, contact=contact
    )
    session.dock("a")
    applied, now = Twist(1.9e-3, 0.0), 0.0
    for _ in range(30):
        decision = session.step(Observation(Pose2(1.4, 0.0, 0.0), BOARD, now), applied, now)
        assert slow.input_box(applied, PERIOD).contains(decision.twist, 1e-9)
        assert not decision.done or decision.twist == REST
        # Held in motion until the task has ended, as by a base that lags.
        applied = decision.twist if session.result is not None else applied
        now += PERIOD
        if decision.done:
            break
    assert decision.done


def test_another_dock_gets_a_controller_of_its_own():
    kind = DockType()
    docks = DockDatabase({n: Dock(n, kind, Pose2(0.0, 0.0, 0.0)) for n in "ab"}, {"x": kind})
    made = []

    def approach(dock):
        made.append(dock.name)
        return Script()

    session = DockingSession(PhaseControllers(approach), docks, LIMIT, PERIOD)
    now, applied = 0.0, REST
    for ask in (lambda: session.dock("a"), lambda: session.undock("b")):
        ask()
        while session.result is None:
            now += PERIOD
            seen = Observation(Pose2(1.4, 0.0, 0.0), BOARD, now)
            applied = session.step(seen, applied, now).twist
    assert made == ["a", "b"]


@pytest.mark.parametrize("certified", [True, False])
def test_the_brake_is_as_certified_as_the_command_before(certified):
    class Sure(Script):
        def step(self, observation, applied, now):
            return super().step(observation, applied, now)._replace(certified=certified)

    robot = Robot([Sure(end="never")])
    robot.session.dock("a")
    while robot.applied != FORWARD:
        robot.tick()
    robot.session.cancel()
    assert robot.tick().certified is certified


def test_cancel_decelerates_from_speed():
    robot = Robot([Script(end="never")])
    robot.session.dock("a")
    while robot.applied != FORWARD:
        robot.tick()
    robot.session.cancel()
    result = robot.run()
    assert result == (False, ErrorCode.NONE, 0, "canceled", True)
    last = robot.commands[-7:]
    assert last[-1] == REST
    steps = -np.diff([command.v for command in last])
    assert steps.max() <= LIMIT.a_max * PERIOD + 1e-12
    # 0.05 m/s takes five ticks of 0.01 m/s each.
    assert np.count_nonzero(steps) == 5


# A robot -------------------------------------------------------------------------------------


class World2D:
    """A simulated robot in front of its dock, with everything that a loop needs."""

    def __init__(self, start, contact_at=None):
        world, body, rng = World(), Body(), np.random.default_rng(1)
        self.limits, self.period = LIMITS["approaching"], world.period
        self.plant = KinematicPlant(start, self.limits, body, rng)
        sensor = PoseSensor(
            self.plant, world.camera, world.standoff, SensorModel.named("A"), rng
        )  # fmt: skip
        self.robot = PlantInTheLoop(self.plant, sensor)
        self.contact = Contact()
        self.contact_at = contact_at
        kind = DockType(contact=contact_at is not None)
        docks = DockDatabase({"a": Dock("a", kind, Pose2(0.0, 0.0, 0.0))}, {"default": kind})

        def approach(dock):
            return DockingController(
                self.limits, world.camera, world.standoff, self.period, lag=body.lag
            )

        self.session = DockingSession(
            PhaseControllers(approach), docks, self.limits, self.period, contact=self.contact
        )
        self.on_tick = lambda tick: None

    def run(self, duration=60.0):
        def each(tick):
            if self.contact_at is not None:
                self.contact.values["docked"] = self.plant.pose().x > self.contact_at
            self.on_tick(tick)

        loop = ControlLoop(
            self.session, self.robot, self.robot, self.robot,
            period=self.period, limits=self.limits, on_tick=each,
        )  # fmt: skip
        report = loop.run(duration)
        self.robot.sleep_until(self.robot.now() + 0.5)
        return report


def test_robot_docks_and_undocks():
    world = World2D(Pose2(-1.2, 0.1, 0.0))
    world.session.dock("a")
    assert world.run().ending is Ending.DONE
    assert world.session.result.success
    docked = world.plant.pose()
    assert math.hypot(docked.x, docked.y) < 0.010
    world.session.undock()
    assert world.run().ending is Ending.DONE
    out = world.plant.pose()
    assert math.hypot(out.x - docked.x, out.y - docked.y) == pytest.approx(0.7, abs=0.03)


def test_robot_stops_at_contact():
    world = World2D(Pose2(-1.2, 0.0, 0.0), contact_at=-0.1)
    world.session.dock("a")
    assert world.run().ending is Ending.DONE
    assert world.session.result.success
    way = 0.22**2 / (2 * 0.3) + 0.22 * (0.12 + 2 / 30)  # braking, lag, and a tick of sensing
    assert -0.1 < world.plant.pose().x < -0.1 + way


def test_canceled_robot_stands():
    world = World2D(Pose2(-1.2, 0.0, 0.0))
    world.session.dock("a")
    world.on_tick = lambda tick: world.session.cancel() if tick.command.v > 0.15 else None
    assert world.run().ending is Ending.FAILED
    assert world.session.result.canceled
    assert world.plant.applied() == REST
    assert abs(world.plant.twist().v) < 5e-3


# Docks and policy ----------------------------------------------------------------------------

TOML = """
[types.charger]
staging_offset = [-1.0, 0.0, 0.1]
backoff = 0.3
contact = true
confirm = true

[types.conveyor]

[docks.kitchen]
type = "charger"
pose = [3.1, 0.4, 1.5]
frame = "hall"
id = "42"

[docks.belt]
type = "conveyor"
pose = [0, 0, 0]
"""


def test_database(tmp_path):
    path = tmp_path / "docks.toml"
    path.write_text(TOML, encoding="utf-8")
    docks = read_docks(path)
    assert docks == parse_docks(TOML)
    charger = DockType("charger", Pose2(-1.0, 0.0, 0.1), 0.3, True, True)
    assert docks.types == {"charger": charger, "conveyor": DockType("conveyor")}
    kitchen = docks.docks["kitchen"]
    assert kitchen == Dock("kitchen", charger, Pose2(3.1, 0.4, 1.5), "hall", "42")
    expected = (3.1 - math.cos(1.5), 0.4 - math.sin(1.5), 1.6)
    assert tuple(kitchen.staging_pose) == pytest.approx(expected)
    assert kitchen.undocking_distance == 1.0


def test_type_may_be_left_out_where_there_is_one():
    for text in ("[docks.a]\npose = [1, 2, 3]", "[types.x]\n[docks.a]\npose = [1, 2, 3]"):
        docks = parse_docks(text)
        assert docks.docks["a"].type == next(iter(docks.types.values()))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[dock.a]", "did you mean 'docks'"),
        ("docks = 3", "docks must be a table"),
        ("[docks]\na = 3", r"docks\.a must be a table"),
        ("[types]\na = 3", r"types\.a must be a table"),
        ("[docks.a]\n", "pose is missing"),
        ("[docks.a]\npose = [1, 2]", "list of x, y and theta"),
        ("[docks.a]\npose = [1, 2, true]", "must be a number"),
        ("[docks.a]\npose = [1, 2, nan]", "finite"),
        ("[docks.a]\npose = [1, 2, 3]\nid = 42", "must be a str"),
        ("[docks.a]\npose = [1, 2, 3]\nfrane = 'map'", "did you mean 'frame'"),
        ("[docks.a]\npose = [1, 2, 3]\nname = 'b'", "unknown key 'name'"),
        ("[docks.a]\npose = [1, 2, 3]\ntype = 'b'", r"type must be one of 'default', got 'b'"),
        ("[types.x]\n[types.y]\n[docks.a]\npose = [1, 2, 3]", "must be one of 'x', 'y', got None"),
        ("[types.x]\nstaging_offset = [0.7, 0, 0]", "x < 0"),
        ("[types.x]\nbackoff = 0.0", "backoff"),
        ("[types.x]\nconfirm = 1", "must be a bool"),
        ("[types.x", "not TOML"),
        ("[types.x]\nbackoff = 1" + 400 * "0", "too large"),
    ],
)
def test_wrong_databases_are_refused(text, told):
    with pytest.raises(ConfigurationError, match=told):
        parse_docks(text)


def test_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"none\.toml"):
        read_docks(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("[dock.a]", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"bad\.toml"):
        read_docks(tmp_path / "bad.toml")


@pytest.mark.parametrize(
    ("name", "value"),
    [*((name, value) for name in SessionPolicy.__dataclass_fields__ if "time" in name
       for value in (0.0, math.inf, math.nan)),
     ("pause", -1.0), ("longest_pause", math.inf), ("max_retries", -1), ("max_retries", 1.5),
     ("looks", 0), ("looks", True), ("prestaging_tolerance", 0.0)],
)  # fmt: skip
def test_wrong_policies_are_refused(name, value):
    with pytest.raises(ConfigurationError, match=name):
        SessionPolicy(**{name: value})


@given(st.just(0.0) | st.floats(1e-9, 10.0), st.floats(0.0, 100.0), st.integers(1, 2000))
def test_pauses_double_up_to_the_longest(pause, longest, retry):
    policy = SessionPolicy(pause=pause, longest_pause=longest)
    doubled = pause
    for _ in range(min(retry, 200) - 1):
        doubled = min(2.0 * doubled, 1e6)
    assert policy.pause_before(retry) == min(doubled, longest)


# Which part it was ---------------------------------------------------------------------------


def raising(text):
    def ask(*_):
        raise RuntimeError(text)

    return ask


@pytest.mark.parametrize("method", ["docked", "confirmed", "release", "released"])
def test_a_contact_that_raises_is_named(method):
    contact = Contact()
    setattr(contact, method, raising("relay"))
    robot = Robot([Script()], kind={"confirm": True}, contact=contact)
    if method.startswith("release"):
        robot.session.undock("a")
    else:
        robot.session.dock("a")
    result = robot.run()
    assert result.error_code is ErrorCode.UNKNOWN
    assert result.error_msg == "the dock's contact raised RuntimeError: relay"


def test_a_controller_that_raises_is_named():
    robot = Robot([Script(end="raise")])
    robot.session.dock("a")
    assert robot.run().error_msg == "the controller (approaching) raised RuntimeError: encoder"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"stage": raising("map")}, "the maker of the staging controller"),
        ({"stage": lambda dock: Script(end="raise")}, "the controller (staging)"),
        ({"robot_pose": raising("tf")}, "robot_pose"),
    ],
)
def test_who_failed_at_staging_is_named(options, told):
    robot = Robot([Script()], **options)
    robot.session.dock("a")
    assert robot.run().error_msg.startswith(f"{told} raised RuntimeError: ")


def test_a_maker_that_raises_is_named():
    robot = Robot([])  # out of scripts
    robot.session.dock("a")
    assert robot.run().error_msg.startswith("the maker of the approach's controller raised ")


@pytest.mark.parametrize("seen", [False, True])
def test_a_dock_not_seen_is_told_from_a_sensor_that_gives_nothing(seen):
    lost = [Script(end="failed", failure=Failure.LOST) for _ in range(4)]
    robot = Robot(lost, seen=True)
    robot.session.dock("a")
    while robot.session.feedback.state is not SessionState.CONTROLLING:
        robot.tick()
    robot.seen = seen
    result = robot.run()
    assert result.error_code is ErrorCode.FAILED_TO_DETECT_DOCK
    assert ("the sensor has delivered nothing for" in result.error_msg) is not seen
