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
# # Quickstart
#
# A differential-drive robot sees a board through a 70° camera and has to stop in front of it,
# without losing sight of it on the way. Everything here runs in simulation, on exact arcs.

# %%
import math

import matplotlib.pyplot as plt
import numpy as np

from clfcbf import FieldOfView, FieldOfViewBarrier, Limits, Pose2, SafetyFilter, Scene, Twist
from clfcbf.simulation.campaign import EpisodeSpec, simulate

# %% [markdown]
# ## Any command, made safe
#
# The goal is the pose to stop in, the feature is what the camera has to keep in view: both as
# seen from the robot, in metres and radians, x forward and y left. The controller wants to turn
# right at full rate, away from the board.

# %%
limits = Limits(v_max=0.22, omega_max=0.4, a_max=0.3, alpha_max=1.0)
camera = FieldOfView(half_angle=math.radians(35), camera=Pose2(0.2, 0.0, 0.0))
safe = SafetyFilter(limits, [camera], period=1 / 30)

scene = Scene(goal=Pose2(1.4, 0.8, 0.0), feature=Pose2(2.0, 0.8, 0.0), stamp=0.0)
wanted, applied = Twist(0.22, -0.4), Twist(0.2, -0.15)
decision = safe.filter(wanted, scene, applied, now=0.0)

print("wanted ", wanted)
print("sent   ", decision.twist, decision.status.name)
print("margins", decision.margins)
assert limits.input_box(applied, 1 / 30).contains(decision.twist, 1e-9)
assert decision.certified

# %% [markdown]
# ## A docking run
#
# One seeded run from the paper's start region: lag, wheel slip, gyro bias, and a camera with
# noise, latency, drop-outs and outliers. The judge knows the truth; the controller does not.

# %%
result, trace = simulate(EpisodeSpec(region="R1", plant="kinematic", sensor="A", seed=0, index=2))

print(f"{result.outcome} after {result.time_s:.1f} s and {result.path_m:.2f} m")
print(
    f"e_lon {result.e_lon_mm:+.1f} mm, e_lat {result.e_lat_mm:+.1f} mm, "
    f"e_theta {result.e_theta_deg:+.2f}°"
)
print(f"smallest angle to the edge of the view {result.min_fov_margin_deg:.1f}°")
assert result.success
assert not result.fov_lost
assert result.limit_violations == 0

# %%
poses = np.array(trace.poses)
bearing = [math.degrees(camera.bearing(pose.seen((0.6, 0.0)))) for pose in trace.poses]
sent = np.array([decision.twist for decision in trace.decisions])

figure, (path, view, command) = plt.subplots(1, 3, figsize=(12, 3.2), layout="constrained")
path.plot(poses[:, 0], poses[:, 1])
path.plot([0.6, 0.6], [-0.25, 0.25], linewidth=4)
path.set(xlabel="x [m]", ylabel="y [m]", title="path, and the board", aspect="equal")
view.plot(trace.times, bearing)
view.axhline(35, linestyle="--")
view.axhline(-35, linestyle="--")
view.set(xlabel="time [s]", ylabel="[°]", title="camera's bearing of the board")
command.plot(trace.times, sent[:, 0], label="v [m/s]")
command.plot(trace.times, sent[:, 1], label="ω [rad/s]")
command.set(xlabel="time [s]", title="commands sent")
command.legend()
plt.show()

# %% [markdown]
# ## The guard at work
#
# Rows are a promise about the next instant; a robot that needs time to brake needs more. Here the
# barrier's gain is far too large, so its row lets the robot turn away at full rate until the very
# edge. The guard looks along the arc of a full stop and refuses in time.

# %%
PERIOD = 1 / 30
board = (1.5, 0.0)


def turn_away(guarded):
    """Turn right at full rate for two seconds; the bearing and the status of every tick."""
    eager = FieldOfViewBarrier(camera, gain=50.0, margin=math.radians(0.5))
    keeper = SafetyFilter(limits, [eager], PERIOD, guard_lag=0.0)
    pose, twist, bearings, statuses = Pose2(0.0, 0.0, 0.0), Twist(0.0, 0.0), [], []
    for tick in range(60):
        now = tick * PERIOD
        seen = Scene(pose.inverse(), Pose2(*pose.seen(board), 0.0), now)
        bearings.append(math.degrees(camera.bearing(seen.feature)))
        nominal = Twist(0.1, -0.4)
        if guarded:
            decision = keeper.filter(nominal, seen, applied=twist, now=now)
            twist = decision.twist
            statuses.append(decision.status.name)
        else:
            twist = limits.input_box(twist, PERIOD).clip(nominal)
        pose = pose.moved(twist, PERIOD)
    return bearings, statuses


without, _ = turn_away(guarded=False)
with_guard, statuses = turn_away(guarded=True)
print({name: statuses.count(name) for name in sorted(set(statuses))})
print(f"largest bearing: {max(with_guard):.2f}° guarded, {max(without):.2f}° not; edge at 35°")
assert max(with_guard) <= 35.0 < max(without)
assert {"GUARDED", "BRAKING"} & set(statuses)

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(np.arange(60) * PERIOD, without, label="the command as wanted")
axes.plot(np.arange(60) * PERIOD, with_guard, label="guarded")
axes.axhline(35, linestyle="--", label="edge of the view")
axes.set(xlabel="time [s]", ylabel="camera's bearing of the board [°]")
axes.legend()
plt.show()
