"""Jacobians of an FMU's right-hand side: by its directional derivatives where they are right, else by differences.

Columns that share no row are taken together, as the FMU's ModelStructure tells them (Curtis, Powell and Reid 1974).
What the FMU declares and offers is compared with differences along random directions before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.models.fmu_instance import Array, FmuInstance

Pattern = NDArray[np.bool_]
Value = Callable[[float, Array, Array], Array]

# With steps h, 2h, 4h extrapolated: the error h^4 that the estimate sees and round-off eps/h are in balance there.
STEP = float(np.finfo(float).eps ** 0.2)
AGREEMENT = 1e-5  # of the largest entry, between differences and what the FMU offers
DIRECTIONS = 2
TRIAL = 0.1  # of a state's nominal value, where that is compared


@dataclass(frozen=True, eq=False)
class Columns:
    """A pattern of non-zeros and groups of columns that share no row in it."""

    pattern: Pattern
    groups: tuple[NDArray[np.int64], ...]

    @classmethod
    def of(cls, pattern: Pattern) -> Columns:
        """The groups by CasADi's colouring."""
        sparsity = ca.sparsify(ca.DM(pattern.astype(float))).sparsity()
        colours = sparsity.uni_coloring()
        groups = (
            np.array(colours.row()[colours.colind()[k] : colours.colind()[k + 1]]) for k in range(colours.size2())
        )
        return cls(pattern, tuple(groups))

    def spread(self, group: NDArray[np.int64], values: Array, into: Array) -> None:
        """Put the sum of a group's columns to the columns that its rows belong to."""
        rows = self.pattern[:, group]
        into[:, group] = np.where(rows, values[:, None], 0.0)


@dataclass(eq=False)
class Differences:
    """Derivatives by central differences with three steps, each with an estimate of its error.

    `largest_error` is the largest estimate so far, relative to the largest entry of its Jacobian.
    """

    largest_error: float = 0.0

    def columns(self, value: Callable[[Array], Array], at: Array, scale: Array, columns: Columns) -> Array:
        """Jacobian of `value` at a point whose components change by `scale`."""
        rows = columns.pattern.shape[0]
        result, error = np.zeros((rows, at.size)), np.zeros((rows, at.size))
        for group in columns.groups:
            # Steps are powers of 2 times the same number for all of a group, so that quotients are exact.
            steps = np.exp2(np.round(np.log2(STEP * np.maximum(np.abs(at[group]), scale[group]))))
            quotients = []
            for factor in (1.0, 2.0, 4.0):
                ahead, behind = at.copy(), at.copy()
                ahead[group] += factor * steps
                behind[group] -= factor * steps
                difference = value(ahead) - value(behind)
                spread = np.zeros((rows, at.size))
                columns.spread(group, difference, spread)
                quotients.append(spread[:, group] / (2.0 * factor * steps))
            first, second = ((4.0 * a - b) / 3.0 for a, b in pairwise(quotients))
            result[:, group] = (16.0 * first - second) / 15.0
            error[:, group] = np.abs(first - second)  # a fifteenth of it where truncation is all, not with round-off
        largest = float(np.abs(result).max(initial=0.0))
        if largest > 0.0 and np.isfinite(largest):
            self.largest_error = max(self.largest_error, float(error.max()) / largest)
        return result


