"""The rivals are what their sources say, and each run of theirs ends, within the limits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from benchmarks.baselines import METHODS, Method, Range, Setup, method_named
from benchmarks.baselines.driver import LawController
from benchmarks.baselines.graceful import GRACEFUL, GRACEFUL_RETRY
from benchmarks.baselines.graceful_law import GracefulLaw, GracefulParameters
from benchmarks.baselines.law import Answer, StopRule, arrival_speed, within
from benchmarks.baselines.ours import Deadline
from benchmarks.baselines.park_kuipers import PARK_KUIPERS, SaturatedLaw, centre_bearing
from benchmarks.baselines.polar import AICARDI, FEATURE_POLAR, PolarGains, PolarLaw
from benchmarks.baselines.pursuit import PursuitGains, PursuitLaw
from clfcbf import FieldOfView, Limits, Phase, Pose2, Status, Twist
from clfcbf.errors import ClfcbfError, ConfigurationError, GeometryError
from clfcbf.laws.park_kuipers import ParkKuipers
from clfcbf.se2 import arc
from clfcbf.simulation.episode import run_episode
from clfcbf.simulation.kinematic import KinematicPlant
from clfcbf.simulation.plant import Body
from clfcbf.simulation.scenarios import World
from clfcbf.simulation.sensor import PoseSensor, SensorModel
from clfcbf.unicycle import Polar
from tests import strategies

LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
UNLIMITED = Limits(100.0, 100.0, 1.0, 1.0)
WORLD = World()
SETUP = Setup.of(WORLD, LIMITS)
REST = Twist(0.0, 0.0)
EASY = Pose2(-1.5, 0.1, 0.0)
"""Nearly straight ahead, 10 cm beside the axis."""

gain = st.floats(0.1, 5.0)
states = st.builds(Polar, st.floats(0.3, 3.0), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))


class Covered:
    """A sensor that sees nothing while ``covered(now)``."""

    def __init__(self, sensor, plant, covered):
        self.sensor, self.plant, self.covered = sensor, plant, covered

    def capture(self):
        self.sensor.capture()

    def observe(self):
        seen = self.sensor.observe()
        return None if self.covered(self.plant.time) else seen


def drive(controller, start=EASY, covered=lambda now: False, world=WORLD):
    plant = KinematicPlant(start, LIMITS, Body.ideal(), np.random.default_rng(0))
    sensor = PoseSensor(
        plant, WORLD.camera, WORLD.standoff, SensorModel.named("ideal"), np.random.default_rng(1)
    )
    return run_episode(plant, Covered(sensor, plant, covered), controller, world, LIMITS)


# --- Nav2's law, by its own tests ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "current", "backward", "expected"),
    [
        ((3.0, 4.0, 0.8), (1.0, 1.0, -0.2), False, (3.6055512428, -0.1827937484, -1.1827937484)),
        ((3.0, 3.0, math.pi), (0.0, 0.0, 0.0), False, (4.2426405, 2.3561945, -math.pi / 4)),
        ((-3.0, -4.0, 0.8), (1.0, 1.0, -0.2), True, (6.4031243, -0.096055523, -1.0960555)),
    ],
)
def test_egocentric_coordinates_are_nav2s(target, current, backward, expected):
    """Its phi is minus our delta, its delta minus our phi; it computes in single precision."""
    seen = Pose2(*current).relative(Pose2(*target))
    rho, phi, delta = GracefulLaw(GracefulParameters()).polar(seen, backward)
    assert (rho, -delta, -phi) == pytest.approx(expected, abs=1e-6)


NAV2_TESTED = GracefulLaw(
    GracefulParameters(
        k_phi=1.0, k_delta=10.0, beta=0.2, lam=2.0, slowdown_radius=0.1, deceleration_max=2.5,
        v_linear_min=0.0, v_linear_max=1.0, v_angular_max=1.0,
    )
)  # fmt: skip


@pytest.mark.parametrize(
    ("target", "kappa", "v", "omega"),
    [
        (Pose2(0.0, 5.0, 0.0), 5.407042, 0.1460446, 0.7896695),
        (Pose2(4.5, -2.17, -0.785), -0.416228, 0.96651200, -0.4022844),
    ],
)
def test_graceful_law_gives_the_numbers_of_nav2s_tests(target, kappa, v, omega):
    assert NAV2_TESTED.curvature(NAV2_TESTED.polar(target)) == pytest.approx(kappa, abs=1e-4)
    assert NAV2_TESTED.twist(target) == pytest.approx((v, omega), abs=1e-4)


def nav2(p, target, backward):
    """The law in Nav2's own variables, from its definition."""
    x, y, yaw = target
    r, sight = math.hypot(x, y), math.atan2(-y, x) + (math.pi if backward else 0.0)
    phi = math.remainder(yaw + sight, 2.0 * math.pi)
    delta = math.remainder(sight, 2.0 * math.pi)
    steer = p.k_delta * (delta - math.atan(-p.k_phi * phi))
    steer += (1.0 + p.k_phi / (1.0 + (p.k_phi * phi) ** 2)) * math.sin(delta)
    kappa = steer / r if backward else -steer / r
    v = min(p.v_linear_max / (1.0 + p.beta * abs(kappa) ** p.lam), p.v_linear_max)
    v = min(v, p.v_linear_max * r / p.slowdown_radius, math.sqrt(2.0 * r * p.deceleration_max))
    v = max(v, p.v_linear_min) * (-1.0 if backward else 1.0)
    bound = max(-p.v_angular_max, min(p.v_angular_max, kappa * v))
    return bound / kappa if kappa else v, bound


