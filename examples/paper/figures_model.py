"""Figures 1 and 2 of the paper: the chain, its linear spectrum with two skin modes, and how families are followed."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from figures_families import Drawn
from matplotlib.axes import Axes
from paper_data import ALPHA, GAMMA, SITES, Array, PaperData, stacked, table

from casadi_skin import Chain, style
from casadi_skin.results.figures.style import blank, finished, number_sites, title
from casadi_skin.runs.study import letter

RIGHT_TO_LEFT, LEFT_TO_RIGHT = "#b2182b", "#2166ac"  # red and blue, as in the paper; distinguished by arrows as well


# Figure 1 -----------------------------------------------------------------------------------------------------------


def _spring(start: tuple[float, float], end: tuple[float, float], coils: int, width: float) -> Array:
    """A zigzag from start to end with straight leads, shape (points, 2)."""
    a, b = np.array(start), np.array(end)
    along = (b - a) / np.linalg.norm(b - a)
    across = np.array([-along[1], along[0]]) * width
    inner = np.linspace(0.2, 0.8, 2 * coils + 1)
    sides = np.concatenate([[0.0], np.tile([1.0, -1.0], coils)[: 2 * coils - 1], [0.0]])
    zigzag = a + inner[:, None] * (b - a) + sides[:, None] * across
    return np.vstack([a, zigzag, b])


def _draw_coupling(axes: Axes, left: float, right: float) -> None:
    """The two one-way springs between neighbours: the force each exerts, and on which of the two it acts."""
    from matplotlib.patches import FancyArrowPatch

    middle = 0.5 * (left + right)
    for height, colour, words, ends in (
        (0.24, RIGHT_TO_LEFT, r"$a_{+}$", (0.26, -0.26)),
        (-0.24, LEFT_TO_RIGHT, r"$a_{-}$", (-0.26, 0.26)),
    ):
        axes.plot(*_spring((left, height), (right, height), 5, 0.09).T, color=colour, lw=1.3, zorder=1)
        level = height + np.copysign(0.24, height)
        tail, head = (middle + ends[0], level), (middle + ends[1], level)
        axes.add_patch(FancyArrowPatch(tail, head, arrowstyle="-|>", mutation_scale=10, color=colour, lw=1.0))
        axes.text(middle, level + np.copysign(0.16, height), words, color=colour, ha="center", va="center", size=13)


def _draw_oscillator(axes: Axes, x: float, name: str) -> None:
    """A mass on its nonlinear spring to the ground."""
    from matplotlib.patches import Circle, Rectangle

    axes.plot(*_spring((x, -0.3), (x, -1.55), 5, 0.11).T, color="black", lw=1.2, zorder=1)
    axes.plot([x - 0.32, x + 0.32], [-1.55, -1.55], color="black", lw=1.2)
    axes.add_patch(Rectangle((x - 0.32, -1.68), 0.64, 0.13, fc="none", ec="0.5", hatch="//////", lw=0.0))
    axes.add_patch(Circle((x, 0.0), 0.36, fc="0.85", ec="black", lw=1.2, zorder=3))
    axes.text(x, 0.0, name, ha="center", va="center", size=13, zorder=4)


def chain_figure(data: PaperData) -> Drawn:
    """The chain with its one-way couplings and nonlinear on-site springs (paper, Fig. 1)."""
    with style():
        figure = blank(6.8, 3.2)
        axes = figure.add_subplot()
        places, names = (0.0, 2.0, 4.0), ("$y_{n-1}$", "$y_n$", "$y_{n+1}$")
        for left, right in zip((-1.0, *places), (*places, 5.0), strict=True):
            if right - left == 2.0:
                _draw_coupling(axes, left, right)
            else:  # the chain goes on
                outer, inner = (left, right) if left < 0 else (right, left)
                for height, colour in ((0.24, RIGHT_TO_LEFT), (-0.24, LEFT_TO_RIGHT)):
                    axes.plot([0.45 * inner + 0.55 * outer, inner], [height, height], color=colour, lw=1.3, zorder=1)
                axes.text(0.15 * inner + 0.85 * outer, 0.0, r"$\cdots$", ha="center", va="center", size=16)
        for x, name in zip(places, names, strict=True):
            _draw_oscillator(axes, x, name)
        axes.text(2.3, -1.0, r"$F = \alpha\, y + g\, y^3$", va="center", size=12)
        forces = (
            (RIGHT_TO_LEFT, 1.05, r"right on left: $F = a_{+}\,\Delta y$, $a_{+} = 1 - \gamma$", -0.9, "left"),
            (LEFT_TO_RIGHT, 1.05, r"left on right: $F = a_{-}\,\Delta y$, $a_{-} = 1 + \gamma$", 4.9, "right"),
        )
        for colour, height, words, x, side in forces:
            axes.text(x, height, words, color=colour, ha=side, va="center", size=11)
        axes.set(xlim=(-1.15, 5.15), ylim=(-1.75, 1.25), aspect="equal")
        axes.axis("off")
        finished(figure, (), 1)
    rows = table(
        force=["right on left", "left on right", "on site, linear", "on site, cubic"],
        law=["a_+ dy", "a_- dy", "alpha y", "g y^3"],
        coefficient=["a_+ = 1 - gamma", "a_- = 1 + gamma", "alpha", "g"],
        value=[f"{1 - GAMMA:g}", f"{1 + GAMMA:g}", f"{ALPHA:g}", "1 and -1"],
    )
    return figure, {"fig1_forces": rows}


# Figure 2 -----------------------------------------------------------------------------------------------------------


def _draw_mode(axes: Axes, u: Array, mode: int) -> None:
    axes.axhline(0.0, color="0.45", lw=0.5)
    axes.plot(np.arange(1, u.size + 1), u, marker="o", ms=2.5, lw=0.8, color="black")
    number_sites(axes, 1, u.size, "site $n$" if mode == 1 else "")
    axes.set_ylabel(rf"$u_{{{mode},n}}\,/\,\Vert u_{{{mode}}}\Vert$")


SLOPE, CURVATURE = 0.0, 0.1  # of the sketched family, chosen for the eye
STEPS = (0.3, 1.55, 2.95)


def _family(S: Array) -> Array:
    """The sketched family g > 0: points (Omega, S), shape (len(S), 2)."""
    return np.stack([1.0 + SLOPE * S + CURVATURE * S**2, S], axis=-1)


def _draw_procedure(axes: Axes) -> None:
    """Linear mode -> small orbit -> predictor along the tangent -> corrector across it, gamma fixed, Omega free."""
    from matplotlib.patches import FancyArrowPatch

    S = np.linspace(0.0, 3.15, 64)
    curve, shown = _family(S), _family(np.array(STEPS))
    axes.plot(*curve.T, color="black", lw=1.3)
    axes.plot(2.0 - curve[:, 0], S, color="black", lw=1.3, ls=(0, (4.0, 2.0)))
    for k, (start, end) in enumerate(pairwise(shown)):
        tangent = np.array([SLOPE + 2 * CURVATURE * start[1], 1.0])
        guess = start + tangent * ((end - start) @ tangent) / (tangent @ tangent)
        for tail, head, colour in ((start, guess, LEFT_TO_RIGHT), (guess, end, RIGHT_TO_LEFT)):
            arrow: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0}
            axes.add_patch(FancyArrowPatch(tail, head, lw=1.0, color=colour, zorder=3, **arrow))
        if k == 1:
            middle = 0.45 * start + 0.55 * guess
            note: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
            axes.annotate("predictor", middle, (-7, 3), ha="right", color=LEFT_TO_RIGHT, **note)
            axes.annotate("corrector", guess, (-5, 4), ha="right", color=RIGHT_TO_LEFT, **note)
    axes.plot(*shown.T, "o", ms=5, mfc="white", mec="black", zorder=4)
    axes.plot(1.0, 0.0, "s", ms=7, color="black", zorder=5, clip_on=False)
    axes.annotate(r"linear skin mode, $S \to 0$", (1.0, 0.0), (-8, 8), textcoords="offset points", ha="right")
    axes.annotate("family,\n$g > 0$", curve[-1], (0, 4), textcoords="offset points", ha="center", va="bottom")
    left = (2.0 - curve[-1, 0], S[-1])
    axes.annotate("family,\n$g < 0$", left, (0, 4), textcoords="offset points", ha="center", va="bottom")
    axes.set(xlim=(-0.35, 2.35), ylim=(0.0, 3.8), xticks=[1.0], yticks=[0.0], ylabel=r"amplitude $S = \Vert y\Vert^2$")
    axes.set(xticklabels=[r"$\omega_j$"], yticklabels=["0"], xlabel=r"frequency $\Omega$ (free), $\gamma$ fixed")
    axes.tick_params(top=False, right=False)


def procedure_figure(data: PaperData) -> Drawn:
    """The spectrum by diagonalisation with the modes 1 and N, and a sketch of the continuation (paper, Fig. 2)."""
    chain = Chain(SITES, ALPHA, GAMMA, 0.0)
    squares, vectors = chain.diagonalise()
    j, omega = np.arange(1, SITES + 1), np.sqrt(squares)
    modes = {mode: vectors[:, mode - 1] / np.linalg.norm(vectors[:, mode - 1]) for mode in (1, SITES)}
    modes = {mode: u * np.sign(u @ chain.linear_spectrum().mode(mode)) for mode, u in modes.items()}
    with style():
        figure = blank(9.4, 3.8)
        panels = figure.subplot_mosaic("aabccc;aadccc", width_ratios=(1, 1, 1.15, 0.8, 0.8, 0.8))
        panels["a"].plot(j, omega, "o-", ms=4, lw=0.8, color="black", mfc="white", zorder=3)
        transform = panels["a"].get_yaxis_transform()
        for square, name, x, up, side in zip(
            chain.band(), ("min", "max"), (0.3, 0.03), (4, -4), ("bottom", "top"), strict=True
        ):
            cutoff = float(np.sqrt(square))
            panels["a"].axhline(cutoff, color="0.45", lw=0.9, ls="--")
            words = rf"$\omega_\mathrm{{{name}}} = {cutoff:.4f}$"
            panels["a"].annotate(words, (x, cutoff), (0, up), transform, "offset points", va=side)
        number_sites(panels["a"], 1, SITES, "mode $j$")
        panels["a"].set_ylabel(r"linear frequency $\omega_j$")
        letter(panels["a"], "a")
        _draw_mode(panels["b"], modes[SITES], SITES)
        _draw_mode(panels["d"], modes[1], 1)
        _draw_procedure(panels["c"])
        letter(panels["c"], "b")
        figure.suptitle(title(chain))
        finished(figure, (), 1)
    spectrum = table(mode=j, omega=omega, omega_closed_form=chain.linear_frequencies())
    profiles = [table(mode=mode, site=j, u=u) for mode, u in modes.items()]
    sketch = table(**dict(zip(("Omega_over_omega", "S"), _family(np.array(STEPS)).T, strict=True)))
    return figure, {"fig2_spectrum": spectrum, "fig2_modes": stacked(profiles), "fig2_sketch": sketch}
