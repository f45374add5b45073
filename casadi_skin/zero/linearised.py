"""Equations of a solution around it to first, second and third order, and the null vectors of the first.

Of orbits and solutions of boundary-value problems, whose equations are those of collocation, and of equilibria,
f(x, p) = 0, in one way: F(x + v) = F(x) + J v + D(v, v)/2 + D(v, v, v)/6 + ..., with J of shape (unknowns, unknowns).

Null vectors of collocation come from inverse iteration on the sparse matrix, so that multipliers of any size do no
harm, those of equilibria from singular values. Higher derivatives of collocation are those of the field at the stages,
of the conditions and of the integrals, exact by CasADi.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.model.result import kept_by_first
from casadi_skin.zero.balanced import BalancedMatrix, NullSpace, balanced, is_sparse, shifted, solution, upper_pair
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.half_plane import pair_near
from casadi_skin.zero.kinds import KINDS
from casadi_skin.zero.problem import EPSILON, Array, SingularError
from casadi_skin.zero.rest import Statics
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

Vector = NDArray[Any]  # of real or complex numbers
ITERATION_ROUNDS = 4  # of inverse iteration
INVERSE_ITERATION_SHIFT = 1e-13  # of the largest entry of a matrix that may be singular to the last digit
ORTHOGONAL_PRODUCT = 1e-10  # of the norms of null vectors in balanced units: a product that is zero
PLACES_ALONG_SOLUTION = 65  # at which null vectors are compared
SHIFT_TRIALS = 5  # shifts, each three times as large as the one before


def by_parts(form: Callable[..., Array], size: int, *directions: Vector) -> Vector:
    """A real multilinear form at real or complex directions, from their real and imaginary parts, shape (size,)."""
    if not any(map(np.iscomplexobj, directions)):
        return form(*directions)
    parts, total = [(v.real, v.imag) for v in directions], np.zeros(size, dtype=complex)
    for choice in np.ndindex(*(2,) * len(parts)):
        chosen = [part[c] for c, part in zip(choice, parts, strict=True)]
        if all(map(np.any, chosen)):
            total += 1j ** sum(choice) * form(*chosen)
    return total


@dataclass(frozen=True, eq=False)
class LinearisedRest:
    """The equations f(x, p) = 0 of an equilibrium; unknowns are its state over some sizes.

    Its attributes and methods mean what those of the same names do of collocation (see `Linearised`).

    Attributes:
        statics: the model at rest.
        x, p: state and parameters.
        sizes: of the components, shape (n,).
        units: by which null vectors are measured, in the sizes.
        ways: numbers of the two parameters of a curve, with the way that each goes.
        left: the left null vector at a branch point of a curve.
        near: frequency near that of the critical pair.
    """

    statics: Statics
    x: Array
    p: Array
    sizes: Array
    units: Array
    ways: Mapping[int, float] = field(default_factory=dict)
    left: Array | None = None
    near: float | None = None

    @property
    def inner(self) -> int:
        """Number of equations, of components and of state values."""
        return self.statics.size

    components = states = inner

    @cached_property
    def jacobian(self) -> Any:
        """df/dx in the sizes, of scipy.sparse where the model's is."""
        return self.statics.scaled(self.statics.matrix(self.x, self.p), self.sizes)

    @cached_property
    def by_parameters(self) -> Array:
        """Derivatives by the parameters of the curve over their ways, shape (n, 2)."""
        columns = self.statics.by_parameters(self.x, self.p)[:, list(self.ways)]
        return np.asarray(columns * list(self.ways.values()) / self.sizes[:, None])

    @cached_property
    def null_vectors(self) -> tuple[Array, Array]:
        """Right and left null vector."""
        if self.statics.is_sparse:
            B, d = balanced(self.jacobian)
            v, psi = null_vectors(B)
            return v * d, psi / d if self.left is None else self.left
        found = NullSpace.of(self.jacobian, self.units, rows=self.units)
        return found.right[:, -1], found.left[:, -1] if self.left is None else self.left

    @cached_property
    def pair(self) -> tuple[float, Vector, Vector]:
        """The frequency of the critical pair, q with J q = i omega q, and its adjoint with product 1."""
        return critical_pair(self.jacobian, self.near)

    def critical(self, kind: str) -> tuple[Vector, Vector]:
        """Of pairs q and p with p.q = 1; v with v.v = 1, whose largest entry is positive, and psi with psi.v = 1.

        psi.psi = 1 where both are orthogonal.
        """
        if KINDS[kind].angle is None:
            return self.pair[1:]
        v, psi = self.null_vectors
        v = self.normalised(v) * np.sign(v[np.argmax(np.abs(v))])
        product, crossed = float(psi @ v), float(np.linalg.norm(psi * self.units) * np.linalg.norm(v / self.units))
        return v, psi / (product if abs(product) > ORTHOGONAL_PRODUCT * crossed else np.linalg.norm(psi))

    def scales(self, kind: str) -> tuple[float, float]:
        """The critical frequency of a kind, and the unit of time of its coefficient."""
        omega = self.pair[0] if KINDS[kind].angle is None else 0.0
        return omega, omega or 1.0

    def derivative(self, *directions: Vector) -> Vector:
        """The second or third derivative in as many directions, shape (n,)."""

        def scaled(*v: Array) -> Array:
            return self.statics.derivative(self.x, self.p, *(self.sizes * one for one in v)) / self.sizes

        return by_parts(scaled, self.inner, *directions)

    full_derivative = derivative

    def response(self, forcing: Vector, multiple: int = 0) -> Vector:
        """The answer to a forcing at a multiple of the critical frequency.

        Raises LinAlgError where another eigenvalue is that multiple, to rounding.
        """
        B, d = balanced(self.jacobian)
        matrix = shifted(B, 1j * multiple * self.pair[0]) if multiple else B
        solve, growth = solution(matrix)
        if not growth < 1.0 / EPSILON:
            words = f"resonance 1:{multiple} there" if multiple else "another eigenvalue vanishes there"
            raise np.linalg.LinAlgError(words)
        return np.asarray(solve(-forcing / d) * d)

    def velocity(self, v: Vector) -> Vector:
        """Contribution of -v in the field."""
        return -v

    def normalised(self, v: Array) -> Array:
        """A right null vector of norm 1."""
        return np.asarray(v / np.linalg.norm(v))

    def along(self, v: Array) -> Array:
        """Values by which two right null vectors are compared."""
        return v

    def seen(self, v: Array) -> Array:
        """1: left null vectors along a curve of branch points have one sign and size."""
        return np.ones(1)


