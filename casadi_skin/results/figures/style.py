"""Common style of all pictures: settings, layout, titles, colours, legends, and files that depend on the data alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.resources import as_file, files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.model.files import replacing
from casadi_skin.model.interrupts import P, T
from casadi_skin.model.result import TURN, in_turn
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch

MARKED_SITES = 60  # profiles of longer lattices are lines without markers, of the positions that move
MOST_VALUES = 6  # of parameters in a title
PNG_DPI = 200  # of pictures as PNG
WIDEST_INCHES = 8.3  # inches: 9 points are 7 at the width of a page, 6.5 inches
PNG_LEVEL = 1  # of compression: the sixth, which is usual, takes half as long again and saves a tenth of the bytes
LEFT_OUT = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}  # formats, and what in them is not the figure's
AMPLITUDE_LABEL = r"total amplitude $S = \Vert y\Vert^2$"

LINE_DASHES: tuple[Any, ...] = ("-", (0, (5.0, 1.6)), (0, (1.0, 1.2)), (0, (5.0, 1.4, 1.0, 1.4)), (0, (3.0, 3.0)),
                           (0, (1.0, 3.0)))  # fmt: skip


@contextmanager
def style() -> Iterator[None]:
    """The settings in which figures are made and saved, whatever the caller's are; a context, or `@style()`.

    They are those of the process: one thread has them at a time.
    """
    import matplotlib.style

    held = list[bool]()
    try:  # as `holding` has it
        held.extend(map(TURN.acquire, (True,)))
        with matplotlib.style.context(_settings(), after_reset=True):
            yield
    finally:
        if held:
            TURN.release()


def drawn(draw: Callable[P, T]) -> Callable[P, T]:
    """A function that makes a figure, for one thread at a time and in the settings of `style`."""
    return in_turn(style()(draw))


@cache
def _settings() -> dict[str, Any]:
    """The style sheet, read once."""
    import matplotlib

    sheet = files("casadi_skin") / "house.mplstyle"
    with as_file(sheet) as path:
        return dict(matplotlib.rc_params_from_file(path, use_default_template=False).items())


def blank(width: float, height: float) -> Figure:
    """An empty figure, no wider than lets its text be read on a page; `finished` lays it out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(min(width, WIDEST_INCHES), height), dpi=PNG_DPI)


def finished(figure: Figure, panels: Iterable[Axes], columns: int, in_black: bool = False) -> Figure:
    """The figure with one legend of all panels below them, laid out; in black where colours distinguish families."""
    handles = {label: found[0] for label, found in _labelled(panels).items()}
    if handles:
        legend = figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)
        for line in legend.get_lines() if in_black else ():
            line.set(color="black", markeredgecolor="black")
    lay_out(figure)
    return figure


def lay_out(figure: Figure) -> None:
    """Place the panels of a figure once and for all by constrained layout: no engine does it again on each drawing."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    renderer: Any = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    renderer.mathtext_parser = _parser()
    # a panel of fixed shape may leave part of its cell free: labels there got no room, which it needs once it has grown
    of_fixed_shape = any(axes.get_box_aspect() or axes.get_aspect() != "auto" for axes in figure.axes)
    for _ in range(2 if of_fixed_shape else 1):
        ConstrainedLayoutEngine().execute(figure)
    for axes in figure.axes:  # the layout's last digits depend on where things lie in memory, and name clip paths
        x, y, width, height = np.round(axes.get_position(original=True).bounds, 9).tolist()
        axes.set_position((x, y, width, height))


@cache
def _parser() -> Any:
    """One parser of formulas for all figures, which keeps those it has parsed: each takes milliseconds."""
    from matplotlib.backends.backend_agg import RendererAgg

    return RendererAgg(1, 1, PNG_DPI).mathtext_parser  # type: ignore[no-untyped-call]


def _labelled(panels: Iterable[Axes]) -> dict[str, list[Artist]]:
    """All that is drawn under each label of a legend."""
    handles: dict[str, list[Artist]] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, []).append(handle)
    return handles


def legend_once(axes: Axes, columns: int = 1) -> None:
    """A legend in which each label stands once, together with earlier lines: in black where their colours differ."""
    labelled = _labelled([axes])
    if not labelled:
        return
    look: dict[str, Any] = {"frameon": True, "framealpha": 0.8, "edgecolor": "none", "fontsize": "small"}
    legend = axes.legend([found[0] for found in labelled.values()], labelled, ncols=columns, **look)
    for handle, found in zip(legend.legend_handles, labelled.values(), strict=True):
        colours = {str(line.get_color()) for line in found if hasattr(line, "get_color")}
        if len(colours) > 1 and handle is not None:
            handle.set(color="black")


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
    if model.labels:
        return ", ".join(f"${symbol} = {number(value)}$" for symbol, value in model.labels) + " (dimensionless)"
    if parameters is None:
        parameters = dict(zip(model.parameter_names, model.nominal or (), strict=False))
    known = [(key, parameters[key]) for key in model.parameter_names if key in parameters][:MOST_VALUES]
    values = ", ".join(f"{plain(key)} = ${number(value)}$" for key, value in known)
    return ": ".join(words for words in (plain(name or model.name), values) if words)


def position_label(model: Any) -> str:
    """Axis label of the positions of a model."""
    return f"{model.place} $n$"


def colours(count: int) -> Array:
    """Colours from dark to light, so that their order survives in grey, shape (count, 4)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(0.05 if count > 1 else 0.4, 0.8, count)))


