"""The page of a run or of a map as one file."""

from __future__ import annotations

import html
import json
from importlib.resources import files
from pathlib import Path

from casadi_skin.explorer.data import page_data
from casadi_skin.explorer.map_data import MAP, map_data
from casadi_skin.files import replacing


def write_page(directory: Path, target: Path) -> Path:
    """Write a page that shows the run or the map in a directory; raises ValueError where that has neither."""
    is_map = (directory / MAP).exists()
    data, kind = (map_data(directory), "map") if is_map else (page_data(directory), "run")
    folder = files("casadi_skin.explorer")

    def text(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    page = text("page.html").replace("@BODY@", text(f"{kind}.html"))
    parts = {
        "@TITLE@": html.escape(str(data["title"])),
        "@PLOTLY@": text("plotly-basic.min.js").replace("</script", "<\\/script"),
        "@COMMON@": text("common.js"),
        "@SCRIPT@": text(f"{kind}.js"),
        "@DATA@": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    }
    for mark, words in parts.items():
        page = page.replace(mark, words)
    with replacing(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target
