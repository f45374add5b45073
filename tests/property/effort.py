"""How many examples a property is tried on."""

from __future__ import annotations

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

LETTERS = "aZ_0 .-'\"\n\0\\[]{}=#éµξ☃😀"


def examples(count: int, **more: Any) -> settings:
    """So many in a slow run, a fifth of them in a quick one: the profiles are those of tests/conftest.py."""
    return settings(max_examples=-(-count * settings().max_examples // 100), **more)


def texts(most: int) -> st.SearchStrategy[str]:
    """Texts of up to so many letters: of all of Unicode in a slow run, whose table takes seconds to make."""
    return st.text(
        LETTERS if settings().max_examples <= 20 else st.characters(exclude_categories=["Cs"]), max_size=most
    )
