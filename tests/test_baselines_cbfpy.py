"""The rows of the paper's program, as we write them out, are those of automatic differentiation."""

import importlib
import importlib.util
import math
import warnings

import numpy as np
import pytest

from benchmarks.baselines.ours import PAPER, PAPER_TUNED
from clfcbf import Pose2, Twist
from clfcbf.constraints.bearing import paper_row
from clfcbf.constraints.clf import quartic_clf

HALF = math.radians(35.0)

pytestmark = pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("cbfpy", "jax")),
    reason="cbfpy is not installed",
)


def assembler():
    """cbfpy's rows ``(G, h)`` of the paper's program, with x = (V, target point) from the robot."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it advises on environment variables
        cbfpy = importlib.import_module("cbfpy")
    jax, jnp = importlib.import_module("jax"), importlib.import_module("jax.numpy")

    class Paper(cbfpy.CLFCBFConfig):
        """``given``: reference (v, omega), then h_x, h_y, h_theta, mu, lambda."""

        def __init__(self):
            super().__init__(n=5, m=2, init_args=(np.ones(7),), backend="elastiqp", solver_tol=1e-6)

        def f(self, z, given):
            v, omega = given[0], given[1]
            return jnp.array([v * jnp.cos(z[2]), v * jnp.sin(z[2]), omega, 0.0, 0.0])

        def g(self, z, given):
            return jnp.array([[-1.0, z[1]], [0.0, -z[0]], [0.0, -1.0], [-1.0, z[4]], [0.0, -z[3]]])

        def h_1(self, z, given):
            return jnp.array([0.5 * (HALF**2 - jnp.arctan2(z[4], z[3]) ** 2)])

        def alpha(self, h, given):
            return given[6] * h

        def V_1(self, z, z_des, given):
            return jnp.array([0.25 * jnp.dot(given[2:5], z[:3] ** 2) ** 2])

        def gamma(self, v, given):
            return given[5] * v

    return jax.jit(cbfpy.CLFCBF.from_config(Paper()).qp_data)


def test_paper_rows_are_those_of_cbfpy():
    jax = importlib.import_module("jax")
    rng = np.random.default_rng(7)
    with jax.enable_x64(True):
        assemble = assembler()
        for k in range(200):
            weights = (PAPER, PAPER_TUNED)[k % 2].stock
            config = weights.config(HALF)
            x, y, theta, v, omega = rng.uniform(-1.0, 1.0, 5).tolist()
            rho, phi = float(rng.uniform(0.3, 3.0)), float(rng.uniform(-1.0, 1.0))
            point = rho * math.cos(phi), rho * math.sin(phi)
            clf = quartic_clf(Pose2(x, y, theta), Twist(v, omega), config.H, config.mu)
            cbf = paper_row(point, HALF, config.lam)
            ours = np.array((*clf.coefficients, *cbf.coefficients))
            z = np.array([x, y, theta, *point])
            numbers = (weights.h_x, weights.h_y, weights.h_theta, weights.mu, weights.lam)
            _, _, _, _, G, h = assemble(z, np.zeros(5), np.array([v, omega, *numbers]))
            theirs = np.column_stack((np.asarray(G)[:2, :2], np.asarray(h)[:2]))
            scale = np.maximum(1.0, np.abs(theirs).max(axis=1, keepdims=True))
            assert np.all(np.abs(ours - theirs) < 1e-13 * scale)
