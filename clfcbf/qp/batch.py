r"""The exact two-input programs for many robots at once, in NumPy.

The programs of :func:`clfcbf.qp.exact.solve_lexicographic` and
:func:`clfcbf.qp.exact.paper_program` side by side: the same geometry on arrays, chunk by chunk,
so that time grows linearly and the memory beyond the arguments and the answer does not grow.
Programs that floats cannot answer to 1e-12 are solved one by one on the exact path, so an
answer depends neither on its neighbours nor on the size of the chunks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clfcbf.errors import ConfigurationError
from clfcbf.qp.batch_geometry import DELICATE, EMPTY, FINE, Array, Flags, Index, excess
from clfcbf.qp.batch_objective import Entry, Objectives
from clfcbf.qp.batch_projection import least_violation, project, unit_rows
from clfcbf.qp.lexicographic import Row, Weight, check_weight, solve_lexicographic
from clfcbf.qp.one_shot import paper_program

__all__ = ["CHUNK", "BatchSolution", "BatchStatus", "solve_batch", "solve_batch_paper"]

CHUNK = 4096
"""Programs worked on at a time: their numbers stay in a core's second-level cache (1 MB)."""
