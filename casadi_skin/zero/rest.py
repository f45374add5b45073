"""A model at rest: the equations that vanish there, their derivatives, and the eigenvalues of the linearisation.

As a problem with one unknown more, which correctors and continuations take, nothing is discretised. Unknowns are
measured by sizes that are powers of two, so that scaling rounds nothing, and equations by their largest derivative, so
that stiff models and components of any unit are solved alike.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.result import Result
from casadi_skin.native import MOST_STATES, Structure
from casadi_skin.native.places import rests
from casadi_skin.zero.balanced import (
    ROUNDED_COMPONENT_RATIO,
    BalancedMatrix,
    ComplexArray,
    NullSpace,
    balanced,
    dense,
    is_mostly_zero,
    units_of,
)
from casadi_skin.zero.problem import EPSILON, Array, Buffers, Indices, Problem, Scalar, Solve
from casadi_skin.zero.statement import in_order, named_values

# Of the size of x: steps of second and third derivatives of a program.
SECOND_DERIVATIVE_STEP, THIRD_DERIVATIVE_STEP = 3e-4, 1e-3
EIGENVALUE_SAFETY = 4.0  # of the estimated errors of eigenvalues


@dataclass(frozen=True, eq=False)
class Spectrum(Result):
    """Eigenvalues by descending real part, with estimated absolute errors; both of shape (components,)."""

    values: ComplexArray
    errors: Array

    def __repr__(self) -> str:
        words = "stable" if self.stable else "unstable"
        return f"<Spectrum: {self.values.size} eigenvalues, largest real part {self.values.real.max():.6g}; {words}>"

    @property
    def stable(self) -> bool:
        """Whether none has a positive real part, within estimated errors."""
        return bool(np.all(self.values.real <= self.errors))


@dataclass(frozen=True, eq=False)
class Statics:
    """The equations f(x, p) = 0 of a model at rest: x its state, of a model of second order its positions alone.

    Attributes:
        model: the model as given, which no force drives in time.
        values: value of each parameter by name.

    Raises ValueError for a forced model, and where a parameter has no value.
    """

    model: OdeModel
    given: Mapping[str, float]
    widening: float = 1.0  # of the steps of differences, for their errors

    def __post_init__(self) -> None:
        if self.model.forced:
            period = "" if isinstance(self.model.forcing_period, ca.SX | ca.MX) else f" {self.model.forcing_period:g}"
            why = f"its right-hand side depends on time, with period{period}, and it has orbits in place of equilibria"
            raise ValueError(f"model: given {self.model.name}, which is forced: {why}; accepted: one without time")
        _ = self.values

    def decaying(self) -> Statics:
        """The same where algebraic equations decay at a rate that the others have at the parameters."""
        p = np.array(list(self.values.values()))
        model = self.model.decaying(lambda implicit: implicit.rate(p))
        return self if model is self.model else Statics(model, self.given)

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of each parameter by name, in the model's order."""
        return named_values(self.model, self.given)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.model.size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.model.state_names[: self.size]

    @property
    def oscillates(self) -> bool:
        """Whether pairs of eigenvalues may cross the imaginary axis one by one, as no conserved quantity pins them."""
        return self.model.order == 1 and self.model.hamiltonian is None

    @cached_property
    def function(self) -> ca.Function:
        """Function (x, p) -> f, dense."""
        model = self.model
        return ca.Function("f", [model.state, model.parameters], [ca.densify(model.rhs)], ["x", "p"], ["f"])

    # Derivatives ----------------------------------------------------------------------------------------------------

    @cached_property
    def _jacobian(self) -> ca.Function:
        x, p = self.symbols()
        f = self.function(x, p)
        return ca.Function("J", [x, p], [ca.jacobian(f, x), ca.densify(ca.jacobian(f, p))])

    @cached_property
    def _forms(self) -> list[ca.Function]:
        """Functions (x, p, u, v, ...) -> f_xx u v and f_xxx u v w."""
        x, p = self.symbols()
        value, directions, found = self.function(x, p), [type(x).sym(name, self.size) for name in "uvw"], []
        for k, direction in enumerate(directions):
            value = ca.jtimes(value, x, direction)
            found.append(ca.Function("form", [x, p, *directions[: k + 1]], [ca.densify(value)]))
        return found

    def at(self, values: Mapping[str, float]) -> Statics:
        """The same model at other values of all parameters; functions made for one serve both."""
        other = copy.copy(self)
        other.__dict__.pop("values", None)
        object.__setattr__(other, "given", values)
        return other

    def symbols(self) -> tuple[Expression, Expression]:
        """New symbols of the unknowns and of the parameters."""
        kind = type(self.model.state)
        return kind.sym("x", self.size), kind.sym("p", int(self.model.parameters.numel()))

    @cached_property
    def _buffers(self) -> Buffers:
        return Buffers(self._jacobian)

    def _derivatives(self, x: Array, p: Array) -> Sequence[Array]:
        """Non-zeros of df/dx and of df/dp by columns, which the next call may overwrite."""
        if self.exact:
            return self._buffers(x, p)
        return [np.array(part.nonzeros()) for part in self._jacobian(x, p)]

    @cached_property
    def _pattern(self) -> tuple[Indices, Indices]:
        """Rows of the non-zeros of df/dx, and where columns start."""
        found = self._jacobian.sparsity_out(0)
        return np.array(found.row(), dtype=np.intc), np.array(found.colind(), dtype=np.intc)

    @cached_property
    def is_sparse(self) -> bool:
        """Whether df/dx is large, and most of it zero."""
        return is_mostly_zero(self.size, self._pattern[0].size)

    def matrix(self, x: Array, p: Array) -> Any:
        """df/dx, shape (n, n): of scipy.sparse by columns where it `is_sparse`."""
        return self.filled(self._derivatives(x, p)[0].copy())

    def filled(self, nonzeros: Array) -> Any:
        """A matrix of the pattern of df/dx with these non-zeros, as `matrix`."""
        from scipy.sparse import csc_matrix

        rows, starts = self._pattern
        if self.is_sparse:
            return csc_matrix((nonzeros, rows, starts), shape=(self.size, self.size))
        found = np.zeros((self.size, self.size))
        found[rows, np.repeat(np.arange(self.size), np.diff(starts))] = nonzeros
        return found

    def scaled(self, matrix: Any, sizes: Array) -> Any:
        """A matrix of derivatives of components over their sizes."""
        if not self.is_sparse:
            return np.asarray(matrix * sizes / sizes[:, None])
        rows, starts = self._pattern
        return self.filled(matrix.data * np.repeat(sizes, np.diff(starts)) / sizes[rows])

    def jacobian(self, x: Array, p: Array) -> Array:
        """df/dx, dense."""
        return dense(self.matrix(x, p))

    def by_parameters(self, x: Array, p: Array) -> Array:
        """df/dp, shape (n, parameters)."""
        return np.array(self._derivatives(x, p)[1]).reshape(-1, self.size).T

    @cached_property
    def exact(self) -> bool:
        """Whether higher derivatives are exact; those of a program, as an FMU, are differences of its Jacobian."""
        return not programs_in(self.function)

    def derivative(self, x: Array, p: Array, *directions: Array) -> Array:
        """f_xx u v or f_xxx u v w, shape (n,)."""
        if self.exact:
            return np.array(self._forms[len(directions) - 1](x, p, *directions)).ravel()
        *others, last = directions
        step = self.widening * (SECOND_DERIVATIVE_STEP if len(others) == 1 else THIRD_DERIVATIVE_STEP)
        ways = np.array([step * self._scale(x, along) * along for along in others])
        matrix = sum(
            np.prod(signs) * self.jacobian(x + signs @ ways, p)
            for signs in map(np.array, itertools.product((-1.0, 1.0), repeat=len(others)))
        )
        return np.asarray(matrix @ last / np.prod([2.0 * step * self._scale(x, along) for along in others]))

    def _scale(self, x: Array, along: Array) -> float:
        """A step along a direction that is the size of x, 1 at least."""
        return max(1.0, float(np.max(np.abs(x)))) / max(float(np.max(np.abs(along))), 1e-300)

    # Eigenvalues ----------------------------------------------------------------------------------------------------

    def linearised(self, x: Array, p: Array, moved: Array | None = None) -> BalancedMatrix:
        """df/dx, and its change where the state is off by `moved`; raises ArithmeticError where it is not finite."""
        A = self.jacobian(x, p)
        if not np.all(np.isfinite(A)):
            raise ArithmeticError(f"{self.model.name}: the derivatives are not finite at the equilibrium")
        change = None if moved is None or not np.any(moved) else self.jacobian(x + moved, p) - A
        return BalancedMatrix(A, max(EPSILON, self.model.rounding), change)

    def spectrum(self, x: Array, p: Array, moved: Array | None = None) -> Spectrum:
        """Eigenvalues of the linearisation, of a model of second order +-sqrt(mu) of those of df/dx.

        `moved` is the estimated error of x, shape (n,), which the errors of eigenvalues include to first order, beside
        rounding by the condition of each (Wilkinson 1965).
        """
        linear, implicit = self.linearised(x, p, moved), self.model.implicit
        if implicit is not None:
            free = implicit.among_free(x, p, linear.balanced[1])
            change = None if linear.change is None else free(linear.change)
            linear = BalancedMatrix(free(linear.matrix), linear.rounding, change)
        values, errors = linear.eigensystem[0], linear.errors(EIGENVALUE_SAFETY)
        if self.model.order == 2:
            values, errors = _roots(values, errors)
        places = np.lexsort((-values.imag, -values.real))
        return Spectrum(values[places], errors[places])


