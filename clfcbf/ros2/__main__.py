"""``python -m clfcbf.ros2 robot.toml``: the docking node, see docs/ros2.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from clfcbf.config import read_config
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.ros2.dds import DdsTransport
from clfcbf.ros2.node import DockingNode
from clfcbf.ros2.parameters import defaults_of, parse_given, settings_of
from clfcbf.ros2.rcl import RclTransport

__all__ = ["main"]

USAGE_ERROR = 2
"""Exit status where the command was wrong or cannot run here, as argument parsers have it."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m clfcbf.ros2",
        description="Docking node: dock/undock goals in, cmd_vel, feedback and diagnostics out.",
        epilog="With rclpy, --ros-args and what follows it go to ROS.",
    )
    parser.add_argument("config", help="the robot's configuration, see: clfcbf check --template")
    parser.add_argument(
        "--transport", choices=("dds", "rclpy"), default="dds",
        help="dds needs no ROS (extra dds), rclpy a sourced ROS 2; default: %(default)s",
    )  # fmt: skip
    parser.add_argument(
        "-p", dest="parameters", metavar="NAME:=VALUE", action="append", default=[],
        help="a parameter, see docs/ros2.md; any number of times",
    )  # fmt: skip
    parser.add_argument("--namespace", default="", help="of the topics; with rclpy the node's own")
    parser.add_argument("--domain", type=int, help="DDS domain; default: ROS_DOMAIN_ID, else 0")
    parser.add_argument("--record", metavar="FILE", help="new log of all ticks, for clfcbf replay")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; the exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    cut = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = _parser().parse_args(given[:cut])
    try:
        _run(options, given[cut:])
    except ClfcbfError as error:
        print(f"clfcbf.ros2: {error}", file=sys.stderr)
        return USAGE_ERROR
    return 0


def _run(options: argparse.Namespace, ros_arguments: Sequence[str]) -> None:
    config = read_config(options.config)
    values: dict[str, Any] = dict(parse_given(options.parameters))
    settings_of(config, values)  # what is wrong with them is told before anything starts
    namespace, transport = options.namespace, None
    if options.transport == "rclpy":
        usual = {**defaults_of(config), **values}
        # Every ROS node has declared use_sim_time already.
        declared = {name: value for name, value in usual.items() if name != "use_sim_time"}
        transport = RclTransport("docking", ros_arguments, options.domain)
        values = transport.parameters(declared) | {"use_sim_time": transport.uses_sim_time}
        namespace = namespace or transport.namespace
    elif ros_arguments:
        raise ConfigurationError("--ros-args needs --transport rclpy; use -p name:=value")
    made = transport or DdsTransport(options.domain)
    try:
        node = DockingNode(settings_of(config, values), made, namespace, record=options.record)
        print("docking node: waiting for goals", flush=True)
        try:
            node.run()
        finally:
            node.close()
    finally:
        made.close()


if __name__ == "__main__":
    sys.exit(main())
