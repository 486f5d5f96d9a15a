"""The paper-faithful mode: exact answers, and the flaws that its printed form must show."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from clfcbf.camera import FieldOfView
from clfcbf.constraints.bearing import bearing_rows, paper_row
from clfcbf.constraints.cbf import edge_rows
from clfcbf.constraints.clf import quadratic_clf, quartic_clf
from clfcbf.constraints.rows import Rows
from clfcbf.errors import ConfigurationError, GeometryError
from clfcbf.limits import Limits
from clfcbf.paper import (
    PaperConfig,
    PaperDecision,
    paper_command,
    settling_time,
    stall_radius,
    stall_report,
    steady_state_lag,
)
from clfcbf.se2 import Point, Pose2, Twist, arc

PHI = math.radians(35.0)
REST = Twist(0.0, 0.0)
FREE = Limits(100.0, 100.0, 1e4, 1e4)
APPROACHING = Limits(0.22, 0.4, 0.3, 1.0)
FAR_AHEAD = (50.0, 0.0)
"""A target on the axis: its barrier row is 0 <= gain Phi²/2 and never in the way."""

unit = st.floats(-1.0, 1.0)
errors = st.builds(Pose2, unit, unit, st.floats(-1.5, 1.5))
speeds = st.builds(Twist, st.floats(-0.22, 0.22), st.floats(-0.4, 0.4))
ranges = st.floats(0.2, 3.0)
configs = st.builds(
    PaperConfig,
    H=st.tuples(*(st.floats(0.2, 3.0),) * 3),
    Q_u=st.tuples(*(st.floats(0.2, 3.0),) * 2),
    c_delta=st.sampled_from((1.0, 1e2, 1e4)),
    mu=st.floats(0.2, 3.0),
    lam=st.floats(0.2, 3.0),
    per_step_acceleration=st.booleans(),
    feedforward=st.booleans(),
    clf=st.sampled_from(("quartic", "quadratic")),
    barrier=st.sampled_from(("paper", "bearing", "half_plane")),
)


def at(rho: float, phi: float) -> Point:
    return rho * math.cos(phi), rho * math.sin(phi)


def simulate(
    config: PaperConfig,
    start: Pose2,
    reference: Twist,
    duration: float,
    limits: Limits = FREE,
    period: float = 0.1,
) -> list[tuple[Pose2, PaperDecision]]:
    """Both frames along their exact arcs, the command held over each period."""
    error, applied, log = start, REST, []
    for _ in range(round(duration / period)):
        decision = paper_command(config, error, reference, FAR_AHEAD, applied, limits, period)
        applied = decision.twist
        log.append((error, decision))
        error = arc(applied, period).relative(error.compose(arc(reference, period)))
    log.append((error, decision))
    return log


def rows_again(
    config: PaperConfig, error: Pose2, reference: Twist, point: Point
) -> tuple[Rows, Rows]:
    clf = {"quartic": quartic_clf, "quadratic": quadratic_clf}[config.clf]
    cbf = {
        "paper": lambda: paper_row(point, config.half_angle, config.lam),
        "bearing": lambda: bearing_rows(point, FieldOfView(config.half_angle), config.lam),
        "half_plane": lambda: edge_rows(point, FieldOfView(config.half_angle), config.lam),
    }[config.barrier]()
    return clf(error, reference, config.H, config.mu), cbf


def enumerate_kkt(
    config: PaperConfig, wanted: Twist, clf: Rows, cbf: Rows, box: tuple[float, ...]
) -> np.ndarray | None:
    """The three-variable program (v, omega, delta) by trying every active set."""
    q = np.array((*config.Q_u, config.c_delta))
    G = np.array(
        [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
        + [(*row, 0.0) for row in cbf.A.tolist()]
        + [(*clf.A[0].tolist(), -1.0)]
    )
    h = np.array([box[1], -box[0], box[3], -box[2], *cbf.b, *clf.b])
    centre = np.array((wanted.v, wanted.omega, 0.0))
    best, best_cost = None, math.inf
    for size in range(4):
        for active in itertools.combinations(range(len(h)), size):
            rows = list(active)
            K = np.zeros((3 + size, 3 + size))
            K[:3, :3] = np.diag(2.0 * q)
            K[:3, 3:], K[3:, :3] = G[rows].T, G[rows]
            try:
                z = np.linalg.solve(K, np.concatenate((2.0 * q * centre, h[rows])))[:3]
            except np.linalg.LinAlgError:
                continue
            if np.all(G @ z <= h + 1e-9):
                cost = float(q @ (z - centre) ** 2)
                if cost < best_cost - 1e-12:
                    best, best_cost = z, cost
    return best


@settings(max_examples=150)
@given(
    config=configs,
    error=errors,
    reference=speeds,
    rho=ranges,
    phi=st.floats(-1.0, 1.0),
    applied=speeds,
)
def test_answer_is_the_printed_program_s(
    config: PaperConfig, error: Pose2, reference: Twist, rho: float, phi: float, applied: Twist
) -> None:
    period, point = 1.0 / 30.0, at(rho, phi)
    step = 1.0 if config.per_step_acceleration else period
    box = (
        max(-0.22, applied.v - 0.3 * step),
        min(0.22, applied.v + 0.3 * step),
        max(-0.4, applied.omega - 1.0 * step),
        min(0.4, applied.omega + 1.0 * step),
    )
    clf, cbf = rows_again(config, error, reference, point)
    wanted = REST
    if config.feedforward:
        wanted = Twist(reference.v * math.cos(error.theta), reference.omega)
    expected = enumerate_kkt(config, wanted, clf, cbf, box)
    got = paper_command(config, error, reference, point, applied, APPROACHING, period)
    assert box[0] <= got.twist.v <= box[1]
    assert box[2] <= got.twist.omega <= box[3]
    assert clf.values[0] == got.V
    assert got.h == min(cbf.values)
    if expected is None:
        assert not got.feasible
        brake = [min(max(0.0, low), high) for low, high in (box[:2], box[2:])]
        assert got.twist == pytest.approx(brake, abs=1e-15)
    elif got.feasible:
        assert (*got.twist, got.delta) == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert np.all(cbf.A @ np.array(got.twist) <= cbf.b + 1e-12)
    else:  # the enumeration allows 1e-9, the exact program does not
        corners = np.array(list(itertools.product(box[:2], box[2:])))
        assert (corners @ cbf.A.T - cbf.b).max(axis=1).min() > -1e-8


@pytest.mark.parametrize("clf", ["quartic", "quadratic"])
@pytest.mark.parametrize("h1", [1.0, 2.0])
@pytest.mark.parametrize("c_delta", [1e3, 1e6, 1e9])
def test_stall_radius_is_where_the_speed_is_half(clf: str, h1: float, c_delta: float) -> None:
    """Far out v = mu e / n; at the radius half of it; below it falls with e^(2n-1)."""
    config = PaperConfig(H=(h1, 1.0, 1.0), Q_u=(0.7, 1.0), c_delta=c_delta, clf=clf)
    n, radius = config.degree, stall_radius(config)

    def speed(x: float) -> float:
        error = Pose2(x, 0.0, 0.0)
        return paper_command(config, error, REST, FAR_AHEAD, REST, FREE, 0.1).twist.v

    full = config.mu * radius / n
    assert speed(radius) == pytest.approx(0.5 * full, rel=1e-9)
    assert speed(30.0 * radius) == pytest.approx(30.0 * full, rel=2e-3)
    fall = math.log(speed(0.02 * radius) / speed(0.01 * radius), 2.0)
    assert fall == pytest.approx(2 * n - 1, abs=2e-3)


@pytest.mark.parametrize(
    ("c_delta", "radius"), [(1e3, 0.316), (1e6, 0.100), (1e9, 0.0316), (1.5625e16, 0.002)]
)
def test_stall_radius_of_the_quartic(c_delta: float, radius: float) -> None:
    assert stall_radius(PaperConfig(c_delta=c_delta)) == pytest.approx(radius, rel=2e-3)


@pytest.mark.parametrize(
    ("c_delta", "clf", "expected"),
    [
        (1e3, "quartic", 0.135),
        (1e4, "quartic", 0.092),
        (1e6, "quartic", 0.043),
        (1e9, "quartic", 0.014),
        (1e4, "quadratic", 1e-3),
        (1e6, "quadratic", 1e-4),
    ],
)
def test_error_left_after_two_minutes(c_delta: float, clf: str, expected: float) -> None:
    """Simulated from 1 m under |v| <= 0.22, against the closed form integrated by Runge-Kutta."""
    config = PaperConfig(c_delta=c_delta, clf=clf)
    n, radius = config.degree, stall_radius(config)

    def closed_loop(_: float, x: np.ndarray) -> np.ndarray:
        ratio = (x / radius) ** (2 * n - 2)
        return -np.minimum(0.22, config.mu * x / n * ratio / (1.0 + ratio))

    flow = solve_ivp(closed_loop, (0.0, 120.0), [1.0], method="LSODA", rtol=1e-9, atol=1e-12)
    end = simulate(config, Pose2(1.0, 0.0, 0.0), REST, 120.0, APPROACHING, 1.0 / 30.0)[-1][0]
    assert end.x == pytest.approx(float(flow.y[0, -1]), rel=5e-3)
    assert end.x == pytest.approx(expected, rel=0.07)
    assert (end.y, end.theta) == (0.0, 0.0)


@pytest.mark.parametrize("clf", ["quartic", "quadratic"])
@pytest.mark.parametrize("tolerance", [0.3, 0.05])
def test_settling_time_is_that_of_the_simulation(clf: str, tolerance: float) -> None:
    config = PaperConfig(c_delta=1e5, clf=clf, mu=2.0)
    time, period = settling_time(config, 1.0, tolerance), 0.02
    log = simulate(config, Pose2(1.0, 0.0, 0.0), REST, time + 1.0, FREE, period)
    reached = next(k for k, (error, _) in enumerate(log) if error.x <= tolerance) * period
    assert reached == pytest.approx(time, rel=0.01)
    assert settling_time(config, tolerance, tolerance) == 0.0


@pytest.mark.parametrize("clf", ["quartic", "quadratic"])
@pytest.mark.parametrize("v_V", [0.22, -0.1])
@pytest.mark.parametrize("c_delta", [1e3, 1e4, 1e6])
def test_steady_state_lag_appears(clf: str, v_V: float, c_delta: float) -> None:
    config = PaperConfig(c_delta=c_delta, clf=clf, mu=1.3, H=(1.5, 1.0, 1.0), Q_u=(0.8, 1.0))
    lag = steady_state_lag(config, v_V)
    assert lag * v_V > 0.0
    end, decision = simulate(config, Pose2(0.0, 0.0, 0.0), Twist(v_V, 0.0), 60.0, FREE, 0.02)[-1]
    assert tuple(end) == pytest.approx((lag, 0.0, 0.0), rel=1e-6, abs=1e-9)
    assert decision.twist.v == pytest.approx(v_V, rel=1e-6)
    assert decision.delta > 0.0, "a squared slack is never exact"


@pytest.mark.parametrize(
    ("clf", "expected"),
    [("quartic", (0.366, 0.263, 0.136)), ("quadratic", (0.076, 0.035, 0.0076))],
)
def test_lag_behind_a_reference_at_full_speed(clf: str, expected: tuple[float, ...]) -> None:
    for c_delta, lag in zip((1e3, 1e4, 1e6), expected, strict=True):
        config = PaperConfig(c_delta=c_delta, clf=clf)
        digit = 1e-3 if lag > 0.01 else 1e-4
        assert steady_state_lag(config, 0.22) == pytest.approx(lag, abs=0.5 * digit)


@pytest.mark.parametrize("clf", ["quartic", "quadratic"])
def test_feedforward_has_no_lag(clf: str) -> None:
    config = PaperConfig(clf=clf, feedforward=True)
    assert steady_state_lag(config, 0.22) == 0.0
    reference = Twist(0.22, 0.1)
    for error, decision in simulate(config, Pose2(0.0, 0.0, 0.0), reference, 20.0):
        assert tuple(error) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        assert decision.twist == pytest.approx(reference, abs=1e-12)


@pytest.mark.parametrize("limits", [FREE, APPROACHING])
@pytest.mark.parametrize("clf", ["quartic", "quadratic"])
def test_lateral_error_stays_for_ever(clf: str, limits: Limits) -> None:
    """300 s from (0.2, 0.3, 0): the lateral line {x = theta = 0} holds the robot."""
    config = PaperConfig(clf=clf)
    log = simulate(config, Pose2(0.2, 0.3, 0.0), REST, 300.0, limits, 1.0 / 30.0)
    end = log[-1][0]
    assert all(error.y == pytest.approx(0.3, abs=1e-12) for error, _ in log)
    assert abs(end.x) < 0.06
    # On the line itself the program pays the slack and stands still.
    there = paper_command(config, Pose2(0.0, 0.3, 0.0), REST, FAR_AHEAD, REST, limits, 0.1)
    assert there.twist == REST
    assert there.V > 0.0
    assert there.delta == pytest.approx(config.mu * there.V, rel=1e-12)


@pytest.mark.parametrize(
    ("clf", "duration", "period"), [("quartic", 300.0, 1.0 / 30.0), ("quadratic", 10.0, 1e-3)]
)
def test_general_start_ends_on_the_lateral_line(clf: str, duration: float, period: float) -> None:
    """Heading and distance close, the lateral error grows from 0.3 m to 0.44 m and stays.

    Against the closed-form answer u = -c a b / (1 + c b b') integrated by Runge-Kutta. The
    quadratic's loop gain there is c V = 1000 1/s, which sampling has to keep up with.
    """
    config, start = PaperConfig(clf=clf), Pose2(1.0, 0.3, -0.3)

    def closed_loop(_: float, e: np.ndarray) -> tuple[float, float, float]:
        square = float(e @ e)
        V = 0.25 * square**2 if clf == "quartic" else 0.5 * square
        outer = square if clf == "quartic" else 1.0
        slope = outer * np.array((-e[0], -e[2]))  # the lateral terms cancel for equal weights
        v, omega = -config.c_delta * V * slope / (1.0 + config.c_delta * slope @ slope)
        return omega * e[1] - v, -omega * e[0], -omega

    flow = solve_ivp(closed_loop, (0.0, 300.0), start, method="LSODA", rtol=1e-9, atol=1e-12)
    expected = flow.y[:, -1]
    assert expected == pytest.approx((0.0, 0.4416, 0.0), abs=1e-4)
    end = simulate(config, start, REST, duration, FREE, period)[-1][0]
    assert tuple(end) == pytest.approx(tuple(expected.tolist()), abs=5e-3)
    limited = simulate(config, start, REST, 100.0, APPROACHING, 1.0 / 30.0)[-1][0]
    assert limited.y > 0.5, "limits make it worse"


@given(
    x=st.floats(1e-9, 0.5), v_V=st.floats(0.05, 0.5), clf=st.sampled_from(("quartic", "quadratic"))
)
def test_hard_row_is_discontinuous_at_zero_error(x: float, v_V: float, clf: str) -> None:
    """Just behind the target at least its speed, just ahead of it standstill."""
    config = PaperConfig(c_delta=math.inf, clf=clf)
    n, reference = config.degree, Twist(v_V, 0.0)

    def speed(error: float) -> float:
        decision = paper_command(
            config, Pose2(error, 0.0, 0.0), reference, FAR_AHEAD, REST, FREE, 0.1
        )
        assert decision.feasible
        return decision.twist.v

    assert speed(x) == pytest.approx(v_V + config.mu * x / n, rel=1e-9)
    assert speed(0.0) == 0.0
    ahead = v_V - config.mu * x / n
    assert speed(-x) == pytest.approx(min(ahead, 0.0), abs=1e-9)


def test_hard_row_without_noise_creeps_up_from_behind() -> None:
    """Sampling alone does not chatter: from behind, the error never changes its sign."""
    config, v_V = PaperConfig(c_delta=math.inf), 0.2
    log = simulate(config, Pose2(0.1, 0.0, 0.0), Twist(v_V, 0.0), 60.0, FREE, 1.0 / 30.0)
    assert all(error.x > 0.0 for error, _ in log)
    assert all(decision.twist.v >= v_V for _, decision in log)


def test_hard_row_chatters_under_the_smallest_noise() -> None:
    """A micrometre of noise switches the speed between 0 and v_V; feedforward cures it."""
    v_V, period, rng = 0.2, 1.0 / 30.0, np.random.default_rng(3)
    reference = Twist(v_V, 0.0)
    jumps, spread = {}, {}
    for feedforward in (False, True):
        config = PaperConfig(c_delta=math.inf, feedforward=feedforward)
        x, speeds, places = 0.0, [], []
        for noise in rng.normal(0.0, 1e-6, 20000).tolist():
            seen = Pose2(x + noise, 0.0, 0.0)
            decision = paper_command(config, seen, reference, FAR_AHEAD, REST, FREE, period)
            x += (v_V - decision.twist.v) * period
            speeds.append(decision.twist.v)
            places.append(x)
        late = np.array(speeds[5000:])
        jumps[feedforward] = int(np.sum(np.abs(np.diff(late)) > 0.9 * v_V))
        spread[feedforward] = max(places[5000:]) - min(places[5000:])
    assert jumps[False] >= 4
    assert spread[False] == pytest.approx(v_V * period, rel=0.05)
    assert jumps[True] == 0
    assert spread[True] < 1e-4


def worst_outward(
    v: tuple[float, float], omega: tuple[float, float], rho: float, phi: float
) -> float:
    """Smallest outward bearing rate over a box, by its corners."""
    side = math.copysign(1.0, phi)
    return min(side * (speed / rho * math.sin(phi) - turn) for speed in v for turn in omega)


@given(
    rho=ranges,
    phi=st.floats(0.02, 1.2),
    side=st.sampled_from((-1.0, 1.0)),
    applied=speeds,
    lam=st.floats(0.3, 5.0),
    a=st.sampled_from((0.3, 1.0)),
    alpha=st.sampled_from((0.5, 1.0, 2.0)),
)
def test_when_the_barrier_row_is_infeasible(
    rho: float, phi: float, side: float, applied: Twist, lam: float, a: float, alpha: float
) -> None:
    period = 1.0 / 30.0
    config = PaperConfig(lam=lam, per_step_acceleration=False)
    limits = Limits(0.22, 0.4, a, alpha)
    v_lo = max(-0.22, applied.v - a * period)
    w_lo, w_hi = max(-0.4, applied.omega - alpha * period), min(0.4, applied.omega + alpha * period)
    least = v_lo / rho * math.sin(phi) - (w_hi if side > 0.0 else -w_lo)
    assert least == pytest.approx(
        worst_outward((v_lo, min(0.22, applied.v + a * period)), (w_lo, w_hi), rho, side * phi)
    )
    allowed = lam * (PHI**2 - phi**2) / (2.0 * phi)
    assume(abs(least - allowed) > 1e-9)
    error = Pose2(0.3, 0.1, 0.2)
    got = paper_command(config, error, REST, at(rho, side * phi), applied, limits, period)
    assert got.feasible == (least <= allowed)


@given(rho=ranges, phi=st.floats(-1.2, 1.2), lam=st.floats(0.3, 30.0))
def test_feasibility_in_the_speed_box_alone(rho: float, phi: float, lam: float) -> None:
    """Standing still meets the row inside the view; outside, the box must reach far enough."""
    config, limits = PaperConfig(lam=lam), Limits(0.22, 0.4, 1e3, 1e3)
    h = 0.5 * (PHI**2 - phi**2)
    reach = abs(phi) * (0.4 + 0.22 / rho * math.sin(abs(phi)))
    assume(abs(reach - lam * abs(h)) > 1e-9)
    got = paper_command(config, Pose2(0.3, 0.1, 0.2), REST, at(rho, phi), REST, limits, 0.1)
    assert got.h == pytest.approx(h, abs=1e-12)
    assert got.feasible == (h >= 0.0 or reach >= lam * abs(h))


def infeasible_runs(barrier: str, lam: float, alpha: float, runs: int) -> int:
    """Runs with an infeasible tick while the wanted turn rate jumps between its limits.

    A zero error leaves the Lyapunov row empty, and with feedforward the wanted command is the
    reference's: the barrier alone answers to the adversary.
    """
    period, rng = 1.0 / 30.0, np.random.default_rng(11)
    config = PaperConfig(lam=lam, barrier=barrier, feedforward=True, per_step_acceleration=False)
    limits, nothing = Limits(0.22, 0.4, 0.3, alpha), Pose2(0.0, 0.0, 0.0)
    failed = 0
    for _ in range(runs):
        point, applied = at(float(rng.uniform(1.0, 2.5)), float(rng.uniform(-0.3, 0.3))), REST
        wanted = Twist(0.0, 0.0)
        for tick in range(240):
            if tick % 15 == 0:
                wanted = Twist(float(rng.uniform(-0.22, 0.22)), float(rng.choice((-0.4, 0.4))))
            got = paper_command(config, nothing, wanted, point, applied, limits, period)
            if not got.feasible:
                failed += 1
                break
            applied = got.twist
            point = arc(applied, period).seen(point)
    return failed


def test_acceleration_limits_starve_the_papers_barrier_first() -> None:
    """Its effective gain grows toward the axis; the bearing's is the same everywhere."""
    runs = 30
    assert infeasible_runs("paper", 1.0, 0.5, runs) > 0.5 * runs
    assert infeasible_runs("bearing", 1.0, 0.5, runs) <= 0.05 * runs
    assert infeasible_runs("half_plane", 1.0, 1.0, runs) == 0
    assert infeasible_runs("half_plane", 5.0, 0.5, runs) > 0.5 * runs


def test_acceleration_limit_as_printed_lacks_the_period() -> None:
    error, period = Pose2(1.0, 0.2, 0.1), 1.0 / 30.0
    limits = Limits(0.22, 0.4, 0.03, 0.02)
    for per_step, dv, dw in ((True, 0.03, 0.02), (False, 0.03 * period, 0.02 * period)):
        config = PaperConfig(per_step_acceleration=per_step)
        got = paper_command(config, error, REST, FAR_AHEAD, REST, limits, period)
        assert got.twist.v == pytest.approx(dv, rel=1e-12)
        assert got.twist.omega == pytest.approx(dw, rel=1e-12)


@given(config=configs, error=errors, reference=speeds, rho=ranges, phi=unit, applied=speeds)
def test_mirror_image(
    config: PaperConfig, error: Pose2, reference: Twist, rho: float, phi: float, applied: Twist
) -> None:
    there = paper_command(config, error, reference, at(rho, phi), applied, APPROACHING, 0.05)
    here = paper_command(
        config,
        Pose2(error.x, -error.y, -error.theta),
        Twist(reference.v, -reference.omega),
        at(rho, -phi),
        Twist(applied.v, -applied.omega),
        APPROACHING,
        0.05,
    )
    assume(here.feasible == there.feasible)  # differs only where a row touches the box
    assert here.twist == pytest.approx((there.twist.v, -there.twist.omega), abs=1e-9)


def test_tolerance_below_the_stall_radius() -> None:
    config = PaperConfig(c_delta=1e6)
    report = stall_report(config, 0.01)
    assert report.stalls
    assert report.radius == stall_radius(config) == pytest.approx(0.1)
    assert stall_radius(replace(config, c_delta=report.c_delta)) == pytest.approx(0.01, rel=1e-9)
    assert "below the stall radius 0.1 m" in str(report)
    assert report.time == settling_time(config, 1.0, 0.01) > 1e5
    fine = stall_report(config, 0.2)
    assert not fine.stalls
    assert "above the stall radius" in str(fine)
    hard = stall_report(replace(config, c_delta=math.inf), 1e-6)
    assert (hard.stalls, hard.radius) == (False, 0.0)
    assert hard.time == pytest.approx(4.0 * math.log(1e6))
    assert steady_state_lag(replace(config, c_delta=math.inf), 0.2) == 0.0


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("H", (1.0, 0.0, 1.0)),
        ("H", ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        ("Q_u", (0.0, 1.0)),
        ("Q_u", (1.0, math.inf)),
        ("c_delta", 0.0),
        ("c_delta", math.nan),
        ("mu", -1.0),
        ("lam", math.inf),
        ("half_angle", 35.0),
        ("clf", "cubic"),
        ("barrier", "none"),
    ],
)
def test_settings_out_of_range(field: str, bad: object) -> None:
    with pytest.raises(ConfigurationError):
        PaperConfig(**{field: bad})  # type: ignore[arg-type]


def test_choices_are_named() -> None:
    with pytest.raises(ConfigurationError, match=r"quartic, quadratic.*cubic"):
        PaperConfig(clf="cubic")  # type: ignore[arg-type]


@pytest.mark.parametrize("tolerance", [0.0, -0.1, 1.1, math.nan])
def test_tolerance_out_of_range(tolerance: float) -> None:
    with pytest.raises(ConfigurationError, match="tolerance"):
        stall_report(PaperConfig(), tolerance)


def test_states_that_are_not_usable() -> None:
    config, error = PaperConfig(), Pose2(0.1, 0.1, 0.1)
    with pytest.raises(GeometryError):
        paper_command(config, Pose2(math.nan, 0.0, 0.0), REST, FAR_AHEAD, REST, FREE, 0.1)
    with pytest.raises(GeometryError):
        paper_command(config, error, REST, (math.inf, 0.0), REST, FREE, 0.1)
    with pytest.raises(GeometryError, match="bearing"):
        paper_command(config, error, REST, (0.0, 0.0), REST, FREE, 0.1)
    with pytest.raises(ConfigurationError, match="period"):
        paper_command(config, error, REST, FAR_AHEAD, REST, FREE, 0.0)
