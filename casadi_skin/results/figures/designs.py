"""The way to a design, with the solution there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.results.figures.style import blank, drawn, finished, number, number_sites, plain
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.design import Design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    for one in (*result.others, result):
        x, y = one.path[:, 0], one.path[:, 1] if len(names) > 1 else one.values
        colour, label = ("0.4", "designs") if one is result else ("0.7", "to another optimum")
        axes.plot(x, y, "o-", color=colour, ms=3, lw=0.8, label=label)
    axes.plot(x[:1], y[:1], "s", color="black", mfc="none", label="start")
    axes.plot(x[-1:], y[-1:], "o", color="tab:red", mfc="none", ms=9, label="optimum" if result.found else "end")
    axes.set(xlabel=plain(names[0]), ylabel=plain(names[1] if len(names) > 1 else result.quantity))
