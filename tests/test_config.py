"""The configuration file: read, checked, written; and mutated files, which only one error meets."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import random
import re
import struct
from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clfcbf import cli, defaults
from clfcbf.camera import FieldOfView
from clfcbf.config import (
    Config,
    Finding,
    Severity,
    findings,
    parse_config,
    read_config,
    template,
    to_toml,
)
from clfcbf.config.schema import DEGREES, REQUIRED, SECTIONS
from clfcbf.docking import DockingConfig
from clfcbf.errors import ConfigurationError
from clfcbf.limits import Limits
from clfcbf.runtime.policy import LoopPolicy, Overrun
from clfcbf.se2 import Pose2
from clfcbf.trajectories.following import FollowingGains
from clfcbf.wheels import WheelLimits
from tests.strategies import limits as any_limits

SMALL = """
[limits]
v_max = 0.22
omega_max_deg = 20
a_max = 0.3
alpha_max = 1

[camera]
half_angle_deg = 35.0
x = 0.2

[filter]
period = 0.04
lag = 0.12

[docking]
standoff = 0.6
"""


def changed(section: str, line: str, text: str = SMALL) -> str:
    """With ``line`` in its section, in place of a line of the same key if there is one."""
    name = line.split("=")[0].strip()
    head, tail = text.split(f"[{section}]\n") if f"[{section}]\n" in text else (text, "")
    body, *rest = re.split(r"(?=^\[)", tail, maxsplit=1, flags=re.MULTILINE)
    stem = name.removesuffix(DEGREES)
    body = re.sub(rf"^{stem}({DEGREES})? = .*\n", "", body, flags=re.MULTILINE)
    return f"{head}[{section}]\n{line}\n{body}{''.join(rest)}"


def keys_of(found: tuple[Finding, ...]) -> set[str]:
    return {finding.key for finding in found}


# Reading ----------------------------------------------------------------------------------------


def test_values_arrive_in_si_units():
    config = parse_config(SMALL)
    assert config.limits == Limits(0.22, math.radians(20.0), 0.3, 1.0)
    assert config.camera == FieldOfView(math.radians(35.0), Pose2(0.2, 0.0, 0.0))
    assert config.filter.period == 0.04
    assert config.filter.guard_lag == defaults.GUARD_LAG
    assert config.standoff == 0.6
    assert config.gains == FollowingGains()
    assert config.noise == defaults.NOISE
    assert config.loop == LoopPolicy()
    assert config.wheels is None


def test_the_controller_is_the_one_described():
    text = changed("gains", "k2 = 16", changed("docking", "attempts = 3"))
    controller = parse_config(changed("noise", "gate = 3.5", text)).controller()
    made = controller.config
    assert made.filter.limits.v_max == 0.22
    assert made.filter.period == 0.04
    assert made.filter.lag == 0.12
    assert made.camera.camera.x == 0.2
    assert made.attempts == 3
    assert made.gains == FollowingGains(k2=16.0)
    assert made.noise == defaults.NOISE._replace(gate=3.5)
    assert made.standoff == 0.6
    # and its filter is the one that the findings look at
    assert parse_config(text).filter == made.filter


@pytest.mark.parametrize("angle", ["alpha_max", "omega_max"])
def test_degrees_only_where_the_name_says_so(angle):
    plain = parse_config(changed("limits", f"{angle} = 0.5")).limits
    degrees = parse_config(changed("limits", f"{angle}_deg = 30")).limits
    assert getattr(plain, angle) == 0.5
    assert getattr(degrees, angle) == math.radians(30.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[limts]", "unknown section 'limts'; did you mean 'limits'?"),
        (changed("limits", "v_mx = 1"), r"\[limits\] unknown key 'v_mx'; did you mean 'v_max'?"),
        (changed("docking", "standof = 1"), r"\[docking\] unknown key 'standof'; did you mean"),
        (changed("limits", "v_max_deg = 3"), r"unknown key 'v_max_deg'; did you mean 'v_max'"),
        (changed("gains", "qqqqqqq = 3"), r"unknown key 'qqqqqqq' \(valid: k2, k3"),
        (SMALL.replace("standoff = 0.6", ""), r"\[docking\] standoff is missing: distance from"),
        (SMALL.replace("half_angle_deg = 35.0", ""), r"\(or half_angle_deg\) is missing"),
        (SMALL.replace("[camera]", "half_angle = 0.6\n[camera]"), "unknown key 'half_angle'"),
        (
            SMALL.replace("\nx = 0.2", "\nhalf_angle = 0.6"),
            r"\[camera\] half_angle is given twice, in radians and degrees",
        ),
        (changed("limits", 'v_max = "fast"'), r"\[limits\] v_max must be a number, got 'fast'"),
        (changed("limits", "v_max = true"), "v_max must be a number, got True"),
        (changed("limits", "v_max = 1" + "0" * 400), "v_max is too large for a number"),
        (changed("limits", "v_max = -1"), r"\[limits\] v_max must be finite and positive, got -1"),
        (changed("limits", "v_max = nan"), r"\[limits\] v_max must be finite and positive"),
        (changed("camera", "half_angle = 35"), r"\[camera\] half_angle must be in \(0, pi/2\) rad"),
        (changed("filter", 'backend = "magic"'), r"\[filter\].*magic"),
        (changed("filter", "backend = 1"), r"\[filter\] backend must be a string, got 1"),
        (changed("filter", "weight = [1, 0]"), r"weight must be a list of 3 numbers, got \[1, 0\]"),
        (changed("filter", "weight = [1, 5, 1]"), r"\[filter\].*weight"),
        (changed("filter", "guard_lag = 0.1"), "guard_lag must cover lag"),
        (changed("docking", "attempts = 2.0"), r"\[docking\] attempts must be an integer, got 2.0"),
        (changed("docking", "attempts = true"), r"attempts must be an integer, got True"),
        (changed("gains", "k2 = 0"), r"\[gains\] k2"),
        (changed("noise", "sigma_xy = 0"), r"\[noise\] sigma_xy must be finite and positive"),
        (changed("loop", 'overrun = "go"'), "must be one of 'brake', 'send', 'stop', got 'go'"),
        (changed("loop", "misses = 0"), r"\[loop\] misses must be an integer >= 1, got 0"),
        (changed("wheels", "track = 0.4"), r"\[wheels\] radius is missing: of the wheels \[m\]"),
        ("limits = 3", r"limits must be a table, \[limits\], got 3"),
        ("[limits", "not TOML: "),
        ("a = " + "[" * 5000, "not TOML"),
        ("a = " + "9" * 5000, "not TOML"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told(text, told):
    with pytest.raises(ConfigurationError, match=told):
        parse_config(text)


def test_file_is_named(tmp_path):
    path = tmp_path / "robot.toml"
    with pytest.raises(ConfigurationError, match=r"cannot read '.*robot.toml': No such file"):
        read_config(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigurationError, match=r"cannot read '.*robot.toml': .*utf-8"):
        read_config(path)
    path.write_text(changed("limits", "v_max = 0"))
    with pytest.raises(ConfigurationError, match=r"robot.toml: \[limits\] v_max must be"):
        read_config(path)
    path.write_text(SMALL)
    assert read_config(path) == parse_config(SMALL)
    with pytest.raises(ConfigurationError, match="cannot read"):
        read_config("nul\0character")


# Writing ----------------------------------------------------------------------------------------

positive = st.floats(1e-3, 1e3)


@st.composite
def configs(draw):
    limits = draw(any_limits)
    camera = FieldOfView(
        draw(st.floats(0.2, 1.5)),
        Pose2(draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0)), draw(st.floats(-3.0, 3.0))),
        draw(st.floats(0.0, 2.0)),
    )
    options = {
        "period": draw(st.floats(1e-3, 0.5)),
        "lag": draw(st.floats(0.0, 0.2)),
        "guard_lag": draw(st.floats(0.2, 1.0)),
        "backend": draw(st.sampled_from(["exact", "daqp"])),
        "weight": (draw(positive), 0.0, draw(positive)),
    }
    docking = {"standoff": draw(positive), "attempts": draw(st.integers(1, 99))}
    if draw(st.booleans()):
        docking["patience"] = draw(positive)
    wheels = st.builds(
        WheelLimits, positive, positive, positive, st.one_of(positive, st.just(math.inf))
    )
    return Config.of(
        limits,
        camera,
        docking,
        options,
        gains=FollowingGains(k2=draw(positive), done_theta=draw(st.floats(1e-4, 0.1))),
        noise=defaults.NOISE._replace(sigma_xy=draw(positive), rejections=draw(st.integers(1, 9))),
        loop=LoopPolicy(draw(st.sampled_from(Overrun)), draw(st.integers(1, 99)), draw(positive)),
        wheels=draw(st.one_of(st.none(), wheels)),
    )


@given(config=configs())
def test_round_trip_is_exact(config):
    written = to_toml(config)
    assert parse_config(written) == config
    assert to_toml(parse_config(written)) == written


def test_template_is_a_configuration_with_nothing_to_remark():
    config = parse_config(template())
    assert findings(config) == ()
    assert config.filter.period == 1.0 / 30.0
    controller = config.controller()
    assert controller.config.standoff == 0.6


def test_template_with_every_default_in_force_says_the_same():
    """Every commented-out value is the default, and is accepted as it stands."""
    text = re.sub(r"^# (\w+ = |\[)", r"\1", template(), flags=re.MULTILINE)
    config = parse_config(text)
    assert replace(config, wheels=None, docking={"standoff": 0.6}) == parse_config(template())
    assert config.wheels is not None
    assert findings(config) == ()
    made = config.controller().config
    plain = parse_config(template()).controller().config
    for field in fields(DockingConfig):
        if field.init:
            assert getattr(made, field.name) == getattr(plain, field.name)


def test_every_key_is_explained_and_every_field_is_a_key():
    for section in SECTIONS:
        for key in section.keys:
            assert len(key.about) > 8, (section.name, key.name)
            assert "\\" not in key.about
    named = {key.name for section in SECTIONS for key in section.keys}
    assert {f.name for f in fields(Limits) if f.init} <= named
    assert {f.name for f in fields(WheelLimits)} <= named
    assert {f.name for f in fields(LoopPolicy)} <= named
    assert {f.name for f in fields(FollowingGains)} <= named
    missing = {key.name for s in SECTIONS for key in s.keys if key.default is REQUIRED}
    assert missing >= {"v_max", "half_angle", "period", "standoff", "track"}


# Findings ---------------------------------------------------------------------------------------


def test_nothing_to_remark_on_the_small_file():
    assert findings(parse_config(SMALL)) == ()


@pytest.mark.parametrize(
    ("text", "severity", "key", "told"),
    [
        (changed("limits", "omega_max = 20"), "risky", "limits.omega_max", "in degrees?"),
        (changed("limits", "v_max = 220"), "risky", "limits.v_max", "in another unit?"),
        (changed("filter", "period = 0.2"), "risky", "filter.period", "by up to 0.06 m/s"),
        (changed("filter", "period = 0.12"), "risky", "filter.period", "by up to 0.12 rad/s"),
        (changed("filter", "period = 0.001"), "risky", "filter.period", "busy thread"),
        (changed("camera", "width = 0.65"), "wrong", "camera.half_angle", "cannot see"),
        (changed("camera", "width = 0.445"), "risky", "camera.half_angle", "to spare"),
        (changed("docking", "standoff = 0.1"), "wrong", "docking.standoff", "behind the camera"),
        (changed("filter", "guard_lag = 0.13"), "risky", "filter.guard_lag", "less than a period"),
        (changed("filter", "lag = 0"), "risky", "filter.lag", "identify it"),
        (changed("limits", "a_max = 0.05"), "risky", "limits.v_max", "0.55 m to stop"),
        (changed("limits", "alpha_max = 0.1"), "risky", "limits.omega_max", "more than the half"),
        (changed("limits", "v_min = 0"), "risky", "limits.v_min", "forbids reverse"),
        (changed("limits", "v_max = 0.31"), "risky", "docking.patience", "0.62 m driven unseen"),
        (changed("loop", "max_age = 2.5"), "risky", "loop.max_age", "patience of 2 s"),
        (changed("loop", "misses = 26"), "risky", "loop.misses", "1.04 s in which no command"),
        (
            SMALL + "[wheels]\ntrack = 0.4\nradius = 0.1\nspeed = 0.25\n",
            "wrong", "wheels.speed", "ask 0.290 m/s of a wheel that does 0.25",
        ),
        (
            SMALL + "[wheels]\ntrack = 0.4\nradius = 0.1\nspeed = 0.3\nacceleration = 0.4\n",
            "wrong", "wheels.acceleration", "ask 0.500 m/s² of a wheel that does 0.4",
        ),
    ],
)  # fmt: skip
def test_findings(text, severity, key, told):
    found = findings(parse_config(text))
    (matching,) = [f for f in found if f.key == key and told in f.text]
    assert matching.severity is Severity(severity)
    assert str(matching).startswith(f"{severity}: {key}: ")
    order = [finding.severity for finding in found]
    assert order == sorted(order, key=lambda s: s is Severity.RISKY)


def test_lag_beyond_the_guard_is_found_where_the_filter_let_it_pass():
    config = parse_config(SMALL)
    object.__setattr__(config.filter, "guard_lag", 0.05)
    assert Severity.WRONG in {f.severity for f in findings(config) if f.key == "filter.guard_lag"}


@given(half_angle=st.floats(0.15, 1.4), width=st.floats(0.0, 2.0), standoff=st.floats(0.3, 2.0))
def test_view_of_the_goal_is_told_by_plain_trigonometry(half_angle, width, standoff):
    text = changed("camera", f"half_angle = {half_angle}\nwidth = {width}")
    config = parse_config(changed("docking", f"standoff = {standoff}", text))
    depth = standoff - 0.2 - defaults.VIEW_SETBACK / math.sin(half_angle - defaults.VIEW_MARGIN)
    edge = math.atan2(0.5 * width, depth)
    spare = half_angle - defaults.VIEW_MARGIN - edge
    wrong = [f for f in findings(config) if f.severity is Severity.WRONG]
    if abs(spare) > 1e-6:
        assert bool(wrong) == (spare < 0.0)


# Mutated files ----------------------------------------------------------------------------------

TEMPLATE = template()
FULL = re.sub(r"^# (\w+ = |\[)", r"\1", TEMPLATE, flags=re.MULTILINE)
CODES = [*range(32, 127), 0, 9, 13, 0x7F, 0x85, 0xE9, 0x2028, 0xD800, 0x1F600]
ODD = [
    "", "nan", "inf", "-inf", "0", "-0.0", "1e308", "1e-308", "1e999", "-1", "1_000", "0x1f",
    "true",
    '"x"', "'exact'", '"daqp"', "[]", "[1, 2, 3]", "[nan, 0, 1]", "{}", "{ a = 1 }", "1979-05-27",
    "07:32:00", '"""', "[[", "9" * 30, "9" * 5000, '"\\u0000"', '"\\ud800"', "5e-324",
]  # fmt: skip


