"""Why a tick sent what it sent: conflicts are real and irreducible, sentences true, files exact."""

from __future__ import annotations

import doctest
import importlib.util
import json
import math
from fractions import Fraction
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

import clfcbf.explain as package
from clfcbf import (
    DockingController,
    FieldOfView,
    Limits,
    Observation,
    Pose2,
    Reference,
    SafetyFilter,
    Scene,
    Status,
    TrackingController,
    Twist,
    cli,
)
from clfcbf.constraints.barrier import Barrier
from clfcbf.constraints.cbf import FieldOfViewBarrier
from clfcbf.constraints.rows import Priority, Rows
from clfcbf.decision import Decision, Phase
from clfcbf.errors import ClfcbfError, ConfigurationError
from clfcbf.explain import (
    HalfPlane,
    decision_from_json,
    decision_to_json,
    decisions_in,
    explain,
    smallest_conflict,
)
from clfcbf.explain.conflict import NEGLIGIBLE
from clfcbf.guard import Verdict
from clfcbf.limits import InputBox
from clfcbf.qp.exact import BackendHealth, LexicographicSolution, solve_lexicographic
from tests.strategies import any_float

needs_cli = pytest.mark.skipif(
    importlib.util.find_spec("tyro") is None, reason="the command line needs the extra cli"
)

PERIOD = 1 / 30
LIMITS = Limits(0.22, 0.4, 0.3, 1.0)
CAMERA = FieldOfView(math.radians(35), Pose2(0.2, 0.0, 0.0))
VIEW = FieldOfViewBarrier(CAMERA, gain=2.0)
REST = Twist(0.0, 0.0)

# Conflicts --------------------------------------------------------------------------------------

small = st.integers(-4, 4)
integral_rows = st.tuples(small, small, st.integers(-6, 6)).map(lambda r: tuple(map(float, r)))
real = st.floats(-3.0, 3.0, allow_subnormal=False)
rows_of_any_kind = st.one_of(integral_rows, st.tuples(real, real, real))
planes = st.lists(
    st.tuples(rows_of_any_kind, st.booleans()).map(lambda r: (r[0], r[1])), min_size=1, max_size=9
).map(lambda items: [HalfPlane(f"r{i}", row, soft) for i, (row, soft) in enumerate(items)])


def has_point(rows: list[tuple[float, float, float]]) -> bool:
    """Fourier-Motzkin on fractions: an elimination that knows nothing of Helly or Farkas."""
    exact = [tuple(map(Fraction, row)) for row in rows]
    upper = [(-c / a, b / a) for a, c, b in exact if a > 0]  # v <= p w + q
    lower = [(-c / a, b / a) for a, c, b in exact if a < 0]
    left = [(c, b) for a, c, b in exact if a == 0]  # c w <= b
    left += [(p - r, s - q) for p, q in lower for r, s in upper]
    if any(c == 0 and b < 0 for c, b in left):
        return False
    highest = [b / c for c, b in left if c > 0]
    lowest = [b / c for c, b in left if c < 0]
    return not highest or not lowest or max(lowest) <= min(highest)


def least_relaxation(planes: list[HalfPlane]) -> float | None:
    """Smallest s that makes room, by linear programming; None where no s does."""
    A = np.array([[a, c, -math.hypot(a, c) if soft else 0.0] for _, (a, c, _), soft in planes])
    b = np.array([row[2] for _, row, _ in planes])
    bounds = [(None, None), (None, None), (0.0, None)]
    found = linprog([0.0, 0.0, 1.0], A, b, bounds=bounds, method="highs")
    return float(found.x[2]) if found.status == 0 else None


def counts(subset: tuple[HalfPlane, ...]) -> bool:
    """Whether the search looks for such a set: infeasible, with a soft member."""
    return any(plane.soft for plane in subset) and not has_point([plane.row for plane in subset])


@settings(max_examples=400)
@given(planes)
def test_conflict_is_infeasible_and_irreducible(planes: list[HalfPlane]) -> None:
    found = smallest_conflict(planes)
    if found is None:
        return
    assert not has_point([member.row for member in found.members])
    for left_out in range(len(found.members)):
        rest = [m.row for k, m in enumerate(found.members) if k != left_out]
        assert has_point(rest)
    assert any(member.soft for member in found.members)
    assert set(found.soft) | set(found.hard) == set(found.members)


