"""Claims about all real numbers, decided by z3: proved, or refuted by a model."""

from __future__ import annotations

import z3

_TIMEOUT = 20_000  # ms


def _check(*formulas):
    solver = z3.Solver()
    solver.set("timeout", _TIMEOUT)
    solver.add(*formulas)
    return solver.check(), solver


def proved(claim, *assumptions):
    """Whether ``claim`` follows; asserts that the assumptions can be met, and that z3 decides."""
    possible, _ = _check(*assumptions)
    assert possible == z3.sat, "the assumptions contradict each other, or z3 gave up"
    answer, _ = _check(*assumptions, z3.Not(claim))
    assert answer != z3.unknown, "z3 gave up"
    return answer == z3.unsat


def reals(names):
    """Real variables, by names parted by blanks."""
    return z3.Reals(names)
