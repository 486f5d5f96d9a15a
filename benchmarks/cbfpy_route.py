r"""cbfpy on the tick's problem: five states, two barriers, one Lyapunov function.

The state is the virtual target :math:`(x, y, \theta)` and the feature, both as seen from the
robot; cbfpy differentiates and assembles the rows that ours are written out, and solves
:math:`\min (u-\bar u)^\top Q(u-\bar u) + c\delta^2`. Two things it has no place for are put in by
an override of its right-hand side: the input box of a tick, which moves, and a decay that is not
a function of V alone.
"""

from __future__ import annotations

import functools
import importlib
import math
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from benchmarks.routes import PENALTY
from benchmarks.stream import Stream, Tick
from benchmarks.timing import Answer, Contestant
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.clf import witnessed_clf
from clfcbf.controller import TrackingConfig
from clfcbf.limits import InputBox

__all__ = ["cbfpy_routes", "rows_difference"]

TIGHT = 1e-6
"""cbfpy asks for 1e-5 or less with its elastiqp backend."""

STRICT_PENALTY = 1e5
"""Of a barrier row or a limit given up, L1: above every multiplier met here, so none is."""

_Maker = Callable[..., Any]


@functools.cache
def _cbfpy_classes() -> tuple[_Maker, Any]:
    """A configuration for ours and a CLFCBF with the moving box; imports cbfpy and JAX."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # it advises on environment variables; the command sets them
        cbfpy = importlib.import_module("cbfpy")
    jax = importlib.import_module("jax")
    jnp = importlib.import_module("jax.numpy")

    class Tracking(cbfpy.CLFCBFConfig):  # type: ignore[name-defined, misc]
        """``inputs``: reference (v, omega), then the box (v_lo, v_hi, w_lo, w_hi)."""

        def __init__(self, config: TrackingConfig, **options: Any) -> None:
            base, self.law, self.share = config.filter, config.law, config.fraction
            (barrier,) = base.barriers
            assert isinstance(barrier, FieldOfViewBarrier)
            self.gain = barrier.gain
            self.edges = barrier.edges
            q11, q12, q22 = base.weight
            self.Q = ((q11, q12), (q12, q22))
            limits = base.limits
            top = (limits.v_max, limits.omega_max)
            super().__init__(
                n=5, m=2, u_min=(limits.reverse_speed, -limits.omega_max), u_max=top,
                clf_relaxation_penalty=2.0 * PENALTY, init_args=(np.zeros(6),), **options,
            )  # fmt: skip

        def f(self, z: Any, inputs: Any) -> Any:
            v, omega = inputs[0], inputs[1]
            c, s = jnp.cos(z[2]), jnp.sin(z[2])
            return jnp.array([v * c, v * s, omega, 0.0, 0.0])

        def g(self, z: Any, inputs: Any) -> Any:
            return jnp.array([[-1.0, z[1]], [0.0, -z[0]], [0.0, -1.0], [-1.0, z[4]], [0.0, -z[3]]])

        def h_1(self, z: Any, inputs: Any) -> Any:
            return jnp.array([n_x * z[3] + n_y * z[4] - d for n_x, n_y, d in self.edges])

        def alpha(self, h: Any, inputs: Any) -> Any:
            return self.gain * h

        def V_1(self, z: Any, z_des: Any, inputs: Any) -> Any:
            half = jnp.sin(0.5 * z[2])
            return jnp.array([0.5 * (z[0] ** 2 + z[1] ** 2) + 2.0 * half**2 / self.law.k2])

        def H(self, z: Any, inputs: Any) -> Any:
            return 2.0 * jnp.array(self.Q)

        def F(self, z: Any, inputs: Any) -> Any:
            return -2.0 * jnp.array(self.Q) @ self.nominal(z, inputs)

        def nominal(self, z: Any, inputs: Any) -> Any:
            x, y, theta = z[0], z[1], z[2]
            v, omega, v_lo, v_hi, w_lo, w_hi = inputs
            law = self.law
            return jnp.array([
                jnp.clip(v * jnp.cos(theta) + law.k1 * x, v_lo, v_hi),
                jnp.clip(
                    omega + law.k2 * v * y + law.k3 * jnp.abs(v) * jnp.sin(theta), w_lo, w_hi
                ),
            ])  # fmt: skip

        def decay(self, z: Any, inputs: Any) -> Any:
            law = self.law
            turning = law.k3 / law.k2 * jnp.abs(inputs[0]) * jnp.sin(z[2]) ** 2
            return self.share * (law.k1 * z[0] ** 2 + turning)

    @jax.tree_util.register_static
    class MovingBox(cbfpy.CLFCBF):  # type: ignore[name-defined, misc]
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            self.tracking: Tracking | None = None

        def h_qp(self, z: Any, z_des: Any, inputs: Any) -> Any:
            assert self.tracking is not None
            hz, lfh = self.h_and_Lfh(z, inputs)
            _, lfv = self.V_and_LfV(z, z_des, inputs)
            decrease = -lfv - self.tracking.decay(z, inputs)
            witness = self.LgV(z, z_des, inputs) @ self.tracking.nominal(z, inputs)
            box = inputs[jnp.array([3, 5, 2, 4])] * jnp.array([1.0, 1.0, -1.0, -1.0])
            return jnp.concatenate(
                [jnp.maximum(decrease, witness), self.alpha(hz, inputs) + lfh, box]
            )

    def make(config: TrackingConfig, **options: Any) -> Any:
        tracking = Tracking(config, **options)
        filter_ = MovingBox.from_config(tracking)
        filter_.tracking = tracking
        return filter_

    return make, jax


def _double(jax: Any) -> AbstractContextManager[Any]:
    scope: AbstractContextManager[Any] = jax.enable_x64(True)
    return scope


def _job(tick: Tick) -> tuple[Any, Any, Any]:
    z = np.array([*tick.error, *tick.feature[:2]])
    inputs = np.array([*tick.inputs.reference.twist, *tick.program.box])
    return z, np.zeros(5), inputs


def cbfpy_routes(stream: Stream, exact: Sequence[tuple[float, float]]) -> list[Contestant]:
    """cbfpy in double precision with elastiqp, and as it comes: qpax, float32, tolerance 1e-3.

    Both from state to command, without prediction, guard or verification.
    """
    make, jax = _cbfpy_classes()
    config = stream.controller.config
    single = make(config)
    with _double(jax):
        double = make(
            config, backend="elastiqp", solver_tol=TIGHT,
            cbf_relaxation_penalty=STRICT_PENALTY, control_relaxation_penalty=STRICT_PENALTY,
        )  # fmt: skip

    def read(u: Any) -> Answer:
        v, omega = float(u[0]), float(u[1])
        return (v, omega) if math.isfinite(v + omega) else None

    def caller(made: Any) -> Callable[[Any], Any]:
        controller = made.controller
        return lambda job: np.asarray(controller(*job))

    jobs = [_job(tick) for tick in stream.ticks]
    name = "cbfpy controller, elastiqp, float64"
    return [
        Contestant(
            name, "tick", caller(double), jobs, read, exact, functools.partial(_double, jax)
        ),
        Contestant("cbfpy controller, defaults", "tick", caller(single), jobs, read, exact),
    ]


def rows_difference(stream: Stream, states: int = 200, seed: int = 0) -> float:
    """Largest difference between cbfpy's rows and ours, over random states and boxes."""
    make, jax = _cbfpy_classes()
    config = stream.controller.config
    base = config.filter
    (barrier,) = base.barriers
    rng = np.random.default_rng(seed)
    worst = 0.0
    with _double(jax):
        assemble = jax.jit(make(config, backend="elastiqp", solver_tol=TIGHT).qp_data)
        for tick in (stream.ticks[int(i)] for i in rng.integers(len(stream.ticks), size=states)):
            moved = rng.normal(0.0, 0.2, 8).tolist()
            error = tick.error._replace(x=moved[0], y=moved[1], theta=moved[2])
            feature = tick.feature._replace(
                x=tick.feature.x + moved[3], y=tick.feature.y + moved[4]
            )
            twist = tick.inputs.reference.twist._replace(v=moved[5], omega=moved[6])
            box = tick.program.box
            nominal = InputBox(*box).clip(config.law.command(error, twist))
            clf = witnessed_clf(error, twist, config.law, config.fraction, nominal)
            scene = tick.inputs.scene._replace(feature=feature)
            rows = (*clf.coefficients, *barrier.rows(scene).coefficients)
            z = np.array([*error, *feature[:2]])
            data = assemble(z, np.zeros(5), np.array([*twist, *box]))
            P, q, _, _, G, h = (np.asarray(part) for part in data)
            ours = np.array(rows)
            worst = max(
                worst,
                float(np.abs(G[:3, :2] - ours[:, :2]).max()),
                float(np.abs(h[:3] - ours[:, 2]).max()),
                float(np.abs(h[3:] - np.array([box[1], box[3], -box[0], -box[2]])).max()),
                float(np.abs(q[:2] + P[:2, :2] @ np.array(nominal)).max()),
            )
    return worst
