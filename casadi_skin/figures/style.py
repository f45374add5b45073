"""What all pictures share: settings, layout, titles, colours, and saving so that bytes depend on the data alone."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.lattice.chain import Chain

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcStyleType

    from casadi_skin.orbits.branch import Branch

AMPLITUDE = r"total amplitude $S = \Vert y\Vert^2$"


def style() -> AbstractContextManager[None]:
    """The settings in which figures are made and saved, whatever the caller's are."""
    import matplotlib.style

    settings: RcStyleType = {
        "font.family": "STIXGeneral", "mathtext.fontset": "stix", "font.size": 10.0, "axes.titlesize": 10.0,
        "figure.titlesize": 10.0, "legend.fontsize": 9.0, "legend.frameon": False, "axes.linewidth": 0.7,
        "axes.formatter.use_mathtext": True, "axes.formatter.limits": (-3, 4), "svg.hashsalt": "casadi_skin",
        "xtick.direction": "in", "ytick.direction": "in", "xtick.top": True, "ytick.right": True,
    }  # fmt: skip
    return matplotlib.style.context(settings, after_reset=True)


def blank(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def finished(figure: Figure, panels: Iterable[Axes], columns: int, in_black: bool = False) -> Figure:
    """The figure with one legend of all panels below them, laid out; in black where colours tell families apart."""
    handles: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if handles:
        legend = figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=columns)
        for line in legend.get_lines() if in_black else ():
            line.set(color="black", markeredgecolor="black")
    engine = figure.get_layout_engine()
    if engine is not None:  # once and for all: laying out is slow, and makes the ticks while the style is set
        engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:  # the layout's last digits depend on where things lie in memory, and name clip paths
        box = np.round(axes.get_position(original=True).bounds, 9)
        axes.set_position((float(box[0]), float(box[1]), float(box[2]), float(box[3])))
    return figure


def number(value: float, digits: int = 6) -> str:
    """The number as it stands in a formula."""
    if value == np.inf:
        return r"\infty"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return rf"{mantissa}\times 10^{{{int(exponent)}}}" if exponent else mantissa


def title(chain: Chain) -> str:
    values = (("N", chain.sites), (r"\alpha", chain.alpha), (r"\gamma", chain.gamma), ("g", chain.g))
    return ", ".join(f"${name} = {number(value)}$" for name, value in values) + " (dimensionless)"


def colours(count: int) -> Array:
    """Colours from dark to light, so that their order survives in grey, shape (count, 4)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(0.05 if count > 1 else 0.4, 0.8, count)))


def common_chain(branches: Sequence[Branch]) -> Chain:
    chains = {branch.space.model for branch in branches}
    if len(chains) != 1:
        raise ValueError(f"branches: given branches of {len(chains)} chains; accepted: one or more, all of one chain")
    return chains.pop()


def number_sites(axes: Axes, first: int, last: int, label: str) -> None:
    """Whole numbers along the axis, from `first` to `last`."""
    from matplotlib.ticker import MaxNLocator

    axes.set(xlim=(first - 0.5, last + 0.5), xlabel=label)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1, steps=[1, 2, 5, 10]))


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.svg, each replaced atomically, and return their paths.

    The bytes depend on the figure alone. Raises OSError where the folder does not exist or cannot be written to.
    """
    paths = []
    for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        path = stem.with_name(f"{stem.name}.{kind}")
        temporary = stem.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            with style():
                figure.savefig(temporary, format=kind, dpi=200, metadata=metadata)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        paths.append(path)
    return paths
