r"""Fair tuning: every method gets the same number of trials on the same starts.

Tree-structured Parzen estimation (Bergstra et al., NeurIPS 2011) by Optuna, over each method's
own ``space``. The objective is lexicographic: success by the paper's criterion, then by the strict
one, then time,

.. math:: J = n_{fail} + \frac{n_{not strict} + \bar t / t_{max}}{n + 1},
          \qquad \bar t / t_{max} < 1,

over n runs, in which a failed one counts the whole patience. The stock parameters are the first
trial. The starts are of a seed of their own, so that no campaign tests on them.

python -m benchmarks.tuning --methods park-kuipers,aicardi --trials 200 --storage tuning.log
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.baselines import METHODS, Method, Setup, method_named
from clfcbf import defaults
from clfcbf.errors import ClfcbfError, ConfigurationError, MissingExtraError
from clfcbf.limits import Limits
from clfcbf.report import check_writable, versions, write_json
from clfcbf.simulation.campaign import EpisodeSpec, simulate
from clfcbf.simulation.episode import EpisodeController
from clfcbf.simulation.scenarios import World

__all__ = ["Outcome", "Plan", "evaluate", "main", "read_tuned", "tune", "tuned_parameters"]

TUNED = Path(__file__).parent / "tuned"
"""Where the results are, one JSON file a method."""

SEED = 1_953_853_029
"""Of the starts and of the search: no campaign counts up to it."""

TRIALS = 200
"""Of each method: 20 for each of the 10 parameters that the widest space has."""

STARTS = 40
"""Runs of a trial: a success rate to within 16 %, and 5 % to be told from 0 in most trials."""

REGIONS = ("R1", "R3", "R4")
"""Where the runs start, in turn: the paper's region and the two closer ones."""

USAGE_ERROR, INTERRUPTED = 2, 130

Run = tuple[bool, bool, float]
"""Of one run: success, strict success, and time [s]."""

Mapper = Callable[[Callable[[EpisodeSpec], Run], Iterable[EpisodeSpec]], Iterable[Run]]


class Plan(NamedTuple):
    """What is the same for every method.

    ``trials`` of each, over ``starts`` runs from the ``regions`` in turn, all of ``seed``.
    """

    trials: int = TRIALS
    starts: int = STARTS
    regions: tuple[str, ...] = REGIONS
    sensor: str = "A"
    seed: int = SEED

    @property
    def specs(self) -> list[EpisodeSpec]:
        """The runs of a trial."""
        return [
            EpisodeSpec(self.regions[i % len(self.regions)], self.seed, i, sensor=self.sensor)
            for i in range(self.starts)
        ]


class Outcome(NamedTuple):
    """What one set of parameters comes to: counts, mean time [s] with failures as the patience."""

    runs: int
    success: int
    strict: int
    time_s: float
    objective: float

    @classmethod
    def of(cls, runs: Sequence[Run], longest: float) -> Outcome:
        """From single runs, none of them longer than ``longest`` [s]."""
        n = len(runs)
        success, strict = sum(run[0] for run in runs), sum(run[1] for run in runs)
        time = sum(min(t, longest) if ok else longest for ok, _, t in runs) / n
        # A second more than can be: the share of the time has to stay below 1.
        objective = n - success + (n - strict + time / (longest + 1.0)) / (n + 1)
        return cls(n, success, strict, time, objective)


def evaluate(method: Method[Any], parameters: object, plan: Plan, mapper: Mapper = map) -> Outcome:
    """The method with those parameters on the plan's starts."""
    runs = list(mapper(partial(_run, method.name, parameters), plan.specs))
    world = World()
    return Outcome.of(runs, world.patience + world.wait)


def _run(name: str, parameters: object, spec: EpisodeSpec) -> Run:
    method = method_named(name)

    def make(world: World, limits: Limits, lag: float) -> EpisodeController:
        return method.controller(Setup.of(world, limits, lag), parameters)

    result, _ = simulate(spec, make=make)
    return result.success, result.strict, result.time_s


def tune(
    method: Method[Any],
    plan: Plan,
    storage: Path | None = None,
    mapper: Mapper = map,
    progress: Callable[[int, float], None] = lambda trials, best: None,
) -> dict[str, Any]:
    """Search the method's space; what goes into its JSON file.

    Parameters
    ----------
    method, plan : what is tuned, and with what budget
    storage : Optuna's journal, which a later call goes on from; None keeps nothing
    mapper : runs the starts of a trial, ``map`` or that of a pool
    progress : told the number of trials made and the best objective

    Raises
    ------
    MissingExtraError : Optuna is not installed
    ConfigurationError : the method has no space, or the storage is of another plan
    """
    optuna = _optuna()
    if not method.space:
        raise ConfigurationError(f"{method.name} has nothing to tune: its space is empty")
    study = _study(optuna, method, plan, storage)

    def objective(trial: Any) -> float:
        values = {
            name: trial.suggest_float(name, low, high, log=log)
            for name, (low, high, log) in method.space.items()
        }
        try:
            outcome = evaluate(method, method.parameters(values), plan, mapper)
        except ConfigurationError as error:  # values that do not go together
            trial.set_user_attr("refused", str(error))
            return plan.starts + 1.0
        trial.set_user_attr("outcome", outcome._asdict())
        return outcome.objective

    def told(study: Any, trial: Any) -> None:
        progress(trial.number + 1, study.best_value)

    study.optimize(objective, n_trials=plan.trials - _made(study), callbacks=[told])
    stock = asdict(method.stock)
    return {
        "method": method.name,
        "parameters": dict(study.best_params),
        "tuned": study.best_trial.user_attrs.get("outcome"),
        "stock_parameters": {name: stock[name] for name in method.space},
        "stock": evaluate(method, method.stock, plan, mapper)._asdict(),
        "best_trial": study.best_trial.number,
        "trials": _made(study),
        "plan": plan._asdict(),
        "space": {name: range_._asdict() for name, range_ in method.space.items()},
        "config_hash": defaults.fingerprint(),
        "versions": {**versions(), "optuna": optuna.__version__},
    }


