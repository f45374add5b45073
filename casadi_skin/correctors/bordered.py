"""Linear solves with the Jacobian of an orbit problem, closed by one more row (a held unknown or an arclength row).

Banded problems are solved by LAPACK's band LU with the dense columns and rows in a border. The band alone is
singular at a linear mode (its null vector is the mode), so one unknown and one equation, at the largest entry of the
state, move to the border too; Schur complement of a bordered matrix, Keller (1977), Govaerts (2000) chapter 3.
Everything else goes to SuperLU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from casadi_skin.bvp.problem import Array, Indices, OrbitProblem

SINGULAR = 1e12  # growth of a right-hand side of size 1 that only a singular matrix gives


class SingularError(ArithmeticError):
    """The bordered matrix cannot be solved to any useful accuracy."""


Solve = Callable[[Array], Array]


@dataclass(frozen=True)
class _Band:
    """Where each non-zero of the Jacobian goes in LAPACK's band storage, and which lie in the border."""

    width: int
    inside: Indices
    place: Indices
    outside: Indices

    @classmethod
    def of(cls, problem: OrbitProblem) -> _Band | None:
        width, n = problem.half_bandwidth, problem.states
        if width is None or 3 * width >= n:
            return None
        rows, columns = problem.pattern
        inside = np.flatnonzero((rows < n) & (columns < n))
        place = (2 * width + rows[inside] - columns[inside]) * n + columns[inside]
        return cls(width, inside, place, np.flatnonzero((rows >= n) | (columns >= n)))


class BorderedSolver:
    """Factorises [dR/dz; row] for one problem; the structure is analysed once, the numbers at each call."""

    def __init__(self, problem: OrbitProblem) -> None:
        self.problem = problem
        self._band = _Band.of(problem)
        self._general = np.append(np.cos(np.arange(problem.size - 1) ** 2 % 6.25), 0.0)

    def factor(self, z: Array, nonzeros: Array, row: Array) -> Solve:
        """A function that solves [dR/dz; row] x = b for b of shape (size,) or (size, columns).

        Raises SingularError where the matrix is singular to working precision.
        """
        if self._band is not None:
            solve = self._factor_band(self._band, z, nonzeros, row)
            if self._accurate(solve, nonzeros, row):
                return solve
        solve = self._factor_sparse(nonzeros, row)
        if not self._accurate(solve, nonzeros, row):
            raise SingularError(
                "the Jacobian with its border is singular: two families meet, or a fold in what is held"
            )
        return solve

    def _accurate(self, solve: Solve, nonzeros: Array, row: Array) -> bool:
        """Whether a solve reproduces its right-hand side and the matrix is not singular.

        Tested on (0, ..., 0, 1), which gives the tangent, and on residuals in general position, whose solution is
        huge where the matrix is singular.
        """
        both = np.zeros((self.problem.size, 2))
        both[-1, 0], both[:, 1] = 1.0, self._general
        x, general = solve(both).T
        if not (np.all(np.isfinite(x)) and np.max(np.abs(general)) < SINGULAR):
            return False
        rows, columns = self.problem.pattern
        terms = nonzeros * x[columns]
        defect = np.bincount(rows, terms, minlength=self.problem.size - 1)
        return bool(np.max(np.abs(defect)) <= 1e-8 * np.max(np.abs(terms)) and abs(row @ x - 1.0) <= 1e-8)

    def _factor_band(self, band: _Band, z: Array, nonzeros: Array, row: Array) -> Solve:
        from scipy.linalg.lapack import dgbtrf, dgbtrs

        n, size, width = self.problem.states, self.problem.size, band.width
        storage = np.zeros((3 * width + 1, n))
        storage.ravel()[band.place] = nonzeros[band.inside]
        pin = int(np.argmax(np.abs(z[:n])))
        border = [pin, *range(n, size)]

        # Rows and columns of the border as dense arrays; the pinned row and column leave the band.
        rows, columns = (t[band.outside] for t in self.problem.pattern)
        dense = np.zeros((size, size - n + 1))  # columns of the border
        right = columns >= n
        dense[rows[right], columns[right] - n + 1] = nonzeros[band.outside][right]
        dense[size - 1, 1:] = row[n:]
        bottom = np.zeros((size - n + 1, n))  # rows of the border, columns of the band
        below = (rows >= n) & ~right
        bottom[rows[below] - n + 1, columns[below]] = nonzeros[band.outside][below]
        bottom[-1] = row[:n]
        near = np.arange(max(0, pin - width), min(n, pin + width + 1))
        dense[near, 0] = storage[2 * width + near - pin, pin]
        bottom[0, near] = storage[2 * width + pin - near, near]
        dense[n:, 0] = bottom[1:, pin]
        storage[2 * width + near - pin, pin] = 0.0
        storage[2 * width + pin - near, near] = 0.0
        storage[2 * width, pin] = 1.0
        bottom[:, pin] = 0.0
        corner = dense[border]
        dense = dense[:n].copy()
        dense[pin] = 0.0

        lu, pivots, info = dgbtrf(storage, width, width, overwrite_ab=True)
        if info != 0:
            return lambda b: np.full(b.shape, np.nan)
        spread, _ = dgbtrs(lu, width, width, dense, pivots)
        schur = corner - bottom @ spread

        def solve(b: Array) -> Array:
            columns_of_b = b.reshape(size, -1)
            inner = columns_of_b[:n].copy()
            inner[pin] = 0.0
            y, _ = dgbtrs(lu, width, width, inner, pivots)
            try:
                edge = np.linalg.solve(schur, columns_of_b[border] - bottom @ y)
            except np.linalg.LinAlgError:
                return np.full(b.shape, np.nan)
            x = np.empty_like(columns_of_b)
            x[:n] = y - spread @ edge
            x[border] = edge
            return x.reshape(b.shape)

        return solve

    def _factor_sparse(self, nonzeros: Array, row: Array) -> Solve:
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        size = self.problem.size
        rows, columns = self.problem.pattern
        last = np.flatnonzero(row)
        matrix = csc_matrix(
            (
                np.concatenate([nonzeros, row[last]]),
                (np.concatenate([rows, np.full(last.size, size - 1)]), np.concatenate([columns, last])),
            ),
            shape=(size, size),
        )
        try:
            return splu(matrix).solve
        except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
            raise SingularError(f"the Jacobian with its border cannot be factorised: {error}") from error
