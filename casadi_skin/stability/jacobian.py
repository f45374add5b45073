"""The sparse derivative of a model's right-hand side along orbits: the coefficients of the variational system."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import Monomials, NotPolynomialError, polynomial_terms
from casadi_skin.native import JacobianKernel, Structure, kernels
from casadi_skin.zero.problem import Array, Indices, Problem

if TYPE_CHECKING:
    from scipy.sparse import csr_array

PHASES_PER_CALL = 64  # phases a call: enough to hide the cost of a call
FEW_TERMS = 4  # terms a non-zero up to which numpy is faster than CasADi


class _Terms:
    """Values of polynomials, a few terms each, at many states: numpy takes a tenth of CasADi's time."""

    def __init__(self, groups: tuple[Monomials, ...], count: int) -> None:
        self._groups, self._count, self.monomials = [], count, groups
        for group in groups:
            rows, first = np.unique(group.rows, return_index=True)  # rows ascend
            single = first.size == group.rows.size
            factors = [_columns(factor) for factor in group.factors]
            self._groups.append((group, _columns(rows), None if single else first, factors))

    @classmethod
    def of(cls, model: OdeModel, expressions: ca.SX) -> _Terms | None:
        """Those of a column of expressions in state and parameter; None where they are no polynomials of few terms."""
        if not isinstance(expressions, ca.SX) or model.parameters.numel() != 1 or model.time is not None:
            return None
        try:
            groups = polynomial_terms(expressions, model.state, model.parameters)
        except NotPolynomialError:
            return None
        few = sum(group.rows.size for group in groups) <= FEW_TERMS * expressions.numel()
        return cls(groups, expressions.numel()) if few else None

    def __call__(self, states: Array, parameters: Array) -> Array:
        """Values, (phases, expressions), at states (phases, size) and the parameter at each, (phases,)."""
        values = np.zeros((parameters.size, self._count))
        for group, rows, first, factors in self._groups:
            terms = np.multiply.outer(parameters**group.power, group.coefficients)
            for columns in factors:
                terms *= states[:, columns]
            values[:, rows] += terms if first is None else np.add.reduceat(terms, first, axis=1)
        return values


def _columns(indices: Indices) -> slice | Indices:
    """A slice where the indices are consecutive: a view costs nothing, a gather does."""
    consecutive = bool(np.all(np.diff(indices) == 1))
    return slice(int(indices[0]), int(indices[-1]) + 1) if consecutive else indices


class _Compiled:
    """Values of any expressions at many states by CasADi, with arrays of our own as its arguments and results."""

    def __init__(self, model: OdeModel, expressions: Expression) -> None:
        parameters = ca.vec(model.parameters)
        self._states = np.zeros((PHASES_PER_CALL, model.size))
        self._parameters = np.zeros((PHASES_PER_CALL, int(parameters.numel())))
        self._values = np.zeros((PHASES_PER_CALL, int(expressions.numel())))
        self._function = ca.Function("J", [model.state, parameters], [expressions]).map(PHASES_PER_CALL)
        self._buffer, self._trigger = self._function.buffer()
        self._buffer.set_arg(0, self._states.data)
        self._buffer.set_arg(1, self._parameters.data)
        self._buffer.set_res(0, self._values.data)

    def __call__(self, states: Array, parameters: Array) -> Array:
        """As that of `_Terms`."""
        values = np.empty((parameters.size, self._values.shape[1]))
        for first in range(0, parameters.size, PHASES_PER_CALL):
            part = states[first : first + PHASES_PER_CALL]
            self._states[: len(part)] = part
            self._parameters[: len(part)] = parameters[first : first + PHASES_PER_CALL, None]
            self._trigger()
            values[first : first + PHASES_PER_CALL] = self._values[: len(part)]
        return values


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
        expressions = nonzeros[self._moving.tolist()]
        self._values = _Terms.of(model, expressions) or _Compiled(model, expressions)

    @cached_property
    def _kernel(self) -> JacobianKernel | None:
        """The compiled kernel of a polynomial right-hand side; None where there is none."""
        if not kernels() or not isinstance(self._values, _Terms):
            return None
        terms = [replace(group, rows=self._moving[group.rows]) for group in self._values.monomials]
        return JacobianKernel(self._constant, terms)

    def along(self, problem: Problem, z: Array, theta: Array, found: Array) -> None:
        """Fill in the non-zeros at phases of several orbits z of a problem, shape (orbits, phases, non-zeros)."""
        parameters, weights = z[:, problem.parameter_index], problem.sampling(theta)
        if weights is None or self._kernel is None:  # shooting and collocation, or a model of other functions
            states = problem.samples(z, theta).reshape(len(z) * theta.size, -1)
            found[:] = self(states, np.repeat(parameters, theta.size)).reshape(found.shape)
        else:
            self._kernel(self.size, z, weights, parameters, found)

    def orbits(self, problem: Problem, z: Array, theta: Array) -> Structure | None:
        """What another kernel needs to compute them, orbit by orbit; None where this one's cannot."""
        weights = problem.sampling(theta)
        if weights is None or self._kernel is None:
            return None
        return self._kernel.orbits(self.size, z, weights, z[:, problem.parameter_index])

    def __call__(self, states: Array, parameters: Array) -> Array:
        """Non-zeros, (phases, non-zeros), at states (phases, size), with the parameter's value at each, (phases,)."""
        result = np.empty((states.shape[0], self.indices.size))
        result[:] = self._constant
        if self._moving.size:
            result[:, self._moving] = self._values(states, parameters)
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

    def window(self, first: int, last: int) -> tuple[slice | NDArray[np.bool_], NDArray[np.int32], NDArray[np.int32]]:
        """Which non-zeros lie in rows and columns first to last - 1, and the `indices` and `indptr` of these."""
        if last - first == self.size:
            return slice(None), self.indices, self.indptr
        rows, columns = self.rows(), self.indices
        inside = (rows >= first) & (rows < last) & (columns >= first) & (columns < last)
        counts = np.bincount(rows[inside] - first, minlength=last - first)
        indptr = np.append(0, np.cumsum(counts)).astype(np.int32)
        return inside, (columns[inside] - first).astype(np.int32), indptr

    def block_matrix(self, points: int) -> csr_array:
        """Block-diagonal matrix of the J of several points; its data is J's non-zeros, point by point."""
        return repeated(self.indices, self.indptr, points)

    def rows(self) -> NDArray[np.intp]:
        """Row of each non-zero."""
        return np.repeat(np.arange(self.size), np.diff(self.indptr))


