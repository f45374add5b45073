"""Gauss-Legendre collocation of the variational system along the orbit: implicit and symplectic (Sanz-Serna 1988).

With d stages X_i of a step of length h, X' = J X gives X_i = x_0 + h sum_j a_ij J_j X_j, and X'' = J X, its velocities
eliminated, X_i = x_0 + c_i h v_0 + h^2 sum_j (a^2)_ij J_j X_j: one linear system a step, in n d unknowns for either
order of the model. Errors at the end of a step go with h^(2 d).
"""

from __future__ import annotations

import numpy as np

from casadi_skin.stability.flows import StepMap, SteppedFlow
from casadi_skin.stability.jacobian import JacobianAlong
from casadi_skin.zero.butcher import gauss_table
from casadi_skin.zero.problem import Array

STEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
DEGREE = 4
BANDED_FROM = 200  # unknowns of a stage system above which a banded solver beats a full one, where the band is narrow


class GaussMap:
    """Transition matrices of models of either order by Gauss-Legendre collocation in `steps` equal steps."""

    def __init__(self, jacobian: JacobianAlong, steps: int, order: int, degree: int = DEGREE) -> None:
        self.jacobian, self.steps, self.order, self.degree = jacobian, steps, order, degree
        table = gauss_table(degree)
        a, b = table.extended[:-1], table.extended[-1]
        self._nodes = table.nodes
        self._coupling = a if order == 1 else a @ a
        self._ends = b[None, :] if order == 1 else np.stack([b @ a, b])
        self.fractions = ((np.arange(steps)[:, None] + table.nodes) / steps).ravel()
        width = int(np.max(np.abs(jacobian.rows() - jacobian.indices), initial=0))
        self._half_bandwidth = (width + 1) * degree - 1
        unknowns = jacobian.size * degree
        self._banded = unknowns > BANDED_FROM and 8 * self._half_bandwidth < unknowns

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, (points, m, m), from J's non-zeros (points, len(fractions), non-zeros)."""
        points, n, h = durations.size, self.jacobian.size, durations / self.steps
        scaled = (nonzeros * (h**self.order)[:, None, None]).reshape(points, self.steps, self.degree, -1)
        state = np.zeros((points, self.order, n, self.order * n))
        state[:, 0, range(n), range(n)] = 1.0
        if self.order == 2:  # velocities times the step, so that no orbit's step is in the formulas
            state[:, 1, range(n), range(n, 2 * n)] = h[:, None]
        for k in range(self.steps):
            state = self._step(scaled[:, k], state)
        state[:, 1:] /= h[:, None, None, None]
        return np.asarray(state.reshape(points, self.order * n, self.order * n))

    def _step(self, coefficients: Array, state: Array) -> Array:
        """Positions and scaled velocities (points, order, n, columns) one step later; J's at the stages of the step."""
        start = state[:, 0, None]
        if self.order == 2:
            start = start + self._nodes[:, None, None] * state[:, 1, None]
        stages = self._banded_stages(coefficients, start) if self._banded else self._full_stages(coefficients, start)
        forces = self._forces(coefficients, stages)
        moved = state + np.einsum("ej,pjnc->penc", self._ends, forces)
        if self.order == 2:
            moved[:, 0] += state[:, 1]
        return np.asarray(moved)

    def _forces(self, coefficients: Array, stages: Array) -> Array:
        """J_j X_j at all stages, shape (points, degree, n, columns)."""
        points, degree, n, columns = stages.shape
        matrix = self.jacobian.block_matrix(points * degree)
        matrix.data = coefficients.ravel()
        return np.asarray(matrix @ stages.reshape(points * degree * n, columns)).reshape(stages.shape)

    def _full_stages(self, coefficients: Array, start: Array) -> Array:
        """Stages X, shape (points, degree, n, columns), by full LU factors."""
        points, degree, n, columns = (*coefficients.shape[:2], *start.shape[2:])
        J = self.jacobian.dense(coefficients)
        matrix = -np.einsum("ij,pjab->piajb", self._coupling, J).reshape(points, degree * n, degree * n)
        matrix[:, range(degree * n), range(degree * n)] += 1.0
        right = np.broadcast_to(start, (points, degree, n, columns)).reshape(points, degree * n, columns)
        return np.linalg.solve(matrix, right).reshape(points, degree, n, columns)

    def _banded_stages(self, coefficients: Array, start: Array) -> Array:
        """Stages X as above, by banded LU factors: unknowns ordered by component, then stage."""
        from scipy.linalg import solve_banded

        points, degree, n, columns = (*coefficients.shape[:2], *start.shape[2:])
        half = self._half_bandwidth
        i, j = np.indices((degree, degree))
        row = self.jacobian.rows()[:, None, None] * degree + i
        column = self.jacobian.indices[:, None, None] * degree + j
        right = np.broadcast_to(start, (points, degree, n, columns)).swapaxes(1, 2).reshape(points, n * degree, columns)
        stages = np.empty((points, n * degree, columns))
        for p in range(points):
            bands = np.zeros((2 * half + 1, n * degree))
            bands[half + row - column, column] = -self._coupling * coefficients[p].T[:, None, :]
            bands[half] += 1.0
            stages[p] = solve_banded((half, half), bands, right[p], check_finite=False)
        return stages.reshape(points, n, degree, columns).swapaxes(1, 2)


class GaussFlow(SteppedFlow):
    """Transition matrices by Gauss-Legendre collocation for models of either order."""

    method, step_numbers = "Gauss-Legendre collocation", STEPS
    orders = (2 * DEGREE,)

    def _build(self, steps: int) -> StepMap:
        return GaussMap(self.jacobian, steps, self.model.order)
