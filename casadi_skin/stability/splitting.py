"""Symplectic splitting of the variational flow: order 6, Runge-Kutta-Nystrom type, 11 stages (Blanes and Moan 2002).

For X'' = J(t) X with J = df/dq along the orbit, kicks V += b h J X and drifts X += a h V alternate; time moves with the
drifts. The map is symplectic to round-off at every step number, so that stable orbits do not acquire instabilities.
Several orbits go through the stages together: their J are the blocks of one sparse matrix.
"""

from __future__ import annotations

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.integrators.srkn import KicksAndDrifts
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.jacobian import JacobianAlong
from casadi_skin.stability.stepping import StepMap, SteppedFlow

STEPS = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)


class SplittingMap:
    """Transition matrices of models of second order by the splitting in `steps` equal steps."""

    def __init__(self, jacobian: JacobianAlong, steps: int) -> None:
        self.jacobian, self.steps = jacobian, steps
        self._sequence = KicksAndDrifts.of(steps)
        self.fractions = self._sequence.times / steps

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, shape (points, 2n, 2n), from J's non-zeros (points, len(fractions), non-zeros)."""
        from scipy.linalg.blas import daxpy

        points, n, h = durations.size, self.jacobian.size, durations / self.steps
        weights = self._sequence.kicks
        stages = np.multiply(nonzeros.swapaxes(0, 1), weights[:, None, None] * (h * h)[:, None], order="C")
        stages = stages.reshape(weights.size, -1)
        matrix = self.jacobian.block_matrix(points)
        # Positions X and velocities times the step h V, so that no orbit's step is in the drifts.
        start = np.zeros((2, points, n, 2 * n))
        start[0][:, range(n), range(n)] = 1.0
        start[1][:, range(n), range(n, 2 * n)] = h[:, None]
        rows, shape = (points * n, 2 * n), (points, n, 2 * n)

        def kick(i: int, x: Array, v: Array) -> Array:
            matrix.data = stages[i]
            moved: Array = daxpy((matrix @ x.reshape(rows)).ravel(), v)
            return moved

        def drift(a: float, x: Array, v: Array) -> Array:
            moved: Array = daxpy(v, x, a=a)
            return moved

        x, v = self._sequence.apply(start[0].ravel(), start[1].ravel(), kick, drift)
        return np.concatenate([x.reshape(shape), v.reshape(shape) / h[:, None, None]], axis=1)


class SplittingFlow(SteppedFlow):
    """Transition matrices by the splitting, extrapolated to order 8, for models of second order.

    Raises ValueError for a model that is not of second order with forces that depend on positions only.
    """

    method, step_numbers = "splitting", STEPS
    orders = (6, 8)

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use gauss, rk4 or cvodes")
        super().__init__(model, tolerance)

    def _build(self, steps: int) -> StepMap:
        return SplittingMap(self.jacobian, steps)