@dataclass(eq=False)
class Derivatives:
    """Jacobians of a group of an FMU's variables, `references`, whose values `value` gives, at (t, x, p).

    `by_states` and `by_parameters` tell how each is computed: "directional" or "differences". `difference` holds
    the error estimate of the latter.
    """

    instance: FmuInstance
    references: tuple[int, ...]
    states: tuple[int, ...]
    scale: Array
    value: Value
    declared: Pattern
    offered: bool
    difference: Differences = field(default_factory=Differences)

    def __post_init__(self) -> None:
        count, parameters = len(self.references), len(self.instance.parameters)
        self._everything = Columns.of(np.ones((count, max(1, parameters)), dtype=bool))
        self._by_states, self.by_states = self._chosen()
        self.by_parameters = self._chosen_for_parameters() if parameters else "directional"

    @property
    def pattern(self) -> Pattern:
        """Which entries of the Jacobian by the states may be non-zero."""
        return self._by_states.pattern

    def states_jacobian(self, t: float, x: Array, p: Array) -> Array:
        """Dense d value/d x, shape (variables, states)."""
        return self._states_jacobian(self.by_states, self._by_states, t, x, p)

    def parameters_jacobian(self, t: float, x: Array, p: Array) -> Array:
        """Dense d value/d p, shape (variables, parameters)."""
        return self._parameters_jacobian(self.by_parameters, t, x, p)

    def time_derivative(self, t: float, x: Array, p: Array) -> Array:
        """d value/d t by differences, shape (variables, 1)."""
        columns = Columns.of(np.ones((len(self.references), 1), dtype=bool))
        at = np.array([t])
        return self.difference.columns(lambda time: self.value(float(time[0]), x, p), at, np.ones(1), columns)

    def _states_jacobian(self, how: str, columns: Columns, t: float, x: Array, p: Array) -> Array:
        if how == "differences":
            return self.difference.columns(lambda point: self.value(t, point, p), x, self.scale, columns)
        seeds = np.zeros((x.size, len(columns.groups)))
        for k, group in enumerate(columns.groups):
            seeds[group, k] = 1.0
        sums = self.instance.directional(self.references, self.states, seeds, t, x, p)
        result = np.zeros(columns.pattern.shape)
        for k, group in enumerate(columns.groups):
            columns.spread(group, sums[:, k], result)
        return result

    def _parameters_jacobian(self, how: str, t: float, x: Array, p: Array) -> Array:
        if how == "differences":
            start = np.abs(self.instance.start_parameters)
            scale = np.where(start > 0.0, start, 1.0)
            return self.difference.columns(lambda given: self.value(t, x, given), p, scale, self._everything)
        references = [v.valueReference for v in self.instance.parameters]
        seeds = np.vstack([np.zeros((x.size, p.size)), np.eye(p.size)])
        return self.instance.directional(self.references, (*self.states, *references), seeds, t, x, p)

    # What is right ----------------------------------------------------------------------------------------------------

    def _trials(self) -> Iterator[tuple[float, Array, Array]]:
        """Points where what the FMU offers is compared: beside its start, where it can be evaluated."""
        generator, start = np.random.default_rng(0), self.instance.start
        p = self.instance.start_parameters
        for size in (TRIAL, TRIAL, 0.0):
            x = start + size * self.scale * generator.uniform(0.5, 1.0, start.size)
            if np.all(np.isfinite(self.value(0.0, x, p))):
                yield 0.0, x, p

    def _chosen(self) -> tuple[Columns, str]:
        directions = np.random.default_rng(1).uniform(0.5, 1.0, (DIRECTIONS, self.scale.size)) * self.scale
        trials = [(at, self._along(at, directions)) for at in self._trials()]
        for how in ("directional", "differences") if self.offered else ("differences",):
            for pattern in (self.declared, np.ones_like(self.declared)):
                columns = Columns.of(pattern)
                found = [(self._states_jacobian(how, columns, *at) @ directions.T, known) for at, known in trials]
                if all(_agree(given, known) for given, known in found):
                    self.difference.largest_error = 0.0
                    return columns, how
        return columns, "differences"  # all entries

    def _along(self, at: tuple[float, Array, Array], directions: Array) -> Array:
        """Derivatives along directions by differences, one column each: an entry left out anywhere shows in its row."""
        t, x, p = at
        column = Columns.of(np.ones((len(self.references), 1), dtype=bool))

        def along(direction: Array) -> Array:
            def moved(distance: Array) -> Array:
                return self.value(t, x + distance[0] * direction, p)

            return Differences().columns(moved, np.zeros(1), np.ones(1), column)

        return np.hstack([along(direction) for direction in directions])

    def _chosen_for_parameters(self) -> str:
        tunable = all(v.causality == "input" or v.variability == "tunable" for v in self.instance.parameters)
        if not (self.by_states == "directional" and tunable):
            return "differences"
        for at in self._trials():
            known = self._parameters_jacobian("differences", *at)
            if not _agree(self._parameters_jacobian("directional", *at), known):
                return "differences"
        self.difference.largest_error = 0.0
        return "directional"


def _agree(given: Array, known: Array) -> bool:
    return bool(np.all(np.abs(given - known) <= AGREEMENT * np.abs(known).max(initial=0.0)))