def _roots(squares: ComplexArray, errors: Array) -> tuple[ComplexArray, Array]:
    """+-sqrt(mu) and their errors: exactly imaginary where mu is negative; one that is 0 but for errors has theirs."""
    exact = np.where((np.abs(squares.imag) <= errors) & (squares.real < 0.0), squares.real, squares)
    roots = np.sqrt(exact.astype(complex))
    size = np.minimum(errors / np.maximum(np.abs(roots), 1e-300), np.sqrt(errors))
    return np.concatenate([roots, -roots]), np.concatenate([size, size])


# The problem of equilibria --------------------------------------------------------------------------------------------

TOGETHER = 12  # states at which equations are evaluated by one call
SMALLEST_COMPONENT_RATIO = 1e-3  # of a component's size: changes of smaller components are measured by that


@dataclass(frozen=True)
class Course:
    """A parameter that goes from a value to another one as a scalar s goes from 0 to 1."""

    name: str
    start: float
    to: float

    def at(self, s: Any) -> Any:
        """The value at s, a number or an expression."""
        return self.start + s * (self.to - self.start)

    @property
    def extent(self) -> float:
        """The change of the parameter, with its sign."""
        return self.to - self.start

    def fraction(self, value: float) -> float:
        """The s of a value."""
        return (value - self.start) / (self.to - self.start)


