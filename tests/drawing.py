"""Runs without the work of drawing, nine tenths of a small one; and what overlaps in a picture."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Bbox


def blank_pictures(patch: pytest.MonkeyPatch) -> None:
    """Empty files in place of pictures and films."""
    from matplotlib.figure import Figure  # here: numpy comes with it, after the number of threads is set

    drawn_savefig = Figure.savefig

    def write(drawn: Any, path: Any, *rest: Any, **more: Any) -> None:
        if not isinstance(path, (str, Path)):  # drawn into memory, where it may be kept for other tests: an FMU's icon
            drawn_savefig(drawn, path, *rest, **more)
            return
        Path(path).touch()
        drawn._draw_was_started = True  # a film that was not drawn warns

    patch.setattr("matplotlib.figure.Figure.savefig", write)
    blank = "casadi_skin.results.figures.style._draw"
    patch.setattr(blank, lambda drawn, *_: setattr(drawn, "_draw_was_started", True))
    patch.setattr("matplotlib.animation.Animation.save", write)
    patch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: None)
    patch.setattr("casadi_skin.results.figures.style.lay_out", lambda *_: None)


def lines(axes: Axes, label: str) -> list[Line2D]:
    """Lines of a label."""
    return [line for line in axes.get_lines() if line.get_label() == label]


def points(line: Line2D) -> Any:
    """Points of a line, shape (points, 2)."""
    return line.get_xydata()


def legend_labels(figure: Figure) -> set[str]:
    """Labels of the legend of all panels."""
    return {text.get_text() for text in figure.legends[0].get_texts()}


def stretches(lines: Iterable[Line2D]) -> list[Line2D]:
    """Lines without gaps, in place of those that have some, which keep their looks and labels."""
    import numpy as np
    from matplotlib.lines import Line2D

    found = []
    for line in lines:
        points = np.asarray(line.get_xydata())
        gaps = np.flatnonzero(np.isnan(points[:, 0]))
        for part in np.split(points, gaps):
            kept = part[~np.isnan(part[:, 0])]
            found.append(Line2D(*kept.T, color=line.get_color(), ls=line.get_linestyle(), label=str(line.get_label())))
    return found


def texts(figure: Figure) -> dict[tuple[str, str], Bbox]:
    """Boxes of all that a drawn figure shows outside of its panels, by panel and words; ticks of an axis together."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    figure.canvas.draw()
    boxes = {("figure", str(artist)): artist.get_window_extent() for artist in (*figure.texts, *figure.legends)}
    for name, axes in enumerate(figure.axes):
        titles = [child for child in axes.get_children() if isinstance(child, Text) and child not in axes.texts]
        outside = [text for text in axes.texts if text.get_window_extent().x0 > axes.bbox.x1]
        powers = [axes.xaxis.get_offset_text(), axes.yaxis.get_offset_text()]
        shown = [t for t in (axes.xaxis.label, axes.yaxis.label, *titles, *outside, *powers) if t.get_text()]
        boxes |= {(str(name), str(text)): text.get_window_extent() for text in shown}
        for axis in (axes.xaxis, axes.yaxis):
            ticks = [tick.label1 for tick in axis._update_ticks()]  # type: ignore[attr-defined]
            labels = [tick.get_window_extent() for tick in ticks if tick.get_visible() and tick.get_text()]
            if labels:
                boxes[str(name), f"ticks of {axis}"] = Bbox.union(labels)
    return boxes


def overlaps(figure: Figure) -> list[tuple[tuple[str, str], object]]:
    """Pairs of texts that overlap, and texts that a panel covers or that leave the figure."""
    boxes = texts(figure)
    pairs = [(a, b) for a, b in itertools.combinations(boxes, 2) if _meet(boxes[a], boxes[b]) and not _at_corner(a, b)]
    panels = [axes.get_window_extent() for axes in figure.axes]
    covered = [(a, "a panel") for a, box in boxes.items() if any(_meet(box, panel) for panel in panels)]
    page = figure.bbox.padded(0.5)
    out = [(a, "the edge") for a, box in boxes.items() if not all(page.contains(*corner) for corner in box.corners())]
    return [*pairs, *covered, *out]


def _meet(one: Bbox, other: Bbox) -> bool:
    from matplotlib.transforms import Bbox

    common = Bbox.intersection(one, other)
    return common is not None and min(common.width, common.height) > 0.5  # of a pixel


def _at_corner(one: tuple[str, str], other: tuple[str, str]) -> bool:
    """Whether these are the ticks of the two axes of a panel: boxes of the two zeros where axes meet overlap."""
    return one[0] == other[0] and all(words.startswith("ticks") for _, words in (one, other))
