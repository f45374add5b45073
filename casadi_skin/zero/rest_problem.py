"""Algebraic equations with one unknown more, as correctors and continuations take them: nothing is discretised.

Unknowns are measured by sizes that are powers of two, so that scaling rounds nothing, and equations by their largest
derivative, so that stiff models and components of any unit are solved alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.problem import EPSILON, Array, Problem, Scalar
from casadi_skin.zero.statics import ROUNDED_COMPONENT_RATIO, NullSpace, Statics, units_of

SMALLEST_COMPONENT_RATIO = 1e-3  # of a component's size: changes of smaller components are measured by that
KEPT_UNITS = 16  # places whose units are kept
STATES_TOGETHER = 64  # states at which equations are evaluated by one call
BESIDE_STATE_WEIGHT = 0.1  # weight of unknowns beside state and parameters in the length of a step


@dataclass(frozen=True)
class Course:
    """A parameter that goes from a value to another one as a scalar s goes from 0 to 1."""

    name: str
    start: float
    to: float

    def at(self, s: Any) -> Any:
        """The value at s, a number or an expression."""
        return self.start + s * (self.to - self.start)

    def fraction(self, value: float) -> float:
        """The s of a value."""
        return (value - self.start) / (self.to - self.start)


def sizes_of(states: Sequence[Array]) -> Array:
    """Scale of each component: its largest value in these states as a power of two, shape (n,).

    One that is zero there has the median of the others as its scale, or 1.
    """
    largest = np.max(np.abs(np.stack(list(states))), axis=0)
    some = largest[largest > 1e-12 * float(np.max(largest, initial=0.0))]
    usual = float(np.median(some)) if some.size else 1.0
    return power_of_two(np.where(largest > 1e-12 * float(np.max(largest, initial=0.0)), largest, usual))


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
    matrix, ranges = statics.jacobian(x, p), np.abs(p)
    for course in courses:
        ranges[list(statics.values).index(course.name)] += abs(course.to - course.start)
    moved = statics.jacobian(
        x + ROUNDED_COMPONENT_RATIO * np.maximum(np.abs(x), sizes), p + ROUNDED_COMPONENT_RATIO * ranges
    )
    matrix = np.where(np.abs(matrix) <= np.abs(moved - matrix), 0.0, matrix)  # all are kept beside undefined places
    return units_of(matrix, x, moving(statics, x, p, courses), usual, sizes)


def moving(statics: Statics, x: Array, p: Array, courses: Sequence[Course]) -> Array:
    """Changes of f over the ranges of parameters, shape (n, courses)."""
    names, by_p = list(statics.values), statics.by_parameters(x, p)
    changes = [by_p[:, names.index(course.name)] * (course.to - course.start) for course in courses]
    return np.reshape(np.array(changes), (len(courses), statics.size)).T


class AlgebraicProblem(Problem):
    """Unknowns z = (y, others, scalars, u): the state over its sizes, those of an extended system, free parameters, u.

    Here F(y, p) = 0 alone, the model at rest in units of the sizes; u follows `walking`, or is held and does nothing.
    Subclasses add unknowns and equations: `others` counts theirs beside the state, `added` their scalars.
    """

    resolution = 1
    others = 0
    added = 0

    def __init__(
        self, statics: Statics, sizes: Array, free: Sequence[Course] = (), walking: Course | None = None
    ) -> None:
        self.statics, self.scale, self.free, self.walking = statics, sizes, tuple(free), walking
        self.states = statics.size + self.others

    @property
    def size(self) -> int:
        return self.states + len(self.free) + self.added + 1

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns; equilibria have no Omega."""
        if scalar is Scalar.OMEGA:
            raise ValueError("an equilibrium has no Omega")
        return self.size - 1

    def parameter_size(self, z: Array) -> float:
        """1, the range of u along a branch."""
        return max(1.0, abs(float(z[-1])))

    # Equations ------------------------------------------------------------------------------------------------------

    @property
    def force(self) -> Callable[[Expression, Expression], Expression]:
        """F(y, p): the equations in units of the sizes."""
        f, scale = self.statics.function, ca.DM(self.scale)
        return lambda y, p: f(scale * y, p) / scale

    def parameters_at(self, scalars: Any) -> Any:
        """All parameters of the model, in its order, from the scalars among the unknowns."""
        courses = {course.name: (course, place) for place, course in enumerate(self.free)}
        if self.walking is not None:
            courses[self.walking.name] = (self.walking, len(self.free) + self.added)
        entries = []
        for name, value in self.statics.values.items():
            course, place = courses.get(name, (None, 0))
            entries.append(value if course is None else course.at(scalars[place]))
        if isinstance(scalars, np.ndarray):
            return np.array(entries, dtype=float)
        return ca.vertcat(*entries) if entries else type(scalars)(0, 1)

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        """As many equations as y, others, free parameters and added scalars; c are the constants."""
        return self.force(y, self.parameters_at(scalars))

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        kind, n = type(self.statics.model.state), self.statics.size
        sizes = (n, self.states - n, self.size - self.states)
        y, others, scalars = (kind.sym(name, size) for name, size in zip("yop", sizes, strict=True))
        c = kind.sym("c", self.constants.size)
        R = ca.densify(self._residual(y, others, scalars, c))
        by_parts = [ca.jacobian(R, part) for part in (y, others, scalars)]
        function = ca.Function("algebraic", [y, others, scalars, c], [R, ca.horzcat(*by_parts)])
        symbol = ca.MX.sym("z", self.size)
        parts = ca.vertsplit(symbol, np.cumsum([0, *sizes]).tolist())
        residual, jacobian = function(*parts, self.constants_symbol)
        return symbol, residual, jacobian

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residual and non-zeros of the Jacobian, each equation relative to its largest derivative."""
        residual, nonzeros = super().evaluate(z)
        rows, columns = self.pattern
        largest = np.zeros(self.size - 1)
        np.maximum.at(largest, rows, np.abs(nonzeros) * np.maximum(np.abs(z), 1.0)[columns])
        largest[~(largest > 0.0)] = 1.0
        return residual / largest, nonzeros / largest[rows]

    # Values ---------------------------------------------------------------------------------------------------------

    def state(self, z: Array) -> Array:
        """The unknowns of the model, shape (n,)."""
        return np.asarray(self.scale * z[: self.statics.size])

    def parameters(self, z: Array) -> Array:
        """All parameters of the model, in its order."""
        return np.asarray(self.parameters_at(z[self.states :]), dtype=float)

    def named(self, z: Array) -> dict[str, float]:
        """All parameters by name."""
        return dict(zip(self.statics.values, map(float, self.parameters(z)), strict=True))

    def prolong(self, z: Array, finer: Problem) -> Array:
        return z.copy()

    def sample(self, z: Array, theta: Array) -> Array:
        return np.tile(self.state(z), (np.size(theta), 1))

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        scalars = slice(self.states, self.size - 1)
        return float(np.max(np.abs(step[scalars]) / np.maximum(np.abs(z[scalars]), 1.0), initial=0.0))

    def profile_change(self, z: Array, step: Array) -> float:
        n = self.statics.size
        return float(np.max(np.abs(step[:n]) / np.maximum(np.abs(z[:n]), SMALLEST_COMPONENT_RATIO)))

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the mean of |dy|^2 relative to the sizes, and of the scalars; little of what is beside these.

        A balanced unit at z is none for a length: it vanishes where eigenvectors meet, as at a Bogdanov-Takens point.
        """
        weights, n = np.maximum(np.abs(z), 1.0) ** -2.0, self.statics.size
        weights[:n] /= n
        weights[n : self.states] *= BESIDE_STATE_WEIGHT**2 / max(self.others, 1)
        weights[-1] = parameter_scale**-2.0
        return np.asarray(weights)

    def units_of_all(self, z: Array) -> Array:
        """Units of all unknowns at z, shape (size,)."""
        n, units = self.statics.size, self.units(z)
        usual = np.concatenate([self.units_beside(units), np.ones(self.size - self.states)])
        return np.concatenate([units, np.maximum(np.abs(z[n:]), usual)])

    def units(self, z: Array) -> Array:
        """Units of the components of y at z, shape (n,): the same whatever the units of the model's states are."""
        key = z.tobytes()
        known: dict[bytes, Array] = self.shared.setdefault("units", {})
        if key not in known:
            if len(known) >= KEPT_UNITS:
                del known[next(iter(known))]
            known[key] = self._units_at(z)
        return known[key]

    def _units_at(self, z: Array) -> Array:
        x, p, statics = self.state(z), self.parameters(z), self.statics
        courses = [*self.free, *([] if self.walking is None else [self.walking])]
        try:
            return _units(statics, x, p, courses, self.scale, self.scale) / self.scale
        except ArithmeticError:  # where the equations are not defined
            return np.maximum(np.abs(z[: statics.size]), 1.0)

    def units_beside(self, units: Array) -> Array:
        """Units of the unknowns between the state and the scalars, shape (others,), by those of the state."""
        return np.ones(self.others)

    def rounding(self, z: Array) -> float:
        return super().rounding(z) * (self.statics.model.rounding / EPSILON)

    # Words ----------------------------------------------------------------------------------------------------------

    def place(self, equation: int) -> str:
        n = self.statics.size
        return f"the equation of {self.statics.names[equation]}" if equation < n else f"condition {equation - n + 1}"

    def whereabouts(self, z: Array) -> str:
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

    def dense(self, z: Array) -> Array:
        """The Jacobian, each equation relative to its largest derivative, shape (size - 1, size)."""
        return self._matrix(self.evaluate(z)[1])

    def jacobian(self, z: Array) -> Array:
        """The Jacobian of the equations as they are written, shape (size - 1, size)."""
        return self._matrix(self._buffers(z, self.constants)[1])

    def _matrix(self, nonzeros: Array) -> Array:
        rows, columns = self.pattern
        matrix = np.zeros((*nonzeros.shape[:-1], self.size - 1, self.size))
        matrix[..., rows, columns] = nonzeros
        return matrix

    def equations_at_all(self, z: Array) -> tuple[Array, Array]:
        """Residuals and Jacobians of the equations as they are written at states (k, size): (k, m) and (k, m, size)."""
        if not self.statics.exact:  # a program is run for one state after the other
            residual, nonzero = np.empty((len(z), self.size - 1)), np.empty((len(z), self.pattern[0].size))
            for k, one in enumerate(z):
                residual[k], nonzero[k] = self._buffers(one, self.constants)
            return residual, self._matrix(nonzero)
        padded = np.concatenate([z, np.repeat(z[:1], -len(z) % STATES_TOGETHER, axis=0)]).reshape(
            -1, STATES_TOGETHER, self.size
        )
        numbers = np.tile(self.numbers[:, None], STATES_TOGETHER)
        found = [self._together(some.T, numbers) for some in padded]
        residuals = np.concatenate([np.array(residual).T for residual, _ in found])
        nonzeros = np.concatenate([jacobians.nz[:].full().reshape(STATES_TOGETHER, -1) for _, jacobians in found])
        return residuals[: len(z)], self._matrix(nonzeros[: len(z)])

    @cached_property
    def _together(self) -> ca.Function:
        """The function at `TOGETHER` states, whose residuals and Jacobians are columns one beside the other."""
        return self.compiled.map(STATES_TOGETHER)