@settings(max_examples=250)
@given(
    st.lists(st.tuples(integral_rows, st.booleans()), min_size=1, max_size=8).map(
        lambda items: [HalfPlane(f"r{i}", row, soft) for i, (row, soft) in enumerate(items)]
    )
)
def test_no_smaller_conflict_exists_and_none_is_missed(planes: list[HalfPlane]) -> None:
    """On small integers, whose conflicts are never as small as rounding."""
    found = smallest_conflict(planes)
    sizes = [
        size
        for size in range(1, len(planes) + 1)
        for subset in combinations(planes, size)
        if counts(subset)
        and all(has_point([p.row for p in part]) for part in combinations(subset, size - 1))
    ]
    assert (found is None) == (not sizes)
    if found is not None:
        assert len(found.members) == min(sizes)
        assert max(sizes) <= 3  # Helly


lengths = st.floats(0.1, 5.0)
offsets = st.floats(-3.0, 3.0)
softness = st.tuples(st.booleans(), st.booleans(), st.booleans()).filter(any)
opposed = st.builds(
    lambda angle, length, ratio: [
        (length * math.cos(angle), length * math.sin(angle)),
        (-ratio * length * math.cos(angle), -ratio * length * math.sin(angle)),
    ],
    st.floats(0.1, 6.0),  # so that no quarter of an entry is subnormal, and rounded
    lengths,
    st.sampled_from([0.25, 0.5, 1.0, 4.0]),
)
spanning = st.builds(
    lambda first, turns, lengths: [
        (length * math.cos(first + turn), length * math.sin(first + turn))
        for length, turn in zip(lengths, (0.0, turns[0], -turns[1]), strict=True)
    ],
    st.floats(0.0, 6.0),
    st.tuples(st.floats(1.7, 3.0), st.floats(1.7, 3.0)),  # of the circle 0.28 to 2.88 are left
    st.tuples(lengths, lengths, lengths),
)


@settings(max_examples=200)
@given(st.one_of(opposed, spanning), st.tuples(offsets, offsets, offsets), softness)
def test_shortfall_is_the_least_relaxation(
    normals: list[tuple[float, float]], b: tuple[float, float, float], soft: tuple[bool, ...]
) -> None:
    if len(normals) == 2:
        soft = (soft[0], soft[1] or not soft[0])
    planes = [HalfPlane(f"r{k}", (*normal, b[k]), soft[k]) for k, normal in enumerate(normals)]
    expected = least_relaxation(planes)
    assert expected is not None
    found = smallest_conflict(planes)
    if found is None:
        assert expected <= 1e-8
        return
    assert found.members == tuple(planes)
    assert found.short == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert set(found.shortfalls) == {plane.name for plane in planes if plane.soft}
    for name, lacking in found.shortfalls.items():
        normal = normals[int(name[1:])]
        assert lacking == pytest.approx(expected * math.hypot(*normal), rel=1e-6, abs=1e-5)


box = st.tuples(
    st.floats(-0.3, 0.3), st.floats(0.001, 0.2), st.floats(-0.5, 0.5), st.floats(0.001, 0.3)
).map(lambda t: InputBox(t[0], t[0] + t[1], t[2], t[2] + t[3]))
coefficient = st.one_of(st.just(0.0), st.floats(0.01, 2.0), st.floats(-2.0, -0.01))
row = st.tuples(coefficient, coefficient, st.floats(-1.0, 1.0))


@settings(max_examples=200)
@given(box, st.lists(row, min_size=1, max_size=5), st.lists(row, max_size=2))
def test_a_tick_has_a_conflict_exactly_where_a_level_gave_way(
    box: InputBox, barriers: list[Any], wishes: list[Any]
) -> None:
    levels = [block for block in (barriers, wishes) if block]
    answer = solve_lexicographic((1.0, 0.0, 0.3), (0.1, 0.0), box, levels)
    assert answer is not None
    margin = [s for s in answer.slacks if 0.5e-9 < s < 2e-9]
    assume(not margin)
    gave = next((k for k, slack in enumerate(answer.slacks) if slack > NEGLIGIBLE), None)
    zero = [k for k, level in enumerate(levels) for a, c, b in level if a == c == 0.0 > b]
    first = min([k for k in (gave, *zero) if k is not None], default=None)
    found = explain(decided(box, barriers, wishes)).conflict
    assert (found is None) == (first is None)
    if found is None or first is None:
        return
    given_up = {f"{'barrier' if first == 0 else 'clf'}.{k}" for k in range(len(levels[first]))}
    assert {member.name for member in found.soft} <= given_up
    if math.isfinite(found.short):
        # one subset can lack no more than the whole level does
        assert found.short <= answer.slacks[first] * (1 + 1e-6) + 1e-9


