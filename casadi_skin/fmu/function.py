"""Jacobians of an FMU's right-hand side: by its directional derivatives where they are right, else by differences.

Columns that share no row are taken together, by the FMU's ModelStructure (Curtis, Powell and Reid 1974).
Derivatives of the FMU are compared with differences along random directions before they are used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from casadi_skin.fmu.description import Array, Element, Group, Pattern
from casadi_skin.fmu.fmu_component import MOST_NUMBERS, Points
from casadi_skin.fmu.instance import Bytes, FmuInstance
from casadi_skin.native import Indices

Place = tuple[Array, Array, Array]  # t, x, p, one place a row

# With steps h, 2h, 4h extrapolated: the error h^4 that the estimate sees and round-off eps/h are in balance there.
DIFFERENCE_STEP = float(np.finfo(float).eps ** 0.2)
STEP_FACTORS = np.array([1.0, -1.0, 2.0, -2.0, 4.0, -4.0])  # of the step, where the function is evaluated
# The derivative times h to order h^6; and the difference of two of order h^4, a fifteenth of which is the error where
# truncation is all, not with round-off.
EXTRAPOLATION_WEIGHTS = np.repeat(
    [[256.0 / 360.0, -40.0 / 360.0, 1.0 / 360.0], [16.0 / 24.0, -10.0 / 24.0, 1.0 / 24.0]], 2, 1
)
EXTRAPOLATION_WEIGHTS *= np.sign(STEP_FACTORS)
DERIVATIVE_AGREEMENT = 1e-5  # of the largest entry, between differences and the FMU's own derivatives
TRIED_DIRECTIONS = 2
TRIAL_DISTANCE = 0.1  # of a state's nominal value, where that is compared


@dataclass(frozen=True, eq=False)
class Columns:
    """A pattern of non-zeros, by columns, and the group of each column: columns of a group share no row in it."""

    pattern: Pattern
    group: Indices
    rows: Indices
    columns: Indices

    @classmethod
    def of(cls, pattern: Pattern) -> Columns:
        """The groups by CasADi's colouring."""
        colours = ca.sparsify(ca.DM(pattern.astype(float))).sparsity().uni_coloring()
        group, starts = np.zeros(pattern.shape[1], dtype=int), colours.colind()
        for k in range(colours.size2()):
            group[colours.row()[starts[k] : starts[k + 1]]] = k
        columns, rows = np.nonzero(pattern.T)
        return cls(pattern, group, rows, columns)

    @cached_property
    def seeds(self) -> Array:
        """1 in the columns of each group, shape (groups, columns)."""
        return np.eye(int(self.group.max(initial=0)) + 1)[:, self.group].copy()

    @cached_property
    def owners(self) -> Indices:
        """The group of each non-zero."""
        return self.group[self.columns]

    def dense(self, nonzeros: Array) -> Array:
        """The matrices with these entries, one a row."""
        matrix = np.zeros((len(nonzeros), *self.pattern.shape))
        matrix[:, self.rows, self.columns] = nonzeros
        return matrix


@dataclass(eq=False)
class Differences:
    """Derivatives by central differences with three steps, each with an estimate of its error.

    `largest_error` is the largest estimate so far, relative to the largest entry of its Jacobian, both in the sizes of
    values and components.
    """

    largest_error: float = 0.0

    def moved(self, at: Array, scale: Array, columns: Columns) -> tuple[Array, Array]:
        """Where a function is evaluated, (groups, 6, places, components), for derivatives at places, one a row.

        And the steps of the components, which change by `scale`.
        """
        # Steps are powers of 2 times the same number for all of a group, so that quotients are exact.
        steps = np.exp2(np.round(np.log2(DIFFERENCE_STEP * np.maximum(np.abs(at), scale))))
        return at + STEP_FACTORS[:, None, None] * (columns.seeds[:, None, None] * steps), steps

    def quotients(self, values: Array, steps: Array, columns: Columns, sizes: Array, across: Array) -> Array:
        """Non-zeros by columns, a row a place, from the values, (groups, 6, places, any).

        `sizes` are those of the values, `across` those of components.
        """
        sums = np.tensordot(EXTRAPOLATION_WEIGHTS, values, (1, 1)).swapaxes(1, 2)
        both = sums[:, :, columns.owners, columns.rows] / steps[:, columns.columns]
        scaled = np.abs(both) * (across[columns.columns] / sizes[columns.rows])
        largest, error = np.max(scaled, axis=2, initial=0.0)
        # Of derivatives that vanish at a place the error is that of rounded values, relative to these.
        largest = np.maximum(largest, np.max(np.abs(values) / sizes, axis=(0, 1, 3), initial=0.0))
        known = (largest > 0.0) & (largest < np.inf)
        self.largest_error = max(self.largest_error, float(np.max(error[known] / largest[known], initial=0.0)))
        return np.asarray(both[0])


