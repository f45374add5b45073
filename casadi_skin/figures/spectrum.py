"""The linear spectrum and its two end modes (paper, Fig. 2a)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.figures.profiles import MARKED_SITES, linear_mode, moving
from casadi_skin.figures.style import (
    blank,
    finished,
    number_sites,
    style,
    title,
)
from casadi_skin.lattice.chain import Chain
from casadi_skin.theory import linear

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def spectrum_figure(chain: Chain) -> Figure:
    """Linear frequencies against j, the cutoffs of the infinite chain, and the modes 1 and N (paper, Fig. 2a).

    Modes that do not oscillate (omega_j^2 <= 0) are left out. Modes have norm 1; of a long chain the sites that move.
    """
    j = np.arange(1, chain.sites + 1)
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, j)
    frequencies = np.sqrt(np.where(squares > 0, squares, np.nan))
    with style():
        figure = blank(6.8, 3.6)
        panels = figure.subplot_mosaic("aab;aac" if chain.sites > 1 else "aab")
        marker = "o" if chain.sites <= MARKED_SITES else ""
        panels["a"].plot(j, frequencies, marker=marker, ms=4, lw=0.8, color="black", mfc="white", zorder=3)
        for square, name, x, below in zip(chain.band(), ("min", "max"), (0.97, 0.03), (False, True), strict=True):
            if square > 0:
                omega, sides = float(np.sqrt(square)), ("left", "top") if below else ("right", "bottom")
                panels["a"].axhline(omega, color="0.45", lw=0.9, ls="--")
                panels["a"].annotate(
                    rf"$\omega_\mathrm{{{name}}} = {omega:.4g}$", (x, omega), (0, -3 if below else 3),
                    panels["a"].get_yaxis_transform(), "offset points", ha=sides[0], va=sides[1],
                )  # fmt: skip
        number_sites(panels["a"], 1, chain.sites, "mode $j$")
        panels["a"].set_ylabel(r"linear frequency $\omega_j$")
        for letter, mode in zip("bc", (chain.sites, 1)[-len(panels) + 1 :], strict=False):
            u = linear_mode(chain, mode)
            panels[letter].axhline(0.0, color="0.45", lw=0.5)
            panels[letter].plot(j, u, marker=marker, ms=2.5, lw=0.8, color="black")
            panels[letter].set_ylabel(rf"$u_{{{mode},n}}$")
            number_sites(panels[letter], *moving(u[None]), "site $n$" if mode == 1 else "")
        figure.suptitle(title(chain))
        return finished(figure, (), 1)
