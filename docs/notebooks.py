"""Tutorials as notebooks: a cell a block of code, made from the pages, by themselves or as a MkDocs hook.

Run: python docs/notebooks.py FOLDER
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

TUTORIALS = ("my_chain", "my_lattice", "my_ode")
DOCS = Path(__file__).parent
BLOCK = re.compile(r"^```(python|toml|sh)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r"^!\[[^\]]*\]\([^)]*\)\n", re.MULTILINE)


def notebook(page: str) -> nbformat.NotebookNode:
    """The notebook of a page: text, programs, scenes written to a file, and commands."""
    text = PICTURE.sub("", (DOCS / f"{page}.md").read_text(encoding="utf-8"))
    cells, place = [], 0
    for match in BLOCK.finditer(text):
        cells += [*_words(text[place : match.start()]), new_code_cell(_program(match[1], match[2].rstrip()))]
        place = match.end()
    cells += _words(text[place:])
    for number, cell in enumerate(cells):
        cell["id"] = f"{page}-{number}"  # else drawn by lot
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel})


def _words(text: str) -> list[nbformat.NotebookNode]:
    return [new_markdown_cell(text.strip())] if text.strip() else []


def _program(language: str, text: str) -> str:
    return {"python": text, "toml": f"%%writefile mine.toml\n{text}", "sh": f"%%sh\n{text}"}[language]


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add the notebooks to the site."""
    from mkdocs.structure.files import File

    for page in TUTORIALS:
        files.append(File.generated(config, f"notebooks/{page}.ipynb", content=nbformat.writes(notebook(page))))
    return files


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(exist_ok=True)
    for name in TUTORIALS:
        nbformat.write(notebook(name), folder / f"{name}.ipynb")