ROUNDED_STATE_RATIO = 1e-12  # of the largest component, in balanced units: a smaller one is zero but for rounding


def sizes_of(statics: Statics, states: Sequence[Array]) -> Array:
    """Scale of each component: its largest value in these states as a power of two, shape (n,).

    One that is zero there has the median of the others as its scale, or 1.
    """
    largest, units = np.max(np.abs(np.stack(list(states))), axis=0), np.ones(statics.size)
    with suppress(ArithmeticError):  # where the equations are not defined
        units = balanced(statics.matrix(states[0], np.array(list(statics.values.values()))))[1]
    moves = largest / units > ROUNDED_STATE_RATIO * float(np.max(largest / units, initial=0.0))
    return power_of_two(np.where(moves, largest, np.median(largest[moves]) if np.any(moves) else 1.0))


def power_of_two(sizes: Array) -> Array:
    """The nearest powers of two."""
    return np.asarray(2.0 ** np.round(np.log2(sizes)))


def sizes_at(statics: Statics, x: Array, courses: Sequence[Course], usual: Array) -> Array:
    """Scales of the components at an equilibrium by their units there (see `units_of`), as powers of two, shape (n,).

    `usual` are scales known from elsewhere: what is smaller by far is rounding.
    """
    p = np.array(list(statics.values.values()))
    return power_of_two(_units(statics, x, p, courses, np.zeros_like(x), usual))


