"""Minimally augmented problems, whose regular solutions are special points.

Orbits and solutions of boundary-value problems. Beside their own equations F = 0, of which one more parameter is free,
stand the entries of a small matrix G(z), which vanishes where a matrix B(z) of their linearisation loses rank:

    [ B    L ] [ V ]   [ 0 ]        [ B^T  R ] [ Psi ]   [ 0 ]
    [ R^T  0 ] [ G ] = [ I ],       [ L^T  0 ] [  H  ] = [ I ],        dG = -Psi^T dB V

with borders L and R in general position (Govaerts 2000, chapters 3 and 8). B is, with its shape but for the rank that
it loses: of a fold F_x, (m, m); of a branch point (F_x, F_p), (m, m + 1), where F is pushed along L by an unknown that
comes back as zero; of a period doubling the linearised equations of the state with v(1) = -v(0), (k, k); of a torus two
copies of them with v2(0) = v1(1) and v2(1) - 2 kappa v2(0) + v1(0) = 0, (2 k + 1, 2 k), where kappa is the cosine of
the angle of the multipliers: real, and regular where kappa goes through 1 and -1 (Doedel, Keller and Kernevez 1991). Of
an autonomous orbit v2 closes up to a multiple of the velocity, across which v1 starts, as the trivial multiplier is 1
as well. Products with F_xx are differences of F_x, which a Newton step needs to few digits.

Extended systems whose regular solutions are folds, Hopf points and branch points of equilibria.

Fold: F = 0, F_y v = 0, v W v = 1 (Moore and Spence 1980). Hopf point: F = 0, F_y v = w, F_y w + kappa v = 0, v W v = 1,
d v = 0, with kappa = omega^2 (Roose and Hlavacek 1985), which stays regular where kappa goes through zero. Branch
point: F + beta c = 0, psi F_y = 0, psi F_p = 0, c psi = 1 with beta = 0 (Griewank and Reddien 1984). W, c and d are
constants that measure null vectors by the units of the state where the system is started.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, TORUS
from casadi_skin.zero.linearised import Linearised, Vector, null_vectors, velocities
from casadi_skin.zero.problem import EPSILON, Array, Indices, Problem, SingularError, Solve
from casadi_skin.zero.rest import AlgebraicProblem, BalancedMatrix, ComplexArray, Course, NullSpace, Statics, upper_pair
from casadi_skin.zero.stated_problem import ZERO_SOLUTION_SIZE, BoundaryProblem
from casadi_skin.zero.statement import Statement

# Extended systems whose regular solutions are folds, Hopf points and branch points of equilibria ----------------------


class ExtendedSystem(AlgebraicProblem):
    """Base of extended systems: their unknowns start from an approximate point, which sets their constants."""

    def __init__(
        self, statics: Statics, sizes: Array, free: Sequence[Course], walking: Course | None = None, rate: float = 1.0
    ) -> None:
        super().__init__(statics, sizes, free, walking)
        n = statics.size
        self.rate = float(2.0 ** np.round(np.log2(rate)))  # of time: the scale of omega
        self.others, self.added = self.shape(n)
        self.states = n + self.others
        self.constants = np.zeros(self.constant_count(n))

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        """Unknowns beside the state, and added scalars."""
        raise NotImplementedError

    @staticmethod
    def constant_count(n: int) -> int:
        """Number of constants."""
        return n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        """The system with its constants, and its unknowns, from dF/dy at an approximate point; u is 0.

        `near` selects the pair of eigenvalues, by default that nearest to the imaginary axis.
        """
        raise NotImplementedError

    def _units_near(self, y: Array, scalars: Array) -> Array:
        """Units of the state at an approximate point."""
        return self.units(
            np.concatenate([y, np.zeros(self.others), scalars, np.zeros(self.size - self.states - scalars.size)])
        )

    def units_beside(self, units: Array) -> Array:
        return np.tile(units, self.others // units.size)


class FoldSystem(ExtendedSystem):
    """Folds, with the null vector v of F_y."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 0

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F = self.force(y, self.parameters_at(scalars))
        return ca.vertcat(F, ca.jtimes(F, y, others), ca.dot(others, c * others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        v = NullSpace.of_rates(matrix, units).right[:, -1]
        return self.with_constants(units**-2.0), np.concatenate([y, v, scalars, [0.0]])


class BranchSystem(ExtendedSystem):
    """Branch points, with the left null vector psi of (F_y, F_p) and the imperfection beta, which is zero."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F, beta = self.force(y, self.parameters_at(scalars)), scalars[1]
        by_y, by_p = ca.jtimes(F, y, others, True), ca.dot(ca.jacobian(F, scalars)[:, 0], others)
        return ca.vertcat(F + beta * c, by_y, by_p, ca.dot(c, others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        psi = NullSpace.of_rates(matrix, units).left[:, -1]
        c = psi * units**2 / np.linalg.norm(psi * units)
        return self.with_constants(c), np.concatenate([y, psi / (c @ psi), scalars, [0.0, 0.0]])

    def units_beside(self, units: Array) -> Array:
        return np.asarray(1.0 / units)


class HopfSystem(ExtendedSystem):
    """Hopf points, with v and w = F_y v / rate in the critical plane, and kappa = (omega/rate)^2."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return 2 * n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        n, rate, kappa = self.statics.size, self.rate, scalars[len(self.free)]
        F = self.force(y, self.parameters_at(scalars))
        v, w = others[:n], others[n:]
        turned, back = ca.jtimes(F, y, v) / rate - w, ca.jtimes(F, y, w) / rate + kappa * v
        return ca.vertcat(F, turned, back, ca.dot(v, c[n:] * v) - 1, ca.dot(c[:n], v))

    @staticmethod
    def constant_count(n: int) -> int:
        return 2 * n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        linear, units = BalancedMatrix(matrix), self._units_near(y, scalars)
        values = linear.eigensystem[0]
        k = upper_pair(values, near)
        v, d = plane(linear.vectors(k)[0] / units)
        v, constants = v * units, np.concatenate([d / units, units**-2.0])
        w = matrix @ v / self.rate
        kappa = (values[k].imag / self.rate) ** 2
        return self.with_constants(constants), np.concatenate([y, v, w, scalars, [kappa, 0.0]])

    def kappa(self, z: Array) -> float:
        """(omega/rate)^2 of a solution; negative where the eigenvalues are real with sum zero."""
        return float(z[self.states + len(self.free)])


def plane(q: ComplexArray) -> tuple[Array, Array]:
    """An orthonormal basis of the plane of the real and imaginary parts of a vector, which may be turned freely."""
    turned = q * np.exp(-0.5j * np.angle(np.sum(q * q)))  # real and imaginary parts are orthogonal now
    v = turned.real / np.linalg.norm(turned.real)
    size = np.linalg.norm(turned.imag)
    if size > 1e-12:
        return v, turned.imag / size
    d = np.zeros_like(v)
    d[np.argmin(np.abs(v))] = 1.0
    d -= v * (v @ d)
    return v, d / np.linalg.norm(d)


# Special orbits and solutions, minimally augmented --------------------------------------------------------------------

RESTING_COMPONENT_RATIO = 1e-5  # of the largest component: what a smaller one changes by is not known from its size
LONG_ROW_FACTOR = 1e-2  # of the rows of a border, which are no pivots then
SUM_ROUNDING = 4.0  # times the root of the sum of squares of terms of G, each rounded: that of G, null vectors among it
DIFFERENCE_STEP = EPSILON ** (1.0 / 3.0)  # of the sizes of unknowns: that of differences of the Jacobian


@dataclass(frozen=True, eq=False)
class Singularity:
    """What makes an orbit or a solution special.

    Attributes:
        kind: "fold", "period doubling", "torus" or "branch point".
        first: name of the parameter that is found with the solution.
        sizes: units of the components of the state, shape (components,).
        normal: of a torus, shape (components,): v1 is orthogonal to it at the start.
        turn: the matrix S of solutions that close as x(1) = S x(0), where it is not 1.
        autonomous: of a torus, whether the velocity is a Floquet function with the multiplier 1.
    """

    kind: str
    first: str
    sizes: Array
    normal: Array
    turn: Array = field(default_factory=lambda: np.zeros((0, 0)))
    autonomous: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """The shape of G: numbers of left and of right null vectors."""
        return (2, 1) if self.kind == TORUS else (1, 2) if self.kind == BRANCH_POINT else (1, 1)

    @property
    def added(self) -> int:
        """Number of unknowns beside those of the solution, one less than entries of G: kappa, or the push."""
        return self.shape[0] * self.shape[1] - 1

    def formulation(self, statement: Statement, walking: str | None) -> Formulation:
        """That of the solutions themselves; their scalars are the free parameters, `first`, the added ones and u."""
        known = statement.with_free(self.first).formulation(walking)
        if not self.added:
            return known
        kind, last = type(known.scalars), int(known.scalars.numel()) - 1
        scalars = kind.sym("scalars", last + self.added + 1)
        values = [known.field, known.conditions, known.integrands]
        inner = ca.vertcat(scalars[:last], scalars[last + self.added])
        field, conditions, integrands = ca.substitute(values, [known.scalars], [inner])
        return replace(known, scalars=scalars, field=field, conditions=conditions, integrands=integrands)


class SingularProblem(BoundaryProblem):
    """Unknowns z = (states, free parameters, the first parameter, kappa or the push, u) of special solutions."""

    def __init__(self, singularity: Singularity, statement: Statement, *arguments: Any) -> None:
        super().__init__(statement.with_free(singularity.first), *arguments)
        self.singularity, self.orbit = singularity, statement
        self._last: tuple[bytes, tuple[Array, Array], Array] | None = None

    def parameters(self, z: Array) -> Array:
        last = self.states + len(self.statement.free)
        scalars = np.append(z[self.states : last], z[-1])
        return np.asarray(self.statement.parameters_at(scalars, self.walking, self.end), dtype=float)

    @property
    def added_index(self) -> int:
        """Place of kappa, or of the push, among the unknowns."""
        return self.size - 2

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        return super().kept(f"{name} of a {self.singularity.kind}", make)

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        rows, columns, _ = self._entries
        return rows, columns

    @property
    def _entries(self) -> tuple[Indices, Indices, Indices]:
        """Rows and columns of the non-zeros, column by column, and which of them each value that `evaluate` has is."""

        def made() -> tuple[Indices, Indices, Indices]:
            own, size = self.equations, self.size
            parts = [(self.discretisation.rows, self.discretisation.columns)]
            if self.singularity.kind == BRANCH_POINT:
                parts.append((np.arange(own), np.full(own, self.added_index)))
            more = np.arange(own, size - 1)
            parts.append((np.repeat(more, size), np.tile(np.arange(size), more.size)))
            keys = np.concatenate([columns * (size - 1) + rows for rows, columns in parts])
            found, slots = np.unique(keys, return_inverse=True)
            return found % (size - 1), found // (size - 1), slots

        entries: tuple[Indices, Indices, Indices] = self.kept("entries", made)
        return entries

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        at = z.tobytes() + self.numbers.tobytes()
        if self._last is None or self._last[0] != at:
            self._last = at, *self._evaluated(z)
        return self._last[1]

    def rounding(self, z: Array) -> Array:  # type: ignore[override]
        found = super().rounding(z)
        assert self._last is not None
        found[self.equations :] = SUM_ROUNDING * self.statement.model.rounding * self._last[2]
        return found

    def rests(self, z: Array) -> bool:
        """Whether the solution is constant, and its mesh says nothing about null vectors."""
        values = z[: self.states].reshape(self.columns, -1)
        return bool(np.all(np.ptp(values, axis=0) <= RESTING_COMPONENT_RATIO * self.singularity.sizes))

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        return np.inf if self.rests(z) else super().expected_error(z, error, other)

    def improvement(self, z: Array, solve: Solve) -> tuple[Array, float] | None:
        return None

    def _evaluated(self, z: Array) -> tuple[tuple[Array, Array], Array]:
        """The equations, and the size of the terms of G."""
        residual, nonzeros = self.discretisation(z, self.numbers)
        border = self._border(z, nonzeros)
        values = [nonzeros]
        if self.singularity.kind == BRANCH_POINT:
            residual = residual + z[self.added_index] * border.push
            values.append(border.push)
        values.append(self._slopes(z, border).ravel())
        rows, _, slots = self._entries
        found = np.bincount(slots, np.concatenate(values), rows.size).astype(float)
        return (np.concatenate([residual, border.G.ravel()]), found), border.terms.ravel()

    def _border(self, z: Array, nonzeros: Array) -> Border:
        """The solution of the bordered equations of B, whose rows are measured by the components of the state."""
        given, sizes, n, k = self.singularity, self.sizes(z), self.formulation.states, self.states
        sizes[:k] = np.tile(given.sizes, self.columns)
        if given.kind in (FOLD, BRANCH_POINT):
            width = k + len(self.orbit.free) + (given.kind == BRANCH_POINT)
            B, rows = self._leading(nonzeros, self.equations, width), np.full(self.equations, np.max(given.sizes))
            rows[: k - n] = sizes[: k - n]
            return Border.of(B, rows, sizes[:width], given.shape, self._order(1, width))
        field, turn, one = self._leading(nonzeros, k - n, k), given.turn, np.eye(n)
        turn = turn if turn.size else one
        if given.kind == DOUBLING:
            B = field + _blocks((k - n, 0, turn), (k - n, k - n, one))
            return Border.of(B, sizes[:k], sizes[:k], (1, 1), self._order(1, k))
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
        return Border.of(B, rows, columns, (2, 1), self._order(2, columns.size))

    def _order(self, copies: int, size: int) -> Indices:
        """An order of the columns of B in which its factors are sparse: copies side by side at ends of intervals."""

        def made() -> Indices:
            order, k, n = self.elimination_order, self.states, self.formulation.states
            order = order[order < k]
            inner = k - (self.resolution + 1) * n
            ends = [order[inner:].reshape(-1, n) + copy * k for copy in range(copies)]
            parts = [*(order[:inner] + copy * k for copy in range(copies)), np.hstack(ends).ravel()]
            return np.concatenate([*parts, np.arange(copies * k, size)])

        order: Indices = self.kept("order", made)
        return order

    def _leading(self, nonzeros: Array, rows: int, columns: int) -> Triplets:
        """The first rows and columns of the solution's own Jacobian."""
        end = int(np.searchsorted(self.discretisation.columns, columns))
        chosen = np.flatnonzero(self.discretisation.rows[:end] < rows)
        return Triplets(nonzeros[chosen], self.discretisation.rows[chosen], self.discretisation.columns[chosen])

    def _slopes(self, z: Array, border: Border) -> Array:
        """The derivatives of G by all unknowns, shape (entries, size)."""
        kind, own = self.singularity.kind, self.equations
        rows = self.states - self.formulation.states if kind in (DOUBLING, TORUS) else own
        found = np.zeros((*border.G.shape, self.size))
        for j, v in enumerate(border.right.T):
            for copy in range(2 if kind == TORUS else 1):
                width = self.states if kind in (DOUBLING, TORUS) else v.size
                direction = np.zeros(self.size)
                direction[:width] = v[copy * self.states :][:width]
                change = self._change(z, direction)[:rows]
                for i, psi in enumerate(border.left.T):
                    found[i, j] -= psi[copy * rows :][:rows] @ change
            if kind == TORUS:
                found[:, j] += self._slopes_at_ends(z, border.left, v)
        return found.reshape(-1, self.size)

    def _slopes_at_ends(self, z: Array, left: Array, v: Array) -> Array:
        """The part of the closing rows of a torus, by kappa and by the velocity at the start, shape (left, size)."""
        n, given = self.formulation.states, self.singularity
        closing = left[2 * (self.states - n) + n :]
        found = np.zeros((left.shape[1], self.size))
        found[:, self.added_index] = 2.0 * closing[:n].T @ v[self.states :][:n]
        if given.autonomous:
            at_start = self.formulation.field_function(0.0, z[:n], z[self.states :], self.values)
            by_velocity = closing[:n].T * v[-1] - closing[n + 1 :].T * v[:n] / given.sizes**2
            found[:, :n] += by_velocity @ np.array(at_start[1])
            found[:, self.states :] += by_velocity @ np.array(at_start[2])
        return found

    def _change(self, z: Array, direction: Array) -> Any:
        """The derivative of the solution's own Jacobian in a direction, by differences, sparse."""
        from scipy.sparse import csc_matrix

        h = DIFFERENCE_STEP / max(float(np.max(np.abs(direction) / self.sizes(z))), 1e-300)
        ahead, behind = (self.discretisation(z + side * h * direction, self.numbers)[1] for side in (1.0, -1.0))
        places = self.discretisation.rows, self.discretisation.columns
        return csc_matrix(((ahead - behind) / (2.0 * h), places), shape=(self.equations, self.size))

    def _place(self, equation: int, z: Array) -> str:
        if equation >= self.equations:
            return f"the condition of a {self.singularity.kind}"
        return super()._place(equation, z)


@dataclass(frozen=True, eq=False)
class Triplets:
    """Entries of a sparse matrix with their rows and columns."""

    values: Array
    rows: Indices
    columns: Indices

    def __add__(self, other: Triplets) -> Triplets:
        both = zip((self.values, self.rows, self.columns), (other.values, other.rows, other.columns), strict=True)
        return Triplets(*(np.concatenate(pair) for pair in both))

    def moved(self, rows: int, columns: int) -> Triplets:
        """The same, further down and to the right."""
        return Triplets(self.values, self.rows + rows, self.columns + columns)


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
    def of(cls, B: Triplets, rows: Array, columns: Array, shape: tuple[int, int], order: Indices) -> Border:
        """Of a matrix whose rows and columns have sizes, and its columns an order of elimination.

        Raises SingularError.
        """
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        (nl, nr), p, q, generator = shape, rows.size, columns.size, np.random.default_rng(0)
        scaled = Triplets(B.values * columns[B.columns] / rows[B.rows], B.rows, B.columns)
        L, R = generator.normal(size=(p, nl)), generator.normal(size=(q, nr))
        K = scaled + _blocks((0, q, L), (p, 0, LONG_ROW_FACTOR * R.T))
        places = np.empty(q + nl, dtype=np.int64)
        places[np.append(order, np.arange(q, q + nl))] = np.arange(q + nl)
        matrix = csc_matrix((K.values, (K.rows, places[K.columns])), shape=(p + nr, p + nr))
        try:
            factors = splu(matrix, permc_spec="NATURAL")
        except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
            raise SingularError(f"the linearised equations lose more rank than expected: {error}") from error
        right = factors.solve(np.vstack([np.zeros((p, nr)), LONG_ROW_FACTOR * np.eye(nr)]))[places[:q]]
        both = np.vstack([np.zeros((q, nl)), np.eye(nl)])
        left = factors.solve(both, trans="T")[:p]  # type: ignore[call-overload]
        if not (np.all(np.isfinite(right)) and np.all(np.isfinite(left))):
            raise SingularError("the linearised equations lose more rank than expected")
        products = scaled.values[:, None, None] * left[scaled.rows][:, :, None] * right[scaled.columns][:, None, :]
        G = -np.sum(products, axis=0)  # as good as both vectors together
        return cls(G, np.linalg.norm(products, axis=0), right * columns[:, None], left / rows[:, None], L[:, 0] * rows)


def singularity_of(
    kind: str, problem: BoundaryProblem, z: Array, first: str, angle: float, turn: Array, autonomous: bool
) -> Singularity:
    """The singularity of a kind near a solution; `angle` is that of the multipliers of a torus."""
    sizes = component_sizes(z[: problem.states].reshape(problem.columns, -1))
    if kind not in (DOUBLING, TORUS):
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
    q = null_vectors(Linearised(problem, z, problem.statement).twisted(complex(np.exp(1j * angle)), turn))[0]
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
