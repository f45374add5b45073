"""A search in two panels: the profiles of its optima, and what every start led to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.figures import style
from casadi_skin.optimise.result import SearchResult
from casadi_skin.optimise.starts import Ending

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 4  # optima whose profiles are drawn
NARROWEST = 1e-3  # of an axis, relative: starts that agree are to look so


def search_figure(result: SearchResult, objective: str) -> Figure:
    """|y_n| of the best optima at the phase where all velocities vanish, and the objective reached by every start."""
    with style.style():
        figure = style.blank(7.2, 3.6)
        left, right = figure.subplots(1, 2)
        _profiles(left, result)
        _starts(right, result, objective)
        figure.suptitle(f"{result.status.value} ($N = {result.chain.sites}$; dimensionless)")
        return style.finished(figure, (left, right), 3)


def _profiles(axes: Axes, result: SearchResult) -> None:
    found = (*result.optima, *result.others)[:SHOWN]
    sites = np.arange(1, result.chain.sites + 1)
    for rank, (optimum, colour) in enumerate(zip(found, style.colours(len(found)), strict=True), start=1):
        words = "" if optimum.on_family is not False else ", another family"
        label = f"optimum {rank}: $S = {style.number(optimum.S)}$, $\\gamma = {style.number(optimum.gamma)}${words}"
        axes.semilogy(sites, np.abs(optimum.orbit.profile), "osD^"[rank - 1], ms=4, ls="-", lw=0.7, color=colour,
                      mfc="none" if rank > 1 else colour, label=label)  # fmt: skip
    style.number_sites(axes, 1, result.chain.sites, "site $n$")
    axes.set_ylabel(r"$|y_n(0)|$")


def _starts(axes: Axes, result: SearchResult, objective: str) -> None:
    marks = {Ending.CONVERGED: ("o", "black", "converged"), Ending.INFEASIBLE: ("x", "0.5", "infeasible"),
             Ending.FAILED: ("+", "0.5", "not converged"), Ending.UNBOUNDED: ("^", "0.5", "ran off"),
             Ending.INTERRUPTED: ("|", "0.5", "interrupted")}  # fmt: skip
    shown = [o.objective for o in (*result.optima, *result.others)]
    for ending, (marker, colour, label) in marks.items():
        points = [(o.start.number, o.solution.objective) for o in result.outcomes
                  if o.ending is ending and o.solution is not None and np.isfinite(o.solution.objective)]  # fmt: skip
        if shown and ending is not Ending.CONVERGED:  # where starts that failed ended says little, and hides the rest
            points = [(number, np.clip(value, min(shown), max(shown))) for number, value in points]
        if points:
            axes.plot(*zip(*points, strict=True), marker, color=colour, mfc="none", ms=6, ls="none", label=label)
    for optimum in result.optima[:1]:
        axes.axhline(optimum.objective, color="0.7", lw=0.8, zorder=0)
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), NARROWEST * max(abs(middle), 1e-300))
    axes.set_ylim(middle - half, middle + half)
    style.number_sites(axes, 1, max((o.start.number for o in result.outcomes), default=1), "start")
    axes.set_ylabel(objective.replace("_", " "))