@given(strategies.poses, st.booleans(), gain, gain, gain, st.floats(1e-4, 0.1))
def test_graceful_law_is_that_in_nav2s_variables(target, backward, k_phi, k_delta, radius, slow):
    """Radius and deceleration are drawn so that each of the speed's bounds is met."""
    assume(math.hypot(target.x, target.y) > 0.01)
    _, phi, delta = GracefulLaw(GracefulParameters()).polar(target, backward)
    assume(abs(delta) < math.pi - 1e-6)
    assume(abs(phi) < math.pi - 1e-6)  # a wrapped angle's sign is a matter of rounding there
    parameters = GracefulParameters(
        k_phi=k_phi, k_delta=k_delta, slowdown_radius=radius, deceleration_max=slow,
        v_linear_min=0.02,
    )  # fmt: skip
    command = GracefulLaw(parameters).twist(target, backward)
    assert command == pytest.approx(nav2(parameters, target, backward), rel=1e-6, abs=1e-9)


def test_graceful_stands_at_the_dock_and_as_nav2_runs_into_it():
    """Nav2 brakes from 5 cm before the dock: v²/2a = 81 mm at the speed it then has."""
    start = Pose2(-1.5, 0.0, 0.0)
    braking, _ = drive(GRACEFUL.controller(SETUP), start)
    assert braking.success
    aside, _ = drive(GRACEFUL.controller(SETUP), Pose2(-1.8, 0.5, -0.2))
    assert abs(aside.e_theta_deg) > math.degrees(StopRule().reached_theta)  # its own end, then
    assert abs(aside.e_lon_mm) < 10.0
    stock = replace(GRACEFUL.stock, trigger="threshold")
    threshold, _ = drive(GRACEFUL.controller(SETUP, stock), start)
    assert 0.031 - 0.008 < 1e-3 * threshold.e_lon_mm < 0.031 + 0.004


def test_retry_goes_back_after_a_loss_and_docks_and_none_without_it():
    def covered(now):
        return 2.0 < now < 3.5

    with_retry, trace = drive(GRACEFUL_RETRY.controller(SETUP), covered=covered)
    assert with_retry.success
    assert min(d.twist.v for d in trace.decisions) < -0.09
    _, trace = drive(GRACEFUL.controller(SETUP), covered=covered)
    assert min(d.twist.v for d in trace.decisions) >= 0.0


def test_retries_are_used_up():
    result, trace = drive(GRACEFUL_RETRY.controller(SETUP), covered=lambda now: now > 2.0)
    assert result.outcome in ("failed", "lost")
    assert "3 retries used" in trace.decisions[-1].reason


# --- the polar laws -----------------------------------------------------------------------------