def decided(box: InputBox, barriers: list[Any], wishes: list[Any]) -> Decision:
    blocks = []
    for name, rows, priority in (
        ("barrier", barriers, Priority.SAFETY),
        ("clf", wishes, Priority.STABILITY),
    ):
        names = tuple(f"{name}.{k}" for k in range(len(rows)))
        if rows:
            blocks.append(Rows(names, tuple(rows), priority, (0.0,) * len(rows)))
    return Decision(
        Twist(0.1, 0.0), Status.OPTIMAL, True, Twist(0.1, 0.0), 0.1, rows=tuple(blocks), box=box,
        weight=(1.0, 0.0, 0.3),
    )  # fmt: skip


@settings(max_examples=200)
@given(box, st.lists(row, max_size=4), st.floats(-0.5, 0.5), st.floats(-0.8, 0.8))
def test_multipliers_balance_the_pull_of_the_nominal_command(
    box: InputBox, barriers: list[Any], v: float, omega: float
) -> None:
    r""":math:`Q(u_{nom} - u) = \sum_i \lambda_i a_i` at the program's answer, box included."""
    decision = decided(box, barriers, [])._replace(nominal=Twist(v, omega))
    levels = [barriers] if barriers else []
    answer = solve_lexicographic((1.0, 0.0, 0.3), (v, omega), box, levels)
    assert answer is not None
    assume(not answer.relaxed)
    e = explain(decision)
    rows = decision.named_rows
    normals = [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)]
    for axis, pull in enumerate((v - answer.v, 0.3 * (omega - answer.omega))):
        total = sum(r.multiplier * rows[r.name][axis] for r in e.rows)
        total += sum(x.multiplier * n[axis] for x, n in zip(e.limits, normals, strict=True))
        assert total == pytest.approx(pull, abs=1e-8)
    assert {r.name for r in e.active_rows} == {r.name for r in e.rows if r.multiplier > 0.0}


def test_shortest_sets_come_first_and_hard_ones_do_not_count() -> None:
    side = HalfPlane("v upper", (1.0, 0.0, 0.1), False)
    other = HalfPlane("v lower", (-1.0, 0.0, -0.2), False)
    assert smallest_conflict([side, other]) is None
    asked = HalfPlane("row", (-2.0, 0.0, -1.0), True)
    found = smallest_conflict([side, asked])
    assert found is not None
    assert [member.name for member in found.members] == ["v upper", "row"]
    assert found.short == pytest.approx(0.4)  # v >= 0.5 against v <= 0.1
    assert found.shortfalls == pytest.approx({"row": 0.8})
    impossible = HalfPlane("nothing", (0.0, 0.0, -0.3), True)
    found = smallest_conflict([side, asked, impossible])
    assert found is not None
    assert found.members == (impossible,)
    assert found.short == math.inf
    assert found.shortfalls == {"nothing": 0.3}


def test_rounding_is_no_conflict() -> None:
    bound = 0.1 + 0.2
    planes = [
        HalfPlane("v upper", (1.0, 0.0, 0.3), False),
        HalfPlane("row", (-1.0, 0.0, -bound), True),
    ]
    assert bound > 0.3
    assert not has_point([plane.row for plane in planes])
    assert smallest_conflict(planes) is None


@pytest.mark.parametrize("scale", [1e-300, 1e-160, 1.0, 1e150, 1e300])
def test_conflict_of_any_scale(scale: float) -> None:
    names = ("a", "b", "c")
    triangle = [(1.0, 0.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, -1.0)]
    scaled = [
        HalfPlane(n, (scale * a, scale * c, scale * b), True)
        for n, (a, c, b) in zip(names, triangle, strict=True)
    ]
    found = smallest_conflict(scaled)
    plain = smallest_conflict([HalfPlane(n, r, True) for n, r in zip(names, triangle, strict=True)])
    assert found is not None
    assert plain is not None
    assert len(found.members) == 3
    assert found.short == pytest.approx(plain.short, rel=1e-12)