def repeated(indices: NDArray[np.int32], indptr: NDArray[np.int32], count: int) -> csr_array:
    """Block-diagonal matrix of square blocks of one pattern; its data is theirs, block by block."""
    from scipy.sparse import csr_array

    size, nonzeros, each = indptr.size - 1, indices.size, np.arange(count, dtype=np.int32)[:, None]
    starts = np.append((nonzeros * each + indptr[:-1]).ravel(), np.int32(count * nonzeros))
    return csr_array((np.zeros(count * nonzeros), (size * each + indices).ravel(), starts), shape=(count * size,) * 2)


# Transition matrices of long chains stored by the bands of their blocks, and products of these ------------------------

BLOCK_COLUMNS = 128  # columns of a product of which zeros are left out


def half_width(block: Array) -> int | None:
    """Half bandwidth of a block that is stored by its band, shape (..., n, 2w + 1); None of a full one."""
    return None if block.shape[-1] == block.shape[-2] else (block.shape[-1] - 1) // 2


def rows_of(band: Array, start: int, end: int) -> Array:
    """Rows of a block from its band, columns start - w to end + w: (points, n, 2w + 1) -> (points, rows, rows + 2w)."""
    count, width = end - start, band.shape[2]
    buffer = np.zeros((len(band), count, count + width))  # one column more: entry (i, i + t) is at i * width + t
    view = np.lib.stride_tricks.as_strided(
        buffer,
        (len(band), count, width),
        (buffer.strides[0], buffer.strides[1] + buffer.itemsize, buffer.itemsize),
    )
    view[:] = band[:, start:end]
    return buffer[:, :, :-1]


def transposed_product(left: Array, right: Array) -> Array:
    """left^T right of blocks (points, n, n) or of their bands, without the zeros far from the diagonal; full."""
    n, width = left.shape[1], half_width(left)
    if n <= BLOCK_COLUMNS:
        return np.asarray(left.swapaxes(1, 2) @ right)
    product = np.zeros((len(left), n, n))
    for start in range(0, n, BLOCK_COLUMNS):
        end = min(n, start + BLOCK_COLUMNS)
        if width is None:
            rows = _extent(np.any(left[:, :, start:end] != 0.0, axis=(0, 2)))
            others = _extent(np.any(right[:, rows] != 0.0, axis=(0, 1)))
            product[:, start:end, others] = left[:, rows, start:end].swapaxes(1, 2) @ right[:, rows, others]
            continue
        first, last = max(0, start - width), min(n, end + width)
        low, high = max(0, first - width), min(n, last + width)
        columns = rows_of(left, first, last)[:, :, start - first + width : end - first + width]
        others_ = rows_of(right, first, last)[:, :, low - first + width : high - first + width]
        product[:, start:end, low:high] = columns.swapaxes(1, 2) @ others_
    return product


def _extent(chosen: NDArray[np.bool_]) -> slice:
    """From the first place that is chosen to the last."""
    places = np.flatnonzero(chosen)
    return slice(int(places[0]), int(places[-1]) + 1) if places.size else slice(0, 0)
