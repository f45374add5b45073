"""Orbits of a lattice in two dimensions: displacements in the plane, and their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.results.figures.style import blank, family, finished, number, style, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch

MOST_ORBITS = 3  # side by side
DEEPEST = -8.0  # of the logarithms drawn


def plane_figure(branch: Branch) -> Figure | None:
    """Displacements at t = 0 over their norm in the plane, and their decimal logarithms, one column a requested orbit.

    Arguments:
        branch: a family.

    Returns:
        The figure; None where the model is no lattice in two dimensions, or no orbit was requested.

    Raises:
        ValueError: the branch is no family.
    """
    lattice = family(branch).model
    orbits = [orbit for orbit in branch.orbits if orbit.point.requested][-MOST_ORBITS:]
    if not isinstance(lattice, Lattice) or len(lattice.declaration.cells) != 2 or not orbits:
        return None
    rows, columns = lattice.declaration.cells[0], lattice.declaration.cells[1] * len(lattice.declaration.sites)
    with style():
        figure = blank(0.6 + 2.8 * len(orbits), 5.2)
        panels = figure.subplots(2, len(orbits), squeeze=False)
        for k, orbit in enumerate(orbits):
            y = orbit.profile.reshape(rows, columns) / np.sqrt(orbit.S)
            largest = float(np.max(np.abs(y)))
            with np.errstate(divide="ignore"):
                logs = np.maximum(np.log10(np.abs(y)), DEEPEST)
            looks: Sequence[tuple[np.ndarray, str, float, float, str]] = (
                (y, "RdBu", -largest, largest, rf"$y(0)/\|y\|$, $S = {number(orbit.S)}$"),
                (logs, "viridis", float(np.min(logs)), 0.0, r"$\log_{10}|y(0)|/\|y\|$"),
            )
            for panel, (values, colours, low, high, words) in zip(panels[:, k], looks, strict=True):
                extent = (0.5, rows + 0.5, 0.5, columns + 0.5)
                image = panel.imshow(values.T, cmap=colours, vmin=low, vmax=high, origin="lower", extent=extent)
                figure.colorbar(image, ax=panel, shrink=0.8, use_gridspec=False)
                panel.set_title(words)
                panel.set_xlabel("cell $n$")
                panel.set_ylabel("cell $m$" if len(lattice.declaration.sites) == 1 else "sites along $m$")
        figure.suptitle(title(lattice, family(branch).coordinates.parameters))
        return finished(figure, (), 1)
