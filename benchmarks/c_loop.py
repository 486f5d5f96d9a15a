"""The exact two-input programs as a plain C loop, compiled on the spot: the batch's yardstick."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clfcbf.errors import ClfcbfError

__all__ = ["CLoop", "CompilerMissingError", "find_compiler"]

Array = NDArray[np.float64]

_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-O2", "-shared", "-fPIC", "-std=c99")
_SOURCE = Path(__file__).with_name("c_loop.c")


class CompilerMissingError(ClfcbfError):
    """No C compiler was found, or it could not compile the loop."""


def find_compiler() -> str:
    """Path of the first C compiler there is.

    Raises
    ------
    CompilerMissingError : there is none
    """
    for name in _COMPILERS:
        path = shutil.which(name)
        if path is not None:
            return path
    raise CompilerMissingError(
        f"the C loop needs a C compiler on the PATH, one of {', '.join(_COMPILERS)}; found none"
    )


class CLoop:
    """One box, one hard row and one soft row a program; one call solves all of them.

    Parameters
    ----------
    compiler : path of a C compiler; looked for if None

    Raises
    ------
    CompilerMissingError : see there
    """

    def __init__(self, compiler: str | None = None) -> None:
        path = compiler or find_compiler()
        with tempfile.TemporaryDirectory(prefix="c_loop") as folder:
            target = Path(folder) / "c_loop.so"
            command = [path, *_FLAGS, str(_SOURCE), "-o", str(target), "-lm"]
            try:
                done = subprocess.run(command, capture_output=True, text=True, check=False)
            except OSError as error:
                raise CompilerMissingError(f"{path} cannot be run: {error}") from error
            if done.returncode:
                raise CompilerMissingError(f"{' '.join(command)} failed:\n{done.stderr}")
            # Once loaded the library no longer needs its file.
            self._library = ctypes.CDLL(str(target))

    def lexicographic(
        self,
        weight: tuple[float, float, float],
        nominal: Array,
        box: Array,
        hard: Array,
        soft: Array,
    ) -> Array:
        """(v, omega, hard slack, soft slack), shape (B, 4); the last two arguments (B, 3)."""
        return self._call(self._library.solve_lexicographic, weight, (), (nominal, box, hard, soft))

    def one_shot(
        self,
        weight: tuple[float, float, float],
        nominal: Array,
        box: Array,
        hard: Array,
        soft: Array,
        penalty: float,
    ) -> Array:
        """(v, omega, delta, feasible), shape (B, 4), for the cost ``penalty * delta**2``."""
        return self._call(
            self._library.solve_one_shot,
            weight,
            (ctypes.c_double(penalty),),
            (nominal, box, hard, soft),
        )

    @staticmethod
    def _call(
        function: Callable[..., None],
        weight: tuple[float, float, float],
        extra: tuple[ctypes.c_double, ...],
        arrays: tuple[Array, ...],
    ) -> Array:
        q11, q12, q22 = weight
        if q12:
            raise ValueError(f"the C loop takes a diagonal weight, got {weight!r}")
        count = len(arrays[0])
        for array, width in zip(arrays, (2, 4, 3, 3), strict=True):
            good = array.dtype == np.float64 and array.flags.c_contiguous
            if not good or array.shape != (count, width):
                raise ValueError(f"expected contiguous float64 of shape ({count}, {width})")
        diagonal = (ctypes.c_double * 2)(q11, q22)
        out = np.empty((count, 4))
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (*arrays, out)]
        function(ctypes.c_size_t(count), diagonal, *extra, *pointers)
        return out
