"""Solves with a factorised matrix: a band with its border, by LAPACK or compiled, or a sparse one by SuperLU."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.native.bordered import BorderedKernel
from casadi_skin.zero.problem import Array, Indices

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU


class BandFactors:
    """Solves with a factorised band and its border: unknowns are eliminated in the band, then those of the border."""

    def __init__(self, width: int, lu: Array, pivots: Indices, spread: Array, below: Array, border: Array) -> None:
        from scipy.linalg.lapack import dgbtrs, dgetrf, dgetrs

        self._width, self._lu, self._pivots, self._spread, self._below = width, lu, pivots, spread, below
        self._band_solve, self._border_solve = dgbtrs, dgetrs
        self._schur, self._order, info = dgetrf(border - below @ spread)
        self.regular = info == 0

    @property
    def orientation(self) -> float:
        """The sign of the determinant: the unknown and the row that pin the band do not change it."""
        band, border = self._lu[2 * self._width], self._schur.diagonal()
        negative = np.count_nonzero(band < 0.0) + np.count_nonzero(border < 0.0)
        swaps = np.count_nonzero(self._pivots != np.arange(band.size))
        swaps += np.count_nonzero(self._order != np.arange(border.size))
        return -1.0 if (negative + swaps) % 2 else 1.0

    def completed(self, inner: Array, outer: Array) -> Array:
        """Solution, from that of the band alone for the first rows, shape (n, columns), and the remaining rows."""
        n, edge = inner.shape[0], self._schur.shape[0]
        right = np.zeros((edge, inner.shape[1]))
        right[1:] = outer
        right -= self._below @ inner
        x, _ = self._border_solve(self._schur, self._order, right)
        whole = np.empty((n + edge - 1, inner.shape[1]))
        np.subtract(inner, self._spread @ x, out=whole[:n])
        whole[n:] = x[1:]
        return whole

    def __call__(self, b: Array) -> Array:
        n, columns = self._lu.shape[1], b.reshape(b.shape[0], -1)
        inner, _ = self._band_solve(self._lu, self._width, self._width, columns[:n], self._pivots)
        return self.completed(inner, columns[n:]).reshape(b.shape)


class CompiledFactors:
    """The same by the compiled kernel; `orientation` is the sign of the determinant."""

    def __init__(self, kernel: BorderedKernel, memory: Array, orientation: float) -> None:
        self.kernel, self.memory, self.orientation = kernel, memory, orientation

    @property
    def addresses(self) -> tuple[int, int, int]:
        """Where the compiled solver, its layout and the factors begin."""
        return self.kernel.solve_address, self.kernel.address, self.memory.ctypes.data

    def __call__(self, b: Array) -> Array:
        x = np.array(b.reshape(b.shape[0], -1).T, order="C")
        self.kernel.solve(self.memory, x)
        return x.T.reshape(b.shape)


class SparseFactors:
    """Solves with factors by SuperLU of a matrix whose columns are in another order and whose rows are scaled."""

    def __init__(self, factors: SuperLU, order: Indices, scale: Array | None) -> None:
        self._factors, self._columns, self._scale = factors, order, scale

    def __call__(self, b: Array) -> Array:
        if self._scale is None:
            return np.asarray(self._factors.solve(b))
        found = np.empty(b.shape)
        found[self._columns] = self._factors.solve((self._scale * b.T).T)
        return found

    @property
    def orientation(self) -> float:
        """The sign of the determinant, 0 where it vanishes."""
        factors, permutations = self._factors, [self._factors.perm_r, self._factors.perm_c, self._columns]
        return float(np.prod([_parity(p) for p in permutations]) * np.prod(np.sign(factors.U.diagonal())))


def _parity(permutation: Indices) -> float:
    """1 for an even permutation, -1 for an odd one, by its cycles."""
    seen, sign = np.zeros(permutation.size, dtype=bool), 1.0
    for start in range(permutation.size):
        length, place = 0, start
        while not seen[place]:
            seen[place], place, length = True, int(permutation[place]), length + 1
        if length and length % 2 == 0:
            sign = -sign
    return sign
