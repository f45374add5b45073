"""A stated boundary-value problem on a mesh, as correctors and walkers take it; and how its conditions close it.

Solutions close where x(end) = S x(start), but for a constant: S is 1 where they are periodic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import cut
from casadi_skin.model.expressions import Expression
from casadi_skin.model.result import NoQuantityError
from casadi_skin.native import Structure, kernels
from casadi_skin.native.collocation import UNITS
from casadi_skin.zero import mesh
from casadi_skin.zero.balanced import Faint
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.discretisation import Formulation, change_of, improved, largest_terms
from casadi_skin.zero.problem import Array, Problem, Scalar, Solve
from casadi_skin.zero.statement import Statement

LONGEST_CONDITION = 40  # characters of a condition in a message
PERIOD = "period"  # the free parameter that is the unknown period of an autonomous orbit
COMPONENT_FLOOR = 1e-3  # of the largest value of a component: what it is measured by at least
ZERO_SOLUTION_SIZE = 1e-12  # solutions smaller than this, found from zeros, are measured by 1
NEARBY_FACTORS_RATIO = 0.1  # of a step: the largest part that factors of another Jacobian may have left
# Of what moves a component, of the largest one where its guess is zero: smaller ones are measured by that.
SMALLEST_COMPONENT_RATIO = 1e-6


class BoundaryProblem(CollocationEquations):
    """Unknowns z = (states, free parameters, u), where u is held or followed.

    Each component of the state is measured by its own largest value, and by no less than its entry in `floors`; free
    parameters by their value and no less than `scalar_floors`.
    """

    measured_by_defect = True
    faint: Faint | None = None

    def __init__(
        self,
        statement: Statement,
        formulation: Formulation,
        intervals: int,
        table: CollocationTable,
        floors: Array,
        scalar_floors: Array,
        walking: str | None = None,
        end: float = 1.0,
    ) -> None:
        self.statement, self.walking, self.end = statement, walking, end
        self.floors, self.scalar_floors = floors, scalar_floors
        self._discretise(formulation, intervals, table, statement.constants(walking, end))
        self.mesh = mesh.Mesh(mesh.with_edges(self.constants, statement.switching), table.ends)

    def with_constants(self, constants: Array) -> Self:
        _ = self.compiled_units  # which the copy has too
        return super().with_constants(mesh.with_edges(constants, self.statement.switching))

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns; of the unknown period of an orbit, which stands for Omega."""
        if scalar is Scalar.PARAMETER:
            return self.size - 1
        if PERIOD not in self.statement.free:
            raise ValueError("a boundary-value problem without a free period has no Omega")
        return self.states + list(self.statement.free).index(PERIOD)

    @property
    def own_tangent(self) -> Array | None:
        return self.parameter_row() if self.walking is None else None

    def unknown_at(self, scalar: Scalar, value: float) -> float:
        """The unknown period at an Omega; u itself."""
        return 2.0 * np.pi / value if scalar is Scalar.OMEGA else value

    def parameter_size(self, z: Array) -> float:
        """1, the change of u along a branch."""
        return max(1.0, abs(float(z[-1])))

    # Values ---------------------------------------------------------------------------------------------------------

    def parameters(self, z: Array) -> Array:
        """All parameters of the model, in its order."""
        found = self.statement.parameters_at(z[self.states :], self.walking, self.end)
        return np.asarray(found, dtype=float)

    def sample(self, z: Array, theta: Array) -> Array:
        return self._interpolate(z, np.asarray(theta, dtype=float))

    def sizes_at(self, z: Array) -> tuple[Array, float]:
        """Components and times have units of their own; a component whose guess is zero has that of the largest one.

        Of a condition whose derivative vanishes the size is that of the smallest, or 1: it determines nothing there.
        """
        sizes, floors = self.sizes(z), self.floors
        if floors.all():
            return sizes, min(1.0, float(floors.min()) / COMPONENT_FLOOR)
        states = sizes[: self.states].reshape(self.columns, -1)
        states[:, floors == 0.0] = np.max(states[0])
        return sizes, float(np.min(floors[floors > 0.0] / COMPONENT_FLOOR, initial=1.0))

    def units_at(self, z: Array, nonzeros: Array) -> tuple[Array, Array]:
        """Sizes of unknowns, and of the largest terms of residuals."""
        sizes, least = self.sizes_at(z)
        largest = largest_terms(nonzeros, *self.pattern, sizes, self.size - 1)
        conditions = largest[self.states - self.formulation.states :]
        conditions[:] = np.maximum(conditions, least)
        return sizes, largest

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        free = slice(self.states, self.size - 1)
        return float(np.max(np.abs(step[free]) / self._scalar_sizes(z), initial=0.0))

    def profile_change(self, z: Array, step: Array, between: Array | None = None) -> float:
        sizes = self._component_sizes(z)
        return change_of(self.discretisation, step, between, sizes)

    def improvement(self, z: Array, solve: Solve) -> tuple[Array, Array] | None:
        """The step to the solution of a method of twice as many stages, and what z misses between its own stages."""
        sizes = self._component_sizes(z)
        step, between, (largest, rest) = improved(self.discretisation, z, self.numbers, solve, sizes)
        return (step, between) if rest <= NEARBY_FACTORS_RATIO * largest else None

    @cached_property
    def compiled_units(self) -> Structure:  # type: ignore[override]
        """Kept by all meshes of as many intervals, and up to date, as `floors` are written to in their place."""
        counts = self.formulation.states, self.columns, self.size - self.states
        scalars = np.array(np.broadcast_to(self.scalar_floors, counts[2] - 1), dtype=float)
        return Structure(UNITS, *counts, self.floors, scalars, SMALLEST_COMPONENT_RATIO, COMPONENT_FLOOR)

    def _component_sizes(self, z: Array) -> Array:
        """Sizes of the components of the state, shape (components,)."""
        if kernels():
            found = np.empty(self.formulation.states)
            kernels()["collocation_sizes"](self.compiled_units, np.ascontiguousarray(z), found)
            return found
        largest = np.max(np.abs(z[: self.states].reshape(self.columns, -1)), axis=0)
        found = np.maximum(largest, self.floors)
        least = SMALLEST_COMPONENT_RATIO * found.max()
        return np.asarray(np.where(self.floors > 0.0, found, np.maximum(found, least)))

    def measure_by(self, z: Array) -> None:
        """Let FLOOR of z be what its components are measured by at least, where it is not zero but for rounding.

        On all meshes that share `floors`: a guess of zeros has not the size of the solution that it led to.
        """
        largest = np.max(np.abs(z[: self.states].reshape(self.columns, -1)), axis=0)
        if np.max(largest) > ZERO_SOLUTION_SIZE:
            self.floors[:] = COMPONENT_FLOOR * largest

    def _scalar_sizes(self, z: Array) -> Array:
        return np.asarray(np.maximum(np.abs(z[self.states : -1]), self.scalar_floors))

    def sizes(self, z: Array, parameter_scale: float = 1.0) -> Array:
        """Scale of each unknown, shape (size,)."""
        found = np.empty(self.size)
        found[: self.states].reshape(self.columns, -1)[:] = self._component_sizes(z)
        found[self.states : -1], found[-1] = self._scalar_sizes(z), parameter_scale
        return found

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the mean over the columns of |dx|^2 relative to the components' sizes, and of the scalars.

        Tails do not count: components that are faint where a branch starts are measured by what acts on them.
        """
        weights, faint = np.empty(self.size), self.faint
        if kernels():
            kernels()["collocation_metric"](self.compiled_units, np.ascontiguousarray(z), parameter_scale, weights)
        else:
            weights[:] = self.sizes(z, parameter_scale) ** -2.0
            weights[: self.states] /= self.columns
        if faint is not None:
            sizes = self._component_sizes(z)
            weights[: self.states].reshape(self.columns, -1)[:] *= (sizes / faint.measured(sizes)) ** 2
        return weights

    def speed_ratio(self, z: Array) -> float:
        if kernels():
            speed, sizes = np.empty(1), np.empty(self.formulation.states)
            kernels()["collocation_speed"](self.compiled_units, np.ascontiguousarray(z), self.mesh.gaps, sizes, speed)
            return float(speed[0])
        values = z[: self.states].reshape(self.columns, -1)
        moves = (values[1:] - values[:-1]) / self._component_sizes(z)
        ways = np.sqrt(np.einsum("ij,ij->i", moves, moves))
        whole = float(ways.sum())
        return float((ways / self.mesh.gaps).max()) / whole if whole > 0.0 else 0.0

    @property
    def may_move(self) -> bool:  # type: ignore[override]
        return PERIOD in self.statement.free and not self.statement.switching.size

    def rounding(self, z: Array) -> Array:  # type: ignore[override]
        """Of each equation, as components of the state have units of their own."""
        largest = largest_terms(self.evaluate(z)[1], *self.pattern, z, self.size - 1)
        return self.statement.model.rounding * largest

    # Words ----------------------------------------------------------------------------------------------------------

    def describe_parameters(self, z: Array) -> str:
        names, values = self.statement.model.parameter_names, self.parameters(z)
        words = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, values, strict=True))
        return f"with {words}" if words else f"on {self.resolution} intervals"

    def backwards(self, z: Array) -> str:
        """That the interval ends before it starts, in words, where its ends are free and do; empty where not."""
        start, end = self.statement.span(self.parameters(z))
        return "" if end > start else f"the interval found, {start:.6g} to {end:.6g}, does not end after its start"

    def time(self, z: Array, column: int) -> float:
        """Where a column of state values is in the interval."""
        start, end = self.statement.span(self.parameters(z))
        return float(start + self._fractions()[column] * (end - start))

    def place(self, equation: int) -> str:
        """Variable and place of an equation of the field, at the guessed interval; or which condition it is."""
        guessed = np.zeros(self.size)
        guessed[self.states : -1] = [self.statement.values[name] for name in self.statement.free]
        return self._place(equation, guessed)

    def _place(self, equation: int, z: Array) -> str:
        n, rows = self.formulation.states, self.table.ends.size
        if equation < self.resolution * rows * n:
            time = self.time(z, equation // n + 1)
            return f"the equation of {self.statement.model.state_names[equation % n]} at t = {time:.6g}"
        condition = equation - self.resolution * rows * n
        ends = int(self.formulation.conditions.numel())
        if condition < ends:
            return f"condition {condition + 1} ({_entry(self.statement.conditions, condition)})"
        return f"integral {condition - ends + 1} ({_entry(self.statement.integrals, condition - ends)})"


def stated(problem: Problem) -> BoundaryProblem:
    """A problem that was stated; raises NoQuantityError for one of a family or of equilibria."""
    if not isinstance(problem, BoundaryProblem):
        raise NoQuantityError("problem: no boundary-value problem was stated; accepted: point.problem")
    return problem


def _entry(expressions: Sequence[Expression], index: int) -> str:
    """One scalar of several expressions as text, cut where it is long."""
    entries = [entry for expression in expressions for entry in ca.vertsplit(ca.vec(expression))]
    text = str(entries[index])
    words = text[1:-1] if text[:1] == "(" and text[-1:] == ")" else text
    return cut(words, LONGEST_CONDITION)


# Closure --------------------------------------------------------------------------------------------------------------

# Random points at which derivatives of conditions are compared, and their difference.
CONDITION_TRIALS, SAME_DERIVATIVE_ATOL = 3, 1e-12
TURNED_FIELD_RTOL = 1e-9  # relative: a field that is the same after a turn


@dataclass(frozen=True, eq=False)
class Closure:
    """How solutions of a statement come back to S times their start: S is 1 where they are periodic.

    Attributes:
        statement: the problem.
        matrix: S, shape (n, n).
        closing: the numbers of the n conditions that close them, all conditions counted one by one.
        end: the derivative of these by the state at the end, shape (n, n).
    """

    statement: Statement
    matrix: Array
    closing: tuple[int, ...]
    end: Array

    def shift(self, parameters: Array) -> Array:
        """The vector added to S times the start, shape (n,)."""
        model, n = self.statement.model, self.matrix.shape[0]
        rows = ca.Function("rows", [*model.ends, model.parameters], [_rows(self.statement)])
        at_rest = np.array(rows(np.zeros(n), np.zeros(n), parameters)).ravel()[list(self.closing)]
        return np.asarray(-np.linalg.solve(self.end, at_rest))

    def twice(self) -> Statement:
        """The problem of solutions that close after two turns; its other conditions are those of the first one."""
        model, n = self.statement.model, self.matrix.shape[0]
        rows, (start, end) = _rows(self.statement), model.ends
        known = ca.Function("rows", [start, end, model.parameters], [rows])
        zeros = type(start).zeros(n)
        middle = ca.DM(self.matrix) @ start - ca.solve(
            ca.DM(self.end), known(zeros, zeros, model.parameters)[list(self.closing)]
        )
        closed = known(middle, end, model.parameters)[list(self.closing)]
        others = [rows[k] for k in range(int(rows.numel())) if k not in self.closing]
        first, last = self.statement.interval
        return replace(self.statement, conditions=[closed, *others], interval=(first, 2 * last - first))

    def goes_on(self, problem: BoundaryProblem, z: Array) -> bool:
        """Whether the field is the same after a turn, f(t + T, S x + c) = S f(t, x), at places near a solution."""
        model, p = self.statement.model, problem.parameters(z)
        start, end = self.statement.span(p)
        generator, places = np.random.default_rng(0), np.linspace(0.0, 1.0, CONDITION_TRIALS + 1)[:-1]
        field = model.function("field", ca.densify(model.full_rhs))
        for t, x in zip(start + places * (end - start), problem.sample(z, places), strict=True):
            near = x + 0.1 * (1.0 + np.abs(x)) * generator.normal(size=x.size)
            here = self.matrix @ np.array(field(t, near, p)).ravel()
            after = np.array(field(t + end - start, self.matrix @ near + self.shift(p), p)).ravel()
            if not np.max(np.abs(after - here)) <= TURNED_FIELD_RTOL * (1.0 + np.max(np.abs(here))):
                return False
        return True


def closure_of(statement: Statement) -> Closure | None:
    """How the conditions of a statement close its solutions; None where they do not.

    Those conditions that hold a start and an end linearly have to determine either from the other.
    """
    model, n = statement.model, statement.model.full_size
    if not statement.conditions:
        return None
    rows, (start, end) = _rows(statement), model.ends
    slopes = ca.Function(
        "slopes", [start, end, model.parameters],
        [ca.densify(ca.jacobian(rows, start)), ca.densify(ca.jacobian(rows, end))],
    )  # fmt: skip
    generator, found = np.random.default_rng(0), []
    for _ in range(CONDITION_TRIALS):
        points = (np.abs(generator.normal(size=size)) for size in (n, n, model.parameters.numel()))
        found.append(np.hstack([np.array(slope) for slope in slopes(*points)]))
    first = found[0]
    linear = np.all([np.max(np.abs(other - first), axis=1) <= SAME_DERIVATIVE_ATOL for other in found[1:]], axis=0)
    both = linear & np.any(first[:, :n] != 0.0, axis=1) & np.any(first[:, n:] != 0.0, axis=1)
    A, B = first[both, :n], first[both, n:]
    if A.shape[0] != n or np.linalg.matrix_rank(A) < n or np.linalg.matrix_rank(B) < n:
        return None
    return Closure(statement, -np.linalg.solve(B, A), tuple(np.flatnonzero(both).tolist()), B)


def _rows(statement: Statement) -> Expression:
    """The conditions at the ends, one below the other."""
    return ca.vertcat(*(ca.vec(condition) for condition in statement.conditions))
