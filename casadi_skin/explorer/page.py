"""The page of a run as one file."""

from __future__ import annotations

import html
import json
from importlib.resources import files
from pathlib import Path

from casadi_skin.explorer.data import page_data
from casadi_skin.files import replacing


def write_page(directory: Path, target: Path) -> Path:
    """Write a page that shows the run in a directory; raises ValueError where that has no branches."""
    data = page_data(directory)
    folder = files("casadi_skin.explorer")
    page = (folder / "page.html").read_text(encoding="utf-8")
    parts = {
        "@TITLE@": html.escape(str(data["title"])),
        "@PLOTLY@": (folder / "plotly-basic.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script"),
        "@SCRIPT@": (folder / "explorer.js").read_text(encoding="utf-8"),
        "@DATA@": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    }
    for mark, text in parts.items():
        page = page.replace(mark, text)
    with replacing(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target