def next_colour(axes: Axes) -> Any:
    """That of the next line, as `axes.plot` takes."""
    return axes._get_lines.get_next_color()  # type: ignore[attr-defined]


def draw_curves(axes: Axes, x: Array, curves: Mapping[str, Any], in_cycle: bool = False, **look: Any) -> None:
    """Curves over x with labels, told apart by dashes and by colours: from dark to light, or those of the axes."""
    shades = [None] * len(curves) if in_cycle else colours(len(curves))
    for k, ((label, values), colour) in enumerate(zip(curves.items(), shades, strict=True)):
        axes.plot(x, values, ls=LINE_DASHES[k % len(LINE_DASHES)], label=label, **{"color": colour, **look})


def common_model(branches: Sequence[Branch]) -> tuple[Any, Mapping[str, float]]:
    """The model of families and its parameters; raises ValueError where it is not one."""
    models = {(b.space.model, tuple(family(b).coordinates.parameters.items())) for b in branches}
    if len(models) != 1:
        raise ValueError(f"branches: given branches of {len(models)} models; accepted: one or more, all of one model")
    model, parameters = models.pop()
    return model, dict(parameters)


def family(branch: Branch) -> Any:
    """The family of a branch; raises ValueError for another branch."""
    if not branch.space.is_family:
        raise ValueError(f"branches: given a branch in {branch.parameter}; accepted: families")
    return branch.space


def amplitude_label(model: Any) -> str:
    """Axis label of S."""
    return AMPLITUDE_LABEL if is_sum_of_squares(model) else "amplitude $S$"


def is_sum_of_squares(model: Any) -> bool:
    """Whether S is the sum of squares of the positions, as in every model without a normalisation of its own."""
    return model.normalisation is None


def moving(profiles: Array) -> tuple[int, int]:
    """First and last position where profiles (some, positions) exceed 1e-3 of their largest; all of a short lattice."""
    largest = np.max(np.abs(profiles), axis=1, keepdims=True)
    seen = np.flatnonzero(np.any(np.abs(profiles) > 1e-3 * largest, axis=0)) + 1
    sites = profiles.shape[1]
    return (int(seen[0]), int(seen[-1])) if sites > MARKED_SITES else (1, sites)


def number_sites(axes: Axes, first: int, last: int, label: str) -> None:
    """Whole numbers along the axis, from `first` to `last`."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=(first - 0.5, last + 0.5), xlabel=label)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))


@in_turn
def save(figure: Figure, stem: Path, formats: Iterable[str] = ("png",)) -> list[Path]:
    """Write `stem`.png, or the formats named, each replaced atomically, and return their paths.

    The bytes depend on the figure alone. Raises OSError where the folder does not exist or cannot be written to.
    """
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    for path in paths:
        drawn = BytesIO()
        with style():
            _draw(figure, path.suffix[1:], drawn)
        with replacing(path) as temporary:  # drawn before, so that a process that is killed leaves nothing
            temporary.write_bytes(drawn.getvalue())
    return paths


def _draw(figure: Figure, kind: str, stream: BytesIO) -> None:
    packed: dict[str, Any] = {"pil_kwargs": {"compress_level": PNG_LEVEL}} if kind == "png" else {}
    figure.savefig(stream, format=kind, dpi=PNG_DPI, metadata={LEFT_OUT[kind]: None}, **packed)
