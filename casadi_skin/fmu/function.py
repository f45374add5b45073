"""Jacobians of an FMU's right-hand side: by its directional derivatives where they are right, else by differences.

Columns that share no row are taken together, by the FMU's ModelStructure (Curtis, Powell and Reid 1974).
Derivatives of the FMU are compared with differences along random directions before they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from casadi_skin.fmu.description import Array, Element, Group, Pattern
from casadi_skin.fmu.fmu_component import Points
from casadi_skin.fmu.instance import Bytes, FmuInstance

Indices = NDArray[np.int64]
Point = tuple[float, Array, Array]

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
        """The matrix with these entries."""
        matrix = np.zeros(self.pattern.shape)
        matrix[self.rows, self.columns] = nonzeros
        return matrix


@dataclass(eq=False)
class Differences:
    """Derivatives by central differences with three steps, each with an estimate of its error.

    `largest_error` is the largest estimate so far, relative to the largest entry of its Jacobian, both in the sizes of
    values and components.
    """

    largest_error: float = 0.0

    def moved(self, at: Array, scale: Array, columns: Columns) -> tuple[Array, Array]:
        """Where a function is evaluated, one row a point; and the step of each component, which changes by `scale`."""
        # Steps are powers of 2 times the same number for all of a group, so that quotients are exact.
        steps = np.exp2(np.round(np.log2(DIFFERENCE_STEP * np.maximum(np.abs(at), scale))))
        along = columns.seeds * steps
        return (at + STEP_FACTORS[:, None] * along[:, None, :]).reshape(-1, at.size), steps

    def quotients(self, values: Array, steps: Array, columns: Columns, sizes: Array, across: Array) -> Array:
        """Non-zeros by columns from the values there; `sizes` are those of the values, `across` those of components."""
        sums = EXTRAPOLATION_WEIGHTS @ values.reshape(len(columns.seeds), STEP_FACTORS.size, -1)
        both = sums[columns.owners, :, columns.rows] / steps[columns.columns, None]
        units = across[columns.columns] / sizes[columns.rows]
        largest, error = np.max(np.abs(both) * units[:, None], axis=0, initial=0.0).tolist()
        # Of derivatives that vanish at a place the error is that of rounded values, relative to these.
        largest = max(largest, float(np.max(np.abs(values) / sizes, initial=0.0)))
        if 0.0 < largest < np.inf:
            self.largest_error = max(self.largest_error, error / largest)
        return np.asarray(both[:, 0])


@dataclass(eq=False)
class Derivatives:
    """Values of some of an FMU's numbers, `unknowns` (its derivatives where that is None), and their Jacobians.

    `by_states` and `by_parameters` name how Jacobians are computed: "directional" or "differences". `difference` holds
    the error estimate of the latter.
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
        self._wanted = None if self.unknowns is None else Group.of(elements)
        self._rates = Group.of(elements)
        self._everything = Columns.of(np.ones((self.size, len(given)), dtype=bool))
        self._along_time = Columns.of(np.ones((self.size, 1), dtype=bool))
        self._seeds: dict[tuple[Columns, bool], Points] = {}
        self._shifted: tuple[bytes | None, Array, Array] = (None, np.empty(0), np.empty(0))
        self._by_states, self.by_states = self._chosen()
        self.by_parameters = self._chosen_for_parameters() if given else "directional"

    @property
    def sizes(self) -> Array:
        """Those of the numbers: of derivatives those of their states."""
        return self._seen if self._outputs is None else self._outputs

    @property
    def pattern(self) -> Pattern:
        """Which entries of the Jacobian by the states may be non-zero."""
        return self._by_states.pattern

    def _at(self, t: Sequence[float], x: Array, p: Array) -> Array:
        """The numbers at several times and states, or at one state, with the same parameters."""
        return self.instance.at(self._wanted, t, x, np.repeat(p[None], len(t), axis=0))

    def states_jacobian(self, t: float, x: Array, p: Array) -> Array:
        """Non-zeros by columns of d value/d x."""
        return self._states_jacobian(self.by_states, self._by_states, t, x, p)

    def parameters_jacobian(self, t: float, x: Array, p: Array) -> Array:
        """Entries by columns of d value/d p."""
        return self._parameters_jacobian(self.by_parameters, t, x, p)

    def time_derivative(self, t: float, x: Array, p: Array) -> Array:
        """d value/d t by differences."""
        times, steps = self.difference.moved(np.array([t]), np.ones(1), self._along_time)
        values = self._at(times[:, 0].tolist(), x[None], p)
        return self.difference.quotients(values, steps, self._along_time, self.sizes, np.ones(1))

    def _states_jacobian(self, how: str, columns: Columns, t: float, x: Array, p: Array) -> Array:
        if how == "differences":
            points, steps = self.difference.moved(x, self.scale, columns)
            values, self._seen = self._at((t,) * len(points), points, p), np.maximum(self._seen, np.abs(x))
            return self.difference.quotients(values, steps, columns, self.sizes, self._seen)
        return self._directional(columns, False, t, x, p)[0]

    def _parameters_jacobian(self, how: str, t: float, x: Array, p: Array) -> Array:
        if how == "differences":
            key = p.tobytes()
            if self._shifted[0] != key:  # the same at all nodes
                self._shifted = key, *self.difference.moved(p, self._given_scale, self._everything)
            _, points, steps = self._shifted
            values = self.instance.at(self._wanted, (t,) * len(points), x[None], points)
            return self.difference.quotients(values, steps, self._everything, self.sizes, self._given_scale)
        return self._directional(self._by_states, True, t, x, p)[1]

    def _directional(self, columns: Columns, by_given: bool, t: float, x: Array, p: Array) -> list[Array]:
        """Non-zeros by columns of d value/d x, and entries of d value/d p where they are wanted too."""
        at = self._along_columns(columns, by_given)
        found = [bytearray(part.nbytes) for part in at.parts]
        self.instance.answer(at, [bytearray(np.array(given).tobytes()) for given in (t, x, p)], found)
        return [np.frombuffer(part) for part in found]

    def _along_columns(self, columns: Columns, by_given: bool) -> Points:
        """A point for the FMU's derivatives along these columns, and along parameters and inputs, in one call."""
        if (columns, by_given) not in self._seeds:
            given, states = self.instance.given if by_given else (), self.instance.variables.states
            groups, places, row = len(columns.seeds), self._rates.places, self._rates.starts.size
            by_states = places[columns.rows] + row * columns.owners
            by_parameters = (places + row * np.arange(groups, groups + len(given))[:, None]).ravel()
            seeds, known = block_diag(columns.seeds, np.eye(len(given))), Group.of((*states, *given))
            found = self.instance.points(1, self._rates, known, seeds, (by_states, by_parameters)[: 1 + by_given])
            self._seeds[columns, by_given] = found
        return self._seeds[columns, by_given]

    def at_once(self, of_jacobian: bool) -> Points | None:
        """A point for the numbers, or for those of their Jacobians that are the FMU's own; None where none is."""
        if not of_jacobian:
            places = np.arange(self.size) if self._wanted is None else self._wanted.places
            return self.instance.points(1, self._wanted, parts=(places,))
        if self.by_states == "differences":
            return None
        return self._along_columns(self._by_states, self.by_parameters == "directional" and bool(self.instance.given))

    # Checks -----------------------------------------------------------------------------------------------------------

    def _trials(self) -> Iterator[Point]:
        """Points where the FMU's derivatives are compared: beside its start, where it can be evaluated."""
        generator, start = np.random.default_rng(0), self.instance.start
        p = self.instance.start_given
        for size in (TRIAL_DISTANCE, TRIAL_DISTANCE, 0.0):
            x = start + size * self.scale * generator.uniform(0.5, 1.0, start.size)
            if np.all(np.isfinite(self._at((0.0,), x[None], p))):
                yield 0.0, x, p

    def _chosen(self) -> tuple[Columns, str]:
        directions = np.random.default_rng(1).uniform(0.5, 1.0, (TRIED_DIRECTIONS, self.scale.size)) * self.scale
        trials = [(at, self._along(at, directions)) for at in self._trials()]
        for how in ("directional", "differences") if self.offered else ("differences",):
            for pattern in (self._declared, np.ones_like(self._declared)):
                columns = Columns.of(pattern)
                found = [
                    (columns.dense(self._states_jacobian(how, columns, *at)) @ directions.T, known)
                    for at, known in trials
                ]
                if all(_agree(given, known, self.sizes[:, None]) for given, known in found):
                    self.difference.largest_error = 0.0
                    return columns, how
        return columns, "differences"  # all entries

    def _along(self, at: Point, directions: Array) -> Array:
        """Derivatives along directions by differences, one column each: an entry left out anywhere shows in its row."""
        (t, x, p), differences = at, Differences()
        distances, steps = differences.moved(np.zeros(1), np.ones(1), self._along_time)
        found = (self._at((t,) * len(distances), x + distances * d, p) for d in directions)
        units = self.sizes, np.ones(1)
        return np.array([differences.quotients(values, steps, self._along_time, *units) for values in found]).T

    def _chosen_for_parameters(self) -> str:
        if not (self.by_states == "directional" and all(element.tunable for element in self.instance.given)):
            return "differences"
        for at in self._trials():
            known = self._parameters_jacobian("differences", *at)
            sizes = self.sizes[self._everything.rows] / self._given_scale[self._everything.columns]
            if not _agree(self._parameters_jacobian("directional", *at), known, sizes):
                return "differences"
        self.difference.largest_error = 0.0
        return "directional"


