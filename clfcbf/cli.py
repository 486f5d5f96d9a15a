"""The command line: ``clfcbf COMMAND [OPTIONS]``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from clfcbf import config, defaults, doctor, explain, plots, recorder, report
from clfcbf.decision import Decision
from clfcbf.errors import ClfcbfError, ConfigurationError, MissingExtraError
from clfcbf.recorder.figure import log_figure
from clfcbf.simulation import campaign
from clfcbf.simulation.campaign import EpisodeSpec
from clfcbf.simulation.scenarios import World, limits_named, region_named

__all__ = [
    "COMMANDS", "Approach", "Check", "Command", "Doctor", "Explain", "Plot", "Replay", "approach",
    "main", "usable_cores",
]  # fmt: skip

FOUND_WRONG = 1
"""Exit status where a file was read and what it says is wrong."""
USAGE_ERROR = 2
"""Exit status where the command was wrong or cannot run here, as argument parsers have it."""
INTERRUPTED = 130
"""Exit status after Ctrl-C: 128 and the number of SIGINT, as shells have it."""


class Command(Protocol):
    """A subcommand: a dataclass whose fields are its options."""

    def run(self) -> int:
        """Do it; the exit status."""


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Approach:
    """Dock from seeded random starts in simulation and report the errors of every run.

    The exit status is 0 whenever all runs were made, whatever came out of them.
    """

    poses: int = 30
    """Number of runs, each from its own start."""
    seed: int = 0
    """Seed of the campaign: starts, bodies and sensor noise follow from it."""
    region: str = "R1"
    """Where runs start: R1 (the paper's region), R2 (with little of the board in view), R3 (close),
    R4 (close and to the side), R5 (so close that it has to reverse), R6 (the docking stage), R7
    (with a camera of 50°) or R8 (the target is nudged on the way)."""
    controller: str = "clf-cbf"
    """clf-cbf, or paper for the published method."""
    plant: str = "mujoco"
    """mujoco, with wheels and contact, or kinematic, exact arcs."""
    sensor: str = "A"
    """ideal, A (white noise), B (A and a calibration error) or C (A and a bias by distance); with
    depth- before it, a depth camera that sees the board and fits it, errors by geometry."""
    limits: str = ""
    """Speed limits of the stage: approaching (0.22 m/s, 0.4 rad/s) or docking (0.35, 0.25); those
    of the region if none are given."""
    ideal: bool = False
    """No lag, no slip, no sensor noise, no latency."""
    backend: str = "exact"
    """Solver of the quadratic program."""
    workers: int = field(default_factory=usable_cores)
    """Processes that share the runs; the default is one for each usable core."""
    json: Path | None = None
    """Write every run and the summary here, over what is there."""
    plot: Path | None = None
    """Draw the runs here: .png, .svg or .pdf."""

    @property
    def specs(self) -> list[EpisodeSpec]:
        """The runs."""
        return [
            EpisodeSpec(
                self.region, self.seed, index, self.controller, self.plant, self.sensor,
                self.limits, self.backend, self.ideal,
            )
            for index in range(self.poses)
        ]  # fmt: skip

    @property
    def heading(self) -> str:
        """What is run, in three lines."""
        stage = self.limits or region_named(self.region).limits
        limits = limits_named(stage)
        sensor = "ideal sensor and body" if self.ideal else f"sensor {self.sensor}"
        return (
            f"{self.poses} runs from {self.region} ({region_named(self.region).about}), "
            f"seed {self.seed}\n"
            f"controller {self.controller}, backend {self.backend}, plant {self.plant}, {sensor}\n"
            f"limits {stage}: {limits.v_max:g} m/s, {limits.omega_max:g} rad/s, "
            f"{limits.a_max:g} m/s², {limits.alpha_max:g} rad/s²"
        )

    def run(self) -> int:
        """Make the runs."""
        return approach(self)


@dataclass(frozen=True, slots=True)
class Explain:
    """Say why a tick that was saved sent what it sent.

    The file is a flight recorder's log, or JSON: a decision is saved with
    json.dumps(decision_to_json(decision)), see clfcbf.explain; a file holds one, or a list of
    them.
    """

    file: Path
    """The file that holds the tick."""
    tick: int | None = None
    """Which of a list, from 0, or from -1 at its end; all of them if not given."""
    at: float | None = None
    """Of a log the tick in force at this time, in seconds since its first tick."""
    json: bool = False
    """Print everything that is known as JSON, not a sentence."""

    def run(self) -> int:
        """Print it."""
        if recorder.is_log(self.file):
            decisions = self._logged()
        elif self.at is not None:
            raise ConfigurationError(
                f"--at needs a flight recorder's log, which {str(self.file)!r} is not"
            )
        else:
            decisions = explain.decisions_in(_load(self.file))
        if not decisions:
            raise ConfigurationError(f"{str(self.file)!r} holds no tick")
        if self.tick is not None:
            if not -len(decisions) <= self.tick < len(decisions):
                raise ConfigurationError(
                    f"--tick must be from 0 to {len(decisions) - 1}, the ticks in "
                    f"{str(self.file)!r}, got {self.tick}"
                )
            decisions = [decisions[self.tick]]
        found = [explain.explain(decision) for decision in decisions]
        if self.json:
            records = [explanation.to_dict() for explanation in found]
            _print(json.dumps(records[0] if len(records) == 1 else records, indent=1))
        else:
            _print("\n".join(map(str, found)))
        return 0

    def _logged(self) -> list[Decision]:
        log = recorder.read_log(self.file)
        if self.at is None:
            return [tick.decision for tick in log.ticks()]
        if self.tick is not None:
            raise ConfigurationError("give --tick or --at, not both")
        return [log.tick_at(self.at).decision]


@dataclass(frozen=True, slots=True)
class Replay:
    """Compute every command of a flight recorder's log again, and say where one differs.

    The exit status is 0 where all come out to the last bit, and 1 where not.
    """

    file: Path
    """The log."""

    def run(self) -> int:
        """Replay it, print what was found."""
        found = recorder.replay(recorder.read_log(self.file))
        _print(str(found))
        return 0 if found.reproduced else FOUND_WRONG


@dataclass(frozen=True, slots=True)
class Plot:
    """Draw a flight recorder's log: commands, clearance, status and duration over time."""

    file: Path
    """The log."""
    out: Path | None = None
    """Draw here: .png, .svg or .pdf; beside the log, as .png, if not given."""

    def run(self) -> int:
        """Draw it, print where."""
        out = self.out if self.out is not None else self.file.with_suffix(".png")
        plots.check_format(out)
        report.check_writable(out)
        plots.save_figure(log_figure(recorder.read_log(self.file)), out)
        _print(str(out))
        return 0


@dataclass(frozen=True, slots=True)
class Doctor:
    """Say what is installed, whether it works, and how fast: packages, solvers, one timing each."""

    json: Path | None = None
    """Write all of it here too, over what is there."""

    def run(self) -> int:
        """Examine, write the file asked for, print the table."""
        if self.json is not None:
            report.check_writable(self.json)
        examination = doctor.examine()
        if self.json is not None:
            report.write_json(self.json, examination.to_dict())
        _print(doctor.table(examination))
        return 0


@dataclass(frozen=True, slots=True)
class Check:
    """Say what is wrong with a robot's configuration, and what is risky; or print a template.

    The exit status is 0 where nothing is wrong, 1 where something is, and 2 where the file cannot
    be taken as a configuration at all.
    """

    file: Path | None = None
    """The configuration, a TOML file."""
    template: bool = False
    """Print a configuration with every key, what it means and its default, and do nothing else."""

    def run(self) -> int:
        """Read, look, build the controller, print what was found."""
        if self.template:
            _print(config.template().rstrip())
            return 0
        if self.file is None:
            raise ConfigurationError("give a configuration to check, or --template for a new one")
        read = config.read_config(self.file)
        found = config.findings(read)
        wrong = sum(finding.severity is config.Severity.WRONG for finding in found)
        if not wrong:
            try:
                read.controller()
            except ClfcbfError as error:
                raise ConfigurationError(f"{self.file}: {error}") from error
        lines = [str(finding) for finding in found]
        _print("\n".join([*lines, f"{self.file}: {wrong} wrong, {len(found) - wrong} risky"]))
        return FOUND_WRONG if wrong else 0


COMMANDS: dict[str, type[Command]] = {
    "approach": Approach, "check": Check, "doctor": Doctor, "explain": Explain, "plot": Plot,
    "replay": Replay,
}  # fmt: skip
"""Subcommands by name; a further one is one line."""


def _check(options: Approach, world: World) -> None:
    for name, least in (("poses", 1), ("seed", 0), ("workers", 1)):
        value = getattr(options, name)
        if value < least:
            raise ConfigurationError(f"--{name} must be at least {least}, got {value}")
    campaign.check_spec(options.specs[0], world)
    for path in (options.json, options.plot):
        if path is not None:
            report.check_writable(path)
    if options.plot is not None:
        plots.check_format(options.plot)


def approach(options: Approach, world: World | None = None) -> int:
    """Make the runs, write the files asked for, print the table; the exit status.

    ``world`` is what stands where; the default is the one that published figures refer to.
    Everything that can be refused is refused before the first run.
    """
    world = world or World()
    _check(options, world)
    specs = options.specs
    work = campaign.record if options.plot is None else campaign.record_and_track
    runs = campaign.run_specs(specs, options.workers, partial(work, world=world))
    records = list(_progress(runs, len(specs)))
    tracks = [record.pop("track", None) for record in records]
    summary = campaign.summarise(records)
    if options.json is not None:
        settings = {**asdict(options), "config_hash": defaults.fingerprint()}
        report.write_json(options.json, _document(settings, records, summary))
    if options.plot is not None:
        figure = plots.approach_figure(records, tracks, world)
        plots.save_figure(figure, options.plot)
    _print(report.table(records, summary, options.heading))
    return 0


def _document(
    settings: Mapping[str, Any], records: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]
) -> dict[str, Any]:
    config = {key: str(value) if isinstance(value, Path) else value
              for key, value in settings.items()}  # fmt: skip
    config["versions"] = report.versions()
    return {"config": config, "episodes": list(records), "summary": dict(summary)}


