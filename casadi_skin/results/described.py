"""Any result in a few words, as lines for print."""

from __future__ import annotations

from typing import Any

from casadi_skin.model.arguments import cut
from casadi_skin.results import describing, describing_analyses
from casadi_skin.results.wording import Rows, words

LONGEST = 100  # characters of a value
REGISTERED = describing, describing_analyses  # modules whose words count once they are loaded


def described(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows, each value cut to a line; raises TypeError for other objects."""
    head, rows = words(result)
    return head, [(name, cut(value, LONGEST)) for name, value in rows]


def lines(result: Any) -> str:
    """A result in a few lines."""
    head, rows = described(result)
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([head, *(f"  {name:<{width}}  {value}" for name, value in rows)])