def _agree(given: Array, known: Array, sizes: Array) -> bool:
    """Whether derivatives agree, in sizes of each."""
    return bool(
        np.all(np.abs(given - known) / sizes <= DERIVATIVE_AGREEMENT * np.max(np.abs(known) / sizes, initial=0))
    )


# An FMU's right-hand side or outputs as a function of CasADi with its Jacobian ----------------------------------------


class FmuFunction(ca.Callback):  # type: ignore[misc]
    """(t, x, p) -> derivatives or outputs of an FMU; their Jacobian is another, (t, x, p, result) -> by t, x and p."""

    def __init__(self, name: str, derivatives: Derivatives, forced: bool, of_jacobian: bool = False) -> None:
        ca.Callback.__init__(self)
        self.derivatives, rows, dense = derivatives, derivatives.size, ca.Sparsity.dense
        sizes = (1, len(derivatives.instance.variables.states), len(derivatives.instance.given))
        self._zeros = [np.zeros(size) for size in sizes]
        self._given = [dense(size, 1) for size in (*sizes, *([rows] if of_jacobian else []))]
        self._jacobian: Any = None if of_jacobian else FmuFunction(f"{name}_jacobian", derivatives, forced, True)
        self._results: tuple[ca.Sparsity, ...]
        values: tuple[Callable[[float, Array, Array], Array], ...] = ()
        if of_jacobian:
            by_time = dense(rows, 1) if forced else ca.Sparsity(rows, 1)
            by_states = ca.sparsify(ca.DM(derivatives.pattern.astype(float))).sparsity()
            self._results = by_time, by_states, dense(rows, sizes[2])
            values = derivatives.time_derivative, derivatives.states_jacobian, derivatives.parameters_jacobian
        else:
            self._results = (dense(rows, 1),)
        self._one = derivatives.at_once(of_jacobian)
        first, count = int(of_jacobian), 0 if self._one is None else len(self._one.parts)
        self._own = slice(first, first + count)  # results of the one call
        others = [k for k in range(len(values)) if not first <= k < first + count and self._results[k].nnz()]
        self._left = [(k, values[k]) for k in others]
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
        if self._one is not None:
            self.derivatives.instance.answer(self._one, arguments, results[self._own])
        if self._left:
            t, x, p = (np.frombuffer(a) if a else zeros for a, zeros in zip(arguments, self._zeros, strict=False))
            for k, value in self._left:
                result = results[k]
                if result:
                    np.frombuffer(result)[:] = value(float(t[0]), x, p)
        return 0

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def has_jac_sparsity(self, oind: int, iind: int) -> bool:
        return self._jacobian is not None

    def get_jac_sparsity(self, oind: int, iind: int, symmetric: bool) -> ca.Sparsity:
        return self._jacobian.sparsity_out(iind)

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        return self._jacobian
