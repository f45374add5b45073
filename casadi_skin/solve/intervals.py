"""Collocation equations of many states, most of whose derivatives vanish, by sparse factors of the intervals.

With x_0 the state at the start, y_k the R values of interval k, of which the last is its end, and s the scalars, the
closed matrix is

    B_k end(y_k-1) + L_k y_k + C_k s = b_k, k = 1 .. K,    D (x_0, y_1, ..., y_K, s) = c,

with end(y_0) = x_0. L_k, (R n, R n), has sparse factors where its unknowns come component by component in an order in
which 1 - A has, A the derivatives of the field; they are made once. The first K equations give all values from x_0 and
s, a start with any scalars; put into D they are equations S (x_0, s) = r, (n + scalars). No matrix n x n is formed:
S, where orbits close the monodromy matrix less 1 with a border, is applied. Of systems that dissipate almost all of its
eigenvalues are near -1, and minimal residuals (Eisenstat, Elman and Schultz 1983) come to rounding in some tens of
steps, whose directions serve all right-hand sides (de Sturler 1996).

Components are in units, in which factors are made and maps act.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.butcher import radau_table
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.half_plane import is_odd
from casadi_skin.zero.problem import Array, Indices, SingularError

MANY_STATES = 100  # from which on intervals have sparse factors
PIVOT_RATIO = 0.1  # of the largest entry of a column: a diagonal entry that is as large is the pivot
MOST_DIRECTIONS = 240  # of minimal residuals
SOLVED_RESIDUAL, DEPENDENT_IMAGE = 1e-12, 1e-10  # relative
ROUND_REDUCTION, SLOW_ROUND = 1e-6, 1e-2  # of a residual in a round, and in one that has come to rounding
LEAST_PROGRESS = 0.1  # of a residual: the part that a direction takes away
MOST_ROUNDS = 4  # of refinement


@dataclass(frozen=True, eq=False)
class _Part:
    """Non-zeros of the Jacobian, (intervals, non-zeros), in a sparse matrix by columns, the same for all intervals.

    `components` are those of its rows and columns; `bounds` those of its columns among its entries.
    """

    source: NDArray[np.int32]
    rows: Indices
    columns: Indices
    bounds: Indices
    components: tuple[Indices, Indices]

    @classmethod
    def of(
        cls, chosen: list[Indices], places: tuple[Indices, Indices], components: tuple[Indices, Indices], size: int
    ) -> _Part:
        """Of non-zeros of each interval, in one order, with their places and components in the first."""
        order = np.lexsort(places)
        rows, columns = (each[order] for each in places)
        source = np.stack([each[order].astype(np.int32) for each in chosen])
        bounds = np.searchsorted(columns, np.arange(size + 1))
        return cls(source, rows, columns, bounds, (components[0][order], components[1][order]))


class IntervalLayout:
    """Where the non-zeros of a problem's Jacobian go: L, B and C of each interval, and D.

    Attributes:
        n, K, R, m: numbers of components, of intervals, of values of an interval and of scalars.
        place: of each component in the order of elimination.
        values: numbers of the values of an interval, R n, in the order of L.
        left, before, scalars: L, B and C.
        below: non-zeros of D but for its last row, with their `places`.
    """

    def __init__(self, problem: CollocationEquations) -> None:
        self.n, self.K, self.R = problem.formulation.states, problem.resolution, problem.table.ends.size
        self.states, self.m = problem.states, problem.size - problem.states
        order = np.asarray(problem.formulation.component_order)
        self.place = np.argsort(order)
        n, width = self.n, self.n * self.R
        self.values = (np.arange(self.R) * n + order[:, None]).ravel()
        rows, columns = problem.pattern  # column by column
        found: list[list[Indices]] = [[], [], []]
        for k in range(self.K):
            own = n + width * k
            ranges = (own, own + width), (own - n, own), (problem.states, problem.size)
            for chosen, (first, last) in zip(found, ranges, strict=True):
                a, b = np.searchsorted(columns, (first, last))
                chosen.append(a + np.flatnonzero((rows[a:b] >= width * k) & (rows[a:b] < width * (k + 1))))
        parts = []
        for chosen, first, size in zip(found, (n, 0, problem.states), (width, n, self.m), strict=True):
            row, column = rows[chosen[0]], columns[chosen[0]] - first
            of_both = row % n, column % n
            if size == width:
                column = self.place[column % n] * self.R + column // n
            parts.append(_Part.of(chosen, (self.place[row % n] * self.R + row // n, column), of_both, size))
        self.left, self.before, self.scalars = parts
        self.below = np.flatnonzero(rows >= self.K * width)
        self.places = rows[self.below] - self.K * width, columns[self.below]

    def systems(self, nonzeros: Array, units: Array) -> Iterator[tuple[Any, Any]]:
        """L_k by columns and B_k by rows."""
        from scipy.sparse import csc_matrix

        width, left, before = self.n * self.R, self.left, self.before
        ratios, starts = (units[c] / units[r] for r, c in (left.components, before.components))
        for own, start in zip(left.source, before.source, strict=True):
            system = csc_matrix((nonzeros[own] * ratios, left.rows, left.bounds), shape=(width, width))
            yield system, csc_matrix((nonzeros[start] * starts, before.rows, before.bounds), (width, self.n)).tocsr()


class Intervals:
    """The factors of L_k and the matrices B_k, of components in some units; maps act on vectors in these.

    `systems` are L_k by columns and B_k by rows, `ends` the places of the end among the values of an interval.
    """

    def __init__(self, systems: Iterable[tuple[Any, Any]], ends: Indices) -> None:
        from scipy.sparse.linalg import splu

        self.factors, self.before, self.ends = list[Any](), list[Any](), ends
        for system, before in systems:
            options = {"SymmetricMode": True}
            try:
                factors = splu(system, permc_spec="NATURAL", diag_pivot_thresh=PIVOT_RATIO, options=options)
            except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
                raise SingularError(f"an interval of the mesh is too long: {error}") from error
            self.factors.append(factors)
            self.before.append(before)

    @classmethod
    def by_radau(cls, problem: CollocationEquations, z: Array, n: int, units: Array) -> Intervals:
        """Maps of the first n components on the intervals of a solution, by Radau's method of the same degree."""
        from scipy.sparse import csc_matrix

        table, K = radau_table(problem.degree), problem.resolution
        d, (rows, columns) = table.degree, problem.formulation.entries
        chosen = np.flatnonzero((rows < n) & (columns < n))
        rows, columns, order = rows[chosen], columns[chosen], np.asarray(problem.formulation.component_order)
        place, one, size = np.argsort(order[order < n]), np.arange(n * d), n * d
        stage, value = np.arange(d), np.arange(d)[:, None]
        at = [
            np.broadcast_to(each, (d, d, rows.size)).ravel()
            for each in (place[rows] * d + value[:, :, None], place[columns] * d + stage[:, None])
        ]
        keys = np.append(at[1] * size + at[0], one * (size + 1))
        found, slots = np.unique(keys, return_inverse=True)
        bounds, identity = np.searchsorted(found, np.arange(size + 1) * size), slots[-size:]
        before = csc_matrix(
            (-np.ones(size), (np.arange(size), np.repeat(np.argsort(place), d))), shape=(size, n)
        ).tocsr()
        starts = np.append(0.0, np.cumsum(problem.constants)[:-1])
        fractions = np.append(starts[:, None] + problem.constants[:, None] * table.nodes, 1.0)
        scalars = z[problem.states :], problem.values
        derivatives = problem.discretisation.derivatives_at(fractions[:, None], problem.sample(z, fractions), *scalars)
        derivatives = (derivatives[:-1, chosen] * (units[columns] / units[rows])).reshape(K, d, -1)

        def systems() -> Iterator[tuple[Any, Any]]:
            for length, along in zip(problem.constants, derivatives, strict=True):
                data = np.zeros(found.size)
                data[identity] = 1.0
                data[slots[:-size]] -= (length * table.extended[:, :, None] * along).ravel()
                yield csc_matrix((data, found % size, bounds), shape=(size, size)), before

        return cls(systems(), place * d + d - 1)

    def carried(self, x: Array, first: int = 0) -> Array:
        """Perturbations, (n, any), over the period from the start of an interval."""
        for k in np.roll(np.arange(len(self.factors)), -first):
            x = -self.factors[k].solve(self.before[k] @ x)[self.ends]
        return x

    def carried_back(self, w: Array, first: int = 0) -> Array:
        """The transposed map."""
        for k in np.roll(np.arange(len(self.factors)), -first)[::-1]:
            at = np.zeros((self.before[k].shape[0], w.shape[1]))
            at[self.ends] = w
            w = -(self.before[k].T @ self.factors[k].solve(at, "T"))
        return w

    @property
    def orientation(self) -> float:
        """The sign of the product of the determinants of L_k."""
        sign = 1.0
        for factors in self.factors:
            odd = sum(is_odd(permutation) for permutation in (factors.perm_r, factors.perm_c))
            sign *= float(np.prod(np.sign(factors.U.diagonal()))) * (-1.0) ** odd
        return sign


