"""Pictures of a time evolution: positions against time, displacement as colour (paper, Figs. 3c, 3f and 6).

The colour map is centred at 0 and its lightness rises from negative to positive, so that the sign survives in grey. The
few states of a small model of first order are drawn as lines.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.evolve import distance_from_orbit
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.results.figures import style
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure


COLOUR_MAP = "cividis"  # blue to grey to yellow; perceptually uniform, and the same to colour-blind readers
MOST_COLUMNS = 4000  # more samples than that no page resolves
MOST_PERIODS = 100  # of the lowest linear frequency; beyond, the extent of the oscillations is shown
EXTENT_PHASES = 64  # at which an orbit is looked at for its largest displacement
EXTENT_WINDOWS = 200  # over which that extent is taken
FEW_STATES = 6  # states of a model of first order that are drawn as lines


@style.drawn
def spacetime_figure(
    evolution: Evolution,
    title: str = "",
    *,
    profile: bool = False,
    energy: bool = False,
    kicked_site: int | None = None,
    orbit: Orbit | None = None,
) -> Figure:
    """Displacements of all positions in time, and in long runs the largest |y_n| of 200 windows of time.

    Of a model of first order its states, those of one with few as lines. Where the samples are too far apart to show
    the oscillation, the axis says so.

    Arguments:
        evolution: of any model.
        title: stands before the model in the title.
        profile: whether the displacements at the first time stand beside the picture.
        energy: whether the relative change of the energy (see `Evolution.energy_drift`) stands below it, where the
            model declares one.
        kicked_site: number of the position to mark, from 1.
        orbit: where the motion started, or near it: colours reach as far as the orbit does, and the distance from it
            stands below.

    Returns:
        The figure.

    Raises:
        ValueError: the energy cannot be evaluated, as at |gamma| = 1 of a chain where sites off the edge move.
    """
    few = not evolution.equations.positions and evolution.states.shape[1] <= FEW_STATES
    profile = profile and not few
    below = [_draw_energy] if energy and evolution.has_energy else []
    below += [] if orbit is None else [partial(_draw_distance, orbit)]
    figure = style.blank(6.4 + 1.1 * profile, 3.4 + 1.1 * len(below))
    widths, heights = ([1.0, 6.0] if profile else [1.0]), [3.0, *(1.0 for _ in below)]
    grid = figure.add_gridspec(len(heights), len(widths), width_ratios=widths, height_ratios=heights)
    main = last = figure.add_subplot(grid[0, -1])
    if few:
        _draw_states(main, evolution)
    else:
        image = draw_spacetime(main, evolution, orbit)
        beyond = bool(np.abs(_shown(evolution)).max() > 1.02 * _largest(evolution, orbit))
        bar: dict[str, Any] = {"aspect": 22, "pad": 0.02, "extend": "both" if beyond else "neither"}
        figure.colorbar(image, ax=main, label=_colour_label(evolution), use_gridspec=False, **bar)
    if profile:
        _draw_profile(figure.add_subplot(grid[0, 0], sharey=main), evolution)
    for row, draw in enumerate(below, start=1):
        last.tick_params(labelbottom=False)
        last = figure.add_subplot(grid[row, -1], sharex=main)
        draw(last, evolution)
    last.set_xlabel(_time_label(evolution))
    if kicked_site is not None and not few:
        main.plot(evolution.t[0], kicked_site, ">", ms=8, mfc="white", mec="black", clip_on=False, zorder=5)
    model = style.title(evolution.model, evolution.parameters)
    figure.suptitle("; ".join(words for words in (title, model) if words))
    return style.finished(figure, (main,) if few else (), FEW_STATES)


def _shown(evolution: Evolution) -> Array:
    """Meaning of the colours: displacements, or the states of a model of first order."""
    return evolution.displacements if evolution.equations.positions else evolution.states


def _colour_label(evolution: Evolution) -> str:
    symbol = "y" if evolution.equations.positions else "x"
    if _is_long(evolution):
        return f"largest $|{symbol}_n|$ in windows of {_window(evolution):.3g}"
    return f"{'displacement' if symbol == 'y' else 'state'} ${symbol}_n(t)$"


def _draw_states(axes: Axes, evolution: Evolution) -> None:
    """The few states as lines, in long runs as the range that each has in each window of time."""
    names, t = evolution.names, evolution.t
    if not _is_long(evolution):
        style.draw_curves(axes, t, dict(zip(map(style.plain, names), evolution.states.T, strict=True)), lw=1.2)
    else:
        for x, name, colour in zip(evolution.states.T, names, style.colours(len(names)), strict=True):
            _draw_range(axes, t, x, color=colour, alpha=0.5, label=style.plain(name))
    words = f"range of states in windows of {_window(evolution):.3g}" if _is_long(evolution) else "states"
    axes.set(xlim=(t[0], t[-1] if t.size > 1 else t[0] + 1.0), ylabel=words)


def draw_spacetime(axes: Axes, evolution: Evolution, orbit: Orbit | None = None) -> QuadMesh:
    """Displacements as colour, time to the right and positions upwards; the returned image takes a colour bar."""
    from matplotlib.ticker import MaxNLocator

    shown, largest = _shown(evolution), _largest(evolution, orbit)
    lowest = -largest
    if _is_long(evolution):
        edges, low, high = _extent(evolution.t, shown)
        y, lowest = np.maximum(-low, high), 0.0
    else:
        every = -(-evolution.t.size // MOST_COLUMNS)
        edges, y = _edges(evolution.t[::every]), shown[::every]
    places = np.arange(shown.shape[1] + 1) + 0.5
    image = axes.pcolormesh(edges, places, y.T, cmap=COLOUR_MAP, vmin=lowest, vmax=largest, rasterized=True)
    rows = style.position_label(evolution.model) if evolution.equations.positions else "state $n$"
    axes.set(xlim=(edges[0], edges[-1]), ylim=(places[0], places[-1]), ylabel=rows)
    axes.tick_params(top=False, right=False, direction="out")
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 4, 5, 10]))
    return image


def _largest(evolution: Evolution, orbit: Orbit | None) -> float:
    """Value of the brightest colour: the range of the orbit, at most the edge of a well beyond which states escape."""
    shown = _shown(evolution)
    if orbit is not None:
        shown = orbit.evaluate(orbit.period * np.arange(EXTENT_PHASES) / EXTENT_PHASES)[:, : shown.shape[1]]
    return min(float(np.abs(shown).max()) or 1.0, evolution.equations.well)


def _draw_profile(axes: Axes, evolution: Evolution) -> None:
    """Displacements at the first time beside the positions that they belong to."""
    y = _shown(evolution)[0]
    n = np.arange(1, y.size + 1)
    axes.axvline(0.0, color="0.45", lw=0.5)
    axes.plot(y, n, marker="o" if y.size <= 60 else "", ms=2.5, lw=0.8, color="black")
    axes.set_xlabel(f"${'y' if evolution.equations.positions else 'x'}_n({evolution.t[0]:g})$")
    axes.xaxis.set_label_position("top")
    axes.tick_params(labelleft=False, labelbottom=False, labeltop=True)
    axes.margins(x=0.15)


def _draw_distance(orbit: Orbit, axes: Axes, evolution: Evolution) -> None:
    """The distance of a motion from an orbit, on a logarithmic scale."""
    from matplotlib.ticker import NullFormatter

    distance = distance_from_orbit(orbit, evolution)
    known = np.isfinite(distance) & (distance > 0.0)
    axes.plot(evolution.t[known], distance[known], lw=0.8, color="black")
    axes.set(yscale="log", ylabel="distance")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_energy(axes: Axes, evolution: Evolution) -> None:
    """Relative change of the energy: in long runs its mean, over the range that it has in each window of time."""
    t, drift = evolution.t, evolution.energy_drift
    axes.axhline(0.0, color="0.6", lw=0.6)
    if _is_long(evolution):
        edges, starts = _draw_range(axes, t, drift, color="0.75"), _starts(t)
        drift = np.add.reduceat(drift, starts) / np.diff(np.append(starts, t.size))
        t = 0.5 * (edges[:-1] + edges[1:])
    axes.plot(t, drift, lw=0.8, color="black")
    axes.set_ylabel(r"$\Delta H\,/\,H$")


# Time ---------------------------------------------------------------------------------------------------------------


def _is_long(evolution: Evolution) -> bool:
    """Whether there are too many oscillations to show, and samples enough to show their extent."""
    if evolution.t.size < 5 * EXTENT_WINDOWS:
        return False
    frequencies = evolution.equations.linear_frequencies
    if frequencies is not None:
        periods = frequencies[0] * (evolution.t[-1] - evolution.t[0]) / (2.0 * np.pi)
    else:  # as often as the states pass their means upwards, the fewest times
        above = evolution.states > evolution.states.mean(axis=0)
        periods = float(np.min(np.count_nonzero(above[1:] & ~above[:-1], axis=0)))
    return bool(periods > MOST_PERIODS)


def _window(evolution: Evolution) -> float:
    """The length of a window of time."""
    return float(evolution.t[-1] - evolution.t[0]) / EXTENT_WINDOWS


def _starts(t: Array) -> NDArray[np.intp]:
    """Place of the first sample of each window that holds one, shape (windows,)."""
    window = np.minimum((EXTENT_WINDOWS * (t - t[0]) / (t[-1] - t[0])).astype(int), EXTENT_WINDOWS - 1)
    return np.asarray(np.unique(window, return_index=True)[1], dtype=np.intp)


def _extent(t: Array, values: Array) -> tuple[Array, Array, Array]:
    """Edges of the windows, and the least and largest of values (time, columns) in each, shape (windows, columns)."""
    starts = _starts(t)
    edges = np.append(t[starts], t[-1])
    return edges, np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def _draw_range(axes: Axes, t: Array, values: Array, **look: Any) -> Array:
    """The range of values (time,) in each window, whose edges are returned."""
    edges, low, high = _extent(t, values[:, None])
    axes.stairs(high[:, 0], edges, baseline=low[:, 0], fill=True, **look)
    return edges


def _edges(t: Array) -> Array:
    """Edges of the cells around times, shape (len(t) + 1,)."""
    if t.size == 1:
        return np.array([t[0], t[0] + 1.0])
    return np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])


def _time_label(evolution: Evolution) -> str:
    """The label of the time axis, with a warning where the fastest linear mode has less than 4 samples a period."""
    apart, frequencies = float(np.max(np.diff(evolution.t), initial=0.0)), evolution.equations.linear_frequencies
    if frequencies is not None and frequencies[1] * apart > 0.5 * np.pi and not _is_long(evolution):
        return f"time $t$ (samples {apart:.3g} apart: oscillations are not resolved)"
    return "time $t$"


# The energy of a lattice in time: by site, its centre, participation number and second moment -------------------------

SPREADING_DECADES = 5.0  # of energies that colours distinguish


def sizes_of(found: Spreading) -> dict[str, Array]:
    """How far the energy has spread, by labels."""
    return {"participation number (sites)": found.participation, "second moment (cells squared)": found.second_moment}


@style.drawn
def spreading_figure(found: Spreading, lattice: Lattice) -> Figure:
    """Energies of the sites in time as colour, and below them three numbers that locate them.

    Arguments:
        found: of a time evolution.
        lattice: that it is one of.

    Returns:
        The figure.
    """
    from matplotlib.colors import LogNorm

    step = max(1, 2 * found.t.size // MOST_COLUMNS)
    energies = np.abs(found.energies[::step]).T
    largest = float(np.max(energies)) or 1.0
    figure = style.blank(6.2, 6.0)
    panels = figure.subplot_mosaic([["a"], ["a"], ["b"], ["c"]], sharex=True)
    numbers, least = np.arange(1, len(energies) + 1), largest * 10.0**-SPREADING_DECADES
    look: dict[str, Any] = {"norm": LogNorm(least, largest), "shading": "nearest", "rasterized": True}
    drawn = panels["a"].pcolormesh(found.t[::step], numbers, np.maximum(energies, least), cmap=COLOUR_MAP, **look)
    panels["a"].set_ylabel("site" if len(lattice.declaration.cells) == 1 else "site, along rows")
    figure.colorbar(drawn, ax=panels["a"], label="energy of the site", use_gridspec=False)
    several = found.centre.shape[1] > 1
    names = [f"along direction {k}" if several else None for k in range(1, 1 + found.centre.shape[1])]
    for place, curves in (("b", dict(zip(names, found.centre.T, strict=True))), ("c", sizes_of(found))):
        style.draw_curves(panels[place], found.t, curves, color="black", lw=0.9)  # type: ignore[arg-type]
    panels["b"].set_ylabel("centre (cell)")
    for place in ("b", "c") if several else ("c",):
        panels[place].legend(loc="best")
    panels["c"].set_ylim(bottom=0.0)
    panels["c"].set_xlabel("time $t$")
    figure.suptitle(style.title(lattice))
    return style.finished(figure, (), 1)