def critical_pair(A: Any, near: float | None = None) -> tuple[float, Vector, Vector]:
    """The frequency omega > 0 of the critical pair of eigenvalues, q with A q = i omega q, and its adjoint.

    The pair is that nearest to i `near`, by default that nearest to the imaginary axis.
    """
    if is_sparse(A):
        value, right, left = pair_near(A, near)
    else:
        linear = BalancedMatrix(A)
        values = linear.eigensystem[0]
        k = upper_pair(values, None if near is None else 1j * near)
        value, (right, left) = complex(values[k]), linear.vectors(k)
    q = right / np.linalg.norm(right)
    return value.imag, q, np.asarray(left / np.vdot(left, q).conj())


@dataclass(frozen=True, eq=False)
class Linearised:
    """The collocation equations of a solution; unknowns x are its states, then the free parameters of its statement.

    The problem may have more scalars, which are held.

    Attributes:
        problem, z, statement: the solution and its statement.
        angle: of the critical multipliers.
        turn: the matrix S of solutions that close as x(1) = S x(0), where it is not 1.
        length: of the interval.
    """

    problem: BoundaryProblem
    z: Array
    statement: Statement
    angle: float = 0.0
    turn: Array | None = None
    length: float = 1.0

    @property
    def components(self) -> int:
        """Number of components of the state."""
        return self.problem.formulation.states

    @property
    def states(self) -> int:
        """Number of state values among the unknowns."""
        return self.problem.states

    @property
    def unknowns(self) -> int:
        """Number of x."""
        return self.states + len(self.statement.free)

    @property
    def inner(self) -> int:
        """Number of equations of the field, before the conditions."""
        return self.states - self.components

    @cached_property
    def matrix(self) -> Any:
        """The derivative of the equations by x and all further scalars, sparse."""
        from scipy.sparse import csc_matrix

        problem, discretisation = self.problem, self.problem.discretisation
        nonzeros = discretisation(self.z, problem.numbers)[1]
        shape = problem.equations, problem.size
        return csc_matrix((nonzeros, (discretisation.rows, discretisation.columns)), shape=shape)

    @cached_property
    def jacobian(self) -> Any:
        """The square derivative by x, sparse."""
        return self.matrix[:, : self.unknowns]

    @cached_property
    def null_vectors(self) -> tuple[Array, Array]:
        """Right and left one of `jacobian`."""
        return null_vectors(self.jacobian)

    @cached_property
    def by_parameters(self) -> Array:
        """Derivatives by both parameters of a curve of special points, shape (unknowns, 2)."""
        return np.asarray(self.matrix[:, [self.unknowns, -1]].toarray())

    def twisted(self, multiple: int = 1) -> Any:
        """The derivative of the equations of the state alone, for v(1) = exp(i multiple angle) turn v(0), sparse."""
        from scipy.sparse import csc_matrix

        n, turn, half, discretisation = self.components, self.turn, self.angle == np.pi, self.problem.discretisation
        factor = complex(np.exp(1j * multiple * self.angle))
        number = (-1.0) ** multiple if half else factor.real if factor.imag == 0.0 else factor
        start, every = -number * (np.eye(n) if turn is None or not turn.size else turn), np.arange(n)
        inside = (discretisation.rows < self.inner) & (discretisation.columns < self.states)
        own, at = discretisation(self.z, self.problem.numbers)[1][inside], np.nonzero(start)
        rows = np.concatenate([discretisation.rows[inside], self.inner + at[0], self.inner + every])
        columns = np.concatenate([discretisation.columns[inside], at[1], self.states - n + every])
        data = np.concatenate([own, start[at], np.ones(n)])
        return csc_matrix((data, (rows, columns)), shape=(self.states, self.states))

    def _increments(self, values: Vector) -> Vector:
        """Contribution of values at the stages, (components, stages), to the equations of collocation."""
        problem = self.problem
        by_interval = values.T.reshape(problem.resolution, problem.degree, -1)
        sums = np.einsum("k,ij,kjn->kin", problem.constants, problem.table.extended, by_interval)
        return np.asarray(-sums.ravel())

    def _at(self, v: Vector, columns: Any) -> tuple[Vector, Vector]:
        """A direction in x at columns of the states, shape (components, columns), and its change of all scalars."""
        scalars = np.zeros(self.problem.size - self.states, dtype=v.dtype)
        scalars[: v.size - self.states] = v[self.states :]
        return v[: self.states].reshape(self.problem.columns, -1)[columns].T, scalars

    def products(self, psi: Array, v: Array) -> Array:
        """Means of left times right components of null vectors (psi, v), shape (components, components)."""
        problem, n = self.problem, self.components
        rows = psi[: self.inner].reshape(problem.resolution, -1, n)
        left = np.einsum("k,ij,kin->kjn", problem.constants, problem.table.extended, rows)
        right = self._at(v, problem.stages)[0].T.reshape(left.shape)
        return np.asarray(np.einsum("kja,kjb->ab", left, right))

    def velocity(self, v: Vector) -> Vector:
        """Contribution of -v in the field to the equations of collocation, shape (inner,)."""
        return -self._increments(self._at(v, self.problem.stages)[0])

    def critical(self, kind: str) -> tuple[Vector, Vector]:
        """The Floquet function with mean square 1, of a fold with the changes of free parameters; and its adjoint."""
        problem = self.problem
        v, adjoint = self.null_vectors if KINDS[kind].angle == 0.0 else null_vectors(self.twisted())
        weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
        values = v[: self.states].reshape(problem.columns, -1)[problem.stages]
        v = v / np.sqrt(float(weights @ np.sum(np.abs(values) ** 2, axis=1)))
        largest = v[: self.components][np.argmax(np.abs(v[: self.components]))]
        return v * (abs(largest) / largest), adjoint

    def scales(self, kind: str) -> tuple[float, float]:
        """The critical frequency, and the unit of time of coefficients."""
        return self.angle / self.length, self.length

    def normalised(self, v: Array) -> Array:
        """A right null vector with mean square 1 along the solution."""
        return np.asarray(v / np.sqrt(v[: self.states] @ v[: self.states] / self.problem.columns))

    def along(self, v: Array) -> Array:
        """Values along the solution by which two right null vectors are compared."""
        places = np.linspace(0.0, 1.0, PLACES_ALONG_SOLUTION)
        return np.append(self.problem.sample(v, places), v[self.states :])

    def seen(self, v: Array) -> Array:
        """What the left null vector sees of v, by which its sign and size are compared.

        Means of products of components, and products of conditions with the ends of v.
        """
        psi, n, inner = self.null_vectors[1], self.components, self.inner
        ends = np.concatenate([v[:n], v[inner:]])
        return np.concatenate([self.products(psi, v).ravel(), np.outer(psi[inner:], ends).ravel()])

    def response(self, forcing: Vector, multiple: int = 0) -> Vector:
        """The answer v to a forcing of the field at a multiple of the critical frequency, J v = -forcing."""
        from scipy.sparse.linalg import splu

        factors = splu(self.twisted(multiple) if multiple else self.jacobian)
        right = np.zeros(factors.shape[0], dtype=forcing.dtype)
        right[: forcing.size] = -forcing
        return np.asarray(factors.solve(right))

    # Higher derivatives ---------------------------------------------------------------------------------------------

    def derivative(self, *directions: Vector) -> Vector:
        """The second or third derivative of the equations of collocation in as many directions, shape (inner,)."""
        return by_parts(lambda *v: self._increments(self._along_stages("field", v)), self.inner, *directions)

    def full_derivative(self, *directions: Array) -> Array:
        """The same of all equations in real directions: conditions and integrals follow."""
        problem, found = self.problem, [self.derivative(*directions)]
        if problem.formulation.conditions.numel():
            function = _directional(problem.formulation, "conditions", len(directions))
            start, end = problem.states - self.components, problem.columns - 1
            ends = self.z[: self.components], self.z[start : self.states]
            along = []
            for v in directions:
                states, scalars = self._at(v, [0, end])
                along += [*states.T, scalars]
            found.append(np.array(function(*ends, *problem.repeated(self.z, 1), *along)).ravel())
        if problem.formulation.integrals:
            weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
            found.append(self._along_stages("integrands", directions) @ weights)
        return np.concatenate(found)

    def _along_stages(self, name: str, directions: Sequence[Array]) -> Array:
        """The derivative of field or integrands at the stages, shape (values, stages)."""
        problem, stages = self.problem, self.problem.stages
        starts = np.cumsum(problem.constants) - problem.constants
        places = (starts[:, None] + problem.constants[:, None] * problem.table.nodes).ravel()[None]
        x = self.z[: self.states].reshape(problem.columns, -1)[stages].T
        along: list[Array] = []
        for v in directions:
            states, scalars = self._at(v, stages)
            along += [states, np.tile(scalars[:, None], stages.size)]
        function = _directional(problem.formulation, name, len(directions), stages.size)
        return np.array(function(places, x, *problem.repeated(self.z, stages.size), *along))


