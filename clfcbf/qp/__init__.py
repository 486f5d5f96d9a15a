"""The QP core: exact in two inputs, any solver behind one protocol, every answer verified."""

from clfcbf.qp.backends import Backend, Capability, available_backends, get_backend
from clfcbf.qp.exact import (
    BackendHealth,
    LexicographicSolution,
    Multipliers,
    PaperSolution,
    check_weight,
    multipliers,
    paper_program,
    solve_lexicographic,
)
from clfcbf.qp.ladder import solve_ladder
from clfcbf.qp.problem import QpSolution, QpStatus, QuadraticProgram, Residuals
from clfcbf.qp.solve import solve_qp

__all__ = [
    "Backend",
    "BackendHealth",
    "Capability",
    "LexicographicSolution",
    "Multipliers",
    "PaperSolution",
    "QpSolution",
    "QpStatus",
    "QuadraticProgram",
    "Residuals",
    "available_backends",
    "check_weight",
    "get_backend",
    "multipliers",
    "paper_program",
    "solve_ladder",
    "solve_lexicographic",
    "solve_qp",
]
