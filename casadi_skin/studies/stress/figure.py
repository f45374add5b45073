"""Pictures of a stress test: digits case by case, physical coordinates against the gauge, thresholds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from casadi_skin.figures.style import blank, colours, finished, style
from casadi_skin.studies.stress.case import MOST_DIGITS, Outcome
from casadi_skin.studies.stress.physical import EPSILON, Comparison
from casadi_skin.studies.study import letter

ROW = 0.155  # inches
LOWEST = 1e-17  # of the axes, where smaller errors are drawn
HIGHEST = 1e2
MARKERS = "os^D"
SYMBOLS = (("gamma", "γ"), ("alpha", "α"), ("lambda", "λ"), ("= -", "= −"), ("e-", "e−"), ("1 - ", "1 − "))
PHYSICAL_PANELS = {
    "multiplier": "largest |multiplier| of a stable orbit",
    "frequency": "linear frequencies",
    "orbit": r"$\Omega$ of orbits found from linear modes",
}


def stress_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Digits of agreement of every case, by theme, in two columns of rows; refusals at the left edge."""
    themes = list(dict.fromkeys(outcome.case.theme for outcome in outcomes))
    groups = [[outcome for outcome in outcomes if outcome.case.theme == theme] for theme in themes]
    left, right = _halves(groups)
    rows = max(sum(len(group) + 1.5 for group in half) for half in (left, right))
    with style():
        figure = blank(10.6, 1.2 + ROW * rows)
        panels = figure.subplots(1, 2 if right else 1, squeeze=False)[0]
        for axes, half in zip(panels, (left, right), strict=False):
            _draw_rows(axes, half, rows)
        return finished(figure, panels, 5)


def _halves(groups: Sequence[Sequence[Outcome]]) -> tuple[list[Sequence[Outcome]], list[Sequence[Outcome]]]:
    """The groups in order, cut in two where both parts are nearest in length."""
    lengths = np.cumsum([len(group) + 1.5 for group in groups])
    cut = int(np.argmin(np.abs(2.0 * lengths - lengths[-1]))) + 1
    return list(groups[:cut]), list(groups[cut:])


def _draw_rows(axes: Axes, groups: Sequence[Sequence[Outcome]], rows: float) -> None:
    places: list[float] = []
    labels: list[str] = []
    y = 0.0
    for group in groups:
        axes.text(0.0, y, group[0].case.theme, fontweight="bold", va="center", fontsize=9)
        y += 1.0
        for outcome in group:
            places.append(y)
            labels.append(_in_symbols(outcome.case.name))
            _draw_case(axes, outcome, y)
            y += 1.0
        y += 0.5
    axes.set(xlim=(-0.8, MOST_DIGITS + 0.6), ylim=(rows - 0.5, -0.9), yticks=places, xlabel="digits")
    axes.set_yticklabels(labels, fontsize=7.5)
    axes.set_xticks(range(0, int(MOST_DIGITS) + 1, 2))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _in_symbols(words: str) -> str:
    """Words with the letters and minus signs of formulas."""
    for word, symbol in SYMBOLS:
        words = words.replace(word, symbol)
    return words


def _draw_case(axes: Axes, outcome: Outcome, y: float) -> None:
    finding = outcome.finding
    if outcome.fault:
        label = "not as expected"
        axes.plot(-0.4, y, "*", color="black", ms=9, label=label, ls="none")
    elif outcome.refused:
        axes.plot(-0.4, y, "x", color="black", ms=5, label="refused, saying why", ls="none")
    if finding is None:
        return
    low, high = sorted((finding.promised, finding.digits))
    axes.plot([low, high], [y, y], color="0.75", lw=1.0, zorder=1)
    axes.plot(finding.promised, y, "|", color="0.3", ms=7, mew=1.4, label="promised or asked for", ls="none")
    if outcome.refused:
        label = "agreement of the last orbit before"
        axes.plot(finding.digits, y, "o", color="black", mfc="white", ms=4, label=label, ls="none")
    else:
        axes.plot(finding.digits, y, "o", color="black", ms=4, label="agreement with the check", ls="none")


# Physical against gauge ---------------------------------------------------------------------------------------------


def physical_figure(compared: Sequence[Comparison]) -> Figure:
    """Errors in physical coordinates against the number of sites, a line a gamma; in the gauge as crosses."""
    with style():
        figure = blank(10.6, 4.1)
        panels = figure.subplots(1, 3, sharey=True)
        for axes, name, panel in zip(panels, PHYSICAL_PANELS, "abc", strict=True):
            _draw_errors(axes, compared, name)
            letter(axes, panel, PHYSICAL_PANELS[name])
        panels[0].set_ylabel("error")
        return finished(figure, panels, 6)


def _draw_errors(axes: Axes, compared: Sequence[Comparison], name: str) -> None:
    gammas = sorted({c.gamma for c in compared})
    for gamma, colour, marker in zip(gammas, colours(len(gammas)), MARKERS * len(gammas), strict=False):
        of_gamma = [c for c in compared if c.gamma == gamma]
        sites = [c.sites for c in of_gamma]
        physical = [_drawn(getattr(c, f"{name}_physical")) for c in of_gamma]
        gauge = [_drawn(getattr(c, f"{name}_gauge")) for c in of_gamma]
        label = rf"physical, $\gamma = {gamma:g}$"
        axes.plot(sites, physical, marker=marker, color=colour, ms=4.5, lw=1.0, label=label, zorder=3)
        axes.plot(sites, gauge, "+", color="black", ms=6, label="gauge", zorder=4)
        if name != "orbit":
            n = np.linspace(min(sites), max(sites), 100)
            law = 0.1 * EPSILON * np.exp((n - 1) * np.arctanh(gamma))
            label = r"$0.1\,\varepsilon\, r^{(N-1)/2}$" if gamma == gammas[-1] else "_"
            axes.plot(n, law, ":", color=colour, lw=1.0, label=label)
    axes.set(yscale="log", ylim=(LOWEST / 2.0, HIGHEST), xlabel="sites $N$", yticks=10.0 ** np.arange(-16, 3, 4))


def _drawn(error: float) -> float:
    """An error within the axes; where there is no result, at the upper edge."""
    return min(max(error, LOWEST), HIGHEST) if not math.isnan(error) else HIGHEST


# Threshold -----------------------------------------------------------------------------------------------------------


def threshold_figure(alpha: float, gammas: Sequence[float], thresholds: Mapping[float, Sequence[float]]) -> Figure:
    """|g| S_c against gamma for each g (a), and how much it differs between the signs of g (b)."""
    looks: dict[float, dict[str, Any]] = {
        1.0: {"marker": "o", "color": "black", "label": "$g = +1$, above the band"},
        -1.0: {"marker": "s", "color": "0.45", "label": "$g = -1$, below the band", "ls": (0, (4.0, 1.5))},
    }
    with style():
        figure = blank(7.2, 3.4)
        left, right = figure.subplots(1, 2)
        for g, S in thresholds.items():
            left.plot(gammas, S, ms=3.0, lw=1.1, **looks[g])
        ratio = np.divide(thresholds[1.0], thresholds[-1.0])
        right.semilogy(gammas, ratio - 1.0, "-o", ms=3.0, color="black", lw=1.1)
        left.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"threshold $|g|\,S_c$", xlim=(0, 1), ylim=(0, None))
        right.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"$S_c(g>0)/S_c(g<0) - 1$", xlim=(0, 1))
        letter(left, "a", "end breather of the infinite chain")
        letter(right, "b", rf"$\alpha = {alpha:g}$ (dimensionless)")
        return finished(figure, [left, right], 2)
