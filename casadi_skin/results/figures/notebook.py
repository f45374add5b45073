"""Results in notebooks: a small table beside its picture."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from casadi_skin.results.described import described
from casadi_skin.results.figures import drawn
from casadi_skin.results.figures.style import blank, finished, style
from casadi_skin.results.wording import Rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def html_table(result: Any) -> str:
    """A result as a small table beside its picture, for notebooks."""
    return page(*described(result), lambda axes: drawn.plot(result, axes))


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
