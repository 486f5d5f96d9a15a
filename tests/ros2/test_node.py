"""The node around a simulated robot, over a transport in memory and in step with its clock."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from clfcbf.config import parse_config, template
from clfcbf.decision import Decision, Phase, Status
from clfcbf.errors import ConfigurationError
from clfcbf.ros2.chassis import twist_of
from clfcbf.ros2.client import TaskClient
from clfcbf.ros2.detection import DetectionFrame
from clfcbf.ros2.diagnostics import Level, decision_status
from clfcbf.ros2.messages import Header, PoseStamped, Time, TwistStamped
from clfcbf.ros2.node import DockingNode
from clfcbf.ros2.parameters import settings_of
from clfcbf.ros2.simulated import SimulatedRobot
from clfcbf.ros2.tasks import Action, Goal
from clfcbf.ros2.transport import COMMANDS, EVENTS, Quality, TransportError
from clfcbf.se2 import Pose2, Twist
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from tests.ros2.bus import Bus

CONFIG = parse_config(template())
START = Pose2(-1.2, 0.1, 0.0)
FRAME = DetectionFrame("camera_optical_frame", CONFIG.camera.camera, optical=True)
GIVEN = {"detection_frame": FRAME.name, "use_sim_time": True}
REST = Twist(0.0, 0.0)


class World:
    """A robot, a node and a client on one bus."""

    def __init__(self, given=GIVEN, start=START, step=CONFIG.filter.period, **options):
        self.bus = Bus()
        rng = np.random.default_rng(0)
        self.plant = KinematicPlant(start, CONFIG.limits, Body(), rng)
        sensor = PoseSensor(self.plant, CONFIG.camera, CONFIG.standoff, SensorModel.named("A"), rng)
        stamped = given.get("enable_stamped_cmd_vel", True)
        self.robot = SimulatedRobot(
            self.plant,
            sensor,
            self.bus.transport(),
            frame=FRAME,
            step=step,
            stamped=stamped,
            patience=0.2,
        )
        self.transport = self.bus.transport()
        self.node = DockingNode(settings_of(CONFIG, given), self.transport, **options)
        self.client = TaskClient(self.bus.transport())

    def commands(self):
        return [twist_of(m.twist) for m in self.bus.messages("/cmd_vel")]

    def diagnostics(self):
        return [
            {status.name.removeprefix("docking: "): status for status in message.status}
            for message in self.bus.messages("/diagnostics")
        ]

    @contextmanager
    def running(self, *targets):
        over = threading.Event()
        threads = [threading.Thread(target=target) for target in targets]
        threads.append(threading.Thread(target=self.robot.run, args=(over,)))
        for thread in threads:
            thread.start()
        try:
            yield self
        finally:
            self.node.stop()
            for thread in threads[:-1]:
                thread.join(20.0)
            over.set()
            threads[-1].join(20.0)
            assert not any(thread.is_alive() for thread in threads)


BOUND = CONFIG.limits.a_max * CONFIG.filter.period + 1e-9


def steepest(commands):
    """Largest change of speed from one command to the next."""
    return max(abs(b.v - a.v) for a, b in itertools.pairwise(commands))


def values(status):
    return {item.key: item.value for item in status.values}


def wait_for(condition, timeout=10.0):
    end = time.monotonic() + timeout
    while not (found := condition()):
        assert time.monotonic() < end, condition
        time.sleep(0.001)
    return found


def test_dock_and_undock():
    world = World()
    with world.running(world.node.run):
        docked = world.client.perform(Goal(Action.DOCK), 30.0)
        at = world.plant.pose()
        undocked = world.client.perform(Goal(Action.UNDOCK), 30.0)
        out = world.plant.pose()
    assert docked["success"], docked
    assert undocked["success"], undocked
    assert math.hypot(at.x, at.y) < 0.010
    assert abs(at.theta) < math.radians(2.0)
    assert math.dist(at[:2], out[:2]) == pytest.approx(0.7, abs=0.05)
    commands = world.commands()
    assert commands[-1] == REST
    assert all(abs(c.v) <= 0.22 + 1e-9 and abs(c.omega) <= 0.4 + 1e-9 for c in commands)
    told = [json.loads(m.data) for m in world.bus.messages("/docking/feedback")]
    states = list(dict.fromkeys(each["state_name"] for each in told))
    assert states == ["INITIAL_PERCEPTION", "CONTROLLING", "WAIT_FOR_CHARGE", "NONE"]
    told = [each for each in world.diagnostics() if "loop" in each]
    assert told
    assert {status.level for each in told for status in each.values()} <= {Level.OK, Level.WARN}
    loop = values(told[-1]["loop"])
    assert float(loop["period_p50"]) == pytest.approx(CONFIG.filter.period, abs=1e-6)
    assert 0.06 <= float(loop["latency_p50"]) <= 0.15


def test_without_stamps_in_real_time():
    """Two seconds of it: the robot moves, and the node stops it when it is asked to end."""
    given = {"detection_frame": FRAME.name, "enable_stamped_cmd_vel": False}
    world = World(given, step=None)
    with world.running(world.node.run):
        goal = world.client.send(Goal(Action.DOCK))
        wait_for(lambda: world.plant.pose().x > START.x + 0.05)
        world.node.stop()
        result = wait_for(lambda: world.client.result(goal))
    assert result["canceled"]
    assert not result["success"]
    commands = [twist_of(m) for m in world.bus.messages("/cmd_vel")]
    assert commands[-1] == REST
    assert steepest(commands[:-1]) <= BOUND


def test_a_task_is_canceled_within_the_limits_and_another_may_follow():
    world = World()
    with world.running(world.node.run):
        goal = world.client.send(Goal(Action.DOCK))
        wait_for(lambda: world.plant.twist().v > 0.1)
        world.client.cancel()
        first = wait_for(lambda: world.client.result(goal))
        begun = len(world.commands())
        second = world.client.perform(Goal(Action.DOCK), 30.0)
    assert first["canceled"]
    assert second["success"], second
    braked = world.commands()[:begun]
    assert braked[-1] == REST
    assert steepest(braked) <= BOUND


def test_a_cancel_before_a_task_does_not_end_it():
    world = World()
    with world.running(world.node.run):
        world.client.cancel()
        time.sleep(0.1)
        assert world.client.perform(Goal(Action.DOCK), 30.0)["success"]


def test_a_second_goal_is_rejected_and_the_first_goes_on():
    world = World()
    with world.running(world.node.run):
        goal = world.client.send(Goal(Action.DOCK))
        wait_for(lambda: world.node.busy)
        second = world.client.send(Goal(Action.UNDOCK))
        rejected = wait_for(lambda: world.client.result(second))
        wait_for(lambda: not world.node.busy, 30.0)
        result = json.loads(world.bus.messages("/docking/result")[-1].data)
    assert (rejected["error_code"], rejected["success"]) == (1, False)
    assert "dock is in progress" in rejected["error_msg"]
    assert result["goal_id"] == goal.goal_id
    assert result["success"]


def test_a_dock_that_is_not_known():
    world = World()
    with world.running(world.node.run):
        told = world.client.perform(Goal(Action.DOCK, "attic"), 10.0)
        other = world.client.perform(Goal(Action.UNDOCK, "attic"), 10.0)
    assert (told["error_code"], told["error_name"]) == (901, "DOCK_NOT_IN_DB")
    assert "'attic'" in told["error_msg"]
    assert other["error_code"] == 902
    assert world.commands() == []
    assert world.diagnostics()[-1]["controller"].level in (Level.ERROR, Level.OK)


def test_nobody_listens_to_the_commands(monkeypatch):
    monkeypatch.setattr("clfcbf.ros2.node.DISCOVERY", 0.05)
    bus = Bus()
    node = DockingNode(settings_of(CONFIG), bus.transport())
    client = TaskClient(bus.transport())
    thread = threading.Thread(target=node.run)
    thread.start()
    try:
        told = client.perform(Goal(Action.DOCK), 5.0)
    finally:
        node.stop()
        thread.join()
    assert told["error_code"] == 1
    assert "nobody listens" in told["error_msg"]


def test_a_base_that_is_gone_ends_the_task_and_not_the_node(monkeypatch):
    world = World()
    lost = []

    def listeners(self):
        return 0 if lost else 1

    monkeypatch.setattr("tests.ros2.bus.BusPublisher.listeners", listeners)
    with world.running(world.node.run):
        goal = world.client.send(Goal(Action.DOCK))
        wait_for(lambda: world.plant.twist().v > 0.1)
        lost.append(True)
        told = wait_for(lambda: world.client.result(goal))
        lost.clear()
        assert world.client.perform(Goal(Action.DOCK), 30.0)["success"]
    assert (told["error_code"], told["error_name"]) == (999, "UNKNOWN")
    assert "nobody listens to /cmd_vel" in told["error_msg"]


def test_a_dock_that_is_not_seen_is_told_after_the_retries():
    """The poses come in a frame that was not declared: refused, counted, and in diagnostics."""
    given = {"detection_frame": "another_frame", "use_sim_time": True, "max_retries": 1}
    world = World(given)
    with world.running(world.node.run):
        told = world.client.perform(Goal(Action.DOCK), 30.0)
    assert (told["error_code"], told["num_retries"]) == (904, 1)
    seen = [each["detection"] for each in world.diagnostics()]
    worst = max(seen, key=lambda status: status.level)
    assert worst.level == Level.WARN
    assert "'camera_optical_frame', expected 'another_frame'" in worst.message
    assert int(values(seen[-1])["frame"]) > 0
    assert values(seen[-1])["accepted"] == "0"
    assert set(world.commands()) == {REST}


def test_diagnostics_without_a_task():
    bus = Bus()
    node = DockingNode(settings_of(CONFIG), bus.transport())
    thread = threading.Thread(target=node.run)
    thread.start()
    wait_for(lambda: bus.messages("/diagnostics"))
    node.stop()
    thread.join()
    node.close()
    (message,) = bus.messages("/diagnostics")
    parts = {status.name: status for status in message.status}
    assert parts["docking: controller"].level == Level.OK
    assert parts["docking: detection"].message == "nobody publishes poses of the dock"
    assert [twist_of(m.twist) for m in bus.messages("/cmd_vel")] == [REST]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_brakes_and_ends_the_node(number):
    world = World()

    def interrupt():
        world.client.send(Goal(Action.DOCK))
        wait_for(lambda: world.plant.twist().v > 0.1)
        os.kill(os.getpid(), number)

    with world.running(interrupt):
        world.node.run()  # in the main thread, where signals are caught
    world.node.close()
    commands = world.commands()
    assert max(c.v for c in commands) > 0.05
    assert commands[-1] == REST
    assert steepest(commands) <= BOUND
    told = json.loads(world.bus.messages("/docking/result")[-1].data)
    assert told["canceled"]


def test_what_is_recorded_replays_to_the_last_bit(tmp_path):
    pytest.importorskip("mcap", reason="needs the extra record")
    from clfcbf.recorder import read_log, replay

    world = World(record=tmp_path / "node.mcap")
    with world.running(world.node.run):
        for action in Action:
            assert world.client.perform(Goal(action), 30.0)["success"]
    world.node.close()
    report = replay(read_log(tmp_path / "node.mcap"))
    assert report.reproduced, str(report)
    assert report.ticks > 200
    assert any("recorder" in each for each in world.diagnostics())
    with pytest.raises(ConfigurationError, match="cannot record"):
        World(record=tmp_path / "node.mcap")


def test_a_transport_that_fails_stops_the_node_but_not_without_zero():
    world = World()
    with world.running() as running:
        client = running.client
        goal = client.send(Goal(Action.DOCK))

        def fail():
            wait_for(lambda: world.plant.twist().v > 0.1)
            for publisher in world.bus.publishers:
                if publisher.topic == "/docking/feedback":
                    publisher.closed = True

        thread = threading.Thread(target=fail)
        thread.start()
        world.node.run(tasks=1)
        thread.join()
        told = wait_for(lambda: client.result(goal))
    assert told["error_code"] == 999
    assert "the transport is closed" in told["error_msg"]
    assert world.commands()[-1] == REST


# The simulated robot --------------------------------------------------------------------------


def test_a_robot_stops_without_commands_and_refuses_what_is_no_number():
    world = World()
    publisher = world.bus.transport().publisher(TwistStamped, "/cmd_vel", COMMANDS)

    def command(v):
        now = Time.of(round(1e9 * world.plant.time))
        message = TwistStamped(Header(now))
        twist = message.twist
        publisher.publish(
            TwistStamped(Header(now), type(twist)(type(twist.linear)(x=v), twist.angular))
        )

    command(0.1)
    world.robot.step()
    assert world.plant.applied() == Twist(0.1, 0.0)
    command(math.nan)
    world.robot.step()
    assert world.robot.refused == 1
    assert world.plant.applied() == Twist(0.1, 0.0)
    for _ in range(20):
        world.robot._in_step = False
        world.robot.step()
    assert world.plant.applied() == REST


def test_lockstep_needs_stamps():
    world = World()
    with pytest.raises(ConfigurationError, match="lockstep"):
        SimulatedRobot(world.plant, None, world.bus.transport(), stamped=False, step=0.1)


def test_a_pose_of_the_future_or_of_yesterday_is_not_driven_by():
    world = World()
    publisher = world.bus.transport().publisher(PoseStamped, "/detected_dock_pose", Quality())
    pose = FRAME.encode(Pose2(1.5, 0.0, 0.0))
    publisher.publish(PoseStamped(Header(Time(3600), FRAME.name), pose))
    assert world.node.target.observe() is None
    assert sum(world.node.target.counts.values()) == 1


# Levels ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", Status)
def test_the_level_of_a_decision(status):
    decision = Decision(REST, status, True, REST, 0.1)
    level = Level(decision_status(decision).level)
    if status in (Status.OPTIMAL, Status.RELAXED, Status.GUARDED, Status.STOPPED):
        assert level is Level.OK
    else:
        assert level >= Level.WARN
    assert decision_status(decision._replace(phase=Phase.FAILED)).level == Level.ERROR


def test_a_closed_bus_refuses():
    bus = Bus()
    transport = bus.transport()
    publisher = transport.publisher(TwistStamped, "/a", EVENTS)
    transport.close()
    with pytest.raises(TransportError):
        publisher.publish(TwistStamped())
