"""Space-time pictures of a time evolution: sites against time, displacement as colour (paper, Figs. 3c, 3f and 6).

The colour map is centred at 0 and its lightness rises from negative to positive, so that the sign survives in grey.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.dynamics import Evolution
from casadi_skin.figures.style import blank, finished, style
from casadi_skin.figures.style import title as chain_title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

COLOURS = "cividis"  # blue to grey to yellow; perceptually uniform, and the same to colour-blind readers
MOST_COLUMNS = 4000  # more samples than that no page resolves
MOST_PERIODS = 100  # of the lowest linear frequency; beyond, the extent of the oscillations is shown
WINDOWS = 200  # over which that extent is taken


def spacetime_figure(
    evolution: Evolution,
    title: str = "",
    *,
    profile: bool = False,
    energy: bool = False,
    kicked_site: int | None = None,
) -> Figure:
    """Displacements of all sites in time, and in long runs the largest |y_n| of 200 windows of time; dimensionless.

    `profile` adds the displacements at the first time, `energy` the relative change of the energy (see
    `Evolution.energy_drift`), `kicked_site` a mark at that site, from 1. Where the samples are too far apart to show
    the oscillation, the axis says so. Raises ValueError for `energy` where the evolution has none.
    """
    with style():
        figure = blank(6.4 + 1.1 * profile, 3.4 + 1.1 * energy)
        widths, heights = ([1.0, 6.0] if profile else [1.0]), ([3.0, 1.0] if energy else [1.0])
        grid = figure.add_gridspec(len(heights), len(widths), width_ratios=widths, height_ratios=heights)
        main = last = figure.add_subplot(grid[0, -1])
        image = draw_spacetime(main, evolution)
        extent = f"largest $|y_n|$ in windows of {_window(evolution):.3g}"
        label = extent if _is_long(evolution) else "displacement $y_n(t)$"
        beyond = bool(np.abs(evolution.displacements).max() > _largest(evolution))
        figure.colorbar(image, ax=main, label=label, aspect=22, pad=0.02, extend="both" if beyond else "neither")
        if profile:
            _draw_profile(figure.add_subplot(grid[0, 0], sharey=main), evolution)
        if energy:
            last = figure.add_subplot(grid[1, -1], sharex=main)
            _draw_energy(last, evolution)
            main.tick_params(labelbottom=False)
        last.set_xlabel(_time_label(evolution))
        if kicked_site is not None:
            main.plot(evolution.t[0], kicked_site, ">", ms=8, mfc="white", mec="black", clip_on=False, zorder=5)
        figure.suptitle("; ".join(words for words in (title, chain_title(evolution.chain)) if words))
        return finished(figure, (), 1)


def draw_spacetime(axes: Axes, evolution: Evolution) -> QuadMesh:
    """Displacements as colour, time to the right and sites upwards; the returned image takes a colour bar."""
    from matplotlib.ticker import MaxNLocator

    sites, largest = evolution.chain.sites, _largest(evolution)
    lowest = -largest
    if _is_long(evolution):
        edges, low, high = _extent(evolution.t, evolution.displacements)
        y, lowest = np.maximum(-low, high), 0.0
    else:
        every = -(-evolution.t.size // MOST_COLUMNS)
        edges, y = _edges(evolution.t[::every]), evolution.displacements[::every]
    places = np.arange(sites + 1) + 0.5
    image = axes.pcolormesh(edges, places, y.T, cmap=COLOURS, vmin=lowest, vmax=largest, rasterized=True)
    axes.set(xlim=(edges[0], edges[-1]), ylim=(places[0], places[-1]), ylabel="site $n$")
    axes.tick_params(top=False, right=False, direction="out")
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 4, 5, 10]))
    return image


def _largest(evolution: Evolution) -> float:
    """Displacement of the brightest colour; with g < 0 at most the top of a site's well, beyond which it escapes."""
    chain, largest = evolution.chain, float(np.abs(evolution.displacements).max()) or 1.0
    if chain.g < 0 and chain.alpha > -2.0:
        largest = min(largest, float(np.sqrt((2.0 + chain.alpha) / -chain.g)))
    return largest


def _draw_profile(axes: Axes, evolution: Evolution) -> None:
    """Displacements at the first time beside the sites that they belong to."""
    y = evolution.displacements[0]
    n = np.arange(1, y.size + 1)
    axes.axvline(0.0, color="0.45", lw=0.5)
    axes.plot(y, n, marker="o" if y.size <= 60 else "", ms=2.5, lw=0.8, color="black")
    axes.set_xlabel(f"$y_n({evolution.t[0]:g})$")
    axes.xaxis.set_label_position("top")
    axes.tick_params(labelleft=False, labelbottom=False, labeltop=True)
    axes.margins(x=0.15)


def _draw_energy(axes: Axes, evolution: Evolution) -> None:
    """Relative change of the energy: in long runs its mean, over the range that it has in each window of time."""
    t, drift = evolution.t, evolution.energy_drift
    axes.axhline(0.0, color="0.6", lw=0.6)
    if _is_long(evolution):
        edges, low, high = _extent(t, drift[:, None])
        axes.stairs(high[:, 0], edges, baseline=low[:, 0], fill=True, color="0.75")
        starts = _starts(t)
        drift = np.add.reduceat(drift, starts) / np.diff(np.append(starts, t.size))
        t = 0.5 * (edges[:-1] + edges[1:])
    axes.plot(t, drift, lw=0.8, color="black")
    axes.set_ylabel(r"$\Delta H\,/\,H$")


# Time ---------------------------------------------------------------------------------------------------------------


def _is_long(evolution: Evolution) -> bool:
    """Whether there are too many oscillations to show, and samples enough to show their extent."""
    lowest = np.sqrt(max(evolution.chain.band()[0], 0.0))
    periods = lowest * (evolution.t[-1] - evolution.t[0]) / (2.0 * np.pi)
    return bool(periods > MOST_PERIODS and evolution.t.size >= 5 * WINDOWS)


def _window(evolution: Evolution) -> float:
    """The length of a window of time."""
    return float(evolution.t[-1] - evolution.t[0]) / WINDOWS


def _starts(t: Array) -> NDArray[np.intp]:
    """Place of the first sample of each window that holds one, shape (windows,)."""
    window = np.minimum((WINDOWS * (t - t[0]) / (t[-1] - t[0])).astype(int), WINDOWS - 1)
    return np.asarray(np.unique(window, return_index=True)[1], dtype=np.intp)


def _extent(t: Array, values: Array) -> tuple[Array, Array, Array]:
    """Edges of the windows, and the least and largest of values (time, columns) in each, shape (windows, columns)."""
    starts = _starts(t)
    edges = np.append(t[starts], t[-1])
    return edges, np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def _edges(t: Array) -> Array:
    """Edges of the cells around times, shape (len(t) + 1,)."""
    if t.size == 1:
        return np.array([t[0], t[0] + 1.0])
    return np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])


def _time_label(evolution: Evolution) -> str:
    """The label of the time axis, with a warning where the fastest linear mode has less than 4 samples a period."""
    apart = float(np.max(np.diff(evolution.t), initial=0.0))
    fastest = np.sqrt(max(evolution.chain.band()[1], 0.0))
    if fastest * apart > 0.5 * np.pi and not _is_long(evolution):
        return f"time $t$ (samples {apart:.3g} apart: oscillations are not resolved)"
    return "time $t$"