@kept_by_first
def _directional(formulation: Formulation, name: str, order: int, count: int = 1) -> ca.Function:
    """Function (places, scalars, constants, directions in states and scalars) -> derivative of `name` in these.

    Places are s and x, or of the conditions the states at the start and at the end, which are among the directions.
    """
    f = formulation
    given: list[Expression] = [*(f.ends if name == "conditions" else (f.s, f.x)), f.scalars, f.constants]
    values: Expression = getattr(f, name)
    kind, moving, directions = type(f.x), given[0 if name == "conditions" else 1 : 3], []
    for k in range(order):
        along = [kind.sym(f"d{k}{i}", symbol.numel()) for i, symbol in enumerate(moving)]
        parts = (ca.jtimes(values, symbol, d) for symbol, d in zip(moving, along, strict=True))
        values = sum(parts, kind.zeros(values.numel()))
        directions += along
    return ca.Function("derivative", [*given, *directions], [ca.densify(values)]).map(count)


LinearisedEquations: TypeAlias = Linearised | LinearisedRest


def velocities(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the state by the fraction of the interval, shape (columns, components)."""
    x = z[: problem.states].reshape(problem.columns, -1)
    mapped = problem.formulation.field_function.map(problem.columns)
    field = mapped(problem._fractions()[None], x.T, *problem.repeated(z, problem.columns))
    return np.array(field[0]).T


def _shifted_factors(matrix: Any) -> Any:
    """SuperLU's factors of a matrix with the least of some shifts of its diagonal by which no pivot vanishes."""
    from scipy.sparse import eye
    from scipy.sparse.linalg import splu

    shift = INVERSE_ITERATION_SHIFT * float(np.max(np.abs(matrix.data)))
    for trial in range(SHIFT_TRIALS):
        try:
            return splu((matrix + 3.0**trial * shift * eye(matrix.shape[0], format="csc")).tocsc())
        except RuntimeError:  # "Factor is exactly singular"
            continue
    raise SingularError("the linearised equations have no null vector that inverse iteration finds")


def null_spaces(matrix: Any, count: int = 1) -> tuple[Vector, Vector]:
    """Orthonormal vectors that a sparse matrix nearly annihilates, from the right and from the left, as columns.

    By inverse iteration with a shift, a larger one where a pivot vanishes exactly; raises SingularError where all do.
    """
    factors = _shifted_factors(matrix)
    right: Vector = np.random.default_rng(0).normal(size=(matrix.shape[0], count)).astype(matrix.dtype)
    for _ in range(ITERATION_ROUNDS):
        left = np.linalg.qr(factors.solve(right, trans="H"))[0]
        right = np.linalg.qr(factors.solve(left))[0]
    return right, left


def null_vectors(matrix: Any) -> tuple[Vector, Vector]:
    """Right and left null vector (v, psi), psi^H matrix = 0, of a sparse matrix that is nearly singular; of norm 1."""
    right, left = null_spaces(matrix)
    return right[:, 0], left[:, 0]


def bordered(matrix: Any, right: Vector, left: Vector) -> Any:
    """A matrix with columns from the left and rows from the right beside it, sparse: [[matrix, left], [right^T, 0]]."""
    from scipy.sparse import bmat, csc_matrix

    blocks: Any = [[csc_matrix(matrix), csc_matrix(left)], [csc_matrix(right.T), None]]
    return bmat(blocks).tocsc()
