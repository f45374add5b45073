"""The tables of a run, a row a solution, rewritten as it goes on, so that results can be read meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.results.dataset import Cell, write_csv
from casadi_skin.results.quantities import csv_row, quantities_of
from casadi_skin.results.quantity import Place

TABLE_PERIOD = 0.5  # seconds between two writings of the table while a run goes on


@dataclass
class Tables:
    """Rows of every branch's table by the name of its file; those of families stand in one.

    Attributes:
        directory: where the tables are written.
        with_stability: whether rows have the stability of their solution.
        rows: by name of the file.
    """

    directory: Path
    with_stability: bool
    rows: dict[str, list[dict[str, Cell]]] = field(default_factory=dict)
    _written: float = 0.0

    def add(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Add rows to a table, which is replaced at most every TABLE_PERIOD."""
        table, rows = table_of(name, space), self.rows.setdefault(table_of(name, space), [])
        mode = space.coordinates.mode_number if isinstance(space, Family) else 0
        for solution in solutions:
            quantities = quantities_of(Branch(space, (solution,), with_stability=self.with_stability))
            index = sum(row.get("mode", 0) == mode for row in rows)
            place = Place(solution, index, mode, solution.point.requested, solution.point.special)
            rows.append(csv_row(quantities, place))
        if rows and time.monotonic() - self._written > TABLE_PERIOD:
            self._write(table)

    def count(self, name: str, space: SolutionSpace) -> int:
        """Number of rows of the table that a branch stands in."""
        return len(self.rows.get(table_of(name, space), ()))

    def write(self) -> list[str]:
        """Write every table that has rows; their names without the suffix."""
        names = [name for name, rows in self.rows.items() if rows]
        for name in names:
            self._write(name)
        return [name.removesuffix(".csv") for name in names]

    def _write(self, name: str) -> None:
        rows = self.rows[name]
        write_csv(self.directory / name, list(rows[0]), rows)
        self._written = time.monotonic()


def table_of(name: str, space: SolutionSpace) -> str:
    """The file that the rows of a branch stand in."""
    return "family.csv" if isinstance(space, Family) else f"{name}.csv"
