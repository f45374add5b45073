"""What runs and examples leave, and examples as modules."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

RunExample = Callable[..., Any]
EXAMPLES = Path(__file__).parents[1] / "examples"


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file by column."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def load(name: str) -> ModuleType:
    """An example script by name."""
    return module_at(EXAMPLES / f"{name}.py")


def module_at(path: Path) -> ModuleType:
    """A file of Python as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def drawn(path: Path) -> bool:
    """Whether a file is a PNG with something in it."""
    return path.read_bytes()[:4] == b"\x89PNG" and path.stat().st_size > 10_000


@pytest.fixture
def run_example(tmp_path: Path) -> RunExample:
    """Runs an example by name, which draws its picture."""

    def run(name: str, *arguments: object, **options: object) -> Any:
        found = load(name).main(tmp_path / "picture.png", *arguments, **options)
        assert drawn(tmp_path / "picture.png")
        return found

    return run