def _units(statics: Statics, x: Array, p: Array, courses: Sequence[Course], usual: Array, sizes: Array) -> Array:
    """Units of the components of a state (see `units_of`), for which a derivative that is rounding is zero.

    Balancing would turn one, as of a product with a component that is zero, into units without bound.
    """
    matrix, ranges = statics.matrix(x, p), np.abs(p)
    for course in courses:
        ranges[list(statics.values).index(course.name)] += abs(course.to - course.start)
    moved = statics.matrix(
        x + ROUNDED_COMPONENT_RATIO * np.maximum(np.abs(x), sizes), p + ROUNDED_COMPONENT_RATIO * ranges
    )
    entries, others = (one.data if statics.is_sparse else one for one in (matrix, moved))
    entries[np.abs(entries) <= np.abs(others - entries)] = 0.0  # all are kept beside undefined places
    return units_of(matrix, x, moving(statics, x, p, courses), usual, sizes)


def moving(statics: Statics, x: Array, p: Array, courses: Sequence[Course]) -> Array:
    """Changes of f over the ranges of parameters, shape (n, courses)."""
    names, by_p = list(statics.values), statics.by_parameters(x, p)
    changes = [by_p[:, names.index(course.name)] * (course.to - course.start) for course in courses]
    return np.reshape(np.array(changes), (len(courses), statics.size)).T


