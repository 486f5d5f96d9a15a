"""Random sweeps and dense paths through them, shared by the tests of barriers."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from clfcbf.constraints.barrier import Sweep
from clfcbf.scene import Scene
from clfcbf.se2 import Pose2, Twist, arc

motions = st.builds(Pose2, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
twists = st.builds(Twist, st.floats(-0.5, 0.5), st.floats(-0.8, 0.8))
sweeps = st.builds(
    Sweep.of, motions, twists, st.sampled_from([0.0, 0.12, 0.3]), twists, st.floats(0.02, 0.9)
)


def scene_of(x: float, y: float, theta: float = 0.0) -> Scene:
    return Scene(Pose2(x, y, theta), Pose2(x, y, theta), 0.0)


def rectangle(sweep: Sweep, count: int = 9) -> list[Pose2]:
    """Poses of coasting first and then following, densely."""
    return [
        sweep.motion.moved(sweep.body, e).moved(sweep.twist, s)
        for e in np.linspace(0.0, sweep.lag, count if sweep.lag else 1)
        for s in np.linspace(0.0, sweep.duration, count)
    ]


def any_order(sweep: Sweep, seed: int, paths: int = 4, steps: int = 8) -> list[Pose2]:
    """Poses on random monotone paths, the two extreme ones among them."""
    rng = np.random.default_rng(seed)
    poses = []
    for path in range(paths):
        kinds = np.repeat([0, 1], steps)
        if path == 1:
            kinds = kinds[::-1]
        elif path > 1:
            kinds = rng.permutation(kinds)
        pose = sweep.motion
        poses.append(pose)
        for kind in kinds:
            twist, whole = (sweep.body, sweep.lag) if kind else (sweep.twist, sweep.duration)
            pose = pose.compose(arc(twist, whole / steps))
            poses.append(pose)
    return poses
