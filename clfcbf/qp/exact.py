"""The exact two-input programs: plain floats in, plain floats out, no solver, no tolerance."""

from clfcbf.qp.kkt import Multipliers, multipliers
from clfcbf.qp.lexicographic import (
    BackendHealth,
    Box,
    Level,
    LexicographicSolution,
    Row,
    Weight,
    check_weight,
    solve_lexicographic,
)
from clfcbf.qp.one_shot import PaperSolution, paper_program

__all__ = [
    "BackendHealth",
    "Box",
    "Level",
    "LexicographicSolution",
    "Multipliers",
    "PaperSolution",
    "Row",
    "Weight",
    "check_weight",
    "multipliers",
    "paper_program",
    "solve_lexicographic",
]
