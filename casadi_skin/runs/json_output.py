"""Output of a command that is not for a reader: nothing, or its results as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

Value = float | int | str | None


def add_output(parser: argparse.ArgumentParser) -> None:
    """Add --quiet and --json, one of which may be given."""
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--quiet", action="store_true", help="print nothing but errors")
    either.add_argument("--json", action="store_true", help="print the results as JSON, and nothing else")


def print_json(value: object) -> None:
    """Print a value as JSON on one line; numbers that are not finite are refused, as JSON has none."""
    import json  # here: --help does not need it

    print(json.dumps(value, ensure_ascii=False, allow_nan=False))


def print_results(directory: Path, complete: bool, reasons: Sequence[str]) -> None:
    """Print the results that a run or a study has left in its directory.

    Arguments:
        directory: where its files are.
        complete: whether every requested result was found.
        reasons: why not, in a line each.
    """
    files = sorted(path.name for path in directory.iterdir() if not path.name.startswith("."))
    tables = {name.removesuffix(".csv"): _rows(directory / name) for name in files if name.endswith(".csv")}
    place = str(directory)
    print_json({"directory": place, "complete": complete, "reasons": list(reasons), "files": files, "tables": tables})


def _rows(path: Path) -> list[dict[str, Value]]:
    """The rows of a table; an empty cell is None."""
    import csv

    with path.open(encoding="utf-8", newline="") as file:
        return [{name: _value(cell) for name, cell in row.items()} for row in csv.DictReader(file)]


def _value(cell: str) -> Value:
    """A cell as the number it is, or as text."""
    for kind in (int, float):
        try:
            value: float = kind(cell)
        except ValueError:
            continue
        return value if abs(value) < float("inf") else cell
    return cell or None