class Undiscretised(Problem):
    """Unknowns z = (state values, scalars, u) of one resolution, without an Omega; u is about 1 at the most."""

    resolution = 1

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns."""
        if scalar is Scalar.OMEGA:
            raise ValueError("there is no Omega among the unknowns")
        return self.size - 1

    def parameter_size(self, z: Array) -> float:
        """1, the range of u along a branch."""
        return max(1.0, abs(float(z[-1])))

    def state(self, z: Array) -> Array:
        """The state, in units of its own."""
        return np.asarray(z[: self.states])

    def prolong(self, z: Array, finer: Problem) -> Array:
        return z.copy()

    def all_prolonged(self, z: Array, finer: Problem) -> Array:
        return z.copy()

    def sample(self, z: Array, theta: Array) -> Array:
        return np.tile(self.state(z), (np.size(theta), 1))

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        scalars = slice(self.states, self.size - 1)
        if self.states == self.size - 1:
            return 0.0
        return float(np.max(np.abs(step[scalars]) / np.maximum(np.abs(z[scalars]), 1.0), initial=0.0))


class AlgebraicProblem(Undiscretised):
    """Unknowns z = (y, scalars, u): the state over its sizes, free parameters and what is added to them, u.

    Here F(y, p) = 0 alone, the model at rest in units of the sizes; u follows `walking`, or is held and does nothing.
    A subclass adds scalars, as many as `added`, and equations.
    """

    added = 0
    _weighed = b"", np.empty(0)

    def __init__(
        self, statics: Statics, sizes: Array, free: Sequence[Course] = (), walking: Course | None = None
    ) -> None:
        self.statics, self.scale, self.free, self.walking = statics, sizes, tuple(free), walking
        self.states = statics.size
        self._kept_at: tuple[bytes, tuple[Array, Array]] = b"", (np.empty(0), np.empty(0))

    @cached_property
    def size(self) -> int:
        return self.states + len(self.free) + self.added + 1

    # Equations ------------------------------------------------------------------------------------------------------

    def parameters_at(self, scalars: Any) -> Any:
        """All parameters of the model, in its order, from the scalars among the unknowns."""
        known = {course.name: course.at(scalars[place]) for place, course in enumerate(self.free)}
        if self.walking is not None:
            known[self.walking.name] = self.walking.at(scalars[len(self.free) + self.added])
        return in_order(self.statics.values | known, scalars)

    @cached_property
    def function(self) -> ca.Function:
        """Function (z, nothing) -> (F, dF/dz), of operations where the model's is."""
        kind, sizes = type(self.statics.model.state), (self.states, self.size - self.states)
        y, scalars = (kind.sym(name, size) for name, size in zip("yp", sizes, strict=True))
        scale = ca.DM(self.scale)
        R = ca.densify(self.statics.function(scale * y, self.parameters_at(scalars)) / scale)
        by_parts = [ca.jacobian(R, part) for part in (y, scalars)]
        function = ca.Function("algebraic", [y, scalars], [R, ca.horzcat(*by_parts)])
        z = kind.sym("z", self.size)
        results = function(*ca.vertsplit(z, np.cumsum([0, *sizes]).tolist()))
        return ca.Function("equations", [z, kind.sym("constants", 0)], results)

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residual and non-zeros of the Jacobian, each equation relative to its largest derivative.

        Not to be written to: the last ones are kept, as a point is corrected, measured and left with one matrix.
        """
        at = z.tobytes()
        if at != self._kept_at[0]:
            self._kept_at = at, self._scaled(z, *self._values(z, self.numbers))
        return self._kept_at[1]

    def improvement(self, z: Array, solve: Solve) -> tuple[Array, Array | None]:
        """A Newton step: equations that are not discretised have errors by what is left of them, and by rounding."""
        return solve(np.append(self.evaluate(z)[0], 0.0)), None

    def _scaled(self, z: Array, residual: Array, nonzeros: Array) -> tuple[Array, Array]:
        largest = self.equation_sizes(z, nonzeros)
        return residual / largest, nonzeros / largest[self.pattern[0]]

    def equation_sizes(self, z: Array, nonzeros: Array) -> Array:
        """The largest derivative of each equation, by unknowns of their size; 1 of one that has none."""
        rows, columns = self.pattern
        largest = np.zeros(self.size - 1)
        np.maximum.at(largest, rows, np.abs(nonzeros) * np.maximum(np.abs(z), 1.0)[columns])
        return np.where(largest > 0.0, largest, 1.0)

    # Values ---------------------------------------------------------------------------------------------------------

    def state(self, z: Array) -> Array:
        """The unknowns of the model, shape (n,)."""
        return np.asarray(self.scale * z[: self.statics.size])

    def parameters(self, z: Array) -> Array:
        """All parameters of the model, in its order."""
        return np.asarray(self.parameters_at(z[self.states :]), dtype=float)

    def rates(self, z: Array) -> Any:
        """dF/dy, in units of the sizes, shape (n, n), of scipy.sparse where the model's derivatives are."""
        return self.statics.scaled(self.statics.matrix(self.state(z), self.parameters(z)), self.scale)

    def named(self, z: Array) -> dict[str, float]:
        """All parameters by name."""
        return dict(zip(self.statics.values, map(float, self.parameters(z)), strict=True))

    def profile_change(self, z: Array, step: Array, between: Array | None = None) -> float:
        n = self.statics.size
        return float(np.max(np.abs(step[:n]) / np.maximum(np.abs(z[:n]), SMALLEST_COMPONENT_RATIO)))

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the mean of |dy|^2 relative to the sizes, and of the scalars.

        A balanced unit at z is none for a length: it vanishes where eigenvectors meet, as at a Bogdanov-Takens point.
        """
        at, n = z.tobytes(), self.states
        if at != self._weighed[0]:  # kept, as a point is measured several times
            weights = np.asarray(1.0 / np.maximum(z * z, 1.0))
            weights[:n] /= n
            self._weighed = at, weights
        weights = self._weighed[1].copy()
        weights[-1] = parameter_scale**-2.0
        return weights

    def units_of_all(self, z: Array) -> Array:
        """Units of all unknowns at z, shape (size,)."""
        return np.concatenate([self.units(z), np.maximum(np.abs(z[self.states :]), 1.0)])

    def units(self, z: Array) -> Array:
        """Units of the components of y at z, shape (n,): the same whatever the units of the model's states are."""
        x, p, statics = self.state(z), self.parameters(z), self.statics
        courses = [*self.free, *([] if self.walking is None else [self.walking])]
        try:
            return _units(statics, x, p, courses, self.scale, self.scale) / self.scale
        except ArithmeticError:  # where the equations are not defined
            return np.maximum(np.abs(z[: statics.size]), 1.0)

    def rounding(self, z: Array) -> float:
        return super().rounding(z) * (self.statics.model.rounding / EPSILON)

    # Words ----------------------------------------------------------------------------------------------------------

    def place(self, equation: int) -> str:
        n = self.statics.size
        return f"the equation of {self.statics.names[equation]}" if equation < n else f"condition {equation - n + 1}"

    def describe_parameters(self, z: Array) -> str:
        named: Mapping[str, float] = self.named(z)
        words = ", ".join(f"{name} = {value:.6g}" for name, value in named.items())
        return f"with {words}" if words else f"at {self.statics.names[0]} = {self.state(z)[0]:.6g}"

    def deficiency(self, z: Array) -> str:
        """Unknowns that the equations leave undetermined at z while u is held, in words; empty where regular."""
        n, units, matrix = self.statics.size, self.units_of_all(z)[:-1], self.dense(z)[:, :-1]
        found = NullSpace.of(matrix, units, self.statics.model.rounding)
        if not found.vanishing:  # as far as the state is known
            moved = z - np.append(found.solution(self.evaluate(z)[0]), 0.0)
            found = NullSpace.of(matrix, units, self.statics.model.rounding, self.dense(moved)[:, :-1] - matrix)
        if not found.vanishing:
            return ""
        name = self.statics.names[int(np.argmax(np.abs(found.right[:n, -1] / units[:n])))]
        weights = np.abs(found.left[:, -1])
        rows = np.flatnonzero(weights > 0.05 * np.max(weights))
        dependent = " and ".join(self.place(int(row)) for row in rows[:6])
        verb = "vanishes" if rows.size == 1 else "depend on each other"
        return f"{dependent} {verb} to first order and leave {name} undetermined"

    def null_space(self, z: Array, moved: Array | None = None) -> NullSpace:
        """Null vectors of the Jacobian by all unknowns, where z is off by `moved`; one of them is the tangent.

        Vectors are in units of the unknowns.
        """
        matrix = self.jacobian(z)
        change = None if moved is None else self.jacobian(z + moved) - matrix
        return NullSpace.of(matrix, self.units_of_all(z), self.statics.model.rounding, change)

    def entries(self, z: Array) -> Array:
        """The non-zeros of the Jacobian of the equations as they are written."""
        return self._buffers(z, self.numbers)[1].copy()

    @cached_property
    def states_places(self) -> tuple[Indices, Indices, Indices]:
        """Which non-zeros of the Jacobian are derivatives of the model's equations by states, and their places."""
        rows, columns = self.pattern
        chosen = np.flatnonzero((rows < self.states) & (columns < self.states))
        return chosen, rows[chosen], columns[chosen]

    def states_part(self, nonzeros: Array) -> Any:
        """The derivatives by states, of scipy.sparse where the model's are, from non-zeros of the Jacobian."""
        from scipy.sparse import csc_matrix

        n, (chosen, rows, columns) = self.states, self.states_places
        if self.statics.is_sparse:
            return csc_matrix((nonzeros[chosen], rows, np.searchsorted(columns, np.arange(n + 1))), shape=(n, n))
        return self.filled(nonzeros)[:n, :n]

    def dense(self, z: Array) -> Array:
        """The Jacobian, each equation relative to its largest derivative, shape (size - 1, size)."""
        return self.filled(self.evaluate(z)[1])

    def jacobian(self, z: Array) -> Array:
        """The Jacobian of the equations as they are written, shape (size - 1, size)."""
        return self.filled(self.entries(z))

    def filled(self, nonzeros: Array) -> Array:
        """Dense ones, shape (..., size - 1, size)."""
        rows, columns = self.pattern
        matrix = np.zeros((*nonzeros.shape[:-1], self.size - 1, self.size))
        matrix[..., rows, columns] = nonzeros
        return matrix

    def equations_at_all(self, z: Array) -> tuple[Array, Array]:
        """Residuals and non-zeros of Jacobians of the equations as they are written at states (k, size)."""
        groups = np.minimum(np.arange(-(-len(z) // TOGETHER) * TOGETHER), len(z) - 1).reshape(-1, TOGETHER)
        found = [[v.reshape(TOGETHER, -1).copy() for v in self._several(z[some], self.numbers)] for some in groups]
        residual, nonzeros = (np.concatenate(parts)[: len(z)] for parts in zip(*found, strict=True))
        return residual, nonzeros

    @cached_property
    def _several(self) -> Buffers:
        """The equations at several states at once."""
        return Buffers(self.compiled, TOGETHER)

    @cached_property
    def along(self) -> Structure | None:
        """The same as kernels take them along a branch; None of more states, and where they are none of operations."""
        places = self._several.places if self.states <= MOST_STATES else None
        return None if places is None else rests(places, self.states, self.pattern)
