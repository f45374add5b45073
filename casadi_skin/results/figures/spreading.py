"""The energy of a lattice in time: by site, its centre, participation number and second moment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.spreading import Spreading
from casadi_skin.results.figures.style import DASHES, blank, finished, style, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECADES = 5.0  # of energies that colours distinguish
MOST_COLUMNS = 2000  # more samples than that no page resolves


def spreading_figure(found: Spreading, lattice: Lattice) -> Figure:
    """Energies of the sites in time as colour, and below them three numbers that locate them.

    Arguments:
        found: of a time evolution.
        lattice: that it is one of.

    Returns:
        The figure.
    """
    from matplotlib.colors import LogNorm

    step = max(1, found.t.size // MOST_COLUMNS)
    energies = np.abs(found.energies[::step]).T
    largest = float(np.max(energies)) or 1.0
    with style():
        figure = blank(6.2, 6.0)
        panels = figure.subplot_mosaic([["a"], ["a"], ["b"], ["c"]], sharex=True)
        numbers = np.arange(1, len(energies) + 1)
        least = largest * 10.0**-DECADES
        drawn = panels["a"].pcolormesh(
            found.t[::step], numbers, np.maximum(energies, least), cmap="cividis", norm=LogNorm(least, largest),
            shading="nearest", rasterized=True,
        )  # fmt: skip
        panels["a"].set_ylabel("site" if len(lattice.declaration.cells) == 1 else "site, along rows")
        figure.colorbar(drawn, ax=panels["a"], label="energy of the site", use_gridspec=False)
        for k, dash in zip(range(found.centre.shape[1]), DASHES, strict=False):
            label = f"along direction {k + 1}" if found.centre.shape[1] > 1 else None
            panels["b"].plot(found.t, found.centre[:, k], color="black", ls=dash, lw=0.9, label=label)
        panels["b"].set_ylabel("centre (cell)")
        if found.centre.shape[1] > 1:
            panels["b"].legend(loc="best")
        panels["c"].plot(found.t, found.participation, color="black", lw=0.9, label="participation number (sites)")
        panels["c"].plot(
            found.t, found.second_moment, color="black", lw=0.9, ls=DASHES[1], label="second moment (cells squared)"
        )
        panels["c"].set_ylim(bottom=0.0)
        panels["c"].legend(loc="best")
        panels["c"].set_xlabel("time $t$")
        figure.suptitle(title(lattice))
        return finished(figure, (), 1)
