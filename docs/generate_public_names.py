"""Writes the tables in docs/python_reference.md: every public name of casadi_skin, its arguments, and what it is.

Run: python docs/generate_public_names.py
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from enum import EnumType
from pathlib import Path
from typing import Any

import casadi_skin
from casadi_skin.model.result import Result

PAGE = Path(__file__).with_name("python_reference.md")
BEGIN, END = "<!-- begin: every public name -->\n", "<!-- end: every public name -->\n"
MADE = (Result, casadi_skin.Map)  # classes that functions make; others are called with arguments
HEADS: Mapping[str, Callable[[Any], bool]] = {
    "Functions": inspect.isroutine,
    "Models, problems and their parts": lambda thing: (
        inspect.isclass(thing) and not issubclass(thing, (*MADE, Exception))
    ),
    "Results": lambda thing: inspect.isclass(thing) and issubclass(thing, MADE),
    "Exceptions": lambda thing: inspect.isclass(thing) and issubclass(thing, Exception),
    "Modules": inspect.ismodule,
}


def tables() -> str:
    """A table for each kind of names, in alphabetical order."""
    names = {name: getattr(casadi_skin, name) for name in casadi_skin.__all__ if name != "__version__"}
    parts = []
    for head, belongs in HEADS.items():
        rows = [_row(name, names[name], head) for name in sorted(names, key=str.casefold) if belongs(names[name])]
        parts.append("\n".join([f"### {head}\n", "| name | what it is |", "| --- | --- |", *rows]))
    return "\n\n".join(parts) + "\n"


def _row(name: str, thing: Any, head: str) -> str:
    place = thing.__name__ if head == "Modules" else f"{thing.__module__}.{thing.__qualname__}"
    given = f"<br>`{_arguments(thing)}`" if head in list(HEADS)[:2] else ""
    paragraph = " ".join(inspect.getdoc(thing).partition("\n\n")[0].split())
    sentence = re.split(r"\. (?=[A-Z`])", paragraph)[0].removesuffix(".").replace("|", "\\|")
    return f"| [`{name}`][{place}]{given} | {sentence} |"


def _arguments(thing: Any) -> str:
    """Its arguments with their defaults, without types."""
    if isinstance(thing, EnumType):
        return "(value)"
    signature = inspect.signature(thing)
    plain = [given.replace(annotation=inspect.Parameter.empty) for given in signature.parameters.values()]
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty)).replace(
        "<factory>", "..."
    )


def page(text: str) -> str:
    """The text of the page with the tables of now."""
    before, _, rest = text.partition(BEGIN)
    return before + BEGIN + tables() + END + rest.partition(END)[2]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
