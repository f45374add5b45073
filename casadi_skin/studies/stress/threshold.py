"""The threshold of the end breather against gamma, for both signs of g."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.figures.style import blank, finished, style
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.threshold import threshold

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALPHA = 1.0
GAMMAS = (0.02, 0.04, *np.round(np.arange(0.06, 0.96, 0.03), 2).tolist(), 0.97, 0.99)
QUICK_GAMMAS = (0.06, 0.25, 0.5, 0.75, 0.97)
LOOKS = {1.0: ("-", "o", "black"), -1.0: ((0, (4.0, 1.5)), "s", "0.45")}


@dataclass(frozen=True)
class Threshold:
    """|g| S_c of the infinite chain with alpha, gamma and the sign of g."""

    alpha: float
    gamma: float
    g: float
    S: float


def thresholds(gammas: Sequence[float], say: Callable[[str], None] = lambda words: None) -> list[Threshold]:
    """Thresholds for g = 1 and g = -1."""
    found = []
    for g in LOOKS:
        for gamma in gammas:
            say(f"threshold: gamma = {gamma:g}, g = {g:+g}")
            found.append(Threshold(ALPHA, gamma, g, threshold(Chain(2, ALPHA, gamma, g))))
    return found


def threshold_figure(found: Sequence[Threshold]) -> Figure:
    """|g| S_c against gamma (a), and how much it differs between the signs of g (b)."""
    by_sign = {g: [t for t in found if t.g == g] for g in LOOKS}
    with style():
        figure = blank(7.2, 3.4)
        left, right = figure.subplots(1, 2)
        for g, (dashes, marker, colour) in LOOKS.items():
            gamma, S = np.array([(t.gamma, t.S) for t in by_sign[g]]).T
            label = rf"$g = {g:+g}$, {'above' if g > 0 else 'below'} the band"
            left.plot(gamma, S, ls=dashes, marker=marker, ms=3.0, color=colour, lw=1.1, label=label)
        hard, soft = (np.array([t.S for t in by_sign[g]]) for g in (1.0, -1.0))
        right.semilogy(gamma, hard / soft - 1.0, "-o", ms=3.0, color="black", lw=1.1)
        left.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"threshold $|g|\,S_c$", xlim=(0, 1), ylim=(0, None))
        right.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"$S_c(g>0)/S_c(g<0) - 1$", xlim=(0, 1))
        left.set_title("(a) end breather of the infinite chain", loc="left")
        right.set_title(rf"(b) $\alpha = {ALPHA:g}$ (dimensionless)", loc="left")
        return finished(figure, [left, right], 2)
