"""Tables that are written beside the paper's figures, and its space-time pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from casadi_skin.bvp.problem import Array
from casadi_skin.dynamics import Evolution
from casadi_skin.figures.spacetime import draw_spacetime

Table = tuple[Sequence[str], Sequence[Mapping[str, object]]]
Drawn = tuple[Figure, dict[str, Table]]


def table(**columns: ArrayLike) -> Table:
    """A table of columns of one length; a single value stands in all rows."""
    values = [column.tolist() for column in np.broadcast_arrays(*columns.values())]
    return list(columns), [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]


def stacked(tables: Sequence[Table]) -> Table:
    """Tables with the same columns, one below the other."""
    return tables[0][0], [row for _, rows in tables for row in rows]


def sites_table(t: Array, displacements: Array) -> Table:
    """Displacements (time, site) against time, a column a site."""
    sites = {f"y_{n}": column for n, column in enumerate(displacements.T, start=1)}
    return table(t=t, **sites)


def draw_space_time(figure: Figure, axes: Axes, evolution: Evolution) -> None:
    """Displacements in time as an image with its colour bar."""
    image = draw_spacetime(axes, evolution)
    axes.set(xlabel="time $t$", yticks=[1, 6, 12, 18, 24])
    figure.colorbar(image, ax=axes, label="$y_n(t)$", aspect=25, pad=0.02)
