"""A linearisation in units in which it is balanced: its eigenvalues with their errors, and what of it vanishes.

A is df/dx, shape (n, n), and B = A d / d in units d that are powers of two, with rows and columns alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import EPSILON, Array, Indices

ComplexArray = NDArray[np.complex128]
# Of the machine's, in the derivatives: an eigenvalue that is zero comes out as that over its condition.
DERIVATIVE_ROUNDING = 16.0
ROUNDED_COMPONENT_RATIO = 1e-12  # of the usual size of a component: one that is smaller is zero
LARGE_MOVE = 1e200  # beyond it a component moves at a singular place alone
SLIGHT_DISTURBANCE = 1e-8  # of an equation's terms: a disturbance by which no regular equilibrium moves far
BALANCING_ROUNDS, BALANCED_CHANGE = 200, 1e-3  # of a sparse matrix; the last change of the logarithm of a unit
NOT_FINITE = "the derivatives are not finite at the equilibrium"
FEW_COMPONENTS = 16  # of a state, of which a dense matrix of paths is made in less time than a sparse graph
FAINT_UNIT_RATIO = 1e-3  # of the unit by which a component acts on others: the least unit of one that hardly changes


@dataclass(frozen=True, eq=False)
class BalancedMatrix:
    """A square matrix df/dx.

    Attributes:
        matrix: in the units of the state.
        rounding: relative rounding error of its entries.
        change: the change of the matrix by the error of the state, shape (n, n); None where that is exact.
    """

    matrix: Array
    rounding: float = EPSILON
    change: Array | None = None

    @cached_property
    def balanced(self) -> tuple[Array, Array]:
        """The balanced matrix B and the units d: x = d y, B = A d / d."""
        return balanced(self.matrix)

    @cached_property
    def uncertain(self) -> float:
        """The norm of what the balanced matrix may be off by."""
        B, d = self.balanced
        moved = 0.0 if self.change is None else float(np.linalg.norm(self.change / d[:, None] * d))
        return self.rounding * float(np.linalg.norm(B)) + moved

    @cached_property
    def eigensystem(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Eigenvalues, and left and right eigenvectors of the balanced matrix as columns of norm 1."""
        from scipy.linalg import eig

        values, left, right = (np.asarray(part, dtype=np.complex128) for part in eig(self.balanced[0], left=True))
        return values, left, right

    @cached_property
    def conditions(self) -> Array:
        """Condition numbers of the eigenvalues (Wilkinson 1965); infinite of defective ones."""
        _, left, right = self.eigensystem
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.abs(np.sum(left.conj() * right, axis=0)))

    def errors(self, safety: float = DERIVATIVE_ROUNDING) -> Array:
        """Errors of the eigenvalues: by their condition, and no more than of a double one that is defective."""
        size = safety * self.uncertain
        return np.asarray(
            np.minimum(size * self.conditions, np.sqrt(size * (np.linalg.norm(self.balanced[0]) + 1e-300)))
        )

    def rates(self, rate: Array) -> ComplexArray:
        """Rates of the eigenvalues where the matrix changes at a rate; 0 of defective ones."""
        _, left, right = self.eigensystem
        d = self.balanced[1]
        moving = np.sum(left.conj() * ((rate / d[:, None] * d) @ right), axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = moving / np.sum(left.conj() * right, axis=0)
        return np.where(np.isfinite(found), found, 0.0)

    def vectors(self, place: int) -> tuple[ComplexArray, ComplexArray]:
        """Right and left eigenvector of an eigenvalue in the units of the state."""
        _, left, right = self.eigensystem
        d = self.balanced[1]
        return right[:, place] * d, left[:, place] / d


def balanced(matrix: Any) -> tuple[Any, Array]:
    """B = A d / d with rows and columns alike, and d, powers of two; raises ArithmeticError without finite entries.

    Of a dense matrix, or of a sparse one by columns.
    """
    from scipy.linalg import matrix_balance

    if is_sparse(matrix):
        return scaled(matrix, np.exp2(np.round(logarithms_of_units(matrix))))
    if not np.all(np.isfinite(matrix)):
        raise ArithmeticError(NOT_FINITE)
    found, scales = matrix_balance(matrix, permute=False, separate=True)
    return np.asarray(found), np.asarray(scales[0])


def scaled(matrix: Any, d: Array) -> tuple[Any, Array]:
    """A sparse matrix A d / d by columns, and d."""
    found = matrix.copy()
    found.data = matrix.data * np.repeat(d, np.diff(matrix.indptr)) / d[matrix.indices]
    return found, d


def is_sparse(matrix: Any) -> bool:
    """Whether a matrix is one of scipy.sparse."""
    return not isinstance(matrix, np.ndarray)


DENSE_SIZE, MOST_NONZEROS = 100, 0.1  # up to which matrices are dense; and the share of non-zeros of sparse ones


def is_mostly_zero(size: int, nonzeros: int) -> bool:
    """Whether a square matrix is best treated as a sparse one."""
    return size > DENSE_SIZE and nonzeros < MOST_NONZEROS * size**2


def dense(matrix: Any) -> Array:
    """A matrix as an array."""
    return np.asarray(matrix.toarray() if is_sparse(matrix) else matrix)


def shifted(matrix: Any, shift: complex) -> Any:
    """A square matrix less a multiple of the unit matrix."""
    from scipy.sparse import eye

    n = matrix.shape[0]
    return (matrix - shift * eye(n)).tocsc() if is_sparse(matrix) else matrix - shift * np.eye(n)


def solution(matrix: Any) -> tuple[Callable[[Any], Any], float]:
    """The solution with a matrix, a function of the right-hand side, and its condition number (estimated if sparse)."""
    from scipy.sparse.linalg import LinearOperator, onenormest, splu

    if not is_sparse(matrix):
        return partial(np.linalg.solve, matrix), float(np.linalg.cond(matrix))
    try:
        factors: Any = splu(matrix)
    except RuntimeError:  # "Factor is exactly singular"
        return partial(np.full_like, fill_value=np.nan), np.inf
    inverse: Any = LinearOperator(
        matrix.shape, factors.solve, lambda b: factors.solve(b, "H"), dtype=matrix.dtype, matmat=factors.solve
    )
    return factors.solve, float(onenormest(inverse) * np.max(abs(matrix).sum(axis=0)))


def logarithms_of_units(matrix: Any) -> Array:
    """Logarithms to the base 2 of units in which sums of rows and columns of a sparse matrix are alike, but for signs.

    All move at once, by half of what each alone would (Osborne 1960). Raises ArithmeticError without finite entries.
    """
    if not np.all(np.isfinite(matrix.data)):
        raise ArithmeticError(NOT_FINITE)
    columns = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return _logarithms(matrix.indices, columns, matrix.data, matrix.shape[0])


def _logarithms(rows: Indices, columns: Indices, entries: Array, n: int) -> Array:
    """The same of a matrix by its entries."""
    sizes, found = np.where(rows == columns, 0.0, np.abs(entries)), np.zeros(n)
    for _ in range(BALANCING_ROUNDS):
        now = sizes * np.exp2(found[columns] - found[rows])
        by_row, by_column = np.bincount(rows, now, n), np.bincount(columns, now, n)
        seen = (by_row > 0.0) & (by_column > 0.0)
        change = 0.25 * np.log2(np.where(seen, by_row, 1.0) / np.where(seen, by_column, 1.0))
        found += change
        if np.max(np.abs(change), initial=0.0) < BALANCED_CHANGE:
            break
    return found


def upper_pair(values: ComplexArray, near: complex | None = None) -> int:
    """Place of the upper eigenvalue of the pair nearest to `near`, by default to the imaginary axis.

    Raises ArithmeticError where all are real.
    """
    upper = np.flatnonzero(values.imag > 0.0)
    if not upper.size:
        raise ArithmeticError("no pair of complex eigenvalues is near the imaginary axis")
    apart = np.abs(values[upper].real) if near is None else np.abs(values[upper] - near)
    return int(upper[np.argmin(apart)])


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Null vectors of a matrix whose columns and rows have units, by its singular values in these.

    Attributes:
        values: singular values, descending; as many more columns than rows there are have none.
        left, right: singular vectors as columns, in the units of the matrix.
        uncertain: error of the values.
    """

    values: Array
    left: Array
    right: Array
    uncertain: float

    @classmethod
    def of(
        cls, matrix: Array, columns: Array, rounding: float = EPSILON, change: Array | None = None,
        rows: Array | None = None,
    ) -> NullSpace:  # fmt: skip
        """Of a matrix whose unknowns are measured by `columns`; each row counts by its largest entry, or by `rows`.

        A row that is within its change is zero: it counts by no entry of its own. Rows of df/dx in x' = f(x) are
        measured by the units of the state, as columns are: where the equation of one component alone is singular, all
        entries of its row are rounding.
        """
        scaled, off = matrix * columns, (np.zeros_like(matrix) if change is None else change) * columns
        if rows is None:
            rows = np.max(np.abs(scaled), axis=1)
            seen = rows > np.max(np.abs(off), axis=1)
            scaled, off = (np.where(seen[:, None], one, 0.0) for one in (scaled, off))
            rows = np.where(seen, rows, 1.0)
        left, values, right = np.linalg.svd(scaled / rows[:, None])
        moved = float(np.linalg.norm(off / rows[:, None]))
        uncertain = 4.0 * DERIVATIVE_ROUNDING * rounding * float(values[0]) + moved
        return cls(values, left / rows[:, None], right.T * columns[:, None], uncertain)

    def solution(self, residual: Array) -> Array:
        """The smallest solution x, in these units, of matrix x = residual."""
        seen = self.values > self.uncertain
        parts = (self.left.T @ residual)[seen] / self.values[seen]
        return np.asarray(self.right[:, : self.values.size][:, seen] @ parts)

    @property
    def vanishing(self) -> int:
        """Number of singular values that are zero but for their error."""
        return int(np.count_nonzero(self.values <= self.uncertain))


def units_of(matrix: Array, x: Array, by_parameters: Array, usual: Array, otherwise: Array) -> Array:
    """Units of the components of a state at one place, shape (n,), positive.

    A component counts by its own size, or by how far it moves with the parameters over their ranges, but for no more
    than the unit by which it acts on others: a balanced one, as large as the sizes of those that act on each other.

    Arguments:
        matrix: df/dx.
        x: the state.
        by_parameters: changes of f over the ranges of parameters, shape (n, parameters).
        usual: usual sizes of the components; zero where nothing is known.
        otherwise: sizes of components that act on each other, are all zero and do not move, but for rounding.
    """
    B, d = balanced(matrix)
    moved = _response(B, by_parameters / d[:, None]) * d
    block = acting_on_each_other(matrix)
    largest = np.zeros((block.max(initial=-1) + 1, 3))
    np.maximum.at(largest, block, np.array([np.maximum(np.abs(x), usual), moved, otherwise]).T / d[:, None])
    known = (ROUNDED_COMPONENT_RATIO * largest[:, 2:] < largest) & (largest < LARGE_MOVE)
    which = np.argmax(known, axis=1)
    factor = np.where(known.any(axis=1), largest[np.arange(which.size), which], 1.0)
    acting, least = d * factor[block], np.where(known[:, 2] & (which == 2), 1.0, FAINT_UNIT_RATIO)[block]
    general = np.cos(np.arange(d.size) ** 2 % 6.25)  # orthogonal to no null vector, as one is that a symmetry gives
    disturbed = SLIGHT_DISTURBANCE * _largest_of_rows(B) * acting / d * general
    moved = np.maximum(moved, _response(B, disturbed[:, None]) * d)  # far where the matrix is singular
    return np.asarray(np.maximum(np.abs(x), np.clip(moved, least * acting, acting)))


def acting_on_each_other(matrix: Any) -> NDArray[np.integer[Any]]:
    """Which components of a state act on each other, numbered, shape (n,): by their paths where there are a few."""
    from scipy.sparse.csgraph import connected_components

    if is_sparse(matrix) or len(matrix) > FEW_COMPONENTS:
        return np.asarray(connected_components(matrix != 0.0, connection="strong")[1])
    reached = (matrix != 0.0) | np.eye(len(matrix), dtype=bool)
    for _ in range(len(matrix).bit_length()):  # paths of twice the length
        reached = reached @ reached
    return np.asarray(np.unique(np.argmax(reached & reached.T, axis=1), return_inverse=True)[1])


def _largest_of_rows(matrix: Any) -> Array:
    """The largest entry of each row."""
    if is_sparse(matrix):
        return np.asarray(abs(matrix).max(axis=1).toarray()).ravel()
    return np.asarray(np.max(np.abs(matrix), axis=1, initial=0.0))


def _response(matrix: Any, change: Array) -> Array:
    """How far the components of a state move where its equations change, shape (n,); infinite at singular places."""
    from scipy.sparse.linalg import splu

    try:
        moved = splu(matrix).solve(change) if is_sparse(matrix) else np.linalg.solve(matrix, change)
    except (np.linalg.LinAlgError, RuntimeError):  # SuperLU: "Factor is exactly singular"
        return np.full(matrix.shape[0], np.inf)
    return np.asarray(np.max(np.abs(moved), axis=1, initial=0.0))


# Units of components that are faint where others are not -------------------------------------------------------------

FAINT_COMPONENT_RATIO = 1e-3  # of the largest that a component acts on and that acts on it, in balanced units


@dataclass(frozen=True, eq=False)
class Faint:
    """Components that are small beside others which they move and which move them, as the tails of a breather.

    Attributes:
        units: balanced units of all components, shape (n,).
        blocks: which components act on each other, numbered, shape (n,).
        components: which are faint, shape (n,).
    """

    units: Array
    blocks: NDArray[np.integer[Any]]
    components: NDArray[np.bool_]

    @classmethod
    def of(cls, strengths: Array, places: tuple[Indices, Indices], sizes: Array) -> Faint | None:
        """Of sizes of the entries of df/dx at these rows and columns, and of components; None where none is faint."""
        rows, columns = places
        strength: Any
        if is_mostly_zero(sizes.size, strengths.size):
            from scipy.sparse import csc_matrix

            strength = csc_matrix((strengths, places), shape=(sizes.size, sizes.size))
        else:
            strength = np.zeros((sizes.size, sizes.size))
            strength[places] = strengths
        blocks = acting_on_each_other(strength)
        acting = np.where(blocks[rows] == blocks[columns], strengths, 0.0)
        units = np.exp2(_logarithms(rows, columns, acting, sizes.size))
        found = cls(units, blocks, np.ones(len(units), dtype=bool))
        faint = sizes < FAINT_COMPONENT_RATIO * found.largest(sizes)
        return cls(units, blocks, faint) if faint.any() else None

    def largest(self, sizes: Array) -> Array:
        """The size of the largest component that acts on each one, in the units of this one."""
        found = np.zeros(self.blocks.max() + 1)
        np.maximum.at(found, self.blocks, sizes / self.units)
        return np.asarray(self.units * found[self.blocks])

    def measured(self, sizes: Array) -> Array:
        """Sizes of components, those of faint ones as large as of others."""
        return np.where(self.components, np.maximum(sizes, self.largest(sizes)), sizes)
