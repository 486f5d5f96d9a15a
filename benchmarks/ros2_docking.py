"""Docking and undocking through ROS 2 topics, three processes a run, every tick recorded.

``python -m benchmarks.ros2_docking [--runs N] [--seed S] [--region R1] [--plant mujoco|kinematic]
[--real-time] [--rclpy PYTHON] [--logs DIR] [--json FILE]``

The robot is simulated in one process, ``python -m clfcbf.ros2`` is another, and this one gives
the goals and judges: by the true pose after standstill, and by replaying every log to the last
bit. In lockstep with the simulation's ``/clock``, unless ``--real-time``. With ``--rclpy`` the
node runs in that interpreter, which has rclpy, and everything else by Cyclone DDS.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clfcbf import Pose2
from clfcbf.config import parse_config, template
from clfcbf.recorder import read_log, replay
from clfcbf.ros2 import Action, DdsTransport, DetectionFrame, Goal, SimulatedRobot, TaskClient
from clfcbf.ros2.messages import PoseStamped
from clfcbf.ros2.simulated import TRUTH
from clfcbf.ros2.transport import EVENTS, LOCALHOST
from clfcbf.simulation.judge import is_docked
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.mujoco_plant import MujocoPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World, draw_start, region_named
from clfcbf.simulation.sensor import PoseSensor, SensorModel

__all__ = ["Run", "main", "perform"]

ROOT = Path(__file__).parents[1]

FRAME = "camera_optical_frame"

WAIT = 1.0
"""[s] Of the robot's time after a result at which its pose is judged, standing."""

START_UP = 20.0
"""[s] For the processes to find one another; an interpreter with ROS takes two or three."""

TASK = 240.0
"""[s] For a task, retries included."""

UNDOCKED = 0.05
"""[m] By which the way out may differ from the staging pose's distance: Nav2's tolerance."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run.

    Attributes
    ----------
    index, seed : of the run, and of all of them
    region : where it starts
    plant : mujoco or kinematic
    real_time : at the pace of the machine's clock, else in lockstep
    rclpy : interpreter of a node with rclpy; empty for Cyclone DDS and this one
    domain : of DDS
    """

    index: int = 0
    seed: int = 0
    region: str = "R1"
    plant: str = "mujoco"
    real_time: bool = False
    rclpy: str = ""
    domain: int = 0

    def robot(self, transport: DdsTransport) -> SimulatedRobot:
        """The simulated robot behind its topics."""
        config, world = parse_config(template()), World()
        rng = np.random.default_rng((self.seed, self.index))
        start = draw_start(region_named(self.region), world, rng)
        made = {"mujoco": MujocoPlant, "kinematic": KinematicPlant}[self.plant]
        plant: Any = made(start, config.limits, Body(), rng)
        sensor = PoseSensor(plant, config.camera, config.standoff, SensorModel.named("A"), rng)
        return SimulatedRobot(
            plant, sensor, transport,
            frame=DetectionFrame(FRAME, config.camera.camera, optical=True),
            step=None if self.real_time else config.filter.period,
        )  # fmt: skip


def drive(run: Run, over: Any) -> None:
    """The robot's process, until ``over`` is set."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who started this
    transport = DdsTransport(run.domain)
    robot = run.robot(transport)
    robot.run(over)
    robot.close()
    transport.close()


@contextlib.contextmanager
def robot_process(run: Run) -> Iterator[None]:
    context = multiprocessing.get_context("spawn")
    over = context.Event()
    process = context.Process(target=drive, args=(run, over), daemon=True)
    process.start()
    try:
        yield
    finally:
        over.set()
        process.join(START_UP)
        if process.is_alive():
            process.kill()


@contextlib.contextmanager
def node_process(run: Run, folder: Path) -> Iterator[subprocess.Popen[str]]:
    config = folder / "robot.toml"
    config.write_text(template(), encoding="utf-8")
    parameters = {"detection_frame": FRAME, "use_sim_time": "false" if run.real_time else "true"}
    command = [
        run.rclpy or sys.executable, "-m", "clfcbf.ros2", str(config), "--domain", str(run.domain),
        "--transport", "rclpy" if run.rclpy else "dds", "--record", str(folder / "node.mcap"),
    ]  # fmt: skip
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command += ["--ros-args", *given] if run.rclpy else given
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=START_UP)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


class Judge:
    """Listens to the robot's true pose, on a thread so that none is missed."""

    def __init__(self, transport: DdsTransport) -> None:
        self._poses = transport.subscription(PoseStamped, f"/{TRUTH}", EVENTS)
        self._latest: tuple[float, Pose2] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._over.wait(0.002):
            for message in self._poses.take():
                pose = DetectionFrame("dock").decode(message.pose)
                if isinstance(pose, Pose2):
                    self._latest = (1e-9 * message.header.stamp.nanoseconds, pose)

    def standing(self) -> Pose2:
        """The pose ``WAIT`` after now, in the robot's time."""
        end, since = time.monotonic() + START_UP, None
        while time.monotonic() < end:
            if self._latest is not None:
                since = self._latest[0] if since is None else since
                if self._latest[0] - since >= WAIT:
                    return self._latest[1]
            time.sleep(0.002)
        raise RuntimeError(f"no true pose of the robot within {START_UP:g} s")

    def close(self) -> None:
        self._over.set()
        self._thread.join()


