"""Labels of cells in a map that is refined: cells of one label show the same behaviour."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.map_grid import Cells, Grid, Row, TaskRecord

# The cells that a map needs next: those of the coarsest grid, then those where the watched quantities change ----------

UNKNOWN = -1  # of the label of a cell that is not computed
Labels = NDArray[np.int32]  # shape of the finest grid, equal where the watched quantities are equal
Places = NDArray[np.int64]  # shape (boxes, axes)


def needed(grid: Grid, labels: Labels) -> Cells:
    """Cells to compute next, ascending; none where the map is as fine as it is to be."""
    coarse = grid.coarsest
    missing = coarse[labels.ravel()[coarse] == UNKNOWN]
    if missing.size or not grid.refined:
        return np.asarray(missing)
    wanted, along = np.zeros(grid.shape, dtype=bool), [axis.stride > 1 for axis in grid.axes]
    sides = [axis.stride for axis in grid.axes]
    corners = [np.arange(0, n - 1, s) if s > 1 else np.arange(n) for n, s in zip(grid.shape, sides, strict=True)]
    boxes = np.stack(np.meshgrid(*corners, indexing="ij"), -1).reshape(-1, len(sides))
    while boxes.size and max(sides) > 1:
        inside = [range(s + 1) if a else (0,) for s, a in zip(sides, along, strict=True)]
        boxes = boxes[_mixed(labels, boxes, inside)]
        finer = [tuple(range(0, s + 1, max(s // 2, 1))) if a else (0,) for s, a in zip(sides, along, strict=True)]
        for offset in itertools.product(*finer):
            wanted[_at(boxes, offset)] = True
        lower = [(0, s // 2) if s > 1 else (0,) for s in sides]
        sides = [max(s // 2, 1) for s in sides]
        boxes = np.concatenate([boxes + np.array(offset) for offset in itertools.product(*lower)])
        ends = [(0, s) if a else (0,) for s, a in zip(sides, along, strict=True)]
        known = [labels[_at(boxes, offset)] != UNKNOWN for offset in itertools.product(*ends)]
        boxes = boxes[np.all(known, axis=0)]
    return np.flatnonzero(wanted & (labels == UNKNOWN)).astype(np.int64)


def _mixed(labels: Labels, boxes: Places, inside: Iterable[Iterable[int]]) -> NDArray[np.bool_]:
    """Whether the known labels of each box, its sides among it, are not all the same."""
    mixed, first = np.zeros(len(boxes), dtype=bool), labels[tuple(boxes.T)]
    for offset in itertools.product(*inside):
        here = labels[_at(boxes, offset)]
        mixed |= (here != first) & (here != UNKNOWN)
    return mixed


def _at(boxes: Places, offset: tuple[int, ...]) -> tuple[NDArray[np.int64], ...]:
    return tuple((boxes + np.array(offset)).T)


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
