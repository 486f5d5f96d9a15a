"""One trial: the tests of a module in a child process, with another text in the module's place.

The child is forked from a parent that has the libraries loaded, so a trial costs its tests and no
start of an interpreter; the other text is planted on import, so no file is written and no trial
can see another's. Time is that of the processor: a busy machine is no reason to call a mutant slow.
"""

from __future__ import annotations

import builtins
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from benchmarks.mutation.mutants import PROBE
from clfcbf.errors import MissingExtraError

__all__ = ["Outcome", "Task", "copied", "run", "signless"]

MEMORY = 4 << 30
"""[bytes] A trial may address: a mutant that builds ever longer fractions ends there."""

PATIENCE = 10.0
"""Wall clock over processor time after which a trial is ended: it waits for something."""

_NUMBERS = (int, float)
_OURS = ("clfcbf", "tests", "benchmarks")


class Task(NamedTuple):
    """A trial to be run: ``text`` in place of ``module``, under ``tests``.

    ``limit`` is the processor time it may take [s].
    """

    module: str
    text: str
    tests: Sequence[str]
    limit: int


class Outcome(NamedTuple):
    """How it ended.

    Attributes
    ----------
    status : "killed", "timeout" or "survived"
    by : the test that failed first, or the error that kept the tests from running
    seconds : processor time
    """

    status: str
    by: str
    seconds: float


def copied(root: Path, into: Path) -> Path:
    """A copy of the tree's code and tests, so that nobody who edits them meets a mutant."""
    for name in ("clfcbf", "tests"):
        shutil.copytree(root / name, into / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "pyproject.toml", into)
    return into


def preload() -> None:
    """Load what every trial needs.

    Raises
    ------
    MissingExtraError : pytest or Hypothesis is not installed
    """
    try:
        import _pytest.assertion.rewrite  # noqa: F401
        import hypothesis.strategies  # noqa: F401
        import numpy  # noqa: F401
        import pytest  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(error.name or "pytest", "test") from error


def run(tree: Path, tasks: Iterable[Task], workers: int) -> Iterator[tuple[int, Outcome]]:
    """Run the tasks, ``workers`` at a time; the number of each and its outcome, as they end."""
    preload()
    waiting = enumerate(tasks)
    running: dict[int, tuple[int, Task, float, Path]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        try:
            while True:
                while len(running) < workers and (following := next(waiting, None)) is not None:
                    number, task = following
                    output = Path(scratch) / str(number)
                    pid = _start(tree, task, output)
                    running[pid] = number, task, time.monotonic(), output
                if not running:
                    return
                for pid, outcome in _ended(running):
                    yield running.pop(pid)[0], outcome
                time.sleep(0.005)
        finally:
            for pid in running:
                with suppress(ProcessLookupError, ChildProcessError):
                    os.kill(pid, signal.SIGKILL)
                    os.waitpid(pid, 0)


def _ended(
    running: dict[int, tuple[int, Task, float, Path]],
) -> list[tuple[int, Outcome]]:
    ended = []
    for pid, (_, task, since, output) in running.items():
        found, status, usage = os.wait4(pid, os.WNOHANG)
        if not found:
            if time.monotonic() - since > PATIENCE * task.limit:
                os.kill(pid, signal.SIGKILL)
            continue
        code = os.waitstatus_to_exitcode(status)
        text = output.read_text(errors="replace")
        output.unlink()
        seconds = usage.ru_utime + usage.ru_stime
        if code in (-signal.SIGTERM, -signal.SIGINT):
            raise KeyboardInterrupt  # the trial was ended from outside: no outcome
        if code == 0:
            outcome = Outcome("survived", "", seconds)
        elif code in (-signal.SIGXCPU, -signal.SIGKILL):
            outcome = Outcome("timeout", "", seconds)
        else:
            outcome = Outcome("killed", _culprit(text, code), seconds)
        ended.append((pid, outcome))
    return ended


def _culprit(text: str, code: int) -> str:
    for line in reversed(text.splitlines()):
        if line.startswith(("FAILED ", "ERROR ")):
            return line[:200]
    return f"exit status {code}: " + "".join(text.splitlines()[-1:])[:200]


def _start(tree: Path, task: Task, output: Path) -> int:
    """Fork the trial and return the child's process id."""
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        _confine(output, task.limit)
        _enter(tree)
        code = _tested(tree, task)
    except BaseException as error:  # the child must not return into the parent's code
        print(f"ERROR {error!r}", flush=True)
    finally:
        sys.stdout.flush()
        os._exit(code)


def _confine(output: Path, limit: int) -> None:
    descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    sys.stdout = sys.stderr = os.fdopen(1, "w", buffering=1, closefd=False)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)  # the parent's handlers are not for its children
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _enter(tree: Path) -> None:
    for name in list(sys.modules):
        if name.partition(".")[0] in _OURS:
            del sys.modules[name]
    os.chdir(tree)
    sys.path[:] = [str(tree), *(p for p in sys.path if p not in ("", os.getcwd()))]


def _tested(tree: Path, task: Task) -> int:
    import pytest

    sys.meta_path.insert(0, _Planted(task.module, tree / task.module, task.text))
    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # of what is preloaded
    arguments = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=no", "-rfE", *quiet]
    return int(pytest.main([*arguments, *task.tests], plugins=[_Quick()]))


class _Quick:
    """Properties that draw the same examples every time and do not shrink what fails."""

    def pytest_collection(self) -> None:  # behind the conftest's profile, before any test's own
        from hypothesis import Phase, settings

        settings.register_profile(
            "mutation",
            derandomize=True,
            database=None,
            deadline=None,
            phases=(Phase.explicit, Phase.generate, Phase.target),
            report_multiple_bugs=False,
        )
        settings.load_profile("mutation")


class _Planted(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, with a text other than its file's."""

    def __init__(self, module: str, path: Path, text: str) -> None:
        self.name = module.removesuffix(".py").replace("/", ".")
        self.path, self.text = str(path), text

    def find_spec(
        self, fullname: str, path: Any = None, target: Any = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(self.text, self.path, "exec"), module.__dict__)


def signless(tree: Path, task: Task) -> set[int]:
    """Places of a minus whose values have no sign: poses, verdicts, truth values.

    Runs the tests once with the probed text.
    """
    preload()
    with tempfile.TemporaryDirectory() as scratch:
        output, seen = Path(scratch) / "output", Path(scratch) / "seen"
        pid = os.fork()
        if not pid:
            code = 70
            try:
                _confine(output, task.limit)
                _enter(tree)
                code = _probing(tree, task, seen)
            except BaseException as error:
                print(f"ERROR {error!r}", flush=True)
            finally:
                sys.stdout.flush()
                os._exit(code)
        _, status = os.waitpid(pid, 0)
        if status:
            raise RuntimeError(
                f"the tests of {task.module} fail before any mutation:\n{output.read_text()}"
            )
        return set(json.loads(seen.read_text()))


def _probing(tree: Path, task: Task, seen: Path) -> int:
    from fractions import Fraction

    numbers = (*_NUMBERS, Fraction)
    found: set[int] = set()

    def probe(place: int, value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, numbers):
            found.add(place)
        return value

    setattr(builtins, PROBE, probe)
    code = _tested(tree, task)
    seen.write_text(json.dumps(sorted(found)))
    return code
