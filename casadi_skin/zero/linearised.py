"""The collocation equations of a solution to first, second and third order, and the null vectors of the first.

Null vectors come from inverse iteration on the sparse matrix, so that multipliers of any size do no harm; higher
derivatives are those of the field at the stages, of the conditions and of the integrals, exact by CasADi.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.problem import Array, SingularError
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

Vector = NDArray[Any]  # of real or complex numbers
ITERATION_ROUNDS = 4  # of inverse iteration
INVERSE_ITERATION_SHIFT = 1e-13  # of the largest entry of a matrix that may be singular to the last digit
SHIFT_TRIALS = 5  # shifts, each three times as large as the one before


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of a solution around it; unknowns x are its states, then the free parameters of its statement.

    The problem may have more scalars, which are held.
    """

    problem: BoundaryProblem
    z: Array
    statement: Statement

    @property
    def components(self) -> int:
        """Number of components of the state."""
        return self.problem.formulation.states

    @property
    def states(self) -> int:
        """Number of state values."""
        return self.problem.states

    @property
    def unknowns(self) -> int:
        """Number of x."""
        return self.states + len(self.statement.free)

    @property
    def inner(self) -> int:
        """Number of equations of collocation, before the conditions."""
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
        """Those of `jacobian`."""
        return null_vectors(self.jacobian)

    def by_scalar(self, place: int) -> Array:
        """The derivative by one of all scalars, from their first or last, dense."""
        return np.asarray(self.matrix[:, [self.states + place if place >= 0 else place]].toarray().ravel())

    def twisted(self, factor: complex, turn: Array | None = None) -> Any:
        """The derivative of the equations of the state alone, for v(1) = factor v(0) or factor turn v(0), sparse."""
        from scipy.sparse import csc_matrix, eye, hstack, vstack

        n = self.components
        number = factor.real if factor.imag == 0.0 else factor
        start = csc_matrix(-number * (np.eye(n) if turn is None or not turn.size else turn))
        closing = hstack([start, csc_matrix((n, self.states - 2 * n)), eye(n)])
        return vstack([self.matrix[: self.inner, : self.states], closing]).tocsc()

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

    # Higher derivatives ---------------------------------------------------------------------------------------------

    def derivative(self, *directions: Vector) -> Vector:
        """The second or third derivative of the equations of collocation in as many directions, shape (inner,)."""
        parts = [(v.real, v.imag) for v in directions]
        total: Vector = np.zeros(self.inner, dtype=complex)
        for choice in np.ndindex(*(2,) * len(parts)):  # real or imaginary part of each
            chosen = [part[c] for c, part in zip(choice, parts, strict=True)]
            if all(np.any(v) for v in chosen):
                values = self._along_stages("field", chosen)
                total += 1j ** sum(choice) * self._increments(values)
        return total if any(np.iscomplexobj(v) for v in directions) else np.asarray(total.real)

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


@lru_cache(maxsize=32)
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


def null_vectors(matrix: Any) -> tuple[Vector, Vector]:
    """Right and left null vector (v, psi), psi^H matrix = 0, of a sparse matrix that is nearly singular; of norm 1.

    By inverse iteration with a shift, a larger one where a pivot vanishes exactly; raises SingularError where all do.
    """
    factors = _shifted_factors(matrix)
    right: Vector = np.random.default_rng(0).normal(size=matrix.shape[0]).astype(matrix.dtype)
    left = right
    for _ in range(ITERATION_ROUNDS):
        left = factors.solve(right / np.linalg.norm(right), trans="H")
        right = factors.solve(left / np.linalg.norm(left))
    return right / np.linalg.norm(right), left / np.linalg.norm(left)
