"""Planes of a map's two ranges, one for each combination of values of its other axes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.map_grid import Axis, Grid

Points = NDArray[np.float64]  # shape (points, 2)


@dataclass(frozen=True)
class Plane:
    """The two ranges of a map, and which cells lie on them where the other axes have certain places."""

    grid: Grid
    along: tuple[int, int]
    chosen: tuple[int, ...]

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """The two ranges."""
        return self.grid.axes[self.along[0]], self.grid.axes[self.along[1]]

    def cell(self, i: int, j: int) -> int:
        """The cell at places along the two ranges."""
        others = iter(self.chosen)
        place = [
            i if k == self.along[0] else j if k == self.along[1] else next(others) for k in range(len(self.grid.axes))
        ]
        return int(np.ravel_multi_index(place, self.grid.shape))

    @property
    def cells(self) -> NDArray[np.int64]:
        """All cells, shape of the two ranges."""
        n, m = (len(axis.values) for axis in self.axes)
        return np.array([[self.cell(i, j) for j in range(m)] for i in range(n)])


def planes(grid: Grid) -> list[Plane]:
    """A plane for each combination of values of the axes that are no ranges; none where there are not two ranges."""
    ranges = [i for i, axis in enumerate(grid.axes) if axis.numeric]
    if len(ranges) != 2:
        return []
    others = [range(len(axis.values)) for axis in grid.axes if not axis.numeric]
    return [Plane(grid, (ranges[0], ranges[1]), chosen) for chosen in product(*others)]
