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
# # Why the paper's CLF stalls
#
# The controller of Xie et al. (2024) asks a quadratic program for the smallest command that makes
#
# $$V = \tfrac14 (x^\top H x)^2$$
#
# decrease, with a slack in case that is not possible:
#
# $$\min_{u,\delta}\ u^\top Q u + c\,\delta^2 \quad\text{s.t.}\quad \dot V(u) + \mu V \le \delta .$$
#
# Written down it looks harmless. This notebook drives it: it is
# `clfcbf.paper.paper_command`, which solves that program exactly. Three things go wrong, each with
# a closed form that the simulation meets. The weights are not printed in the paper; ours are
# named in `PaperConfig`, and the exponents below hold for any of them.

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from clfcbf import Limits, Pose2, Twist
from clfcbf.constraints.clf import kanayama_clf, quartic_clf
from clfcbf.laws.kanayama import Kanayama
from clfcbf.paper import (
    PaperConfig,
    paper_command,
    settling_time,
    stall_radius,
    steady_state_lag,
)

LIMITS = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
PERIOD, REST = 1 / 30, Twist(0.0, 0.0)
AHEAD = (5.0, 0.0)  # the viewed target, so far ahead that the barrier has no say


def drive(config, error, seconds, reference=REST, limits=LIMITS):
    """Errors over time, shape (n, 3), of a robot that does what the program says."""
    errors, applied = [error], REST
    for _ in range(round(seconds / PERIOD)):
        applied = paper_command(config, error, reference, AHEAD, applied, limits, PERIOD).twist
        # The target moves, then the robot, each along its exact arc.
        target = error.moved(reference, PERIOD)
        error = Pose2(0.0, 0.0, 0.0).moved(applied, PERIOD).relative(target)
        errors.append(error)
    return np.array(errors)


# %% [markdown]
# ## One: the row loses its grip
#
# Let the error be longitudinal, $e$. The row's coefficient $L_gV$ is of third order in $e$, the
# decrease it asks for of fourth. The optimal command pays for the slack or for the speed, and below
#
# $$e^\star = \Big(\frac{q_1}{c\,h_1^4}\Big)^{1/6}$$
#
# slack is cheaper: the speed falls with the *seventh* power of the error. In a log-log plot that is
# a slope, and it can be read off.

# %%
free = Limits(v_max=1e6, omega_max=1e6, a_max=1e9, alpha_max=1e9)
distances = np.geomspace(0.01, 3.0, 200)
config = PaperConfig()
speed = [
    paper_command(config, Pose2(e, 0.0, 0.0), REST, AHEAD, REST, free, PERIOD).twist.v
    for e in distances
]
radius = stall_radius(config)
low, high = distances < 0.3 * radius, distances > 3.0 * radius
slope = [np.polyfit(np.log(distances[k]), np.log(np.array(speed)[k]), 1)[0] for k in (low, high)]
print(f"e* = {radius:.3f} m; the speed goes with e^{slope[0]:.2f} below, e^{slope[1]:.2f} above")
assert abs(slope[0] - 7.0) < 0.05
assert abs(slope[1] - 1.0) < 0.05

# %%
starts, weights = 1.0, (1e3, 1e4, 1e6, 1e9)
figure, (law, time) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
law.loglog(distances, speed, label="the program's speed")
law.loglog(distances, distances / 4, ":", color="grey", label="µe/4")
law.axvline(radius, linestyle="--", color="tab:red", label=f"e* = {radius:.2f} m")
law.set(
    xlabel="longitudinal error e [m]", ylabel="v [m/s]", ylim=(1e-10, 2), title="speed asked for"
)
law.legend()
for c in weights:
    config = PaperConfig(c_delta=c)
    errors = drive(config, Pose2(starts, 0.0, 0.0), 120.0)
    (line,) = time.semilogy(np.arange(len(errors)) * PERIOD, errors[:, 0], label=f"c = {c:.0e}")
    time.axhline(stall_radius(config), linestyle=":", color=line.get_color())
    print(
        f"c = {c:.0e}: e* = {stall_radius(config):.3f} m, after 2 min {errors[-1, 0]:.3f} m off; "
        f"2 mm would take {settling_time(config, starts, 0.002) / 86400:.2g} days"
    )
time.set(xlabel="time [s]", ylabel="e [m]", title="a metre away, two minutes later")
time.legend()
plt.show()

# %% [markdown]
# Raising the weight to reach 2 mm: $c = q_1/(h_1^4 e^6)$.

# %%
needed = 1.0 / 0.002**6
assert abs(stall_radius(PaperConfig(c_delta=needed)) - 0.002) < 1e-12
print(f"c = {needed:.1e}: hardly soft any more, and hardly conditioned")

# %% [markdown]
# ## Two: rest is what the cost wants
#
# At no error at all the row is idle, and $u^\top Qu$ asks for rest. A target that drives ahead runs
# away until the row pulls as hard:
#
# $$x_{ss} = \Big(\frac{4\,q_1\,v_V}{c\,\mu\,h_1^4}\Big)^{1/7}.$$

# %%
ahead = Twist(0.15, 0.0)
for c in (1e4, 1e6, 1e8):
    config = PaperConfig(c_delta=c)
    measured = drive(config, Pose2(0.1, 0.0, 0.0), 90.0, ahead)[-1, 0]
    expected = steady_state_lag(config, ahead.v)
    print(f"c = {c:.0e}: trails by {measured:.4f} m, formula {expected:.4f} m")
    assert abs(measured - expected) < 2e-3

