"""The mutation benchmark: which mutants there are, what they are called, what is remembered."""

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray")

from benchmarks.mutation.ledger import Tally, digest, entry, equivalents, remembered, tally
from benchmarks.mutation.mutants import PROBE, Key, mutants, probed
from benchmarks.mutation.targets import SHARED, TARGETS
from benchmarks.mutation.trial import Outcome, Task, copied, run, signless
from clfcbf.errors import ConfigurationError

ROOT = Path(__file__).parents[1]

TEXT = '''\
"""A module - with signs + in its docstring."""
import math

STEP = 0.5
NOTHING = 0.0


def clipped(x: float, limit: float = 2.0) -> bool:
    low, high = -limit, limit
    if x < low or x > high:
        raise ValueError(f"{x - 1} is out")
    return abs(x) - 1.0 <= math.cos(x) * max(x, STEP)
'''


def changes(text):
    return {(each.key.line, each.key.mutant) for each in mutants("m.py", text)}


@pytest.mark.parametrize(
    ("line", "mutant"),
    [
        ("STEP = 0.5", "STEP = -0.5"),
        ("low, high = -limit, limit", "low, high = limit, limit"),
        ("low, high = -limit, limit", "low, high = -limit, -limit"),
        ("if x < low or x > high:", "if x <= low or x > high:"),
        ("if x < low or x > high:", "if x > low or x > high:"),
        ("if x < low or x > high:", "if x < low or x < high:"),
        ("if x < low or x > high:", "if -x < low or x > high:"),
    ],
)
def test_signs_comparisons_and_constants_are_flipped(line, mutant):
    assert (line, mutant) in changes(TEXT)


def test_extrema_absolute_values_and_truths_are_flipped():
    line = "return abs(x) - 1.0 <= math.cos(x) * max(x, STEP)"
    made = {mutant for before, mutant in changes(TEXT) if before == line}
    assert made >= {
        "return (x) - 1.0 <= math.cos(x) * max(x, STEP)",
        "return abs(x) + 1.0 <= math.cos(x) * max(x, STEP)",
        "return -abs(x) - 1.0 <= math.cos(x) * max(x, STEP)",
        "return abs(x) - 1.0 <= -math.cos(x) * max(x, STEP)",
        "return abs(x) - 1.0 <= math.cos(x) * min(x, STEP)",
        "return not (abs(x) - 1.0 <= math.cos(x) * max(x, STEP))",
    }
    assert "return abs(-x) - 1.0 <= math.cos(x) * max(x, STEP)" not in made
    assert "return abs(x) - 1.0 <= math.cos(-x) * max(x, STEP)" not in made


def test_what_says_nothing_is_left_alone():
    untouched = ("NOTHING", "import", '"""', "raise")
    assert not [line for line, _ in changes(TEXT) if line.startswith(untouched)]
    assert not changes("x = a[1] == 0\n") - {("x = a[1] == 0", "x = a[1] != 0")}


def test_augmented_signs_and_nots():
    assert changes("x -= y\n") >= {("x -= y", "x += y"), ("x -= y", "x -= -y")}
    assert ("x = not y", "x =  y") in changes("x = not y\n")


def test_every_mutant_is_another_program_and_compiles():
    for each in mutants("m.py", TEXT):
        compile(each.text, "m.py", "exec")
        assert each.text != TEXT
        assert each.text.splitlines()[each.number - 1].strip() == each.key.mutant


def test_names_outlive_line_numbers():
    before = {each.key for each in mutants("m.py", TEXT)}
    later = {each.key for each in mutants("m.py", "\n\n" + TEXT)}
    assert before == later
    assert {key.scope for key in before} == {"", "clipped"}
    twice = "def f(x):\n    y = x + 1\n    y = x + 1\n    return y\n"
    keys = [each.key for each in mutants("m.py", twice)]
    assert len(set(keys)) == len(keys)
    assert {key.copy for key in keys} == {0, 1}


