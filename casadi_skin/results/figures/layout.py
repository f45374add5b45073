"""Places of panels in a figure: by constrained layout, or, which is quicker, from the sizes of texts alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text

GAP = 4.0  # points between panels, and around all
POINTS = 72.0  # in an inch
TICK_PAD, TITLE_PAD = 3.5, 6.0  # points between an axis and its labels, as matplotlib has them
OFFSET_HEIGHT = 13.0  # points: of the power of ten above an axis


def lay_out(figure: Figure, dpi: float, plain: bool) -> None:
    """Place the panels of a figure once and for all, so that no engine does it again when it is saved.

    Arguments:
        figure: the figure; its legend is at its lower edge.
        dpi: the resolution of its pictures: texts are parsed once for a resolution.
        plain: whether panels stand in one grid, with ticks below and at the left, and nothing outside of them but
            labels, titles and annotations: sizes of texts give their places, where constrained layout draws twice.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    canvas, before = FigureCanvasAgg(figure), figure.get_dpi()
    figure.set_dpi(dpi)
    renderer: Any = canvas.get_renderer()  # type: ignore[no-untyped-call]
    renderer.mathtext_parser = _parser()
    if plain:
        ruler = _Ruler(figure, renderer)
        for _ in range(2):  # ticks depend on places
            _place(figure, ruler)
    else:
        ConstrainedLayoutEngine().execute(figure)
    figure.set_dpi(before)
    for axes in figure.axes:  # the layout's last digits depend on where things lie in memory, and name clip paths
        box = np.round(axes.get_position(original=True).bounds, 9)
        axes.set_position((float(box[0]), float(box[1]), float(box[2]), float(box[3])))


@cache
def _parser() -> Any:
    """One parser of formulas for all figures, which keeps those it has parsed: each takes milliseconds."""
    from matplotlib.backends.backend_agg import RendererAgg

    return RendererAgg(1, 1, POINTS).mathtext_parser  # type: ignore[no-untyped-call]


class _Ruler:
    """Widths and heights in points of the texts of a figure, which do not depend on places: each is measured once."""

    def __init__(self, figure: Figure, renderer: Any) -> None:
        self.figure, self.renderer, self.points = figure, renderer, figure.dpi / POINTS
        self._known: dict[Any, tuple[float, float]] = {}

    def of(self, artist: Text | Legend) -> tuple[float, float]:
        """Of a text or a legend."""
        if artist not in self._known:
            self._known[artist] = self._measured(artist)
        return self._known[artist]

    def of_tick(self, label: str) -> tuple[float, float]:
        """Of the label of a tick."""
        from matplotlib.text import Text

        if label not in self._known:
            self._known[label] = self._measured(Text(text=label, figure=self.figure))
        return self._known[label]

    def _measured(self, artist: Text | Legend) -> tuple[float, float]:
        box = artist.get_window_extent(self.renderer)
        return box.width / self.points, box.height / self.points


def _place(figure: Figure, ruler: _Ruler) -> None:
    """Places of all panels, and of the title of the figure."""
    width, height = figure.bbox.width / ruler.points, figure.bbox.height / ruler.points
    bottom = sum(ruler.of(legend)[1] + GAP for legend in figure.legends)
    for title in figure.texts:  # the title alone
        title.set_y(1.0 - GAP / height)
        height -= ruler.of(title)[1] + GAP
    specs = [spec for axes in figure.axes if (spec := axes.get_subplotspec()) is not None]
    grid, rooms = specs[0].get_gridspec(), np.array([_room(axes, ruler) for axes in figure.axes])
    columns, rows = [spec.colspan for spec in specs], [spec.rowspan for spec in specs]
    across = _spread(width, columns, rooms[:, :2], grid.get_width_ratios())
    down = height - _spread(height - bottom, rows, rooms[:, 2:], grid.get_height_ratios())
    whole = figure.bbox.height / ruler.points
    for axes, (left, right), (upper, lower) in zip(figure.axes, across, down, strict=True):
        axes.set_position((left / width, lower / whole, (right - left) / width, (upper - lower) / whole))


def _spread(length: float, spans: Sequence[range], rooms: Array, ratios: Any) -> Array:
    """Start and end of panels along one direction, shape (panels, 2).

    Arguments:
        length: of all, in points.
        spans: the cells of each panel.
        rooms: space that each panel needs before and after it, in points, shape (panels, 2).
        ratios: of the lengths of cells.
    """
    before, after = np.zeros(len(ratios)), np.zeros(len(ratios))
    for span, (ahead, behind) in zip(spans, rooms, strict=True):
        before[span[0]] = max(before[span[0]], ahead + GAP)
        after[span[-1]] = max(after[span[-1]], behind)
    cells = (length - GAP - before.sum() - after.sum()) * np.asarray(ratios) / np.sum(ratios)
    ends = np.cumsum(before + cells + after) - after
    return np.array([(ends[span[0]] - cells[span[0]], ends[span[-1]]) for span in spans])


def _room(axes: Axes, ruler: _Ruler) -> tuple[float, float, float, float]:
    """Space for labels at the left, right, upper and lower side of a panel, in points."""
    from matplotlib.text import Annotation, Text
    from matplotlib.transforms import ScaledTranslation

    x, y, inches = axes.xaxis, axes.yaxis, axes.get_figure().dpi_scale_trans  # type: ignore[union-attr]
    (wide, low), (left, high) = _ticks(x, ruler), _ticks(y, ruler)
    beside, below = left + y.labelpad, low + x.labelpad
    y.set_label_coords(0.0, 0.5, axes.transAxes + ScaledTranslation(-beside / POINTS, 0.0, inches))
    x.set_label_coords(0.5, 0.0, axes.transAxes + ScaledTranslation(0.0, -below / POINTS, inches))
    titles = [text for text in axes.get_children() if isinstance(text, Text) and text not in axes.texts]
    above = [ruler.of(title)[1] + TITLE_PAD for title in titles if title.get_text()]
    outside = [text for text in axes.texts if isinstance(text, Annotation) and text.get_annotation_clip() is False]
    beyond = [(text.get_window_extent(ruler.renderer).x1 - axes.bbox.x1) / ruler.points for text in outside]
    return (
        beside + ruler.of(y.label)[0] if axes.get_ylabel() else left,
        max(0.5 * wide, *beyond, 0.0),
        max(above, default=0.5 * high) + OFFSET_HEIGHT * bool(y.get_major_formatter().get_offset()),
        below + ruler.of(x.label)[1] if axes.get_xlabel() else low,
    )


def _ticks(axis: Axis, ruler: _Ruler) -> tuple[float, float]:
    """Width and height of the largest label of the ticks of an axis in points, with their distance from the axis."""
    if not any(axis.get_tick_params().get(name) for name in ("labelbottom", "labelleft")):
        return 0.0, 0.0
    low, high = sorted(axis.get_view_interval())
    sizes = [(0.0, 0.0)]
    for places, formatter in (
        (axis.get_majorticklocs(), axis.get_major_formatter()),
        (axis.get_minorticklocs(), axis.get_minor_formatter()),
    ):
        labels = formatter.format_ticks(list(places))
        shown = {label for label, place in zip(labels, places, strict=True) if label and low <= place <= high}
        sizes += [ruler.of_tick(label) for label in shown]
    (width, height), along = np.max(sizes, axis=0), axis is axis.axes.xaxis
    return float(width) + TICK_PAD * (not along), float(height) + TICK_PAD * along
