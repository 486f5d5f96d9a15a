"""A backend that fails in every way a solver can: the filter's commands do not show it."""

import json

import numpy as np
import pytest

from benchmarks import faults
from clfcbf.qp import QpStatus, SolverHealth, available_backends, get_backend, solve_qp
from clfcbf.qp.conformance import cases, check_backend

NAMES = available_backends()
SLOW = {"casadi-ipopt": 150, "qpsolvers:clarabel": 300, "qpsolvers:osqp": 300}


@pytest.mark.parametrize("name", NAMES)
def test_ticks_with_faults_stay_in_the_contract(name):
    ticks = 3000 if name == "exact" else SLOW.get(name, 600)
    result = faults.run(name, ticks, seed=1)
    assert result["outside"] == result["different"] == result["exceptions"] == 0
    assert result["uncertified"] == 0
    injected = sum(result["injected"].values())
    assert injected > 0.4 * ticks
    # What was asked was used, refused or failed; late answers are right and used.
    spoilt = injected - result["injected"].get("late", 0)
    assert result["used"] + result["refused"] + result["failed"] == result["asked"]
    assert spoilt <= result["refused"] + result["failed"] <= spoilt + 0.01 * ticks


@pytest.mark.parametrize("fault", faults.FAULTS)
def test_each_fault_alone_at_every_tick(fault):
    result = faults.run("exact", 150, seed=2, rate=1.0, faults=(fault,))
    assert result["injected"] == {fault: 150}
    assert result["outside"] == result["different"] == result["exceptions"] == 0
    assert result["used"] >= 149 if fault == "late" else result["used"] == 0


@pytest.mark.parametrize("fault", [f for f in faults.FAULTS if f != "late"])
def test_each_fault_in_a_solve(fault):
    """No exception and no wrong answer leaves ``solve_qp``; the fallback settles the program."""
    faulty = faults.Faulty(get_backend("daqp"), np.random.default_rng(0), 1.0, (fault,))
    health = SolverHealth()
    for case in cases(seed=5, count=3, families=("feasible", "degenerate", "infeasible by 1e-4")):
        alone = solve_qp(case.problem, faulty, fallback=())
        assert alone.x is None
        answer = solve_qp(case.problem, faulty, health=health)
        assert answer.status in case.expected
        if case.x is not None:
            assert answer.x == pytest.approx(case.x, abs=1e-6)
            assert answer.backend != faulty.name
    counts = health.backends[faulty.name]
    assert counts.asked == 9
    assert counts.used == 3  # infeasible: proved here, whatever it said
    assert counts.refused + counts.failed == 6
    assert health.fallbacks == 6


def test_the_conformance_suite_finds_each_fault():
    for fault in set(faults.FAULTS) - {"late"}:
        faulty = faults.Faulty(get_backend("daqp"), np.random.default_rng(0), 1.0, (fault,))
        assert not check_backend(faulty, count=2, families=("feasible",)).passed, fault


def test_a_late_answer_is_an_answer():
    faulty = faults.Faulty(get_backend("exact"), np.random.default_rng(0), 1.0, ("late",))
    (case, *_) = cases(seed=0, count=1, families=("feasible",))
    answer = solve_qp(case.problem, faulty, fallback=())
    assert answer.status is QpStatus.OPTIMAL
    assert answer.attempts[0].seconds >= faults.DELAY


def test_command_line(tmp_path, capsys):
    path = tmp_path / "faults.json"
    arguments = ["--ticks", "60", "--backends", "exact", "daqp", "--json", str(path)]
    assert faults.main(arguments) == 0
    rows = json.loads(path.read_text())["backends"]
    assert [row["backend"] for row in rows] == ["exact", "daqp"]
    assert all(row["ticks"] == 60 and row["outside"] == 0 for row in rows)
    assert "0 outside the contract" in capsys.readouterr().out


def test_every_installed_backend_is_covered_unless_told_otherwise(tmp_path, monkeypatch):
    asked = []
    whole = faults.run
    path = tmp_path / "faults.json"

    def run(backend, *arguments):
        asked.append(backend)
        done = json.loads(path.read_text())["backends"] if path.exists() else []
        assert [row["backend"] for row in done] == asked[:-1]  # what is done is on file
        return whole("exact", 2) | {"backend": backend}

    monkeypatch.setattr(faults, "run", run)
    assert faults.main(["--json", str(path)]) == 0
    assert asked == list(NAMES)
