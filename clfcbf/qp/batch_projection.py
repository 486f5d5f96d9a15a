r"""Projection onto box and rows, and the least violation, of many two-input programs at once.

As :mod:`clfcbf.qp.projection` and :mod:`clfcbf.qp.relaxation` do for one; arrays as in
:mod:`clfcbf.qp.batch_geometry`.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from clfcbf.qp.batch_geometry import (
    DELICATE,
    FINE,
    NOISE,
    SMALL_ANGLE,
    Array,
    Chord,
    Flags,
    Index,
    chord,
    excess,
    inside,
    lowest,
    scale_of,
)
from clfcbf.qp.objective import CONDITION
from clfcbf.qp.polygon import TRUSTED
