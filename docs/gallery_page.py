"""MkDocs hook: writes the gallery from the pictures of the pages of examples, so that each leads to what drew it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

MARK = "<!-- gallery -->"
NAMES = "examples lattices equilibria gradients maps designs scenes_of_any_model daes fmu"
PAGES = tuple(f"{name}.md" for name in NAMES.split())
PICTURE = re.compile(r"^(#{1,4}) (?P<head>.+)$|^!\[(?P<words>[^\]]*)\]\((?P<path>pictures/[^)]+)\)", re.MULTILINE)


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """Put the pictures in place of the mark."""
    return markdown.replace(MARK, gallery(Path(config["docs_dir"]))) if MARK in markdown else markdown


def gallery(docs: Path) -> str:
    """A picture a cell, each with a link to the section in which it stands."""
    cells, seen = [], set()
    for page in PAGES:
        head = ""
        for match in PICTURE.finditer((docs / page).read_text(encoding="utf-8")):
            if match["head"]:
                head = match["head"]
            elif match["path"] not in seen:
                seen.add(match["path"])
                cells.append(f"[![{match['words']}]({match['path']})\n{head}]({page}#{anchor(head)})")
    return '<div class="gallery" markdown>\n\n' + "\n\n".join(cells) + "\n\n</div>"


def anchor(head: str) -> str:
    """The anchor of a heading, as Python-Markdown makes it."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", head).strip().lower())
