"""Names and values in the lines that `check` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

Lines = list[tuple[str, str]]  # pairs (subject, text)
MOST_WORDS = 16  # that a line of the plan lists


def named(values: Mapping[str, float]) -> str:
    """Names and values, one after the other."""
    return listed([f"{name} = {value:g}" for name, value in values.items()])


def listed(words: Sequence[str]) -> str:
    """Words one after the other; of many the first and the last."""
    if len(words) <= MOST_WORDS:
        return ", ".join(words)
    return f"{', '.join(words[:2])}, ..., {words[-1]} ({len(words)} in all)"
