"""Tables of results, which modules register by class."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

Columns = dict[str, Any]


@singledispatch
def table(result: Any) -> tuple[str, str, Columns]:
    """The name of the first column, the meaning of the table, and its columns; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")
