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
# # The view and its barrier
#
# A camera sees a wedge. To keep a feature in it is to keep it on the right side of two lines; the
# rest of this notebook is what follows from taking that literally.

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from clfcbf import FieldOfView, FieldOfViewBarrier, Limits, Pose2, SafetyFilter, Scene, Sweep, Twist
from clfcbf.constraints.bearing import paper_row
from clfcbf.constraints.cbf import camera_edges, edge_rows

HALF = math.radians(35)
camera = FieldOfView(HALF, Pose2(0.2, 0.0, 0.0))
limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
rng = np.random.default_rng(0)

# %% [markdown]
# ## Two half-planes
#
# Each edge has a unit normal $n$ into the view, and $h = n^\top(p - c)$ is how far the feature is
# from it: in metres, linear, smooth at the apex. An angle is none of these.

# %%
x, y = np.meshgrid(np.linspace(-0.2, 2.5, 200), np.linspace(-1.5, 1.5, 200))
left, right = camera_edges(camera)
h = np.minimum(*(e.normal_x * x + e.normal_y * y - e.offset for e in (left, right)))
figure, axes = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
shades = axes.contourf(x, y, h, levels=np.arange(-1.0, 1.05, 0.1), cmap="RdBu", vmin=-1, vmax=1)
axes.contour(x, y, h, levels=[0.0], colors="k")
for edge in (left, right):
    foot = np.array([1.0, math.copysign(0.8 * math.tan(HALF), -edge.normal_y)])
    axes.annotate("", foot + 0.35 * np.array(edge[:2]), foot, arrowprops={"arrowstyle": "->"})
axes.plot(0, 0, "ks", label="rotation centre")
axes.plot(0.2, 0, "k^", label="camera")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="h, the smaller of the two [m]")
axes.legend(loc="lower left")
figure.colorbar(shades)
plt.show()

# %% [markdown]
# For a feature at rest $\dot h = -n_xv + (n_xy - n_yx)\,\omega$, which is what a row is made of. A
# difference quotient along exact arcs says the same:

# %%
worst = 0.0
for _ in range(500):
    point, twist = tuple(rng.uniform((0.3, -1), (2.5, 1))), Twist(*rng.uniform(-0.4, 0.4, 2))
    rows, step = edge_rows(point, camera, gain=1.0), 1e-6
    here = Pose2(0.0, 0.0, 0.0)
    ahead, behind = (here.moved(twist, t).seen(point) for t in (step, -step))
    for (a_v, a_omega, _), edge in zip(rows.coefficients, (left, right), strict=True):
        quotient = np.dot(edge[:2], np.subtract(ahead, behind)) / (2 * step)
        worst = max(worst, abs(quotient + a_v * twist.v + a_omega * twist.omega))
print(f"500 points: differ by {worst:.1e} m/s at most")
assert worst < 1e-8

# %% [markdown]
# ## A shape matters: one gain everywhere
#
# The paper's barrier is $\tfrac12(\Phi^2 - \varphi^2)$. It describes the same set. But the bearing
# rate that it allows falls toward the edge with the slope
# $\lambda(\Phi^2+\varphi^2)/(2\varphi^2)$, which has no bound: a bearing that moves outward through
# the middle of the view has to be braked harder than the acceleration limits can.

# %%
bearings = np.radians(np.linspace(2, 35, 200))
allowed = {"paper": [], "half-plane": []}
for phi in bearings:
    point = (math.cos(phi), math.sin(phi))
    a_v, a_omega, b = paper_row(point, HALF, 1.0).coefficients[0]
    allowed["paper"].append(-b / a_omega)  # at v = 0 the bearing's rate is -omega
    a_v, a_omega, b = edge_rows(point, FieldOfView(HALF), 1.0).coefficients[0]
    allowed["half-plane"].append(-b / a_omega)
rates = {name: np.array(values) for name, values in allowed.items()}
figure, (rate, gain) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
for name, values in rates.items():
    rate.plot(np.degrees(bearings), values, label=name)
    gain.plot(np.degrees(bearings), -np.gradient(values, bearings), label=name)
