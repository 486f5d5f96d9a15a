# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Choosing a backend
#
# The program of a tick has two variables and a handful of rows. `exact` solves it by geometry, and
# is the default. Every other solver sits behind the same call, and none of them is believed.
# When is another one worth it, and what happens when it is wrong?

# %%
import math
import statistics
import time

import matplotlib.pyplot as plt
import numpy as np

from clfcbf import QpSolution, QpStatus, QuadraticProgram, available_backends, solve_qp
from clfcbf.qp import Capability, SolverHealth, get_backend

print(len(available_backends()), "backends here:", ", ".join(available_backends()))

# %% [markdown]
# ## The programs
#
# Forty ticks of a robot that is steered out of view, at random places: two inputs, the box of the
# tick, one or two rows that bite.

# %%
rng = np.random.default_rng(0)


def tick_program():
    bearing, distance = rng.uniform(-0.6, 0.6), rng.uniform(0.5, 2.5)
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    rows, bounds = [], []
    for side in (-1.0, 1.0):
        n_x, n_y = math.sin(0.61), side * math.cos(0.61)
        rows.append((n_x, n_y * x - n_x * y))
        bounds.append(1.5 * (n_x * x + n_y * y))
    v, omega = rng.uniform((0, -0.4), (0.22, 0.4))
    wanted = np.array(rng.uniform((0, -0.4), (0.22, 0.4)))
    P = np.diag((1.0, 0.3))
    return QuadraticProgram(
        P, -P @ wanted, rows, bounds, (v - 0.01, omega - 0.033), (v + 0.01, omega + 0.033)
    )


programs = [tick_program() for _ in range(40)]
reference = [solve_qp(problem) for problem in programs]
print(
    {
        status.value: [s.status for s in reference].count(status)
        for status in {s.status for s in reference}
    }
)
solvable = [k for k, s in enumerate(reference) if s.found]

# %% [markdown]
# ## Time beside capability
#
# `solve_qp` verifies each answer: feasible, stationary, complementary, recomputed from the data.
# The time includes that, and the polish that most adapters put behind a solver of moderate
# accuracy: which is why none is off by more than rounding.

# %%
LONGEST = 0.5  # [s] of timing for each
table = {}
for name in available_backends():
    capability, durations, worst = get_backend(name).capability, [], 0.0
    solve_qp(programs[0], name)  # what a solver sets up once is no tick's cost
    end = time.perf_counter() + LONGEST
    while time.perf_counter() < end and len(durations) < 400:
        k = solvable[len(durations) % len(solvable)]
        begun = time.perf_counter()
        solution = solve_qp(programs[k], name, fallback=())
        durations.append(1e6 * (time.perf_counter() - begun))
        found = solution.x if solution.found else np.full(2, math.nan)
        worst = max(worst, float(np.abs(found - reference[k].x).max()))
    table[name] = (statistics.median(durations), worst, capability)

print(
    f"{'backend':22s} {'median':>9s} {'off by':>8s}  {'variables':>9s} {'singular P':>10s}  licence"
)
for name, (median, worst, capability) in sorted(table.items(), key=lambda item: item[1][0]):
    size = "any" if capability.max_variables is None else f"<= {capability.max_variables}"
    singular = "yes" if capability.semidefinite else "no"
    print(
        f"{name:22s} {median:6.0f} µs {worst:8.0e}  {size:>9s} {singular:>10s}  "
        f"{capability.licence}"
    )
assert all(worst < 1e-6 for _, worst, _ in table.values())

# %%
names = sorted(table, key=lambda name: table[name][0])
colours = {"GPL": "C3", "LGPL": "C1"}
bars = [
    next(
        (
            c
            for key, c in colours.items()
            if table[n][2].licence.startswith(key) or f" {key}" in table[n][2].licence
        ),
        "C0",
    )
    for n in names
]
figure, axes = plt.subplots(figsize=(9, 0.28 * len(names) + 1.2), layout="constrained")
axes.barh(names, [table[n][0] for n in names], color=bars)
axes.set(xscale="log", xlabel="median of solve_qp, verification included [µs]")
axes.invert_yaxis()
for label, colour in (("permissive", "C0"), ("LGPL", "C1"), ("GPL", "C3")):
    axes.barh(names[0], 0, color=colour, label=label)
axes.legend(title="licence")
plt.show()

# %% [markdown]
# A tick at 30 Hz has 33 000 µs. Each of these fits, so time is rarely the reason. Reasons are:
#
# | you want | take |
# |---|---|
# | two inputs, no dependency, no tolerance, a proof where nothing is feasible | `exact` |
# | more variables: slacks, horizons | `daqp` or `clarabel` |
# | the solver that the rest of your stack has | that one, here |
# | to distribute closed source | not a GPL one |
#
# In a controller the exact answer is computed anyway, and the backend's is taken only where they
# agree.
#
# ## A solver that lies
#
# Every solver is wrong somewhere: a tolerance, a warm start, a bug. Here are some that are wrong
# on purpose, each of which says `OPTIMAL`.

# %%
exact = get_backend("exact")


class Liar:
    """Solves the program, and then tells something else."""

    capability = Capability()

    def __init__(self, name, spoil):
        self.name, self.spoil = name, spoil

    def solve(self, problem, time_limit=None):
        x = exact.solve(problem).x
        return QpSolution(self.spoil(np.zeros(2) if x is None else x), QpStatus.OPTIMAL, self.name)


def raises(x):
    raise RuntimeError("segmentation fault, nearly")


liars = [
    Liar("off by 1e-3", lambda x: x + 1e-3),
    Liar("off by 1e-6", lambda x: x + np.array((0.0, 1e-6))),
    Liar("NaN", lambda x: np.full(2, math.nan)),
    Liar("zero", lambda x: np.zeros(2)),
    Liar("raises", raises),
    Liar("wrong shape", lambda x: np.zeros(3)),
    Liar("honest", lambda x: x),
]
health = SolverHealth()
for liar in liars:
    for k, problem in enumerate(programs):
        solution = solve_qp(problem, liar, health=health)
        if k in solvable:
            assert np.abs(solution.x - reference[k].x).max() < 1e-6
        else:
            assert not solution.found
print(health)
hopeless = len(programs) - len(solvable)
assert all(health.backends[liar.name].used == hopeless for liar in liars[:-1])

# %% [markdown]
# Every command that came out is right to 1e-6; the count says what it took. What is "used" of a
# liar are the programs that have no answer: that was proved here, whatever it said.
#
# ## Where nothing is feasible
#
# "Infeasible" is a claim as well. It is passed on only with a certificate that was checked: weights
# $y \ge 0$ of the rows with $G^\top y = 0$ and $h^\top y < 0$.

# %%
empty = QuadraticProgram(np.eye(2), np.zeros(2), [[1.0, 0.0], [-1.0, 0.0]], [-1.0, 0.5])
for name in ("exact", "daqp", "clarabel"):
    if name in available_backends():
        print(f"{name:10s}", solve_qp(empty, name).status.value)


class Pessimist(Liar):
    """Finds nothing feasible."""

    def solve(self, problem, time_limit=None):
        return QpSolution(None, QpStatus.INFEASIBLE, self.name)


solution = solve_qp(programs[solvable[0]], Pessimist("pessimist", None))
print("pessimist  ", [(a.backend, a.status.value) for a in solution.attempts])
assert solution.found
assert solution.backend != "pessimist"

# %% [markdown]
# A backend of your own is a class with three members; `clfcbf.qp.conformance.check_backend` puts it
# through fourteen families of programs that have broken solvers before.
