"""Minimally augmented problems, whose regular solutions are special points.

Beside the equations F = 0 of the solutions, of which one more parameter is free, stand the entries of a small matrix
G(z), which vanishes where a matrix B(z) of their linearisation loses rank:

    [ B    L ] [ V ]   [ 0 ]        [ B^T  R ] [ Psi ]   [ 0 ]
    [ R^T  0 ] [ G ] = [ I ],       [ L^T  0 ] [  H  ] = [ I ],        dG = -Psi^T dB V

with borders L and R in general position (Govaerts 2000, chapters 3 and 8). B is, with its shape but for the rank that
it loses: of a fold F_x, (m, m); of a branch point (F_x, F_p), (m, m + 1), where F is pushed along L by an unknown that
comes back as zero; of a period doubling the linearised equations of the state with v(1) = -v(0), (k, k); of a torus two
copies of them with v2(0) = v1(1) and v2(1) - 2 kappa v2(0) + v1(0) = 0, (2 k + 1, 2 k), where kappa is the cosine of
the angle of the multipliers: real, and regular where kappa goes through 1 and -1 (Doedel, Keller and Kernevez 1991). Of
an autonomous orbit v2 closes up to a multiple of the velocity, across which v1 starts, as the trivial multiplier is 1
as well. Products with F_xx are differences of F_x, which a Newton step needs to few digits: exact ones, as gradients
have them, take up to five times as long, and curves of special orbits 5 to 40 per cent longer.

Equilibria are the same with F = f(x, p) at rest. At a Hopf point B is that of f_x v1 / rate = v2 and f_x v2 / rate =
-kappa v1, with v1 across a vector, (2 n + 1, 2 n), and kappa = (omega / rate)^2: regular where kappa goes through zero
(Roose and Hlavacek 1985).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casadi_skin.native import give_back, kernels
from casadi_skin.native.collocation import MOST_STATES, CollocationKernel
from casadi_skin.zero.balanced import dense, is_mostly_zero
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.kinds import DOUBLING, HOPF, KINDS, TORUS
from casadi_skin.zero.linearised import Linearised, Vector, critical_pair, null_vectors, velocities
from casadi_skin.zero.problem import EPSILON, Array, Indices, Problem, SingularError, Solve
from casadi_skin.zero.rest import AlgebraicProblem
from casadi_skin.zero.stated_problem import ZERO_SOLUTION_SIZE, BoundaryProblem
from casadi_skin.zero.statement import Statement

RESTING_COMPONENT_RATIO = 1e-5  # of the largest component: what a smaller one changes by is not known from its size
LONG_ROW_FACTOR = 1e-2  # of the rows of a border, which are no pivots then
BORDER_RESIDUAL = 1e-12  # of the largest terms: what solutions by intervals may leave
SUM_ROUNDING = 4.0  # times the root of the sum of squares of terms of G, each rounded: that of G, null vectors among it
DIFFERENCE_STEP = EPSILON ** (1.0 / 3.0)  # of the sizes of unknowns: that of differences of the Jacobian


BothWays: TypeAlias = tuple[Array, Array]  # solutions x of K x = b and y of K^T y = c


@dataclass(frozen=True, eq=False)
class Singularity:
    """What makes a solution special.

    Attributes:
        kind: "fold", "hopf", "period doubling", "torus" or "branch point".
        first: name of the parameter that is found with the solution.
        sizes: units of the components of the state, shape (components,).
        normal: of a torus or a Hopf point, shape (components,): v1 is orthogonal to it, at the start.
        turn: the matrix S of solutions that close as x(1) = S x(0), where it is not 1.
        autonomous: of a torus, whether the velocity is a Floquet function with the multiplier 1.
        rate: of a Hopf point, the scale of omega.
    """

    kind: str
    first: str
    sizes: Array
    normal: Array
    turn: Array = field(default_factory=lambda: np.zeros((0, 0)))
    autonomous: bool = False
    rate: float = 1.0

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of G: numbers of left and of right null vectors."""
        return KINDS[self.kind].shape

    @property
    def pushes(self) -> int:
        """Number of unknowns that push the equations, which B has a column for."""
        return self.shape[1] - 1

    @property
    def added(self) -> int:
        """Number of unknowns beside those of the solution, one less than entries of G: kappa, or the push."""
        return self.shape[0] * self.shape[1] - 1

    def formulation(self, statement: Statement, walking: str | None) -> Formulation:
        """That of the solutions themselves; their scalars are the free parameters, `first`, the added ones and u."""
        known = statement.with_free(self.first).formulation(walking)
        if not self.added:
            return known
        key, made = (*statement.free, walking, self.first, self.added), statement.formulations
        if key in made:
            return made[key]
        kind, last = type(known.scalars), int(known.scalars.numel()) - 1
        scalars = kind.sym("scalars", last + self.added + 1)
        values = [known.field, known.conditions, known.integrands]
        inner = ca.vertcat(scalars[:last], scalars[last + self.added])
        field, conditions, integrands = ca.substitute(values, [known.scalars], [inner])
        made[key] = replace(known, scalars=scalars, field=field, conditions=conditions, integrands=integrands)
        return made[key]