class IntervalFactors:
    """Solves of the closed matrix [dR/dz; row] by minimal residuals of S, whose rows and columns are of one size.

    `sizes` are those of all unknowns. The directions and their images, orthonormal, serve all right-hand sides.
    """

    def __init__(self, problem: CollocationEquations, nonzeros: Array, row: Array, sizes: Array) -> None:
        from scipy.sparse import csr_matrix

        n = problem.formulation.states
        units = np.exp2(np.round(np.log2(sizes[:n])))
        of: IntervalLayout = problem.kept("sparse intervals", lambda: IntervalLayout(problem))
        self.layout, self.intervals = of, Intervals(of.systems(nonzeros, units), of.place * of.R + of.R - 1)
        self._units = np.concatenate([np.tile(units, problem.columns), sizes[of.states :]])
        self._start = np.append(np.arange(n), np.arange(of.states, problem.size))  # places of x_0 and s
        self._values = n + np.arange(of.K)[:, None] * n * of.R + of.values  # of y_k in the order of L_k
        scalars = np.zeros((of.K, n * of.R, of.m))
        scalars[:, of.scalars.rows, of.scalars.columns] = nonzeros[of.scalars.source]
        self._scalars = scalars * sizes[of.states :] / self._units[self._values[0], None]
        count = problem.size - 1 - of.K * n * of.R
        self._below, self._row = csr_matrix((nonzeros[of.below], of.places), shape=(count, problem.size)), row
        largest = np.append(abs(self._below) @ self._units, np.abs(row) @ self._units)
        self._scales = 1.0 / np.where(largest > 0.0, largest, 1.0)  # of the equations D
        self._size = n + of.m
        self._forget()

    def _forget(self) -> None:
        self._count = 0
        self._directions, self._images = (np.zeros((self._size, MOST_DIRECTIONS), order="F") for _ in range(2))

    def __call__(self, b: Array) -> Array:
        if b.ndim > 1:
            return np.stack([self(column) for column in b.T], axis=1)
        start = np.zeros(self._size)
        found = self._reached(start, b)
        left = self._missed(found, b)
        size = before = float(np.linalg.norm(left))
        for _ in range(MOST_ROUNDS):
            start = start + self._solved(left)
            other = self._reached(start, b)
            left = self._missed(other, b)
            now = float(np.linalg.norm(left))
            if now < before:
                found = other
            if now <= SOLVED_RESIDUAL * size or now > SLOW_ROUND * before:
                break
            before = now
        return found

    def _reached(self, start: Array, b: Array | None) -> Array:
        """All unknowns from a start and scalars in their units, where the equations but D hold."""
        of, z = self.layout, np.empty(self._units.size)
        x, s = np.split(start, [of.n])
        for k, (factors, before) in enumerate(zip(self.intervals.factors, self.intervals.before, strict=True)):
            right = -(before @ x) - self._scalars[k] @ s
            if b is not None:
                right += b[self._values[k] - of.n] / self._units[self._values[k]]
            y = factors.solve(right)
            z[self._values[k]], x = y, y[self.intervals.ends]
        z[self._start] = start
        return np.asarray(z * self._units)

    def _missed(self, z: Array, b: Array | None = None) -> Array:
        """By how much the equations D are missed, in their scales."""
        missed = -np.append(np.asarray(self._below @ z), self._row @ z)
        return np.asarray((missed if b is None else missed + b[-missed.size :]) * self._scales)

    def _solved(self, right: Array) -> Array:
        """A start with the least residual of S in the directions that are known and those that are added."""
        if self._count == MOST_DIRECTIONS:
            self._forget()
        U, C = self._directions, self._images
        parts = C[:, : self._count].T @ right
        start, left = U[:, : self._count] @ parts, right - C[:, : self._count] @ parts
        enough, way = ROUND_REDUCTION * float(np.linalg.norm(right)), left
        while np.linalg.norm(left) > enough and self._count < MOST_DIRECTIONS:
            k, u = self._count, way / np.linalg.norm(way)
            c = -self._missed(self._reached(u, None))
            size = np.linalg.norm(c)
            for _ in range(2):
                parts = C[:, :k].T @ c
                c, u = c - C[:, :k] @ parts, u - U[:, :k] @ parts
            if not np.linalg.norm(c) > DEPENDENT_IMAGE * size:
                break
            U[:, k], C[:, k] = u / np.linalg.norm(c), c / np.linalg.norm(c)
            self._count += 1
            part = float(C[:, k] @ left)
            # Where a residual is hardly smaller its image is followed: the method does not break down.
            way = left - part * C[:, k] if abs(part) > LEAST_PROGRESS * np.linalg.norm(left) else C[:, k]
            start, left = start + part * U[:, k], left - part * C[:, k]
        return start

    @property
    def orientation(self) -> float:
        """The sign of the determinant: that of S by its real eigenvalues on the other side of 0 than most of them.

        These are far from the others, and are those of S on the directions.
        """
        of, U = self.layout, self._directions[:, : self._count]
        basis, triangle = np.linalg.qr(U)
        restricted = np.linalg.solve(triangle.T, (basis.T @ self._images[:, : self._count]).T).T
        values = np.linalg.eigvals(restricted)
        most = float(np.sign(np.median(values.real)))
        apart = int(np.count_nonzero((values.imag == 0.0) & (values.real * most < 0.0)))
        swapped = of.n * (of.K * of.R * of.n)  # columns of x_0 behind those of the intervals
        sign = self.intervals.orientation * most**self._size * (-1.0) ** (apart + swapped)
        return float(sign)