@dataclass(eq=False)
class Derivatives:
    """Values of some of an FMU's numbers, `unknowns` (its derivatives where that is None), and their Jacobians.

    All are taken at places t, x, p, one a row, and have a row for each. `by_states` and `by_parameters` name how
    Jacobians are computed: "directional" or "differences". `difference` holds the error estimate of the latter.
    """

    instance: FmuInstance
    unknowns: tuple[Element, ...] | None
    offered: bool
    difference: Differences = field(default_factory=Differences)

    def __post_init__(self) -> None:
        variables, given = self.instance.variables, self.instance.given
        elements = variables.derivatives if self.unknowns is None else self.unknowns
        self.size = len(elements)
        self.scale = np.array([state.size for state in variables.states])
        self._seen = self.scale.copy()  # the largest sizes of states so far
        self._outputs = None if self.unknowns is None else np.array([element.size for element in self.unknowns])
        self._given_scale = np.where(self.instance.start_given != 0.0, np.abs(self.instance.start_given), 1.0)
        self._declared = variables.declared(elements)
        self.points = self.instance.points(None if self.unknowns is None else Group.of(elements))
        self._rates = Group.of(elements)
        self._everything = Columns.of(np.ones((self.size, len(given)), dtype=bool))
        self._along_time = Columns.of(np.ones((self.size, 1), dtype=bool))
        self._seeds: dict[tuple[Columns, bool], Points] = {}
        trials = self._trials()
        self._by_states, self.by_states = self._chosen(trials)
        self.by_parameters = self._chosen_for_parameters(trials) if given else "directional"

    @property
    def sizes(self) -> Array:
        """Those of the numbers: of derivatives those of their states."""
        return self._seen if self._outputs is None else self._outputs

    @property
    def pattern(self) -> Pattern:
        """Which entries of the Jacobian by the states may be non-zero."""
        return self._by_states.pattern

    @property
    def most_places(self) -> int:
        """How many of them are moved together for differences."""
        largest = max(len(self._by_states.seeds), len(self.instance.given)) * max(self.scale.size, self.size)
        return max(1, MOST_NUMBERS // (STEP_FACTORS.size * largest))

    def values(self, t: Array, x: Array, p: Array) -> Array:
        """The numbers, for places in arrays of any shape that go together."""
        shape = np.broadcast_shapes(t.shape, x.shape[:-1], p.shape[:-1])
        count = math.prod(shape)
        rows = (np.broadcast_to(a, (*shape, a.shape[-1])).reshape(count, a.shape[-1]) for a in (x, p))
        return self.instance.numbers(self.points, np.broadcast_to(t, shape).ravel(), *rows).reshape(*shape, self.size)

    def states_jacobian(self, t: Array, x: Array, p: Array, tried: tuple[Columns, str] | None = None) -> Array:
        """Non-zeros by columns of d value/d x; in another way where that is tried."""
        columns, how = tried or (self._by_states, self.by_states)
        if how == "directional":
            return self.instance.numbers(self._along_columns(columns, False), t, x, p)
        self._seen = np.maximum(self._seen, np.max(np.abs(x), axis=0, initial=0.0))
        return self._differences(1, self.scale, self._seen, columns, [t[:, None], x, p])

    def parameters_jacobian(self, t: Array, x: Array, p: Array, tried: str = "") -> Array:
        """Entries by columns of d value/d p; in another way where that is tried."""
        if (tried or self.by_parameters) == "directional":
            along = self._along_columns(self._by_states, True)
            return self.instance.numbers(along, t, x, p)[:, along.ends[0] :]
        return self._differences(2, self._given_scale, self._given_scale, self._everything, [t[:, None], x, p])

    def time_derivative(self, t: Array, x: Array, p: Array) -> Array:
        """d value/d t by differences."""
        return self._differences(0, np.ones(1), np.ones(1), self._along_time, [t[:, None], x, p])

    def _differences(self, which: int, scale: Array, across: Array, columns: Columns, given: list[Array]) -> Array:
        """Derivatives by one of the given times, states and parameters, which change by `scale` and are so large."""
        given[which], steps = self.difference.moved(given[which], scale, columns)
        t, x, p = given
        return self.difference.quotients(self.values(t[..., 0], x, p), steps, columns, self.sizes, across)

    def _along_columns(self, columns: Columns, by_given: bool) -> Points:
        """Points for the FMU's derivatives along these columns, and along parameters and inputs where wanted."""
        if (columns, by_given) not in self._seeds:
            given, states = self.instance.given if by_given else (), self.instance.variables.states
            groups, places, row = len(columns.seeds), self._rates.places, self._rates.starts.size
            by_states = places[columns.rows] + row * columns.owners
            by_parameters = (places + row * np.arange(groups, groups + len(given))[:, None]).ravel()
            seeds, known = block_diag(columns.seeds, np.eye(len(given))), Group.of((*states, *given))
            found = self.instance.points(self._rates, known, seeds, (by_states, by_parameters)[: 1 + by_given])
            self._seeds[columns, by_given] = found
        return self._seeds[columns, by_given]

    def at_once(self, by_given: bool) -> Points | None:
        """Points for those of the Jacobians that are the FMU's own; None where none is."""
        if self.by_states == "differences":
            return None
        by_given = by_given and self.by_parameters == "directional" and bool(self.instance.given)
        return self._along_columns(self._by_states, by_given)

    # Checks -----------------------------------------------------------------------------------------------------------

    def _trials(self) -> Place:
        """Places where the FMU's derivatives are compared: beside its start, where it can be evaluated."""
        start, distances = self.instance.start, np.array([TRIAL_DISTANCE, TRIAL_DISTANCE, 0.0])[:, None]
        x = start + distances * self.scale * np.random.default_rng(0).uniform(0.5, 1.0, (3, start.size))
        t, p = np.zeros(3), np.tile(self.instance.start_given, (3, 1))
        known = np.all(np.isfinite(self.values(t, x, p)), axis=1)
        return t[known], x[known], p[known]

    def _chosen(self, trials: Place) -> tuple[Columns, str]:
        directions = np.random.default_rng(1).uniform(0.5, 1.0, (TRIED_DIRECTIONS, self.scale.size)) * self.scale
        known = self._along(trials, directions)
        for how in ("directional", "differences") if self.offered else ("differences",):
            for pattern in (self._declared, np.ones_like(self._declared)):
                columns = Columns.of(pattern)
                given = columns.dense(self.states_jacobian(*trials, (columns, how))) @ directions.T
                if _agree(given, known, self.sizes[:, None]):
                    self.difference.largest_error = 0.0
                    return columns, how
        return columns, "differences"  # all entries

    def _along(self, at: Place, directions: Array) -> Array:
        """Derivatives along directions by differences, (places, any, directions): an entry left out shows."""
        t, x, p = (np.repeat(each, len(directions), axis=0) for each in at)
        distances, steps = Differences().moved(np.zeros((len(t), 1)), np.ones(1), self._along_time)
        values = self.values(t, x + distances * np.tile(directions, (len(at[0]), 1)), p)
        found = Differences().quotients(values, steps, self._along_time, self.sizes, np.ones(1))
        return found.reshape(len(at[0]), len(directions), self.size).swapaxes(1, 2)

    def _chosen_for_parameters(self, trials: Place) -> str:
        if not (self.by_states == "directional" and all(element.tunable for element in self.instance.given)):
            return "differences"
        known, given = (self.parameters_jacobian(*trials, how) for how in ("differences", "directional"))
        sizes = self.sizes[self._everything.rows] / self._given_scale[self._everything.columns]
        if not _agree(given, known, sizes):
            return "differences"
        self.difference.largest_error = 0.0
        return "directional"


def _agree(given: Array, known: Array, sizes: Array) -> bool:
    """Whether derivatives agree at all places, in sizes of each."""
    across = tuple(range(1, known.ndim))
    largest = np.max(np.abs(known) / sizes, axis=across, initial=0.0, keepdims=True)
    return bool(np.all(np.abs(given - known) / sizes <= DERIVATIVE_AGREEMENT * largest))


# An FMU's right-hand side or outputs as a function of CasADi with its Jacobian ----------------------------------------


class FmuFunction(ca.Callback):  # type: ignore[misc]
    """(t, x, p) -> derivatives or outputs of an FMU; their Jacobian is another, (t, x, p, result) -> by t, x and p."""

    def __init__(self, name: str, derivatives: Derivatives, forced: bool, of_jacobian: bool = False) -> None:
        ca.Callback.__init__(self)
        self.derivatives, rows, dense = derivatives, derivatives.size, ca.Sparsity.dense
        sizes = (1, len(derivatives.instance.variables.states), len(derivatives.instance.given))
        self._zeros = [np.zeros(size) for size in sizes]
        self._given = [dense(size, 1) for size in (*sizes, *([rows] if of_jacobian else []))]
        jacobian = None if of_jacobian else FmuFunction(f"{name}_jacobian", derivatives, forced, True)
        self.jacobian_function: Any = jacobian
        self._results: tuple[ca.Sparsity, ...] = (dense(rows, 1),)
        self._values: tuple[Callable[[Array, Array, Array], Array], ...] = (derivatives.values,)
        # Points for results from number `first` on, by whether those by parameters are among them.
        self._at_once: list[Points | None]
        self._first, self._at_once = 0, [derivatives.points for _ in range(2)]
        if of_jacobian:
            by_time = dense(rows, 1) if forced else ca.Sparsity(rows, 1)
            by_states = ca.sparsify(ca.DM(derivatives.pattern.astype(float))).sparsity()
            self._results = by_time, by_states, dense(rows, sizes[2])
            self._values = derivatives.time_derivative, derivatives.states_jacobian, derivatives.parameters_jacobian
            self._first, self._at_once = 1, [derivatives.at_once(by_given) for by_given in (False, True)]
        # Second derivatives are differences: only iterations use them, as the Newton matrix of CVODES' sensitivities.
        self.construct(name, {"enable_fd": of_jacobian})

    def get_n_in(self) -> int:
        return len(self._given)

    def get_n_out(self) -> int:
        return len(self._results)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._given[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._results[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[Bytes], results: Sequence[Bytes]) -> int:
        points, last = self._at_once[bool(results[-1])], self._first
        if points is not None:
            last += len(points.parts)
            self.derivatives.instance.answer(points, arguments, results[self._first : last])
        for k, result in enumerate(results):
            if result and not self._first <= k < last:
                given = zip(arguments, self._zeros, strict=False)
                t, x, p = (np.frombuffer(a) if a else zeros for a, zeros in given)
                np.frombuffer(result)[:] = self._values[k](t, x[None], p[None])[0]
        return 0

    def at_places(self, given: Sequence[Array], wanted: Sequence[bool]) -> list[Array]:
        """The non-zeros of the results at places, one a row; zeros where they are not wanted."""
        count, most = len(given[0]), self.derivatives.most_places
        found = [np.zeros((count, result.nnz())) for result in self._results]
        for first in range(0, count, most):
            rows = slice(first, first + most)
            t, x, p = (array[rows] for array in given[:3])
            for k, values in self._wanted(t[:, 0], x, p, wanted).items():
                found[k][rows] = values
        return found

    def _wanted(self, t: Array, x: Array, p: Array, wanted: Sequence[bool]) -> dict[int, Array]:
        points, first, found = self._at_once[wanted[-1]], self._first, dict[int, Array]()
        if points is not None and any(wanted[first : first + len(points.parts)]):
            numbers = self.derivatives.instance.numbers(points, t, x, p)
            found = dict(enumerate(np.split(numbers, points.ends[:-1], axis=1), start=first))
        return found | {k: self._values[k](t, x, p) for k, w in enumerate(wanted) if w and k not in found}

    def has_jacobian(self) -> bool:
        return self.jacobian_function is not None

    def has_jac_sparsity(self, oind: int, iind: int) -> bool:
        return self.jacobian_function is not None

    def get_jac_sparsity(self, oind: int, iind: int, symmetric: bool) -> ca.Sparsity:
        return self.jacobian_function.sparsity_out(iind)

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        return self.jacobian_function
