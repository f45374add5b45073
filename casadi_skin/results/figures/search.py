"""A search in two panels: the orbits of its optima, and where every start led."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_problem import Ending
from casadi_skin.results.figures.style import blank, colours, finished, number, number_sites, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OPTIMA_SHOWN = 4  # optima that are drawn
ORBIT_SAMPLES = 401  # of an orbit
NARROWEST_AXIS = 1e-3  # of an axis, relative: starts that agree are to look so


def search_figure(result: SearchResult, objective: str) -> Figure:
    """The best optima, and the objective reached by every start.

    Of a family |y_n| at the phase where all velocities vanish, of other orbits the first state over a period.
    """
    with style():
        figure = blank(7.2, 3.6)
        left, right = figure.subplots(1, 2)
        (_profiles if result.problem.of_family else _orbits)(left, result)
        draw_starts(right, result, objective)
        chain = result.model
        words = f"$N = {chain.sites}$; dimensionless" if chain.labels else chain.name
        figure.suptitle(f"{result.status.value} ({words})")
        return finished(figure, (left, right), 3)


def _profiles(axes: Axes, result: SearchResult) -> None:
    found = (*result.optima, *result.others)[:OPTIMA_SHOWN]
    for rank, (optimum, colour) in enumerate(zip(found, colours(len(found)), strict=True), start=1):
        words = "" if optimum.on_family is not False else ", another family"
        label = f"optimum {rank}: $S = {number(optimum.S)}$"
        if result.model.labels:
            label += f", $\\gamma = {number(optimum.gamma)}$"
        profile = np.abs(optimum.orbit.profile)
        axes.semilogy(np.arange(1, profile.size + 1), profile, "osD^"[rank - 1], ms=4, ls="-", lw=0.7, color=colour,
                      mfc="none" if rank > 1 else colour, label=label + words)  # fmt: skip
    if found:
        number_sites(axes, 1, found[0].orbit.profile.size, "site $n$")
    axes.set_ylabel(r"$|y_n(0)|$")


def _orbits(axes: Axes, result: SearchResult) -> None:
    phases = np.linspace(0.0, 1.0, ORBIT_SAMPLES)
    shown = result.optima[:OPTIMA_SHOWN]
    for rank, (optimum, colour) in enumerate(zip(shown, colours(len(shown)), strict=True), start=1):
        label = f"optimum {rank}: period {number(optimum.period)}"
        axes.plot(phases, optimum.orbit.evaluate(phases * optimum.period)[:, 0], color=colour, label=label)
    axes.set_xlabel("time / period")
    axes.set_ylabel(result.model.state_names[0].replace("_", " "))


def draw_starts(axes: Axes, result: SearchResult, objective: str) -> None:
    """The objective that each start reached, by how it ended."""
    marks = {Ending.CONVERGED: ("o", "black", "converged"), Ending.INFEASIBLE: ("x", "0.5", "infeasible"),
             Ending.FAILED: ("+", "0.5", "not converged"), Ending.UNBOUNDED: ("^", "0.5", "ran off"),
             Ending.INTERRUPTED: ("|", "0.5", "interrupted"), Ending.NO_OPTIMUM: ("s", "0.5", "saddle")}  # fmt: skip
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
    half = max(0.5 * (high - low), NARROWEST_AXIS * max(abs(middle), 1e-300))
    axes.set_ylim(middle - half, middle + half)
    number_sites(axes, 1, max((o.start.number for o in result.outcomes), default=1), "start")
    axes.set_ylabel(objective.replace("_", " "))
