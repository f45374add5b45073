"""The skin effect of a lattice: its modes in the loops of the ring's spectrum, and the generalised Brillouin zone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.lattice.skin import brillouin_zone, winding_numbers
from casadi_skin.results.figures.style import DASHES, blank, finished, style, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RING_POINTS = 1001


def skin_figure(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> Figure:
    """omega^2 of the ring and of the modes by their winding numbers, and the factors beta of the modes' waves.

    Arguments:
        lattice: a lattice in one dimension whose cells are all alike.
        parameters: values of parameters that are not the declared ones.

    Returns:
        The figure.

    Raises:
        ValueError: the lattice has two dimensions, or cells that differ.
    """
    ring = bands(lattice, parameters, RING_POINTS, open_ends=False)
    squares = lattice_modes(lattice, parameters).squares
    windings = winding_numbers(lattice, squares, parameters)
    zone = brillouin_zone(lattice, squares, parameters).ravel()
    with style():
        figure = blank(6.6, 3.2)
        panels = figure.subplot_mosaic("ab")
        panels["a"].plot(ring.squares.real, ring.squares.imag, ".", ms=1.0, color="0.6")
        markers = {0.0: "x", 1.0: "o", -1.0: "s"}
        for value in np.unique(windings[np.isfinite(windings)]):
            chosen = squares[windings == value]
            panels["a"].plot(
                chosen.real, chosen.imag, markers.get(float(value), "^"), ms=3.5, mfc="white", color="black",
                label=f"{value:+.0f}" if value else "0",
            )  # fmt: skip
        on_ring = squares[np.isnan(windings)]
        if on_ring.size:
            panels["a"].plot(on_ring.real, on_ring.imag, "|", ms=5, color="black", label="none: on the ring's")
        panels["a"].legend(title="winding number", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        panels["a"].set_xlabel(r"Re $\omega^2$ (dots: of a ring)")
        panels["a"].set_ylabel(r"Im $\omega^2$")
        circle = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 201))
        panels["b"].plot(circle.real, circle.imag, color="0.6", lw=0.8, ls=DASHES[1])
        panels["b"].plot(zone.real, zone.imag, "o", ms=3, mfc="white", color="black")
        panels["b"].set_aspect("equal")
        panels["b"].set_xlabel(r"Re $\beta$ (dashed: $|\beta| = 1$)")
        panels["b"].set_ylabel(r"Im $\beta$")
        figure.suptitle(title(lattice, parameters))
        return finished(figure, (), 1)
