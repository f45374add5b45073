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
from casadi_skin.bvp.problem import Array, Indices


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
        rows, columns: places of the non-zeros of the Jacobian, column by column.
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
        self._stage = (np.arange(intervals)[:, None] * self._R + 1 + np.arange(self._d)).ravel()
        self._start = np.arange(intervals) * self._R
        parts = self._places(formulation)
        equations = self._states - self._n + int(formulation.conditions.numel()) + self._integrals
        keys = [columns * equations + rows for rows, columns in parts]
        found, slots = np.unique(np.concatenate(keys), return_inverse=True)
        self.rows, self.columns = found % equations, found // equations
        ends = np.cumsum([key.size for key in keys])[:-1]
        target, start, self._stiff, *rest = np.split(slots, ends)
        self._rest = np.concatenate(rest)
        self._differences = np.zeros(found.size)
        self._differences[target], self._differences[start] = 1.0, -1.0

    def _places(self, formulation: Formulation) -> list[tuple[Indices, Indices]]:
        """Rows and columns of the parts of the Jacobian: differences, field by states and scalars, conditions."""
        n, K, d, R, m = self._n, self._K, self._d, self._R, self._m
        bottom, component = self._states - n, np.arange(n)
        increment = np.arange(bottom)
        ends = np.repeat(self._start, R), np.arange(1, K * R + 1)
        parts = [(increment, (column[:, None] * n + component).ravel()) for column in ends[::-1]]
        r, c = (np.array(t, dtype=np.int64) for t in formulation.field_function.sparsity_out(1).get_triplet())
        shape = (K, R, d, r.size)
        stiff = (np.arange(K * R).reshape(K, R, 1, 1) * n + r, self._stage.reshape(K, 1, d, 1) * n + c)
        parts.append(tuple(np.broadcast_to(places, shape).ravel() for places in stiff))  # type: ignore[arg-type]
        scalars = self._states + np.arange(m)
        by_scalars = np.broadcast_arrays(increment.reshape(K, R, 1, n), scalars[:, None])
        parts.append((by_scalars[0].ravel(), by_scalars[1].ravel()))
        for i, offset in enumerate((0, bottom, self._states), start=1):
            rows, columns = (
                np.array(t, dtype=np.int64) for t in formulation.condition_function.sparsity_out(i).get_triplet()
            )
            parts.append((rows + bottom, columns + offset))
        if self._integrals:
            first = bottom + int(formulation.conditions.numel()) + np.arange(self._integrals)
            by_x = np.broadcast_arrays(first, (self._stage[:, None, None] * n + component[:, None]))
            by_s = np.broadcast_arrays(first, scalars[:, None])
            parts += [(by_x[0].ravel(), by_x[1].ravel()), (by_s[0].ravel(), by_s[1].ravel())]
        return parts

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
        nonzeros = self._differences.copy()
        nonzeros[self._stiff] -= (weights[..., None] * by_states.reshape(K, 1, d, -1)).ravel()
        nonzeros[self._rest] = np.concatenate(rest)
        return np.concatenate(residual), nonzeros