effective = (HALF**2 + bearings**2) / (2 * bearings**2)
gain.plot(np.degrees(bearings), effective, "k:", label="λ(Φ²+φ²)/(2φ²)")
rate.set(xlabel="bearing [°]", ylabel="outward rate allowed [rad/s]", ylim=(0, 2))
gain.set(xlabel="bearing [°]", ylabel="effective gain [1/s]", ylim=(0, 20))
rate.legend()
gain.legend()
plt.show()
numeric = -np.gradient(rates["paper"], bearings)[2:-2]
assert np.allclose(numeric, effective[2:-2], rtol=0.02)

# %% [markdown]
# ## Room for error: the eroded view
#
# What is known of the feature is off by a turn about the camera of at most $m$, and a displacement
# of at most $d$. Which features are in view whatever the error? Turn the edges inward by $m$ and
# move them inward by $d$: that is a view again, of a camera that sits $d/\sin(\Phi - m)$ farther
# ahead.

# %%
margin, setback = math.radians(4.0), 0.06
kept = camera.eroded(margin, setback)
print(
    f"camera {kept.camera.x:.3f} m ahead, sees {math.degrees(kept.half_angle):.0f}° to either side"
)


def displaced(point, turn, shift, direction):
    """The point turned about the camera, then moved."""
    dx, dy = point[0] - camera.camera.x, point[1] - camera.camera.y
    c, s = math.cos(turn), math.sin(turn)
    return (
        camera.camera.x + c * dx - s * dy + shift * math.cos(direction),
        camera.camera.y + s * dx + c * dy + shift * math.sin(direction),
    )


def worst_margin(point):
    """Smallest angle to the edge over errors at the ends of their bounds."""
    return min(
        camera.margin(displaced(point, turn, setback, direction))
        for turn in (-margin, margin)
        for direction in np.linspace(-math.pi, math.pi, 180)
    )


inside, outside = [], []
for _ in range(200):
    phi, rho = rng.uniform(-1, 1) * kept.half_angle, rng.uniform(0.05, 2.0)
    inside.append(worst_margin(kept.camera.transform((rho * math.cos(phi), rho * math.sin(phi)))))
    edge, rho = kept.half_angle + 0.01, rng.uniform(0.3, 2.0)
    outside.append(
        worst_margin(kept.camera.transform((rho * math.cos(edge), rho * math.sin(edge))))
    )
print(f"inside:       worst {math.degrees(min(inside)):+.3f}°, never lost")
print(f"0.6° outside: best  {math.degrees(max(outside)):+.3f}°, each can be lost")
assert min(inside) > -1e-9
assert max(outside) < 0.0

# %%
figure, axes = plt.subplots(figsize=(6.5, 4), layout="constrained")
for view, style, name in ((camera, "k-", "the view"), (kept, "C0-", "what is kept")):
    for sign in (-1, 1):
        ray = [
            view.camera.transform(
                (r * math.cos(view.half_angle), sign * r * math.sin(view.half_angle))
            )
            for r in (0, 2)
        ]
        axes.plot(*zip(*ray, strict=True), style, label=name if sign > 0 else None)
point = kept.camera.transform((1.2 * math.cos(kept.half_angle), 1.2 * math.sin(kept.half_angle)))
cloud = np.array(
    [
        displaced(
            point,
            rng.uniform(-margin, margin),
            setback * math.sqrt(rng.uniform()),
            rng.uniform(-4, 4),
        )
        for _ in range(400)
    ]
)
axes.plot(*cloud.T, ".", markersize=2, color="C1", label="where it may really be")
axes.plot(*point, "kx")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend(loc="lower right")
plt.show()
assert all(camera.margin(tuple(p)) > -1e-9 for p in cloud)

# %% [markdown]
# ## From the wedge to commands
#
# At each tick the rows are half-planes of $(v, \omega)$. Together with what one tick can reach they
# leave a polygon, and the command is its point nearest to what the controller wants.

