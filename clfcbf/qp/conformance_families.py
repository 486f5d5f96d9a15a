r"""Quadratic programs whose answers are known, family by family, from a seed.

The answer is known without a solver: either the exact geometry of two variables gives it, or an
enumeration of active sets, or the multipliers were drawn first and the data made to fit,
:math:`q = -(Pz + G^\top\lambda + A^\top\nu + \mu)`.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from clfcbf.qp.backends.exact import ExactBackend
from clfcbf.qp.problem import Array, QpStatus, QuadraticProgram

__all__ = ["FAMILIES", "Case", "cases", "enumerate_active_sets"]

_SIZES = (2, 3, 5, 10, 20, 30)
"""Numbers of variables: that of a command, that with a slack, and up to a short horizon's."""

_GAP = 1e-4
"""By how much the infeasible programs are: solvers with loose tolerances find them feasible."""

_SCALE = 1e8
"""By which cost, rows and variables are multiplied or divided."""

_OPTIMAL = frozenset({QpStatus.OPTIMAL})
_INFEASIBLE = frozenset({QpStatus.INFEASIBLE})
_UNBOUNDED = frozenset({QpStatus.UNBOUNDED})
_INVALID = frozenset({QpStatus.INVALID_INPUT})


class Case(NamedTuple):
    """A program and what must come of it.

    Attributes
    ----------
    family, number : where it comes from
    problem : the program
    expected : statuses that are right
    x : the answer, or None where there is none
    size : of the variables; the error of an answer is measured against it
    """

    family: str
    number: int
    problem: QuadraticProgram
    expected: frozenset[QpStatus]
    x: Array | None = None
    size: float = 1.0

    def __str__(self) -> str:
        return f"{self.family}-{self.number}"


class _Data(NamedTuple):
    """A program in pieces that can be changed, and its answer."""

    P: Array
    q: Array
    G: Array
    h: Array
    lb: Array
    ub: Array
    A: Array
    b: Array
    x: Array

    def problem(self) -> QuadraticProgram:
        return QuadraticProgram(*self[:-1])


def _positive(rng: np.random.Generator, n: int) -> Array:
    root = rng.normal(size=(n, n))
    matrix: Array = root @ root.T / n + 0.1 * np.eye(n)
    return (matrix + matrix.T) / 2


