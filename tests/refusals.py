"""Tables of refused scenes: a text file with a message on a line, and the lines of the scene below it, indented."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

INDENT, BETWEEN = " " * 4, " | "


def refusals(path: Path, tables: Mapping[str, str]) -> list[tuple[str, str]]:
    """Scenes with the message about each. Lines that share one are told apart by bars; <NAME> stands for the lines that
    `tables` or the file itself, as <NAME> = ..., has for it.
    """
    parts, found = dict(tables), list[tuple[str, str]]()

    def text(line: str) -> str:
        return "".join(parts.get(one, f"{one}\n") for one in line.split(BETWEEN))

    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("<"):
            name, _, part = line.partition(" = ")
            parts[name] = text(part)
        elif line.startswith(INDENT):
            scene, message = found[-1]
            found[-1] = scene + text(line.removeprefix(INDENT)), message
        elif line and not line.startswith("#"):
            found.append(("", line))
    return found
