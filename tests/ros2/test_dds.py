"""Cyclone DDS as a transport: the wire, the qualities of service, other processes."""

from __future__ import annotations

import json
import struct
import sys
import time

import pytest

from clfcbf.errors import ConfigurationError, MissingExtraError
from clfcbf.ros2.messages import (
    MESSAGES,
    Header,
    PoseStamped,
    String,
    Time,
    Twist,
    TwistStamped,
    Vector3,
)
from clfcbf.ros2.transport import COMMANDS, EVENTS, LATCHED, LOCALHOST, Quality, TransportError
from tests.ros2 import network
from tests.ros2.network import DOMAIN, peer, sent_and_returned, wait_for

pytest.importorskip("cyclonedds", reason="needs the extra dds")

from clfcbf.ros2 import dds
from clfcbf.ros2.dds import DdsTransport

BEST = Quality(reliable=False, depth=10)


@pytest.fixture
def participant(monkeypatch):
    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    made = []

    def make():
        made.append(DdsTransport(DOMAIN))
        return made[-1]

    yield make
    for transport in made:
        transport.close()


def cdr_of_twist_stamped(message):
    """Little-endian CDR, by hand: header of 4 bytes, then members aligned to their size."""
    stamp, frame = message.header.stamp, message.header.frame_id.encode() + b"\0"
    body = struct.pack("<iII", stamp.sec, stamp.nanosec, len(frame)) + frame
    body += b"\0" * (-len(body) % 8)
    twist = message.twist
    numbers = [getattr(v, a) for v in (twist.linear, twist.angular) for a in "xyz"]
    return b"\0\1\0\0" + body + struct.pack("<6d", *numbers)


@pytest.mark.parametrize("frame", ["", "base_link", "a_longer_name_of_a_frame"])
def test_bytes_on_the_wire(frame):
    message = TwistStamped(
        Header(Time(-7, 999), frame), Twist(Vector3(0.1, 0.2, 0.3), Vector3(0.4, 0.5, 0.6))
    )
    wire = dds._to_wire(message, dds._wire_type(TwistStamped))
    assert wire.serialize()[4:] == cdr_of_twist_stamped(message)[4:]
    if frame == "base_link":
        assert len(wire.serialize()) == 76


def test_names_on_the_wire():
    names = {kind.NAME: dds._wire_type(kind).__idl_typename__ for kind in MESSAGES}
    assert names["geometry_msgs/msg/TwistStamped"] == "geometry_msgs::msg::dds_::TwistStamped_"
    for name, wire in names.items():
        package, group, kind = name.split("/")
        assert wire.replace(".", "::") == f"{package}::{group}::dds_::{kind}_"


def test_every_message_in_one_process(participant):
    one, other = participant(), participant()
    for i, (message, quality) in enumerate(network.SAMPLES):
        publisher = one.publisher(type(message), f"/here{i}", quality)
        subscription = other.subscription(type(message), f"/here{i}", quality)
        wait_for(lambda p=publisher, s=subscription: p.listeners() and s.sources())
        publisher.publish(message)
        assert wait_for(subscription.take) == [message]
        assert subscription.take() == []


def test_every_message_to_another_process_and_back(participant):
    with peer("dds", "echo"):
        for sent, back in sent_and_returned(participant()):
            assert back == sent


@pytest.mark.parametrize(
    ("offered", "asked", "heard"),
    [
        (EVENTS, EVENTS, True), (EVENTS, BEST, True), (BEST, BEST, True), (BEST, EVENTS, False),
        (LATCHED, EVENTS, True), (EVENTS, LATCHED, False),
    ],
)  # fmt: skip
def test_who_hears_whom(participant, offered, asked, heard):
    topic = f"/quality_{offered.reliable:d}{offered.latched:d}{asked.reliable:d}{asked.latched:d}"
    publisher = participant().publisher(String, topic, offered)
    subscription = participant().subscription(String, topic, asked)
    if heard:
        wait_for(lambda: publisher.listeners() and subscription.sources())
        publisher.publish(String("x"))
        assert wait_for(subscription.take) == [String("x")]
    else:
        time.sleep(0.1)
        publisher.publish(String("x"))
        time.sleep(0.05)
        assert subscription.take() == []
        assert publisher.listeners() == subscription.sources() == 0


def test_who_comes_late_gets_what_is_latched_and_no_more(participant):
    latched = participant().publisher(String, "/late", LATCHED)
    for text in "abc":
        latched.publish(String(text))
    subscription = participant().subscription(String, "/late", LATCHED)
    assert wait_for(subscription.take) == [String("c")]
    plain = participant().publisher(String, "/gone", EVENTS)
    plain.publish(String("a"))
    missed = participant().subscription(String, "/gone", EVENTS)
    wait_for(plain.listeners)
    time.sleep(0.05)
    assert missed.take() == []