def _known(rng: np.random.Generator, n: int, m: int, p: int = 0, active: int = -1) -> _Data:
    """Multipliers first: ``active`` rows hold the answer, by default half as many as variables."""
    P, x = _positive(rng, n), rng.normal(size=n)
    G, A = rng.normal(size=(m, n)), rng.normal(size=(p, n))
    holding = np.arange(m) < (min(n - p, m) // 2 if active < 0 else active)
    rng.shuffle(holding)
    dual = np.where(holding, rng.uniform(0.1, 2.0, m), 0.0)
    h = G @ x + np.where(holding, 0.0, rng.uniform(0.1, 1.0, m))
    lb, ub = x - rng.uniform(0.2, 2.0, n), x + rng.uniform(0.2, 2.0, n)
    lb[rng.random(n) < 0.3], ub[rng.random(n) < 0.3] = -np.inf, np.inf
    q = -(P @ x + G.T @ dual + A.T @ rng.normal(size=p))
    return _Data(P, q, G, h, lb, ub, A, A @ x, x)


def _mixed(rng: np.random.Generator, index: int) -> _Data:
    n = _SIZES[index % 3]
    return _known(rng, n, int(rng.integers(1, 3 * n)))


def enumerate_active_sets(problem: QuadraticProgram) -> Array | None:
    """The answer of a small program by trying every active set; None where none is feasible."""
    eye = np.eye(problem.n)
    rows = np.concatenate((problem.G, -eye, eye))
    sides = np.concatenate((problem.h, -problem.lb, problem.ub))
    rows, sides = rows[np.isfinite(sides)], sides[np.isfinite(sides)]
    best: Array | None = None
    least = np.inf
    for count in range(problem.n - problem.p + 1):
        for chosen in combinations(range(sides.size), count):
            C = np.concatenate((problem.A, rows[list(chosen)]))
            system = np.block([[problem.P, C.T], [C, np.zeros((len(C), len(C)))]])
            if np.linalg.matrix_rank(system) < len(system):
                continue
            right = np.concatenate((-problem.q, problem.b, sides[list(chosen)]))
            x = np.linalg.solve(system, right)[: problem.n]
            cost = float(0.5 * x @ problem.P @ x + problem.q @ x)
            if cost < least and (rows @ x - sides <= 1e-9).all():
                best, least = x, cost
    return best


def _feasible(rng: np.random.Generator, index: int) -> Case:
    """Two variables, answered by the exact geometry."""
    m = int(rng.integers(0, 6))
    inside, G = rng.uniform(-0.5, 0.5, 2), rng.normal(size=(m, 2))
    problem = QuadraticProgram(
        _positive(rng, 2),
        2.0 * rng.normal(size=2),
        G,
        G @ inside + rng.uniform(0.0, 1.0, m),
        -rng.uniform(0.5, 1.0, 2),
        rng.uniform(0.5, 1.0, 2),
    )
    return Case("feasible", index, problem, _OPTIMAL, ExactBackend().solve(problem).x)


def _enumerated(rng: np.random.Generator, index: int) -> Case:
    """Three variables, answered by enumeration; some have no feasible point."""
    m = int(rng.integers(1, 5))
    problem = QuadraticProgram(
        _positive(rng, 3),
        2.0 * rng.normal(size=3),
        rng.normal(size=(m, 3)),
        rng.normal(size=m) + 0.3,
        -rng.uniform(0.2, 1.0, 3),
        rng.uniform(0.2, 1.0, 3),
    )
    x = enumerate_active_sets(problem)
    return Case("enumerated", index, problem, _INFEASIBLE if x is None else _OPTIMAL, x)


def _degenerate(rng: np.random.Generator, index: int) -> Case:
    """More rows through the answer than there are variables."""
    n = _SIZES[index % 3]
    data = _known(rng, n, 2 * n, active=n + 1)
    # One direction leads inside through all of them: a set of one point would be empty to rounding.
    G = np.where(data.G[:, :1] < 0.0, -data.G, data.G)
    slack = data.h - data.G @ data.x
    dual = np.where(slack > 0.05, 0.0, rng.uniform(0.1, 2.0, slack.size))
    q = -(data.P @ data.x + G.T @ dual)
    changed = data._replace(q=q, G=G, h=G @ data.x + np.where(slack > 0.05, slack, 0.0))
    return Case("degenerate", index, changed.problem(), _OPTIMAL, data.x)


def _duplicates(rng: np.random.Generator, index: int) -> Case:
    """Rows repeated, some of the copies with another length."""
    data = _mixed(rng, index)
    copies = rng.integers(0, data.h.size, 4)
    factor = rng.choice([1.0, 3.0, 0.1], 4)
    G = np.concatenate((data.G, data.G[copies] * factor[:, None]))
    h = np.concatenate((data.h, data.h[copies] * factor))
    return Case("duplicate rows", index, data._replace(G=G, h=h).problem(), _OPTIMAL, data.x)


def _zero_rows(rng: np.random.Generator, index: int) -> Case:
    """Rows 0 <= h, which say nothing or, every fourth time, that there is no point."""
    data = _mixed(rng, index)
    none = index % 4 == 3
    value = -0.1 if none else float(rng.choice([0.0, 1.0, np.inf]))
    at = int(rng.integers(0, data.h.size + 1))
    changed = data._replace(G=np.insert(data.G, at, 0.0, axis=0), h=np.insert(data.h, at, value))
    expected, x = (_INFEASIBLE, None) if none else (_OPTIMAL, data.x)
    return Case("zero rows", index, changed.problem(), expected, x)


def _row_lengths(rng: np.random.Generator, index: int) -> Case:
    """Rows of length 1e-8 to 1e8."""
    data = _mixed(rng, index)
    factor = 10.0 ** rng.uniform(-8.0, 8.0, data.h.size)
    changed = data._replace(G=data.G * factor[:, None], h=data.h * factor)
    return Case("huge and tiny rows", index, changed.problem(), _OPTIMAL, data.x)


def _infinite(rng: np.random.Generator, index: int) -> Case:
    """Bounds and right-hand sides at infinity."""
    data = _mixed(rng, index)
    lb, ub = data.lb.copy(), data.ub.copy()
    lb[rng.random(lb.size) < 0.7], ub[rng.random(ub.size) < 0.7] = -np.inf, np.inf
    G = np.concatenate((data.G, rng.normal(size=(2, lb.size))))
    changed = data._replace(G=G, h=np.append(data.h, [np.inf, np.inf]), lb=lb, ub=ub)
    return Case("infinite bounds", index, changed.problem(), _OPTIMAL, data.x)


def _infeasible(rng: np.random.Generator, index: int) -> Case:
    """Two rows that miss each other by little, or three of which no two do."""
    data = _mixed(rng, index)
    n = data.q.size
    row = rng.normal(size=n)
    row /= np.linalg.norm(row)
    offset = float(row @ data.x)
    G, h = np.stack((row, -row)), np.array((offset, -offset - _GAP))
    if index % 2:
        other = rng.normal(size=n)
        G = np.stack((row, other - row, -other))
        along = float(other @ data.x)
        h = np.array((offset, along - offset, -along - _GAP))
    changed = data._replace(
        G=np.concatenate((data.G, G)),
        h=np.append(data.h, h),
        lb=np.full(n, -np.inf),
        ub=np.full(n, np.inf),
    )
    return Case("infeasible by 1e-4", index, changed.problem(), _INFEASIBLE)


def _singular(rng: np.random.Generator, index: int) -> Case:
    """P singular, the answer on a row that the cost pushes against where it is flat."""
    n = _SIZES[index % 3]
    frame = np.linalg.qr(rng.normal(size=(n, n)))[0]
    P = (frame[:, 1:] * rng.uniform(0.5, 2.0, n - 1)) @ frame[:, 1:].T
    P, flat, x = (P + P.T) / 2, frame[:, 0], rng.normal(size=n)
    G = np.stack((flat, rng.normal(size=n)))
    h = G @ x + np.array((0.0, 0.5))
    q = -(P @ x + float(rng.uniform(0.5, 2.0)) * flat)
    return Case("singular", index, QuadraticProgram(P, q, G, h), _OPTIMAL, x)


def _unbounded(rng: np.random.Generator, index: int) -> Case:
    """P singular or indefinite, the cost falling without end along a direction without rows."""
    n = _SIZES[index % 3]
    frame = np.linalg.qr(rng.normal(size=(n, n)))[0]
    curvature = rng.uniform(0.5, 2.0, n)
    curvature[0] = 0.0 if index % 2 else -0.5
    P = (frame * curvature) @ frame.T
    q = rng.normal(size=n)
    G = rng.normal(size=(2, n))
    G -= np.outer(G @ frame[:, 0], frame[:, 0])  # no row ends the fall
    problem = QuadraticProgram((P + P.T) / 2, q - frame[:, 0] * (1 + q @ frame[:, 0]), G, [1, 1])
    return Case("unbounded", index, problem, _UNBOUNDED if index % 2 else _INVALID)


def _not_finite(rng: np.random.Generator, index: int) -> Case:
    """A NaN or an infinity in every place, one at a time."""
    data = _known(rng, 2, 2, 1, active=1)
    lb, ub = np.array([-9.0, -9.0]), np.array([9.0, 9.0])
    pieces: dict[str, Any] = data._replace(lb=lb, ub=ub)._asdict()
    x = pieces.pop("x")
    places = [
        (name, at, value)
        for name in pieces
        for at in np.ndindex(np.shape(pieces[name]))
        for value in (np.nan, np.inf, -np.inf)
    ]
    name, at, value = places[index % len(places)]
    changed = np.array(pieces[name])
    changed[at] = value
    if name == "P":
        changed[at[::-1]] = value
    open_side = {"h": np.inf, "ub": np.inf, "lb": -np.inf}.get(name)
    if value == open_side:
        # A side taken away is a program like any other; its answer is found by enumeration.
        problem = QuadraticProgram(**{**pieces, name: changed})
        return Case("not finite", index, problem, _OPTIMAL, enumerate_active_sets(problem))
    del x
    return Case("not finite", index, QuadraticProgram(**{**pieces, name: changed}), _INVALID)


def _scaled(rng: np.random.Generator, index: int) -> Case:
    """The whole cost, or all variables, times 1e8 or 1e-8."""
    data = _mixed(rng, index)
    factor = _SCALE if index % 2 else 1.0 / _SCALE
    if index % 4 < 2:
        changed = data._replace(P=data.P * factor, q=data.q * factor)
        return Case("1e8 scaling", index, changed.problem(), _OPTIMAL, data.x)
    changed = data._replace(
        q=data.q * factor, h=data.h * factor, lb=data.lb * factor, ub=data.ub * factor
    )
    return Case("1e8 scaling", index, changed.problem(), _OPTIMAL, data.x * factor, factor)


def _sizes(rng: np.random.Generator, index: int) -> Case:
    """2 to 30 variables with equality rows."""
    n = _SIZES[index % len(_SIZES)]
    p = int(rng.integers(1, n // 2 + 1))
    data = _known(rng, n, int(rng.integers(0, 2 * n)), p)
    return Case("sizes and equalities", index, data.problem(), _OPTIMAL, data.x)


def _metamorphic(rng: np.random.Generator, index: int) -> Case:
    """A row added that says nothing, rows scaled, or permuted: the answer stays."""
    data = _mixed(rng, index)
    G, h = data.G, data.h
    match index % 4:
        case 0:
            row = rng.normal(size=data.q.size)
            G, h = np.vstack((row, G)), np.insert(h, 0, row @ data.x + 0.1)
        case 1:
            G, h = np.vstack((G, 0.0 * G[0])), np.append(h, 1.0)
        case 2:
            factor = 10.0 ** rng.uniform(-3.0, 3.0, h.size)
            G, h = G * factor[:, None], h * factor
        case _:
            order = rng.permutation(h.size)
            G, h = G[order], h[order]
    return Case("metamorphic", index, data._replace(G=G, h=h).problem(), _OPTIMAL, data.x)


FAMILIES: dict[str, Callable[[np.random.Generator, int], Case]] = {
    "feasible": _feasible,
    "enumerated": _enumerated,
    "degenerate": _degenerate,
    "duplicate rows": _duplicates,
    "zero rows": _zero_rows,
    "huge and tiny rows": _row_lengths,
    "infinite bounds": _infinite,
    "infeasible by 1e-4": _infeasible,
    "singular": _singular,
    "unbounded": _unbounded,
    "not finite": _not_finite,
    "1e8 scaling": _scaled,
    "sizes and equalities": _sizes,
    "metamorphic": _metamorphic,
}
"""Generators by name."""


def cases(seed: int = 0, count: int = 20, families: tuple[str, ...] = ()) -> list[Case]:
    """``count`` cases of each family; the same for the same seed.

    Parameters
    ----------
    seed : of the random numbers
    count : cases a family
    families : names in :data:`FAMILIES`; all of them if none is given
    """
    found = []
    for name in families or FAMILIES:
        rng = np.random.default_rng((seed, sum(name.encode())))
        found += [FAMILIES[name](rng, number) for number in range(count)]
    return found