# Explanations -----------------------------------------------------------------------------------


class Wall:
    """A barrier whose row asks for at least a turn rate; the clearance is what it is told."""

    name = "wall"

    def __init__(self, omega: float, clearance: float = 1.0) -> None:
        self.omega, self.value = omega, clearance

    def rows(self, *_: object, **__: object) -> Rows:
        return Rows(("wall.turn",), ((0.0, -2.0, -2.0 * self.omega),), Priority.SAFETY, (0.25,))

    def clearance_around(self, *_: object, **__: object) -> tuple[float, float]:
        return self.value, -math.inf

    def clearance(self, *_: object, **__: object) -> float:
        return self.value

    def clearance_along(self, *_: object, **__: object) -> float:
        return self.value


def scene_at(distance: float, bearing: float, stamp: float = 0.0) -> Scene:
    feature = Pose2(0.2 + distance * math.cos(bearing), distance * math.sin(bearing), 0.0)
    return Scene(feature.compose(Pose2(-0.6, 0.0, 0.0)), feature, stamp)


AHEAD = scene_at(1.8, 0.0)


def tick(
    nominal: Twist, applied: Twist = REST, barriers: Any = (VIEW,), scene: Scene = AHEAD,
    now: float = 0.0, **options: Any,
) -> Decision:  # fmt: skip
    return SafetyFilter(LIMITS, barriers, PERIOD, **options).filter(nominal, scene, applied, now)


def test_nominal_sent_as_it_is() -> None:
    e = explain(tick(Twist(0.1, 0.0), Twist(0.1, 0.0)))
    assert e.status is Status.OPTIMAL
    assert (e.active_rows, e.active_limits, e.conflict) == ((), (), None)
    assert e.nominal == e.answer == e.sent == Twist(0.1, 0.0)
    assert e.verdict is Verdict.ADMITTED
    assert str(e) == (
        "Optimal: the nominal command v = 0.1 m/s, omega = 0 rad/s was sent as it is."
    )


def test_limits_that_hold_are_named_with_their_cause() -> None:
    accelerating = explain(tick(Twist(0.5, 0.0), Twist(0.1, 0.0)))
    assert [x.name for x in accelerating.active_limits] == ["v upper (acceleration)"]
    assert accelerating.active_limits[0].reached
    assert accelerating.active_limits[0].multiplier == pytest.approx(0.5 - 0.11)
    assert "the limit v upper (acceleration) held the nominal command" in str(accelerating)
    fast = explain(tick(Twist(0.5, 0.0), Twist(0.22, 0.0)))
    assert [x.name for x in fast.active_limits] == ["v upper (speed)"]
    turning = explain(tick(Twist(0.22, -2.0), Twist(0.22, -0.39), barriers=()))
    assert [x.name for x in turning.active_limits] == ["omega lower (speed)"]
    handed_over = explain(tick(Twist(0.22, 0.0), Twist(0.55, 0.0), barriers=()))
    assert [x.name for x in handed_over.active_limits] == ["v lower (acceleration)"]


def test_row_that_holds_is_named_with_value_and_unit() -> None:
    decision = tick(Twist(0.0, -0.02), barriers=(Wall(0.01),))
    e = explain(decision, units={"wall": "m"})
    (row,) = e.active_rows
    assert (row.name, row.priority, row.value, row.unit) == ("wall.turn", 10, 0.25, "m")
    assert row.margin == pytest.approx(0.0, abs=1e-12)
    # 0.3 (omega_nom - omega) = -2 lambda
    assert row.multiplier == pytest.approx(0.3 * 0.03 / 2.0)
    assert str(e).startswith("Optimal: row wall.turn held the nominal command")
    assert explain(decision, units={"wall.turn": "rad"}).rows[0].unit == "rad"
    assert explain(decision).rows[0].unit == ""
    assert [r.unit for r in explain(tick(Twist(0.1, 0.0))).rows] == ["m", "m"]


