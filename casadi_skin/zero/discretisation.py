"""A boundary-value problem on the unit interval: the data that collocation needs, of orbits as of any problem.

Residual and Jacobian of collocation on K intervals, assembled by structure from one mapped function of the model.

No symbolic graph of a mesh: what depends on the number of intervals alone, as which entry of the Jacobian comes from
where, is worked out once, and serves all meshes and solutions of that number; lengths of intervals are arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.native import Structure as Compiled
from casadi_skin.native import kernels
from casadi_skin.native.collocation import CHECKS, EQUATIONS
from casadi_skin.native.programs import CallingBuffers, Calls, Program
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.problem import Array, Buffers, Indices, Solve

Pattern = tuple[tuple[int, ...], ...]  # rows and columns of non-zeros, by columns
Places = NDArray[np.int32]  # of the non-zeros of a mesh: of a thousand states these fill the memory


@dataclass(frozen=True, eq=False)
class Formulation:
    """dx/ds = field(s, x, sigma) for s in [0, 1], with rows that vanish at the ends and integrals that vanish.

    `s`, `x`, `ends` (x at the start and at the end) and `scalars` (sigma: Omega or a duration, parameters, unfolding
    coefficients) are symbols of one kind, SX or MX, and so are the `constants`, whose values may change without
    anything being built again: all expressions may have them in. `conditions` are expressions in `ends` and in sigma;
    `integrands` are expressions in s, x and sigma. Together they are one less than components of x and scalars: one
    scalar is held or followed.
    """

    s: Expression
    x: Expression
    ends: tuple[Expression, Expression]
    scalars: Expression
    field: Expression
    conditions: Expression
    integrands: Expression
    constants: Expression
    programs: Sequence[Program] = ()  # that expressions may call

    @cached_property
    def discretisations(self) -> dict[tuple[int, CollocationTable], Any]:
        """Discretisations made of this formulation, by the number of intervals and the table of the method."""
        return {}

    @cached_property
    def states(self) -> int:
        """Number of components of x."""
        return int(self.x.numel())

    @cached_property
    def integrals(self) -> int:
        """Number of integral conditions."""
        return int(self.integrands.numel())

    @cached_property
    def field_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> (F, sparse dF/dx, dense dF/dsigma)."""
        return self._along("field", self.field, sparse=True)

    @cached_property
    def component_order(self) -> NDArray[np.int64]:
        """An order of the components of x in which factors of 1 - dF/dx are sparse, by approximate minimum degree."""
        pattern = self.field_function.sparsity_out(1)
        return np.array((pattern + pattern.T + ca.Sparsity.diag(self.states)).amd(), dtype=np.int64)

    def at_stages(self, *arguments: ca.MX) -> list[ca.MX]:
        """F, dF/dx and dF/dsigma at several stages, one column of (s, x, sigma, constants) each.

        An SX function gives all at once. Of a program values have a function of their own: CasADi evaluates all of an
        MX function, also results that are not used.
        """
        count = arguments[0].size2()
        found = list(self.field_function.map(count)(*arguments))
        if self.values_function is not self.field_function:
            found[0] = self.values_function.map(count)(*arguments)
        return found

    @cached_property
    def values_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> F first: without derivatives where CasADi would evaluate them all."""
        if self.field_function.is_a("SXFunction"):
            return self.field_function
        return ca.Function("values", self._arguments, [ca.densify(self.field)])

    def buffers(self, function: ca.Function, places: int) -> Buffers:
        """One of these functions at so many places; programs that it calls take all of them at once."""
        if function not in self._calls:
            self._calls[function] = Calls.of(function, self.programs)
        calls = self._calls[function]
        return Buffers(function, places) if calls is None else CallingBuffers(calls, places)

    @cached_property
    def _calls(self) -> dict[ca.Function, Calls | None]:
        return {}

    @cached_property
    def integrand_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> (e, dense de/dx, dense de/dsigma)."""
        return self._along("integrands", self.integrands, sparse=False)

    def _along(self, name: str, values: Expression, sparse: bool) -> ca.Function:
        by_x, by_scalars = ca.jacobian(values, self.x), _dense(ca.jacobian(values, self.scalars))
        results = [_dense(values), by_x if sparse else _dense(by_x), by_scalars]
        return ca.Function(name, self._arguments, results)

    @property
    def _arguments(self) -> list[Expression]:
        return [self.s, self.x, self.scalars, self.constants]

    @cached_property
    def condition_function(self) -> ca.Function:
        """Function (x at start, x at end, sigma, constants) -> (rows, sparse derivatives by the first three)."""
        derivatives = [
            *(ca.jacobian(self.conditions, end) for end in self.ends),
            ca.jacobian(self.conditions, self.scalars),
        ]
        results = [_dense(self.conditions), *derivatives]
        return ca.Function("conditions", [*self.ends, self.scalars, self.constants], results)

    @cached_property
    def condition_buffers(self) -> Buffers:
        """The same, called with arrays."""
        return Buffers(self.condition_function, listed=True)

    @cached_property
    def entries(self) -> tuple[Indices, Indices]:
        """Rows and columns of the non-zeros of dF/dx."""
        rows, columns = self.field_function.sparsity_out(1).get_triplet()
        return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)

    @cached_property
    def patterns(self) -> tuple[Pattern, tuple[Pattern, ...]]:
        """Non-zeros of dF/dx, and of the conditions' derivatives by x at the start, x at the end and sigma."""
        found = [self.field_function.sparsity_out(1), *(self.condition_function.sparsity_out(i) for i in (1, 2, 3))]
        along, *by_ends = (tuple(map(tuple, sparsity.get_triplet())) for sparsity in found)
        return along, tuple(by_ends)