def mutated(seed: int) -> str:
    """The template, or the small file, with a few things done to it."""
    rng = random.Random(seed)
    lines = rng.choice([FULL, SMALL, TEMPLATE]).splitlines()
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(lines))
        line = lines[at]
        kind = rng.choice(["value", "number", "drop", "double", "swap", "name", "text"])
        odd = "".join(chr(rng.choice(CODES)) for _ in range(rng.randint(1, 4)))
        if kind == "value" and "=" in line:
            lines[at] = f"{line.split('=')[0]}= {rng.choice(ODD)}"
        elif kind == "number" and "=" in line:
            number = struct.unpack("d", rng.randbytes(8))[0]  # of every size, NaNs among them
            lines[at] = f"{line.split('=')[0]}= {number!r}"
        elif kind == "drop" and len(lines) > 1:
            del lines[at]
        elif kind == "double":
            lines.insert(at, line)
        elif kind == "swap":
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], line
        elif kind == "name" and "=" in line:
            lines[at] = odd + line
        elif kind == "text":
            place = rng.randint(0, len(line))
            lines[at] = line[:place] + odd + line[place:]
    return "\n".join(lines)


def accepted(text: str) -> Config | None:
    """The configuration; None where it was refused as it should be, with words."""
    try:
        return parse_config(text)
    except ConfigurationError as error:
        if not str(error):
            raise AssertionError("refused without a word") from error
        return None


