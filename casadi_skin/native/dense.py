"""Factors and solutions of small closed matrices by a compiled kernel: dense.c."""

from __future__ import annotations

import numpy as np

from casadi_skin.native import Array, Indices, Structure, kernels

LAYOUT = "iiaarraa"


class DenseKernel:
    """Factors and solutions of matrices of one pattern, closed by one more row.

    Arguments:
        pattern: rows and columns of the non-zeros.
        limits, probe: as for `CollocationKernel`.
    """

    def __init__(self, pattern: tuple[Indices, Indices], limits: tuple[float, float], probe: Array) -> None:
        self._size, places = probe.size + 1, [each.astype(np.int64) for each in pattern]
        room = np.empty(self._size * (self._size + 2))
        self.layout = Structure(LAYOUT, self._size, pattern[0].size, *places, *limits, probe, room)

    def factors(self, nonzeros: Array, row: Array) -> tuple[Array, float] | None:
        """Factors and the sign of the determinant; None of a matrix that is singular but for rounding."""
        memory, sign = np.empty(self._size * (self._size + 1)), np.empty(1)
        given = (np.ascontiguousarray(each, dtype=float) for each in (nonzeros, row))
        failed = kernels()["dense_factors"](self.layout, *given, memory, sign)
        return None if failed else (memory, float(sign[0]))

    def solve(self, memory: Array, x: Array) -> None:
        """Overwrite right-hand sides, (count, size), by solutions with the factors in `memory`."""
        kernels()["dense_solve"](self.layout, memory, len(x), x)
