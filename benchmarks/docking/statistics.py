"""What a number of successes shows, and whether one method is better than another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clfcbf.errors import ConfigurationError, MissingExtraError

try:
    from scipy import stats
except ImportError as error:
    raise MissingExtraError("scipy", "bench") from error

__all__ = [
    "CONFIDENCE",
    "Interval",
    "Paired",
    "bootstrap",
    "demonstrated",
    "holm",
    "mcnemar",
    "runs_needed",
    "wilson",
]

CONFIDENCE = 0.95
"""Of intervals, and of reliabilities that are called demonstrated."""

RESAMPLES = 2000
"""Of a bootstrap: the ends of a 95 % interval then rest on some 50 resamples each."""


class Interval(NamedTuple):
    """From ``low`` to ``high``."""

    low: float
    high: float


def wilson(successes: int, runs: int, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval of a success rate (1927): sound near 0 and 1, and for few."""
    _check_counts(successes, runs)
    low, high = stats.binomtest(successes, runs).proportion_ci(confidence, method="wilson")
    return Interval(float(low), float(high))


def demonstrated(successes: int, runs: int, confidence: float = CONFIDENCE) -> float:
    r"""Reliability R that so many successes demonstrate, as ASTM F3499-21 reports docking.

    The one-sided lower bound of Clopper and Pearson (1934): with R or less, so many successes or
    more have a probability of at most :math:`1-C`. Without a failure it is :math:`R = (1-C)^{1/n}`.
    """
    _check_counts(successes, runs)
    test = stats.binomtest(successes, runs, alternative="greater")
    return float(test.proportion_ci(confidence, method="exact").low)


def runs_needed(reliability: float, failures: int = 0, confidence: float = CONFIDENCE) -> int:
    r"""Fewest runs with so many failures that demonstrate a reliability, the inverse of the above.

    The smallest n with :math:`P(X \le k) \le 1-C` for :math:`X \sim B(n, 1-R)`; without a failure
    :math:`n = \lceil\ln(1-C)/\ln R\rceil`.
    """
    if not 0.0 < reliability < 1.0:
        raise ConfigurationError(f"reliability must be in (0, 1), got {reliability!r}")
    low = failures
    high = max(2 * failures, 1)

    def enough(runs: int) -> bool:
        return bool(stats.binom.cdf(failures, runs, 1.0 - reliability) <= 1.0 - confidence)

    while not enough(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


class Paired(NamedTuple):
    """Two methods on the same runs: how often only the first or only the second succeeded.

    ``p`` is that of McNemar's exact test (1947).
    """

    only_first: int
    only_second: int
    runs: int
    p: float


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    r"""Exact two-sided test of whether two methods succeed equally often, run by run.

    Of the b + c runs on which they differ, each is the first's with probability 1/2 if they are
    equal; runs on which they agree say nothing.
    """
    if len(first) != len(second):
        raise ConfigurationError(
            f"a paired test needs the same runs, got {len(first)} and {len(second)}"
        )
    pairs = list(zip(first, second, strict=True))
    b, c = pairs.count((True, False)), pairs.count((False, True))
    p = float(stats.binomtest(b, b + c, 0.5).pvalue) if b + c else 1.0
    return Paired(b, c, len(pairs), p)


def holm(ps: Sequence[float]) -> list[float]:
    r"""p-values adjusted for so many tests by Holm (1979): any below 0.05 is significant with all.

    In rising order :math:`\tilde p_{(i)} = \max_{j \le i} \min(1, (m-j+1)\,p_{(j)})`.
    """
    order = np.argsort(ps)
    adjusted = [0.0] * len(ps)
    largest = 0.0
    for rank, i in enumerate(order.tolist()):
        largest = max(largest, min(1.0, (len(ps) - rank) * ps[i]))
        adjusted[i] = largest
    return adjusted


def bootstrap(
    values: ArrayLike,
    statistic: Callable[..., np.ndarray] = np.median,
    confidence: float = CONFIDENCE,
    seed: int = 0,
) -> Interval:
    """Percentile bootstrap interval of a statistic of a sample; one value is its own interval.

    ``statistic`` takes an ``axis``, as NumPy's do.
    """
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or not sample.size:
        raise ConfigurationError(f"a bootstrap needs a sample, got shape {sample.shape!r}")
    if np.ptp(sample) == 0.0:
        return Interval(float(sample[0]), float(sample[0]))
    result = stats.bootstrap(
        (sample,), statistic, confidence_level=confidence, n_resamples=RESAMPLES,
        method="percentile", vectorized=True, rng=np.random.default_rng(seed),
    )  # fmt: skip
    low, high = result.confidence_interval
    return Interval(float(low), float(high))


def _check_counts(successes: int, runs: int) -> None:
    if not 0 <= successes <= runs or runs < 1:
        raise ConfigurationError(
            f"counts need 0 <= successes <= runs and a run, got {successes!r} of {runs!r}"
        )
