"""The page of a run, a map, a branch or a diagram as one file."""

from __future__ import annotations

import html
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.runs.explorer_data import page_data
from casadi_skin.runs.explorer_map_data import MAP, map_data


def write_page(source: Path, target: Path) -> Path:
    """Write a page that shows the run or the map in a directory, or a map, a branch or a diagram in a file.

    Raises ValueError where there is none of these.
    """
    data, kind = _data_of_file(source) if source.is_file() else _data_in(source)
    folder = files("casadi_skin.runs.page")

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


def _data_in(directory: Path) -> tuple[dict[str, Any], str]:
    """The contents of a page of a directory, and their kind."""
    return (map_data(directory), "map") if (directory / MAP).exists() else (page_data(directory), "run")


def _data_of_file(path: Path) -> tuple[dict[str, Any], str]:
    """The contents of a page of one file, which is written as a run or a map writes it, and read again."""
    from casadi_skin.runs.explorer_file import write_files

    folder = TemporaryFolder("casadi_skin_page_")
    try:
        write_files(path, folder.path)
        return _data_in(folder.path)
    finally:
        folder.remove()