def _progress(runs: Iterable[dict[str, Any]], total: int) -> Iterable[dict[str, Any]]:
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "cli") from error
    bar: Iterable[dict[str, Any]] = tqdm(
        runs, total=total, unit="run", file=sys.stderr, leave=False,
        disable=None,  # silent where stderr is not a terminal
    )  # fmt: skip
    return bar


def _load(path: Path) -> Any:
    """What a JSON file holds."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigurationError(f"cannot read {str(path)!r}: {reason}") from error
    except (ValueError, RecursionError) as error:  # not JSON, not text, or nested too deeply
        raise ConfigurationError(f"{str(path)!r} is not JSON: {error}") from error


def _print(text: str) -> None:
    """Print also where the terminal's encoding lacks a character, or the reader has left."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(encoding, "replace").decode(encoding), flush=True)
    except BrokenPipeError:  # such as of "| head": the interpreter must not flush again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parsed(argv: Sequence[str] | None) -> Command:
    try:
        import tyro
    except ImportError as error:
        raise MissingExtraError("tyro", "cli") from error
    registry = tyro.constructors.ConstructorRegistry()

    def one_word(kind: type[Any], metavar: str) -> Any:
        return tyro.constructors.PrimitiveConstructorSpec(
            nargs=1,
            metavar=metavar,
            instance_from_str=lambda words: kind(words[0]),
            is_instance=lambda value: value is None or isinstance(value, kind),
            str_from_instance=lambda value: ["none" if value is None else str(value)],
        )

    @registry.primitive_rule
    def _plain(info: tyro.constructors.PrimitiveTypeInfo) -> Any:
        for kind, metavar in ((Path, "FILE"), (int, "INT"), (float, "FLOAT")):
            if info.type in (kind, kind | None):
                return one_word(kind, metavar)
        return None

    def check(file: Path | None = None, /, *, template: bool = False) -> Check:
        return Check(file, template)  # its file is an argument, and may be left out

    check.__doc__ = f"""{Check.__doc__}
    Args:
        file: The configuration, a TOML file.
        template: Print a configuration with every key, what it means and its default.
    """
    commands: dict[str, Callable[..., Any]] = {**COMMANDS, "check": check}
    command: Command = tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="clfcbf",
        description="Safe docking control for nonholonomic robots.",
        args=None if argv is None else list(argv),
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalRequiredArgs),
        registry=registry,
    )
    return command


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``clfcbf`` with ``argv``, or with the process's arguments; the exit status."""
    try:
        return _parsed(argv).run()
    except ClfcbfError as error:
        print(f"clfcbf: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("clfcbf: interrupted", file=sys.stderr)
        return INTERRUPTED
    except SystemExit as stop:  # the parser's, after it has printed its help or its error
        return stop.code if isinstance(stop.code, int) else USAGE_ERROR


if __name__ == "__main__":
    sys.exit(main())
