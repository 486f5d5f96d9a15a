r"""The quadratic program and its answer, in the notation that Python solvers share.

.. math:: \min_z\ \tfrac12 z^\top P z + q^\top z
          \quad\text{s.t.}\quad G z \le h,\quad A z = b,\quad lb \le z \le ub
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf.errors import ConfigurationError

__all__ = ["Array", "Attempt", "QpSolution", "QpStatus", "QuadraticProgram", "Residuals"]

Array = NDArray[np.float64]

_SYMMETRY = 1e-12
"""Asymmetry of P taken for rounding, relative to its largest entry."""


class QpStatus(Enum):
    """What is known of a program after a solve; only the first two come with an answer."""

    OPTIMAL = "optimal"
    """Every condition of optimality was recomputed here and holds."""
    RELAXED = "relaxed"
    """Optimal after some rows were relaxed by the least amount."""
    INFEASIBLE = "infeasible"
    """No point satisfies the rows, and a certificate of that was checked here."""
    UNBOUNDED = "unbounded"
    """The cost falls without end, and the direction was checked here."""
    ITERATION_LIMIT = "iteration limit"
    """The solver ran out of iterations."""
    TIME_LIMIT = "time limit"
    """The solver ran out of time."""
    NUMERICAL_ERROR = "numerical error"
    """The solver failed, or gave an answer that does not stand verification."""
    INVALID_INPUT = "invalid input"
    """The data holds a NaN, an infinity where none may be, or a cost that is not convex."""
    UNPROVEN = "unproven"
    """The solver calls the program infeasible, and neither that nor the contrary was proved."""

    @property
    def found(self) -> bool:
        """Whether an answer comes with this status."""
        return self is QpStatus.OPTIMAL or self is QpStatus.RELAXED


def _read_only(values: ArrayLike | None, shape: tuple[int, ...], name: str, fill: float) -> Array:
    if values is None:
        array = np.full(shape, fill)
    else:
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(f"{name} is not an array of numbers: {error}") from error
        if array.shape != shape:
            raise ConfigurationError(f"{name} must have shape {shape}, got {array.shape}")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True, init=False, eq=False)
class QuadraticProgram:
    r"""A convex quadratic program.

    Parameters
    ----------
    P : symmetric, positive semidefinite, shape (n, n)
    q : shape (n,)
    G, h : rows :math:`G z \le h`, shapes (m, n) and (m,); both or neither; ``inf`` in h for none
    lb, ub : bounds, shape (n,); infinite entries, or None, for none
    A, b : rows :math:`A z = b`, shapes (p, n) and (p,); both or neither

    Attributes
    ----------
    P, q, G, h, lb, ub, A, b : float64, read-only, filled in where None was given

    Raises
    ------
    ConfigurationError : a shape does not fit, P is not symmetric, or of G and h, or A and b, only
        one is given

    Notes
    -----
    A NaN is not refused here: :func:`clfcbf.solve_qp` answers it with ``INVALID_INPUT``.
    """

    P: Array
    q: Array
    G: Array
    h: Array
    lb: Array
    ub: Array
    A: Array
    b: Array

    def __init__(
        self,
        P: ArrayLike,
        q: ArrayLike,
        G: ArrayLike | None = None,
        h: ArrayLike | None = None,
        lb: ArrayLike | None = None,
        ub: ArrayLike | None = None,
        A: ArrayLike | None = None,
        b: ArrayLike | None = None,
    ) -> None:
        n = np.size(q)
        if n == 0:
            raise ConfigurationError("q must have at least one entry, got none")
        if (G is None) != (h is None):
            raise ConfigurationError("G and h must be given together, got only one of them")
        if (A is None) != (b is None):
            raise ConfigurationError("A and b must be given together, got only one of them")
        m = 0 if h is None else np.size(h)
        p = 0 if b is None else np.size(b)
        cost = _read_only(P, (n, n), "P", 0.0)
        if np.isfinite(cost).all():
            asymmetry = float(np.abs(cost - cost.T).max())
            if asymmetry > _SYMMETRY * float(np.abs(cost).max()):
                raise ConfigurationError(f"P must be symmetric, off by {asymmetry!r}")
        fields = {
            "P": cost,
            "q": _read_only(q, (n,), "q", 0.0),
            "G": _read_only(G, (m, n), "G", 0.0),
            "h": _read_only(h, (m,), "h", 0.0),
            "lb": _read_only(lb, (n,), "lb", -np.inf),
            "ub": _read_only(ub, (n,), "ub", np.inf),
            "A": _read_only(A, (p, n), "A", 0.0),
            "b": _read_only(b, (p,), "b", 0.0),
        }
        for name, array in fields.items():
            object.__setattr__(self, name, array)

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.q.size

    @property
    def m(self) -> int:
        r"""Number of rows :math:`G z \le h`."""
        return self.h.size

    @property
    def p(self) -> int:
        """Number of rows :math:`A z = b`."""
        return self.b.size

    @property
    def well_posed(self) -> bool:
        """Whether every number is finite, bounds and h apart, which may be infinite upward."""
        finite = (self.P.ravel(), self.q, self.G.ravel(), self.A.ravel(), self.b)
        return bool(
            np.isfinite(np.concatenate(finite)).all()
            # Comparisons that a NaN fails.
            and (self.h > -np.inf).all()
            and (self.lb < np.inf).all()
            and (self.ub > -np.inf).all()
        )


@dataclass(frozen=True, slots=True)
class Residuals:
    r"""How far a point and its multipliers are from optimal; see :func:`clfcbf.qp.verify`.

    Attributes
    ----------
    primal : largest distance to the wrong side of a row or bound, over :math:`1 + |z|_\infty`
    dual : largest entry of :math:`Pz + q + G^\top\lambda + A^\top\nu + \mu`, or multiplier of the
        wrong sign, over the largest term of that entry and its curvature :math:`P_{ii}`
    gap : largest complementarity :math:`\min(\text{distance to the row}, \text{multiplier})` of a
        row or bound, the one scaled as ``primal``, the other as ``dual``
    """

    primal: float
    dual: float
    gap: float

    @property
    def worst(self) -> float:
        """The largest of the three."""
        return max(self.primal, self.dual, self.gap)


class Attempt(NamedTuple):
    """One backend's try at a program.

    Attributes
    ----------
    backend : its name
    status : what its answer was worth, after verification
    seconds : how long it took [s]
    message : what it said, or what was wrong
    refused : whether it gave an answer that did not stand verification
    moved : by how much its answer was polished, see :class:`QpSolution`
    """

    backend: str
    status: QpStatus
    seconds: float
    message: str = ""
    refused: bool = False
    moved: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class QpSolution:
    r"""What came of a solve.

    Attributes
    ----------
    x : the answer, shape (n,), or None where there is none: never a point that failed
    status : what is known of it
    backend : name of the backend
    dual : multipliers :math:`\lambda \ge 0` of the rows, shape (m,), or None
    dual_bounds : of the bounds, shape (n,), negative at a lower bound, or None
    residuals : recomputed by :func:`clfcbf.qp.verify`, or None where there is no answer
    message : what the backend said, or what was wrong
    dual_equalities : multipliers of the rows :math:`Az = b`, of any sign, shape (p,), or None
    attempts : every backend asked, in order; filled in by :func:`clfcbf.solve_qp`
    moved : largest change of an entry of the solver's own point by the polish, over
        :math:`1 + |z|_\infty`; large where the solver was wrong and was put right
    """

    x: Array | None
    status: QpStatus
    backend: str
    dual: Array | None = None
    dual_bounds: Array | None = None
    residuals: Residuals | None = None
    message: str = ""
    dual_equalities: Array | None = None
    attempts: tuple[Attempt, ...] = ()
    moved: float = 0.0

    @property
    def found(self) -> bool:
        """Whether ``x`` is an answer."""
        return self.x is not None and self.status.found