seeds = st.integers(0, 2**63)


@settings(max_examples=2000, database=None)
@given(seed=seeds)
def test_mutated_files_meet_one_error_only(seed):
    config = accepted(mutated(seed))
    if config is None:
        return
    for finding in findings(config):
        assert finding.text
    if seed % 4 == 0:
        assert parse_config(to_toml(config)) == config


def test_a_good_part_of_the_mutated_files_is_taken():
    """So that what comes after reading is tried as well."""
    taken = sum(accepted(mutated(seed)) is not None for seed in range(100))
    assert 10 < taken < 90


@settings(max_examples=60, database=None)
@given(seed=seeds)
def test_mutated_files_that_are_taken_build_or_say_why(seed):
    config = accepted(mutated(seed))
    if config is not None and all(f.severity is not Severity.WRONG for f in findings(config)):
        with contextlib.suppress(ConfigurationError):
            config.controller()


# The command ------------------------------------------------------------------------------------

needs_tyro = pytest.mark.skipif(
    importlib.util.find_spec("tyro") is None, reason="the command line needs the extra cli"
)


@needs_tyro
def test_template_then_check(tmp_path, capsys):
    assert cli.main(["check", "--template"]) == 0
    path = tmp_path / "robot.toml"
    path.write_text(capsys.readouterr().out)
    assert cli.main(["check", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: 0 wrong, 0 risky\n"


@needs_tyro
def test_what_is_found_is_printed(tmp_path, capsys):
    path = tmp_path / "robot.toml"
    path.write_text(changed("camera", "width = 0.65", changed("filter", "lag = 0")))
    assert cli.main(["check", str(path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("wrong: camera.half_angle: ")
    assert lines[1].startswith("risky: filter.lag: ")
    assert lines[-1] == f"{path}: 1 wrong, 1 risky"
    path.write_text(changed("filter", "lag = 0"))
    assert cli.main(["check", str(path)]) == 0


@needs_tyro
@pytest.mark.parametrize(
    ("argv", "told"),
    [
        ([], "or --template for a new one"),
        (["no-such.toml"], "cannot read 'no-such.toml': No such file"),
    ],
)
def test_command_refuses(argv, told, capsys):
    assert cli.main(["check", *argv]) == 2
    assert told in capsys.readouterr().err


@needs_tyro
def test_what_only_the_controller_refuses_is_told_with_the_file(tmp_path, capsys):
    path = tmp_path / "robot.toml"
    path.write_text(changed("docking", "fraction = 2"))
    assert cli.main(["check", str(path)]) == 2
    assert "robot.toml: fraction must be in (0, 1], got 2.0" in capsys.readouterr().err


# What would take minutes ------------------------------------------------------------------------


@pytest.mark.parametrize("period", ["1e-9", "0.00099"])
def test_a_period_no_plan_can_be_made_with_is_refused(period):
    with pytest.raises(ConfigurationError, match=r"period must be at least 0\.001 s"):
        parse_config(changed("filter", f"period = {period}"))


@pytest.mark.parametrize("line", ["v_max = 1e12", "v_max = 1e-6", "a_max = 1e-9"])
def test_limits_no_plan_can_be_made_with_are_refused_by_the_controller(line):
    """At once: not after a table of a petabyte, or of hours of driving."""
    config = parse_config(changed("limits", line))
    with pytest.raises(ConfigurationError, match=line.split(" ", maxsplit=1)[0]):
        config.controller()


@pytest.mark.parametrize(
    ("section", "line", "told"),
    [
        ("docking", "standoff = nan", "[docking] standoff must be finite, got nan"),
        ("loop", f"misses = {10**400}", "[loop] misses is too large for a number"),
        ("loop", "window = 1000000000", "[loop] window must be at most 10000000"),
        ("docking", "patience = inf", "[docking] patience must be finite, got inf"),
        ("filter", "period = 0.0", "[filter] period must be finite and positive [s], got 0.0"),
        ("limits", "alpha_max = 5e-324", "[limits] alpha_max must be at least 1e-09, got 5e-324"),
    ],
)
def test_what_is_computed_with_is_refused_by_its_own_name(section, line, told):
    with pytest.raises(ConfigurationError, match=re.escape(told)):
        parse_config(changed(section, line))
