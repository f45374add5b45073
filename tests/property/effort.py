"""How many examples a property is tried on."""

from __future__ import annotations

from typing import Any

from hypothesis import settings


def examples(count: int, **more: Any) -> settings:
    """So many in a slow run, a fifth of them in a quick one: the profiles are those of tests/conftest.py."""
    return settings(max_examples=-(-count * settings().max_examples // 100), **more)
