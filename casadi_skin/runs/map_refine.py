"""The cells that a map needs next: those of the coarsest grid, then those where the watched quantities change.

The grid is halved where the corners of a box, or cells computed on its sides, differ. What is needed follows from the
cells that are known alone, so that every engine, and a map that is resumed, computes the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.map_grid import Cells, Grid

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