def test_braking_says_what_was_asked_and_what_is_allowed() -> None:
    """The row asks for 0.12 rad/s, one tick from 0.0467 reaches 0.08."""
    applied = Twist(0.0, 0.08 - LIMITS.alpha_max * PERIOD)
    e = explain(tick(REST, applied, barriers=(Wall(0.12, clearance=-math.inf),)))
    assert e.conflict is not None
    names = [member.name for member in e.conflict.members]
    assert names == ["omega upper (acceleration)", "wall.turn"]
    assert e.conflict.short == pytest.approx(0.04)
    assert e.conflict.shortfalls == pytest.approx({"wall.turn": 0.08})
    assert e.barrier_slack == pytest.approx(0.04)
    braking = tick(REST, applied, barriers=(Wall(0.12),))._replace(
        status=Status.BRAKING, verdict=Verdict.BRAKED
    )
    assert str(explain(braking)).startswith(
        "Braking: row wall.turn needs omega >= 0.12 rad/s, but the acceleration limit allows at "
        "most 0.08: short by 0.04 rad/s; "
    )


def test_camera_edge_in_words() -> None:
    """At the edge, turning away too fast to stop: no command of this tick keeps the row."""
    scene = scene_at(1.0, math.radians(34.0))
    e = explain(tick(Twist(0.1, -0.4), Twist(0.1, -0.4), scene=scene))
    assert e.status is Status.BRAKING
    assert e.verdict is Verdict.BRAKED
    assert e.conflict is not None
    assert [member.name for member in e.conflict.soft] == ["fov.left"]
    text = str(e)
    assert text.startswith("Braking: the camera's left edge (fov.left) needs omega >= ")
    assert "but the acceleration limit allows at most -0.367: short by " in text
    (row,) = (r for r in e.rows if r.name == "fov.left")
    assert row.margin < 0.0


def test_guarded() -> None:
    """A gain so large that the row lets pass what cannot be stopped in view."""
    view = FieldOfViewBarrier(CAMERA, gain=50.0)
    scene = scene_at(1.0, math.radians(32.0))
    turns = (Twist(0.2, -0.02 * k) for k in range(20))
    ticks = (tick(turn, turn, barriers=(view,), scene=scene, guard_lag=0.0) for turn in turns)
    e = explain(next(decision for decision in ticks if decision.status is Status.GUARDED))
    assert e.verdict is Verdict.REPLACED
    assert e.conflict is None
    assert e.answer is not None
    assert e.answer != e.sent
    assert str(e) == (
        f"Guarded: a stop from the program's answer v = {e.answer.v:.3g} m/s, "
        f"omega = {e.answer.omega:.3g} rad/s would not stay safe, so the guard sent "
        f"v = {e.sent.v:.3g} m/s, omega = {e.sent.omega:.3g} rad/s."
    )


def test_the_barrier_of_these_tests_is_one() -> None:
    assert isinstance(Wall(0.1), Barrier)


def test_relaxed_names_what_the_lyapunov_row_gave_way_to() -> None:
    """The barrier asks for 0.11 rad/s, the Lyapunov row for no more than 0.09."""
    box = LIMITS.input_box(Twist(0.1, 0.1), PERIOD)
    barrier = Rows(("wall.turn",), ((0.0, -1.0, -0.11),), Priority.SAFETY, (0.1,))
    clf = Rows(("clf.kanayama",), ((0.0, 2.0, 0.18),), Priority.STABILITY, (0.3,))
    answer = solve_lexicographic(
        (1.0, 0.0, 0.3), (0.1, 0.0), box, [barrier.coefficients, clf.coefficients]
    )
    assert answer is not None
    decision = Decision(
        Twist(answer.v, answer.omega), Status.RELAXED, True, Twist(0.1, 0.0), 0.1,
        answer.slacks[1], answer.slacks[0], (barrier, clf), box, weight=(1.0, 0.0, 0.3),
        answer=answer, verdict=Verdict.ADMITTED, limits=LIMITS,
    )  # fmt: skip
    e = explain(decision)
    assert e.conflict is not None
    assert [m.name for m in e.conflict.hard] == ["wall.turn"]
    assert [m.name for m in e.conflict.soft] == ["clf.kanayama"]
    assert e.conflict.short == pytest.approx(0.02)
    assert e.conflict.shortfalls == pytest.approx({"clf.kanayama": 0.04})
    assert str(e).startswith(
        "Relaxed: the Lyapunov row (clf.kanayama) had to give way to row wall.turn: "
        "short by 0.02 in the plane of (v, omega); "
    )


