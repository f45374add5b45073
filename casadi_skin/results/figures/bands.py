"""The bands of a lattice's cell, with the modes of the lattice beside them, and the spectrum of the ring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.results.figures.style import blank, finished, style, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RING_POINTS = 401


def band_figure(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> Figure:
    """Bands against the wave number, modes of the lattice by participation ratio, and omega^2 of a ring.

    Arguments:
        lattice: a lattice whose cells are all alike.
        parameters: values of parameters that are not the declared ones.

    Returns:
        The figure.

    Raises:
        ValueError: the cells differ.
    """
    of_cell, ring = bands(lattice, parameters), bands(lattice, parameters, RING_POINTS, open_ends=False)
    modes = lattice_modes(lattice, parameters)
    with style():
        figure = blank(7.2, 3.2)
        panels = figure.subplot_mosaic("abc")
        along = of_cell.wave_numbers[:, 0] / np.pi
        if of_cell.wave_numbers.shape[1] == 2:
            along = np.linspace(0.0, 3.0, len(along))
            panels["a"].set_xticks(range(4), [r"$\Gamma$", "X", "M", r"$\Gamma$"])
        panels["a"].plot(along, np.sqrt(np.maximum(of_cell.squares.real, 0.0)), color="black")
        lean = ", ".join(f"{beta:.4g}" for beta in of_cell.beta)
        panels["a"].set_xlabel(r"wave number $k/\pi$" if max(of_cell.beta) == min(of_cell.beta) == 1.0 else (
            rf"wave number $k/\pi$, $|\beta| = {lean}$"))  # fmt: skip
        panels["a"].set_ylabel(r"linear frequency $\omega$")
        panels["b"].plot(modes.participation, modes.frequencies.real, "o", ms=3, mfc="white", color="black")
        panels["b"].set_xlabel("participation ratio (sites)")
        panels["b"].sharey(panels["a"])
        panels["c"].plot(ring.squares.real, ring.squares.imag, ".", ms=1.5, color="0.45")
        panels["c"].plot(modes.squares.real, modes.squares.imag, "o", ms=3, mfc="white", color="black")
        panels["c"].set_xlabel(r"Re $\omega^2$ (dots: of a ring)")
        panels["c"].set_ylabel(r"Im $\omega^2$")
        figure.suptitle(title(lattice, parameters))
        return finished(figure, (), 1)
