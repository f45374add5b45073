"""The classical Runge-Kutta method of order 4 on the variational system, for models of first and of second order.

It shares nothing with the splitting but the orbit. It is neither symmetric nor symplectic: at the tolerances in use
the multipliers of a stable orbit leave the unit circle by the error it makes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_skin.stability.flows import StepMap, SteppedFlow
from casadi_skin.stability.jacobian import JacobianAlong
from casadi_skin.zero.problem import Array

STEPS = (6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2048, 3072, 4096)

Product = Callable[[int, Array], Array]


class RungeKuttaMap:
    """Transition matrices of models of either order by the classical method in `steps` equal steps."""

    def __init__(self, jacobian: JacobianAlong, steps: int, order: int) -> None:
        self.jacobian, self.steps, self.order = jacobian, steps, order
        self.fractions = np.arange(2 * steps + 1) / (2 * steps)

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, (points, m, m), from J's non-zeros (points, len(fractions), non-zeros)."""
        points, n, h = durations.size, self.jacobian.size, durations / self.steps
        matrix, columns = self.jacobian.block_matrix(points), self.order * n
        # J h (J h^2 for models of second order), so that no orbit's step is in the formulas.
        coefficients = (nonzeros * (h**self.order)[:, None, None]).swapaxes(0, 1).reshape(self.fractions.size, -1)

        def product(place: int, x: Array) -> Array:
            matrix.data = coefficients[place]
            return np.asarray(matrix @ x.reshape(points * n, columns)).reshape(x.shape)

        x = np.zeros((points, n, columns))
        x[:, range(n), range(n)] = 1.0
        if self.order == 1:
            for k in range(self.steps):
                x = self._first(product, 2 * k, x)
            return x
        v = np.zeros_like(x)
        v[:, range(n), range(n, 2 * n)] = h[:, None]
        for k in range(self.steps):
            x, v = self._second(product, 2 * k, x, v)
        return np.concatenate([x, v / h[:, None, None]], axis=1)

    @staticmethod
    def _first(product: Product, place: int, x: Array) -> Array:
        k1 = product(place, x)
        k2 = product(place + 1, x + 0.5 * k1)
        k3 = product(place + 1, x + 0.5 * k2)
        k4 = product(place + 2, x + k3)
        return x + (k1 + 2.0 * (k2 + k3) + k4) / 6.0

    @staticmethod
    def _second(product: Product, place: int, x: Array, v: Array) -> tuple[Array, Array]:
        """The same method on positions and velocities times the step, the stages of the positions eliminated."""
        k1 = product(place, x)
        k2 = product(place + 1, x + 0.5 * v)
        k3 = product(place + 1, x + 0.5 * v + 0.25 * k1)
        k4 = product(place + 2, x + v + 0.5 * k2)
        return x + v + (k1 + k2 + k3) / 6.0, v + (k1 + 2.0 * (k2 + k3) + k4) / 6.0


class RungeKuttaFlow(SteppedFlow):
    """Transition matrices by the classical Runge-Kutta method, extrapolated to order 5, for models of either order."""

    method, step_numbers = "Runge-Kutta method", STEPS
    orders = (4, 5)

    def _build(self, steps: int) -> StepMap:
        return RungeKuttaMap(self.jacobian, steps, self.model.order)
