"""Residual and Jacobian of collocation on K intervals, assembled by structure from one mapped function of the model.

No symbolic graph of a mesh: what depends on the number of intervals alone, as which entry of the Jacobian comes from
where, is worked out once, and serves all meshes and solutions of that number; lengths of intervals are arguments.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.bvp.butcher import CollocationTable
from casadi_skin.bvp.formulation import Formulation
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.structure import Layout, structure_of


class Buffers:
    """Calls of a compiled function without conversions: arguments and results live in arrays given to it once."""

    def __init__(self, function: ca.Function) -> None:
        self._arguments = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        self._buffer, self._trigger = function.buffer()
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, argument.data)
        for i, result in enumerate(self._results):
            self._buffer.set_res(i, result.data)

    def __call__(self, *arguments: Array) -> list[Array]:
        """The results, non-zeros by columns; they are overwritten by the next call."""
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._trigger()
        return self._results


class Discretisation:
    """Collocation equations of a formulation on K intervals of any lengths that sum to 1.

    Attributes:
        structure: where entries of the Jacobian go.
        rows, columns: places of its non-zeros, column by column.
        shared: solvers that have been made for these equations, by name.
    """

    def __init__(self, formulation: Formulation, intervals: int, table: CollocationTable) -> None:
        self.shared: dict[Any, Any] = {}
        self._at, self._last = (np.empty(0), np.empty(0)), (np.empty(0), np.empty(0))
        self._n, self._K, self._d, self._R = formulation.states, intervals, table.degree, table.ends.size
        self._m, self._table = int(formulation.scalars.numel()), table
        self._states = self._n * (intervals * self._R + 1)
        self._field = Buffers(formulation.field_function.map(intervals * self._d))
        self._conditions = Buffers(formulation.condition_function)
        self._integrals = formulation.integrals
        if self._integrals:
            self._integrands = Buffers(formulation.integrand_function.map(intervals * self._d))
        self.structure = structure_of(Layout.of(formulation, intervals, table))
        self.rows, self.columns = self.structure.rows, self.structure.columns
        self._stage, self._start = self.structure.stage, self.structure.start

    def __call__(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        """Residual, and the non-zeros of the Jacobian in the order of `rows` and `columns`; not to be written to.

        `numbers` are the lengths of the intervals, then the constants of the formulation. The last results are kept: a
        solution is measured where it was solved.
        """
        if not (np.array_equal(z, self._at[0]) and np.array_equal(numbers, self._at[1])):
            found = self._assembled(z, numbers[: self._K], numbers[self._K :])
            for array in found:
                array.flags.writeable = False
            self._at, self._last = (z.copy(), numbers.copy()), found
        return self._last

    def _assembled(self, z: Array, lengths: Array, constants: Array) -> tuple[Array, Array]:
        n, K, d, R, m = self._n, self._K, self._d, self._R, self._m
        values, scalars = z[: self._states].reshape(-1, n), z[self._states :]
        starts = np.cumsum(lengths) - lengths
        arguments = (
            (starts[:, None] + lengths[:, None] * self._table.nodes).ravel(),
            values[self._stage].ravel(),
            np.tile(scalars, K * d),
            np.tile(constants, K * d),
        )
        weights = lengths[:, None, None] * self._table.extended  # (K, R, d)
        field, by_states, by_scalars = self._field(*arguments)
        increments = weights @ field.reshape(K, d, n)
        ends = values[1:].reshape(K, R, n) - values[self._start][:, None, :]
        condition, *derivatives = self._conditions(values[0], values[-1], scalars, constants)
        residual = [(ends - increments).ravel(), condition]
        rest = [-(weights @ by_scalars.reshape(K, d, m * n)).ravel(), *derivatives]
        if self._integrals:
            own, quadrature = self._integrals, (lengths[:, None] * self._table.extended[-1]).ravel()
            value, by_x, by_s = self._integrands(*arguments)
            residual.append(quadrature @ value.reshape(K * d, own))
            rest += [(quadrature[:, None] * by_x.reshape(K * d, -1)).ravel(), quadrature @ by_s.reshape(K * d, -1)]
        nonzeros = self.structure.differences.copy()
        nonzeros[self.structure.stiff] -= (weights[..., None] * by_states.reshape(K, 1, d, -1)).ravel()
        nonzeros[self.structure.rest] = np.concatenate(rest)
        return np.concatenate(residual), nonzeros
