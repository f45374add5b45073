"""Linear solves with the Jacobian of an orbit problem, closed by one more row (a held unknown or an arclength row).

Banded problems are solved by band LU with the dense columns and rows in a border, by the compiled kernel.
The band alone is singular at a linear mode (its null vector is the mode), so its diagonal entry at the largest entry of
the state is raised, and an unknown more in the border takes that back; Schur complement of a bordered matrix, Keller
(1977), Govaerts (2000) chapter 3. A few equations have dense factors. Of collocation the unknowns within the intervals
come first, so that dense blocks are left between ends of intervals alone (the condensation of Ascher, Mattheij and
Russell 1995, section 7.2): of few states by another compiled kernel, native/collocation.c. Everything else goes to
SuperLU, collocation of many states in an order that the model's own pattern determines, and what a kernel refuses.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native import MOST, BorderedKernel, Structure, give_back, kernels
from casadi_skin.native.collocation import MOST_STATES, CollocationKernel
from casadi_skin.native.dense import DenseKernel
from casadi_skin.solve.intervals import MANY_STATES, IntervalFactors
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.half_plane import is_odd
from casadi_skin.zero.problem import Array, Indices, Problem, SingularError, Solve
from casadi_skin.zero.rest import Undiscretised
from casadi_skin.zero.stated_problem import BoundaryProblem

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU


# Solves with a factorised matrix: a band with its border, or a sparse one by SuperLU ---------------------------------


class SmallFactors:
    """Solves with factors of a compiled kernel in its memory; `orientation` is the sign of the determinant."""

    def __init__(
        self, kernel: BorderedKernel | CollocationKernel | DenseKernel, memory: Array, orientation: float
    ) -> None:
        self.kernel, self.memory, self.orientation = kernel, memory, orientation

    def __call__(self, b: Array) -> Array:
        x = np.array(b.T, order="C", ndmin=2)
        self.kernel.solve(self.memory, x)
        return x.T.reshape(b.shape)


class CompiledFactors(SmallFactors):
    """The same of large matrices, whose memory is used again."""

    def __del__(self) -> None:
        give_back(self.memory)

    @property
    def compiled(self) -> tuple[Structure, Array]:
        """The layout and the factors, for compiled kernels that solve by themselves."""
        return self.kernel.layout, self.memory


class DenseFactors:
    """Solves with the factors of a dense matrix."""

    def __init__(self, matrix: Array) -> None:
        from scipy.linalg.lapack import dgetrf, dgetrs

        self._solve = dgetrs
        self._factors, self._pivots, where = dgetrf(matrix)
        if where:
            raise SingularError(f"the Jacobian with its border cannot be factorised: its pivot {where} is zero")

    def __call__(self, b: Array) -> Array:
        return np.asarray(self._solve(self._factors, self._pivots, b)[0])

    @property
    def orientation(self) -> float:
        """The sign of the determinant."""
        swaps = np.count_nonzero(self._pivots != np.arange(self._pivots.size))
        return float(np.prod(np.sign(np.diag(self._factors))) * (-1.0) ** swaps)


class SparseFactors:
    """Solves with factors by SuperLU of a matrix whose columns are in another order and whose rows are scaled."""

    def __init__(self, factors: SuperLU, order: Indices, scale: Array | None) -> None:
        self._factors, self._columns, self._scale = factors, order, scale

    def __call__(self, b: Array) -> Array:
        if self._scale is None:
            return np.asarray(self._factors.solve(b))
        found = np.empty(b.shape)
        found[self._columns] = self._factors.solve((self._scale * b.T).T)
        return found

    @property
    def orientation(self) -> float:
        """The sign of the determinant, 0 where it vanishes."""
        factors, permutations = self._factors, [self._factors.perm_r, self._factors.perm_c, self._columns]
        return float((-1.0) ** sum(map(is_odd, permutations)) * np.prod(np.sign(factors.U.diagonal())))


SINGULAR_GROWTH = 1e12  # growth of residuals, in units of both (`Problem.units_at`), that only a singular matrix gives
LONG_ROW_FACTOR = 1e-2  # factor of rows through most unknowns, as of integrals and of the arclength
DENSE_UNKNOWNS = 24  # up to which dense factors take less time than sparse ones, measured
# States: blocks between ends of intervals of more fill the factors, in another order 2 to 10 times less.
MOST_ORDERED = 200
MOST_FAILED = 3  # times in a row that a matrix is not solved by its intervals
ACCURATE_RESIDUAL = 1e-9  # residual of a solve, relative to the largest entries of matrix and solution


@dataclass(frozen=True)
class _Places:
    """The closed matrix: columns in the order of elimination, with the closing row as the last entry of every column.

    `rows` and `bounds` are its pattern; entries number `open` of it are the non-zeros `taken` of the Jacobian.
    """

    order: Indices
    closing: Indices
    open: Indices
    taken: Indices
    rows: NDArray[np.intc]
    bounds: NDArray[np.intc]

    @classmethod
    def of(cls, problem: Problem) -> _Places:
        size, (rows, columns) = problem.size, problem.pattern
        order, ends = problem.elimination_order, np.searchsorted(columns, np.arange(size + 1))
        counts = np.diff(ends)[order]
        bounds = np.append(0, np.cumsum(counts + 1))
        closing = bounds[1:] - 1
        opened = np.delete(np.arange(rows.size + size), closing)
        taken = np.arange(rows.size) + np.repeat(ends[:-1][order] - (np.cumsum(counts) - counts), counts)
        closed = np.full(rows.size + size, size - 1)
        closed[opened] = rows[taken]
        return cls(order, closing, opened, taken, closed.astype(np.intc), bounds.astype(np.intc))  # as SuperLU has them


@dataclass(frozen=True)
class Steps:
    """Solutions of [dR/dz; row] x = b at several states, each (states, unknowns), and the signs of the determinants.

    The right-hand side b is for `newton` the residuals, last that of the closing row; for `along` (0, ..., 0, 1); for
    `response` residuals of size 1 in general position, and 0.
    """

    newton: Array
    along: Array
    response: Array
    orientation: Array


class BorderedSolver:
    """Factorises [dR/dz; row] for one problem; the structure is analysed once, the numbers at each call."""

    def __init__(self, problem: Problem) -> None:
        self.problem, size = problem, problem.size
        self._kernel = _band_kernel(problem)
        self._probes = np.zeros((size, 3))
        self._probes[-1, 0], self._probes[:-1, 1:] = 1.0, problem.probe[:, None]
        self._collocation, self._dense_kernel = _collocation_kernel(problem), _dense_kernel(problem)
        self._failed = 0
        self._by_intervals: BoundaryProblem | None = None
        if isinstance(problem, BoundaryProblem) and problem.formulation.states >= MANY_STATES:
            self._by_intervals = problem if problem.equations == size - 1 else None

    @staticmethod
    def of(problem: Problem) -> BorderedSolver:
        """The one that serves all problems that differ in their constants only."""
        if "bordered" not in problem.shared:
            problem.shared["bordered"] = BorderedSolver(problem)
        found: BorderedSolver = problem.shared["bordered"]
        return found

    @cached_property
    def _places(self) -> _Places:
        found: _Places = self.problem.kept("closed", lambda: _Places.of(self.problem))
        return found

    @cached_property
    def _closed(self) -> Any:
        from scipy.sparse import csc_matrix

        places, size = self._places, self.problem.size
        return csc_matrix((np.zeros(places.rows.size), places.rows, places.bounds), shape=(size, size))

    @cached_property
    def _scale(self) -> Array:
        """Factors of the rows that keep those through most unknowns from being pivots, which would fill the factors."""
        scale = np.ones(self.problem.size)
        rows = self.problem.kept("long rows", lambda: long_rows(self._closed.indices, self.problem.size))
        scale[rows] = LONG_ROW_FACTOR
        return scale

    @cached_property
    def _scales(self) -> Array:
        """The same for every entry of the closed matrix."""
        return np.asarray(self._scale[self._closed.indices])

    def factor(self, z: Array, nonzeros: Array, row: Array) -> Solve:
        """A function that solves [dR/dz; row] x = b for b of shape (size,) or (size, columns).

        Raises SingularError where the matrix is singular to working precision.
        """
        if self._kernel is not None:
            x = np.array(self._probes.T[None, 1::-1], order="C")
            memory = self._kernel.memory()
            orientation = self._kernel.steps(z[None], nonzeros[None], row[None], x, memory)
            if orientation is not None:
                return CompiledFactors(self._kernel, memory, float(orientation[0]))
        dense = None if self._dense_kernel is None else self._dense_kernel.factors(nonzeros, row)
        if self._dense_kernel is not None and dense is not None:
            return SmallFactors(self._dense_kernel, *dense)
        condensed = self._condensed(nonzeros, row, z)
        if condensed is not None:
            return condensed
        if not (np.all(np.isfinite(nonzeros)) and np.all(np.isfinite(row))):
            raise SingularError("the Jacobian with its border cannot be factorised: an entry is not finite")
        solve = self._by_minimal_residuals(z, nonzeros, row) or self.unchecked(nonzeros, row)
        sizes, residuals = self.problem.units_at(z, nonzeros)
        probes = self._probes.copy()
        probes[:-1, 1] *= residuals
        if not self._accurate(solve(probes), sizes, nonzeros, row):
            raise SingularError(
                "the Jacobian with its border is singular: two families meet, a fold in the held unknown, or sizes "
                "too far apart for double precision"
            )
        return solve

    def _by_minimal_residuals(self, z: Array, nonzeros: Array, row: Array) -> Solve | None:
        """Solves by sparse factors of the intervals, of many states; None where they do not come to rounding."""
        problem = self._by_intervals
        if problem is not None and self._failed < MOST_FAILED:
            self._failed += 1
            with suppress(SingularError):
                solve = IntervalFactors(problem, nonzeros, row, problem.sizes_at(z)[0])
                if self._reproduces(solve(self._probes[:, 0]), nonzeros, row):
                    self._failed = 0
                    return solve
        return None

    @cached_property
    def takes_several(self) -> bool:
        """Whether several states are solved for at once: a band, and no equation without an unknown."""
        return self._kernel is not None and np.unique(self.problem.pattern[0]).size == self.problem.size - 1

    def steps(self, z: Array, residuals: Array, nonzeros: Array, rows: Array) -> Steps | None:
        """Solutions at states z, by residuals (states, unknowns), where it `takes_several`.

        None where a matrix is singular but for rounding.
        """
        assert self._kernel is not None
        x = np.zeros((len(z), 3, z.shape[1]))
        x[:, 0], x[:, 1, :-1], x[:, 2, -1] = residuals, self.problem.probe, 1.0
        signs = self._kernel.steps(z, nonzeros, rows, x)
        newton, response, along = x.swapaxes(0, 1)
        return None if signs is None else Steps(newton, along, response, signs)

    def orientation(self, nonzeros: Array, row: Array) -> float:
        """The sign of the determinant of [dR/dz; row], which a branch that crosses changes; 0 where it is singular."""
        try:
            return (self._condensed(nonzeros, row) or self.unchecked(nonzeros, row)).orientation
        except SingularError:
            return 0.0

    def _accurate(self, probes: Array, sizes: Array | float, nonzeros: Array, row: Array) -> bool:
        """Whether solutions for `_probes` reproduce their right-hand side and the matrix is not singular.

        The first, for (0, ..., 0, 1), gives the tangent; the others, for residuals in general position, in units of
        their own and of size 1, are huge where the matrix is singular: in `sizes` of unknowns, and as they are. Both
        have to be, as components that are zero but for rounding have no size. A NaN fails every comparison.
        """
        x, general, raw = np.ascontiguousarray(probes.T)
        if not (np.max(np.abs(general) / sizes) < SINGULAR_GROWTH or np.max(np.abs(raw)) < SINGULAR_GROWTH):
            return False
        return self._reproduces(x, nonzeros, row)

    def _reproduces(self, x: Array, nonzeros: Array, row: Array) -> bool:
        """Whether the matrix times x is (0, ..., 0, 1)."""
        largest = max(x.max(), -x.min()) * max(nonzeros.max(), -nonzeros.min())
        defect = self.problem.times(nonzeros, x)
        return bool(
            max(defect.max(), -defect.min()) <= ACCURATE_RESIDUAL * largest and abs(row @ x - 1.0) <= ACCURATE_RESIDUAL
        )

    def _condensed(self, nonzeros: Array, row: Array, z: Array | None = None) -> CompiledFactors | None:
        """By the kernel of collocation; None where there is none, and of a matrix that is singular, in sizes at z."""
        kernel = self._collocation
        if kernel is None:
            return None
        found = kernel.factors(nonzeros, row, *((None, 1.0) if z is None else self.problem.sizes_at(z)))
        return None if found is None else CompiledFactors(kernel, *found)

    def corrected(
        self, problem: Problem, newton: Structure, held: tuple[Array, Array, float], weights: Array
    ) -> tuple[str, int, Array, CompiledFactors] | None:
        """How Newton's method ends by the kernel, in how many steps, where, and factors of a matrix there or nearby.

        None where there is no kernel for the equations, and where it does not factorise a matrix. `held` are a guess
        and a row with the value of row . z, `weights` measure steps. What is known of the equations there is kept.
        """
        kernel = self._collocation
        if kernel is None or not isinstance(problem, CollocationEquations) or not problem.discretisation.in_operations:
            return None
        (guess, row, value), equations = held, problem.discretisation
        data = equations.compiled, problem.compiled_units, newton, problem.numbers, weights, row, value, guess
        status, steps, z, found, factors = kernel.corrected(*data)
        solve = CompiledFactors(kernel, *factors)
        if status == "SINGULAR":
            return None
        equations.keep(z, problem.numbers, found)
        return status, steps, z, solve

    def unchecked(self, nonzeros: Array, row: Array) -> Solve:
        """As `factor` of a matrix that may be nearly singular."""
        from scipy.sparse.linalg import splu

        if self.problem.size <= DENSE_UNKNOWNS and not self.problem.in_order:
            return DenseFactors(self._dense(nonzeros, row))
        self._close(nonzeros, row)
        try:
            if not self.problem.in_order:
                return SparseFactors(splu(self._closed), self._places.order, None)
            self._closed.data *= self._scales
            many = isinstance(self.problem, CollocationEquations) and self.problem.formulation.states > MOST_ORDERED
            factors = splu(self._closed, permc_spec="COLAMD" if many else "NATURAL")
            return SparseFactors(factors, self._places.order, self._scale)
        except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
            raise SingularError(f"the Jacobian with its border cannot be factorised: {error}") from error

    def _dense(self, nonzeros: Array, row: Array) -> Array:
        """The closed matrix of a small problem."""
        matrix = np.zeros((self.problem.size, self.problem.size))
        matrix[self.problem.pattern] = nonzeros
        matrix[-1] = row
        return matrix

    def _close(self, nonzeros: Array, row: Array) -> None:
        """Fill the closed matrix."""
        places, data = self._places, self._closed.data
        data[places.open], data[places.closing] = nonzeros[places.taken], row[places.order]


def _band_kernel(problem: Problem) -> BorderedKernel | None:
    """The compiled kernel of a band with columns right of it, rows below and a corner, where that has room for these.

    The border has the diagonal entry's unknown and row first; arrays are transposed, as LAPACK stores them.
    """
    width, n, size = problem.half_bandwidth, problem.states, problem.size
    if not kernels() or width is None or 3 * width >= n or size - n > MOST:
        return None
    (rows, columns), edge = problem.pattern, size - n + 1
    parts = (
        ((rows < n) & (columns < n), columns * (3 * width + 1) + 2 * width + rows - columns),
        ((rows < n) & (columns >= n), (columns - n + 1) * n + rows),
        ((rows >= n) & (columns < n), (rows - n + 1) * n + columns),
        ((rows >= n) & (columns >= n), (rows - n + 1) * edge + columns - n + 1),
    )
    places = [(np.flatnonzero(chosen), target[chosen]) for chosen, target in parts]
    return BorderedKernel((n, size, width), places, problem.pattern, (SINGULAR_GROWTH, ACCURATE_RESIDUAL))


def _collocation_kernel(problem: Problem) -> CollocationKernel | None:
    """The compiled kernel of collocation equations with few states, as many as unknowns but one."""
    if not (kernels() and isinstance(problem, CollocationEquations) and problem.pattern[0].max() == problem.size - 2):
        return None
    n, scalars = problem.formulation.states, problem.size - problem.states
    conditions = int(problem.formulation.conditions.numel())
    counts = conditions, n + scalars - 1 - conditions  # all other rows are long: integrals, and what augments them
    if n > MOST_STATES:
        return None
    sizes, limits = (n, problem.resolution, problem.table.ends.size, scalars), (SINGULAR_GROWTH, ACCURATE_RESIDUAL)
    found: CollocationKernel = problem.kept(
        "collocation", lambda: CollocationKernel(sizes, counts, problem.pattern, limits, problem.probe)
    )
    return found


def _dense_kernel(problem: Problem) -> DenseKernel | None:
    """The compiled kernel of a few equations that are not discretised, whose unknowns are of size 1."""
    if not (kernels() and isinstance(problem, Undiscretised) and problem.size <= DENSE_UNKNOWNS):
        return None
    return DenseKernel(problem.pattern, (SINGULAR_GROWTH, ACCURATE_RESIDUAL), problem.probe)


def long_rows(rows: NDArray[np.integer[Any]], size: int) -> Indices:
    """Those of the rows of all non-zeros that go through most unknowns."""
    return np.flatnonzero(np.bincount(rows) > 0.5 * size)