def perform(run: Run, folder: Path) -> dict[str, Any]:
    """Dock, undock, replay; what came of it."""
    transport = DdsTransport(run.domain)
    begun = time.monotonic()
    with node_process(run, folder) as node, robot_process(run):
        client, judge = TaskClient(transport), Judge(transport)
        try:
            client.wait_for_node(START_UP)
            start = judge.standing()
            docked = client.perform(Goal(Action.DOCK), TASK)
            at = judge.standing()
            undocked = client.perform(Goal(Action.UNDOCK), TASK)
            out = judge.standing()
        finally:
            judge.close()
            transport.close()
    replays = [replay(read_log(path)) for path in sorted(folder.glob("*.mcap"))]
    away = abs(math.hypot(out.x - at.x, out.y - at.y) - 0.7) < UNDOCKED
    return {
        "index": run.index, "start": list(start),
        "success": bool(docked["success"] and is_docked(at) and undocked["success"] and away),
        "docked": dict(docked), "undocked": dict(undocked),
        "e_lon_mm": 1e3 * at.x, "e_lat_mm": 1e3 * at.y, "e_theta_deg": math.degrees(at.theta),
        "backed_out_m": math.hypot(out.x - at.x, out.y - at.y),
        "ticks": sum(each.ticks for each in replays),
        "reproduced": bool(replays) and all(each.reproduced for each in replays),
        "node_exit_status": node.returncode, "wall_s": time.monotonic() - begun,
    }  # fmt: skip


def _told(record: dict[str, Any]) -> str:
    x, y, theta = record["start"]
    verdict = "ok    " if record["success"] else "FAILED"
    replayed = "to the last bit" if record["reproduced"] else "DIFFERENTLY"
    return (
        f"{record['index']:3} {verdict} from ({x:5.2f}, {y:5.2f}) m {math.degrees(theta):4.0f}°: "
        f"{record['e_lon_mm']:5.1f} mm, {record['e_lat_mm']:5.1f} mm, "
        f"{record['e_theta_deg']:5.2f}°; out {record['backed_out_m']:.3f} m; "
        f"{record['ticks']} ticks replayed {replayed}; {record['wall_s']:.1f} s"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the runs and print what came of them; 0 whatever it was."""
    parser = argparse.ArgumentParser(prog="benchmarks.ros2_docking", description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--region", default="R1")
    parser.add_argument("--plant", choices=("mujoco", "kinematic"), default="mujoco")
    parser.add_argument("--real-time", action="store_true")
    parser.add_argument("--rclpy", default="", metavar="PYTHON", help="of a node with rclpy")
    parser.add_argument("--domain", type=int, default=1 + os.getpid() % 200)
    parser.add_argument("--logs", type=Path, metavar="DIR", help="keep the recordings there")
    parser.add_argument("--json", type=Path, metavar="FILE", help="overwritten")
    options = parser.parse_args(arguments)
    os.environ.setdefault(LOCALHOST, "LOCALHOST")
    records = []
    with tempfile.TemporaryDirectory() as scratch:
        for index in range(options.runs):
            run = Run(
                index, options.seed, options.region, options.plant, options.real_time,
                options.rclpy, options.domain,
            )  # fmt: skip
            folder = (options.logs or Path(scratch)) / f"run-{index:03d}"
            folder.mkdir(parents=True, exist_ok=True)
            records.append(perform(run, folder))
            print(_told(records[-1]), flush=True)
            if options.json is not None:
                options.json.write_text(json.dumps({"runs": records}, indent=1) + "\n", "utf-8")
    good = sum(record["success"] for record in records)
    same = sum(record["reproduced"] for record in records)
    print(f"{good} of {len(records)} docked and undocked, {same} replayed to the last bit")
    return 0


if __name__ == "__main__":
    sys.exit(main())