def _dense(values: Expression) -> Expression:
    if values.is_dense():
        return values
    return ca.densify(values) if values.nnz() else type(values).zeros(*values.shape)


# Places of the entries of collocation equations, which depend on numbers and patterns alone, for all problems ---------

KEPT_STRUCTURES, LARGE_NONZEROS = 64, 20_000  # structures that are kept, and non-zeros beyond which none are


@dataclass(frozen=True, eq=False)
class Structure:
    """Where entries of the Jacobian go.

    Attributes:
        rows, columns: places of the non-zeros, column by column.
        differences: the part of the non-zeros that is constant, 1, -1 or 0, in a byte each.
        stiff: the non-zero that takes each entry of the field's derivatives by the states at the stages.
        rest: the same for derivatives by the scalars, of the conditions and of the integrals.
        stage: columns of the state values that are stages, the last one twice: there are as many check points.
        start: columns of the starts of the intervals.
    """

    rows: Places
    columns: Places
    differences: NDArray[np.int8]
    stiff: Places
    rest: Places
    stage: Indices
    start: Indices
    _made: dict[str, Any] = field(default_factory=dict)

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """Objects that depend on this structure alone; their users do not change them."""
        if name not in self._made:
            self._made[name] = make()
        return self._made[name]


@lru_cache(maxsize=KEPT_STRUCTURES)
def structure_of(
    n: int, K: int, stages: tuple[int, ...], R: int, m: int, counts: tuple[int, int], field: Pattern,
    by_ends: tuple[Pattern, ...],
) -> Structure:  # fmt: skip
    """The places of all entries, which are not to be written to.

    Arguments:
        n, K, R, m: numbers of states, of intervals, of increments of an interval and of scalars.
        stages: their places among the values of an interval.
        counts: numbers of conditions and of integrals.
        field: pattern of the field's derivative by the states.
        by_ends: patterns of the conditions' derivatives by the state at the start, that at the end, and the scalars.
    """
    d, bottom, values, component = len(stages), n * K * R, n * (K * R + 1), np.arange(n)
    stage, start = (np.arange(K)[:, None] * R + np.array(stages)).ravel(), np.arange(K) * R
    increment, scalars = np.arange(bottom), values + np.arange(m)
    ends = np.arange(1, K * R + 1), np.repeat(start, R)
    at_end, at_start = ((column[:, None] * n + component).ravel() for column in ends)
    r, c = (np.array(t, dtype=np.int64) for t in field)
    stiff = np.broadcast_arrays(increment.reshape(K, R, 1, n)[..., r], stage.reshape(K, 1, d, 1) * n + c)
    parts = [(increment, at_end), (increment, at_start), stiff]
    parts.append(np.broadcast_arrays(increment.reshape(K, R, 1, n), scalars[:, None]))
    for pattern, offset in zip(by_ends, (0, bottom, values), strict=True):
        rows, columns = (np.array(t, dtype=np.int64) for t in pattern)
        parts.append((rows + bottom, columns + offset))
    if counts[1]:
        first = bottom + counts[0] + np.arange(counts[1])
        parts.append(np.broadcast_arrays(first, stage[:, None, None] * n + component[:, None]))
        parts.append(np.broadcast_arrays(first, scalars[:, None]))
    equations = bottom + sum(counts)
    sizes = [np.size(rows) for rows, _ in parts]
    keys = np.concatenate([(columns * equations + rows).ravel() for rows, columns in parts])
    order = np.argsort(keys, kind="stable")
    keys, slots = keys[order], np.empty(keys.size, dtype=np.int32)
    new = np.append(True, keys[1:] != keys[:-1])
    slots[order], keys = np.cumsum(new, dtype=np.int32) - 1, keys[new]
    plus, minus, by_states, *rest = np.split(slots, np.cumsum(sizes)[:-1])
    differences = np.zeros(keys.size, dtype=np.int8)
    differences[plus], differences[minus] = 1, -1
    rows, columns = (keys % equations).astype(np.int32), (keys // equations).astype(np.int32)
    return Structure(rows, columns, differences, by_states, np.concatenate(rest), np.append(stage, stage[-1]), start)


class Discretisation:
    """Collocation equations of a formulation on K intervals of any lengths that sum to 1.

    Attributes:
        formulation, table: the problem and the method.
        structure: where entries of the Jacobian go.
        rows, columns: places of its non-zeros, column by column.
        equations: their number.
        shared: solvers that have been made for these equations, by name.
    """

    def __init__(self, formulation: Formulation, intervals: int, table: CollocationTable) -> None:
        self.shared: dict[Any, Any] = {}
        self._at, self._last, self._by_states = b"", (np.empty(0), np.empty(0)), np.empty(0)
        self._on = b""  # the mesh whose places and weights are kept
        self._n, self._K, self._d, self._R = formulation.states, intervals, table.degree, table.ends.size
        self._m, self.table, self.formulation = int(formulation.scalars.numel()), table, formulation
        self._states = self._n * (intervals * self._R + 1)
        places = intervals * self._d + 1  # the stages, or the check points
        field, values = formulation.field_function, formulation.values_function
        self._field = formulation.buffers(field, places)
        self._values = self._field if values is field else formulation.buffers(values, places)
        self._conditions = formulation.condition_buffers
        self._integrals = formulation.integrals
        self._integrands = formulation.buffers(formulation.integrand_function, places) if self._integrals else None
        self._counts = counts = int(formulation.conditions.numel()), formulation.integrals
        self.equations = self._states - self._n + sum(counts)
        sizes = self._n, intervals, table.stages, self._R, self._m
        large = places * self._R * len(formulation.patterns[0][0]) > LARGE_NONZEROS
        structure = structure_of.__wrapped__ if large else structure_of
        self.structure: Structure = structure(*sizes, counts, *formulation.patterns)
        self.rows, self.columns = self.structure.rows, self.structure.columns
        self._stage, self._start = self.structure.stage, self.structure.start

    @cached_property
    def compiled(self) -> Compiled:
        """These equations as kernels take them."""
        of, (condition, *by_ends) = self.structure, self._conditions.results
        numbers = [self._n, self._K, self._R, self._d, self._m, len(self.formulation.patterns[0][0]), *self._counts]
        values, by_x, by_s = self._integrands.results if self._integrands else 3 * [None]
        arrays = [np.ascontiguousarray(self.table.extended), of.differences, of.stiff, of.rest, *self._field.results]
        sizes = [of.rows.size, *(part.size for part in by_ends)]
        functions = [each.places if each else None for each in (self._field, self._conditions, self._integrands)]
        stages = np.array(self.table.stages), of.rows, of.columns
        data = *arrays, condition, *by_ends, values, by_x, by_s, *functions, self.table.nodes, *stages
        return Compiled(EQUATIONS, *numbers, *sizes, *data)

    @cached_property
    def in_operations(self) -> bool:
        """Whether kernels evaluate all functions: each is one of operations."""
        functions = (self._field, self._conditions, self._integrands)
        return all(each is None or each.places is not None for each in functions)

    @cached_property
    def checks(self) -> Compiled | None:
        """The check points of the defect as kernels take them; None where a function is none of operations."""
        table = self.table.defect
        weights = table.inner, table.values, table.slopes, table.increments, table.between, *table.quadrature
        first, count = int(np.argmax(table.checked)), int(np.count_nonzero(table.checked))
        arrays = map(np.ascontiguousarray, weights)
        return Compiled(CHECKS, table.inner.size, first, count, *arrays) if self.in_operations else None

    def __call__(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        """Residual, and the non-zeros of the Jacobian in the order of `rows` and `columns`; not to be written to.

        `numbers` are the lengths of the intervals, then the constants of the formulation. The last results are kept: a
        solution is measured where it was solved.
        """
        if z.tobytes() + numbers.tobytes() != self._at:
            self.keep(z, numbers, self._assembled(z, numbers))
        return self._last

    def keep(self, z: Array, numbers: Array, found: tuple[Array, Array]) -> None:
        """Keep residual and non-zeros, which nobody writes to from now on."""
        for array in found:
            array.flags.writeable = False
        self._at, self._last = z.tobytes() + numbers.tobytes(), found

    @property
    def intervals(self) -> int:
        """Number K of intervals."""
        return self._K

    @property
    def state_values(self) -> int:
        """How many of the unknowns are values of states."""
        return self._states

    def times(self, nonzeros: Array, step: Array) -> Array:
        """A matrix of the pattern of the Jacobian times a step, shape (equations,)."""
        if not kernels():
            return np.asarray(np.bincount(self.rows, nonzeros * step[self.columns], self.equations), dtype=float)
        found = np.empty(self.equations)
        kernels()["collocation_times"](self.compiled, nonzeros, np.ascontiguousarray(step), found)
        return found

    def _lay(self, lengths: Array) -> None:
        """Set the places of the stages, shape (K d + 1, 1), and the weights of their increments, shape (K, R, d)."""
        on = lengths.tobytes()
        if on != self._on:
            starts = np.cumsum(lengths) - lengths
            stages = starts[:, None] + lengths[:, None] * self.table.nodes
            self._places = np.append(stages, stages[-1, -1])[:, None]
            self._weights = lengths[:, None, None] * self.table.extended
            self._quadrature = self._weights[:, -1].ravel()
            self._on = on

    def stages(self, z: Array, numbers: Array) -> tuple[Array, Array, Array, Array]:
        """(s, x, scalars, constants) at the stages, the last one twice."""
        self._lay(numbers[: self._K])
        values = z[: self._states].reshape(-1, self._n)
        return self._places, values[self._stage], z[self._states :], numbers[self._K :]

    def _assembled(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        n, K, d, R, m = self._n, self._K, self._d, self._R, self._m
        if kernels():
            for function in (self._field, self._conditions, self._integrands):
                if function is not None and function.places is None:
                    function(*(self._ends(z, numbers) if function is self._conditions else self.stages(z, numbers)))
            found = np.empty(self.equations), np.empty(self.rows.size)
            kernels()["collocation_equations"](self.compiled, np.ascontiguousarray(z), numbers, *found)
            self._by_states = self._by_stages(self._field.results[1]).copy()
            return found
        arguments = self.stages(z, numbers)
        values, weights = z[: self._states].reshape(-1, n), self._weights
        field, by_states, by_scalars = map(self._by_stages, self._field(*arguments))
        self._by_states = by_states.copy()
        increments = weights @ field.reshape(K, d, n)
        ends = values[1:].reshape(K, R, n) - values[self._start][:, None, :]
        condition, *derivatives = self._conditions(*self._ends(z, numbers))
        residual = [(ends - increments).ravel(), condition]
        rest = [-(weights @ by_scalars.reshape(K, d, m * n)).ravel(), *derivatives]
        if self._integrands is not None:
            own, quadrature = self._integrals, self._quadrature
            value, by_x, by_s = map(self._by_stages, self._integrands(*arguments))
            residual.append(quadrature @ value.reshape(K * d, own))
            rest += [(quadrature[:, None] * by_x.reshape(K * d, -1)).ravel(), quadrature @ by_s.reshape(K * d, -1)]
        nonzeros = self.structure.differences.astype(float)
        nonzeros[self.structure.stiff] -= (weights[..., None] * by_states.reshape(K, 1, d, -1)).ravel()
        nonzeros[self.structure.rest] = np.concatenate(rest)
        return np.concatenate(residual), nonzeros

    def _ends(self, z: Array, numbers: Array) -> tuple[Array, Array, Array, Array]:
        """The states at the start and at the end, the scalars and the constants."""
        count, n = self._states, self._n
        return z[:n], z[count - n : count], z[count:], numbers[self._K :]

    def _by_stages(self, found: Array) -> Array:
        """Results of a mapped function, one row a stage."""
        return found.reshape(self._K * self._d + 1, -1)[:-1]

    def jacobians(self, z: Array, numbers: Array, count: int) -> Array:
        """Derivatives of the field by the first `count` states at the stages, dense, shape (K d, count, count)."""
        if self._field.places is not None:
            found = np.empty((self._K * self._d, count, count))
            data = np.ascontiguousarray(z), numbers, count, *self.formulation.entries, found
            kernels()["collocation_jacobians"](self.compiled, *data)
            return found
        if z.tobytes() + numbers.tobytes() == self._at:
            return self._dense(self._by_states)[:, :count, :count]
        return self._dense(self._by_stages(self._field(*self.stages(z, numbers))[1]))[:, :count, :count]

    def jacobians_at(self, *arguments: Array) -> Array:
        """The same at (s, x, scalars, constants), as many places as there are stages and one more."""
        return self._dense(self.derivatives_at(*arguments))

    def derivatives_at(self, *arguments: Array) -> Array:
        """The non-zeros of these."""
        return self._field(*arguments)[1].reshape(self._K * self._d + 1, -1)

    def _dense(self, nonzeros: Array) -> Array:
        found = np.zeros((len(nonzeros), self._n, self._n))
        rows, columns = self.formulation.entries
        found[:, rows, columns] = nonzeros
        return found

    def along(self, *arguments: Array) -> tuple[Array, Array]:
        """Field and integrands at (s, x, scalars, constants), as many places as there are stages and one more."""
        field = self._values(*arguments)[0].reshape(-1, self._n).copy()
        if self._integrands is None:
            return field, np.zeros((len(field), 0))
        return field, self._integrands(*arguments)[0].reshape(-1, self._integrals).copy()


def missed(equations: Discretisation, z: Array, numbers: Array) -> tuple[Array, Array]:
    """The residual of the solution z in a method of twice as many stages, on its own mesh.

    Arguments:
        equations: the equations that z solves.
        z: unknowns.
        numbers: lengths of the intervals, and constants.

    Returns:
        The residual, shape (size - 1,), and the integral of the defect from the start of its interval to each inner
        check point, less the polynomial through those at the stages, shape (inner points, states).
    """
    of, table, K, d = equations.formulation, equations.table.defect, equations.intervals, equations.table.degree
    if kernels() and equations.checks is not None:
        found = np.empty(equations.equations), np.empty((K * table.inner.size, of.states))
        kernels()["collocation_missed"](equations.compiled, equations.checks, z, numbers, *found)
        return found
    lengths, arguments = numbers[:K], _at_checks(equations, z, numbers)
    field, integrands = (_by_intervals(equations, found) for found in equations.along(*arguments))
    rises = polynomials(equations, z)[1]
    defects = lengths[:, None, None] * field - table.slopes[:, 1:] @ rises
    residual = [-(table.increments @ defects).ravel(), np.zeros(of.conditions.numel())]
    if of.integrals:
        at_stages = equations.along(*equations.stages(z, numbers))[1][:-1].reshape(K, d, -1)
        whole = table.quadrature[0] @ at_stages + table.quadrature[1] @ integrands
        residual.append(lengths @ whole - lengths @ (equations.table.extended[-1] @ at_stages))
    return np.concatenate(residual), (table.between @ defects).reshape(-1, of.states)


def improved(
    equations: Discretisation, z: Array, numbers: Array, solve: Solve, sizes: Array
) -> tuple[Array, Array, Array]:
    """The step to the solution of a method of twice as many stages, and what z misses between, see `missed`.

    And the largest changes by both, and by what the factors of a Jacobian nearby have left of the step.
    """
    (residual, nonzeros), size, compiled = equations(z, numbers), z.size, getattr(solve, "compiled", None)
    if kernels() and equations.checks is not None and compiled is not None:
        inner = equations.intervals * equations.table.defect.inner.size
        found = np.empty(size), np.empty((inner, equations.formulation.states)), np.empty(2)
        data = equations.compiled, equations.checks, *compiled, z, numbers, residual, nonzeros, sizes
        kernels()["collocation_improved"](*data, *found, np.empty(2 * size))
        return found
    left, between = missed(equations, z, numbers)
    right = np.append(residual + left, 0.0)
    step = solve(right)
    right[:-1] -= equations.times(nonzeros, step)
    more = solve(right)
    step = step + more
    changes = change_of(equations, step, between, sizes), change_of(equations, more, None, sizes)
    return step, between, np.array(changes)


def largest_terms(nonzeros: Array, rows: Indices, columns: Indices, z: Array, count: int) -> Array:
    """The largest of the terms of each of `count` equations: derivatives times the unknowns."""
    found = np.zeros(count)
    if kernels():
        places = (np.ascontiguousarray(each, dtype=np.int32) for each in (rows, columns))
        kernels()["largest_terms"](nonzeros.size, nonzeros, *places, np.ascontiguousarray(z), found)
    else:
        np.maximum.at(found, rows, np.abs(nonzeros * z[columns]))
    return found


def change_of(equations: Discretisation, step: Array, between: Array | None, sizes: Array) -> float:
    """The largest change of a state in a step, and of what solutions miss between, relative to its component's size."""
    if kernels() and equations.checks is not None:
        found = np.empty(1)
        data = equations.compiled, equations.checks, np.ascontiguousarray(step), between, sizes
        kernels()["collocation_change"](*data, found)
        return float(found[0])
    moves = step[: equations.state_values].reshape(-1, equations.formulation.states)
    largest = np.max(np.abs(moves), axis=0)
    if between is not None:
        first, table = equations.structure.start[:, None], equations.table.defect
        inner = (table.values @ moves[first + np.arange(equations.table.degree + 1)]).reshape(between.shape) - between
        largest = np.maximum(largest, np.max(np.abs(inner), axis=0, initial=0.0))
    return float(np.max(largest / sizes))


def polynomials(equations: Discretisation, z: Array) -> tuple[Array, Array]:
    """The states at the starts of the intervals, (K, 1, states), and what the polynomials' other values differ by.

    These differences, (K, d, states), are small, and so is the rounding of what is made of them.
    """
    values = z[: equations.state_values].reshape(-1, equations.formulation.states)
    first = values[equations.structure.start][:, None]
    return first, values[equations.structure.start[:, None] + np.arange(1, equations.table.degree + 1)] - first


def _at_checks(equations: Discretisation, z: Array, numbers: Array) -> tuple[Array, ...]:
    """(s, x, scalars, constants) at the inner check points of all intervals, then at the ends of these."""
    n, table, count = equations.formulation.states, equations.table, equations.state_values
    lengths, constants = np.split(numbers, [equations.intervals])
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    inner = ends[:-1, None] + lengths[:, None] * table.defect.inner
    first, rises = polynomials(equations, z)
    within = (first + table.defect.values[:, 1:] @ rises).reshape(-1, n)
    states = np.concatenate([within, z[:count].reshape(-1, n)[:: table.ends.size]])
    return np.concatenate([inner.ravel(), ends])[:, None], states, z[count:], constants


def _by_intervals(equations: Discretisation, found: Array) -> Array:
    """Values there at the check points of each interval, shape (intervals, points, ...)."""
    table, K = equations.table.defect, equations.intervals
    between, ends = np.split(found, [K * table.inner.size])
    between = between.reshape(K, table.inner.size, *found.shape[1:])
    return np.concatenate([ends[:-1, None], between, ends[1:, None]], axis=1)[:, table.checked]
