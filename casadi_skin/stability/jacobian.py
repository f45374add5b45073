"""The sparse derivative of a model's right-hand side along orbits: the coefficients of the variational system."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import Monomials, NotPolynomialError, polynomial_terms
from casadi_skin.zero.problem import Array, Indices, Problem

if TYPE_CHECKING:
    from scipy.sparse import csr_array

PHASES_PER_CALL = 64  # phases a call: enough to hide the cost of a call
FEW_TERMS = 4  # terms a non-zero up to which numpy is faster than CasADi


class _Terms:
    """Values of polynomials, a few terms each, at many states: numpy takes a tenth of CasADi's time.

    `places` are those of the polynomials among the numbers of a row.
    """

    def __init__(self, groups: tuple[Monomials, ...], places: Indices) -> None:
        self._groups = []
        for group in groups:
            rows, first = np.unique(group.rows, return_index=True)  # rows ascend
            starts = None if first.size == group.rows.size else first
            self._groups.append((group, _columns(places[rows]), starts, [_columns(each) for each in group.factors]))

    def add(self, states: Array, parameters: Array, result: Array) -> None:
        """Add values at states (phases, size) and the parameter at each, (phases,), to rows (phases, any)."""
        for group, columns, starts, factors in self._groups:
            terms = np.multiply.outer(parameters**group.power, group.coefficients)
            for of_states in factors:
                terms *= states[:, of_states]
            result[:, columns] += terms if starts is None else np.add.reduceat(terms, starts, axis=1)


def _columns(indices: Indices) -> slice | Indices:
    """A slice where the indices have equal steps: a view costs nothing, a gather does."""
    steps = np.unique(np.diff(indices))
    if steps.size > 1 or (steps.size and steps[0] < 1):
        return indices
    return slice(int(indices[0]), int(indices[-1]) + 1, int(steps[0]) if steps.size else 1)


class _Compiled:
    """Values of any expressions at many states by CasADi, with arrays of our own as its arguments and results."""

    def __init__(self, model: OdeModel, expressions: Expression, places: Indices) -> None:
        parameters = ca.vec(model.parameters)
        self._places = places
        self._states = np.zeros((PHASES_PER_CALL, model.size))
        self._parameters = np.zeros((PHASES_PER_CALL, int(parameters.numel())))
        self._values = np.zeros((PHASES_PER_CALL, int(expressions.numel())))
        self._function = ca.Function("J", [model.state, parameters], [expressions]).map(PHASES_PER_CALL)
        self._buffer, self._trigger = self._function.buffer()
        self._buffer.set_arg(0, self._states.data)
        self._buffer.set_arg(1, self._parameters.data)
        self._buffer.set_res(0, self._values.data)

    def add(self, states: Array, parameters: Array, result: Array) -> None:
        """As that of `_Terms`."""
        for first in range(0, parameters.size, PHASES_PER_CALL):
            these = slice(first, first + PHASES_PER_CALL)
            count = len(states[these])
            self._states[:count], self._parameters[:count] = states[these], parameters[these, None]
            self._trigger()
            result[these, self._places] += self._values[:count]


def _values(model: OdeModel, expressions: ca.SX, places: Indices) -> _Terms | _Compiled:
    """Those of a column of expressions in state and parameter: polynomials of few terms by numpy."""
    if isinstance(expressions, ca.SX) and model.parameters.numel() == 1 and model.time is None:
        try:
            groups = polynomial_terms(expressions, model.state, model.parameters)
        except NotPolynomialError:
            return _Compiled(model, expressions, places)
        if sum(group.rows.size for group in groups) <= FEW_TERMS * expressions.numel():
            return _Terms(groups, places)
    return _Compiled(model, expressions, places)


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
        self._constant = np.zeros(moving.size)
        fixed, places = np.flatnonzero(~moving), np.flatnonzero(moving)
        self._constant[fixed] = np.array(ca.evalf(nonzeros[fixed.tolist()])).ravel()
        self._moving = _values(model, nonzeros[places.tolist()], places) if places.size else None

    def along(self, problem: Problem, z: Array, theta: Array) -> Array:
        """Non-zeros at phases of several orbits z of a problem, shape (orbits, phases, non-zeros)."""
        states = problem.samples(z, theta).reshape(len(z) * theta.size, -1)
        found = self(states, np.repeat(z[:, problem.parameter_index], theta.size))
        return found.reshape(len(z), theta.size, -1)

    def __call__(self, states: Array, parameters: Array) -> Array:
        """Non-zeros, (phases, non-zeros), at states (phases, size), with the parameter's value at each, (phases,)."""
        result = np.empty((states.shape[0], self.indices.size))
        result[:] = self._constant
        if self._moving is not None:
            self._moving.add(states, parameters, result)
        return result

    def dense(self, nonzeros: Array) -> Array:
        """J as full matrices, shape (..., non-zeros) -> (..., size, size)."""
        matrices = np.zeros((*nonzeros.shape[:-1], self.size, self.size))
        matrices[..., self.rows(), self.indices] = nonzeros
        return matrices

    @cached_property
    def half_bandwidth(self) -> int:
        """Largest distance of a non-zero from the diagonal."""
        return int(np.max(np.abs(self.rows() - self.indices), initial=0))

    def block_matrix(self, points: int) -> csr_array:
        """Block-diagonal matrix of the J of several points; its data is J's non-zeros, point by point."""
        from scipy.sparse import csr_array

        nonzeros, each = self.indices.size, np.arange(points, dtype=np.int32)[:, None]
        starts = np.append((nonzeros * each + self.indptr[:-1]).ravel(), np.int32(points * nonzeros))
        columns = (self.size * each + self.indices).ravel()
        return csr_array((np.zeros(points * nonzeros), columns, starts), shape=(points * self.size,) * 2)

    def rows(self) -> NDArray[np.intp]:
        """Row of each non-zero."""
        return np.repeat(np.arange(self.size), np.diff(self.indptr))
