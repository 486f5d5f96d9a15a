"""The QP core: exact in two inputs, any solver behind one protocol, every answer verified."""

from clfcbf.qp.backends import Backend, Capability, available_backends, get_backend
from clfcbf.qp.batch import BatchSolution, BatchStatus, solve_batch
from clfcbf.qp.batch_one_shot import PaperBatchSolution, solve_batch_paper
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
from clfcbf.qp.health import SolverHealth
from clfcbf.qp.ladder import solve_ladder
from clfcbf.qp.one_shot_route import OneShotSolution, one_shot_problem, solve_one_shot
from clfcbf.qp.priorities import Ladder, LadderSolution
from clfcbf.qp.problem import Attempt, QpSolution, QpStatus, QuadraticProgram, Residuals
from clfcbf.qp.solve import FALLBACK, solve_qp

__all__ = [
    "FALLBACK",
    "Attempt",
    "Backend",
    "BackendHealth",
    "BatchSolution",
    "BatchStatus",
    "Capability",
    "Ladder",
    "LadderSolution",
    "LexicographicSolution",
    "Multipliers",
    "OneShotSolution",
    "PaperBatchSolution",
    "PaperSolution",
    "QpSolution",
    "QpStatus",
    "QuadraticProgram",
    "Residuals",
    "SolverHealth",
    "available_backends",
    "check_weight",
    "get_backend",
    "multipliers",
    "one_shot_problem",
    "paper_program",
    "solve_batch",
    "solve_batch_paper",
    "solve_ladder",
    "solve_lexicographic",
    "solve_one_shot",
    "solve_qp",
]
