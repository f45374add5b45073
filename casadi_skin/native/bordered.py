"""Solutions with banded matrices and their borders by the kernel bordered.c."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
INTEGER, POINTER = ctypes.c_int64, ctypes.c_void_p
LANES = 8  # right-hand sides that go together
MOST = 7  # unknowns beside the band
WIDEST = 64  # half bandwidth beyond which LAPACK's blocks are faster


class _Entries(ctypes.Structure):
    _fields_ = (("count", INTEGER), ("source", POINTER), ("target", POINTER))


class _Layout(ctypes.Structure):
    _fields_ = (
        *((name, INTEGER) for name in ("banded", "size", "width", "nonzeros")),
        *((name, _Entries) for name in ("inside", "right", "below", "corner")),
        *((name, POINTER) for name in ("rows", "columns")),
        *((name, ctypes.c_double) for name in ("singular", "accurate")),
        *((name, POINTER) for name in ("deep", "reach", "above")),
    )


@cache
def _functions() -> tuple[Any, Any] | None:
    """Those for steps and for solutions; None without a compiler."""
    found = library("bordered")
    if found is None:
        return None
    steps, solve = found.casadi_skin_bordered_steps, found.casadi_skin_bordered_solve
    steps.argtypes = [POINTER, INTEGER, *[POINTER] * 3, INTEGER, *[POINTER] * 4]
    steps.restype = ctypes.c_int
    solve.argtypes, solve.restype = [POINTER, POINTER, INTEGER, POINTER], None
    return steps, solve


class BorderedKernel:
    """Factors and solutions of matrices of one layout.

    Arguments:
        sizes: number of unknowns in the band, of all, and the half bandwidth.
        places: source and target of the non-zeros inside the band, right of it, below it, and in the corner.
        pattern: rows and columns of the non-zeros.
        limits: growth of a right-hand side that only a singular matrix gives, and the residual of a solution that is
            accurate, relative to the largest entries of matrix and solution.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        places: Sequence[tuple[Indices, Indices]],
        pattern: tuple[Indices, Indices],
        limits: tuple[float, float],
    ) -> None:
        functions = _functions()
        assert functions is not None
        self._steps, self._solve = functions
        self.banded, self.size, width = sizes
        held = [array for pair in (*places, pattern) for array in pair]
        self._held = [np.ascontiguousarray(array) for array in (*held, *_extents(self.banded, width, places[0][1]))]
        at = [address(array) for array in self._held]
        parts = [_Entries(places[i][0].size, at[2 * i], at[2 * i + 1]) for i in range(4)]
        self._layout = _Layout(*sizes, pattern[0].size, *parts, *at[8:10], *limits, *at[10:])
        self.address = ctypes.addressof(self._layout)
        self.solve_address = int(ctypes.cast(self._solve, POINTER).value or 0)
        edge = self.size - self.banded + 1
        room = self.banded * (3 * width + 2 + 2 * edge) + edge * (3 * edge - 1)  # integers among them
        self._room = room + LANES * (self.banded + 1)
        self._defect, self._scratch = np.empty(self.size), np.empty(self._room)

    def memory(self) -> Array:
        """Room for one factorised matrix."""
        return np.empty(self._room)

    def steps(self, z: Array, nonzeros: Array, rows: Array, x: Array, memory: Array | None = None) -> Array | None:
        """Signs of the determinants of matrices at states, (states, size); None where one is singular but for rounding.

        Right-hand sides x, (states, each, size), are overwritten by solutions; the last but one of each has residuals
        in general position, the last is for the closing row alone. `memory` keeps the factors of the last state.
        """
        arrays = [z, nonzeros, rows, x, np.empty(len(z)), self._scratch if memory is None else memory, self._defect]
        assert all(array.flags.c_contiguous for array in arrays)
        at = [address(array) for array in arrays]
        failed = self._steps(self.address, len(z), *at[:3], x.shape[1], *at[3:])
        return None if failed else arrays[4]

    def solve(self, memory: Array, x: Array) -> None:
        """Overwrite right-hand sides, (count, size), by solutions with the factors in `memory`."""
        assert x.flags.c_contiguous
        at = [address(array) for array in (memory, x)]
        self._solve(self.address, at[0], len(x), at[1])


def _extents(banded: int, width: int, targets: Indices) -> tuple[Indices, Indices, Indices]:
    """The last row with an entry in columns up to each, columns alike, and entries above the diagonal of factors.

    Rows and columns next to a tail have entries farther off than others, for which the band is wider than they need.
    """
    columns, places = np.divmod(targets, 3 * width + 1)
    rows, deep = columns + places - 2 * width, np.arange(banded)
    reach = deep.copy()
    np.maximum.at(deep, columns, rows)
    np.maximum.at(reach, rows, columns)
    deep, reach = np.maximum.accumulate(deep), np.maximum.accumulate(reach)
    return deep, reach, np.arange(banded) - np.searchsorted(reach[deep], np.arange(banded))


def bordered_kernel(
    sizes: tuple[int, int, int],
    places: Sequence[tuple[Indices, Indices]],
    pattern: tuple[Indices, Indices],
    limits: tuple[float, float],
) -> BorderedKernel | None:
    """A kernel, see `BorderedKernel`; None without a compiler, and where border or band are wide."""
    if _functions() is None or sizes[1] - sizes[0] > MOST or sizes[2] > WIDEST:
        return None
    return BorderedKernel(sizes, places, pattern, limits)
