"""Any result as lines for print, as a data frame, as a dataset, drawn into axes, and as a table in a notebook.

pandas and xarray are extras that are imported on first use; a branch has its table from its quantities.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.model.arguments import check_options, cut, needs_extra, short_repr
from casadi_skin.points.diagram import Diagram
from casadi_skin.results import analyses, solutions  # noqa: F401  they register how results are shown
from casadi_skin.results.dataset import Dataset, Variable, branch_to_xarray, to_xarray
from casadi_skin.results.figures.style import blank, finished, legend_once, style
from casadi_skin.results.quantities import columns_of, places_of
from casadi_skin.results.words import Rows, show

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

LONGEST_VALUE = 100  # characters of a value


def described(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows, each value cut to a line; raises TypeError for other objects."""
    shown = show(result)
    return shown.title, [(name, cut(value, LONGEST_VALUE)) for name, value in shown.rows]


def lines(result: Any) -> str:
    """A result in a few lines."""
    head, rows = described(result)
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([head, *(f"  {name:<{width}}  {value}" for name, value in rows)])


def to_dataframe(result: Any) -> pandas.DataFrame:
    """A result as a pandas DataFrame; raises ImportError, naming the extra, without pandas."""
    with needs_extra("pandas", "pandas"):
        import pandas
    if isinstance(result, Branch):
        columns = columns_of(result)
        return pandas.DataFrame([{q.name: q.of(place) for q in columns} for place in places_of(result)])
    if isinstance(result, Diagram):
        frames = [to_dataframe(branch).assign(branch=n) for n, branch in enumerate(result.branches, start=1)]
        return pandas.concat(frames, ignore_index=True)
    return pandas.DataFrame(show(result).columns())


def to_dataset(result: Any) -> xarray.Dataset:
    """A result as an xarray Dataset: branches along `point`, states along `t`, multipliers along their number."""
    if isinstance(result, Branch):
        return branch_to_xarray(result)
    if isinstance(result, Diagram):
        words = "given a diagram, whose branches have dimensions of their own"
        raise ValueError(f"to_xarray: {words}; accepted: one branch")
    shown = show(result)
    columns = shown.columns()
    index = next(iter(columns))
    along = [Variable(name, (index,), np.asarray(values), name) for name, values in columns.items()]
    return to_xarray(Dataset(along, {"title": shown.meaning}), (index,))


def plot(result: Any, axes: Axes | None = None, **options: Any) -> Axes:
    """Draw a result into axes, new ones of pyplot by default, and return them; see `Result.plot`."""
    from matplotlib.axes import Axes

    shown = show(result)
    check_options("plot", options, shown.draw)
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    legend_once(axes, shown.draw(axes, **options) or 1)
    return axes


def html_table(result: Any) -> str:
    """A result as a small table beside its picture, for notebooks."""
    return page(*described(result), lambda axes: plot(result, axes))


def page(head: str, rows: Rows, draw: Callable[[Axes], object]) -> str:
    """Rows as a small table beside the picture that a function draws into axes; without it where that refuses."""
    cells = "".join(f"<tr><th>{html.escape(n)}</th><td>{html.escape(v)}</td></tr>" for n, v in rows)
    table = f"<table><caption>{html.escape(head)}</caption>{cells}</table>"
    return f'<div style="display:flex;gap:2em;align-items:center">{table}{_picture(head, draw)}</div>'


def _picture(head: str, draw: Callable[[Axes], object]) -> str:
    """A picture as part of a page; nothing where there is none."""
    with style():
        figure, stream = blank(4.2, 2.8), io.BytesIO()
        try:
            draw(figure.add_subplot())
        except (ValueError, ArithmeticError):
            return ""
        finished(figure, (), 1).savefig(stream, format="png", dpi=110)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{html.escape(head)}" src="data:image/png;base64,{data}">'
