"""Residual and Jacobian of collocation on K intervals, assembled by structure from one mapped function of the model.

No symbolic graph of a mesh: what depends on the number of intervals alone, as which entry of the Jacobian comes from
where, is worked out once, and serves all meshes and solutions of that number; lengths of intervals are arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.formulation import Formulation, Pattern
from casadi_skin.zero.problem import Array, Buffers, Indices

# Places of the entries of collocation equations, which depend on numbers and patterns alone, for all problems ---------

KEPT_TABLES, LARGE_NONZEROS = 64, 20_000  # tables that are kept, and non-zeros beyond which none are


@dataclass(frozen=True)
class Layout:
    """Numbers that determine the places: of states, intervals, increments and scalars; stages; patterns.

    `stages` are their places among the values of an interval. `conditions` and `integrals` are numbers of rows;
    `by_ends` are the patterns of the conditions' derivatives by the state at the start, the state at the end, and the
    scalars.
    """

    states: int
    intervals: int
    stages: tuple[int, ...]
    increments: int
    scalars: int
    conditions: int
    integrals: int
    field: Pattern
    by_ends: tuple[Pattern, ...]

    @classmethod
    def of(cls, formulation: Formulation, intervals: int, table: CollocationTable) -> Layout:
        """The layout of a formulation on so many intervals."""
        counts = formulation.states, intervals, table.stages, table.ends.size, int(formulation.scalars.numel())
        rows = int(formulation.conditions.numel()), formulation.integrals
        return cls(*counts, *rows, *formulation.patterns)

    @property
    def degree(self) -> int:
        """Number of stages of an interval."""
        return len(self.stages)

    @property
    def values(self) -> int:
        """Number of state values."""
        return self.states * (self.intervals * self.increments + 1)


@dataclass(frozen=True, eq=False)
class Structure:
    """Where entries of the Jacobian go.

    Attributes:
        rows, columns: places of the non-zeros, column by column.
        differences: the part of the non-zeros that is constant.
        stiff: the non-zero that takes each entry of the field's derivatives by the states at the stages.
        below_stiff: the constant part of these non-zeros.
        rest: the same for derivatives by the scalars, of the conditions and of the integrals.
        stage: columns of the state values that are stages, the last one twice: there are as many check points.
        start: columns of the starts of the intervals.
    """

    rows: Indices
    columns: Indices
    differences: Array
    stiff: Indices
    below_stiff: Array
    rest: Indices
    stage: Indices
    start: Indices
    _made: dict[str, Any] = field(default_factory=dict)

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """Objects that depend on this structure alone; their users do not change them."""
        if name not in self._made:
            self._made[name] = make()
        return self._made[name]


def structure_of(layout: Layout) -> Structure:
    """The places of all entries, which are not to be written to."""
    large = layout.intervals * layout.increments * layout.degree * len(layout.field[0]) > LARGE_NONZEROS
    return _structure(layout) if large else _kept_structure(layout)


@lru_cache(maxsize=KEPT_TABLES)
def _kept_structure(layout: Layout) -> Structure:
    return _structure(layout)


def _structure(layout: Layout) -> Structure:
    K, R = layout.intervals, layout.increments
    stage, start = (np.arange(K)[:, None] * R + np.array(layout.stages)).ravel(), np.arange(K) * R
    parts = _places(layout, stage, start)
    equations = layout.values - layout.states + layout.conditions + layout.integrals
    keys = [columns * equations + rows for rows, columns in parts]
    found, slots = np.unique(np.concatenate(keys), return_inverse=True)
    at_end, at_start, stiff, *rest = np.split(slots, np.cumsum([key.size for key in keys])[:-1])
    differences = np.zeros(found.size)
    differences[at_end], differences[at_start] = 1.0, -1.0
    rows, columns = found % equations, found // equations
    stages = np.append(stage, stage[-1])
    return Structure(rows, columns, differences, stiff, differences[stiff], np.concatenate(rest), stages, start)


def _places(layout: Layout, stage: Indices, start: Indices) -> list[tuple[Indices, Indices]]:
    """Rows and columns of the parts of the Jacobian: differences, field by states and scalars, then the rest."""
    n, K, d, R, m = layout.states, layout.intervals, layout.degree, layout.increments, layout.scalars
    bottom, component = layout.values - n, np.arange(n)
    increment = np.arange(bottom)
    ends = np.repeat(start, R), np.arange(1, K * R + 1)
    parts = [(increment, (column[:, None] * n + component).ravel()) for column in ends[::-1]]
    r, c = (np.array(t, dtype=np.int64) for t in layout.field)
    shape = (K, R, d, r.size)
    stiff = (np.arange(K * R).reshape(K, R, 1, 1) * n + r, stage.reshape(K, 1, d, 1) * n + c)
    parts.append(tuple(np.broadcast_to(places, shape).ravel() for places in stiff))  # type: ignore[arg-type]
    scalars = layout.values + np.arange(m)
    by_scalars = np.broadcast_arrays(increment.reshape(K, R, 1, n), scalars[:, None])
    parts.append((by_scalars[0].ravel(), by_scalars[1].ravel()))
    for pattern, offset in zip(layout.by_ends, (0, bottom, layout.values), strict=True):
        rows, columns = (np.array(t, dtype=np.int64) for t in pattern)
        parts.append((rows + bottom, columns + offset))
    if layout.integrals:
        first = bottom + layout.conditions + np.arange(layout.integrals)
        by_x = np.broadcast_arrays(first, (stage[:, None, None] * n + component[:, None]))
        by_s = np.broadcast_arrays(first, scalars[:, None])
        parts += [(by_x[0].ravel(), by_x[1].ravel()), (by_s[0].ravel(), by_s[1].ravel())]
    return parts


class Discretisation:
    """Collocation equations of a formulation on K intervals of any lengths that sum to 1.

    Attributes:
        table, layout: the method, and the numbers and patterns of the equations.
        structure: where entries of the Jacobian go.
        rows, columns: places of its non-zeros, column by column.
        shared: solvers that have been made for these equations, by name.
    """

    def __init__(self, formulation: Formulation, intervals: int, table: CollocationTable) -> None:
        self.shared: dict[Any, Any] = {}
        self._at, self._last = b"", (np.empty(0), np.empty(0))
        self._on = b""  # the mesh whose places and weights are kept
        self._n, self._K, self._d, self._R = formulation.states, intervals, table.degree, table.ends.size
        self._m, self.table = int(formulation.scalars.numel()), table
        self._states = self._n * (intervals * self._R + 1)
        places = intervals * self._d + 1  # the stages, or the check points
        self._field = Buffers(formulation.field_function.map(places), places)
        self._conditions = formulation.condition_buffers
        self._integrals = formulation.integrals
        if self._integrals:
            self._integrands = Buffers(formulation.integrand_function.map(places), places)
        self.layout = Layout.of(formulation, intervals, table)
        self.structure = structure_of(self.layout)
        self.rows, self.columns = self.structure.rows, self.structure.columns
        self._stage, self._start = self.structure.stage, self.structure.start

    def __call__(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        """Residual, and the non-zeros of the Jacobian in the order of `rows` and `columns`; not to be written to.

        `numbers` are the lengths of the intervals, then the constants of the formulation. The last results are kept: a
        solution is measured where it was solved.
        """
        at = z.tobytes() + numbers.tobytes()
        if at != self._at:
            found = self._assembled(z, numbers)
            for array in found:
                array.flags.writeable = False
            self._at, self._last = at, found
        return self._last

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
        arguments = self.stages(z, numbers)
        values, (_, _, scalars, constants), weights = z[: self._states].reshape(-1, n), arguments, self._weights
        field, by_states, by_scalars = self._at_stages(self._field, arguments)
        increments = weights @ field.reshape(K, d, n)
        ends = values[1:].reshape(K, R, n) - values[self._start][:, None, :]
        condition, *derivatives = self._conditions(values[0], values[-1], scalars, constants)
        residual = [(ends - increments).ravel(), condition]
        rest = [-(weights @ by_scalars.reshape(K, d, m * n)).ravel(), *derivatives]
        if self._integrals:
            own, quadrature = self._integrals, self._quadrature
            value, by_x, by_s = self._at_stages(self._integrands, arguments)
            residual.append(quadrature @ value.reshape(K * d, own))
            rest += [(quadrature[:, None] * by_x.reshape(K * d, -1)).ravel(), quadrature @ by_s.reshape(K * d, -1)]
        nonzeros = self.structure.differences.copy()
        stiff = self.structure.stiff
        nonzeros[stiff] = self.structure.below_stiff - (weights[..., None] * by_states.reshape(K, 1, d, -1)).ravel()
        nonzeros[self.structure.rest] = np.concatenate(rest)
        return np.concatenate(residual), nonzeros

    def _at_stages(self, function: Buffers, arguments: Sequence[Array]) -> list[Array]:
        """Results of a mapped function, one row a stage."""
        return [found.reshape(self._K * self._d + 1, -1)[:-1] for found in function(*arguments)]

    def jacobians(self, z: Array, numbers: Array) -> Array:
        """Derivatives of the field by the states at the stages, dense, shape (K d, n, n)."""
        found = np.zeros((self._K * self._d, self._n, self._n))
        rows, columns = (list(places) for places in self.layout.field)
        found[:, rows, columns] = self._at_stages(self._field, self.stages(z, numbers))[1]
        return found

    def along(self, *arguments: Array) -> tuple[Array, Array]:
        """Field and integrands at (s, x, scalars, constants), as many places as there are stages and one more."""
        field = self._field(*arguments)[0].reshape(-1, self._n).copy()
        if not self._integrals:
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
    of, table = equations.layout, equations.table.defect
    n, K, rows = of.states, of.intervals, of.increments
    lengths, constants = numbers[:K], numbers[K:]
    values, scalars = z[: of.values].reshape(-1, n), z[of.values :]
    column = np.arange(K)[:, None] * rows
    polynomials = values[column + np.arange(of.degree + 1)]
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    inner = ends[:-1, None] + lengths[:, None] * table.inner
    places = np.concatenate([inner.ravel(), ends])[:, None]
    states = np.concatenate([(table.values @ polynomials).reshape(-1, n), values[::rows]])
    count = K * table.inner.size

    def by_intervals(found: Array) -> Array:
        """Values at the check points of each interval, shape (intervals, points, values)."""
        between, ends = found[:count].reshape(K, table.inner.size, found.shape[1]), found[count:, None]
        return np.concatenate([ends[:-1], between, ends[1:]], axis=1)[:, table.checked]

    field, integrands = map(by_intervals, equations.along(places, states, scalars, constants))
    defects = lengths[:, None, None] * field - table.slopes @ polynomials
    residual = [-(table.increments @ defects).ravel(), np.zeros(of.conditions)]
    if of.integrals:
        at_stages = equations.along(*equations.stages(z, numbers))[1][:-1].reshape(K, of.degree, -1)
        whole = table.quadrature[0] @ at_stages + table.quadrature[1] @ integrands
        residual.append(lengths @ whole - lengths @ (equations.table.extended[-1] @ at_stages))
    return np.concatenate(residual), (table.between @ defects).reshape(-1, n)
