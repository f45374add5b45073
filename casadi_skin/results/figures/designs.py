"""The way to a design with the solution there, and where the starts of a search led."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.results.figures.style import blank, drawn, finished, number, number_sites, plain
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.design import Design
from casadi_skin.search.nlp import Ending
from casadi_skin.search.orbit_search import SearchResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.zero.problem import Array

NARROWEST_AXIS = 1e-3  # of an axis, relative: starts that agree are to look so


@drawn
def design_figure(result: Design, name: str) -> Figure:
    """The way of a design to its optimum and, of a family, the profile of the orbit there."""
    of_family = isinstance(result.solution, CosineOrbit)
    figure = blank(7.2 if of_family else 4.4, 3.6)
    axes = figure.subplots(1, 1 + of_family, squeeze=False)[0]
    draw_path(axes[0], result)
    if of_family:
        for orbit, marker in zip(result.located, "osD^v" * len(result.located), strict=False):
            profile = np.abs(orbit.profile)
            label = f"$S = {number(orbit.S)}$, $\\Omega = {number(orbit.Omega)}$"
            axes[1].semilogy(np.arange(1, profile.size + 1), profile, f"{marker}-", ms=4, lw=0.7, label=label)
        number_sites(axes[1], 1, profile.size, "site $n$")
        axes[1].set_ylabel("$|y_n(0)|$")
    figure.suptitle(f"{plain(result.quantity)} $= {number(result.value)}$ ({name})")
    return finished(figure, tuple(axes), 3)


def draw_path(axes: Axes, result: Design) -> None:
    """The designs on the way: in the plane of the first two parameters, also over a map; of one its quantity."""
    names = list(result.parameters)
    x, y = result.path[:, 0], result.path[:, 1] if len(names) > 1 else result.values
    axes.plot(x, y, "o-", color="0.4", ms=3, lw=0.8, label="designs")
    axes.plot(x[:1], y[:1], "s", color="black", mfc="none", label="start")
    axes.plot(x[-1:], y[-1:], "o", color="tab:red", mfc="none", ms=9, label="optimum" if result.found else "end")
    axes.set_xlabel(plain(names[0]))
    axes.set_ylabel(plain(names[1] if len(names) > 1 else result.quantity))


def path_of(result: Design) -> dict[str, Array]:
    """The designs on the way by parameter."""
    return dict(zip(result.parameters, result.path.T, strict=True))


def draw_starts(axes: Axes, result: SearchResult, objective: str) -> None:
    """The objective that each start reached, those that led to an optimum filled."""
    ends = [(o.start.number, o.objective, o.ending is Ending.CONVERGED) for o in result.outcomes if o.solution]
    for led, label, fill in ((True, "converged", "black"), (False, "another end", "none")):
        points = [(number, value) for number, value, converged in ends if converged is led and np.isfinite(value)]
        if points:
            axes.plot(*zip(*points, strict=True), "o", color="black", mfc=fill, ms=6, ls="none", label=label)
    for optimum in result.optima[:1]:
        axes.axhline(optimum.objective, color="0.7", lw=0.8, zorder=0)
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), NARROWEST_AXIS * max(abs(middle), 1e-300))
    axes.set_ylim(middle - half, middle + half)
    number_sites(axes, 1, max((o.start.number for o in result.outcomes), default=1), "start")
    axes.set_ylabel(objective.replace("_", " "))