@given(
    states, gain, gain, st.floats(0.1, 20.0), st.sampled_from([LIMITS, UNLIMITED]), st.booleans()
)
def test_polar_law_decays_as_stated_along_its_exact_motion(state, gamma, k, h, limits, feature):
    law = PolarLaw(PolarGains(gamma, k, h), limits, 0.6 if feature else 0.0)
    command = law.twist(state)
    assert limits.contains(command, 1e-12)

    def value(t):
        return law.lyapunov(Polar.of(arc(command, t).relative(state.pose())))

    step = 1e-5 / (1.0 + abs(command.v) + abs(command.omega))
    measured = (value(step) - value(-step)) / (2.0 * step)
    scale = (1.0 + h) * (1.0 + abs(command.v) + abs(command.omega)) ** 3 / state.rho**2
    assert law.decay(state) >= 0.0
    assert measured == pytest.approx(-law.decay(state), abs=1e-6 * scale)


@pytest.mark.parametrize("method", [AICARDI, FEATURE_POLAR])
def test_lyapunov_function_falls_along_a_runge_kutta_path(method):
    """What V loses is the integral of the decay, and near its end the path leaves δ as it is."""
    standoff = WORLD.standoff if method is FEATURE_POLAR else 0.0
    law = PolarLaw(method.stock, LIMITS, standoff)

    def flow(t, z):
        rho, phi, delta, _ = z
        v, omega = law.twist(Polar(rho, phi, delta))
        across = v / rho * math.sin(phi)
        return -v * math.cos(phi), across - omega, across, law.decay(Polar(rho, phi, delta))

    start = Polar(2.2, 0.5, -0.6)
    path = solve_ivp(flow, (0.0, 12.0), (*start, 0.0), rtol=1e-9, atol=1e-11, max_step=0.05)
    values = np.array([law.lyapunov(Polar(*z[:3])) for z in path.y.T])
    assert np.all(np.diff(values) <= 1e-9)
    assert values[0] - values == pytest.approx(path.y[3], abs=1e-5)
    assert values[-1] < 0.5 * values[0]


def test_feature_polar_law_ends_beside_the_goal_from_beside_the_axis():
    """V no longer falls at the standoff: what is left of the line of sight stays."""
    state = Polar(0.6, 0.0, 0.2)
    law = PolarLaw(FEATURE_POLAR.stock, LIMITS, 0.6)
    assert law.twist(state) == REST
    result, trace = drive(FEATURE_POLAR.controller(SETUP), Pose2(-1.8, 0.5, -0.2))
    assert result.outcome == "failed"
    assert "came to rest" in trace.decisions[-1].reason
    assert abs(result.e_lat_mm) > 30.0
    assert abs(result.e_theta_deg) > 5.0
    assert abs(result.e_lon_mm) < 10.0


# --- the others ---------------------------------------------------------------------------------


@given(st.builds(Pose2, st.floats(-3.0, 0.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)))
def test_pursuit_circle_leads_to_the_carrot(pose):
    law = PursuitLaw(PursuitGains(lookahead=0.7), LIMITS)
    x, y = carrot = pose.seen((pose.x + 0.7, 0.0))
    assume(x > 0.01)
    kappa = law.curvature(pose)
    length = math.hypot(x, y) if abs(kappa) < 1e-9 else 2.0 * math.atan2(y, x) / kappa
    end = arc(Twist(1.0, kappa), length)
    assert (end.x, end.y) == pytest.approx(carrot, abs=1e-8)


def test_pursuit_ends_with_a_turn_on_the_spot():
    _, trace = drive(method_named("pure-pursuit").controller(SETUP), Pose2(-1.2, 0.3, 0.3))
    moving = [d.twist for d in trace.decisions if abs(d.twist.omega) > 0.02]
    assert moving[-1].v < 0.01


@given(st.floats(0.05, 1.2), st.floats(-0.2, 0.5), st.floats(0.3, 3.0))
def test_centre_bearing_is_seen_at_the_edge_of_the_camera(half_angle, ahead, standoff):
    setup = Setup(LIMITS, FieldOfView(half_angle, Pose2(ahead, 0.0, 0.0)), standoff, 1 / 30)
    assume(standoff > ahead + 0.05)
    bearing = centre_bearing(setup)
    for rho in (standoff, 1.5 * standoff, 10.0 * standoff):
        point = rho * math.cos(bearing), rho * math.sin(bearing)
        assert setup.camera.margin(point) >= -1e-9
    if ahead >= 0.0:
        point = standoff * math.cos(bearing), standoff * math.sin(bearing)
        assert setup.camera.margin(point) == pytest.approx(0.0, abs=1e-9)


