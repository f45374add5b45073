"""The collocation equations of an orbit to first, second and third order, and the null vectors of the first.

Null vectors come from inverse iteration on the sparse matrix, so that multipliers of any size do no harm; higher
derivatives are those of the field at the stages, exact by CasADi.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.formulation import Formulation
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statement import Statement

Vector = NDArray[Any]  # of real or complex numbers
ITERATION_ROUNDS = 4  # of inverse iteration
INVERSE_ITERATION_SHIFT = 1e-13  # of the largest entry of a matrix that may be singular to the last digit


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of an orbit around it; unknowns are its states, then the free parameters of its statement.

    The problem may be an extended one, of which the orbit's own equations and unknowns are taken.
    """

    problem: BoundaryProblem
    z: Array
    statement: Statement

    @property
    def components(self) -> int:
        """Number of components of the orbit's state."""
        return self.statement.model.full_size

    @property
    def states(self) -> int:
        """Number of state values of the orbit."""
        return self.problem.columns * self.components

    @property
    def inner(self) -> int:
        """Number of the orbit's equations of collocation, before the conditions."""
        return self.states - self.components

    @property
    def joined_vector(self) -> Array:
        """The null vector v1 that is among the unknowns of an extended problem, with its changes of free parameters."""
        problem, n, free = self.problem, self.components, len(self.statement.free)
        states = self.z[: problem.states].reshape(problem.columns, -1)[:, n : 2 * n]
        return np.concatenate([states.ravel(), self.z[problem.states + free + 1 :][:free]])

    @cached_property
    def jacobian(self) -> Any:
        """The square derivative of the orbit's equations, parameters that are not free held, sparse."""
        whole, n, free = self.problem.formulation.states, self.components, len(self.statement.free)
        states = _leading(self.problem.states, whole, n)
        return self._own_rows[:, [*states, *range(self.problem.states, self.problem.states + free)]].tocsc()

    @property
    def slope(self) -> Array:
        """The derivative of the orbit's equations by the parameter that the problem follows, dense."""
        name = self.problem.walking
        assert name is not None
        return self.by_scalar(-1) / (self.problem.end - self.problem.statement.values[name])

    def by_scalar(self, place: int) -> Array:
        """The derivative of the orbit's equations by one of all scalars, from their first or last, dense."""
        column = self.problem.states + place if place >= 0 else place
        return np.asarray(self._own_rows[:, [column]].toarray().ravel())

    @cached_property
    def _own_rows(self) -> Any:
        """The rows of the orbit's own equations in the whole derivative."""
        from scipy.sparse import csc_matrix

        problem, whole, n = self.problem, self.problem.formulation.states, self.components
        shape = (problem.size - 1, problem.size)
        matrix = csc_matrix((problem.evaluate(self.z)[1], problem.pattern), shape=shape)
        bottom, ends = problem.states - whole, int(problem.formulation.conditions.numel())
        conditions, integrals = (
            sum(int(e.numel()) for e in group) for group in (self.statement.conditions, self.statement.integrals)
        )
        ranges = (range(bottom, bottom + conditions), range(bottom + ends, bottom + ends + integrals))
        rows = [*_leading(bottom, whole, n), *ranges[0], *ranges[1]]
        return matrix[rows]

    def twisted(self, factor: complex, turn: Array | None = None) -> Any:
        """The derivative of the equations of the state alone, for v(1) = factor v(0) or factor turn v(0), sparse."""
        from scipy.sparse import csc_matrix, eye, hstack, vstack

        n = self.components
        number = factor.real if factor.imag == 0.0 else factor
        start = csc_matrix(-number * (np.eye(n) if turn is None or not turn.size else turn))
        closing = hstack([start, csc_matrix((n, self.states - 2 * n)), eye(n)])
        return vstack([self.jacobian[: self.inner, : self.states], closing]).tocsc()

    def _at_stages(self, v: Vector) -> tuple[Vector, Vector]:
        """A direction at the stages, shape (components, stages), and its change of all scalars."""
        problem = self.problem
        x = np.zeros((problem.formulation.states, problem.stages.size), dtype=v.dtype)
        x[: self.components] = v[: self.states].reshape(problem.columns, -1)[problem.stages].T
        scalars = np.zeros(problem.size - problem.states, dtype=v.dtype)
        scalars[: v.size - self.states] = v[self.states :]
        return x, scalars

    def _increments(self, values: Vector) -> Vector:
        """Contribution of values at the stages to the equations of collocation; 0 to the conditions."""
        problem = self.problem
        by_interval = values[: self.components].T.reshape(problem.resolution, problem.degree, -1)
        sums = np.einsum("k,ij,kjn->kin", problem.constants, problem.table.extended, by_interval)
        return np.asarray(-sums.ravel())

    def products(self, psi: Array, v: Array) -> Array:
        """Means of left times right components of null vectors (psi, v), shape (components, components)."""
        problem, n = self.problem, self.components
        rows = psi[: self.inner].reshape(problem.resolution, -1, n)
        left = np.einsum("k,ij,kin->kjn", problem.constants, problem.table.extended, rows)
        right = self._at_stages(v)[0][:n].T.reshape(left.shape)
        return np.asarray(np.einsum("kja,kjb->ab", left, right))

    def velocity(self, v: Vector) -> Vector:
        """Contribution of -v in the field to the equations of collocation, shape (inner,)."""
        return -self._increments(self._at_stages(v)[0])

    def derivative(self, *directions: Vector) -> Vector:
        """The second or third derivative of the equations of collocation in as many directions, shape (inner,)."""
        problem = self.problem
        function = _derivative(problem.formulation, self.components, len(directions))
        stages = problem.stages
        starts = np.cumsum(problem.constants) - problem.constants
        places = (starts[:, None] + problem.constants[:, None] * problem.table.nodes).ravel()[None]
        x = self.z[: problem.states].reshape(problem.columns, -1)[stages].T
        repeated = problem.repeated(self.z, stages.size)
        mapped = function.map(stages.size)
        total: Vector = np.zeros((self.components, stages.size), dtype=complex)
        parts = [self._at_stages(v) for v in directions]
        for choice in np.ndindex(*(2,) * len(parts)):  # real or imaginary part of each
            turned = [(a.imag, b.imag) if c else (a.real, b.real) for c, (a, b) in zip(choice, parts, strict=True)]
            if all(np.any(a) or np.any(b) for a, b in turned):
                given = [g for a, b in turned for g in (a, np.tile(b[:, None], stages.size))]
                total += 1j ** sum(choice) * np.array(mapped(places, x, *repeated, *given))
        found = self._increments(total)
        return found if any(np.iscomplexobj(v) for v in directions) else np.asarray(found.real)


