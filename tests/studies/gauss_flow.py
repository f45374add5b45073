"""Gauss-Legendre collocation of the variational system along the orbit: implicit and symplectic (Sanz-Serna 1988).

With d stages X_i of a step of length h, X' = J X gives X_i = x_0 + h sum_j a_ij J_j X_j, and X'' = J X, its velocities
eliminated, X_i = x_0 + c_i h v_0 + h^2 sum_j (a^2)_ij J_j X_j: one linear system a step, in n d unknowns for either
order of the model. Errors at the end of a step go with h^(2 d).
"""

from __future__ import annotations

import numpy as np

from casadi_skin.stability.flows import JacobianAlong, StepMap, SteppedFlow
from casadi_skin.zero.butcher import gauss_table
from casadi_skin.zero.problem import Array

DEGREE = 4


def dense(jacobian: JacobianAlong, nonzeros: Array) -> Array:
    """J as full matrices, shape (..., non-zeros) -> (..., size, size)."""
    matrices = np.zeros((*nonzeros.shape[:-1], jacobian.size, jacobian.size))
    matrices[..., jacobian.rows(), jacobian.indices] = nonzeros
    return matrices


class GaussMap:
    """Transition matrices of models of either order by Gauss-Legendre collocation in `steps` equal steps."""

    def __init__(self, jacobian: JacobianAlong, steps: int, order: int) -> None:
        self.jacobian, self.steps, self.order, table = jacobian, steps, order, gauss_table(DEGREE)
        a, b = table.extended[:-1], table.extended[-1]
        self.nodes = table.nodes
        self.coupling = a if order == 1 else a @ a
        self.ends = b[None, :] if order == 1 else np.stack([b @ a, b])
        self.fractions = ((np.arange(steps)[:, None] + table.nodes) / steps).ravel()

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, (points, m, m), from J's non-zeros (points, len(fractions), non-zeros)."""
        points, n, h = durations.size, self.jacobian.size, durations / self.steps
        J = dense(self.jacobian, nonzeros * (h**self.order)[:, None, None]).reshape(points, self.steps, DEGREE, n, n)
        state = np.zeros((points, self.order, n, self.order * n))
        state[:, 0, range(n), range(n)] = 1.0
        if self.order == 2:  # velocities times the step, so that no orbit's step is in the formulas
            state[:, 1, range(n), range(n, 2 * n)] = h[:, None]
        for k in range(self.steps):
            start = np.repeat(state[:, :1], DEGREE, axis=1)
            if self.order == 2:
                start = start + self.nodes[:, None, None] * state[:, 1, None]
            matrix = -np.einsum("ij,pjab->piajb", self.coupling, J[:, k]).reshape(points, DEGREE * n, DEGREE * n)
            matrix[:, range(DEGREE * n), range(DEGREE * n)] += 1.0
            stages = np.linalg.solve(matrix, start.reshape(points, DEGREE * n, -1)).reshape(start.shape)
            moved = state + np.einsum("ej,pjnc->penc", self.ends, J[:, k] @ stages)
            if self.order == 2:
                moved[:, 0] += state[:, 1]
            state = moved
        state[:, 1:] /= h[:, None, None, None]
        return np.asarray(state.reshape(points, self.order * n, self.order * n))


class GaussFlow(SteppedFlow):
    """Transition matrices by Gauss-Legendre collocation for models of either order."""

    method, step_numbers = "Gauss-Legendre collocation", (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
    orders = (2 * DEGREE,)

    def _build(self, steps: int) -> StepMap:
        return GaussMap(self.jacobian, steps, self.model.order)