def test_centre_bearing_wants_a_camera_that_looks_ahead():
    aside = FieldOfView(0.6, Pose2(0.2, 0.1, 0.0))
    with pytest.raises(ConfigurationError, match="axis"):
        centre_bearing(replace(SETUP, camera=aside))
    with pytest.raises(ConfigurationError, match="sees nothing"):
        centre_bearing(Setup(LIMITS, FieldOfView(0.6, Pose2(0.7, 0.0, 0.0)), 0.6, 1 / 30))


@settings(max_examples=25)
@given(st.floats(0.8, 3.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_saturated_law_keeps_the_feature_in_view(rho, share, delta):
    """Along the path itself, the command taken at once; δ up to 57 degrees."""
    edge = centre_bearing(SETUP)
    gains = PARK_KUIPERS.stock
    core = ParkKuipers(
        gains.k_phi, gains.k_delta, gains.beta, gains.exponent, bearing_limit=gains.share * edge
    )
    law = SaturatedLaw(core, gains, LIMITS, 0.6)
    target = Polar(rho, share * edge, delta).pose()
    for _ in range(700):
        command = law.twist(Polar.of(target))
        target = arc(command, 0.03).relative(target)
        assert WORLD.camera.margin((target.x, target.y)) > -1e-3
    assert 0.0 <= Polar.of(target).rho - 0.6 < 0.05


@given(strategies.twists, strategies.limits)
def test_within_keeps_the_curvature_and_the_limits(twist, limits):
    slowed = within(twist, limits)
    assert limits.contains(slowed, 1e-12)
    assert slowed.v * twist.omega == pytest.approx(slowed.omega * twist.v, abs=1e-12)
    if limits.contains(twist):
        assert slowed == twist


@given(st.floats(0.0, 5.0), st.floats(0.1, 5.0), st.floats(0.1, 1.0))
def test_arrival_speed_stops_in_time(rest, k, brake):
    v = arrival_speed(rest, k, brake, LIMITS)
    assert 0.0 <= v <= LIMITS.v_max
    assert v * v / (2.0 * LIMITS.a_max) <= brake * rest * (1.0 + 1e-12)
    assert v <= k * rest
    assert arrival_speed(-rest, k, brake, LIMITS) == 0.0


@given(
    strategies.poses,
    st.sampled_from(["graceful", "graceful back", "aicardi", "feature", "pursuit", "saturated"]),
)
def test_laws_are_symmetric_to_the_axis(pose, name):
    """The mirror image of a pose has the mirror image of its command."""
    assume(abs(pose.y) > 1e-6)
    assume(abs(pose.theta) < 3.0)
    edge = centre_bearing(SETUP)
    saturated = SaturatedLaw(ParkKuipers(bearing_limit=edge), PARK_KUIPERS.stock, LIMITS, 0.6)

    def pursued(seen):
        law = PursuitLaw(PursuitGains(), LIMITS)
        kappa = law.curvature(seen.inverse())
        return Twist(0.1, 0.1 * kappa)

    command = {
        "graceful": GracefulLaw(GracefulParameters()).twist,
        "graceful back": lambda seen: GracefulLaw(GracefulParameters()).twist(seen, True),
        "aicardi": lambda seen: PolarLaw(AICARDI.stock, LIMITS).twist(Polar.of(seen)),
        "feature": lambda seen: PolarLaw(FEATURE_POLAR.stock, LIMITS, 0.6).twist(Polar.of(seen)),
        "pursuit": pursued,
        "saturated": lambda seen: saturated.twist(Polar.of(seen)),
    }[name]
    for angle in Polar.of(pose)[1:]:
        assume(abs(abs(angle) - math.pi) > 1e-6 and abs(angle) > 1e-6)
    v, omega = command(pose)
    mirrored = command(Pose2(pose.x, -pose.y, -pose.theta))
    assert mirrored == pytest.approx((v, -omega), rel=1e-9, abs=1e-12)


# --- the driver ---------------------------------------------------------------------------------


QUICK = [name for name in METHODS if not {"nmpc", "mpc"} & set(name.split("-"))]


@pytest.mark.parametrize("name", QUICK)
def test_every_method_docks_from_an_easy_start_within_the_limits(name):
    """But for the paper's as printed, whose Lyapunov row fades before the goal: it stalls."""
    result, trace = drive(method_named(name).controller(SETUP))
    assert result.limit_violations == 0
    assert not result.fov_lost
    if name == "paper":
        assert result.outcome == "miss"
        assert -200.0 < result.e_lon_mm < -80.0
        return
    assert result.success, (result.outcome, trace.decisions[-1].reason)
    assert trace.decisions[-1].done
    assert all(d.timing > 0.0 for d in trace.decisions)


@pytest.mark.parametrize("name", QUICK)
def test_every_method_ends_when_the_target_is_lost(name):
    result, trace = drive(method_named(name).controller(SETUP), covered=lambda now: now > 2.0)
    last = trace.decisions[-1]
    assert last.phase is Phase.FAILED
    assert last.reason
    assert last.twist == REST
    assert result.limit_violations == 0


@pytest.mark.parametrize("name", QUICK)
def test_every_method_gives_up_on_a_target_never_seen(name):
    _, trace = drive(method_named(name).controller(SETUP), covered=lambda now: True)
    last = trace.decisions[-1]
    assert last.phase is Phase.FAILED
    assert "gave up after 55 s" in last.reason
    assert last.twist == REST


class Constant:
    """A law that always says the same."""

    def __init__(self, twist, **said):
        self.answer = Answer(twist, **said)

    def command(self, view):
        return self.answer


@settings(max_examples=8)
@given(st.builds(Twist, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)))
def test_any_command_is_clipped_to_the_chassis(twist):
    """And what is not yet braked for by the stop rule goes on to the deadline at most."""
    controller = LawController(SETUP, Constant(twist), StopRule(deadline=3.0))
    result, trace = drive(controller, world=replace(WORLD, patience=6.0))
    assert result.limit_violations == 0
    assert trace.decisions[-1].phase in (Phase.FAILED, Phase.DONE)


def test_a_law_that_stands_off_the_goal_has_failed_and_near_it_is_done():
    result, trace = drive(LawController(SETUP, Constant(REST)))
    assert result.outcome == "failed"
    assert "-1500 mm, 100 mm, 0.0 degrees" in trace.decisions[-1].reason
    result, trace = drive(LawController(SETUP, Constant(REST)), Pose2(-0.02, 0.01, 0.05))
    assert result.success
    assert trace.decisions[-1].done


def test_a_law_says_itself_that_it_is_done_or_gives_up():
    result, _ = drive(LawController(SETUP, Constant(REST, arrived=True)))
    assert result.outcome == "miss"
    result, trace = drive(LawController(SETUP, Constant(REST, failure="no way")))
    assert (result.outcome, trace.decisions[-1].reason) == ("failed", "no way")


def test_a_run_through_the_goal_is_stopped_where_the_brake_ends_in_it():
    """At full speed the brake begins 81 mm before the goal."""
    result, _ = drive(LawController(SETUP, Constant(Twist(9.0, 0.0))), Pose2(-1.0, 0.001, 0.0))
    assert result.success
    assert abs(result.e_lon_mm) < 5.0 + 1e-6


def test_a_law_that_raises_is_braked_for():
    class Undefined:
        def command(self, view):
            raise GeometryError("nowhere")

    _, trace = drive(
        LawController(SETUP, Undefined(), StopRule(deadline=1.0)),
        world=replace(WORLD, patience=2.0),
    )
    assert Status.INVALID_INPUT in {d.status for d in trace.decisions}
    assert all(d.twist == REST for d in trace.decisions)
    assert any("nowhere" in d.reason for d in trace.decisions)


def test_what_the_law_is_told_is_the_truth_where_nothing_errs():
    told = []

    class Spy:
        def command(self, view):
            told.append(view)
            return Answer(Twist(0.2, 0.1))

    rule = StopRule(deadline=2.0)
    _, trace = drive(LawController(SETUP, Spy(), rule), world=replace(WORLD, patience=3.0))
    truth = dict(zip(trace.times, trace.poses, strict=True))
    for view in told:
        pose = truth[view.time]
        assert view.pose == pytest.approx(pose, abs=1e-6)
        assert view.goal == pytest.approx(pose.inverse(), abs=1e-6)
        assert view.feature == pytest.approx(pose.seen((0.6, 0.0)), abs=1e-6)
    moving = told[-1]
    ended = moving.pose
    brake = moving.applied
    ticks = LIMITS.brake_ticks(brake, WORLD.period)
    for left in range(ticks - 1, 0, -1):
        ended = ended.moved(brake.scaled(left / ticks), WORLD.period)
    assert moving.stopping == pytest.approx(ended, abs=1e-9)


def test_deadline_ends_a_controller_that_does_not():
    class Forever:
        def step(self, observation, applied, now):
            from clfcbf.decision import Decision

            box = LIMITS.input_box(applied, WORLD.period)
            return Decision(box.clip(Twist(0.1, 0.0)), Status.OPTIMAL, False, REST, 0.0)

    controller = Deadline(Forever(), LIMITS, WORLD.period, 2.0)
    result, trace = drive(controller, Pose2(-3.0, 0.0, 0.0))
    assert result.outcome == "failed"
    assert result.limit_violations == 0
    assert trace.decisions[-1].twist == REST
    assert "2 s" in trace.decisions[-1].reason


# --- methods as data ----------------------------------------------------------------------------


def test_methods_state_their_source_and_where_they_depart():
    assert list(METHODS) == [method.name for method in METHODS.values()]
    for method in METHODS.values():
        assert method.about
        assert method.source
        assert method.departures or method.name == "clf-cbf"


@pytest.mark.parametrize("name", METHODS)
def test_stock_is_inside_its_space_and_the_space_can_be_built(name):
    method = method_named(name)
    assert method.space
    for parameter, (low, high, _) in method.space.items():
        assert low <= getattr(method.stock, parameter) <= high, parameter
    for corner in (0, 1):
        values = {parameter: bounds[corner] for parameter, bounds in method.space.items()}
        changed = method.parameters(values)
        assert {k: getattr(changed, k) for k in values} == values
    assert method.parameters({}) == method.stock


@pytest.mark.parametrize("corner", [0, 1])
@pytest.mark.parametrize("name", QUICK)
def test_corners_of_the_space_run(name, corner):
    method = method_named(name)
    values = {parameter: bounds[corner] for parameter, bounds in method.space.items()}
    controller = method.controller(SETUP, method.parameters(values))
    result, _ = drive(controller, world=replace(WORLD, patience=2.0))
    assert result.limit_violations == 0


def test_what_is_wrong_is_named():
    with pytest.raises(ConfigurationError, match="graceful-retry"):
        method_named("gracefull")
    with pytest.raises(ConfigurationError, match="not tunable; choose from"):
        AICARDI.parameters({"kappa": 1.0})
    with pytest.raises(ConfigurationError, match=r"\[0\.2, 2\.0\], got 9"):
        AICARDI.parameters({"gamma": 9.0})
    stock = PolarGains(1.0, 1.0, 1.0)
    with pytest.raises(ConfigurationError, match="no parameter 'g'"):
        Method("m", "", "", (), stock, {"g": Range(1.0, 2.0)}, AICARDI.build)
    for bounds in (Range(2.0, 1.0), Range(0.0, 1.0), Range(0.0, math.inf, False)):
        with pytest.raises(ConfigurationError, match="low < high"):
            Method("m", "", "", (), stock, {"gamma": bounds}, AICARDI.build)
    with pytest.raises(ConfigurationError, match="dataclass"):
        Method("m", "", "", (), 3.0, {"gamma": Range(1.0, 2.0)}, AICARDI.build)


@pytest.mark.parametrize(
    "make",
    [
        lambda: GracefulParameters(trigger="touch"),
        lambda: GracefulParameters(v_linear_min=0.3),
        lambda: GracefulParameters(projection=-0.1),
        lambda: GracefulParameters(k_phi=0.0),
        lambda: StopRule(reached=-0.1),
        lambda: StopRule(accepted=0.0),
        lambda: StopRule(deadline=math.nan),
        lambda: PursuitGains(lookahead=-1.0),
        lambda: replace(PARK_KUIPERS.stock, share=1.0),
        lambda: PolarGains(1.0, math.nan, 1.0),
        lambda: Deadline(None, LIMITS, 1 / 30, math.inf),
        lambda: PolarLaw(AICARDI.stock, LIMITS).twist(Polar(0.0, 0.0, 0.0)),
    ],
)
def test_bad_parameters_are_refused(make):
    with pytest.raises(ClfcbfError):
        make()
