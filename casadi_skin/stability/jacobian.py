"""The sparse derivative of a model's right-hand side along orbits: the coefficients of the variational system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.models.ode import OdeModel

if TYPE_CHECKING:
    from scipy.sparse import csr_array

CHUNK = 64  # phases a call: enough to hide what a call costs


class JacobianAlong:
    """Non-zeros of J = d rhs/d state at many states, row by row (CSR); one pattern for all of them.

    `indices` and `indptr` are the pattern of J, shape (size, size).
    """

    def __init__(self, model: OdeModel) -> None:
        self.size = model.size
        # CasADi orders by columns: the non-zeros of the transpose are those of J ordered by rows.
        transposed = ca.jacobian(model.rhs, model.state).T
        self.indptr = np.array(transposed.sparsity().colind(), dtype=np.int32)
        self.indices = np.array(transposed.sparsity().row(), dtype=np.int32)
        nonzeros, parameters = transposed.nz[:], ca.vec(model.parameters)
        moving = np.array(ca.which_depends(nonzeros, ca.vertcat(model.state, parameters), 1, True), dtype=bool)
        # Off-diagonals of a chain are the same everywhere: they are computed once.
        self._moving = np.flatnonzero(moving)
        self._constant = np.zeros(moving.size)
        fixed = np.flatnonzero(~moving)
        self._constant[fixed] = np.array(ca.evalf(nonzeros[fixed.tolist()])).ravel()
        self._states = np.zeros((CHUNK, model.size))
        self._parameters = np.zeros((CHUNK, int(parameters.numel())))
        self._values = np.zeros((CHUNK, self._moving.size))
        single = ca.Function("J", [model.state, parameters], [nonzeros[self._moving.tolist()]])
        self._function = single.map(CHUNK)
        self._buffer, self._trigger = self._function.buffer()
        self._buffer.set_arg(0, self._states.data)
        self._buffer.set_arg(1, self._parameters.data)
        self._buffer.set_res(0, self._values.data)

    def __call__(self, states: Array, parameters: Array) -> Array:
        """Non-zeros, (phases, non-zeros), at states (phases, size), with the parameter's value at each, (phases,)."""
        count = states.shape[0]
        result = np.empty((count, self.indices.size))
        result[:] = self._constant
        values = np.empty((count, self._moving.size))
        for first in range(0, count if self._moving.size else 0, CHUNK):
            part = states[first : first + CHUNK]
            self._states[: len(part)] = part
            self._parameters[: len(part)] = parameters[first : first + CHUNK, None]
            self._trigger()
            values[first : first + CHUNK] = self._values[: len(part)]
        result[:, self._moving] = values
        return result

    def dense(self, nonzeros: Array) -> Array:
        """J as full matrices, shape (..., non-zeros) -> (..., size, size)."""
        matrices = np.zeros((*nonzeros.shape[:-1], self.size, self.size))
        matrices[..., self.rows(), self.indices] = nonzeros
        return matrices

    def block_matrix(self, points: int) -> csr_array:
        """Block-diagonal matrix of the J of several points; its data is J's non-zeros, point by point."""
        from scipy.sparse import csr_array

        count = self.indices.size
        indices = (self.size * np.arange(points, dtype=np.int32)[:, None] + self.indices).ravel()
        starts = (count * np.arange(points, dtype=np.int32)[:, None] + self.indptr[:-1]).ravel()
        indptr = np.append(starts, np.int32(points * count))
        return csr_array((np.zeros(points * count), indices, indptr), shape=(points * self.size,) * 2)

    def rows(self) -> NDArray[np.intp]:
        """Row of each non-zero."""
        return np.repeat(np.arange(self.size), np.diff(self.indptr))
