"""Places of the entries of collocation equations, which depend on numbers and patterns alone, for all problems.

Index tables of small systems are kept for the next problem that has the same: many have one second-order equation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.formulation import Formulation, Pattern
from casadi_skin.zero.problem import Array, Indices

KEPT, LARGE = 64, 20_000  # tables that are kept, and non-zeros beyond which none are


@dataclass(frozen=True)
class Layout:
    """Numbers that determine the places: of states, intervals, stages, increments and scalars; patterns.

    `conditions` and `integrals` are numbers of rows; `by_ends` are the patterns of the conditions' derivatives by the
    state at the start, the state at the end, and the scalars.
    """

    states: int
    intervals: int
    degree: int
    increments: int
    scalars: int
    conditions: int
    integrals: int
    field: Pattern
    by_ends: tuple[Pattern, ...]

    @classmethod
    def of(cls, formulation: Formulation, intervals: int, table: CollocationTable) -> Layout:
        """The layout of a formulation on so many intervals."""
        counts = formulation.states, intervals, table.degree, table.ends.size, int(formulation.scalars.numel())
        rows = int(formulation.conditions.numel()), formulation.integrals
        return cls(*counts, *rows, *formulation.patterns)

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
    large = layout.intervals * layout.increments * layout.degree * len(layout.field[0]) > LARGE
    return _structure(layout) if large else _kept_structure(layout)


@lru_cache(maxsize=KEPT)
def _kept_structure(layout: Layout) -> Structure:
    return _structure(layout)


def _structure(layout: Layout) -> Structure:
    K, d, R = layout.intervals, layout.degree, layout.increments
    stage, start = (np.arange(K)[:, None] * R + 1 + np.arange(d)).ravel(), np.arange(K) * R
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
