"""Factors and solutions of collocation equations by compiled kernels: collocation.c, equations.c."""

from __future__ import annotations

import numpy as np

from casadi_skin.native import LANES, Array, Indices, Structure, give_back, kernels, memory_of

LAYOUT = 20 * "i" + "aaarra"
EQUATIONS = 12 * "i" + 21 * "a"
CHECKS = 3 * "i" + 7 * "a"
INTERVALS = 4 * "i" + 3 * "a"
UNITS = "iiiaarr"
NEWTON = "i" + 7 * "r"
ENDS = ("CONVERGED", "DIVERGED", "TOO_MANY_ITERATIONS", "SINGULAR")  # of Newton's method, as equations.c numbers them
LAYERS = 4 * "i" + 2 * "a"
MOST_STATES = 30  # of collocation whose blocks are taken for dense; of rings, SuperLU takes 1.5 times as long at 30


class CollocationKernel:
    """Factors and solutions of collocation equations on K intervals, closed by one more row.

    Arguments:
        sizes: numbers n of states, K of intervals, R of increments of an interval, m of scalars.
        counts: numbers of conditions and of integrals.
        pattern: rows and columns of the non-zeros, by columns.
        limits, probe: as for `BorderedKernel`; residuals of size 1 in general position.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int, int],
        counts: tuple[int, int],
        pattern: tuple[Indices, Indices],
        limits: tuple[float, float],
        probe: Array,
    ) -> None:
        n, K, R, m = sizes
        self._kernels = kernels()
        rows, columns = (each.astype(np.int64) for each in pattern)
        inner, longs, last = n * (R - 1), counts[1] + 1, 2 * n + m
        heights = [-(-height // LANES) * LANES for height in (R * n + longs, 2 * n + longs, last)]
        widths = inner + last, n + last, last
        orders = (K * R * n + (K - 1) * 2 * n + last + 1) // 2  # integers, two in the room of a real number
        room = 4 * (sum(heights) + last + longs) + n * n  # right-hand sides, or a matrix
        matrices = K * heights[0] * widths[0], (K - 1) * heights[1] * widths[1], heights[2] * last
        parts = *matrices, (n * (K + 1) + m) * longs, 2 * (K * R * n + n + m), room, orders
        at = np.cumsum([0, *(-(-part // LANES) * LANES for part in parts)])
        self._nonzeros, self._size, self.room = rows.size, n * (K * R + 1) + m, int(at[-1]) + LANES
        # Columns of each non-zero counted from x_k, x_(k+1) or the first scalar, and the rows from its interval's.
        bottom, (k, row) = n * K * R, np.divmod(rows, R * n)
        scalar, column = columns - bottom - n, columns - k * R * n
        column = np.where(column < n, column + inner, np.where(column < R * n, column - n, column))
        column = np.where(scalar >= 0, scalar + inner + 2 * n, column)
        target = (k * widths[0] + column) * heights[0] + row
        below = rows - bottom
        edge = np.where(columns < n, columns, columns - bottom + n)  # of x_0, x_K and the scalars
        target = np.where(below >= 0, at[2] + edge * heights[2] + below + n, target)
        k, column = np.divmod(np.minimum(columns, bottom), R * n)
        inside = (k * widths[0] + column - n) * heights[0] + R * n + below - counts[0]
        place = np.where(columns < bottom, k * n + column, columns - bottom + K * n)
        at_node = at[3] + place * longs + below - counts[0]
        target = np.where(below >= counts[0], np.where(column < n, at_node, inside), target)
        data = target.astype(np.int32), rows.astype(np.int32), np.searchsorted(columns, np.arange(self._size + 1))
        shape = *sizes, counts[0], longs, rows.size, *heights, *widths, *at[:-1].tolist()
        self.layout = Structure(LAYOUT, *shape, *data, *limits, probe)

    def factors(self, nonzeros: Array, row: Array, sizes: Array | None, least: float) -> tuple[Array, float] | None:
        """Factors and the sign of the determinant; None of a singular matrix.

        Arguments:
            nonzeros, row: of the Jacobian, and the closing row.
            sizes: of the unknowns, by which singular matrices are told; 1 where it is None.
            least: size of residuals of conditions, at least.
        """
        memory, sign, x = memory_of(self.room), np.empty(1), np.empty((4, self._size))
        data = nonzeros, row, sizes, least, memory, sign, x, x[3]
        if self._kernels["collocation_factors"](self.layout, *data):
            give_back(memory)
            return None
        return memory, float(sign[0])

    def corrected(
        self, equations: Structure, units: Structure | None, newton: Structure, numbers: Array, weights: Array,
        row: Array, value: float, guess: Array,
    ) -> tuple[str, int, Array, tuple[Array, Array], tuple[Array, float]]:  # fmt: skip
        """How Newton's method ends, in how many steps, and where; residual and non-zeros there, factors and their sign.

        Arguments:
            equations, units, newton: of the kinds EQUATIONS, UNITS and NEWTON; units of all unknowns are 1 without.
            numbers: lengths of the intervals, and constants.
            weights: by which steps are measured, (size,).
            row, value: of the closing equation, row . z = value.
            guess: where it starts.
        """
        z, memory, found, room = guess.copy(), memory_of(self.room), np.empty(2), np.empty(6 * self._size)
        residual, nonzeros = np.empty(self._size - 1), np.empty(self._nonzeros)
        data = equations, self.layout, units, newton, numbers, weights, row, value, memory, z, residual, nonzeros
        end = self._kernels["collocation_corrected"](*data, found, room)
        steps, sign = found.tolist()
        return ENDS[end], int(steps), z, (residual, nonzeros), (memory, sign)

    def solve(self, memory: Array, x: Array, transposed: bool = False) -> None:
        """Overwrite right-hand sides, (count, size), by solutions with factors in `memory`, or of the transpose."""
        name = "collocation_solve_transposed" if transposed else "collocation_solve"
        self._kernels[name](self.layout, memory, len(x), x)