@pytest.mark.parametrize(
    ("decision", "start"),
    [
        (tick(Twist(0.1, 0.0), now=9.0), "Stale: the last measurement is older"),
        (tick(Twist(math.nan, 0.0)), "Invalid input: an input is not finite"),
        (tick(Twist(0.1, 0.0), now=math.nan), "Clock error: the time did not advance"),
        (
            tick(Twist(0.1, 0.0), scene=scene_at(1.0, math.radians(120.0))),
            "Out of view: outside the camera's left edge (fov.left) by 0.996 m",
        ),
    ],
)
def test_faults_in_words(decision: Decision, start: str) -> None:
    text = str(explain(decision))
    assert text.startswith(start)
    assert text.endswith("; the robot is told to stand.")


def test_other_controllers() -> None:
    docking = DockingController(LIMITS, CAMERA, 0.6, PERIOD)
    waiting = docking.step(None, REST, 0.0)
    assert str(explain(waiting)) == (
        "No target (waiting): the target has not been seen often enough yet; "
        "the robot is told to stand."
    )
    seen = [docking.step(Observation(AHEAD.goal, AHEAD.feature, t), REST, t) for t in (0.1, 0.2)]
    e = explain(seen[-1])
    assert e.phase is seen[-1].phase
    assert [row.name for row in e.rows] == ["fov.left", "fov.right", "clf.kanayama"]
    assert e.rows[2].unit == "m²"
    tracking = TrackingController(LIMITS, [CAMERA], PERIOD)
    decision = tracking.step(Reference(Pose2(0.1, 0.0, 0.0), Twist(0.1, 0.0)), AHEAD, REST, 0.0)
    assert [row.name for row in explain(decision).rows][-1] == "clf.kanayama"


def test_done_and_failed() -> None:
    stood = tick(Twist(0.1, 0.0), now=9.0)._replace(status=Status.OPTIMAL)
    done = stood._replace(done=True, phase=Phase.DONE)
    assert str(explain(done)) == (
        "Optimal (done): the task is finished; the robot is told to stand."
    )
    failed = stood._replace(phase=Phase.FAILED, reason="gave up after 6 plans")
    assert "Optimal (failed): gave up after 6 plans; " in str(explain(failed))


def test_a_backend_that_lies_is_reported() -> None:
    health = BackendHealth("other", False, "optimal", math.inf, "nonsense")
    decision = tick(Twist(0.1, 0.0))
    assert decision.answer is not None
    decision = decision._replace(answer=decision.answer._replace(health=health))
    e = explain(decision)
    assert e.backend == health
    assert e.to_dict()["backend"]["distance"] is None


any_decision = st.builds(
    Decision,
    twist=st.builds(Twist, any_float, any_float),
    status=st.sampled_from(Status),
    certified=st.booleans(),
    nominal=st.builds(Twist, any_float, any_float),
    clearance=any_float,
    slack=any_float,
    barrier_slack=any_float,
    rows=st.lists(
        st.integers(0, 3).flatmap(
            lambda n: st.builds(
                Rows,
                st.lists(st.text(max_size=6), min_size=n, max_size=n).map(tuple),
                st.lists(
                    st.tuples(any_float, any_float, any_float), min_size=n, max_size=n
                ).map(tuple),
                st.one_of(st.sampled_from(Priority), st.integers(30, 40)),
                st.lists(any_float, min_size=n, max_size=n).map(tuple),
            )
        ),
        max_size=3,
    ).map(tuple),
    box=st.builds(InputBox, any_float, any_float, any_float, any_float),
    done=st.booleans(),
    phase=st.one_of(st.none(), st.sampled_from(Phase)),
    reason=st.text(max_size=8),
    timing=any_float,
    weight=st.sampled_from([None, (1.0, 0.0, 0.3), (2.0, -0.1, 0.7)]),
    answer=st.one_of(
        st.none(),
        st.builds(
            LexicographicSolution, any_float, any_float, st.lists(any_float, max_size=3).map(tuple),
            st.lists(st.integers(0, 9), max_size=2).map(tuple), st.booleans(),
            st.one_of(
                st.none(),
                st.builds(
                    BackendHealth, st.text(max_size=4), st.booleans(), st.text(max_size=4),
                    any_float, st.text(max_size=4),
                ),
            ),
        ),
    ),
    verdict=st.one_of(st.none(), st.sampled_from(Verdict)),
    limits=st.sampled_from([None, LIMITS, Limits(1.0, 1.0, 1.0, 1.0, 0.0)]),
)  # fmt: skip