@lru_cache(maxsize=16)
def _derivative(formulation: Formulation, components: int, order: int) -> ca.Function:
    """Function (s, x, scalars, constants, directions in x, scalars) -> derivative of the leading field in these."""
    known = [formulation.s, formulation.x, formulation.scalars, formulation.constants]
    kind = type(formulation.x)
    field = ca.Function("field", known, [ca.densify(formulation.field[:components])])
    s, x, scalars = kind.sym("s"), kind.sym("x", formulation.states), kind.sym("q", known[2].numel())
    constants = kind.sym("c", known[3].numel())
    found, directions = field(s, x, scalars, constants), []
    for k in range(order):
        a, b = kind.sym(f"a{k}", x.numel()), kind.sym(f"b{k}", scalars.numel())
        found = ca.jtimes(found, x, a) + ca.jtimes(found, scalars, b)
        directions += [a, b]
    return ca.Function("derivative", [s, x, scalars, constants, *directions], [ca.densify(found)])


def velocities(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the state by the fraction of the interval, shape (columns, components)."""
    x = z[: problem.states].reshape(problem.columns, -1)
    mapped = problem.formulation.field_function.map(problem.columns)
    field = mapped(problem._fractions()[None], x.T, *problem.repeated(z, problem.columns))
    return np.array(field[0]).T


def _leading(size: int, whole: int, part: int) -> list[int]:
    """Numbers below `size` of which the first `part` of each `whole` are taken."""
    return np.flatnonzero(np.arange(size) % whole < part).tolist()


def null_vectors(matrix: Any) -> tuple[Vector, Vector]:
    """Right and left null vector (v, psi), psi^H matrix = 0, of a sparse matrix that is nearly singular; of norm 1."""
    from scipy.sparse import eye
    from scipy.sparse.linalg import splu

    shift = INVERSE_ITERATION_SHIFT * float(np.max(np.abs(matrix.data)))
    factors = splu((matrix + shift * eye(matrix.shape[0], format="csc")).tocsc())
    right: Vector = np.random.default_rng(0).normal(size=matrix.shape[0]).astype(matrix.dtype)
    left = right
    for _ in range(ITERATION_ROUNDS):
        left = factors.solve(right / np.linalg.norm(right), trans="H")  # type: ignore[call-overload]
        right = factors.solve(left / np.linalg.norm(left))
    return right / np.linalg.norm(right), left / np.linalg.norm(left)


# Second and third derivatives of all equations of a solution, those of its conditions and integrals among them --------


def full_derivative(linear: Linearised, *directions: Array) -> Array:
    """The second or third derivative of the equations in as many real directions, in the order of their rows."""
    return np.concatenate([linear.derivative(*directions), _of_ends(linear, directions), _of_means(linear, directions)])


def _of_ends(linear: Linearised, directions: tuple[Array, ...]) -> Array:
    """That of the conditions at the ends."""
    problem, count = linear.problem, _rows(linear)[0]
    if not count:
        return np.zeros(0)
    function = _along_ends(problem.formulation, count, len(directions))
    x = linear.z[: problem.states].reshape(problem.columns, -1)
    along = [part for v in directions for part in _parts(linear, v, [0, -1])]
    return np.array(function(x[0], x[-1], *problem.repeated(linear.z, 1), *along)).ravel()


def _of_means(linear: Linearised, directions: tuple[Array, ...]) -> Array:
    """That of the integrals."""
    problem, count = linear.problem, _rows(linear)[1]
    if not count:
        return np.zeros(0)
    stages = problem.stages.size
    function = _along_stages(problem.formulation, count, len(directions)).map(stages)
    starts = np.cumsum(problem.constants) - problem.constants
    places = (starts[:, None] + problem.constants[:, None] * problem.table.nodes).ravel()[None]
    x = linear.z[: problem.states].reshape(problem.columns, -1)[problem.stages].T
    along = []
    for v in directions:
        *states, scalars = _parts(linear, v, list(problem.stages))
        along += [np.array(states).T, np.tile(scalars[:, None], stages)]
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    found = np.array(function(places, x, *problem.repeated(linear.z, stages), *along))
    return np.asarray(found.reshape(count, stages) @ weights)


def _rows(linear: Linearised) -> tuple[int, int]:
    """Numbers of the solution's own conditions and integrals."""
    groups = (linear.statement.conditions, linear.statement.integrals)
    conditions, integrals = (sum(int(e.numel()) for e in group) for group in groups)
    return conditions, integrals


def _parts(linear: Linearised, v: Vector, columns: list[int]) -> list[Array]:
    """A direction in all components of the states at some columns, and in all scalars."""
    problem = linear.problem
    x = np.zeros((len(columns), problem.formulation.states))
    x[:, : linear.components] = v[: linear.states].reshape(problem.columns, -1)[columns]
    scalars = np.zeros(problem.size - problem.states)
    scalars[: v.size - linear.states] = v[linear.states :]
    return [*x, scalars]


@lru_cache(maxsize=16)
def _along_ends(formulation: Formulation, count: int, order: int) -> ca.Function:
    """Function (start, end, scalars, constants, directions in each of the first three) -> derivative in these."""
    return _directional(
        [*formulation.ends, formulation.scalars, formulation.constants], 0, formulation.conditions[:count], order
    )


@lru_cache(maxsize=16)
def _along_stages(formulation: Formulation, count: int, order: int) -> ca.Function:
    """Function (s, x, scalars, constants, directions in x, scalars) -> derivative of the leading integrands."""
    return _directional(
        [formulation.s, formulation.x, formulation.scalars, formulation.constants], 1, formulation.integrands[:count],
        order,
    )  # fmt: skip


def _directional(known: list[ca.SX | ca.MX], first: int, values: ca.SX | ca.MX, order: int) -> ca.Function:
    """The derivative of values in directions of the known symbols from the first to the last but one."""
    kind, directions = type(known[0]), []
    for k in range(order):
        along = [kind.sym(f"d{k}{i}", symbol.numel()) for i, symbol in enumerate(known[first:-1])]
        values = sum(
            (ca.jtimes(values, symbol, d) for symbol, d in zip(known[first:-1], along, strict=True)),
            kind.zeros(values.numel()),
        )
        directions += along
    return ca.Function("derivative", [*known, *directions], [ca.densify(values)])