# %% [markdown]
# Asking for the distance to the feedforward $(v_V\cos\theta, \omega_V)$ in place of rest ends it:

# %%
behind = drive(PaperConfig(feedforward=True), Pose2(0.1, 0.0, 0.0), 90.0, ahead)[-1, 0]
print(f"with feedforward {behind:.4f} m: no more than it started with, and no pull either")
assert behind < 0.1 + 1e-9

# %% [markdown]
# ## Three: a lateral error is for ever
#
# The worst comes from geometry. With $x = \theta = 0$ and $y \ne 0$ both $L_gV$ and, for a target
# at rest, $L_fV$ vanish: no command changes $V$ at all, while the row wants it to shrink. $V$ is
# therefore no control Lyapunov function. The solver pays the slack and answers "stand still".

# %%
row = quartic_clf(Pose2(0.0, 0.3, 0.0), REST, (1.0, 1.0, 1.0), 1.0)
print("row of V:  {:g} v + {:g} omega <= {:.6f}".format(*(0.0 + c for c in row.coefficients[0])))
answer = paper_command(PaperConfig(), Pose2(0.0, 0.3, 0.0), REST, AHEAD, REST, LIMITS, PERIOD)
print("command:  ", answer.twist, f"slack {answer.delta:.6f}")
assert row.coefficients[0][:2] == (0.0, 0.0)
assert abs(answer.delta - 0.25 * 0.3**4) < 1e-12

# %%
left = []
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for start in (
    Pose2(1.5, 0.5, 0.0),
    Pose2(1.5, 0.3, -0.3),
    Pose2(1.0, -0.4, 0.4),
    Pose2(0.8, 0.2, 0.5),
):
    errors = drive(PaperConfig(c_delta=1e9), start, 300.0)
    # Where the robot is, seen from the target.
    path = np.array([Pose2(*error).inverse() for error in errors])
    axes.plot(path[:, 0], path[:, 1])
    axes.plot(*path[-1, :2], "o", color=axes.lines[-1].get_color())
    left.append(abs(errors[-1, 1]))
    print(f"from ({start.x}, {start.y}, {start.theta}): after 5 min {left[-1]:.3f} m beside")
assert sum(error > 0.05 for error in left) == 3
axes.plot(0, 0, "k*", markersize=12, label="target")
axes.set(
    xlabel="[m]", ylabel="[m]", title="five minutes each, the row as good as hard", aspect="equal"
)
axes.legend()
plt.show()

# %% [markdown]
# One of the four is lucky: its heading happens to undo its lateral error on the way. The others
# stay where the row has nothing left to pull with. This is no matter of weights. Brockett (1983):
# no continuous feedback of the error alone makes a unicycle converge to a pose. Whoever wants a
# pose must *plan*: a target that moves gives the lateral error something to work on.
#
# ## What is here instead
#
# Kanayama's law tracks a target that moves, and brings its own Lyapunov function,
#
# $$V = \tfrac12(x^2+y^2) + \frac{1-\cos\theta}{k_2}, \qquad \dot V = -W .$$
#
# The row asks for a share of $W$, so the law meets it at *every* error. That can be checked at
# twenty thousand of them: the slack that the law needs is never positive.

# %%
law, rng = Kanayama(), np.random.default_rng(0)
worst = -math.inf
for x, y, theta, v, omega in rng.uniform(-1, 1, (20_000, 5)):
    error, reference = Pose2(2 * x, 2 * y, 3 * theta), Twist(0.22 * v, 0.4 * omega)
    a_v, a_omega, b = kanayama_clf(error, reference, law, 0.5).coefficients[0]
    command = law.command(error, reference)
    worst = max(worst, a_v * command.v + a_omega * command.omega - b)
print(f"largest slack the law needs at 20 000 errors: {worst:.1e}")
assert worst < 1e-12

# %% [markdown]
# $W$ does not see $y$: where only $y$ is left the row asks for nothing, the cost $\lVert u - k(x)
# \rVert^2$ does, and the target's motion carries it. The same starts, with the whole controller: it
# plans, follows, and backs off where a lateral error is left.

# %%
from clfcbf import DockingController, FieldOfView, Observation  # noqa: E402

camera = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for error in (
    Pose2(1.5, 0.5, 0.0),
    Pose2(1.5, 0.3, -0.3),
    Pose2(1.0, -0.4, 0.4),
    Pose2(0.8, 0.2, 0.5),
):
    controller = DockingController(LIMITS, camera, 0.6, PERIOD)
    pose, applied, path = error.inverse(), REST, []
    for tick in range(1800):
        seen = pose.inverse()
        feature = seen.compose(Pose2(0.6, 0.0, 0.0))
        decision = controller.step(
            Observation(seen, feature, tick * PERIOD), applied, tick * PERIOD
        )
        path.append(pose)
        if decision.done:
            break
        applied = decision.twist
        pose = pose.moved(applied, PERIOD)
    path = np.array(path)
    axes.plot(path[:, 0], path[:, 1])
    print(
        f"{tick * PERIOD:5.1f} s, {1e3 * math.hypot(pose.x, pose.y):.1f} mm, "
        f"{math.degrees(pose.theta):+.2f}°"
    )
    assert decision.done
    assert math.hypot(pose.x, pose.y) < 0.01
axes.plot(0, 0, "k*", markersize=12)
axes.set(xlabel="[m]", ylabel="[m]", title="the same starts", aspect="equal")
plt.show()