@settings(max_examples=200)
@given(any_decision)
def test_any_decision_has_a_sentence_and_data(decision: Decision) -> None:
    e = explain(decision)
    text = str(e)
    assert text.startswith(decision.status.value.capitalize())
    assert text.endswith(".")
    record = json.loads(json.dumps(e.to_dict(), allow_nan=False))
    assert record["sentence"] == text
    assert len(record["rows"]) == sum(len(block.names) for block in decision.rows)


# Files ------------------------------------------------------------------------------------------


@settings(max_examples=200)
@given(any_decision)
def test_json_gives_back_every_bit(decision: Decision) -> None:
    """``repr`` tells NaN from NaN, minus zero from zero and every float from its neighbours."""
    text = json.dumps(decision_to_json(decision), allow_nan=False)
    assert repr(decision_from_json(json.loads(text))) == repr(decision)


def test_a_saved_tick_is_explained_alike() -> None:
    decision = tick(Twist(0.1, -0.4), Twist(0.1, -0.4), scene=scene_at(1.0, math.radians(34.0)))
    again = decision_from_json(json.loads(json.dumps(decision_to_json(decision))))
    assert again == decision
    assert explain(again) == explain(decision)


def test_numpy_numbers_are_saved() -> None:
    decision = tick(Twist(0.1, 0.0))._replace(twist=Twist(*np.array([0.1, 0.2])))  # type: ignore[arg-type]
    assert decision_from_json(decision_to_json(decision)).twist == Twist(0.1, 0.2)


GOOD = decision_to_json(tick(Twist(0.5, 0.0)))


def test_defaults_may_be_missing() -> None:
    least = {key: GOOD[key] for key in ("twist", "status", "certified", "nominal", "clearance")}
    decision = decision_from_json(least)
    assert decision.rows == ()
    assert decision.weight is None


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ((), [], "decision must be an object"),
        (("status",), "fine", "decision.status must be one of 'optimal', 'relaxed'"),
        (("status",), ["optimal"], "decision.status must be one of"),
        (("phase",), "running", "decision.phase must be one of 'waiting'"),
        (("verdict",), 1, "decision.verdict must be one of 'admitted'"),
        (("twist",), [1.0], "decision.twist must be an object"),
        (("twist", "omega"), None, "decision.twist.omega must be a number"),
        (("twist", "omega"), True, "decision.twist.omega must be a number"),
        (("twist", "v"), "NaN", "decision.twist.v must be a number or one of"),
        (("twist", "v"), 10**400, "decision.twist.v must be a number that a float can hold"),
        (("certified",), 1, "decision.certified must be true or false"),
        (("reason",), 1, "decision.reason must be a string"),
        (("box",), [1, 2, 3], "decision.box must be a list of 4 entries"),
        (("weight",), [1.0, 2.0, 1.0], "decision.weight: weight must be"),
        (("limits", "v_max"), -1.0, "decision.limits: v_max must be finite and positive"),
        (("limits", "v_max"), None, "decision.limits.v_max must be a number"),
        (("limits", "speed"), 1.0, "decision.limits has no field 'speed'; it has: v_max"),
        (("rows", 0, "values"), [1.0], r"rows\[0\].values must have one entry for each"),
        (("rows", 0, "names"), ["a"], r"rows\[0\].coefficients must have one entry"),
        (("rows", 0, "names", 1), 7, r"decision.rows\[0\].names\[1\] must be a string"),
        (("rows", 0, "priority"), 1.5, r"decision.rows\[0\].priority must be an integer"),
        (("rows",), {}, "decision.rows must be a list"),
        (("rows", 0, "coefficients", 1), [1.0], r"coefficients\[1\] must be a list of 3 entries"),
        (("rows", 0, "coefficients", 1, 2), "x", r"coefficients\[1\]\[2\] must be a number"),
        (("answer", "v"), None, "decision.answer.v must be a number"),
        (("answer", "violated"), [0.5], r"decision.answer.violated\[0\] must be an integer"),
        (("answer", "health"), {}, "decision.answer.health.backend is missing"),
        (("tick",), 1, "decision has no field 'tick'; it has: twist, status"),
    ],
)
def test_malformed_fields_are_named(path: tuple[Any, ...], value: Any, message: str) -> None:
    content = json.loads(json.dumps(GOOD))
    if not path:
        content = value
    else:
        place = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
    with pytest.raises(ConfigurationError, match=message):
        decision_from_json(content)