def test_the_probe_is_shown_every_value_and_changes_none():
    seen = {}

    def probe(place, value):
        seen[place] = value
        return value

    namespace = {PROBE: probe}
    exec(compile(probed(TEXT), "m.py", "exec"), namespace)
    assert namespace["clipped"](1.5) is (math.cos(1.5) * 1.5 >= 0.5)
    assert {0.5, 2.0, 1.5} <= set(seen.values())
    places = {place for place, value in seen.items() if value == 0.5}
    assert len(list(mutants("m.py", TEXT, places))) < len(list(mutants("m.py", TEXT)))


def test_scores_leave_out_the_equivalent():
    outcomes = ("killed", "killed", "timeout", "equivalent", "survived")
    count = tally({"status": status} for status in outcomes)
    assert count == Tally(5, 2, 1, 1, 1)
    assert count.score == 0.75


def test_what_is_remembered_depends_on_what_has_changed():
    made = list(mutants("m.py", TEXT))[:2]
    known = {
        "text": digest([TEXT]),
        "tests": digest(["one"]),
        "mutants": [
            entry(each, Outcome(status, "", 0.1))
            for each, status in zip(made, ("killed", "survived"), strict=True)
        ],
    }
    killed, survived = (each.key for each in made)
    assert set(remembered(known, digest([TEXT]), digest(["one"]))) == {killed, survived}
    assert set(remembered(known, digest([TEXT]), digest(["two"]))) == {killed}
    assert not remembered(known, digest([TEXT + "\n"]), digest(["one"]))
    assert not remembered({}, digest([TEXT]), digest(["one"]))


def test_equivalents_are_of_the_modules_as_they_are():
    """Their lines are there; the benchmark itself says which are no longer mutants."""
    for key in equivalents():
        lines = [line.strip() for line in (ROOT / key.module).read_text().splitlines()]
        assert lines.count(key.line) > key.copy, f"no longer a line: {key}"
        assert key.mutant != key.line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('[[equivalent]]\nmodule="m"\nscope=""\nmutants=[["a","b"]]\n', "reason"),
        ('[[equivalent]]\nmodule="m"\nscope=""\nreason="r"\nmutants=[["a"]]\n', "becomes"),
        ('[[equivalent]]\nmodule="m"\nscope=""\nreason="r"\nmutants=[["a","b"],["a","b"]]\n',
         "twice"),
    ],
)  # fmt: skip
def test_bad_lists_of_equivalents(tmp_path, content, message):
    path = tmp_path / "equivalents.toml"
    path.write_text(content)
    with pytest.raises(ConfigurationError, match=message):
        equivalents(path)


def test_targets_and_their_tests_exist():
    for name in (*TARGETS, *SHARED, *(test for tests in TARGETS.values() for test in tests)):
        assert (ROOT / name).is_file()
    assert str(Key("m.py", "f", "a", "b", 1)) == "m.py:f #1\n  - a\n  + b"


@pytest.mark.skipif(sys.platform == "win32" or not hasattr(os, "fork"), reason="trials are forked")
def test_trials_tell_a_noticed_mutant_from_one_that_is_not(tmp_path):
    if "jax" in sys.modules:  # it warns of every fork, in whichever process has it loaded
        name = f"{__file__}::test_trials_tell_a_noticed_mutant_from_one_that_is_not"
        command = (sys.executable, "-m", "pytest", "-n", "0", "-q", "-p", "no:cacheprovider", name)
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        return
    tree = copied(ROOT, tmp_path)
    module, tests = "clfcbf/wave.py", ("tests/test_wave.py",)
    text = "def wave(x):\n    while x > 9.0:\n        x -= 9.0\n    return x + 1.0\n"
    (tree / module).write_text(text)
    (tree / tests[0]).write_text(
        "from clfcbf.wave import wave\n\n\ndef test_wave():\n    assert wave(10.0) == 2.0\n"
    )
    texts = (
        text,
        text.replace("x + 1.0", "x - 1.0"),
        text.replace("x -= 9.0", "x += 9.0"),
    )
    outcomes = dict(run(tree, [Task(module, each, tests, 2) for each in texts], 2))
    assert [outcomes[i].status for i in range(3)] == ["survived", "killed", "timeout"]
    assert "test_wave" in outcomes[1].by
    assert signless(tree, Task(module, probed(text), tests, 20)) == set()
    assert "clfcbf.wave" not in sys.modules