def test_only_the_newest_are_kept(participant):
    subscription = participant().subscription(String, "/depth", Quality(depth=3))
    publisher = participant().publisher(String, "/depth", Quality(depth=10))
    wait_for(publisher.listeners)
    for number in range(10):
        publisher.publish(String(str(number)))
    assert publisher.flush(1.0)
    assert subscription.take() == [String("7"), String("8"), String("9")]


def test_after_the_end(participant):
    transport, other = participant(), participant()
    publisher = transport.publisher(Twist, "/end", COMMANDS)
    subscription = other.subscription(Twist, "/end", COMMANDS)
    wait_for(subscription.sources)
    publisher.publish(Twist(Vector3(0.5)))
    transport.close()
    transport.close()
    # What was sent before is not lost, and the other side learns that nobody is left.
    assert wait_for(subscription.take) == [Twist(Vector3(0.5))]
    wait_for(lambda: subscription.sources() == 0)
    for use in (
        lambda: publisher.publish(Twist()),
        lambda: transport.publisher(Twist, "/end", COMMANDS),
        lambda: transport.subscription(Twist, "/end", COMMANDS),
    ):
        with pytest.raises(TransportError, match="closed"):
            use()
    assert publisher.listeners() == 0
    assert publisher.flush(0.0)


def test_what_a_type_cannot_hold_is_told(participant):
    publisher = participant().publisher(TwistStamped, "/wrong", COMMANDS)
    with pytest.raises(TransportError, match="/wrong does not take"):
        publisher.publish(TwistStamped(Header(Time(2**40))))
    with pytest.raises(TransportError, match="/wrong does not take"):
        publisher.publish(PoseStamped())


def test_what_cannot_be_read_is_told(participant, monkeypatch):
    """Somebody else's text need not be UTF-8."""
    subscription = participant().subscription(String, "/latin", EVENTS)
    publisher = participant().publisher(String, "/latin", EVENTS)
    wait_for(publisher.listeners)
    raw = publisher._wire.serialize

    def latin(self, **options):
        return raw(self, **options).replace("ö".encode(), b"\xf6\xf6")

    monkeypatch.setattr(publisher._wire, "serialize", latin)
    publisher.publish(String("Köln"))
    with pytest.raises(TransportError, match="/latin cannot be read"):
        wait_for(subscription.take)


@pytest.mark.parametrize("domain", [-1, 233, 10**9])
def test_a_domain_has_a_number(domain, monkeypatch):
    with pytest.raises(ConfigurationError, match="domain must be from 0 to 232"):
        DdsTransport(domain)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with pytest.raises(ConfigurationError):
        DdsTransport()


def test_the_domain_is_that_of_ros(monkeypatch):
    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    transport = DdsTransport()
    assert transport.domain == DOMAIN
    transport.close()


def test_what_the_environment_says_comes_last(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///etc/cyclonedds.xml")
    monkeypatch.delenv(LOCALHOST, raising=False)
    assert "localhost" not in dds._configuration()
    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    assert "localhost" in dds._configuration()
    assert dds._configuration().endswith(",file:///etc/cyclonedds.xml")


def test_without_cyclone(monkeypatch):
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    with pytest.raises(MissingExtraError, match=r"clfcbf\[dds\]"):
        DdsTransport(DOMAIN)


def test_the_node_in_another_process_docks(tmp_path, monkeypatch):
    """Three processes: a simulated robot, the node from its command line, and this one."""
    pytest.importorskip("mcap", reason="needs the extra record")
    from benchmarks.ros2_docking import Run, perform

    monkeypatch.setenv(LOCALHOST, "LOCALHOST")
    found = perform(Run(plant="kinematic", domain=DOMAIN), tmp_path)
    assert found["success"], json.dumps(found)
    assert found["reproduced"]
    assert found["node_exit_status"] == 0


def test_the_command_line_tells_what_is_wrong(tmp_path, capsys):
    from clfcbf.config import template
    from clfcbf.ros2.__main__ import main

    config = tmp_path / "robot.toml"
    config.write_text(template(), encoding="utf-8")
    for arguments, complaint in (
        (["/nowhere.toml"], "cannot read"),
        ([str(config), "-p", "speed:=1"], "unknown parameter 'speed'"),
        ([str(config), "--ros-args", "-p", "a:=1"], "--ros-args needs --transport rclpy"),
        ([str(config), "--domain", "999"], "domain"),
    ):
        assert main(arguments) == 2
        assert complaint in capsys.readouterr().err


def test_the_command_line_without_ros(tmp_path, capsys):
    from clfcbf.config import template
    from clfcbf.ros2.__main__ import main

    pytest.importorskip("cyclonedds")
    try:
        import rclpy  # noqa: F401
    except ImportError:
        config = tmp_path / "robot.toml"
        config.write_text(template(), encoding="utf-8")
        assert main([str(config), "--transport", "rclpy"]) == 2
        assert "source ROS's setup file first" in capsys.readouterr().err
    else:
        pytest.skip("rclpy is installed here")
