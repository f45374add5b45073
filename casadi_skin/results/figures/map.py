"""A quantity over one or two parameters: colours from dark to light, so that their order survives in grey."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.results.figures.style import blank, drawn, finished, number, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

COLOUR_MAP = "cividis"  # its lightness rises all the way
CONTOUR_COUNT = 7
FEW_WHOLE_NUMBERS = 6  # whole numbers with a colour each
PANEL_COLUMNS = 3  # of panels
MOST_PANELS = 12
FLAG_WORDS: dict[tuple[float, ...], tuple[str, str]] = {(0.0, 1.0): ("no", "yes")}
Values = NDArray[np.float64]


@dataclass(frozen=True)
class MapAxis:
    """An axis along which a map is drawn."""

    name: str
    values: Values
    log: bool = False


@dataclass(frozen=True)
class Panel:
    """One plane, or one line, of a map: values with NaN where there is none, and whether cells failed.

    Attributes:
        title: values of the parameters that are not drawn along an axis.
        values: shape of the axes.
        failed: the same shape.
        known: where values were computed, the same shape; elsewhere they are those of a neighbour.
        lines: curves drawn over it, shape (points, 2) each.
    """

    title: str
    values: Values
    failed: NDArray[np.bool_]
    known: NDArray[np.bool_]
    lines: Sequence[Values] = ()


@drawn
def map_figure(name: str, title: str, axes: Sequence[MapAxis], panels: Sequence[Panel]) -> Figure:
    """A panel for each value of the parameters that are not along an axis, with one scale of colours.

    Arguments:
        name: the quantity.
        title: of the picture.
        axes: one or two; along the first is drawn to the right.
        panels: the first ones of many.

    Returns:
        The figure; failed cells are crossed out.
    """
    shown = panels[:MOST_PANELS]
    columns = min(len(shown), PANEL_COLUMNS)
    rows = math.ceil(len(shown) / columns)
    figure = blank(1.2 + 3.6 * columns, 0.7 + 3.1 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=len(axes) == 1).ravel().tolist()
    for spare in grid[len(shown) :]:
        spare.set_visible(False)
    draw_maps(grid[: len(shown)], name, axes, shown)
    more = f" (the first {MOST_PANELS} of {len(panels)})" if len(panels) > MOST_PANELS else ""
    figure.suptitle(f"{plain(title)}{more}")
    return finished(figure, grid[: len(shown)], 4)


def draw_maps(places: Sequence[Axes], name: str, axes: Sequence[MapAxis], panels: Sequence[Panel]) -> None:
    """Panels drawn into axes, planes with one bar of colours beside them; failed cells are crossed out."""
    in_plane = len(axes) == 2
    norm, colours, ticks = _scale(np.concatenate([panel.values[np.isfinite(panel.values)] for panel in panels]))
    for place, panel in zip(places, panels, strict=True):
        if in_plane:
            _draw_plane(place, axes, panel, norm, colours, ticks is not None)
        else:
            _draw_line(place, axes[0], panel)
        place.set(xlabel=plain(axes[0].name), ylabel=plain(axes[1].name if in_plane else name))
        if panel.title:
            place.set_title(panel.title)
    if not in_plane:
        return
    label = plain(name).replace("_", " ")
    bar = places[0].figure.colorbar(places[0].collections[0], ax=places, label=label, ticks=ticks)
    bar.ax.minorticks_off()
    words = FLAG_WORDS.get(tuple(ticks or ()))
    if words is not None:
        bar.ax.set_yticklabels(list(words))


def _scale(known: Values) -> tuple[Normalize, Any, list[float] | None]:
    """How values become colours: a colour each where there are few whole ones, which are the ticks then."""
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize

    few = np.unique(known)
    if few.size == 0 or few.size > FEW_WHOLE_NUMBERS or np.any(few != np.round(few)):
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        return Normalize(low, high if high > low else low + 1.0), colormaps[COLOUR_MAP], None
    levels = np.array([0.0, 1.0]) if set(few.tolist()) <= {0.0, 1.0} else few
    middle = 0.5 * (levels[1:] + levels[:-1])
    edges = np.concatenate([[levels[0] - 0.5], middle, [levels[-1] + 0.5]])
    shades = ListedColormap(colormaps[COLOUR_MAP](np.linspace(0.15, 0.95, levels.size)))
    return BoundaryNorm(edges, levels.size), shades, levels.tolist()


def edges_of(axis: MapAxis) -> Values:
    """Ends of the cells round the values of an axis."""
    values = np.log(axis.values) if axis.log else axis.values
    middle = 0.5 * (values[1:] + values[:-1])
    ends = np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])
    return np.asarray(np.exp(ends) if axis.log else ends)


def _draw_plane(place: Axes, axes: Sequence[MapAxis], panel: Panel, norm: Normalize, colours: Any, few: bool) -> None:
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import MaxNLocator

    x, y = axes
    masked = np.ma.masked_invalid(panel.values.T)
    place.pcolormesh(edges_of(x), edges_of(y), masked, norm=norm, cmap=colours, rasterized=True)
    place.set(facecolor="white", xscale="log" if x.log else "linear", yscale="log" if y.log else "linear")
    finite = panel.values[np.isfinite(panel.values)]
    if not few and finite.size > 3 and finite.min() < finite.max() and min(panel.values.shape) > 1:
        _draw_contours(place, axes, panel)
    if np.any(panel.failed):
        i, j = np.nonzero(panel.failed)
        place.plot(x.values[i], y.values[j], "x", color="#c02020", ms=4.0, mew=0.9, label="failed or ended early")
    _draw_boundary(place, panel.lines)
    for axis, values in ((place.xaxis, x.values), (place.yaxis, y.values)):
        if np.all(values == np.round(values)):
            axis.set_major_locator(MaxNLocator(integer=True))
    if np.any(~np.isfinite(panel.values) & ~panel.failed):
        place.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, fc="white", ec="0.5", lw=0.6, label="none"))
    box = edges_of(x), edges_of(y)
    place.set(xlim=sorted((box[0][0], box[0][-1])), ylim=sorted((box[1][0], box[1][-1])))


def _draw_boundary(place: Axes, lines: Sequence[Values]) -> None:
    """Curves in black and white, which show on every colour; lines of one point are points."""
    for line in (line for line in lines if len(line) > 1):
        place.plot(*line.T, "-", color="black", lw=2.2, label="boundary of stability")
        place.plot(*line.T, "--", color="white", lw=0.9)
    points = [line for line in lines if len(line) == 1]
    if points:
        look: dict[str, Any] = {"color": "black", "mfc": "white", "mew": 0.7, "ms": 3.0}
        place.plot(*np.concatenate(points).T, "o", label="boundary, at one place", **look)


def _draw_contours(place: Axes, axes: Sequence[MapAxis], panel: Panel) -> None:
    """Contour lines, through computed cells alone."""
    x, y = axes
    look: dict[str, Any] = {"colors": "white", "linewidths": 0.6}
    if np.all(panel.known):
        lines: Any = place.contour(x.values, y.values, np.ma.masked_invalid(panel.values.T), CONTOUR_COUNT, **look)
    else:
        i, j = np.nonzero(panel.known & np.isfinite(panel.values))
        places = np.stack([x.values[i], y.values[j]])
        extents = np.ptp(places, axis=1, keepdims=True)
        if np.linalg.matrix_rank((places - places[:, :1]) / np.where(extents > 0.0, extents, 1.0)) < 2:
            return  # points on one line have no triangles between them
        lines = place.tricontour(places[0], places[1], panel.values[i, j], CONTOUR_COUNT, **look)
    place.clabel(lines, fontsize=7, fmt="%.3g")


def _draw_line(place: Axes, axis: MapAxis, panel: Panel) -> None:
    known = np.isfinite(panel.values)
    place.plot(axis.values[known], panel.values[known], "o-", ms=3.0, lw=0.9, color="black")
    place.set_xscale("log" if axis.log else "linear")
    if np.any(panel.failed):
        at = axis.values[panel.failed]
        span: dict[str, Any] = {"transform": place.get_xaxis_transform(), "color": "#c02020"}
        place.plot(at, np.full(at.size, 0.03), "x", ms=5.0, label="failed or ended early", clip_on=False, **span)


def panel_title(names: Sequence[str], values: Sequence[Any]) -> str:
    """Values of parameters as a title."""
    shown = [f"${number(v)}$" if isinstance(v, int | float) else plain(str(v)) for v in values]
    return ", ".join(f"{plain(name)} = {value}" for name, value in zip(names, shown, strict=True))
