"""Results in notebooks: a small table beside its picture."""

from __future__ import annotations

import base64
import html
import io
from typing import Any

from casadi_skin.figures import drawn
from casadi_skin.figures.style import blank, finished, style
from casadi_skin.results.described import described


def html_table(result: Any) -> str:
    """A result as a small table beside its picture, for notebooks."""
    head, rows = described(result)
    cells = "".join(f"<tr><th>{html.escape(n)}</th><td>{html.escape(v)}</td></tr>" for n, v in rows)
    table = f"<table><caption>{html.escape(head)}</caption>{cells}</table>"
    return f'<div style="display:flex;gap:2em;align-items:center">{table}{_picture(result, head)}</div>'


def _picture(result: Any, head: str) -> str:
    """The picture of a result as part of a page; nothing where it has none."""
    with style():
        figure, stream = blank(4.2, 2.8), io.BytesIO()
        try:
            drawn.plot(result, figure.add_subplot())
        except (ValueError, ArithmeticError):
            return ""
        finished(figure, (), 1).savefig(stream, format="png", dpi=110)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{html.escape(head)}" src="data:image/png;base64,{data}">'
