"""What tests on a real network share: a domain of their own, on this machine alone."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

from clfcbf.ros2.transport import LOCALHOST
from tests.ros2.samples import SAMPLES

ROOT = Path(__file__).parents[2]
ROS_PYTHON = os.environ.get("CLFCBF_ROS_PYTHON", "")

DOMAIN = 1 + os.getpid() % 200
"""Workers that run at once have different process numbers, and do not hear one another."""


def environment():
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {**os.environ, LOCALHOST: "LOCALHOST", "PYTHONPATH": path, "PYTHONWARNINGS": "default"}


@contextlib.contextmanager
def peer(kind, role, domain=DOMAIN, interpreter=None):
    """A ``peer.py``; closing its standard input ends it, and what it printed is in ``told``."""
    python = interpreter or (ROS_PYTHON if kind == "rclpy" else sys.executable)
    process = subprocess.Popen(
        [python, "-m", "tests.ros2.peer", kind, str(domain), role], env=environment(), cwd=ROOT,
        text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    process.told = ""
    try:
        yield process
    finally:
        try:
            process.told, errors = process.communicate("", timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert process.returncode == 0, errors


def wait_for(condition, timeout=15.0):
    end = time.monotonic() + timeout
    while not (found := condition()):
        assert time.monotonic() < end, condition
        time.sleep(0.002)
    return found


def sent_and_returned(transport):
    """Every sample with what an echo made of it."""
    ends = [
        (
            transport.publisher(type(message), f"/there{i}", quality),
            transport.subscription(type(message), f"/back{i}", quality),
        )
        for i, (message, quality) in enumerate(SAMPLES)
    ]
    wait_for(lambda: all(p.listeners() and s.sources() for p, s in ends))
    found = []
    for (publisher, subscription), (message, _) in zip(ends, SAMPLES, strict=True):
        # What is not reliable may be lost, and the echo's publisher may not have found us yet.
        for _ in range(50):
            publisher.publish(message)
            try:
                (*_, back) = wait_for(subscription.take, timeout=0.2)
            except AssertionError:
                continue
            break
        else:
            back = None
        found.append((message, back))
    return found
