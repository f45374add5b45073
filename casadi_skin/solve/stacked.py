"""Newton steps at several states of one banded problem, as `BorderedSolver` takes them one by one.

A compiled kernel takes them one after the other. Without one, LAPACK factorises the bands one after the other, and all
else is done in arrays over the states, for which numpy needs a fraction of the time that it needs for one state after
the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.solve.bordered import ACCURATE, SINGULAR, BandLayout
from casadi_skin.zero.problem import Array, Problem


@dataclass(frozen=True)
class Steps:
    """Solutions of [dR/dz; row] x = b at several states, each (states, unknowns), and the signs of the determinants.

    `newton` is that for the residuals, that of the closing row among them, `along` for the closing row alone, and
    `response` for residuals of size 1 in general position.
    """

    newton: Array
    along: Array
    response: Array
    orientation: Array


class StackedSolver:
    """Solves for states of one problem at once."""

    def __init__(self, problem: Problem, layout: BandLayout) -> None:
        self._problem, self._layout = problem, layout
        rows, columns = problem.pattern
        self._by_rows = np.argsort(rows, kind="stable")
        self._columns = columns[self._by_rows]
        self._starts = np.searchsorted(rows[self._by_rows], np.arange(problem.size - 1))
        self._kernel = layout.kernel(problem)

    @staticmethod
    def of(problem: Problem) -> StackedSolver | None:
        """The one that serves all problems that differ in their constants only; None where there is no band."""
        if "stacked" not in problem.shared:
            layout = BandLayout.of(problem)
            full = np.unique(problem.pattern[0]).size == problem.size - 1  # no equation without an unknown
            problem.shared["stacked"] = StackedSolver(problem, layout) if layout is not None and full else None
        found: StackedSolver | None = problem.shared["stacked"]
        return found

    def steps(self, z: Array, residuals: Array, nonzeros: Array, rows: Array) -> Steps | None:
        """Solutions at states z, by residuals (states, unknowns); None where a matrix is singular but for rounding."""
        if self._kernel is not None:
            x = np.zeros((len(z), 3, z.shape[1]))
            x[:, 0], x[:, 1, :-1], x[:, 2, -1] = residuals, self._problem.probe, 1.0
            orientation = self._kernel.steps(z, nonzeros, rows, x)
            newton, response, along = x.swapaxes(0, 1)
            return None if orientation is None else Steps(newton, along, response, orientation)
        return self._in_arrays(z, residuals, nonzeros, rows)

    def _in_arrays(self, z: Array, residuals: Array, nonzeros: Array, rows: Array) -> Steps | None:
        """The same without a compiled kernel."""
        from scipy.linalg.lapack import dgbtrf, dgbtrs

        layout, (count, size), n = self._layout, z.shape, self._problem.states
        width, edge, each = layout.width, size - n + 1, np.arange(count)
        storage, right = np.zeros((count, n, 3 * width + 1)), np.zeros((count, edge + 2, n))
        below, corner = np.zeros((count, edge, n)), np.zeros((count, edge, edge))
        layout.fill(storage, right, below, corner, nonzeros)
        below[:, -1], corner[:, -1, 1:] = rows[:, :n], rows[:, n:]
        pin = np.argmax(np.abs(z[:, :n]), axis=1)
        raised = np.max(np.abs(storage[each, pin]), axis=1)
        storage[each, pin, 2 * width] += raised
        right[each, 0, pin], below[each, 0, pin], corner[:, 0, 0] = -raised, -1.0, 1.0
        right[:, -2], right[:, -1] = residuals[:, :n], self._problem.probe[:n]

        negative = np.zeros(count, dtype=np.int64)
        for i in range(count):
            lu, pivots, failed = dgbtrf(storage[i].T, width, width, overwrite_ab=True)
            dgbtrs(lu, width, width, right[i].T, pivots, overwrite_b=True)
            if failed:
                return None
            negative[i] = np.count_nonzero(lu[2 * width] < 0.0) + np.count_nonzero(pivots != np.arange(n))
        spread, inner = right[:, :edge], right[:, edge:]
        schur = corner - below @ spread.swapaxes(1, 2)
        if not np.all(np.isfinite(schur)):
            return None
        sign, _ = np.linalg.slogdet(schur)
        if not np.all(sign):
            return None
        outer = np.zeros((count, edge, 3))
        outer[:, 1:, 0], outer[:, 1:-1, 1] = residuals[:, n:], self._problem.probe[n:]
        outer[:, :, :2] -= below @ inner.swapaxes(1, 2)
        outer[:, -1, 2] = 1.0
        x = np.linalg.solve(schur, outer)
        found = np.zeros((count, 3, size))
        found[:, :2, :n] = inner
        found[:, :, :n] -= x.swapaxes(1, 2) @ spread
        found[:, :, n:] = x[:, 1:].swapaxes(1, 2)
        newton, response, along = found.swapaxes(0, 1)
        if not self._accurate(along, response, nonzeros, rows):
            return None
        return Steps(newton, along, response, np.where(negative % 2, -1.0, 1.0) * sign)

    def _accurate(self, along: Array, response: Array, nonzeros: Array, rows: Array) -> bool:
        """Whether all solutions reproduce their right-hand sides; a NaN fails every comparison."""
        if not np.max(np.abs(response)) < SINGULAR:
            return False
        largest = np.max(np.abs(along), axis=1) * np.max(np.abs(nonzeros), axis=1)
        products = np.take(nonzeros, self._by_rows, axis=1) * np.take(along, self._columns, axis=1)
        defects = np.max(np.abs(np.add.reduceat(products, self._starts, axis=1)), axis=1)
        closing = np.abs(np.einsum("ij,ij->i", rows, along) - 1.0)
        return bool(np.all(defects <= ACCURATE * largest) and np.all(closing <= ACCURATE))
