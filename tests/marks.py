"""Marks that many tests give."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """A case of a parametrised test that is among the slow ones."""
    return pytest.param(*values, marks=pytest.mark.slow)
