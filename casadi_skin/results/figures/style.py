"""Common style of all pictures: settings, layout, titles, colours, and files whose bytes depend on the data alone."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.results.figures.formulas import write_in_letters
from casadi_skin.results.figures.layout import lay_out
from casadi_skin.results.figures.png import write_png
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from contextlib import _GeneratorContextManager

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.family import Family

MOST_VALUES = 6  # of parameters in a title
DPI = 200  # of pictures as PNG
WIDEST = 8.3  # inches: 9 points are 7 at the width of a page, 6.5 inches
DATED = {"svg": "Date", "pdf": "CreationDate"}  # formats, and their name of the date, which is left out
AMPLITUDE = r"total amplitude $S = \Vert y\Vert^2$"

DASHES: tuple[Any, ...] = ("-", (0, (5.0, 1.6)), (0, (1.0, 1.2)), (0, (5.0, 1.4, 1.0, 1.4)), (0, (3.0, 3.0)),
                           (0, (1.0, 3.0)))  # fmt: skip


def style() -> _GeneratorContextManager[None]:
    """The settings in which figures are made and saved, whatever the caller's are; a context, or `@style()`."""
    import matplotlib.style

    return matplotlib.style.context(_settings(), after_reset=True)


@cache
def _settings() -> dict[str, Any]:
    """The style sheet, read once."""
    import matplotlib

    sheet = files("casadi_skin.results.figures") / "house.mplstyle"
    with as_file(sheet) as path:
        return dict(matplotlib.rc_params_from_file(path, use_default_template=False).items())


def blank(width: float, height: float) -> Figure:
    """An empty figure, no wider than lets its text be read on a page; `finished` lays it out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(min(width, WIDEST), height))


def finished(
    figure: Figure, panels: Iterable[Axes], columns: int, in_black: bool = False, plain: bool = False
) -> Figure:
    """The figure with one legend of all panels below them, laid out; in black where colours distinguish families.

    `plain` is as in `figures.layout.lay_out`.
    """
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        legend = figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)
        for line in legend.get_lines() if in_black else ():
            line.set(color="black", markeredgecolor="black")
    write_in_letters(figure)
    lay_out(figure, DPI, plain)
    return figure


def number(value: float, digits: int = 6) -> str:
    """The number as it stands in a formula."""
    if value == np.inf:
        return r"\infty"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return rf"{mantissa}\times 10^{{{int(exponent)}}}" if exponent else mantissa


def plain(name: str) -> str:
    """A name that a user chose, without mathematics in it."""
    return name.replace("$", r"\$")


def title(model: Any, parameters: Mapping[str, float] | None = None, name: str = "") -> str:
    """A model in words: symbols and values of one that has symbols, as a chain, else its name and parameters.

    `name` stands in place of the name of an `OdeModel`; parameters that are None are its nominal ones.
    """
    if not isinstance(model, OdeModel):
        return ", ".join(f"${symbol} = {number(value)}$" for symbol, value in model.labels) + " (dimensionless)"
    if parameters is None:
        parameters = dict(zip(model.parameter_names, model.nominal or (), strict=False))
    known = [(key, parameters[key]) for key in model.parameter_names if key in parameters][:MOST_VALUES]
    values = ", ".join(f"{plain(key)} = ${number(value)}$" for key, value in known)
    return ": ".join(words for words in (plain(name or model.name), values) if words)


def position_label(model: Any) -> str:
    """Axis label of the positions of a model."""
    return "position $n$" if isinstance(model, OdeModel) else "site $n$"


def colours(count: int) -> Array:
    """Colours from dark to light, so that their order survives in grey, shape (count, 4)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(0.05 if count > 1 else 0.4, 0.8, count)))


def common_model(branches: Sequence[Branch]) -> tuple[Any, Mapping[str, float]]:
    """The model of families and its parameters; raises ValueError where it is not one."""
    models = {(b.space.model, tuple(family(b).coordinates.parameters.items())) for b in branches}
    if len(models) != 1:
        raise ValueError(f"branches: given branches of {len(models)} models; accepted: one or more, all of one model")
    model, parameters = models.pop()
    return model, dict(parameters)


def family(branch: Branch) -> Family:
    """The family of a branch; raises ValueError for another branch."""
    from casadi_skin.follow.family import Family

    if not isinstance(branch.space, Family):
        raise ValueError(f"branches: given a branch in {branch.parameter}; accepted: families")
    return branch.space


def amplitude_label(model: Any) -> str:
    """Axis label of S."""
    return AMPLITUDE if is_sum_of_squares(model) else "amplitude $S$"


def is_sum_of_squares(model: Any) -> bool:
    """Whether S is the sum of squares of the positions, as in every model without a normalisation of its own."""
    return not isinstance(model, OdeModel) or model.normalisation is None


def number_sites(axes: Axes, first: int, last: int, label: str) -> None:
    """Whole numbers along the axis, from `first` to `last`."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=(first - 0.5, last + 0.5), xlabel=label)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))


def save(figure: Figure, stem: Path, formats: Iterable[str] = ("png",)) -> list[Path]:
    """Write `stem`.png, or the formats named, each replaced atomically, and return their paths.

    The bytes depend on the figure alone. Raises OSError where the folder does not exist or cannot be written to.
    """
    paths = []
    for kind in formats:
        path = stem.with_name(f"{stem.name}.{kind}")
        temporary = stem.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            with style():
                _write(figure, temporary, kind)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        paths.append(path)
    return paths


def _write(figure: Figure, path: Path, kind: str) -> None:
    if kind in DATED:
        figure.savefig(path, format=kind, dpi=DPI, metadata={DATED[kind]: None})
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = figure.canvas  # its methods have no types
    before = figure.get_dpi()
    if not isinstance(canvas, FigureCanvasAgg):
        canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    canvas.draw()  # savefig copies the pixels twice
    with path.open("wb") as stream:
        write_png(stream, np.asarray(canvas.buffer_rgba()), DPI)
    figure.set_dpi(before)