@pytest.mark.parametrize("name", ["twist", "status", "certified", "nominal", "clearance"])
def test_missing_fields_are_named(name: str) -> None:
    content = {key: value for key, value in GOOD.items() if key != name}
    with pytest.raises(ConfigurationError, match=f"decision.{name} is missing"):
        decision_from_json(content)


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), any_float, st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.sampled_from(sorted(GOOD)), inner)
    ),
    max_leaves=8,
)


@settings(max_examples=150)
@given(json_values, st.sampled_from(sorted(GOOD)))
def test_whatever_is_read_is_a_decision_or_refused(value: Any, name: str) -> None:
    for content in (value, {**GOOD, name: value}):
        try:
            decision = decision_from_json(content)
        except ClfcbfError as error:
            refusal = str(error)
        else:
            assert repr(decision_from_json(decision_to_json(decision))) == repr(decision)
            assert str(explain(decision))
            continue
        assert refusal.startswith("decision")


def test_which_of_a_list_is_malformed() -> None:
    with pytest.raises(ConfigurationError, match=r"tick 1: decision.status must be one of"):
        decisions_in([GOOD, {**GOOD, "status": "?"}])
    assert len(decisions_in(GOOD)) == 1


# Command line -----------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    ticks = [GOOD, decision_to_json(tick(Twist(0.1, 0.0), now=9.0))]
    path = tmp_path / "ticks.json"
    path.write_text(json.dumps(ticks), encoding="utf-8")
    return path


@needs_cli
def test_command(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["explain", str(saved)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("Optimal: ")
    assert lines[1].startswith("Stale: ")
    for index in ("1", "-1"):
        assert cli.main(["explain", str(saved), "--tick", index]) == 0
        assert capsys.readouterr().out.splitlines() == lines[1:]
    assert cli.main(["explain", str(saved), "--tick", "0", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["sentence"] == lines[0]
    assert record["active"] == ["v upper (acceleration)"]
    assert cli.main(["explain", str(saved), "--json"]) == 0
    assert [r["status"] for r in json.loads(capsys.readouterr().out)] == ["optimal", "stale"]


@needs_cli
def test_one_tick_in_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tick.json"
    path.write_text(json.dumps(GOOD), encoding="utf-8")
    assert cli.main(["explain", str(path)]) == 0
    assert capsys.readouterr().out == f"{explain(decision_from_json(GOOD))}\n"


@needs_cli
@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (None, [], "cannot read"),
        (b"{", [], "is not JSON"),
        (b"\xff\xfe\x00", [], "is not JSON"),
        (b"[" * 100_000, [], "is not JSON"),
        (b"[]", [], "holds no tick"),
        (b'{"status": "optimal"}', [], "decision.twist is missing"),
        (json.dumps([GOOD]).encode(), ["--tick", "1"], "--tick must be from 0 to 0"),
    ],
)
def test_command_refuses_in_one_line(
    content: bytes | None, options: list[str], message: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path = tmp_path / "tick.json"
    if content is not None:
        path.write_bytes(content)
    assert cli.main(["explain", str(path), *options]) == cli.USAGE_ERROR
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("clfcbf: ")
    assert message in captured.err
    assert captured.err.count("\n") == 1


def test_the_example_runs() -> None:
    outcome = doctest.testmod(package)
    assert outcome.attempted > 5
    assert outcome.failed == 0


def test_the_modules_of_the_room_import_in_one_direction() -> None:
    """Type-checking imports included: no two of them need each other."""
    import ast
    from pathlib import Path

    import clfcbf.explain

    needs: dict[str, set[str]] = {}
    for path in Path(clfcbf.explain.__file__).parent.glob("*.py"):
        names = {
            node.module.rpartition(".")[2]
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom)
            and (node.module or "").startswith("clfcbf.explain.")
        }
        needs[path.stem] = names
    while free := [name for name, others in needs.items() if not others & needs.keys()]:
        for name in free:
            del needs[name]
    assert not needs