# %%
applied, wanted = Twist(0.2, -0.15), Twist(0.22, -0.4)
safe = SafetyFilter(limits, [camera], period=1 / 30)
decision = safe.filter(wanted, Scene(Pose2(1.4, 0.8, 0), Pose2(2, 0.8, 0), 0.0), applied, now=0.0)
figure, (wide, close) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
v, omega = np.meshgrid(np.linspace(-0.05, 0.3, 300), np.linspace(-0.5, 0.5, 300))
box = decision.box
for axes in (wide, close):
    for a_v, a_omega, b in decision.named_rows.values():
        axes.contourf(
            v, omega, a_v * v + a_omega * omega - b, levels=[0, 1e9], colors=["C3"], alpha=0.25
        )
    axes.add_patch(plt.Rectangle((box[0], box[2]), box[1] - box[0], box[3] - box[2], fill=False))
    axes.plot(*applied, "k+", markersize=10, label="in force")
    axes.plot(*wanted, "C3x", markersize=10, label="wanted")
    axes.plot(*decision.twist, "C2o", label="sent")
    axes.set(xlabel="v [m/s]", ylabel="ω [rad/s]")
wide.legend(loc="upper left")
wide.set_title("commands; the row forbids the red side")
close.set(xlim=(0.18, 0.23), ylim=(-0.2, -0.1), title="what one tick can reach")
plt.show()
print(decision.twist, {name: round(abs(m), 4) for name, m in decision.margins.items()})

# %% [markdown]
# ## From an instant to a stop: the guard's sweep
#
# A row holds now. The robot lags, and needs time to brake. So before a command goes out, the guard
# asks where the robot might pass on its way to rest: it coasts along its present twist $b$ by up
# to $\tau$ and follows the command $u$ by up to $T_{eff}$, in an order that nobody knows. Each
# order is a path from corner to corner in the rectangle of the two, and there are infinitely many.
# Four corners answer for all of them, with a blur for the order.

# %%
body, command, lag = Twist(0.2, -0.1), Twist(0.21, -0.35), 0.25
ticks = limits.brake_ticks(command, 1 / 30)
sweep = Sweep.of(Pose2(0, 0, 0), body, lag, command, 0.5 / 30 * (ticks + 1))
barrier = FieldOfViewBarrier(camera, gain=1.5)
board = Scene(Pose2(1.0, 0.35, 0), Pose2(1.6, 0.35, 0), 0.0)
bound = barrier.clearance_along(board, sweep)


def random_order(pieces=60):
    """The body's path for one order of coasting and braking."""
    pose, path = sweep.motion, [sweep.motion]
    share = rng.dirichlet(np.full(pieces, 0.3), size=2)
    for coast, brake in share.T:
        # Both at once over the piece: the twist is their sum.
        twist = Twist(
            body.v * coast * lag + command.v * brake * sweep.duration,
            body.omega * coast * lag + command.omega * brake * sweep.duration,
        )
        pose = pose.moved(twist, 1.0)
        path.append(pose)
    return path


figure, (plane, angle) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
least = math.inf
for k in range(300):
    path = random_order()
    clearances = [barrier.clearance(board, pose) for pose in path]
    least = min(least, *clearances)
    if k < 60:
        plane.plot(*np.array(path)[:, :2].T, color="C0", alpha=0.2)
        angle.plot(np.linspace(0, 1, len(path)), np.degrees(clearances), color="C0", alpha=0.2)
plane.plot(*np.array(sweep.corners())[:, :2].T, "k.", label="the corners")
plane.set(xlabel="x [m]", ylabel="y [m]", title="ways to rest, from the same command")
plane.legend()
angle.axhline(math.degrees(bound), color="C3", linestyle="--", label="bound from four corners")
angle.set(xlabel="share of the way", ylabel="angle to the edge [°]")
angle.legend()
plt.show()
print(f"bound {math.degrees(bound):.3f}°, smallest of 300 orders {math.degrees(least):.3f}°")
print(f"the order can matter by {1e3 * sweep.blur:.1f} mm")
assert bound <= least

# %% [markdown]
# The bound holds and it is close: a guard that is too careful would be as useless as none. Why
# corners suffice is in the guarantee; how it fares against an adversary is in the notebook on
# the guard under attack.
