"""Labels of cells in a map that is refined: cells of one label show the same behaviour."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from casadi_skin.runs.map_grid import Cells, Grid
from casadi_skin.runs.map_records import Row, TaskRecord
from casadi_skin.runs.map_refine import UNKNOWN

DEFAULT = ("stable", "end")
Watched = Sequence[str] | Mapping[str, Sequence[float]] | None


class Watch:
    """Labels of cells, shape of the finest grid; none are kept of a map that is not refined."""

    def __init__(self, grid: Grid, watched: Watched = None) -> None:
        names = DEFAULT if watched is None else watched
        self._levels: Mapping[str, Sequence[float]] = names if isinstance(names, Mapping) else dict.fromkeys(names, ())
        self._codes: dict[tuple[object, ...], int] = {}
        self.labels = np.full(grid.shape, UNKNOWN, dtype=np.int32) if grid.refined else np.zeros(0, dtype=np.int32)

    def see(self, record: TaskRecord) -> None:
        """Label the cells of a record."""
        if self.labels.size:
            rows: Sequence[Row | None] = record.rows or (None,) * len(record.cells)
            for cell, row in zip(record.cells, rows, strict=True):
                self.labels.flat[cell] = self._codes.setdefault(self._label(row), len(self._codes))

    def forget(self, cells: Cells) -> None:
        """Take labels back."""
        if self.labels.size:
            self.labels.flat[cells] = UNKNOWN

    def _label(self, row: Row | None) -> tuple[object, ...]:
        if row is None:
            return ()
        return (bool(row.fault), *(self._of(row.values.get(name), at) for name, at in self._levels.items()))

    def _of(self, value: object, levels: Sequence[float]) -> object:
        """A word or a whole number itself, a number by the levels that it is above; whether it is there."""
        if isinstance(value, float):
            return -1 if math.isnan(value) else sum(value > level for level in levels)
        return sum(value > level for level in levels) if levels and isinstance(value, int) else value