def _optuna() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise MissingExtraError("optuna", "bench") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def _study(optuna: Any, method: Method[Any], plan: Plan, storage: Path | None) -> Any:
    journal = None
    if storage is not None:
        check_writable(storage)
        backend = optuna.storages.journal.JournalFileBackend(str(storage))
        journal = optuna.storages.JournalStorage(backend)
    study = optuna.create_study(
        storage=journal, study_name=method.name, load_if_exists=True, direction="minimize"
    )
    # The number of trials may grow from one call to the next, nothing else may change.
    mine = {
        **plan._replace(trials=0)._asdict(),
        "regions": list(plan.regions),
        "space": {name: list(range_) for name, range_ in method.space.items()},
        "config_hash": defaults.fingerprint(),
    }
    before = study.user_attrs.get("plan", mine)
    if before != mine:
        changed = [name for name in mine if before.get(name) != mine[name]]
        raise ConfigurationError(
            f"cannot resume {method.name} from {str(storage)!r}: other {', '.join(changed)}"
        )
    study.set_user_attr("plan", mine)
    # Seeded by where it stands, or a resumed search would draw its first trials again.
    study.sampler = optuna.samplers.TPESampler(seed=(plan.seed + _made(study)) % 2**32)
    stock = asdict(method.stock)
    values = {name: stock[name] for name in method.space}
    if not study.trials and all(
        low <= values[name] <= high for name, (low, high, _) in method.space.items()
    ):
        study.enqueue_trial(values)
    return study


def _made(study: Any) -> int:
    """Trials with an objective; one that was broken off has none."""
    return sum(trial.value is not None for trial in study.trials)


def read_tuned(name: str, folder: Path = TUNED) -> dict[str, Any]:
    """The result of tuning a method; ``ConfigurationError`` where there is none."""
    path = folder / f"{method_named(name).name}.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        values = {key: float(value) for key, value in found["parameters"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"{str(path)!r} holds no tuned parameters: {error}") from error
    return {**found, "parameters": values}


def tuned_parameters(name: str, folder: Path = TUNED) -> Any:
    """The method's parameters as tuned."""
    return method_named(name).parameters(read_tuned(name, folder)["parameters"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune the methods one after the other; 0 once each has had its trials."""
    options = _parser().parse_args(arguments)
    try:
        return _tune_all(options)
    except ClfcbfError as error:
        print(f"tuning: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("tuning: interrupted; the same --storage goes on from there", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks.tuning", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("--methods", default=",".join(METHODS), metavar="NAMES", help="separated by commas")
    add("--trials", type=int, default=TRIALS, help="of each method")
    add("--starts", type=int, default=STARTS, help="runs of a trial")
    add("--regions", default=",".join(REGIONS), metavar="NAMES", help="in turn")
    add("--sensor", default="A")
    add("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    add("--storage", type=Path, metavar="FILE", help="Optuna's journal; goes on from what it holds")
    add("--out", type=Path, default=TUNED, metavar="FOLDER", help="of the results")
    return parser


def _tune_all(options: argparse.Namespace) -> int:
    for name in ("trials", "starts", "workers"):
        if getattr(options, name) < 1:
            raise ConfigurationError(f"{name} must be at least 1, got {getattr(options, name)!r}")
    methods = [method_named(name.strip()) for name in options.methods.split(",")]
    regions = tuple(name.strip() for name in options.regions.split(","))
    plan = Plan(options.trials, options.starts, regions, options.sensor)
    _ = plan.specs  # an unknown region or sensor is told before anything is run
    options.out.mkdir(parents=True, exist_ok=True)
    with _mapper(min(options.workers, plan.starts)) as mapper:
        for method in methods:
            result = tune(method, plan, options.storage, mapper, _progress(method.name))
            write_json(options.out / f"{method.name}.json", result)
            print(_line(method.name, "stock", result["stock"]))
            print(_line("", "tuned", result["tuned"]))
    return 0


def _progress(name: str) -> Callable[[int, float], None]:
    if not sys.stderr.isatty():
        return lambda trials, best: None
    return lambda trials, best: print(
        f"\r{name}: {trials} trials, best {best:.4f}", end="", file=sys.stderr
    )


def _line(name: str, which: str, outcome: Mapping[str, Any] | None) -> str:
    if outcome is None:
        return f"{name:<16}{which:<7}every trial was refused"
    return (
        f"{name:<16}{which:<7}success {outcome['success']}/{outcome['runs']}, strict "
        f"{outcome['strict']}, mean time {outcome['time_s']:.2f} s"
    )


@contextmanager
def _mapper(workers: int) -> Iterator[Mapper]:
    if workers == 1:
        yield map
        return
    # A forked child may inherit a lock that one of the parent's threads, such as numpy's, holds.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context)
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)


if __name__ == "__main__":
    sys.exit(main())
