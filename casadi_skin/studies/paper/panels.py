"""What the paper's figures share: tables written beside the pictures, panel letters, space-time pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.bvp.problem import Array
from casadi_skin.results.tables import Cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.dynamics import Evolution

Table = tuple[Sequence[str], Sequence[Mapping[str, Cell]]]
Drawn = tuple["Figure", dict[str, Table]]


def table(**columns: ArrayLike) -> Table:
    """A table of columns of one length."""
    values = [np.asarray(column).tolist() for column in columns.values()]
    return list(columns), [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]


def stacked(tables: Sequence[Table]) -> Table:
    """Tables with the same columns, one below the other."""
    return tables[0][0], [row for _, rows in tables for row in rows]


def letter(axes: Axes, name: str, words: str = "") -> None:
    """The panel's letter and a few words above it, at the left."""
    axes.set_title(f"({name})  {words}".rstrip(), loc="left")


def sites_table(t: Array, displacements: Array) -> Table:
    """Displacements (time, site) against time, a column a site."""
    sites = {f"y_{n}": column for n, column in enumerate(displacements.T, start=1)}
    return table(t=t, **sites)


def draw_space_time(figure: Figure, axes: Axes, evolution: Evolution) -> None:
    """Displacements as an image, time to the right and sites upwards; lightness alone tells the sign."""
    y = evolution.displacements
    largest = float(np.max(np.abs(y)))
    sites = np.arange(1, y.shape[1] + 1)
    image = axes.pcolormesh(
        evolution.t, sites, y.T, cmap="cividis", vmin=-largest, vmax=largest, shading="nearest", rasterized=True
    )
    axes.set(xlim=(evolution.t[0], evolution.t[-1]), xlabel="time $t$", ylabel="site $n$", yticks=[1, 6, 12, 18, 24])
    axes.tick_params(top=False, right=False, direction="out")
    figure.colorbar(image, ax=axes, label="$y_n(t)$", aspect=25, pad=0.02)
