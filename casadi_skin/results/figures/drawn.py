"""Any result drawn into axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from casadi_skin.model.arguments import check_options, short_repr
from casadi_skin.results.figures import drawing, drawing_analyses
from casadi_skin.results.figures.drawing import draw

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REGISTERED = drawing, drawing_analyses  # modules whose functions `draw` calls once they are loaded


def plot(result: Any, axes: Axes | None = None, **options: Any) -> Axes:
    """Draw a result into axes, new ones of pyplot by default, and return them; see `Result.plot`."""
    from matplotlib.axes import Axes

    check_options("plot", options, draw.dispatch(type(result)))
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    draw(result, axes, **options)
    return axes