class Augmented(Problem):
    """Unknowns z = (states, free parameters, the first parameter, kappa or the push, u) of special solutions.

    The equations of the solutions themselves, then the entries of G.
    """

    singularity: Singularity
    equations: int  # of the solutions
    _last: tuple[bytes, tuple[Array, Array], Array] | None = None

    @property
    def first_index(self) -> int:
        """Place of the first parameter among the unknowns."""
        return self.size - 2 - self.singularity.added

    @property
    def added_index(self) -> int:
        """Place of kappa, or of the push, among the unknowns.

        Kappa is (omega/rate)^2 of a Hopf point, negative where the eigenvalues are real with sum zero; of a torus the
        cosine of the angle of the multipliers, beyond 1 and -1 where these are real with product 1.
        """
        return self.size - 2

    def frequency_of(self, z: Array) -> float:
        """That of the critical pair of a Hopf point; raises ArithmeticError of a real one."""
        if not z[self.added_index] > 0.0:
            raise ArithmeticError("a neutral saddle has no frequency")
        return float(self.singularity.rate * np.sqrt(z[self.added_index]))

    @abstractmethod
    def own(self, z: Array) -> tuple[Array, Array]:
        """Residuals of the solution's own equations, and the values of their Jacobian."""

    @property
    @abstractmethod
    def own_places(self) -> tuple[Indices, Indices]:
        """Rows and columns of these values, column by column."""

    @abstractmethod
    def border(self, z: Array, nonzeros: Array | None = None) -> Border:
        """The solution of the bordered equations of B, by the values of the Jacobian; raises SingularError."""

    @property
    @abstractmethod
    def copies(self) -> tuple[int, int, int]:
        """How often B holds the Jacobian, and how many rows and columns of it."""

    def push_size(self, z: Array) -> float:
        """The size of a push that matters."""
        return 1.0

    @abstractmethod
    def rounding(self, z: Array) -> Array:  # type: ignore[override]
        """Of each equation."""

    @abstractmethod
    def lengths(self, z: Array) -> Array:
        """Scale of each unknown, shape (size,)."""

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        rows, columns, _ = self._entries
        return rows, columns

    @property
    def _entries(self) -> tuple[Indices, Indices, Indices]:
        """Rows and columns of the non-zeros, column by column, and which of them each value that `evaluate` has is."""

        def made() -> tuple[Indices, Indices, Indices]:
            own, size = self.equations, self.size
            parts = [self.own_places]
            if self.singularity.pushes:
                parts.append((np.arange(own), np.full(own, self.added_index)))
            more = np.arange(own, size - 1)
            parts.append((np.repeat(more, size), np.tile(np.arange(size), more.size)))
            keys = np.concatenate([columns * np.int64(size - 1) + rows for rows, columns in parts])
            found, slots = np.unique(keys, return_inverse=True)
            return (found % (size - 1)).astype(np.int32), (found // (size - 1)).astype(np.int32), slots

        entries: tuple[Indices, Indices, Indices] = self.kept("entries", made)
        return entries

    times, null_vector = Problem.times, Problem.null_vector  # whose rows are not those of collocation alone

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        at = z.tobytes() + self.numbers.tobytes()
        if self._last is None or self._last[0] != at:
            self._last = at, *self._evaluated(z)
        return self._last[1]

    def _evaluated(self, z: Array) -> tuple[tuple[Array, Array], Array]:
        """The equations, and the size of the terms of G."""
        residual, nonzeros = self.own(z)
        border = self.border(z, nonzeros)
        values = [nonzeros]
        if self.singularity.pushes:
            residual = residual + z[self.added_index] * border.push
            values.append(border.push)
        values.append(self._slopes(z, border).ravel())
        rows, _, slots = self._entries
        found = np.bincount(slots, np.concatenate(values), rows.size).astype(float)
        return (np.concatenate([residual, border.G.ravel()]), found), border.terms.ravel()

    def _slopes(self, z: Array, border: Border) -> Array:
        """The derivatives of G by all unknowns, shape (entries, size)."""
        (copies, rows, width), (own_rows, own_columns) = self.copies, self.own_places
        inside = np.flatnonzero(own_rows < rows)
        own_rows, own_columns = own_rows[inside], own_columns[inside]
        found = np.zeros((*border.G.shape, self.size))
        for j, v in enumerate(border.right.T):
            for copy in range(copies):
                direction = np.zeros(self.size)
                direction[:width] = v[copy * width :][:width]
                change = self._change(z, direction)[inside]
                for i, psi in enumerate(border.left.T):
                    found[i, j] -= np.bincount(own_columns, psi[copy * rows :][own_rows] * change, self.size)
            found[:, j] += self.further_slopes(z, border.left, v)
        return found.reshape(-1, self.size)

    def further_slopes(self, z: Array, left: Array, v: Array) -> Array:
        """The part of what is in B beside the Jacobian, shape (left, size)."""
        return np.zeros((left.shape[1], self.size))

    def _change(self, z: Array, direction: Array) -> Array:
        """The derivatives of the values of the solution's own Jacobian in a direction, by differences."""
        h = DIFFERENCE_STEP / max(float(np.max(np.abs(direction) / self.lengths(z))), 1e-300)
        ahead, behind = (self.own(z + side * h * direction)[1] for side in (1.0, -1.0))
        return np.asarray((ahead - behind) / (2.0 * h))

    def _leading(self, nonzeros: Array, rows: int, columns: int) -> Triplets:
        """The first rows and columns of the solution's own Jacobian."""
        own_rows, own_columns = self.own_places
        end = int(np.searchsorted(own_columns, columns))
        chosen = np.flatnonzero(own_rows[:end] < rows)
        return Triplets(nonzeros[chosen], own_rows[chosen], own_columns[chosen])


class SingularProblem(Augmented, BoundaryProblem):
    """Of special orbits and solutions of boundary-value problems.

    A finer mesh shows the errors: the scalar that vanishes has factors of its own, and no defect.
    """

    measured_by_defect = keeps_factors = False

    def __init__(self, singularity: Singularity, statement: Statement, *arguments: Any) -> None:
        super().__init__(statement.with_free(singularity.first), *arguments)
        self.singularity, self.orbit = singularity, statement

    def parameters(self, z: Array) -> Array:
        last = self.states + len(self.statement.free)
        scalars = np.append(z[self.states : last], z[-1])
        return np.asarray(self.statement.parameters_at(scalars, self.walking, self.end), dtype=float)

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        return super().kept(f"{name} of a {self.singularity.kind}", make)

    @property
    def shared(self) -> dict[Any, Any]:
        """Of the last singularity of each kind."""
        known, kind = super().shared, self.singularity.kind
        if kind not in known or known[kind][0] is not self.singularity:
            known[kind] = self.singularity, {}
        found: dict[Any, Any] = known[kind][1]
        return found

    def own(self, z: Array) -> tuple[Array, Array]:
        return self.discretisation(z, self.numbers)

    @property
    def own_places(self) -> tuple[Indices, Indices]:
        return self.discretisation.rows, self.discretisation.columns

    def lengths(self, z: Array) -> Array:
        return self.sizes(z)

    def rounding(self, z: Array) -> Array:  # type: ignore[override]
        found = BoundaryProblem.rounding(self, z)
        assert self._last is not None
        found[self.equations :] = SUM_ROUNDING * self.statement.model.rounding * self._last[2]
        return found

    @property
    def copies(self) -> tuple[int, int, int]:
        given = self.singularity
        if KINDS[given.kind].angle != 0.0:
            return given.shape[0], self.states - self.formulation.states, self.states
        return 1, self.equations, self.states + len(self.orbit.free) + given.pushes

    def rests(self, z: Array) -> bool:
        """Whether the solution is constant, and its mesh says nothing about null vectors."""
        values = z[: self.states].reshape(self.columns, -1)
        return bool(np.all(np.ptp(values, axis=0) <= RESTING_COMPONENT_RATIO * self.singularity.sizes))

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        return np.inf if self.rests(z) else super().expected_error(z, error, other)

    def improvement(self, z: Array, solve: Solve) -> tuple[Array, Array] | None:
        return None

    def border(self, z: Array, nonzeros: Array | None = None) -> Border:
        """By rows that are measured by the components of the state."""
        nonzeros = self.own(z)[1] if nonzeros is None else nonzeros
        given, sizes, n, k = self.singularity, self.sizes(z), self.formulation.states, self.states
        sizes[:k] = np.tile(given.sizes, self.columns)
        if KINDS[given.kind].angle == 0.0:
            width = self.copies[2]
            B, rows = self._leading(nonzeros, self.equations, width), np.full(self.equations, np.max(given.sizes))
            rows[: k - n] = sizes[: k - n]
            return Border.of(B, rows, sizes[:width], given.shape, self._condensed)
        field, turn, one = self._leading(nonzeros, k - n, k), given.turn, np.eye(n)
        turn = turn if turn.size else one
        if given.kind == DOUBLING:
            B = field + _blocks((k - n, 0, turn), (k - n, k - n, one))
            return Border.of(B, sizes[:k], sizes[:k], (1, 1), self._condensed)
        second, back, kappa = field.moved(k - n, k), np.linalg.inv(turn), z[self.added_index]
        end, start, shifts = 2 * (k - n), z[:n], int(given.autonomous)
        closing = [
            (end, k - n, -back), (end, k, one), (end + n, 0, one), (end + n, k, -2.0 * kappa * one),
            (end + n, 2 * k - n, back), (2 * k, 0, given.normal[None]),
        ]  # fmt: skip
        if shifts:
            velocity = np.array(self.formulation.field_function(0.0, start, z[k:], self.values)[0]).ravel()
            closing += [(end + n, 2 * k, -velocity[:, None]), (2 * k + 1, 0, (velocity / given.sizes**2)[None])]
        columns = np.concatenate([sizes[:k], sizes[:k], np.ones(shifts)])
        B, rows = field + second + _blocks(*closing), np.append(columns, 1.0)
        return Border.of(B, rows, columns, (2, 1), self._condensed)

    def _condensed(self, K: Triplets, b: Array, c: Array) -> BothWays | None:
        """Solutions x of K x = b and y of K^T y = c interval by interval, copies side by side as states.

        None without the kernel, and where they leave residuals, as beside branch points that no parameter moves.
        """
        size, copies, n = len(b), self.copies[0], self.copies[0] * self.formulation.states
        if not kernels() or n > MOST_STATES:
            return None

        def made() -> tuple[CollocationKernel, Indices, Indices, tuple[Indices, Indices]]:
            counts = copies * self.states - n, copies * self.states
            places = [np.arange(count).reshape(-1, copies, n // copies).swapaxes(0, 1).ravel() for count in counts]
            rows, columns = (np.append(some, range(some.size, size)) for some in places)
            closing, row, column = K.rows == size - 1, rows[K.rows], columns[K.columns]
            inside = np.flatnonzero(~closing)
            inside = inside[np.argsort(column[inside], kind="stable")]
            own = KINDS[self.singularity.kind].angle == 0.0  # else what closes the function, by its ends
            most = n + size - counts[1] - 1
            conditions = int(self.formulation.conditions.numel()) if own else most
            sizes = n, self.resolution, self.table.ends.size, size - counts[1]
            data = (conditions, most - conditions), (row[inside], column[inside])
            kernel = CollocationKernel(sizes, *data, (np.inf, np.inf), np.ones(size - 1))
            return kernel, inside, np.flatnonzero(closing), (rows, columns)

        kernel, inside, closing, (rows, columns) = self.kept("condensed", made)
        row = np.bincount(columns[K.columns[closing]], K.values[closing], size)
        factors = kernel.factors(K.values[inside], row, None, 1.0)
        if factors is None:
            return None
        found, good, most = list[Array](), True, BORDER_RESIDUAL * np.max(np.abs(K.values))
        for right, transposed in ((b, False), (c, True)):
            equations, unknowns = (rows, K.rows), (columns, K.columns)
            (of, i), (to, j) = (unknowns, equations) if transposed else (equations, unknowns)
            x = np.empty(right.T.shape)
            x[:, of] = right.T
            kernel.solve(factors[0], x, transposed)
            found.append(x[:, to].T)
            left = [np.bincount(i, K.values * v[to][j], size) for v in x] - right.T
            good = good and bool(np.max(np.abs(left)) <= most * np.max(np.abs(x)))
        give_back(factors[0])
        return (found[0], found[1]) if good else None

    def further_slopes(self, z: Array, left: Array, v: Array) -> Array:
        """That of the closing rows of a torus, by kappa and by the velocity at the start."""
        n, given = self.formulation.states, self.singularity
        if given.kind != TORUS:
            return super().further_slopes(z, left, v)
        closing = left[2 * (self.states - n) + n :]
        found = np.zeros((left.shape[1], self.size))
        found[:, self.added_index] = 2.0 * closing[:n].T @ v[self.states :][:n]
        if given.autonomous:
            at_start = self.formulation.field_function(0.0, z[:n], z[self.states :], self.values)
            by_velocity = self.velocity_weights(left, v)
            found[:, :n] += by_velocity @ np.array(at_start[1])
            found[:, self.states :] += by_velocity @ np.array(at_start[2])
        return found

    def velocity_weights(self, left: Array, v: Array) -> Array:
        """What the velocity at the start of an autonomous orbit is multiplied by there, shape (left, components)."""
        n, given = self.formulation.states, self.singularity
        closing = left[2 * (self.states - n) + n :]
        return np.asarray(closing[:n].T * v[-1] - closing[n + 1 :].T * v[:n] / given.sizes**2)

    def _place(self, equation: int, z: Array) -> str:
        if equation >= self.equations:
            return f"the condition of a {self.singularity.kind}"
        return super()._place(equation, z)


class SingularRest(Augmented, AlgebraicProblem):
    """Of special equilibria, whose own equations are those of `inner`, a problem without what is added, and without u
    where nothing is followed.
    """

    def __init__(self, singularity: Singularity, inner: AlgebraicProblem) -> None:
        first, *walking = (*inner.free, inner.walking)
        super().__init__(inner.statics, inner.scale, (first,), *walking)
        self.singularity, self.added, self.equations, self._inner = singularity, singularity.added, self.states, inner
        self._kept = np.delete(np.arange(self.size), range(inner.size - len(walking), self.size - len(walking)))

    def own(self, z: Array) -> tuple[Array, Array]:
        residual, nonzeros = self._inner._values(z[self._kept], self._inner.numbers)
        return residual.copy(), nonzeros.copy()

    @cached_property
    def own_places(self) -> tuple[Indices, Indices]:
        rows, columns = self._inner.pattern
        return rows, self._kept[columns]

    @cached_property
    def _entries(self) -> tuple[Indices, Indices, Indices]:
        return super()._entries

    def lengths(self, z: Array) -> Array:
        return np.append(self.singularity.sizes, np.maximum(np.abs(z[self.equations :]), 1.0))

    @property
    def copies(self) -> tuple[int, int, int]:
        n = self.equations
        return self.singularity.shape[0], n, n + self.singularity.pushes

    def border(self, z: Array, nonzeros: Array | None = None) -> Border:
        nonzeros = self.own(z)[1] if nonzeros is None else nonzeros
        given, n = self.singularity, self.equations
        width = self.copies[2]
        B, rows, columns = self._leading(nonzeros, n, width), given.sizes, np.append(given.sizes, np.ones(width - n))
        if given.kind == HOPF:
            B = Triplets(B.values / given.rate, B.rows, B.columns)
            one = Triplets(np.ones(n), np.arange(n), np.arange(n))
            B = B + B.moved(n, n) + one.moved(0, n, -1.0) + one.moved(n, 0, z[self.added_index])
            B = B + _blocks((2 * n, 0, given.normal[None]))
            columns = np.tile(columns, 2)
            rows = np.append(columns, 1.0)
        return Border.of(B, rows, columns, given.shape)

    def push_size(self, z: Array) -> float:
        n, units = self.equations, self.singularity.sizes
        slopes = self.filled(super().evaluate(z)[1])[n:] * self.lengths(z)
        return float(np.linalg.norm(dense(self.rates(z)) * units / units[:, None]) + np.max(np.abs(slopes)))

    def further_slopes(self, z: Array, left: Array, v: Array) -> Array:
        found, n = super().further_slopes(z, left, v), self.equations
        if self.singularity.kind == HOPF:
            found[:, self.added_index] = -left[n : 2 * n].T @ v[:n]
        return found

    def _change(self, z: Array, direction: Array) -> Array:
        found = super()._change(z, direction)
        return found / self.singularity.rate if self.singularity.kind == HOPF else found

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        return self._scaled(z, *super().evaluate(z))

    def rounding(self, z: Array) -> Array:  # type: ignore[override]
        found = np.full(self.size - 1, AlgebraicProblem.rounding(self, z))
        largest = self.equation_sizes(z, super().evaluate(z)[1])[self.equations :]
        assert self._last is not None
        own = SUM_ROUNDING * max(EPSILON, self.statics.model.rounding) * self._last[2] / largest
        found[self.equations :] = np.maximum(found[self.equations :], own)
        return found

    def entries(self, z: Array) -> Array:
        return super().evaluate(z)[1].copy()


def singular_rest(kind: str, inner: AlgebraicProblem, z: Array, near: complex | None) -> tuple[SingularRest, Array]:
    """The problem of a special equilibrium, and its unknowns, from an approximate one z in those of its own equations.

    `near` selects the pair of eigenvalues of a Hopf point, by default that nearest to the imaginary axis.
    """
    n, units = inner.states, inner.units(z)
    normal, rate, added = np.zeros_like(units), 1.0, [0.0] * (KINDS[kind].shape[1] - 1)
    if kind == HOPF:
        omega, q, _ = critical_pair(inner.rates(z), None if near is None else near.imag)
        rate = float(2.0 ** np.round(np.log2(abs(near or omega))))
        normal, added = normal_of(q, units), [(omega / rate) ** 2]
    first: Any = (*inner.free, inner.walking)[0]
    problem = SingularRest(Singularity(kind, first.name, units, normal, rate=rate), inner)
    return problem, np.concatenate([z[: n + 1], added, [0.0]])


@dataclass(frozen=True, eq=False)
class Triplets:
    """Entries of a sparse matrix with their rows and columns."""

    values: Array
    rows: Indices
    columns: Indices

    def __add__(self, other: Triplets) -> Triplets:
        both = zip((self.values, self.rows, self.columns), (other.values, other.rows, other.columns), strict=True)
        return Triplets(*(np.concatenate(pair) for pair in both))

    def moved(self, rows: int, columns: int, factor: float = 1.0) -> Triplets:
        """A multiple of the same, further down and to the right."""
        return Triplets(factor * self.values, self.rows + rows, self.columns + columns)


def _blocks(*blocks: tuple[int, int, Array]) -> Triplets:
    """Dense matrices with the places of their first entries."""
    parts = []
    for row, column, block in blocks:
        rows, columns = np.indices(block.shape).reshape(2, -1)
        parts.append((block.ravel(), row + rows, column + columns))
    return Triplets(*(np.concatenate(part) for part in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class Border:
    """G, (nl, nr), with the size of its `terms`, and null vectors: `right` V, (columns, nr), `left` Psi, (rows, nl).

    `push` is the first column of L.
    """

    G: Array
    terms: Array
    right: Array
    left: Array
    push: Array

    @classmethod
    def of(
        cls, B: Triplets, rows: Array, columns: Array, shape: tuple[int, int],
        condensed: Callable[[Triplets, Array, Array], BothWays | None] | None = None,
    ) -> Border:  # fmt: skip
        """Of a matrix whose rows and columns have sizes; factorised by `condensed` where that can.

        Raises SingularError.
        """
        (nl, nr), p, q = shape, rows.size, columns.size
        scaled = Triplets(B.values * columns[B.columns] / rows[B.rows], B.rows, B.columns)
        L, border, b, c = _general(p, q, nl, nr)
        K = scaled + border
        found = None if condensed is None else condensed(K, b, c)
        found = found or (_sparse if is_mostly_zero(q + nl, K.values.size) else _dense)(K, b, c)
        right, left = found[0][:q], found[1][:p]
        if not (np.all(np.isfinite(right)) and np.all(np.isfinite(left))):
            raise SingularError("the linearised equations lose more rank than expected")
        products = scaled.values[:, None, None] * left[scaled.rows][:, :, None] * right[scaled.columns][:, None, :]
        G = -np.sum(products, axis=0)  # as good as both vectors together
        return cls(G, np.linalg.norm(products, axis=0), right * columns[:, None], left / rows[:, None], L[:, 0] * rows)


@lru_cache(maxsize=8)
def _general(p: int, q: int, nl: int, nr: int) -> tuple[Array, Triplets, Array, Array]:
    """L; L and R^T, with their places; and the right-hand sides b and c: of every matrix of one shape."""
    generator = np.random.default_rng(0)
    L, R = generator.normal(size=(p, nl)), generator.normal(size=(q, nr))
    b, c = np.vstack([np.zeros((p, nr)), LONG_ROW_FACTOR * np.eye(nr)]), np.vstack([np.zeros((q, nl)), np.eye(nl)])
    return L, _blocks((0, q, L), (p, 0, LONG_ROW_FACTOR * R.T)), b, c


def _sparse(K: Triplets, b: Array, c: Array) -> BothWays:
    """Solutions x of K x = b and y of K^T y = c."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    try:
        factors: Any = splu(csc_matrix((K.values, (K.rows, K.columns))))
    except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
        raise SingularError(f"the linearised equations lose more rank than expected: {error}") from error
    return factors.solve(b), factors.solve(c, "T")


def _dense(K: Triplets, b: Array, c: Array) -> BothWays:
    """The same with a small or full matrix."""
    from scipy.linalg.lapack import dgetrf, dgetrs

    size = len(b)
    matrix = np.bincount(K.columns * size + K.rows, K.values, size * size).reshape(size, size).T
    factors, pivots, singular = dgetrf(matrix)
    if singular:
        raise SingularError("the linearised equations lose more rank than expected")
    return dgetrs(factors, pivots, b)[0], dgetrs(factors, pivots, c, 1)[0]


def singularity_of(
    kind: str, problem: BoundaryProblem, z: Array, first: str, angle: float, turn: Array, autonomous: bool
) -> Singularity:
    """The singularity of a kind near a solution; `angle` is that of the multipliers of a torus."""
    sizes = component_sizes(z[: problem.states].reshape(problem.columns, -1))
    if KINDS[kind].angle == 0.0:
        return Singularity(kind, first, sizes, np.zeros_like(sizes))
    normal = np.zeros_like(sizes)
    if kind == TORUS:
        normal = normal_of(_start_of_plane(problem, z, angle, sizes, turn, autonomous), sizes)
    return Singularity(kind, first, sizes, normal, turn, autonomous)


def component_sizes(values: Array) -> Array:
    """Scale of each component of a Floquet function: the orbit's largest, or a usual one where it rests; 1 of zeros."""
    largest = np.max(np.abs(values), axis=0)
    moves = largest > RESTING_COMPONENT_RATIO * np.max(largest)
    if np.max(largest) <= ZERO_SOLUTION_SIZE:
        return np.ones(largest.size)
    return np.asarray(np.where(moves, largest, np.median(largest[moves])))


def _start_of_plane(
    problem: BoundaryProblem, z: Array, angle: float, sizes: Array, turn: Array, autonomous: bool
) -> Vector:
    """The start of the function q with q(1) = exp(i angle) turn q(0), of an autonomous orbit across the velocity."""
    q = null_vectors(Linearised(problem, z, problem.statement, angle, turn).twisted())[0]
    start = q[: problem.formulation.states]
    if not autonomous:
        return start
    velocity = velocities(problem, z)[0]
    shift = complex((velocity / sizes) @ (start / sizes) / np.sum((velocity / sizes) ** 2))
    return np.asarray(start - shift * velocity)


def normal_of(start: Vector, sizes: Array) -> Array:
    """A vector between the axes of the ellipse on which real parts of multiples of a complex one are.

    What is orthogonal to it is no eigenvector where the ellipse becomes a line, as at the resonances 1:1 and 1:2.
    """
    scaled = start / sizes
    turned = scaled * np.exp(-0.5j * np.angle(np.sum(scaled * scaled)))
    longer, shorter = (part / np.linalg.norm(part) for part in (turned.real, turned.imag))
    return np.asarray((longer - shorter) / np.sqrt(2.0) / sizes)
