"""Tables of refused scenes: a text file with a message on a line, and the lines of the scene below it, indented."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

INDENT = " " * 4


def refusals(path: Path, tables: Mapping[str, str]) -> list[tuple[str, str]]:
    """Scenes with the message about each; a line <NAME> of a scene stands for the table by that name."""
    found = []
    for block in path.read_text(encoding="utf-8").partition("\n\n")[2].split("\n\n"):
        message, *lines = block.rstrip("\n").split("\n")
        scene = [line.removeprefix(INDENT) for line in lines]
        found.append(("".join(tables.get(line, f"{line}\n") for line in scene), message))
    return found
