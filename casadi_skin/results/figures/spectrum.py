"""The linear spectrum and its two end modes (paper, Fig. 2a)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.results.figures.profiles import MARKED_SITES, moving
from casadi_skin.results.figures.style import blank, finished, number_sites, position_label, style, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def spectrum_figure(model: Any, parameters: Mapping[str, float] | None = None) -> Figure:
    """Linear frequencies against j, the cutoffs of an infinite lattice, and the modes 1 and N (paper, Fig. 2a).

    Modes that do not oscillate (omega_j^2 <= 0) are left out. Modes have norm 1; of a long lattice the positions that
    move.

    Arguments:
        model: a `Chain` of finite length, or an `OdeModel` of second order with an equilibrium at 0.
        parameters: values of the parameters of an `OdeModel`, where they are not its nominal ones.

    Returns:
        The figure.

    Raises:
        ValueError: the model has no linear modes.
    """
    spectrum = linear_spectrum(model, parameters)
    N = spectrum.squares.size
    if N == 0:
        raise ValueError("sites: given an infinite chain; accepted for its spectrum: a whole number >= 1")
    j, n = np.arange(1, N + 1), position_label(model)
    frequencies = np.sqrt(np.where(spectrum.squares > 0, spectrum.squares, np.nan))
    with style():
        figure = blank(6.8, 3.6)
        panels = figure.subplot_mosaic("aab;aac" if N > 1 else "aab")
        marker = "o" if N <= MARKED_SITES else ""
        panels["a"].plot(j, frequencies, marker=marker, ms=4, lw=0.8, color="black", mfc="white", zorder=3)
        cutoffs = zip(spectrum.cutoffs or (), ("min", "max"), (0.97, 0.03), (False, True), strict=False)
        for square, name, x, below in cutoffs:
            if square > 0:
                omega, sides = float(np.sqrt(square)), ("left", "top") if below else ("right", "bottom")
                panels["a"].axhline(omega, color="0.45", lw=0.9, ls="--")
                panels["a"].annotate(
                    rf"$\omega_\mathrm{{{name}}} = {omega:.4g}$", (x, omega), (0, -3 if below else 3),
                    panels["a"].get_yaxis_transform(), "offset points", ha=sides[0], va=sides[1],
                )  # fmt: skip
        number_sites(panels["a"], 1, N, "mode $j$")
        panels["a"].set_ylabel(r"linear frequency $\omega_j$")
        for letter, mode in zip("bc", (N, 1)[-len(panels) + 1 :], strict=False):
            u = spectrum.mode(mode)
            panels[letter].axhline(0.0, color="0.45", lw=0.5)
            panels[letter].plot(j, u, marker=marker, ms=2.5, lw=0.8, color="black")
            panels[letter].set_ylabel(rf"$u_{{{mode},n}}$")
            number_sites(panels[letter], *moving(u[None]), n if mode == 1 else "")
        figure.suptitle(title(model, parameters))
        return finished(figure, (), 1, plain=True)
